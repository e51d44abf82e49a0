import math

import pytest

from echowing.flight.alignment import (
    LONGEST_GAP_S,
    LONGEST_WAIT_S,
    Alignment,
    History,
    Report,
)
from echowing.flight.guidance import Horizontal
from echowing.geo import GRAVITY_MPS2, GlobalPosition, displace

START = GlobalPosition(39.34, -86.03, 260.0)


def report(
    time_s: float,
    place_m: Horizontal = (0.0, 0.0),
    velocity_mps: Horizontal = (0.0, 0.0),
    heading_rad: float = 0.0,
) -> Report:
    return Report(time_s, displace(START, (*place_m, 0.0)), velocity_mps, heading_rad)


def standing(*times_s: float) -> History:
    history = History()
    for time_s in times_s:
        history.add(report(time_s))
    return history


def moving(
    times_s: list[float], velocity_mps: Horizontal, acceleration_mps2: Horizontal, start_m: float
) -> History:
    """Reports of a vehicle that is accelerated steadily, from `start_m` north of START."""
    history = History()
    for time_s in times_s:
        (vn, ve), (an, ae) = velocity_mps, acceleration_mps2
        north = start_m + vn * time_s + 0.5 * an * time_s**2
        east = ve * time_s + 0.5 * ae * time_s**2
        history.add(report(time_s, (north, east), (vn + an * time_s, ve + ae * time_s)))
    return history


def test_a_reading_waits_until_both_have_reported_from_after_it() -> None:
    waiting = Alignment()
    waiting.add(0.6, 3.0)

    assert waiting.due(standing(0.0, 0.5), standing(0.0, 0.5, 1.0)) == []
    assert waiting.due(standing(0.0, 0.5, 1.0), standing(0.0, 0.5)) == []
    (reading,) = waiting.due(standing(0.0, 0.5, 1.0), standing(0.0, 0.5, 1.0))
    assert (reading.time_s, reading.distance_m) == (0.6, 3.0)


def test_each_reading_is_given_once_and_in_its_order() -> None:
    waiting = Alignment()
    for time_s in (0.2, 0.4, 0.8):
        waiting.add(time_s, None)
    reports = standing(0.0, 0.5)

    assert [one.time_s for one in waiting.due(reports, reports)] == [0.2, 0.4]
    assert waiting.due(reports, reports) == []
    reports.add(report(1.0))
    assert [one.time_s for one in waiting.due(reports, reports)] == [0.8]


@pytest.mark.parametrize("at_s", [0.05, 0.31, 0.5, 0.74])
def test_steady_acceleration_is_interpolated_exactly(at_s: float) -> None:
    """The leader 4 Hz, the follower 10 Hz, neither reports at the moment of the reading."""
    leader = moving([0.0, 0.25, 0.5, 0.75, 1.0], (2.0, 0.5), (-2.5, 1.0), 3.0)
    follower = moving([n / 10.0 for n in range(11)], (1.0, -0.3), (0.8, 2.0), 0.0)
    waiting = Alignment()
    waiting.add(at_s, 2.9)

    (reading,) = waiting.due(leader, follower)

    north = 3.0 + (2.0 - 1.0) * at_s + 0.5 * (-2.5 - 0.8) * at_s**2
    east = (0.5 + 0.3) * at_s + 0.5 * (1.0 - 2.0) * at_s**2
    assert reading.believed_m == pytest.approx((north, east), abs=1e-3)


def test_a_leader_that_climbs_is_above_by_what_it_had_climbed_then() -> None:
    leader = History()
    for time_s in (0.0, 1.0):
        leader.add(Report(time_s, displace(START, (3.0, 0.0, -2.0 - time_s)), (0.0, 0.0), 0.0))
    waiting = Alignment()
    waiting.add(0.25, None)

    (reading,) = waiting.due(leader, standing(0.0, 1.0))

    assert reading.above_m == pytest.approx(2.25)


def test_a_report_that_comes_late_is_left_out() -> None:
    history = standing(0.0, 0.5)
    history.add(report(0.25, (50.0, 0.0)))
    history.add(report(0.5, (50.0, 0.0)))

    waiting = Alignment()
    waiting.add(0.3, 3.0)
    (reading,) = waiting.due(history, standing(0.0, 0.5))
    assert reading.believed_m == pytest.approx((0.0, 0.0))
    assert history.newest_s == 0.5


@pytest.mark.parametrize(("gap_s", "known"), [(LONGEST_GAP_S, 1), (LONGEST_GAP_S + 0.1, 0)])
def test_over_lost_reports_nothing_is_interpolated(gap_s: float, known: int) -> None:
    waiting = Alignment()
    waiting.add(0.7, 3.0)
    after = standing(0.0, 0.5, 1.0, 2.0)

    assert len(waiting.due(standing(0.0, gap_s), after)) == known
    assert waiting.due(standing(0.0, 0.5, 1.0, 2.0), after) == []  # and it is not kept


def test_a_reading_from_before_all_reports_is_dropped() -> None:
    waiting = Alignment()
    waiting.add(0.5, 3.0)

    assert waiting.due(standing(1.0, 2.0), standing(0.0, 1.0, 2.0)) == []


def test_readings_that_nobody_overtakes_are_dropped() -> None:
    waiting = Alignment()
    silent, told = History(), standing(0.0)
    for number in range(400):
        waiting.add(number / 10.0, 3.0)
        assert waiting.due(silent, told) == []

    reports = standing(*(n / 2.0 for n in range(70, 81)))  # 35 s to 40 s: History keeps 3 s
    times = [one.time_s for one in waiting.due(reports, reports)]
    assert times[0] == pytest.approx(39.9 - LONGEST_WAIT_S, abs=0.11)
    assert times[-1] == 39.9


def test_a_vehicle_whose_clock_began_anew_is_unknown_until_it_reports_again() -> None:
    history = standing(100.0, 100.5)
    history.clear()

    assert history.newest_s == -math.inf
    history.add(report(0.5))
    assert history.newest_s == 0.5


def test_the_nose_turns_the_short_way_through_south() -> None:
    waiting, leader, follower = Alignment(), standing(0.0, 1.0), History()
    follower.add(report(0.0, heading_rad=math.radians(170.0)))
    follower.add(report(1.0, heading_rad=math.radians(-150.0)))
    waiting.add(0.25, 3.0)

    (reading,) = waiting.due(leader, follower)

    assert abs(reading.axis.azimuth_rad) == pytest.approx(math.pi, abs=1e-6)


def test_a_copter_leans_as_its_velocity_changes() -> None:
    waiting, leader, follower = Alignment(), standing(0.0, 1.0), History()
    follower.add(report(0.0, velocity_mps=(2.0, 0.0)))
    follower.add(report(0.5, velocity_mps=(1.0, 0.0)))
    waiting.add(0.25, 3.0)

    (reading,) = waiting.due(leader, follower)

    assert reading.lean_rad == pytest.approx(math.atan(2.0 / GRAVITY_MPS2))
