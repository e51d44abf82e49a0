"""How `echowing follow` ends: by the pilot's switch, by signals at any moment, by a full disk."""

import csv
import json
import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.logs import read_flights
from echowing.cli import main

from .field import (
    FOLLOWER,
    FULL_DISK,
    LEADER,
    Air,
    Process,
    World,
    changed,
    in_slot,
    is_followed,
    mode_of,
    unspoilt,
)

pytestmark = pytest.mark.seconds(80)
SIGNALS = (signal.SIGINT, signal.SIGTERM)


# ---- the stop switch ----------------------------------------------------------------------------


class Transmitter(Air):
    """The follower's link, with channel 7 of its transmitter in the test's hand."""

    def __init__(self, world: World) -> None:
        self.pulse_us = 1000
        super().__init__([world.port_of(FOLLOWER)], self._with_switch)
        self.link = f"{self.tool}@{FOLLOWER}"

    def _with_switch(self, message: Any) -> Any:
        if message.get_type() == "RC_CHANNELS":
            return [(0.0, changed(message, chan7_raw=self.pulse_us))]
        return unspoilt(message)


@pytest.fixture
def transmitter(world: World) -> Iterator[Transmitter]:
    held = Transmitter(world)
    yield held
    held.close()


def test_the_stop_switch_stops_and_lets_go(world: World, transmitter: Transmitter) -> None:
    tool = world.follow("--stop-switch", "7:1700", follower=transmitter.link)
    there = tool.row(is_followed)

    transmitter.pulse_us = 1800
    stop = tool.event("follower 2: stop switch, holding", there)
    off = tool.event("follower 2: pilot has control, by the stop switch", stop)
    world.pilot.until_still()
    transmitter.pulse_us = 1000
    # It does not begin again by itself: two rows a second apart.
    once = tool.row(lambda row: row["state"] == "no points sent", off)
    again = tool.row(lambda row: row["state"] == "no points sent", once + 1)

    # Only the pilot gives it back, by his mode switch.
    world.pilot.set_mode(mavlink.COPTER_MODE_LOITER)
    away = tool.event("left Guided for LOITER", again)
    for _ in range(3):  # rows are a second apart: two heartbeats, and one to spare
        away = 1 + tool.row(lambda row: row["mode"] == "LOITER", away)
    world.pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    tool.row(is_followed, away)
    tool.kill()


def test_the_stop_switch_may_choose_a_mode(world: World, transmitter: Transmitter) -> None:
    tool = world.follow("--stop-switch", "7:1700:BRAKE", follower=transmitter.link)
    there = tool.row(is_followed)
    transmitter.pulse_us = 1800
    tool.event("follower 2: left Guided for BRAKE, pilot has control", there)
    asking = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    world.pilot.until(lambda m: mode_of(m) == mavlink.COPTER_MODE_BRAKE, asking)
    world.pilot.until_still()
    assert tool.end() == 0
    assert "left to its pilot (BRAKE" in tool.lines[-1]


# ---- Ctrl-C and SIGTERM at any time -------------------------------------------------------------


def at_any_time(chance: random.Random, most_s: float) -> None:
    """A moment that the seed chooses; nothing is waited for here, the moment is what is tested."""
    time.sleep(chance.uniform(0.0, most_s))


def assert_readable(folder: Path) -> None:
    """Every row of the table has all its columns, and the .tlog is frames to its last byte."""
    (table,) = folder.glob("*.csv")
    with table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert all(None not in row and None not in row.values() for row in rows)
    (path,) = folder.glob("*.tlog")
    frames, log = 0, mavutil.mavlogfile(str(path))
    while (message := log.recv_msg()) is not None:
        assert message.get_type() != "BAD_DATA"
        frames += len(message.get_msgbuf()) + 8  # the time stamp
    assert frames == path.stat().st_size


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_signal_before_anybody_is_heard(seed: int, tmp_path: Path) -> None:
    chance = random.Random(seed)
    ends = ("--leader", "tcp:127.0.0.1:9", "--follower", "tcp:127.0.0.1:10")
    tool = Process("follow", *ends, "--engage", "--json", "--log", str(tmp_path))
    tool.event("waiting for leader")
    at_any_time(chance, 1.0)
    assert tool.end(chance.choice(SIGNALS)) == 0
    assert "nothing was moved" in tool.lines[-1]
    assert_readable(tmp_path)


