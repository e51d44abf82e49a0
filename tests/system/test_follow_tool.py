"""`echowing follow` against `echowing sim --serve`: real processes over loopback, in real time.

Nothing here waits a fixed time for something to have happened: every wait is for a condition,
with a deadline that a loaded machine can keep.
"""

import csv
import json
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.vehicle_log import read_vehicles
from echowing.cli import main
from echowing.geo import displace
from echowing.links import Link, parse_address
from echowing.sim.autopilot import ORIGIN

DEADLINE_S = 25.0
LEADER, FOLLOWER, SECOND = 1, 2, 3
PILOT_PORT = 2  # above a vehicle's telemetry port
GROUND_STATION_ID = 255

# A slow leader, so that a follower finds its slot within seconds.
WORLD = [
    *("echowing", "--set", "leader.speed_mps=0.5", "--set", "gps.sigma_m=0.2"),
    *("--set", "formation.slots=[{radius_m=3.0},{radius_m=6.0, angle_deg=40.0}]"),
]


class Process:
    """A verb in a process of its own; its output is read as it comes."""

    def __init__(self, *arguments: str, under: Sequence[str] = ()) -> None:
        self._process = subprocess.Popen(
            [*under, sys.executable, "-m", "echowing", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
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

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; returns the exit code."""
        self._process.send_signal(number)
        code = self._process.wait(DEADLINE_S)
        self._reader.join(DEADLINE_S)
        return code

    def exit_code(self) -> int:
        """Wait for it to end by itself."""
        code = self._process.wait(DEADLINE_S)
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
        self.until(lambda m: _mode_of(m) == mode, change)

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


def _mode_of(message: Any) -> int | None:
    autopilot = message.get_srcComponent() == 1
    return message.custom_mode if message.get_type() == "HEARTBEAT" and autopilot else None


def _speed_mps(message: Any) -> float:
    if message.get_type() != "GLOBAL_POSITION_INT":
        return float("inf")
    return float((message.vx**2 + message.vy**2) ** 0.5 / 100.0)


class Bridge:
    """A vehicle's TCP endpoint on another port, which the test may cut."""

    def __init__(self, port: int) -> None:
        self._port = port
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
        ways = ((tool, vehicle), (vehicle, tool))
        for one, _ in ways:
            one.settimeout(0.02)
        while not self.cut.is_set() and not self._done.is_set():
            for source, sink in ways:
                try:
                    data = source.recv(4096)
                except TimeoutError:
                    continue
                except OSError:
                    return
                if not data:
                    return
                sink.sendall(data)

    def close(self) -> None:
        """Take it away."""
        self._done.set()
        self._thread.join(DEADLINE_S)
        self._listener.close()


class World:
    """The served vehicles, their ports and pilots."""

    def __init__(self, *more: str) -> None:
        self.port = _free_ports()
        self.process = Process("sim", *WORLD, "--serve", str(self.port), *more)
        self.process.wait_for(lambda line: f"system {SECOND}" in line)
        self.pilot = Pilot(self.port + 10, FOLLOWER)

    def link(self, system_id: int) -> str:
        """The connection string of a vehicle, with its id so that nobody has to look for it."""
        return f"tcp:127.0.0.1:{self.port + 10 * (system_id - 1)}@{system_id}"

    def follow(self, *more: str, leader: str | None = None, under: Sequence[str] = ()) -> Process:
        """The tool, engaged, with the first follower."""
        ends = ("--leader", leader or self.link(LEADER), "--follower", self.link(FOLLOWER))
        return Process("follow", *ends, "--engage", "--json", *more, under=under)


def _free_ports() -> int:
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


@pytest.fixture(scope="module")
def served() -> Iterator[World]:
    world = World()
    yield world
    world.pilot.close()
    assert world.process.end() == 0
    assert world.process.lines[-1] == "stopped"


@pytest.fixture
def world(served: World) -> World:
    served.pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    return served


def is_followed(row: dict[str, Any]) -> bool:
    return bool(row["state"] == "following")


def in_slot(row: dict[str, Any]) -> bool:
    return row["state"] == "following" and row["error_m"] is not None and abs(row["error_m"]) < 1.0


def test_two_followers_fly_a_formation_file(world: World, tmp_path: Path) -> None:
    formation = tmp_path / "two.toml"
    formation.write_text(
        "[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 6.0\nangle_deg = 40.0\n",
        encoding="utf-8",
    )
    tool = world.follow("--follower", world.link(SECOND), "--formation", str(formation))
    tool.row(lambda row: row["system_id"] == FOLLOWER and in_slot(row))
    tool.row(lambda row: row["system_id"] == SECOND and in_slot(row))
    assert tool.end(signal.SIGINT) == 0
    assert sum("stopped and stands" in line for line in tool.lines) == 2


def test_an_engagement_the_pilot_and_the_end(world: World, tmp_path: Path) -> None:
    tool = world.follow("--log", str(tmp_path))
    there = tool.row(in_slot)

    world.pilot.set_mode(mavlink.COPTER_MODE_LOITER)
    left = tool.event("left Guided for LOITER, hands off", there)
    # Two rows a second apart: nobody forces it back.
    once = tool.row(lambda row: row["state"] == "hands off" and row["mode"] == "LOITER", left)
    tool.row(lambda row: row["state"] == "hands off" and row["mode"] == "LOITER", once + 1)
    world.pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    again = tool.event("in Guided, following", left)
    tool.row(is_followed, again)

    assert tool.end(signal.SIGTERM) == 0
    assert "stopped and stands, GUIDED" in tool.lines[-1]
    world.pilot.until_still()
    (tlog,) = tmp_path.glob("*.tlog")
    assert {vehicle.system_id for vehicle in read_vehicles(tlog)} == {LEADER, FOLLOWER}
    (table,) = tmp_path.glob("*.csv")
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    # 10 Hz, whole to the end: the last row is of the stop.
    assert rows[-1]["state"].startswith("holding: the tool ends")
    seconds = float(rows[-1]["time_s"]) - float(rows[0]["time_s"])
    assert len(rows) > 5.0 * seconds


def test_a_relay_flies_midway_to_the_remote_vehicle(world: World) -> None:
    # 16 m south of where the leader started, so the middle is more than 8 m behind it.
    ground = displace(ORIGIN, (-16.0, 0.0, 0.0))
    ends = ("--remote", world.link(LEADER), "--vehicle", world.link(FOLLOWER))
    tool = Process(
        *("relay", *ends, "--ground", f"{ground.lat_deg:.7f},{ground.lon_deg:.7f}"),
        *("--altitude", "10", "--min-separation", "1.5", "--engage", "--json"),
    )
    tool.row(lambda row: is_followed(row) and row["slot_error_m"] < 1.0 and row["separation_m"] > 7)
    tool.kill()


def test_a_lost_leader_stops_the_follower_until_it_is_heard_again(world: World) -> None:
    bridge = Bridge(world.port)
    tool = world.follow(leader=f"tcp:127.0.0.1:{bridge.port}@1")
    there = tool.row(is_followed)

    bridge.cut.set()
    lost = tool.event("closed by the other end", there)
    tool.event("leader is stale, holding", there)
    tool.event("follower 2: stands", lost)
    world.pilot.until_still()
    bridge.cut.clear()
    tool.event("leader heard again, following", lost)

    tool.kill()
    bridge.close()


def test_a_killed_tool_leaves_the_follower_to_the_applets_watchdog(world: World) -> None:
    tool = world.follow()
    tool.row(is_followed)

    tool.kill()

    ping = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    world.pilot.until(lambda m: "stream lost, holding" in getattr(m, "text", ""), ping)
    world.pilot.until_still()


def test_points_that_the_autopilot_refuses_stop_the_follower(world: World) -> None:
    tool = world.follow()
    tool.row(is_followed)
    # A fence of 1 m round its home: every point ahead is outside.
    world.pilot.set_parameter("FENCE_RADIUS", 1.0)
    world.pilot.set_parameter("FENCE_ENABLE", 1.0)
    try:
        tool.event("did not take the points")
        tool.event("its points are refused, holding")
    finally:
        world.pilot.set_parameter("FENCE_ENABLE", 0.0)
    tool.kill()


def test_a_full_disk_is_said_and_flying_goes_on(world: World, tmp_path: Path) -> None:
    tool = world.follow("--log", str(tmp_path), under=FULL_DISK)
    full = tool.event("cannot be written")
    tool.row(is_followed, full)
    tool.kill()


def test_in_two_halves_the_leader_is_published_and_cannot_be_moved(world: World) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    publisher = Process(
        *("leader", "--vehicle", world.link(LEADER), "--publish", f"udp:127.0.0.1:{port}")
    )
    publisher.wait_for(lambda line: "published to" in line)
    tool = Process(
        *("follow", "--leader-from", f"udp:127.0.0.1:{port}", "--follower", world.link(FOLLOWER)),
        *("--engage", "--json"),
    )
    # The age is measured through both halves: under half a second on one machine.
    tool.row(lambda row: in_slot(row) and row["leader_age_s"] < 0.5)
    tool.kill()

    kinds = _answers_to_a_stranger(port)
    assert "TIMESYNC" in kinds  # what was asked came through, so a command would have
    assert mavlink.COPTER_MODE_LAND not in kinds
    assert publisher.end(signal.SIGINT) == 0
    assert publisher.lines[-1].endswith("ended")


def _answers_to_a_stranger(port: int) -> list[Any]:
    """Tell the publisher to land the leader; kinds of messages, and modes, until it answers."""
    stranger = mavlink.MAVLink(None, srcSystem=GROUND_STATION_ID, srcComponent=190)
    land = mavlink.MAVLink_command_long_message(
        LEADER, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, mavlink.COPTER_MODE_LAND, *(0.0,) * 5
    )
    ask = mavlink.MAVLink_timesync_message(0, 4711)
    heard: list[Any] = []
    answered_at: int | None = None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as follow:
        follow.bind(("127.0.0.1", port))
        follow.settimeout(DEADLINE_S)
        _, publisher = follow.recvfrom(1000)
        for message in (land, ask):
            follow.sendto(bytes(message.pack(stranger)), publisher)
        while answered_at is None or "HEARTBEAT" not in heard[answered_at:]:
            message = mavlink.MAVLink(None).decode(bytearray(follow.recv(1000)))
            heard += [message.get_type(), _mode_of(message)]
            if message.get_type() == "TIMESYNC" and message.ts1 == 4711:
                answered_at = len(heard)
    return heard


def test_garbage_and_strangers_on_the_leaders_link_do_no_harm(world: World) -> None:
    bridge = DatagramBridge(world.port)
    tool = world.follow(leader=f"udpin:{bridge.tool_port}@1")
    there = tool.row(in_slot)
    rows = [json.loads(line) for line in tool.lines[: there + 1]]
    assert bridge.garbage > 50
    assert not any("jumps" in row.get("event", "") for row in rows)
    assert tool.end() == 0
    bridge.close()


class DatagramBridge:
    """The leader over UDP; before each datagram comes rubbish, and a stranger's position."""

    def __init__(self, port: int) -> None:
        self._vehicle = socket.create_connection(("127.0.0.1", port))
        self._vehicle.settimeout(0.05)
        self._tool = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._tool.setblocking(False)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.tool_port = int(probe.getsockname()[1])
        self.garbage = 0
        self._random = random.Random(5)
        self._stranger = mavlink.MAVLink(None, srcSystem=77, srcComponent=1)
        # The leader's own id, but another component of it, says that it is at the equator.
        self._camera = mavlink.MAVLink(None, srcSystem=LEADER, srcComponent=100)
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.is_set():
            try:
                data = self._vehicle.recv(4096)
                self._disturb()
                self._send(data)
            except TimeoutError:
                pass
            try:
                self._vehicle.sendall(self._tool.recv(4096))
            except OSError:
                continue

    def _disturb(self) -> None:
        elsewhere = mavlink.MAVLink_global_position_int_message(2**31, *(0,) * 8)
        self._send(bytes(elsewhere.pack(self._stranger)))
        self._send(bytes(elsewhere.pack(self._camera)))
        # A frame's beginning, of which the rest never comes, and plain noise.
        for _ in range(5):
            self._send(b"\xfd\xff\x00" + self._random.randbytes(20))
            self._send(self._random.randbytes(200))
            self.garbage += 2

    def _send(self, data: bytes) -> None:
        try:
            self._tool.sendto(data, ("127.0.0.1", self.tool_port))
        except OSError:
            return

    def close(self) -> None:
        """Take it away."""
        self._done.set()
        self._thread.join(DEADLINE_S)
        self._vehicle.close()
        self._tool.close()


def test_signed_links_carry_points_and_refuse_another_key(tmp_path: Path) -> None:
    key, other = tmp_path / "key", tmp_path / "other"
    for path, phrase in ((key, "a phrase of the field"), (other, "another phrase")):
        path.write_text(phrase, encoding="utf-8")
        path.chmod(0o600)
    world = World("--signing-key-file", str(key))
    stranger = world.follow("--signing-key-file", str(other))
    stranger.event("not signed with the key")
    stranger.kill()
    tool = world.follow("--signing-key-file", str(key))
    tool.row(in_slot)
    assert tool.end() == 0
    assert "stopped and stands, GUIDED" in tool.lines[-1]
    world.pilot.close()
    assert world.process.end() == 0


def test_without_engage_it_only_watches(world: World) -> None:
    tool = Process(
        *("follow", "--leader", world.link(LEADER), "--follower", world.link(FOLLOWER), "--json")
    )
    tool.row(lambda row: row["state"] == "only watched" and row["separation_m"] is not None)
    assert tool.end(signal.SIGINT) == 0
    assert "was not moved" in tool.lines[-1]


ENDS = ["follow", "--leader", "udpin:14550", "--follower", "udpin:14560"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--stop-switch", "5:1200:STABILIZE"], "STABILIZE is refused"),
        (["--stop-switch", "19:1200"], "channel is a number from 1 to 18"),
        (["--stop-switch", "5:90"], "801 to 2199"),
        (["--stop-switch", "5:1200:ACRO"], "one of LOITER, BRAKE, LAND, RTL"),
        (["--rate", "50"], "--rate 50: give 1 to 20"),
        (["--radius", "0.5"], "smallest is 1 m"),
        (["--angle", "120"], "ahead of the leader"),
        (["--radius", "1.2"], "inside --min-separation"),
        (["--follower", "udpin:14570"], "2 followers need --formation"),
        (["--formation", "/nowhere.toml"], "cannot be read"),
        (["--follower", "udpin:14560"], "say which is which"),
        (["--follower", "nonsense"], "no such kind"),
        (["--follower", "tcp:5760"], "which host"),
        (["--follower", "udpin:14570@300"], "system id from 1 to 255"),
    ],
)
def test_what_cannot_be_flown_is_refused(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*ENDS, *options]) == 2
    assert said in capsys.readouterr().err


def test_a_formation_file_of_another_size_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formation = tmp_path / "two.toml"
    formation.write_text("[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 6.0\n", encoding="utf-8")
    assert main([*ENDS, "--formation", str(formation)]) == 2
    assert "2 slots for 1 followers" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--publish", "tcp:127.0.0.1:5760"], "write udp:HOST:PORT"),
        (["--publish", "udp:5760"], "which host"),
        (["--publish", "udp:127.0.0.1:5760", "--rate", "0"], "give 1 to 20"),
    ],
)
def test_a_leader_that_cannot_be_published_is_refused(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["leader", "--vehicle", "udpin:14550", *options]) == 2
    assert said in capsys.readouterr().err


def test_a_taken_port_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        where = f"udpin:{port}"
        assert main(["follow", "--leader", where, "--follower", "udpin:14560"]) == 2
    assert "the port is taken" in capsys.readouterr().err
