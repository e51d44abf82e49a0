"""`echowing follow` over links as the field has them: lost, late, doubled, shared and noisy."""

import csv
import random
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from .field import (
    FOLLOWER,
    LEADER,
    SECOND,
    Air,
    World,
    changed,
    in_slot,
    is_followed,
    unspoilt,
)

pytestmark = pytest.mark.seconds(60)
Fly = Callable[..., Air]


@pytest.fixture
def air_of(world: World) -> Iterator[Fly]:
    """Puts vehicles on the air; takes them off it at the end."""
    opened: list[Air] = []

    def put(*system_ids: int, spoil: Any = unspoilt) -> Air:
        opened.append(Air([world.port_of(number) for number in system_ids], spoil))
        return opened[-1]

    yield put
    for air in opened:
        air.close()


def test_a_follower_out_of_radio_range_is_left_to_its_applet(world: World, air_of: Fly) -> None:
    air = air_of(FOLLOWER)
    tool = world.follow(follower=f"{air.tool}@{FOLLOWER}")
    # Rows come once a second: a second of points is a stream to the applet, one point is none.
    there = tool.row(is_followed, tool.row(is_followed) + 1)

    air.cut.set()
    lost = tool.event("follower 2: no report for 2 s, no points sent", there)
    ping = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    world.pilot.until(lambda m: "stream lost, holding" in getattr(m, "text", ""), ping)
    world.pilot.until_still()
    tool.row(lambda row: row["state"] == "no points sent", lost)

    air.cut.clear()
    again = tool.event("follower 2: reports again", lost)
    tool.row(is_followed, again)
    tool.kill()


class Reboot:
    """The leader's clock as after so long a time in the air; after `again`, from 0 once more."""

    UP_MS = 3_600_000

    def __init__(self) -> None:
        self.again_ms: int | None = None
        self._newest_ms = 0

    def boot_again(self) -> None:
        """From now on time begins at 0."""
        self.again_ms = self._newest_ms

    def spoil(self, message: Any) -> Iterable[tuple[float, bytes]]:
        """Change what carries the leader's time."""
        shift_ms = self.UP_MS if self.again_ms is None else -self.again_ms
        if message.get_type() == "GLOBAL_POSITION_INT":
            self._newest_ms = message.time_boot_ms
            return [(0.0, changed(message, time_boot_ms=max(0, message.time_boot_ms + shift_ms)))]
        if message.get_type() == "TIMESYNC" and message.tc1:
            return [(0.0, changed(message, tc1=max(1, message.tc1 + shift_ms * 1_000_000)))]
        return unspoilt(message)


def test_a_leader_that_boots_again_in_flight_is_followed_again(world: World, air_of: Fly) -> None:
    reboot = Reboot()
    air = air_of(LEADER, spoil=reboot.spoil)
    tool = world.follow(leader=f"{air.tool}@{LEADER}")
    # Its age is known, not the time of reception: its clock has been asked.
    there = tool.row(lambda row: in_slot(row) and row["leader_age_s"] < 0.5)

    air.cut.set()
    lost = tool.event("leader is stale, holding", there)
    reboot.boot_again()
    air.cut.clear()

    again = tool.event("clear again, following", lost)
    tool.row(lambda row: in_slot(row) and row["leader_age_s"] < 0.5, again)
    assert not any("jumps" in line for line in tool.lines)
    assert tool.end() == 0


def doubled_and_late(seed: int) -> Callable[[Any], Iterable[tuple[float, bytes]]]:
    """Every message twice, each up to 0.6 s late: mostly out of order."""
    chance = random.Random(seed)

    def spoil(message: Any) -> Iterable[tuple[float, bytes]]:
        frame = bytes(message.get_msgbuf())
        return [(chance.uniform(0.0, 0.6), frame) for _ in range(2)]

    return spoil


def test_doubled_and_reordered_telemetry_never_goes_back_in_time(
    world: World, air_of: Fly, tmp_path: Path
) -> None:
    air = air_of(LEADER, FOLLOWER, spoil=doubled_and_late(5))
    tool = world.follow(
        *("--log", str(tmp_path)),
        leader=f"{air.tool}@{LEADER}",
        follower=f"{air.tool}@{FOLLOWER}",
    )
    there = tool.row(in_slot)
    tool.row(in_slot, tool.row(in_slot, there + 1) + 1)
    assert tool.end() == 0
    assert not any("jumps" in line for line in tool.lines)
    assert ": stopped, GUIDED" in tool.lines[-1]

    (table,) = tmp_path.glob("*.csv")
    rows = [row for row in csv.DictReader(table.open(encoding="utf-8")) if row["leader_age_s"]]
    stamps = [float(row["time_s"]) - float(row["leader_age_s"]) for row in rows]
    assert len({round(stamp, 2) for stamp in stamps}) > 8  # it went on
    # Of the leader's reports only ever a newer one is used. 2 ms: both columns are rounded.
    assert all(later > earlier - 0.002 for earlier, later in pairwise(stamps))


def test_vehicles_share_a_link_and_a_stranger_on_it_is_left_alone(
    world: World, air_of: Fly
) -> None:
    air = air_of(LEADER, FOLLOWER, SECOND)
    unnamed = world.follow(leader=air.tool, follower=world.link(FOLLOWER))
    assert unnamed.exit_code() == 2
    assert f"systems {LEADER}, {SECOND} are on it" in unnamed.lines[-1]
    assert f"{air.tool}@{LEADER}" in unnamed.lines[-1]

    air.heard.clear()
    tool = world.follow(leader=f"{air.tool}@{LEADER}", follower=f"{air.tool}@{FOLLOWER}")
    tool.row(in_slot)
    assert tool.end() == 0
    points = [one for one in air.heard if one.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]
    assert {point.target_system for point in points} == {FOLLOWER}
    addressed = {getattr(one, "target_system", 0) for one in air.heard}
    assert addressed - {0} == {LEADER, FOLLOWER}
    assert not any(f"system {SECOND}" in line for line in tool.lines)


def noisy(seed: int) -> Callable[[Any], Iterable[tuple[float, bytes]]]:
    """Between the messages noise; of every third message a bit is wrong, or its end is missing."""
    chance = random.Random(seed)

    def spoil(message: Any) -> Iterable[tuple[float, bytes]]:
        frame = bytearray(message.get_msgbuf())
        if chance.random() < 0.33:
            frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)
        elif chance.random() < 0.1:
            del frame[chance.randrange(1, len(frame)) :]
        noise = chance.randbytes(chance.randrange(1, 400))
        return [(0.0, b"\xfd" + noise), (0.0, bytes(frame)), (0.0, noise + bytes(frame[:9]))]

    return spoil


def test_a_link_full_of_noise_still_flies_and_shows_its_quality(world: World, air_of: Fly) -> None:
    air = air_of(LEADER, FOLLOWER, spoil=noisy(7))
    tool = world.follow(leader=f"{air.tool}@{LEADER}", follower=f"{air.tool}@{FOLLOWER}")
    tool.row(in_slot)
    quality = tool.row(lambda row: row["link_percent"] is not None)
    # Of ten messages about six arrive whole.
    assert '"link_percent": 9' not in tool.lines[quality]
    assert '"link_percent": 100' not in tool.lines[quality]
    assert not any("jumps" in line for line in tool.lines)
    assert tool.end() == 0
