import math
from dataclasses import replace

import pytest

from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import (
    GRAY,
    Course,
    GuidanceSettings,
    GuidedPoint,
    LeaderFix,
    Slot,
    bearing_rad,
    held_behind,
    lead_share,
    predicted,
    slot_offset_m,
)
from echowing.flight.known import Known
from echowing.flight.plan import planned
from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.sonar_file import shipped_sonar

HERE = GlobalPosition(39.34, -86.03, 260.0)
COURSES_DEG = range(0, 360, 15)
BY_POSITION = GuidanceSettings(feed_forward=False, learn_offset=False)
FOLLOWER = 2


class Planner:
    """Points for one follower, which gets them at once; heading north at first."""

    def __init__(self, settings: GuidanceSettings, slot: Slot | None = None) -> None:
        plan = FollowerPlan(FOLLOWER, slot or Slot(3.0), sonar=shipped_sonar())
        self.known = Known(1, [plan], settings)
        self.follower = self.known.followers[FOLLOWER]
        self.follower.clock.answered(0.0, 0.0, 0.0)

    def point(
        self, fix: LeaderFix, now_s: float = 0.0, at: GlobalPosition | None = None
    ) -> GuidedPoint:
        """The point from this report; `at`: where the follower is."""
        self.known.leader.fix = fix
        self.follower.position, self.follower.position_at_s = at, now_s
        return planned(self.known, self.follower, fix, now_s)


def grays(fix: LeaderFix, now_s: float = 0.0, slot: Slot | None = None) -> GuidedPoint:
    return Planner(GRAY, slot).point(fix, now_s)


def fix_on_course(
    course_deg: float,
    speed_mps: float = 2.0,
    *,
    time_s: float = 0.0,
    heading_deg: float = 0.0,
    position: GlobalPosition = HERE,
) -> LeaderFix:
    course = math.radians(course_deg)
    velocity = (speed_mps * math.cos(course), speed_mps * math.sin(course), 0.0)
    return LeaderFix(time_s, position, velocity, math.radians(heading_deg))


def seen_from_leader(
    point: GlobalPosition, course_deg: float, leader: GlobalPosition = HERE
) -> tuple[float, float]:
    """(ahead, right) of the leader in metres, worked out without the guidance's own algebra."""
    north, east, _ = ned_between(leader, point)
    distance, bearing = math.hypot(north, east), math.atan2(east, north)
    off = bearing - math.radians(course_deg)
    return distance * math.cos(off), distance * math.sin(off)


@pytest.mark.parametrize("course_deg", COURSES_DEG)
def test_on_every_course_the_slot_is_straight_behind(course_deg: int) -> None:
    """The thesis's frame fault (Table 8) put it abeam on north and south courses."""
    guided = grays(fix_on_course(course_deg))

    assert seen_from_leader(guided.slot, course_deg) == pytest.approx((-3.0, 0.0), abs=0.02)


@pytest.mark.parametrize("course_deg", COURSES_DEG)
def test_on_every_course_the_guided_point_is_the_slot_moved_ahead_by_l1(course_deg: int) -> None:
    guided = grays(fix_on_course(course_deg, 1.5), slot=Slot(5.0))

    # L1 = 1.0 s x 1.5 m/s.
    assert seen_from_leader(guided.point, course_deg) == pytest.approx((-3.5, 0.0), abs=0.02)


@pytest.mark.parametrize("course_deg", COURSES_DEG)
def test_a_positive_angle_is_counter_clockwise_seen_from_above(course_deg: int) -> None:
    slot = Slot(4.0, math.radians(90.0))

    guided = grays(fix_on_course(course_deg), slot=slot)

    # The tail turned counter-clockwise is the leader's right.
    assert seen_from_leader(guided.slot, course_deg) == pytest.approx((0.0, 4.0), abs=0.02)


def test_the_altitude_step_is_upwards() -> None:
    guided = grays(fix_on_course(0.0), slot=Slot(3.0, 0.0, 2.5))

    assert guided.point.alt_m == pytest.approx(HERE.alt_m + 2.5)


@pytest.mark.parametrize("latitude_deg", [0.0, 60.0, 79.9, 85.0, -85.0])
@pytest.mark.parametrize("longitude_deg", [0.0, 180.0, -179.99999])
def test_the_slot_is_right_at_high_latitude_and_across_the_antimeridian(
    latitude_deg: float, longitude_deg: float
) -> None:
    place = GlobalPosition(latitude_deg, longitude_deg, 100.0)
    fix = fix_on_course(270.0, position=place)

    guided = grays(fix)

    assert seen_from_leader(guided.slot, 270.0, place) == pytest.approx((-3.0, 0.0), abs=0.02)


