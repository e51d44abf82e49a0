import math
import random
from collections.abc import Callable

import pytest

from echowing.flight.alignment import Report
from echowing.flight.clocks import LONGEST_GAP_S
from echowing.flight.drift import DRIFTS_M, Drift
from echowing.flight.guidance import Horizontal
from echowing.flight.receivers import FORGETS_S
from echowing.geo import GlobalPosition, displace
from echowing.sim.world import gps

START = GlobalPosition(39.34, -86.03, 260.0)
AT_REST: Horizontal = (0.0, 0.0)


def told(
    off_m: Callable[[float], Horizontal], until_s: float, every_s: float = 0.25
) -> tuple[Drift, list[Horizontal]]:
    """Reports of a vehicle on a circle of 8 m at 2 m/s, its place off by so much at a moment."""
    drift, lately = Drift(), []
    for number in range(round(until_s / every_s) + 1):
        time_s = number * every_s
        angle = time_s / 4.0
        north_m, east_m = off_m(time_s)
        place = (8.0 * math.cos(angle) + north_m, 8.0 * math.sin(angle) + east_m, 0.0)
        velocity = -2.0 * math.sin(angle), 2.0 * math.cos(angle)
        drift.reported(Report(time_s, displace(START, place), velocity, 0.0))
        lately.append(drift.lately_m)
    return drift, lately


def test_a_vehicle_that_turns_has_not_drifted() -> None:
    """A chord and the arc are centimetres apart, and turn round with it."""
    _, lately = told(lambda _: AT_REST, 60.0)

    assert max(math.hypot(*one) for one in lately) < 0.1


@pytest.mark.parametrize(("step_m", "counts"), [(1.0, 0.6), (2.0, 1.0), (2.7, 1.0)])
def test_a_receiver_that_steps_has_drifted_by_that_and_it_is_forgotten_slowly(
    step_m: float, counts: float
) -> None:
    """As EKF3 follows it: the velocity is drawn along, and hides a third and more of it.

    Of a small step that may be the velocity's own error.
    """
    filter_, drift, hidden_m = gps.Filter(1.5, 0.0), Drift(), 0.0
    lately_m = []
    for number in range(round((10.0 + FORGETS_S) / 0.25)):
        place = displace(START, (0.0, filter_.error_m, 0.0))
        drift.reported(Report(0.25 * number, place, (0.0, filter_.error_mps), 0.0))
        lately_m.append(drift.lately_m[1])
        for _ in range(25):
            filter_.step(step_m if number >= 20 else 0.0, 0.0, 0.01)
            hidden_m += 0.01 * filter_.error_mps if number < 40 else 0.0

    assert 0.35 * step_m < hidden_m
    assert lately_m[40] == pytest.approx(counts * step_m, abs=0.15 * step_m)
    assert lately_m[-1] == pytest.approx(math.exp(-1.0) * counts * step_m, abs=0.1 * step_m)


def test_a_jump_is_not_counted() -> None:
    """It is for `jumps` to decide whether it is the receiver's."""
    drift, _ = told(lambda time_s: (15.0 if time_s > 5.0 else 0.0, 0.0), 6.0)
    assert drift.lately_m == pytest.approx((0.0, 0.0), abs=0.1)
    for time_s, north_m in ((7.0, 0.0), (7.25, 0.0), (7.5, 1.0)):
        if north_m:  # less than what looks like one
            drift.jumped()
        drift.reported(Report(time_s, displace(START, (north_m, 0.0, 0.0)), AT_REST, 0.0))

    assert drift.lately_m == pytest.approx((0.0, 0.0), abs=0.1)


@pytest.mark.parametrize("mps", [0.5, 2.0])
def test_a_velocity_that_is_wrong_counts_for_no_more_than_receivers_may_drift(mps: float) -> None:
    """A vehicle that says it stands."""
    drift = Drift()
    for number in range(400):
        place = displace(START, (0.25 * mps * number, 0.0, 0.0))
        drift.reported(Report(0.25 * number, place, AT_REST, 0.0))
        assert math.hypot(*drift.lately_m) <= DRIFTS_M + 1e-9

    assert math.hypot(*drift.lately_m) == pytest.approx(DRIFTS_M)


def test_over_a_longer_gap_it_may_have_turned_unseen() -> None:
    drift = Drift()
    drift.reported(Report(0.0, START, AT_REST, 0.0))
    drift.reported(Report(LONGEST_GAP_S + 0.01, displace(START, (0.5, 0.0, 0.0)), AT_REST, 0.0))
    assert drift.lately_m == (0.0, 0.0)
    after_s = 2.0 * LONGEST_GAP_S
    drift.reported(Report(after_s, displace(START, (0.6, 0.0, 0.0)), AT_REST, 0.0))

    assert drift.lately_m == pytest.approx((0.1, 0.0), abs=1e-6)


def left_share(velocity_mps: float) -> float:
    """How far places less their drift move in 3 s, as a share of how far they move themselves."""
    errors = gps.Errors(sigma_m=0.8, tau_s=60.0, velocity_sigma_mps=velocity_mps)
    receiver = gps.Drift(errors, lambda name: random.Random(f"5 {name}"))
    drift, moved_m, left_m, before = Drift(), 0.0, 0.0, (0.0, 0.0)
    for number in range(6_000):
        for _ in range(5):
            north_m, east_m, _ = receiver.step(0.05)
        place = displace(START, (north_m, east_m, 0.0))
        drift.reported(Report(0.25 * number, place, receiver.velocity_mps, 0.0))
        now = north_m, north_m - drift.lately_m[0]
        if number % 12 == 0:  # 3 s
            moved_m += (now[0] - before[0]) ** 2
            left_m += (now[1] - before[1]) ** 2
            before = now

    return math.sqrt(left_m / moved_m)


def test_places_less_their_drift_wander_less() -> None:
    """By nearly half within seconds, by a third where velocities err as receivers' do."""
    exact, usual, bad = (left_share(one) for one in (0.0, 0.05, 0.1))

    assert exact == pytest.approx(0.55, abs=0.05)
    assert exact < usual < bad < 0.85
