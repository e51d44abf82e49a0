"""The cable to the board: find its port, open it, and explain what is wrong with it."""

import errno
import select
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import serial
from serial.tools import list_ports

from echowing.errors import EchowingError
from echowing.mavlink.links import Address, UdpListener, open_transport, parse_address

START_AGAIN = ". Plug it in and start again"
USB_BAUD = 115_200  # of the firmware's USB port; boards with USB of their own ignore it
WRITE_TIMEOUT_S = 2.0  # a board whose loop runs takes a frame within milliseconds

_READ_BYTES = 4096
# Whoever is at the other end: nobody has looked at its messages here.
_BOARD = frozenset({0})


class PortLostError(EchowingError):
    """The connection was lost during the work."""


class Wire(Protocol):
    """An open connection to the board."""

    def read(self, timeout_s: float) -> bytes:
        """New bytes, waiting at most `timeout_s` for them. Raises PortLostError."""

    def write(self, data: bytes) -> None:
        """Send. Raises PortLostError."""

    def understood(self) -> None:
        """The last bytes contained MAVLink."""

    def close(self) -> None:
        """Let go."""


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A serial port of this computer that is on USB."""

    device: str
    description: str
    usb_id: str  # vendor:product, hexadecimal

    def __str__(self) -> str:
        return f"{self.device} ({self.description}, USB {self.usb_id})"


def usb_devices() -> list[UsbDevice]:
    """The serial ports on USB, by name."""
    return [
        UsbDevice(info.device, _named(info), f"{info.vid:04x}:{info.pid or 0:04x}")
        for info in sorted(list_ports.comports(), key=lambda info: str(info.device))
        if info.vid is not None
    ]


def _named(info: object) -> str:
    product = getattr(info, "product", None) or getattr(info, "description", None)
    return str(product or "no name")


def find_port(devices: Callable[[], Sequence[UsbDevice]] = usb_devices) -> str:
    """The only serial port on USB; EchowingError when there is none, or more than one."""
    found = devices()
    if not found:
        raise EchowingError(
            "no board found: no serial port is on USB. Plug the board in with a cable that "
            "carries data (many only charge), or give --port"
        )
    if len(found) > 1:
        raise EchowingError(
            f"{len(found)} serial ports are on USB: {', '.join(map(str, found))}. "
            f"Say which with --port, as --port {found[0].device}"
        )
    return found[0].device


def open_wire(text: str, baud: int = USB_BAUD) -> Wire:
    """Open a connection string. Raises EchowingError that says why it cannot."""
    address = parse_address(text, baud)
    try:
        return SerialWire(address) if address.kind == "serial" else SocketWire(address)
    except (OSError, OverflowError, ValueError) as error:
        raise EchowingError(f"{text}: {_why_not_opened(error, address)}") from error


class SerialWire:
    """A serial device, opened exclusively."""

    def __init__(self, address: Address) -> None:
        self._name = address.host
        self._port = serial.Serial(
            address.host,
            address.baud,
            exclusive=True,
            timeout=0,
            write_timeout=WRITE_TIMEOUT_S,
        )

    def read(self, timeout_s: float) -> bytes:
        """As `Wire`."""
        try:
            self._port.timeout = max(0.0, timeout_s)
            first = self._port.read(1)
            waiting = min(self._port.in_waiting, _READ_BYTES) if first else 0
            return bytes(first + self._port.read(waiting)) if waiting else bytes(first)
        except (OSError, TypeError) as error:  # pyserial: TypeError where the port closed beneath
            raise PortLostError(f"{self._name}: {_why_lost(error)}") from error

    def write(self, data: bytes) -> None:
        """As `Wire`."""
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise PortLostError(
                f"{self._name}: the device accepts no bytes; unplug it, plug it in and start again"
            ) from error
        except (OSError, TypeError) as error:
            raise PortLostError(f"{self._name}: {_why_lost(error)}") from error

    def understood(self) -> None:
        """As `Wire`."""

    def close(self) -> None:
        """As `Wire`."""
        self._port.close()


class SocketWire:
    """A socket: a board behind a router, an autopilot or another computer."""

    def __init__(self, address: Address) -> None:
        self._name = address.text
        self._transport = open_transport(address)

    def read(self, timeout_s: float) -> bytes:
        """As `Wire`."""
        try:
            select.select([self._transport.fileno()], [], [], max(0.0, timeout_s))
            return self._transport.read()
        except OSError as error:
            raise PortLostError(f"{self._name}: {_why_hung_up(error)}") from error

    def write(self, data: bytes) -> None:
        """As `Wire`."""
        try:
            self._transport.write(data)
        except OSError as error:
            raise PortLostError(f"{self._name}: {_why_hung_up(error)}") from error

    def understood(self) -> None:
        """As `Wire`: answer its sender from now on, and nobody else."""
        if isinstance(self._transport, UdpListener):
            self._transport.understood(_BOARD)
            self._transport.keep(_BOARD)

    def close(self) -> None:
        """As `Wire`."""
        self._transport.close()


# Error numbers, a word of pyserial's where it gives no number (on Windows access is denied to a
# port that is open elsewhere), and what to say.
_REASONS: tuple[tuple[set[int], str, str], ...] = (
    (
        {errno.EAGAIN, errno.EBUSY},
        "PermissionError",
        "the port is busy: another program has it open (a ground station, a serial monitor, "
        "another `echowing rig`); end that program first",
    ),
    (
        {errno.EACCES, errno.EPERM},
        "Permission denied",
        "not allowed to open it: on Linux add yourself to the group that owns it "
        "(`sudo usermod -a -G dialout $USER`), log out and in again",
    ),
    (
        {errno.ENOENT, errno.ENODEV, errno.ENXIO},
        "FileNotFoundError",
        "no such device; {there_are}",
    ),
    ({errno.ENOTTY, errno.EISDIR}, "configure port", "is not a serial port; {there_are}"),
)


def _why_not_opened(error: Exception, address: Address) -> str:
    if address.kind != "serial":
        return _why_hung_up(error)
    number, words = getattr(error, "errno", None), str(error)
    for numbers, word, reason in _REASONS:
        if number in numbers or word in words:
            return reason.format(there_are=_there_are())
    if isinstance(error, ValueError | OverflowError):
        return f"the port does not support {address.baud} baud; the board's USB port has {USB_BAUD}"
    return getattr(error, "strerror", None) or words


def _there_are() -> str:
    found = usb_devices()
    if not found:
        return "no serial port is on USB now: is the board plugged in, with a cable for data?"
    return f"on USB there {'is' if len(found) == 1 else 'are'} {', '.join(map(str, found))}"


def _why_lost(error: Exception) -> str:
    reason = getattr(error, "strerror", None)
    return (
        "the connection was lost: the cable was unplugged or the board lost its power"
        f"{f' ({reason})' if reason else ''}{START_AGAIN}"
    )


def _why_hung_up(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ECONNREFUSED:
        return "nothing listens there; start the other end first"
    if number == errno.EADDRINUSE:
        return "the port is taken; another tool listens there"
    if number in (errno.ECONNRESET, errno.EPIPE):
        return "the connection was lost: the other end has closed it"
    return getattr(error, "strerror", None) or str(error)
