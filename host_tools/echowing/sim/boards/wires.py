"""Where an emulated board's serial port goes: a TCP connection or a pseudo-terminal.

Every wire takes and gives bytes without blocking. Like a real wire it does not mind when nobody
listens: what is sent then is lost.
"""

import contextlib
import os
import pty
import socket
import tty
from typing import Protocol

from echowing.errors import EchowingError

RETRY_S = 1.0
# A tool that was started again connects before its former connection is seen to have ended.
SECOND_WAITS_S = 0.5
_CHUNK = 4096


class Wire(Protocol):
    """One end of a serial line."""

    def describe(self) -> str:
        """Where the other end is to be found."""

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """Send `data` and return what has arrived."""

    def close(self) -> None:
        """Unplug."""


class PtyWire:
    """A pseudo-terminal: other programs open it like a USB serial port."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def describe(self) -> str:
        """Its device file."""
        return self.path

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """As `Wire.exchange`."""
        with contextlib.suppress(BlockingIOError):  # nobody reads and it is full
            os.write(self._master, data)
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        """As `Wire.close`."""
        os.close(self._master)
        os.close(self._slave)


class _TcpWire:
    """A connection that may be there or not."""

    _peer: socket.socket | None = None

    @property
    def connected(self) -> bool:
        """Whether somebody is at the other end."""
        return self._peer is not None

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """As `Wire.exchange`; connects when there is no connection."""
        if self._peer is None:
            self._peer = self._connect(now_s)
        if self._peer is None:
            return b""
        try:
            if data:
                self._peer.send(data)
        except BlockingIOError:  # the peer does not read: lost, as on a wire
            pass
        except OSError:
            self._hang_up()
            return b""
        return self._receive(self._peer)

    def _receive(self, peer: socket.socket) -> bytes:
        try:
            data = peer.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def _connect(self, now_s: float) -> socket.socket | None:
        raise NotImplementedError

    def _hang_up(self) -> None:
        if self._peer is not None:
            self._peer.close()
        self._peer = None

    @staticmethod
    def _prepare(peer: socket.socket) -> socket.socket:
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return peer

    def close(self) -> None:
        """As `Wire.close`."""
        self._hang_up()


class TcpClientWire(_TcpWire):
    """Connects to a listener, SITL's serial port say, and again whenever it went away."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._next_try_s = 0.0

    def describe(self) -> str:
        """The address it connects to."""
        return f"tcp {self._address[0]}:{self._address[1]}"

    def _connect(self, now_s: float) -> socket.socket | None:
        if now_s < self._next_try_s:
            return None
        self._next_try_s = now_s + RETRY_S
        try:
            return self._prepare(socket.create_connection(self._address, timeout=0.2))
        except OSError:
            return None


class TcpServerWire(_TcpWire):
    """Listens on this machine; one connection at a time, the next when it ends.

    Who comes while another is there is hung up on after a moment, so that he knows.
    """

    _second: socket.socket | None = None
    _second_since_s = 0.0

    def __init__(self, port: int) -> None:
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except OSError as error:
            raise EchowingError(
                f"cannot listen on port {port}: {error.strerror}; take another, 0 for any free one"
            ) from error
        self._listener.listen(1)
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]

    def describe(self) -> str:
        """The port it listens on."""
        return f"tcp 127.0.0.1:{self.port} (listening)"

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """As `Wire.exchange`."""
        arrived = super().exchange(data, now_s)
        if self.connected:
            self._refuse_second(now_s)
        return arrived

    def _refuse_second(self, now_s: float) -> None:
        if self._second is None:
            self._second, self._second_since_s = self._accept(), now_s
        elif now_s - self._second_since_s >= SECOND_WAITS_S:
            self._second.close()
            self._second = None

    def _connect(self, now_s: float) -> socket.socket | None:
        second, self._second = self._second, None
        return second or self._accept()

    def _accept(self) -> socket.socket | None:
        try:
            return self._prepare(self._listener.accept()[0])
        except BlockingIOError:
            return None

    def close(self) -> None:
        """As `Wire.close`."""
        super().close()
        if self._second is not None:
            self._second.close()
        self._listener.close()


def open_wire(where: str) -> Wire:
    """A wire from its description: `tcp:HOST:PORT`, `tcpin:PORT` or `pty`."""
    kind, _, rest = where.partition(":")
    if where == "pty":
        return PtyWire()
    if kind == "tcpin":
        return TcpServerWire(_port(rest.rpartition(":")[2], where, lowest=0))
    host, _, port = rest.rpartition(":")
    if kind == "tcp" and host:
        return TcpClientWire(host, _port(port, where))
    raise EchowingError(f"no such port {where!r}: write tcp:HOST:PORT, tcpin:PORT or pty")


def open_udp(where: str) -> socket.socket:
    """A socket for datagrams to this machine, from `udp:PORT` or `udp:HOST:PORT`."""
    kind, _, rest = where.partition(":")
    if kind != "udp":
        raise EchowingError(f"no such source {where!r}: write udp:PORT")
    host, _, port = rest.rpartition(":")
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.bind((host or "127.0.0.1", _port(port, where, lowest=0)))
    except OSError as error:
        raise EchowingError(f"cannot listen on {where}: {error.strerror}") from error
    receiver.setblocking(False)
    return receiver


def _port(text: str, where: str, lowest: int = 1) -> int:
    if not text.isdigit() or not lowest <= int(text) <= 65535:
        raise EchowingError(f"{where!r}: the port has to be a number from {lowest} to 65535")
    return int(text)
