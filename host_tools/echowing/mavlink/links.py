"""MAVLink links to real vehicles: connection strings as pymavlink writes them.

The transports are our own: those of pymavlink block while they reconnect, and print messages. A
tool that flies several vehicles must not wait for one. Nothing here blocks.
"""

import contextlib
import errno
import os
import select
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

from echowing.errors import EchowingError
from echowing.mavlink.connection import DEFAULT_BAUD
from echowing.mavlink.signing import LinkSigning, Parser, is_refused

LOOPBACK, EVERYWHERE = "127.0.0.1", "0.0.0.0"
RETRY_S = 1.0
# One datagram, or the buffer of a serial port.
CHUNK_BYTES = 65_535
# Most bytes of one link before the others and the points get their turn: the messages of fifty
# vehicles in a third of a second.
MOST_READS = 500
# More senders than this at one listening port are not vehicles: fifty followers without a router,
# their leader, and some to spare.
MOST_PEERS = 64
# Datagrams of others that are thrown away before the links that are ours get their turn.
MOST_FOREIGN = 2_000
# A peer that has been silent for so long may go on from another port: its bridge was restarted.
MOVED_S = 5.0
# A vehicle learns the time from our signatures within a second or two; one whose frames are
# refused for longer has another key, or none.
REFUSED_S = 3.0
# A vehicle sends its heartbeat each second.
SILENT_S = 3.0
TAKEN = (
    "nothing arrives; a vehicle's TCP port often accepts only one tool, and another may be "
    "connected"
)

_STILL_CONNECTING = {errno.EINPROGRESS, errno.EALREADY, errno.EWOULDBLOCK}
_FORMS = "udpin:[HOST:]PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:[HOST:]PORT or a serial device"


@dataclass(frozen=True, slots=True)
class Address:
    """A connection string taken apart. kind: udpin, udpout, tcp, tcpin or serial."""

    text: str
    kind: str
    host: str = ""
    port: int = 0
    baud: int = DEFAULT_BAUD

    @property
    def where(self) -> str:
        """The connection string, and the address on which it listens."""
        if self.kind == "udpin" and self.host == EVERYWHERE:
            return f"{self.text} (listens on all addresses of this computer)"
        if self.kind in ("udpin", "tcpin"):
            return f"{self.text} (listens on {self.host})"
        return self.text


def parse_address(text: str, baud: int = DEFAULT_BAUD) -> Address:
    """Read a connection string. Without a host `udpin` listens everywhere, `tcpin` on loopback.

    Vehicles on Wi-Fi send their datagrams to this computer's address.

    Raises EchowingError that says what to write.
    """
    kind, _, rest = text.partition(":")
    if kind == "udp":  # pymavlink's other name for it
        kind = "udpin"
    if kind not in ("udpin", "udpout", "tcp", "tcpin"):
        return _serial_address(text, baud)
    host, _, port = rest.rpartition(":")
    if not port.isdecimal() or not 1 <= int(port) <= 65_535:
        raise EchowingError(f"connection {text!r}: the port is a number from 1 to 65535 ({_FORMS})")
    if not host and kind in ("udpout", "tcp"):
        raise EchowingError(f"connection {text!r}: which host? Write {kind}:HOST:PORT")
    here = EVERYWHERE if kind == "udpin" else LOOPBACK
    return Address(text, kind, host or here, int(port))


def _serial_address(text: str, baud: int) -> Address:
    device, comma, own_baud = text.partition(",")
    if not device.startswith("/") and not device.upper().startswith("COM"):
        raise EchowingError(f"connection {text!r}: no such kind; write {_FORMS}")
    if comma and not own_baud.isdecimal():
        raise EchowingError(f"connection {text!r}: the baud rate after the comma is a number")
    return Address(text, "serial", device, baud=int(own_baud) if comma else baud)


class Transport(Protocol):
    """An open way to send and receive bytes; OSError: it is lost.

    datagrams: `read` returns complete frames, so nothing is kept for the next call.
    """

    datagrams: bool

    def fileno(self) -> int:
        """For `select`."""

    def read(self) -> bytes:
        """New bytes; empty: none."""

    def write(self, data: bytes) -> None:
        """Send; bytes that do not fit are lost, as on a radio."""

    def close(self) -> None:
        """Close it."""


