"""How high a follower is to fly: by its plan, by its leader, and by what its sonar's tilt tells."""

import math

import pytest

from echowing.flight.axis import Axis
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.heights import CLIMB_MPS, MOST_M, SURE_SIGMAS, Heights
from echowing.flight.lowest import LOWEST_M

from .told import HEIGHT_M, Told
from .yard import FOLLOWER, LEADER, Vehicle

CORRECTED = Limits(home_difference_m=5.0, leader_flies=False)


def told(
    limits: Limits | None = CORRECTED, home_m: float = 250.0, altitude_m: float = HEIGHT_M
) -> Told:
    """A leader 14 m up, and a follower with a home of its own."""
    vehicles = {
        LEADER: Vehicle((0.0, 0.0), height_m=14.0),
        FOLLOWER: Vehicle((-3.0, 0.0), home_m=home_m),
    }
    return Told(vehicles, limits, GuidanceSettings(), altitude_m)


def heights(of: Told, *, leaders: bool = False) -> Heights:
    return Heights(of.known, leaders=leaders)


@pytest.mark.parametrize(("home_m", "commanded_m"), [(250.0, 10.0), (248.0, 12.0), (253.0, 7.0)])
def test_the_height_is_the_same_above_the_sea_from_whatever_home(
    home_m: float, commanded_m: float
) -> None:
    there = told(home_m=home_m)
    assert heights(there).commanded_m(there.follower) == pytest.approx(commanded_m)


def test_without_limits_each_counts_from_its_own_home() -> None:
    there = told(None, home_m=248.0)
    assert heights(there).commanded_m(there.follower) == HEIGHT_M


def test_where_no_altitude_was_asked_for_it_flies_at_the_leaders() -> None:
    there = told()
    heights(there).take_leaders(there.follower)
    assert there.follower.plan.altitude_m == HEIGHT_M
    heights(there, leaders=True).take_leaders(there.follower)
    assert there.follower.plan.altitude_m == 14.0


def test_the_leaders_height_is_not_known_without_its_report() -> None:
    there = told()
    assert heights(there, leaders=True).wanted_m(there.follower) == pytest.approx(HEIGHT_M)
    there.known.leader.fix = None
    assert heights(there, leaders=True).wanted_m(there.follower) is None
    assert heights(there).wanted_m(there.follower) == pytest.approx(HEIGHT_M)


def looked(of: Told, above_m: float) -> None:
    """The sonar hears a leader that is level by the barometers only where it is tilted to it."""
    cloud, level_m = of.follower.estimate.offset, 2.8
    far_m, side = math.hypot(level_m, above_m), math.copysign(1.0, above_m)
    by_barometer = (level_m, 0.0, 0.0)
    for _ in range(8):
        of.now_s += 0.3
        cloud.silent(of.now_s, Axis(0.0, math.radians(-10.0 * side)), by_barometer)
        of.now_s += 0.3
        cloud.heard(of.now_s, far_m, Axis(0.0, math.radians(20.0 * side)), by_barometer)


@pytest.mark.parametrize("above_m", [1.0, -1.0])
def test_it_climbs_slowly_to_where_the_beam_shows_its_leader(above_m: float) -> None:
    there = told()
    looked(there, above_m)
    step = heights(there)
    offset = there.follower.estimate.offset
    assert -offset.up_m * above_m > 0.5, "the beam tells it"
    step.level_m(there.follower, there.now_s)
    before_m = step.level_m(there.follower, there.now_s)
    after_m = step.level_m(there.follower, there.now_s + 0.5)
    assert (after_m - before_m) * math.copysign(1.0, above_m) == pytest.approx(0.5 * CLIMB_MPS)
    # After a pause it is still no more than a second's climb.
    later_m = step.level_m(there.follower, there.now_s + 2.0)
    assert abs(later_m - after_m) <= CLIMB_MPS + 1e-9


def test_what_the_beam_does_not_tell_surely_is_not_flown_after() -> None:
    """Heard once, tilted up: the leader is likely higher, and may as well be level."""
    there = told()
    cloud = there.follower.estimate.offset
    cloud.heard(0.3, 3.0, Axis(0.0, math.radians(20.0)), (3.0, 0.0, 0.0))
    assert 0.1 < -cloud.up_m < SURE_SIGMAS * cloud.up_sigma_m
    assert heights(there).level_m(there.follower, 0.4) == pytest.approx(HEIGHT_M)


def test_a_leader_that_is_not_heard_any_more_leaves_the_height_as_it_is() -> None:
    there = told()
    looked(there, 1.0)
    before_m = heights(there).level_m(there.follower, there.now_s)
    assert before_m == pytest.approx(HEIGHT_M + CLIMB_MPS)
    later_s = there.now_s + 60.0
    assert heights(there).level_m(there.follower, later_s) == pytest.approx(before_m)


def test_no_beam_leads_it_to_the_ground() -> None:
    there = told(altitude_m=LOWEST_M + 0.5)
    there.follower.level_m = -MOST_M
    assert heights(there).level_m(there.follower, 1.0) == LOWEST_M
