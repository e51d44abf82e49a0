"""Simulated vehicles on real sockets in real time, so that real ground tools connect to them.

One thread, no blocking: each turn takes what has arrived, steps the world, and sends what it says.
"""

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Protocol

from echowing.errors import EchowingError
from echowing.sim.boards.wires import Wire, open_wire

STEP_S = 0.02
# This far behind, the machine cannot keep up: the time is let go rather than caught up.
HOPELESS_S = 0.5
_DATAGRAM_BYTES = 65_535


class Endpoint(Protocol):
    """Something with named MAVLink links: an `Autopilot`."""

    def receive(self, link: str, data: bytes) -> None:
        """Bytes off the wire."""

    def transmit(self, link: str) -> bytes:
        """Bytes to go on the wire."""


class UdpWire:
    """Datagrams: `udpin` listens and answers all who have spoken, `udpout` speaks first."""

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peers: list[tuple[str, int]] = []
        self._kind = "udpin" if listen else "udpout"
        if listen:
            self._bind(host, port)
            host, port = self._socket.getsockname()
        else:
            self._peers.append((host, port))
        self.host, self.port = host, port

    def _bind(self, host: str, port: int) -> None:
        try:
            self._socket.bind((host, port))
        except OSError as error:
            raise EchowingError(
                f"cannot listen on udp {host}:{port}: {error.strerror}; take another port"
            ) from error

    def describe(self) -> str:
        """Its address."""
        return f"{self._kind}:{self.host}:{self.port}"

    def exchange(self, data: bytes, now_s: float) -> bytes:
        """As `Wire.exchange`."""
        if data:
            for peer in self._peers:
                with contextlib.suppress(OSError):  # nobody there, or no room: lost, as on a radio
                    self._socket.sendto(data, peer)
        return self._receive()

    def _receive(self) -> bytes:
        arrived = bytearray()
        while True:
            try:
                data, peer = self._socket.recvfrom(_DATAGRAM_BYTES)
            except BlockingIOError:
                return bytes(arrived)
            except OSError:  # a former datagram found nobody
                continue
            if self._kind == "udpin" and peer not in self._peers:
                self._peers.append(peer)
            arrived += data

    def close(self) -> None:
        """As `Wire.close`."""
        self._socket.close()


def open_port(where: str) -> Wire:
    """A wire from a connection string of the vehicle's end.

    `tcpin:PORT`, `tcp:HOST:PORT`, `udpin:[HOST:]PORT`, `udpout:HOST:PORT` or `pty`. Listening is on
    this machine only, unless HOST says otherwise; port 0 takes any free one.
    """
    kind, _, rest = where.partition(":")
    if kind not in ("udpin", "udpout"):
        return open_wire(where)
    host, _, port = rest.rpartition(":")
    lowest = 0 if kind == "udpin" else 1
    if not port.isdigit() or not lowest <= int(port) <= 65535 or (kind == "udpout" and not host):
        raise EchowingError(f"{where!r}: write udpin:PORT, udpin:HOST:PORT or udpout:HOST:PORT")
    return UdpWire(host or "127.0.0.1", int(port), listen=kind == "udpin")


class Server:
    """Steps a world in real time and wires its vehicles' links to sockets.

    `step` is told the simulated time and moves everything to it, the autopilots included. `clock`
    and `sleep` are seconds, monotonic; tests give their own.
    """

    def __init__(
        self,
        step: Callable[[float], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        step_s: float = STEP_S,
    ) -> None:
        self._step = step
        self._clock = clock
        self._sleep = sleep
        self._step_s = step_s
        self._wires: list[tuple[Endpoint, str, Wire]] = []
        self._steps = 0
        self._next_s: float | None = None

    @property
    def t_s(self) -> float:
        """Simulated time."""
        return self._steps * self._step_s

    def connect(self, endpoint: Endpoint, link: str, where: str) -> Wire:
        """Put a link of a vehicle on a wire (see `open_port`); the link has to exist."""
        wire = open_port(where)
        self._wires.append((endpoint, link, wire))
        return wire

    def turn(self) -> float:
        """Step the world if it is time. Returns the seconds until the next step."""
        now_s = self._clock()
        if self._next_s is None or now_s - self._next_s > HOPELESS_S:
            self._next_s = now_s
        if now_s < self._next_s:
            return self._next_s - now_s
        self._next_s += self._step_s
        self._steps += 1
        for endpoint, link, wire in self._wires:
            arrived = wire.exchange(b"", now_s)
            if arrived:
                endpoint.receive(link, arrived)
        self._step(self.t_s)
        for endpoint, link, wire in self._wires:
            leaving = endpoint.transmit(link)
            arrived = wire.exchange(leaving, now_s) if leaving else b""
            if arrived:
                endpoint.receive(link, arrived)
        return max(0.0, self._next_s - self._clock())

    def run(self, stop: Callable[[], bool]) -> None:
        """Go on until `stop` says so."""
        while not stop():
            pause_s = self.turn()
            if pause_s > 0.0:
                self._sleep(pause_s)

    def close(self) -> None:
        """Unplug everything."""
        for _, _, wire in self._wires:
            wire.close()
        self._wires.clear()