class UdpListener:
    """Listens for datagrams. Answers all senders of MAVLink until it is told whom it is for.

    From then on (`keep`) it hears and answers only the first sender of each of these vehicles. It
    may go on from another port of its computer, once the old one has fallen silent.
    foreign: the address of a sender that was not heard.
    """

    datagrams = True

    def __init__(self, address: Address) -> None:
        self._socket = _bound(socket.SOCK_DGRAM, address)
        # In the order of their last messages, so that senders that have gone are dropped first.
        self._peers: dict[tuple[str, int], float] = {}
        self._first: dict[int, tuple[str, int]] = {}
        self._last_peer: tuple[str, int] | None = None
        self._kept: frozenset[int] | None = None
        self.foreign: str | None = None

    def fileno(self) -> int:
        """As `Transport`."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """As `Transport`; one datagram."""
        for _ in range(MOST_FOREIGN):
            try:
                data, sender = self._socket.recvfrom(CHUNK_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return b""
            self._last_peer = sender
            if self._kept is None or any(sender[0] == host for host, _ in self._peers):
                return data
            self._note_foreign(sender)
        return b""

    def keep(self, systems: frozenset[int]) -> None:
        """Hear and answer from now on only the first sender of each of these vehicles."""
        self._kept = systems
        firsts = {sender for system_id, sender in self._first.items() if system_id in systems}
        self._peers = {one: at_s for one, at_s in self._peers.items() if one in firsts}

    def understood(self, systems: Iterable[int] = (), now_s: float = 0.0) -> bool:
        """The last datagram contained MAVLink of these systems; whether it is to be heard.

        If so its sender is answered from now on.
        """
        sender, sent = self._last_peer, set(systems)
        if sender is None:
            return True
        if self._kept is not None and sender not in self._peers:
            ours = not sent.isdisjoint(self._kept)
            if not (ours and self._has_moved(sender[0], now_s)):
                self._note_foreign(sender)
                return False
        for system_id in sent:
            self._first.setdefault(system_id, sender)
        self._peers.pop(sender, None)
        self._peers[sender] = now_s
        if len(self._peers) > MOST_PEERS:
            del self._peers[next(iter(self._peers))]
        return True

    def _has_moved(self, host: str, now_s: float) -> bool:
        """Whether a peer of this computer has fallen silent; it is forgotten."""
        for one, at_s in self._peers.items():
            if one[0] == host and now_s - at_s > MOVED_S:
                del self._peers[one]
                return True
        return False

    def _note_foreign(self, sender: tuple[str, int]) -> None:
        self.foreign = f"{sender[0]}:{sender[1]}"

    def write(self, data: bytes) -> None:
        """As `Transport`."""
        for peer in self._peers:
            _send_datagram(self._socket, data, peer)

    def close(self) -> None:
        """As `Transport`."""
        self._socket.close()


class UdpSender:
    """Datagrams to one address, and its answers."""

    datagrams = True

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer = (_number_of(address.host), address.port)

    def fileno(self) -> int:
        """As `Transport`."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """As `Transport`; one datagram, of that address only."""
        for _ in range(MOST_FOREIGN):
            try:
                data, sender = self._socket.recvfrom(CHUNK_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return b""
            if sender == self._peer:
                return data
        return b""

    def write(self, data: bytes) -> None:
        """As `Transport`."""
        _send_datagram(self._socket, data, self._peer)

    def close(self) -> None:
        """As `Transport`."""
        self._socket.close()


@cache
def _number_of(host: str) -> str:
    """A host's address, looked up once: without a network a lookup blocks for seconds."""
    return socket.gethostbyname(host)


def _send_datagram(sender: socket.socket, data: bytes, peer: tuple[str, int]) -> None:
    try:
        sender.sendto(data, peer)
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.ECONNREFUSED, errno.ENOBUFS):
            raise


