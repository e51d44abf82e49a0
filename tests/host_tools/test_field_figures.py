"""The fleet that `echowing bench --only field` flies, and what is made of its times."""

import json
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.bench import field
from echowing.bench.field import FieldFigure, Flown, fly
from echowing.bench.fleet import HERE, RATES_HZ, STEP_S, Point, make_fleet
from echowing.cli import main
from echowing.flight.guidance import Slot
from echowing.geo import displace
from echowing.mavlink.messages import position_target

TOOL = 245


def received(data: bytes) -> list[Any]:
    return list(mavlink.MAVLink(None).parse_buffer(data) or ())


def test_a_fleet_is_a_leader_and_a_follower_in_each_slot() -> None:
    leader, first, second = make_fleet([Slot(3.0), Slot(6.0, 0.0, 2.0)])
    assert leader.velocity_mps[0] > 0.0
    assert first.at_ned_m == pytest.approx((-3.0, 0.0, -10.0))
    assert second.at_ned_m == pytest.approx((-6.0, 0.0, -12.0))
    assert [point.system_id for point in (leader, first, second)] == [1, 2, 3]


def test_a_follower_flies_to_its_own_points_only() -> None:
    _, mine, other = make_fleet([Slot(3.0), Slot(6.0)])
    there = displace(HERE, (10.0, 5.0, 0.0))
    message = position_target(mine.system_id, there, 12.0, None, 0.0)
    for point in (mine, other):
        assert point.hear(message, 0.0) == b""
        for _ in range(500):
            point.move(STEP_S)
    assert mine.at_ned_m == pytest.approx((10.0, 5.0, -12.0), abs=0.1)
    assert other.at_ned_m == pytest.approx((-6.0, 0.0, -10.0))


def test_a_follower_says_what_a_real_one_does_as_often() -> None:
    point = Point(2, (0.0, 0.0, -10.0), RATES_HZ)
    kinds: list[str] = []
    for step in range(500):  # ten seconds
        for frame in point.says(step * STEP_S):
            (message,) = received(frame)
            kinds.append(message.get_type())
            assert message.get_srcSystem() == 2
    counts = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counts == {
        "HEARTBEAT": 10,
        "GLOBAL_POSITION_INT": 100,
        "POSITION_TARGET_GLOBAL_INT": 40,
        "DISTANCE_SENSOR": 100,
        "NAMED_VALUE_FLOAT": 20 + 20 + 10,
    }


def test_a_follower_answers_for_its_clock_and_its_watchdog() -> None:
    point = Point(2, (0.0, 0.0, -10.0), RATES_HZ)
    (clock,) = received(point.hear(mavlink.MAVLink_timesync_message(0, 4711), 1.5))
    assert (clock.tc1, clock.ts1) == (1_500_000_000, 4711)
    ask = mavlink.MAVLink_param_request_read_message(2, 1, b"ECHO_STREAM_T", -1)
    (parameter,) = received(
        point.hear(received(ask.pack(mavlink.MAVLink(None, TOOL, 190)))[0], 2.0)
    )
    assert (parameter.param_id, parameter.param_value) == ("ECHO_STREAM_T", 3.0)


def test_times_are_a_points_share_of_its_turn_and_the_whole_turn() -> None:
    # Ninety-eight turns of 10 ms for 10 points, and two slow ones of 50 ms.
    flown = Flown([(0.01, 10)] * 98 + [(0.05, 10)] * 2, followers=10, wall_s=10.0, cpu_s=2.5)
    assert flown.point_s(50) == pytest.approx(0.001)
    assert flown.point_s(99) == pytest.approx(0.005, rel=0.05)
    assert flown.turn_s(99) == pytest.approx(0.05, rel=0.05)
    assert flown.rate_hz == pytest.approx(10.0)
    assert flown.share == pytest.approx(0.25)


def test_a_fleet_is_followed_and_every_turn_with_points_is_timed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(field, "SETTLE_S", 0.0)
    flown = fly(3, 10.0, 1.0)
    assert {points for _, points in flown.turns} == {3}
    assert all(spent_s > 0.0 for spent_s, _ in flown.turns)
    assert flown.cpu_s > 0.0
    assert flown.wall_s >= 1.0  # flown for so long, however busy the machine is


def test_a_watched_fleet_is_seen_at_the_rate_of_its_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """One browser reads; another one, that reads nothing, is there all the time."""
    monkeypatch.setattr(field, "SETTLE_S", 0.0)
    flown = fly(2, 10.0, 1.0, watched=True)
    assert {points for _, points in flown.turns} == {2}
    assert 0.0 < flown.frames_hz < 11.0


def test_the_section_prints_figures_with_what_they_mean(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = FieldFigure("telemetry to wire", 0.5, "ms", "under 1")
    monkeypatch.setattr("echowing.bench.field.field_figures", lambda: iter([figure]))
    assert main(["bench", "--only", "field"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "telemetry to wire" in printed
    assert "the wait for a point to be due is not in it" in printed
    assert main(["bench", "--only", "field", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["value"] == 0.5
