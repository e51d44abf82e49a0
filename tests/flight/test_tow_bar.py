import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echowing.flight.guidance import GuidedPoint, Horizontal, LeaderFix, Slot, bearing_rad
from echowing.flight.tow_bar import FURTHEST_ROUND_RAD, TowBar
from echowing.geo import GlobalPosition, displace, ned_between, wrap_angle_rad

START = GlobalPosition(39.34, -86.03, 260.0)
TICK_S = 0.125  # guided points at 8 Hz
NORTH, EAST, SOUTH = 0.0, math.pi / 2, math.pi


class Leader:
    """A leader that moves at a speed and a course, its nose along it unless set otherwise."""

    def __init__(self, course_rad: float = NORTH) -> None:
        self.now_s = 0.0
        self.place = START
        self.course_rad = self.heading_rad = course_rad
        self.speed_mps = 0.0

    def fix(self) -> LeaderFix:
        return LeaderFix(self.now_s, self.place, (*self.velocity, 0.0), self.heading_rad)

    @property
    def velocity(self) -> Horizontal:
        return (
            self.speed_mps * math.cos(self.course_rad),
            self.speed_mps * math.sin(self.course_rad),
        )

    def step(self) -> None:
        north, east = self.velocity
        self.place = displace(self.place, (north * TICK_S, east * TICK_S, 0.0))
        self.now_s += TICK_S

    def fly(self, bar: TowBar, seconds: float, speed_mps: float) -> list[GuidedPoint]:
        """The points of a leader that keeps its course for so long."""
        self.speed_mps = speed_mps
        points = []
        for _ in range(round(seconds / TICK_S)):
            points.append(bar.update(self.fix(), self.now_s))
            self.step()
        return points


def seen_from_leader(point: GuidedPoint) -> tuple[float, float]:
    """Distance from leader to slot, and the bearing of it."""
    north, east, _ = ned_between(point.leader, point.slot)
    return math.hypot(north, east), math.atan2(east, north)


