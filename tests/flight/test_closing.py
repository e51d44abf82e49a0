"""How Guided closes a distance, against the simulator's two generations of it."""

import pytest

from echowing.flight.closing import Closing
from echowing.flight.envelope import FASTEST_MPS
from echowing.flight.handling import Handling
from echowing.sim.vehicle.shaping import PREDICTIVE, STEPPED, ShapingLaw

RECOMMENDED = Closing(5.0, 15.3)
STEP_S = 0.01


def closed_after_s(law: ShapingLaw, closing: Closing, far_m: float, lasts_s: float) -> float:
    """How far a vehicle that Guided sends there has come after a time, m."""
    accel, jerk = closing.accel_mps2, closing.jerk_mps3
    moved_m = mps = mps2 = 0.0
    for _ in range(round(lasts_s / STEP_S)):
        wanted, _ = law.approach(far_m - moved_m, 0.0, mps, 0.0, 0.0, accel, jerk)
        demand, _ = law.demand(wanted, 0.0, mps, 0.0, accel, jerk)
        mps2 += max(-jerk * STEP_S, min(jerk * STEP_S, demand - mps2))
        mps += mps2 * STEP_S
        moved_m += mps * STEP_S
    return moved_m


def reckoned_after_s(closing: Closing, far_m: float, lasts_s: float) -> float:
    """The same by this law alone."""
    moved_m = mps = 0.0
    for _ in range(round(lasts_s / STEP_S)):
        turns_mps2 = closing.turns_per_s * (closing.speed_mps(far_m - moved_m) - mps)
        mps += max(-closing.accel_mps2, min(closing.accel_mps2, turns_mps2)) * STEP_S
        moved_m += mps * STEP_S
    return moved_m


@pytest.mark.parametrize("law", [STEPPED, PREDICTIVE])
@pytest.mark.parametrize("closing", [Closing(), RECOMMENDED])
@pytest.mark.parametrize("far_m", [0.5, 1.0, 3.0])
def test_it_is_what_guided_flies(law: ShapingLaw, closing: Closing, far_m: float) -> None:
    """A second and more after the order, within a quarter of the distance."""
    for lasts_s in (1.0, 1.5, 2.0):
        flown_m = closed_after_s(law, closing, far_m, lasts_s)
        assert reckoned_after_s(closing, far_m, lasts_s) == pytest.approx(flown_m, abs=far_m / 4.0)


def test_a_quick_vehicle_closes_faster_than_arducopters_default() -> None:
    """1 m/s for each metre by ArduCopter's defaults; 1.5 with what `setup` recommends."""
    assert Closing().speed_mps(0.5) == pytest.approx(0.5)
    assert RECOMMENDED.speed_mps(0.5) == pytest.approx(0.765)
    assert RECOMMENDED.speed_mps(3.0) == pytest.approx(3.5, abs=0.05)
    assert RECOMMENDED.speed_mps(100.0) == FASTEST_MPS


@pytest.mark.parametrize("mps", [0.0, 0.3, 1.0, 3.0])
def test_the_distance_of_a_speed_is_flown_at_that_speed(mps: float) -> None:
    assert RECOMMENDED.speed_mps(RECOMMENDED.distance_m(mps)) == pytest.approx(mps)


def test_it_comes_from_the_parameters_that_a_vehicle_reports() -> None:
    handling = Handling()
    assert handling.closing == Closing()
    handling.receive("WP_ACC", 5.0)
    handling.receive("PSC_JERK_NE", 20.0)
    # The lean's angular acceleration allows no more than 15.3 m/s3.
    assert handling.closing.accel_mps2 == 5.0
    assert handling.closing.jerk_mps3 == pytest.approx(15.3, abs=0.1)