def test_the_leader_is_predicted_over_the_age_of_its_report() -> None:
    guided = Planner(BY_POSITION).point(fix_on_course(90.0, time_s=10.0), 10.46)

    # 0.46 s at 2 m/s.
    assert ned_between(HERE, guided.leader) == pytest.approx((0.0, 0.92, 0.0), abs=0.02)
    assert guided.age_s == pytest.approx(0.46)


def test_without_prediction_the_slot_is_where_the_report_says() -> None:
    guided = grays(fix_on_course(90.0, time_s=10.0), 10.46)

    assert guided.leader == HERE


def test_slow_leaders_are_followed_by_heading_and_moving_ones_by_course() -> None:
    course = Course()

    assert course.update(fix_on_course(90.0, 2.0)) == pytest.approx(math.pi / 2)
    assert course.update(fix_on_course(90.0, 0.24, heading_deg=180.0)) == pytest.approx(math.pi)


def test_between_the_two_limits_the_choice_stays_as_it_was() -> None:
    slow, moving = Course(), Course()
    slow.update(fix_on_course(90.0, 0.1))
    moving.update(fix_on_course(90.0, 1.0))

    between = fix_on_course(90.0, 0.3)

    assert slow.update(between) == pytest.approx(0.0)
    assert moving.update(between) == pytest.approx(math.pi / 2)


def test_exactly_a_quarter_metre_a_second_is_still_moving() -> None:
    """Thesis Appendix C: yaw is used if v < 0.25."""
    course = Course()
    course.update(fix_on_course(90.0, 1.0))

    assert course.update(fix_on_course(90.0, 0.25)) == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("lead_time_s", [0.0, 1.0, 1.4, 5.0])
@pytest.mark.parametrize("angle_deg", [-90.0, -40.0, 0.0, 15.0, 90.0])
@pytest.mark.parametrize("course_deg", [0, 75, 200])
def test_a_guided_point_is_never_ahead_of_the_leader_nor_within_a_metre(
    lead_time_s: float, angle_deg: float, course_deg: int
) -> None:
    planner = Planner(
        replace(BY_POSITION, lead_time_s=lead_time_s), Slot(3.0, math.radians(angle_deg))
    )

    guided = planner.point(fix_on_course(course_deg, 4.0, heading_deg=course_deg), 0.2)

    ahead_m, right_m = seen_from_leader(guided.point, course_deg, guided.leader)
    assert ahead_m <= 0.02
    assert math.hypot(ahead_m, right_m) >= 1.0 - 0.02


def test_holding_behind_moves_a_point_only_along_the_course() -> None:
    # 0.6 m to the right of a northbound leader, 1 m ahead: back to 0.8 m behind (a 3-4-5 triangle).
    assert held_behind((1.0, 0.6), 0.0, 1.0) == pytest.approx((-0.8, 0.6))
    assert held_behind((-2.0, 0.6), 0.0, 1.0) == pytest.approx((-2.0, 0.6))


@pytest.mark.parametrize(
    ("age_s", "share"), [(0.0, 1.0), (0.5, 1.0), (0.75, 0.5), (1.0, 0.0), (3.0, 0.0)]
)
def test_the_lead_shrinks_as_the_report_ages(age_s: float, share: float) -> None:
    assert lead_share(age_s, GuidanceSettings()) == pytest.approx(share)


def test_grays_scheme_keeps_its_lead_however_old_the_report() -> None:
    assert lead_share(100.0, GRAY) == 1.0


def test_a_leader_that_reverses_pushes_its_points_straight_back() -> None:
    """By position too: the slot stays on its side, and the lead points away from the leader."""
    planner = Planner(BY_POSITION)
    planner.point(fix_on_course(0.0), 0.0)
    for step in range(1, 8 * 8):
        now_s = step / 8.0
        guided = planner.point(fix_on_course(180.0, time_s=now_s), now_s)
        # The slot is 3 m south, the leader comes south at 2 m/s: with 1.4 s of lead the point
        # is 2.8 m further south.
        assert ned_between(guided.leader, guided.slot)[:2] == pytest.approx((-3.0, 0.0), abs=0.02)
        assert ned_between(guided.leader, guided.point)[:2] == pytest.approx((-5.8, 0.0), abs=0.1)


@pytest.mark.parametrize("feed_forward", [True, False])
def test_both_ways_of_flying_have_the_same_slot(feed_forward: bool) -> None:
    """Through a corner, from reports of half a second ago; the lead is all that differs."""
    ours = Planner(replace(BY_POSITION, feed_forward=feed_forward))
    other = Planner(replace(BY_POSITION, feed_forward=not feed_forward))
    turned = 0.0
    for step in range(40):
        now_s = step / 8.0
        fix = fix_on_course(0.0 if step < 10 else 90.0, time_s=now_s - 0.5)
        guided = ours.point(fix, now_s)
        assert guided.slot == other.point(fix, now_s).slot
        turned = guided.course_rad
    assert turned > math.radians(60.0)


def test_the_follower_looks_at_the_leader_from_where_it_is() -> None:
    follower = displace(HERE, (-3.0, -3.0, 0.0))

    guided = Planner(BY_POSITION).point(fix_on_course(0.0), 0.0, follower)

    assert guided.yaw_rad == pytest.approx(math.radians(45.0), abs=0.01)
    for settings in (GRAY, replace(GuidanceSettings(), face_leader=False)):
        assert Planner(settings).point(fix_on_course(0.0), 0.0, follower).yaw_rad is None


@pytest.mark.parametrize(
    ("offset", "degrees"), [((1.0, 0.0, 0.0), 0), ((0.0, 1.0, 0.0), 90), ((-1.0, 0.0, 0.0), 180)]
)
def test_bearings_are_clockwise_from_north(offset: Ned, degrees: float) -> None:
    bearing = bearing_rad(HERE, displace(HERE, offset))

    assert abs(math.degrees(bearing)) == pytest.approx(degrees, abs=0.5)


def test_slot_offsets_turn_with_the_course() -> None:
    assert slot_offset_m(Slot(3.0), 0.0) == pytest.approx((-3.0, 0.0))
    assert slot_offset_m(Slot(3.0), math.pi / 2) == pytest.approx((0.0, -3.0))


def test_an_accelerating_leader_is_predicted_with_its_acceleration() -> None:
    fix = replace(fix_on_course(0.0, 2.0), acceleration_ned_mps2=(-2.0, 0.0, 0.0))

    now = predicted(fix, 0.5)

    # 2 m/s x 0.5 s - 2 m/s2 x (0.5 s)^2 / 2, and 2 - 1 m/s.
    assert ned_between(HERE, now.position)[0] == pytest.approx(0.75, abs=0.02)
    assert now.velocity_ned_mps[0] == pytest.approx(1.0)


@pytest.mark.parametrize("feed_forward", [True, False])
@pytest.mark.parametrize("learn_offset", [True, False])
def test_the_slot_is_further_out_where_a_reversal_asks_for_it(
    feed_forward: bool, learn_offset: bool
) -> None:
    settings = GuidanceSettings(feed_forward=feed_forward, learn_offset=learn_offset)
    planner = Planner(settings)
    planner.follower.reversal_m = 6.0
    guided = planner.point(fix_on_course(0.0))
    assert ned_between(HERE, guided.slot)[0] == pytest.approx(-6.0, abs=0.02)


def test_a_slot_to_the_side_is_flown_to_by_speed() -> None:
    """1.3 m: Guided would close them with 20 degrees of roll, and the sonar lose its leader."""
    planner = Planner(GuidanceSettings(learn_offset=False))
    fix = fix_on_course(0.0)
    for step in range(20):  # the tow bar straightens behind the leader
        behind = displace(fix.position, (-3.0, 0.0, 0.0))
        guided = planner.point(replace(fix, time_s=step / 8.0), step / 8.0, behind)
    at = displace(guided.slot, (0.0, -1.3, 0.0))
    guided = planner.point(replace(fix, time_s=2.5), 2.5, at)
    north_m, east_m, _ = ned_between(at, guided.slot)
    far_m = math.hypot(north_m, east_m)
    assert far_m == pytest.approx(1.3, abs=0.05)
    assert ned_between(at, guided.point)[1] == pytest.approx(0.0, abs=0.02)
    assert guided.velocity_mps[1] == pytest.approx(0.65, abs=0.05)