@given(
    legs=st.lists(st.tuples(st.floats(0.0, 6.0), st.floats(-math.pi, math.pi)), min_size=1),
    radius_m=st.floats(1.5, 8.0),
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_a_slot_on_the_tail_is_never_faster_than_its_leader(
    legs: list[tuple[float, float]], radius_m: float
) -> None:
    leader, bar = Leader(), TowBar(Slot(radius_m))

    for speed_mps, course_rad in legs:
        leader.course_rad = course_rad
        for point in leader.fly(bar, 1.0, speed_mps):
            assert math.hypot(*point.velocity_mps) <= speed_mps + 1e-9


@pytest.mark.parametrize("turn_rad", [math.pi / 2, -math.pi / 2])
def test_what_flies_the_slots_velocity_keeps_its_distance_through_a_corner(turn_rad: float) -> None:
    leader, bar = Leader(), TowBar(Slot(3.0))
    points = leader.fly(bar, 5.0, 2.0)
    leader.course_rad = turn_rad
    points += leader.fly(bar, 6.0, 2.0)

    place = points[0].slot
    for point, after in pairwise(points):
        north, east = point.velocity_mps
        place = displace(place, (north * TICK_S, east * TICK_S, 0.0))
        off_m = math.hypot(*ned_between(after.leader, place)[:2]) - 3.0
        # The bar turns by 0.08 rad in a tick at the corner; its chord is 0.01 m off its arc.
        assert abs(off_m) < 0.1

    # A trailer's bearing falls short of the course by a factor e in 3 m / 2 m/s = 1.5 s.
    behind_rad = wrap_angle_rad(seen_from_leader(points[-1])[1] + math.pi - turn_rad)
    assert abs(behind_rad) < 0.1


def test_a_trailers_bar_turns_as_a_trailer_does() -> None:
    """From 90 degrees across the bar follows tan(bearing off / 2) = exp(-v t / length)."""
    leader, bar = Leader(), TowBar(Slot(3.0))
    leader.fly(bar, 2.0, 2.0)
    leader.course_rad = EAST

    points = leader.fly(bar, 3.0, 2.0)

    off_rad = wrap_angle_rad(EAST - points[-1].course_rad)
    expected_rad = 2.0 * math.atan(math.exp(-2.0 * 3.0 / 3.0))
    assert off_rad == pytest.approx(expected_rad, abs=0.03)  # Euler's steps of 0.08 rad


def test_a_leader_that_turns_its_nose_moves_nobody() -> None:
    leader, bar = Leader(), TowBar(Slot(3.0))
    before = leader.fly(bar, 2.0, 2.0)[-1]
    stood = leader.fly(bar, 0.25, 0.0)[-1]

    for _ in range(40):
        leader.heading_rad += 0.2
        point = leader.fly(bar, TICK_S, 0.0)[-1]
        assert point.slot == stood.slot
        assert point.velocity_mps == (0.0, 0.0)
    (far_m, before_rad), (stood_m, stood_rad) = seen_from_leader(before), seen_from_leader(stood)
    assert far_m == pytest.approx(stood_m)
    assert wrap_angle_rad(before_rad - stood_rad) == pytest.approx(0.0, abs=1e-6)


def test_noise_of_a_hovering_leaders_course_does_not_turn_the_bar() -> None:
    leader, bar = Leader(), TowBar(Slot(3.0))
    leader.fly(bar, 2.0, 2.0)

    for number in range(80):
        leader.course_rad = number * 2.4
        point = leader.fly(bar, TICK_S, 0.09)[-1]

    assert point.course_rad == pytest.approx(NORTH, abs=1e-9)


def test_a_leader_that_flies_back_pushes_straight_back() -> None:
    leader, bar = Leader(), TowBar(Slot(3.0))
    leader.fly(bar, 4.0, 2.0)
    leader.course_rad = SOUTH

    for point in leader.fly(bar, 6.0, 2.0):
        distance_m, bearing = seen_from_leader(point)
        assert distance_m == pytest.approx(3.0, abs=1e-3)
        assert abs(wrap_angle_rad(bearing - SOUTH)) < 0.01
        assert point.velocity_mps == pytest.approx((-2.0, 0.0), abs=0.02)


@pytest.mark.parametrize("aside_rad", [0.2, 0.7, -0.7])
def test_a_formations_bar_does_not_turn_while_it_is_pushed(aside_rad: float) -> None:
    """It would buckle: a lone follower's bar does, and is behind its leader again."""
    leader, formations, lone = Leader(), TowBar(Slot(3.0)), TowBar(Slot(3.0))
    for bar in (formations, lone):
        bar.update(leader.fix(), leader.now_s)  # both begin north
    leader.course_rad, leader.speed_mps = SOUTH + aside_rad, 2.0
    for _ in range(80):
        point = formations.update(leader.fix(), leader.now_s, formation_mps=leader.velocity)
        assert point.course_rad == NORTH
        assert point.velocity_mps == pytest.approx(leader.velocity)
        alone = lone.update(leader.fix(), leader.now_s)
        leader.step()
    # From 168 degrees, the furthest here, a trailer's bar is within 0.03 rad after 10 s.
    assert wrap_angle_rad(alone.course_rad - leader.course_rad) == pytest.approx(0.0, abs=0.05)


def test_at_a_corner_the_slot_ahead_flies_back_and_pushes_nobody() -> None:
    """In a vee the slot inside a corner does, by the turn; the leader flies across."""
    ahead, bar = Leader(), TowBar(Slot(3.0))
    bar.update(ahead.fix(), ahead.now_s)
    ahead.course_rad, ahead.speed_mps = SOUTH + 0.4, 1.5
    for _ in range(8):
        point = bar.update(ahead.fix(), ahead.now_s, formation_mps=(0.0, 2.0))
        ahead.step()
    assert point.course_rad != pytest.approx(NORTH, abs=0.05)


def test_a_formations_bar_is_pulled_round_by_a_sharp_corner() -> None:
    """A mission's corner of 120 degrees is no way back: nobody is left ahead of the leader."""
    leader, bar = Leader(), TowBar(Slot(3.0))
    bar.update(leader.fix(), leader.now_s)
    leader.course_rad, leader.speed_mps = math.radians(120.0), 2.0
    for _ in range(80):
        point = bar.update(leader.fix(), leader.now_s, formation_mps=leader.velocity)
        leader.step()

    assert wrap_angle_rad(point.course_rad - leader.course_rad) == pytest.approx(0.0, abs=0.05)


def test_a_formation_turns_as_one_body() -> None:
    slots = [Slot(3.0), Slot(6.0, math.radians(40.0)), Slot(4.0, math.radians(-30.0))]
    bars = [TowBar(slot, 6.0) for slot in slots]
    leader, apart = Leader(), []

    for course_rad in (NORTH, EAST, SOUTH):
        leader.course_rad, leader.speed_mps = course_rad, 2.0
        for _ in range(32):
            points = [bar.update(leader.fix(), leader.now_s) for bar in bars]
            leader.step()
            assert len({point.course_rad for point in points}) == 1
            places = [ned_between(points[0].slot, point.slot) for point in points[1:]]
            apart.append([math.hypot(north, east) for north, east, _ in places])

    assert points[0].course_rad > EAST  # it did turn
    for distances in apart:
        assert distances == pytest.approx(apart[0], abs=1e-3)


def test_the_velocity_is_the_one_the_slot_moves_at() -> None:
    """Of a slot aside, too, while the bar turns: places a tick apart against the velocity."""
    leader, bar = Leader(), TowBar(Slot(4.0, math.radians(50.0)))
    leader.fly(bar, 3.0, 2.0)
    leader.course_rad = EAST

    for point, after in pairwise(leader.fly(bar, 4.0, 2.0)):
        north, east, _ = ned_between(point.slot, after.slot)
        moved_mps = north / TICK_S, east / TICK_S
        # The bar turns by 0.06 rad a tick: so much of 2.5 m/s changes meanwhile.
        assert moved_mps == pytest.approx(point.velocity_mps, abs=0.2)


@pytest.mark.parametrize("course_rad", [NORTH, EAST, SOUTH])
def test_the_bar_begins_where_the_follower_is(course_rad: float) -> None:
    """A follower that joins from the side is not sent round the leader at once."""
    leader, bar = Leader(course_rad), TowBar(Slot(3.0))
    follower = displace(START, (0.0, 5.0, 0.0))

    point = bar.update(leader.fix(), 0.0, follower)

    assert bearing_rad(leader.place, point.slot) == pytest.approx(EAST, abs=1e-3)
    assert point.yaw_rad == pytest.approx(-EAST, abs=1e-3)  # and looks at the leader


def test_the_slot_waits_for_its_follower() -> None:
    leader, bar = Leader(EAST), TowBar(Slot(3.0))
    north_of_it = displace(START, (5.0, 0.0, 0.0))
    leader.speed_mps = 2.0
    for _ in range(80):  # on the spot: only what the bar makes of the course is looked at
        point = bar.update(leader.fix(), leader.now_s, north_of_it)
        leader.now_s += TICK_S
        off_rad = wrap_angle_rad(bearing_rad(START, point.slot))
        assert abs(off_rad) <= FURTHEST_ROUND_RAD + 1e-6

    assert abs(off_rad) == pytest.approx(FURTHEST_ROUND_RAD, abs=0.05)


def test_the_slot_stands_off_where_it_is_asked_to() -> None:
    leader, bar = Leader(), TowBar(Slot(3.0, altitude_step_m=2.0))

    point = bar.update(leader.fix(), 0.0, None, 4.5)

    assert seen_from_leader(point)[0] == pytest.approx(4.5, abs=1e-3)
    assert point.slot.alt_m == pytest.approx(START.alt_m + 2.0)
    assert seen_from_leader(bar.update(leader.fix(), 0.0))[0] == pytest.approx(3.0, abs=1e-3)


def test_after_a_pause_the_bar_is_not_swung_by_it() -> None:
    leader, bar = Leader(), TowBar(Slot(3.0))
    leader.fly(bar, 2.0, 2.0)
    leader.course_rad = EAST
    leader.now_s += 30.0

    point = leader.fly(bar, TICK_S, 2.0)[-1]

    # One second at the most: 2 m/s across 3 m are 0.67 rad.
    assert point.course_rad == pytest.approx(2.0 / 3.0, abs=1e-6)
