"""The field on one machine: `echowing` verbs as processes, served vehicles, pilots, bad links.

Nothing here waits a fixed time for something to have happened: every wait is for a condition,
with a deadline that a loaded machine can keep.
"""

import heapq
import json
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.links import Link, parse_address
from echowing.sim.world.cutter import ByteLoss, PacketCutter

# Generous: who keeps up is not waited for, and a busy machine takes its time to start a process.
DEADLINE_S = 120.0
LEADER, FOLLOWER, SECOND = 1, 2, 3
PILOT_PORT = 2  # above a vehicle's telemetry port
GROUND_STATION_ID = 255

# A slow leader, so that a follower finds its slot within seconds.
WORLD = [
    *("echowing", "--set", "leader.speed_mps=0.5", "--set", "gps.sigma_m=0.2"),
    *("--set", "formation.slots=[{radius_m=3.0},{radius_m=6.0, angle_deg=40.0}]"),
    *("--set", "formation.slot_separation_m=4.0"),
]


# The package of this environment.
ECHOWING = (sys.executable, "-m", "echowing")


class Process:
    """A verb in a process of its own; its output is read as it comes.

    program: what takes the verb.
    """

    def __init__(
        self,
        *arguments: str,
        under: Sequence[str] = (),
        stdin: str | None = None,
        program: Sequence[str] = ECHOWING,
    ) -> None:
        self._process = subprocess.Popen(
            [*under, *program, *arguments],
            stdin=subprocess.DEVNULL if stdin is None else subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        if stdin is not None and self._process.stdin is not None:
            self._process.stdin.write(stdin)
            self._process.stdin.close()
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self.lines.append(line.rstrip())
                self._news.notify_all()
        with self._news:
            self._news.notify_all()

    def wait_for(self, told: Callable[[str], bool], since: int = 0) -> int:
        """The number of the first line from `since` on for which `told` is true."""
        until_s = time.monotonic() + DEADLINE_S
        with self._news:
            while True:
                for number, line in enumerate(self.lines[since:], since):
                    if told(line):
                        return number
                left_s = until_s - time.monotonic()
                if left_s <= 0.0 or not self._reader.is_alive():
                    pytest.fail("never told; it said:\n" + "\n".join(self.lines[-40:]))
                self._news.wait(min(left_s, 0.5))

    def event(self, text: str, since: int = 0) -> int:
        """Wait for an event with `text` in it."""
        return self.wait_for(lambda line: text in json.loads(line).get("event", ""), since)

    def row(self, fits: Callable[[dict[str, Any]], bool], since: int = 0) -> int:
        """Wait for a follower's row that fits."""

        def told(line: str) -> bool:
            record = json.loads(line)
            return "state" in record and fits(record)

        return self.wait_for(told, since)

    def send_signal(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; returns the exit code."""
        self.send_signal(number)
        code = self._process.wait(DEADLINE_S)
        self._reader.join(DEADLINE_S)
        return code

    def exit_code(self, deadline_s: float = DEADLINE_S) -> int:
        """Wait for it to end by itself."""
        code = self._process.wait(deadline_s)
        self._reader.join(DEADLINE_S)
        return code

    def kill(self) -> None:
        """As by kill -9."""
        self._process.kill()
        self._process.wait(DEADLINE_S)


# No file of such a process grows beyond 6 blocks (6 KB): as on a disk that fills up.
FULL_DISK = ("sh", "-c", 'ulimit -f 6; exec "$@"', "sh")


class Pilot:
    """A vehicle's pilot at his own ground station."""

    def __init__(self, port: int, system_id: int) -> None:
        self._system_id = system_id
        self._link = Link(parse_address(f"tcp:127.0.0.1:{port + PILOT_PORT}"))
        self._mav = mavlink.MAVLink(None, srcSystem=GROUND_STATION_ID, srcComponent=190)

    def set_mode(self, mode: int) -> None:
        """Change the mode and see that it has changed."""
        command = mavlink.MAV_CMD_DO_SET_MODE
        change = mavlink.MAVLink_command_long_message(
            self._system_id, 1, command, 0, 1, mode, *(0.0,) * 5
        )
        self.until(lambda m: mode_of(m) == mode, change)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter and see it confirmed."""
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        change = mavlink.MAVLink_param_set_message(self._system_id, 1, name.encode(), value, kind)
        self.until(lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == name, change)

    def until_still(self) -> None:
        """Wait until the vehicle moves less than 0.3 m/s over the ground."""
        position = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        ask = mavlink.MAVLink_command_long_message(
            self._system_id, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, position, *(0.0,) * 6
        )
        self.until(lambda m: _speed_mps(m) < 0.3, ask)

    def until(self, fits: Callable[[Any], bool], asking: Any) -> Any:
        """Ask again and again until a message fits."""
        until_s, ask_s = time.monotonic() + DEADLINE_S, 0.0
        while time.monotonic() < until_s:
            now_s = time.monotonic()
            if now_s >= ask_s:
                ask_s = now_s + 0.3
                self._link.send(bytes(asking.pack(self._mav)), now_s)
            for message in self._link.receive(now_s):
                if message.get_srcSystem() == self._system_id and fits(message):
                    return message
            time.sleep(0.02)
        pytest.fail(f"system {self._system_id} never said so")

    def close(self) -> None:
        """Hang up."""
        self._link.close()


def mode_of(message: Any) -> int | None:
    autopilot = message.get_srcComponent() == 1
    return message.custom_mode if message.get_type() == "HEARTBEAT" and autopilot else None


def _speed_mps(message: Any) -> float:
    if message.get_type() != "GLOBAL_POSITION_INT":
        return float("inf")
    return float((message.vx**2 + message.vy**2) ** 0.5 / 100.0)


class Bridge:
    """A vehicle's TCP endpoint on another port, which the test may cut, or let lose bytes."""

    def __init__(self, port: int, loss: ByteLoss | None = None) -> None:
        self._port = port
        self._radios = [PacketCutter(loss or ByteLoss(), random.Random(way)) for way in (1, 2)]
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.1)
        self.port = int(self._listener.getsockname()[1])
        self.cut = threading.Event()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.is_set():
            try:
                tool, _ = self._listener.accept()
            except TimeoutError:
                continue
            if not self.cut.is_set():
                with tool, socket.create_connection(("127.0.0.1", self._port)) as vehicle:
                    self._carry(tool, vehicle)
            tool.close()

    def _carry(self, tool: socket.socket, vehicle: socket.socket) -> None:
        others = {tool: vehicle, vehicle: tool}
        radios = dict(zip((tool, vehicle), self._radios, strict=True))
        while not self.cut.is_set() and not self._done.is_set():
            # Only reading has a deadline: who cannot write at once waits for a busy machine.
            for source in select.select([tool, vehicle], [], [], 0.02)[0]:
                try:
                    data = source.recv(4096)
                except OSError:
                    return
                if not data:
                    return
                others[source].sendall(radios[source].carry(data, time.monotonic()))

    def close(self) -> None:
        """Take it away."""
        self._done.set()
        self._thread.join(DEADLINE_S)
        self._listener.close()


class World:
    """The served vehicles, their ports and pilots."""

    def __init__(self, *more: str) -> None:
        self.port = free_ports()
        self.process = Process("sim", *WORLD, "--serve", str(self.port), *more)
        self.process.wait_for(lambda line: f"system {SECOND}" in line)
        self.pilot = Pilot(self.port + 10, FOLLOWER)
        self._tools: list[Process] = []

    def end_tools(self) -> None:
        """None that a failed test has left behind may fly on in the next."""
        for tool in self._tools:
            tool.kill()
        self._tools.clear()

    def port_of(self, system_id: int) -> int:
        """The TCP port of a vehicle's telemetry."""
        return self.port + 10 * (system_id - 1)

    def link(self, system_id: int) -> str:
        """The connection string of a vehicle, with its id so that nobody has to look for it."""
        return f"tcp:127.0.0.1:{self.port_of(system_id)}@{system_id}"

    def follow(
        self,
        *more: str,
        leader: str | None = None,
        follower: str | None = None,
        under: Sequence[str] = (),
        program: Sequence[str] = ECHOWING,
    ) -> Process:
        """The tool, engaged, with the first follower."""
        leader, follower = leader or self.link(LEADER), follower or self.link(FOLLOWER)
        ends = ("--leader", leader, "--follower", follower)
        log = () if "--log" in more else ("--no-log",)
        arguments = ("follow", *ends, "--engage", "--json", *log, *more)
        tool = Process(*arguments, under=under, program=program)
        self._tools.append(tool)
        return tool


def free_ports() -> int:
    """A port with free ones where the vehicles' will be."""
    for _ in range(100):
        port = random.randrange(20_000, 60_000)
        try:
            for shift in (0, 2, 10, 12, 20, 22):
                socket.create_server(("127.0.0.1", port + shift)).close()
        except OSError:
            continue
        return port
    pytest.fail("no free ports")


def is_followed(row: dict[str, Any]) -> bool:
    """Points go to it, whether its applet holds the distance already or not."""
    return bool(row["state"].startswith("following"))


def in_slot(row: dict[str, Any]) -> bool:
    return is_followed(row) and row["error_m"] is not None and abs(row["error_m"]) < 1.0


Spoil = Callable[[Any], Iterable[tuple[float, bytes]]]
"""What becomes of a message on its way to the tool: each datagram, and how many seconds later."""


def unspoilt(message: Any) -> Iterable[tuple[float, bytes]]:
    """It arrives as it was sent, at once."""
    return [(0.0, bytes(message.get_msgbuf()))]


def changed(message: Any, **fields: float) -> bytes:
    """A vehicle's message with other values in it, whole and undamaged."""
    for name, value in fields.items():
        setattr(message, name, value)
    sender = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
    sender.seq = message.get_seq()
    return bytes(message.pack(sender))


class Air:
    """Served vehicles on one UDP port of the tool, through an air that the test may spoil.

    `tool` is the tool's connection string; `heard` the messages that it has sent; while `cut` is
    set nothing passes either way.
    """

    def __init__(self, ports: Sequence[int], spoil: Spoil = unspoilt) -> None:
        self._spoil = spoil
        self._vehicles = [socket.create_connection(("127.0.0.1", port)) for port in ports]
        self._parsers = {vehicle: _parser() for vehicle in self._vehicles}
        self._tool = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        self.tool = f"udpin:127.0.0.1:{self._to[1]}"
        self.heard: list[Any] = []
        self.cut = threading.Event()
        self._ears = _parser()
        self._late: list[tuple[float, int, bytes]] = []
        self._count = 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.is_set():
            for source in select.select([*self._vehicles, self._tool], [], [], 0.01)[0]:
                if source is self._tool:
                    self._up()
                else:
                    self._down(source)
            self._deliver()

    def _down(self, vehicle: socket.socket) -> None:
        for message in self._parsers[vehicle].parse_buffer(vehicle.recv(65_535)) or ():
            if message.get_msgId() < 0 or self.cut.is_set():
                continue
            for delay_s, datagram in self._spoil(message):
                self._count += 1
                due_s = time.monotonic() + delay_s
                heapq.heappush(self._late, (due_s, self._count, datagram))

    def _deliver(self) -> None:
        while self._late and self._late[0][0] <= time.monotonic():
            self._tool.sendto(heapq.heappop(self._late)[2], self._to)

    def _up(self) -> None:
        try:
            data = self._tool.recv(65_535)
        except ConnectionRefusedError:  # the tool is not there yet, or no more
            return
        if self.cut.is_set():
            return
        self.heard += self._ears.parse_buffer(data) or ()
        for vehicle in self._vehicles:
            vehicle.sendall(data)

    def close(self) -> None:
        """Hang up."""
        self._done.set()
        self._thread.join(DEADLINE_S)
        for end in (*self._vehicles, self._tool):
            end.close()


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser
