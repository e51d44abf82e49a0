"""Auto missions: legs with S-curve speed, corners cut, last point a stop."""

import math
from itertools import pairwise

import pytest

from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.wpnav import Leg, Ned, TrackLimits, WaypointNavigator, along_limit

LIMITS = TrackLimits()
ORIGIN = (0.0, 0.0, -10.0)


def perfect_run(navigator: WaypointNavigator, step_s: float = 0.02) -> list[Ned]:
    """Positions led through by a vehicle that follows without any error."""
    points = []
    for _ in range(round(300.0 / step_s)):
        navigator.advance(
            step_s, navigator.position_m, (0.0, 0.0, 0.0), navigator.velocity_mps, 1.0
        )
        points.append(navigator.position_m)
        if navigator.finished:
            return points
    raise AssertionError("the mission does not end")


@pytest.mark.parametrize("length_m", [0.05, 1.0, 5.0, 60.0, 500.0])
@pytest.mark.parametrize("speed_mps", [0.3, 2.0, 12.0])
def test_leg_keeps_its_limits_and_ends_at_rest_on_its_end(
    length_m: float, speed_mps: float
) -> None:
    leg = Leg(ORIGIN, (length_m, 0.0, -10.0), speed_mps, LIMITS)
    steps = 4000
    samples = [leg.at(leg.end_s * k / steps) for k in range(steps)]
    assert max(abs(a) for a, _, _ in samples) <= LIMITS.acceleration_mps2 + 1e-6
    assert min(v for _, v, _ in samples) >= -1e-6
    assert max(v for _, v, _ in samples) <= speed_mps + 1e-6
    accelerations = [a for a, _, _ in samples]
    jerks = [(b - a) * steps / leg.end_s for a, b in pairwise(accelerations)]
    assert max(map(abs, jerks)) <= LIMITS.jerk_mps3 * 1.001 + 1e-6
    _, speed, distance = leg.at(leg.end_s - 1e-4)
    assert speed < 1e-3
    assert distance == pytest.approx(length_m, abs=0.01)


def test_leg_is_the_integral_of_its_speed() -> None:
    leg = Leg(ORIGIN, (30.0, 40.0, -10.0), 3.0, LIMITS)
    step = leg.end_s / 20000
    travelled = sum(leg.at((k + 0.5) * step)[1] * step for k in range(20000))
    assert travelled == pytest.approx(50.0, abs=1e-3)


def test_climbing_leg_is_held_back_by_the_climb_rate() -> None:
    leg = Leg((0.0, 0.0, 0.0), (10.0, 0.0, -50.0), 10.0, LIMITS)
    direction = 50.0 / math.hypot(10.0, 50.0)
    assert leg.speed_mps == pytest.approx(LIMITS.climb_mps / direction)


def test_limit_along_a_direction() -> None:
    assert along_limit((1.0, 0.0, 0.0), 2.0, 2.5, 1.5) == 2.0
    assert along_limit((0.0, 0.0, 1.0), 2.0, 2.5, 1.5) == 1.5
    assert along_limit((0.0, 0.0, -1.0), 2.0, 2.5, 1.5) == 2.5
    assert along_limit((1.0, 0.0, 0.0), 0.0, 2.5, 1.5) == 0.0


@pytest.mark.parametrize("speed_mps", [1.0, 4.0])
def test_speed_changes_on_the_way_and_the_leg_still_ends_on_its_end(speed_mps: float) -> None:
    leg = Leg(ORIGIN, (100.0, 0.0, -10.0), 2.0, LIMITS)
    leg.advance(10.0)
    before = leg.at(leg.elapsed_s)
    leg.set_speed(speed_mps)
    assert leg.at(leg.elapsed_s) == pytest.approx(before)
    cruise = leg.at(leg.braking_s)[1]
    assert cruise == pytest.approx(speed_mps, abs=1e-6)
    assert leg._at(leg.end_s)[2] == pytest.approx(100.0, abs=1e-3)


def test_braking_leg_keeps_its_plan() -> None:
    leg = Leg(ORIGIN, (100.0, 0.0, -10.0), 2.0, LIMITS)
    leg.advance(leg.braking_s + 0.1)
    end_s = leg.end_s
    leg.set_speed(5.0)
    assert leg.end_s == end_s


def test_corner_is_cut_within_the_radius_and_without_a_stop() -> None:
    corner = (20.0, 0.0, -10.0)
    navigator = WaypointNavigator(ORIGIN, [corner, (20.0, 20.0, -10.0)], 2.0)
    points = perfect_run(navigator)
    nearest = min(math.dist(point, corner) for point in points)
    # the recorded rectangle cuts its corners by 0.7 m at 2 m/s; never more than WP_RADIUS_M
    assert 0.2 < nearest < LIMITS.radius_m
    speeds = [math.dist(a, b) / 0.02 for a, b in pairwise(points)]
    cruise = [
        speed
        for speed, point in zip(speeds, points, strict=False)
        if point[0] > 6 and point[1] < 14
    ]
    assert min(cruise) > 1.0
    assert points[-1] == pytest.approx((20.0, 20.0, -10.0))


def test_way_straight_back_stops_at_the_turn() -> None:
    navigator = WaypointNavigator(ORIGIN, [(20.0, 0.0, -10.0), ORIGIN], 2.0)
    points = perfect_run(navigator)
    assert max(point[0] for point in points) > 18.0
    assert points[-1] == pytest.approx(ORIGIN)


def test_waypoint_where_the_vehicle_is_is_passed_over() -> None:
    navigator = WaypointNavigator(ORIGIN, [ORIGIN, (10.0, 0.0, -10.0), (10.0, 0.0, -10.0)], 2.0)
    assert perfect_run(navigator)[-1] == pytest.approx((10.0, 0.0, -10.0))


def test_empty_mission_is_over_at_once() -> None:
    assert WaypointNavigator(ORIGIN, [], 2.0).finished


def test_point_waits_for_a_vehicle_that_does_not_come() -> None:
    navigator = WaypointNavigator(ORIGIN, [(100.0, 0.0, -10.0)], 2.0)
    for _ in range(3000):
        gap = (navigator.position_m[0], 0.0, 0.0)
        navigator.advance(0.02, ORIGIN, gap, (0.0, 0.0, 0.0), 1.0)
    assert navigator.position_m[0] < 10.0


def test_mission_flown_by_the_copter() -> None:
    copter = Copter(ORIGIN, flying=True)
    copter.start_auto([(30.0, 0.0, -15.0), (30.0, 20.0, -10.0)], 3.0)
    headings = []
    for _ in range(2500):
        copter.step(0.02)
        if copter.ve_mps > 2.0:
            headings.append(copter.yaw_rad)
    assert copter.navigator is not None
    assert copter.navigator.finished
    end = (copter.north_m, copter.east_m, copter.down_m)
    assert end == pytest.approx((30.0, 20.0, -10.0), abs=0.05)
    assert max(headings) == pytest.approx(math.pi / 2, abs=0.1)


def test_mission_takes_another_speed_on_the_way() -> None:
    copter = Copter(ORIGIN, flying=True)
    copter.start_auto([(200.0, 0.0, -10.0)], 2.0)
    for _ in range(500):
        copter.step(0.02)
    copter.set_speed_limit(5.0)
    for _ in range(500):
        copter.step(0.02)
    assert copter.vn_mps == pytest.approx(5.0, abs=0.1)