@pytest.mark.parametrize("seed", [3, 5, pytest.param(4, marks=pytest.mark.long)])
def test_a_signal_while_searching_or_just_after(world: World, seed: int, tmp_path: Path) -> None:
    """Without ids it listens for 4 s who is there, so that some moments lie after the search."""
    chance = random.Random(seed)
    tool = world.follow(
        *("--log", str(tmp_path)),
        leader=world.link(LEADER).partition("@")[0],
        follower=world.link(FOLLOWER).partition("@")[0],
    )
    tool.event("MAVLink received")
    at_any_time(chance, 5.5)
    assert tool.end(chance.choice(SIGNALS)) == 0
    last = tool.lines[-1]
    assert any(end in last for end in ("nothing was moved", "was not moved", ": stopped, GUIDED"))
    assert_readable(tmp_path)
    world.pilot.until_still()


@pytest.mark.parametrize("seed", [6, 8, pytest.param(7, marks=pytest.mark.long)])
def test_a_signal_while_following(world: World, seed: int, tmp_path: Path) -> None:
    chance = random.Random(seed)
    tool = world.follow("--log", str(tmp_path))
    tool.row(is_followed)
    at_any_time(chance, 1.5)
    assert tool.end(chance.choice(SIGNALS)) == 0
    assert ": stopped, GUIDED" in tool.lines[-1]
    world.pilot.until_still()
    assert_readable(tmp_path)


@pytest.mark.parametrize("seed", [9, pytest.param(11, marks=pytest.mark.long)])
def test_a_second_signal_while_stopping(world: World, seed: int, tmp_path: Path) -> None:
    chance = random.Random(seed)
    tool = world.follow("--log", str(tmp_path))
    there = tool.row(is_followed)
    tool.send_signal(chance.choice(SIGNALS))
    tool.event("the tool ends, holding", there)
    at_any_time(chance, 1.2)
    code = tool.end(chance.choice(SIGNALS))
    # The stop is sent in any case; whoever does not wait to see it is told so.
    if any("asked twice" in line for line in tool.lines):
        assert "follower 2" in tool.lines[-1]
        assert (code == 1) is ("not confirmed stopped" in tool.lines[-1])
    else:
        assert code == 0
        assert ": stopped, GUIDED" in tool.lines[-1]
    world.pilot.until_still()
    assert_readable(tmp_path)


# ---- the log ------------------------------------------------------------------------------------


def test_what_fits_on_a_full_disk_can_be_read_and_the_end_is_clean(
    world: World, tmp_path: Path
) -> None:
    tool = world.follow("--log", str(tmp_path), under=FULL_DISK)
    full = tool.event("cannot be written")
    tool.row(is_followed, full)
    assert tool.end() == 0
    assert ": stopped, GUIDED" in tool.lines[-1]
    assert not any("Traceback" in line for line in tool.lines)
    assert sum("cannot be written" in line for line in tool.lines) == 1
    (table,) = tmp_path.glob("*.csv")
    with table.open(newline="", encoding="utf-8") as file:
        assert next(csv.reader(file))[:2] == ["unix_time_s", "time_s"]
    (path,) = tmp_path.glob("*.tlog")
    log = mavutil.mavlogfile(str(path))
    assert any(message.get_type() == "HEARTBEAT" for message in iter(log.recv_msg, None))


def test_the_log_of_a_killed_tool_is_analysed_from_its_folder(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tool = world.follow("--log", str(tmp_path))
    there = tool.row(is_followed)
    shown = tool.row(in_slot, tool.row(in_slot, there) + 1)
    tool.row(in_slot, shown + 1)
    tool.kill()

    # What was shown one row before the last is on the disk: rows are not kept back.
    (table,) = tmp_path.glob("*.csv")
    with table.open(newline="", encoding="utf-8") as file:
        last_s = [float(row["time_s"]) for row in csv.DictReader(file)][-1]
    assert last_s >= json.loads(tool.lines[shown])["time_s"]

    assert main(["analyze", str(tmp_path), "--settle", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] > 20
    # In its last second the vehicles' own messages tell the same: at some 0.5 m/s a few tenths of a
    # second, of which the one log may hold more than the other, are a decimetre or two.
    (tlog,) = tmp_path.glob("*.tlog")
    (by_table,), (by_messages,) = read_flights([tmp_path]), read_flights([tlog], leader=LEADER)
    told_m = [flight.separation_m[-10:].mean() for flight in (by_table, by_messages)]
    assert told_m[0] == pytest.approx(told_m[1], abs=0.25)

    assert main(["analyze", str(tmp_path), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").exists()