class Stream:
    """A connected TCP socket, or one that is still connecting."""

    datagrams = False

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection

    @classmethod
    def to(cls, address: Address) -> "Stream":
        """Begin to connect; a refusal shows at the first `read`."""
        stream = cls(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        code = stream._socket.connect_ex((_number_of(address.host), address.port))
        if code != 0 and code not in _STILL_CONNECTING:
            stream.close()
            raise OSError(code, os.strerror(code))
        return stream

    def fileno(self) -> int:
        """As `Transport`."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """As `Transport`."""
        try:
            data = self._socket.recv(CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.ENOTCONN:  # still on its way
                return b""
            raise
        if not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> None:
        """As `Transport`."""
        try:
            self._socket.send(data)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.ENOTCONN:
                raise

    def close(self) -> None:
        """As `Transport`."""
        self._socket.close()


class TcpListener:
    """Waits for one TCP connection, and for the next when it has ended."""

    datagrams = False

    def __init__(self, address: Address) -> None:
        self._listener = _bound(socket.SOCK_STREAM, address)
        self._listener.listen(1)
        self._stream: Stream | None = None

    def fileno(self) -> int:
        """As `Transport`: the connection's, or the listener's while there is none."""
        return self._stream.fileno() if self._stream else self._listener.fileno()

    def read(self) -> bytes:
        """As `Transport`; a connection that ends is no loss, the next may come."""
        if self._stream is None:
            try:
                self._stream = Stream(self._listener.accept()[0])
            except BlockingIOError:
                return b""
        try:
            return self._stream.read()
        except OSError:
            self._hang_up()
            return b""

    def write(self, data: bytes) -> None:
        """As `Transport`."""
        try:
            if self._stream is not None:
                self._stream.write(data)
        except OSError:
            self._hang_up()

    def _hang_up(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream = None

    def close(self) -> None:
        """As `Transport`."""
        self._hang_up()
        self._listener.close()


class SerialPort:
    """A serial device, by pyserial."""

    datagrams = False

    def __init__(self, address: Address) -> None:
        import serial  # noqa: PLC0415 (slow import, not needed for sockets)

        # Exclusive: two tools on one device would each get half of the bytes.
        self._port = serial.Serial(address.host, address.baud, timeout=0, exclusive=True)

    def fileno(self) -> int:
        """As `Transport`."""
        return int(self._port.fileno())

    def read(self) -> bytes:
        """As `Transport`."""
        return bytes(self._port.read(CHUNK_BYTES))

    def write(self, data: bytes) -> None:
        """As `Transport`."""
        # Not pyserial's write, which waits without limit when a radio stops us.
        with contextlib.suppress(BlockingIOError):
            os.write(self._port.fileno(), data)

    def close(self) -> None:
        """As `Transport`."""
        self._port.close()


def _bound(kind: socket.SocketKind, address: Address) -> socket.socket:
    listener = socket.socket(socket.AF_INET, kind)
    if kind == socket.SOCK_STREAM:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.setblocking(False)
    try:
        listener.bind((address.host, address.port))
    except OSError:
        listener.close()
        raise
    return listener


_OPENERS: dict[str, Callable[[Address], Transport]] = {
    "udpin": UdpListener,
    "udpout": UdpSender,
    "tcp": Stream.to,
    "tcpin": TcpListener,
    "serial": SerialPort,
}


def open_transport(address: Address) -> Transport:
    """Open what the address names. Raises OSError, OverflowError or ValueError."""
    return _OPENERS[address.kind](address)


class Link:
    """One link: connects, connects again when lost, and turns bytes into MAVLink messages.

    `news` holds messages for the operator; the owner empties it. With `signing` it accepts only
    signed messages.
    """

    def __init__(self, address: Address, signing: LinkSigning | None = None) -> None:
        self.address = address
        self.signing = signing
        self.news: list[str] = []
        self.connected = False
        self._transport: Transport | None = None
        self._parser = Parser(signing)
        self._try_at_s = self._opened_at_s = 0.0
        self._complaint = ""
        self._refused_since_s: float | None = None
        self._refusal_told = self._foreign_told = False
        self._kept: frozenset[int] | None = None

    @property
    def name(self) -> str:
        """The connection string."""
        return self.address.text

    def open(self) -> None:
        """Open what must work at once: listening ports and serial devices.

        Raises EchowingError that says why it cannot. The other end of a connection may come later.
        """
        if self.address.kind == "tcp":
            return
        try:
            self._transport = open_transport(self.address)
        except (OSError, OverflowError, ValueError) as error:
            raise EchowingError(f"link {self.name}: {_reason(error)}") from error

    def keep(self, systems: Iterable[int]) -> None:
        """Hear and answer from now on nobody who does not send for these vehicles."""
        self._kept = frozenset(systems)
        if isinstance(self._transport, UdpListener):
            self._transport.keep(self._kept)

    def fileno(self) -> int | None:
        """For `select`; None while there is nothing to wait for."""
        return None if self._transport is None else self._transport.fileno()

    def receive(self, now_s: float) -> list[Any]:
        """The messages that have arrived; tries to connect where there is no connection."""
        if self._transport is None and not self._connect(now_s):
            return []
        messages: list[Any] = []
        try:
            for _ in range(MOST_READS):
                if self._transport is None or not (data := self._transport.read()):
                    break
                messages += self._parse(data, now_s)
        except OSError as error:
            self._lost(error, now_s)
        self._tell_of_foreign()
        if messages and not self.connected:
            self._heard()
        elif self.address.kind == "tcp" and not self.connected:
            self._complain_of_silence(now_s)
        return messages

    def send(self, frame: bytes, now_s: float) -> None:
        """Send a frame; it is lost without a connection."""
        if self._transport is None:
            return
        try:
            self._transport.write(frame)
        except OSError as error:
            self._lost(error, now_s)

    def close(self) -> None:
        """Close it."""
        if self._transport is not None:
            self._transport.close()
        self._transport = None

    def _connect(self, now_s: float) -> bool:
        if now_s < self._try_at_s:
            return False
        self._try_at_s = now_s + RETRY_S
        try:
            self._transport = open_transport(self.address)
        except (OSError, OverflowError, ValueError) as error:
            self._complain(error)
        if isinstance(self._transport, UdpListener) and self._kept is not None:
            self._transport.keep(self._kept)
        self._parser = Parser(self.signing)
        self._opened_at_s = now_s
        return self._transport is not None

    def _complain_of_silence(self, now_s: float) -> None:
        """Report once that a vehicle that should send every second sends nothing."""
        silent = self._transport is not None and now_s - self._opened_at_s >= SILENT_S
        if silent and self._complaint != TAKEN:
            self._complaint = TAKEN
            self.news.append(f"link {self.name}: {TAKEN}")

    def _tell_of_foreign(self) -> None:
        """Report once that somebody else sends to this port."""
        transport = self._transport
        if not isinstance(transport, UdpListener) or transport.foreign is None:
            return
        if not self._foreign_told:
            self._foreign_told = True
            self.news.append(
                f"link {self.name}: {transport.foreign} sends to it too, and is neither heard nor "
                "answered"
            )

    def _heard(self) -> None:
        self.connected = True
        self._complaint = ""
        self.news.append(f"link {self.name}: MAVLink received")

    def _lost(self, error: OSError, now_s: float) -> None:
        self.close()
        self._complain(error)
        self.connected = False
        self._try_at_s = now_s + RETRY_S

    def _complain(self, error: Exception) -> None:
        """Report why there is no connection, once per reason."""
        reason = _reason(error)
        hung_up = getattr(error, "errno", None) == errno.ECONNRESET
        if hung_up and self.address.kind == "tcp" and not self.connected:
            reason = TAKEN
        if self.connected or reason != self._complaint:
            self._complaint = reason
            self.news.append(f"link {self.name}: {reason}; trying again every {RETRY_S:g} s")

    def _parse(self, data: bytes, now_s: float) -> list[Any]:
        """The complete, known and undamaged messages in these bytes."""
        if self.signing is not None:
            self.signing.keep_time()
        parsed = self._parser.parse_buffer(data) or ()
        found = [message for message in parsed if message.get_msgId() >= 0]
        refused = any(map(is_refused, parsed))
        transport = self._transport
        if transport is not None and transport.datagrams and self._parser.buf_len() > 0:
            self._parser = Parser(self.signing)  # a part of a frame is garbage here
        if isinstance(transport, UdpListener):
            # Also if its messages are refused: a vehicle learns the time from our signature.
            systems = [message.get_srcSystem() for message in found]
            if (found or refused) and not transport.understood(systems, now_s):
                return []
        if found:
            self._refused_since_s, self._refusal_told = None, False
        elif refused:
            self._refuse(now_s)
        return found

    def _refuse(self, now_s: float) -> None:
        """Report once that messages are refused, until a signed one arrives."""
        if self._refused_since_s is None:
            self._refused_since_s = now_s
        if now_s - self._refused_since_s >= REFUSED_S and not self._refusal_told:
            self._refusal_told = True
            self.news.append(
                f"link {self.name}: messages are not signed with the key of "
                "--signing-key-file, and are refused"
            )


def _reason(error: Exception) -> str:
    """Why a link cannot be opened, and what to do."""
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return "the port is taken; another tool listens there"
    if number == errno.EACCES:
        return "not allowed; on Linux your user has to be in the group dialout"
    if number == errno.ENOENT:
        return "no such device; is it plugged in?"
    if number in (errno.EBUSY, errno.EAGAIN):
        return "the device is busy; another tool has it open"
    if number == errno.ECONNREFUSED:
        return "nothing listens there"
    return getattr(error, "strerror", None) or str(error)


def leads_back(link: Address, to: Address) -> bool:
    """Whether datagrams sent `to` an address come in, or go out, at a link of ours too."""
    if link.kind not in ("udpin", "udpout") or link.port != to.port:
        return False
    try:
        if link.kind == "udpin" and link.host == EVERYWHERE:
            return _is_here(to.host)
        return _number_of(link.host) == _number_of(to.host)
    except OSError:  # no such host, which shows when it is opened
        return False


def _is_here(host: str) -> bool:
    """Whether an address is one of this computer's."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((_number_of(host), 0))
        except OSError:
            return False
    return True


def wait(links: Iterable[Link], timeout_s: float) -> None:
    """Wait until something arrives on a link, at most `timeout_s`."""
    numbers = [number for link in links if (number := link.fileno()) is not None]
    select.select(numbers, [], [], max(0.0, timeout_s))
