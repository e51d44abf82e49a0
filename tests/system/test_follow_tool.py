"""`echowing follow` against `echowing sim --serve`: real processes over loopback, in real time."""

import csv
import json
import random
import signal
import socket
import threading
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.vehicle_log import read_vehicles
from echowing.cli import main
from echowing.geo import displace
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.tool.again import received

from .field import (
    DEADLINE_S,
    FOLLOWER,
    FULL_DISK,
    GROUND_STATION_ID,
    LEADER,
    SECOND,
    Bridge,
    Process,
    World,
    in_slot,
    is_followed,
    mode_of,
)

pytestmark = pytest.mark.seconds(150)


def test_two_followers_fly_a_formation_file(world: World, tmp_path: Path) -> None:
    formation = tmp_path / "two.toml"
    formation.write_text(
        "[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 6.0\nangle_deg = 60.0\n",
        encoding="utf-8",
    )
    tool = world.follow("--follower", world.link(SECOND), "--formation", str(formation))
    tool.row(lambda row: row["system_id"] == FOLLOWER and in_slot(row))
    tool.row(lambda row: row["system_id"] == SECOND and in_slot(row))
    assert tool.end(signal.SIGINT) == 0
    assert sum(": stopped, GUIDED" in line for line in tool.lines) == 2


def test_an_engagement_the_pilot_and_the_end(world: World, tmp_path: Path) -> None:
    tool = world.follow("--log", str(tmp_path))
    there = tool.row(in_slot)

    world.pilot.set_mode(mavlink.COPTER_MODE_LOITER)
    left = tool.event("left Guided for LOITER, pilot has control", there)
    # Two rows a second apart: nobody forces it back.
    once = tool.row(
        lambda row: row["state"] == "pilot has control" and row["mode"] == "LOITER", left
    )
    tool.row(lambda row: row["state"] == "pilot has control" and row["mode"] == "LOITER", once + 1)
    world.pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    again = tool.event("in Guided, following", left)
    tool.row(is_followed, again)

    assert tool.end(signal.SIGTERM) == 0
    assert ": stopped, GUIDED" in tool.lines[-1]
    world.pilot.until_still()
    (tlog,) = tmp_path.glob("*.tlog")
    assert {vehicle.system_id for vehicle in read_vehicles(tlog)} == {LEADER, FOLLOWER}
    # What the session has not read is not in it. Without where the sonar looked the nose looks for
    # the leader, as of a vehicle without a gimbal.
    assert "GIMBAL_DEVICE_ATTITUDE_STATUS" in {one.get_type() for _, one in received(tlog)}
    (table,) = tmp_path.glob("*.csv")
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    # Whole to the end: the last row is of the stop; and as often as it was shown, at the least.
    assert rows[-1]["state"].startswith("holding: the tool ends")
    times_s = [float(row["time_s"]) for row in rows]
    assert times_s == sorted(set(times_s))
    shown = [line for line in tool.lines if line.startswith("{") and "separation_m" in line]
    assert len(rows) >= len(shown) > 0


