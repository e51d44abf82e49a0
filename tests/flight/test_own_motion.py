"""A follower between its report and the order that answers it."""

import math

import pytest

from echowing.flight.closing import Closing
from echowing.flight.own_motion import BEGINS_S, REMEMBERED_S, OwnMotion
from echowing.geo import GlobalPosition, displace

from ..system.flown import flown
from ..world import CLEARLY

HERE = GlobalPosition(39.34, -86.03, 260.0)
CLOSING = Closing(accel_mps2=2.0, jerk_mps3=8.0)


def there(north_m: float, east_m: float = 0.0) -> GlobalPosition:
    return displace(HERE, (north_m, east_m, 0.0))


def test_without_orders_it_flies_on_as_it_reports() -> None:
    moved_m, flown_mps = OwnMotion().carried_on(HERE, (2.0, -1.0), 10.0, 10.8)
    assert moved_m == pytest.approx((1.6, -0.8))
    assert flown_mps == (2.0, -1.0)


def test_an_order_counts_from_its_arrival_on() -> None:
    motion = OwnMotion()
    motion.ordered(10.5, HERE, (0.0, 0.0), CLOSING)
    begins_s = 10.5 + BEGINS_S
    assert motion.carried_on(HERE, (2.0, 0.0), 10.0, begins_s)[0] == pytest.approx((1.2, 0.0))
    # From then on it is stopped, 1.2 m beyond the place: 2 m/s2 at the most.
    _, mps = motion.carried_on(HERE, (2.0, 0.0), 10.0, begins_s + 0.5)
    assert mps == pytest.approx((1.0, 0.0), abs=1e-6)


def test_one_with_a_high_jerk_answers_sooner() -> None:
    """3 m to go, from rest, for a second: 1 m/s2 for each m/s that is missing, or 4."""
    moved_m = []
    for jerk_mps3 in (2.0, 8.0):
        motion = OwnMotion()
        motion.ordered(10.0, there(3.0), (0.0, 0.0), Closing(2.0, jerk_mps3))
        moved_m.append(motion.carried_on(HERE, (0.0, 0.0), 10.0, 11.0)[0][0])
    assert 0.3 < moved_m[0] < 0.5
    assert 0.7 < moved_m[1] < 0.9  # 2 m/s2 for 0.9 s


def test_one_that_was_stopped_is_not_taken_to_fly_on() -> None:
    """4 m/s, and the order to stand at 3 m that it has had for long: it comes to stand there."""
    motion = OwnMotion()
    for tick in range(40):
        motion.ordered(8.0 + tick / 8.0, there(3.0), (0.0, 0.0), CLOSING)
    (north_m, east_m), (north_mps, _) = motion.carried_on(HERE, (4.0, 0.0), 10.0, 12.0)
    # At 4 m/s on for 2 s it would be 8 m on; it overshoots by what 2 m/s2 take more than 3 m.
    assert north_m == pytest.approx(4.0, abs=0.4)
    assert east_m == pytest.approx(0.0, abs=1e-6)
    assert abs(north_mps) < 1.0


def test_a_place_that_moves_is_flown_with() -> None:
    """An order of 2 m/s east, and nothing new for a second: it is where the place is by then."""
    motion = OwnMotion()
    for tick in range(41):
        motion.ordered(5.0 + tick / 8.0, there(0.0, tick / 4.0), (0.0, 2.0), CLOSING)
    (_, east_m), (_, east_mps) = motion.carried_on(there(0.0, 10.0), (0.0, 2.0), 10.0, 11.5)
    assert (east_m, east_mps) == pytest.approx((3.0, 2.0), abs=0.01)


def test_it_closes_far_places_no_faster_than_guided_does() -> None:
    motion = OwnMotion()
    motion.ordered(0.0, HERE, (0.0, 0.0), CLOSING)
    _, mps = motion.carried_on(there(-100.0), (0.0, 0.0), 1.0, 6.0)
    assert math.hypot(*mps) == pytest.approx(5.0, abs=0.01)


def test_what_is_forgotten_counts_no_more() -> None:
    motion = OwnMotion()
    motion.ordered(10.0, there(50.0), (0.0, 0.0), CLOSING)
    motion.forget()
    assert motion.carried_on(HERE, (1.0, 0.0), 11.0, 12.0)[1] == (1.0, 0.0)


@pytest.mark.parametrize(
    "seed", [101, *(pytest.param(seed, marks=pytest.mark.long) for seed in (102, 103, 104))]
)
def test_over_two_slow_radios_the_leader_is_found_and_held(seed: int) -> None:
    """Carried on at its velocity alone, the follower went to and fro, 5 to 13 m from its leader.

    The leader turns its first corner at 35 s: 3.2 to 4.7 m in 16 seeds that have found it.
    """
    one = flown("echowing", seed, "radio.follower.latency_s=0.46", "duration_s=45", *CLEARLY)
    late = one.flights[0].time_s > 35.0
    assert one.flights[0].separation_m[late].max() < 5.0
    assert one.flights[0].separation_m[late].mean() < 3.6
    assert one.closest_m > 1.2


@pytest.mark.parametrize("to_s", [1e9, math.inf])
def test_an_old_report_is_carried_on_no_longer_than_orders_are_remembered(to_s: float) -> None:
    motion = OwnMotion()
    motion.ordered(10.0, there(3.0), (0.0, 0.0), CLOSING)
    carried = motion.carried_on(HERE, (0.0, 0.0), 10.0, to_s)
    assert carried == motion.carried_on(HERE, (0.0, 0.0), 10.0, 10.0 + REMEMBERED_S)