def test_a_relay_flies_midway_to_the_remote_vehicle(world: World) -> None:
    # 16 m south of where the leader started, so the middle is more than 8 m behind it.
    ground = displace(ORIGIN, (-16.0, 0.0, 0.0))
    ends = ("--remote", world.link(LEADER), "--vehicle", world.link(FOLLOWER))
    tool = Process(
        *("relay", *ends, "--ground", f"{ground.lat_deg:.7f},{ground.lon_deg:.7f}"),
        *("--altitude", "10", "--min-separation", "1.5", "--engage", "--json", "--no-log"),
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
    tool.event("follower 2: has stopped", lost)
    world.pilot.until_still()
    bridge.cut.clear()
    tool.event("leader reports again, following", lost)

    tool.kill()
    bridge.close()


APPLET_HOLDS = 7  # ECHO_STATE (lua/echowing.md)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def test_a_killed_tool_leaves_the_follower_to_the_applets_watchdog(world: World) -> None:
    tool = world.follow()
    # Rows come once a second: a second of points is a stream to the applet, one point is none.
    tool.row(is_followed, tool.row(is_followed) + 1)

    tool.kill()

    world.pilot.until(lambda m: "stream lost, holding" in getattr(m, "text", ""), HEARTBEAT)
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
    port = _free_udp_port()
    publisher = Process(
        *("leader", "--vehicle", world.link(LEADER), "--publish", f"udp:127.0.0.1:{port}")
    )
    publisher.wait_for(lambda line: "published to" in line)
    tool = Process(
        *("follow", "--leader-from", f"udp:127.0.0.1:{port}", "--follower", world.link(FOLLOWER)),
        *("--engage", "--json", "--no-log"),
    )
    # The age is measured through both halves: under half a second on one machine.
    tool.row(lambda row: in_slot(row) and row["leader_age_s"] < 0.5)
    tool.kill()

    kinds = _answers_to_a_stranger(port)
    assert "TIMESYNC" in kinds  # what was asked came through, so a command would have
    assert mavlink.COPTER_MODE_LAND not in kinds
    assert publisher.end(signal.SIGINT) == 0
    assert publisher.lines[-1].endswith("ended")


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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
            heard += [message.get_type(), mode_of(message)]
            if message.get_type() == "TIMESYNC" and message.ts1 == 4711:
                answered_at = len(heard)
    return heard


def test_garbage_and_strangers_on_the_leaders_link_do_no_harm(world: World) -> None:
    bridge = DatagramBridge(world.port)
    tool = world.follow(leader=f"udpin:127.0.0.1:{bridge.tool_port}@1")
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


def close(world: World) -> None:
    world.pilot.close()
    assert world.process.end() == 0


def test_signed_links_carry_points_and_refuse_another_key(tmp_path: Path) -> None:
    key, other = tmp_path / "key", tmp_path / "other"
    for path, phrase in ((key, "a phrase of the field"), (other, "another phrase")):
        path.write_text(phrase, encoding="utf-8")
        path.chmod(0o600)
    world = World("--signing-key-file", str(key))
    stranger = world.follow("--signing-key-file", str(other))
    stranger.event("not signed with the key")
    stranger.kill()
    port = _free_udp_port()
    publisher = Process(
        *("leader", "--vehicle", world.link(LEADER), "--publish", f"udp:127.0.0.1:{port}"),
        *("--signing-key-file", str(key)),
    )
    publisher.wait_for(lambda line: "published to" in line)
    tool = Process(
        *("follow", "--leader-from", f"udp:127.0.0.1:{port}", "--follower", world.link(FOLLOWER)),
        *("--signing-key-file", str(key), "--engage", "--json"),
    )
    tool.row(lambda row: in_slot(row) and row["leader_age_s"] < 0.5)
    assert tool.end() == 0
    assert ": stopped, GUIDED" in tool.lines[-1]
    assert publisher.end() == 0
    close(world)


def test_points_carry_a_velocity_that_the_applet_holds(world: World) -> None:
    tool = world.follow()
    tool.row(in_slot)
    world.pilot.until(
        lambda m: getattr(m, "name", "") == "ECHO_STATE" and m.value == APPLET_HOLDS, HEARTBEAT
    )
    assert tool.end() == 0
    assert ": stopped, GUIDED" in tool.lines[-1]


def test_points_without_a_velocity_are_for_the_speed_applet(world: World) -> None:
    tool = world.follow("--position-only")
    tool.event("it runs the hold, which needs points with a velocity")
    assert tool.end() == 0

    flies = World("--set", 'law="thesis"')
    tool = flies.follow("--position-only")
    tool.row(in_slot)
    said = flies.pilot.until(lambda m: getattr(m, "name", "") == "ECHO_STATE", HEARTBEAT)
    assert said.value != APPLET_HOLDS
    assert tool.end() == 0
    close(flies)


def is_disarmed(message: Any) -> bool:
    armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    return mode_of(message) is not None and not message.base_mode & armed


# Arms whatever the checks say.
ARM = mavlink.MAVLink_command_long_message(
    FOLLOWER, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 21196, *(0.0,) * 5
)


def test_a_landed_follower_takes_off_once_its_pilot_has_armed_it() -> None:
    world = World("--set", "leader.altitude_m=4")  # landing from higher takes long
    pilot = world.pilot
    pilot.set_mode(mavlink.COPTER_MODE_LAND)
    pilot.until(is_disarmed, HEARTBEAT)
    tool = world.follow("--take-off", "2.5", "--altitude", "4")
    tool.event("waits to take off, until its pilot puts it in Guided")
    pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    tool.event("waits to take off, until its pilot arms it")
    pilot.until(lambda m: mode_of(m) is not None and not is_disarmed(m), ARM)
    up = tool.event("has taken off")
    tool.row(lambda row: is_followed(row) and row["altitude_m"] > 3.5, up)
    assert tool.end() == 0
    close(world)


def test_without_engage_it_only_watches(world: World) -> None:
    tool = Process(
        *("follow", "--leader", world.link(LEADER), "--follower", world.link(FOLLOWER), "--json"),
        "--no-log",
    )
    tool.row(
        lambda row: (
            (row["state"], row["mode"]) == ("only watched", "GUIDED")
            and row["separation_m"] is not None
        )
    )
    assert tool.end(signal.SIGINT) == 0
    assert "was not moved" in tool.lines[-1]


# What is not refused, and should be, ends by itself and listens to nobody.
LEADERS, FOLLOWERS = "udpin:127.0.0.1:14550", "udpin:127.0.0.1:14560"
ENDS = ["follow", "--leader", LEADERS, "--follower", FOLLOWERS, "--duration", "0", "--no-log"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--stop-switch", "5:1200:STABILIZE"], "STABILIZE is refused"),
        (["--stop-switch", "19:1200"], "channel is a number from 1 to 18"),
        (["--stop-switch", "5:90"], "801 to 2199"),
        (["--stop-switch", "5:1200:ACRO"], "one of LOITER, BRAKE, LAND, RTL"),
        (["--rate", "50"], "--rate 50: give 1 to 20"),
        (["--leader-rate", "0"], "--leader-rate 0: give 1 to 20"),
        (["--take-off", "1"], "--take-off 1: give 2 to 100"),
        (["--take-off", "10", "--next-at", "11"], "--next-at 11: give 1 to 9.5"),
        (["--next-at", "5"], "needs --take-off"),
        (["--signing-key-file", "/nowhere"], "No such file"),
        (["--radius", "0.5"], "smallest is 1 m"),
        (["--angle", "120"], "ahead of the leader"),
        (["--radius", "1.0"], "inside --min-separation"),
        (["--follower", "udpin:14570"], "2 followers need --formation"),
        (["--formation", "/nowhere.toml"], "nowhere.toml: cannot be read: No such file"),
        (["--follower", FOLLOWERS], "give the system id of each"),
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


def test_a_time_that_ran_out_before_anybody_was_heard_is_no_success(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ends = ["--leader", "tcp:127.0.0.1:9", "--follower", "tcp:127.0.0.1:10"]
    assert main(["follow", *ends, "--duration", "0.3", "--no-log"]) == 1
    assert "ended before all vehicles had reported" in capsys.readouterr().out


def test_a_formation_file_of_another_size_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formation = tmp_path / "two.toml"
    formation.write_text("[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 8.0\n", encoding="utf-8")
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
        where = f"udpin:127.0.0.1:{port}"
        assert main(["follow", "--leader", where, "--follower", "udpin:14560"]) == 2
    assert "the port is taken" in capsys.readouterr().err
