"""Who ranges whom: what sonars know of receivers on the way from one follower to another."""

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from echowing.flight.axis import Axis
from echowing.flight.cloud import UNRANGED_SIGMA_M, Off
from echowing.flight.envelope import Answer
from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    LeaderFix,
    Slot,
)
from echowing.flight.known import FLOWN_SHARE, Known
from echowing.flight.plan import planned
from echowing.flight.session import FollowSession
from echowing.flight.steps import Allowed, Plan
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.mavlink.messages import ForApplet, Manner
from echowing.sonar_file import shipped_sonar

LEADER, AUTO = 1, 3
HERE = GlobalPosition(39.34, -86.03, 250.0)


def known(slots: Sequence[Slot]) -> Known:
    plans = [
        FollowerPlan(system_id, slot, sonar=shipped_sonar())
        for system_id, slot in enumerate(slots, LEADER + 1)
    ]
    return Known(LEADER, plans, GuidanceSettings())


def taught(follower: FollowerState, north_m: float) -> None:
    """Let its sonar hear for a minute that the receivers disagree by so much, north and south."""
    cloud = follower.estimate.offset
    for number in range(200):
        bearing = math.radians(20.0 * (number % 18))
        to_it_m = 3.0 * math.cos(bearing), 3.0 * math.sin(bearing), 0.0
        believed_m = to_it_m[0] + north_m, to_it_m[1], 0.0
        cloud.heard(0.3 * number, 3.0, Axis(bearing, 0.0), believed_m)


def test_two_that_hear_the_leader_know_where_the_other_is() -> None:
    there = known([Slot(3.0, 0.6), Slot(3.0, -0.6)])
    first, second = there.followers.values()
    raw, sigma_m = there.apart(first, second, HERE)
    assert (raw, sigma_m) == (HERE, UNRANGED_SIGMA_M), "nothing is known: as its receiver says"
    taught(first, 2.0)
    taught(second, -1.0)
    seen, sigma_m = there.apart(first, second, HERE)
    # Its receiver puts the leader 2 m too far north, the other's 1 m too far south.
    assert ned_between(HERE, seen)[0] == pytest.approx(-3.0, abs=0.3)
    assert sigma_m < 0.5 * UNRANGED_SIGMA_M
    back, _ = there.apart(second, first, HERE)
    assert ned_between(HERE, back)[0] == pytest.approx(3.0, abs=0.3)


def test_in_a_column_only_the_sonars_between_the_two_count() -> None:
    there = known([Slot(3.0), Slot(3.0, behind=0), Slot(3.0, behind=1)])
    first, second, third = there.followers.values()
    taught(second, 1.0)
    taught(third, 1.5)
    seen, sigma_m = there.apart(third, first, HERE)
    assert ned_between(HERE, seen)[0] == pytest.approx(-2.5, abs=0.3)
    assert sigma_m < 0.7 * UNRANGED_SIGMA_M, (
        "the first one's own sonar, which is deaf, is not asked"
    )


def test_heights_go_along_the_chain_as_places_do() -> None:
    """A barometer that is a metre off is so for those whose sonars only see its echo, too."""
    there = known([Slot(3.0), Slot(3.0, behind=0)])
    first, second = there.followers.values()
    for follower, off_m in ((first, (0.3, 0.0, 1.0)), (second, (0.0, 0.2, -0.4))):
        follower.position = HERE
        follower.estimate.offset.turn_to(Off(*off_m, 0.05, 0.05))
    there.leader.fix = LeaderFix(0.0, HERE, (0.0, 0.0, 0.0), 0.0)
    (leader,) = there._beside(second)
    (behind,) = there._beside(first)

    assert leader.off[:3] == pytest.approx((-0.3, 0.0, -1.0), abs=0.02)
    assert behind.off[:3] == pytest.approx((0.0, 0.2, -0.4), abs=0.02)
    assert behind.off.up_sigma_m == pytest.approx(0.05, rel=0.1)


def test_who_is_ranged_has_room_where_receivers_alone_leave_none() -> None:
    there = known([Slot(3.0), Slot(3.0, behind=0)])
    first, second = there.followers.values()
    for follower, north_m in ((first, 0.0), (second, -3.0)):
        follower.position, follower.position_at_s = displace(HERE, (north_m, 0.0, 0.0)), 60.0
    other, apart_m, unsure_m = there.least_room_m(second, 1.0, 60.0) or (None, 0.0, 0.0)
    assert other is first
    assert apart_m == pytest.approx(3.0, abs=0.1)
    assert unsure_m > 1.5
    taught(second, 0.0)
    (_, _, unsure_m) = there.least_room_m(second, 1.0, 60.0) or (None, 0.0, math.nan)
    assert unsure_m < 0.7


def test_the_leader_is_seen_over_the_whole_chain() -> None:
    there = known([Slot(3.0), Slot(3.0, behind=0)])
    first, second = there.followers.values()
    taught(first, 1.0)
    taught(second, 0.5)
    seen = there.as_seen_by(second, HERE)
    assert ned_between(HERE, seen)[0] == pytest.approx(-1.5, abs=0.3)


def test_a_slot_behind_another_moves_as_that_one_wherever_who_flies_in_it_is_not_known() -> None:
    there = known([Slot(3.0), Slot(3.0, behind=0)])
    first, second = there.followers.values()
    slot = displace(HERE, (5.0, 0.0, 0.0))
    first.position, first.velocity_mps = displace(HERE, (4.0, 1.0, 0.0)), (0.0, 3.0)
    first.guided = GuidedPoint(slot, slot, HERE, None, slot_mps=(2.0, 0.0), at_s=10.0)
    fix = there.followed_then(second, LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0), 10.5)
    assert ned_between(HERE, fix.position)[:2] == pytest.approx((6.0, 0.0), abs=0.05)
    assert fix.velocity_ned_mps == (2.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("speed_mps", "ago_s", "deaf", "least_m"),
    [
        # A report of 0.7 s and 0.2 s on its way are noticed after 0.9 s, the dead time is 0.5 s; it
        # brakes with 5 m/s2 and the leader with 2.5, so it stops shorter: by 0.1 and 0.4 m.
        (1.0, 10.0, False, 1.0 + 1.4 - 0.1),
        (2.0, 10.0, False, 1.0 + 2.8 - 0.4),
        (2.0, 1.0, False, 0.0),
        # With a sonar that is likely deaf, the leader may turn round: twice the change of speed.
        (1.0, 10.0, True, 1.0 + 2.8 - 0.4),
        # 1 + 5.6 - 1.6 m would be beyond the sonar's reach, where no leader is ever heard again.
        (4.0, 10.0, False, 3.8),
    ],
)
def test_a_leader_that_is_not_heard_gets_room_to_stop_in(
    speed_mps: float, ago_s: float, deaf: bool, least_m: float
) -> None:
    there = known([Slot(2.0)])
    (one,) = there.followers.values()
    one.handling.answer_in_calm = Answer(0.5, 5.0)
    taught(one, 0.0)
    one.estimate.offset._deaf[:] = deaf
    now_s = one.estimate._used_to_s = 59.7 + ago_s
    there.leader.oldest_s, there.leader_mode = 0.7, AUTO
    fix = there.leader.fix = LeaderFix(now_s, HERE, (speed_mps, 0.0, 0.0), 0.0)
    guided = planned(there, one, fix, now_s)
    assert math.hypot(*guided.offset_m) == pytest.approx(max(2.0, least_m), abs=0.05)


@pytest.mark.parametrize(("followers", "buckles"), [(1, True), (3, False)])
def test_a_leader_pushes_its_formation_back_as_it_is(followers: int, buckles: bool) -> None:
    """20 degrees off straight back, 2 m/s, 3 s: a lone one comes round, a line stays a line."""
    there = known([Slot(3.0, behind=n - 1 if n else None) for n in range(followers)])
    there.settings = replace(there.settings, learn_offset=False)  # no room for what is not heard
    last, velocity = list(there.followers.values())[-1], (2.0, 0.0, 0.0)
    for tick in range(33):
        now_s = 10.0 + 0.125 * tick
        if tick == 8:
            velocity = (2.0 * math.cos(math.radians(160.0)), 2.0 * math.sin(math.radians(160.0)), 0)
        fix = there.leader.fix = LeaderFix(now_s, HERE, velocity, 0.0)
        for one in there.followers.values():
            one.guided = planned(there, one, fix, now_s)
    assert last.guided is not None
    turned_deg = math.degrees(last.guided.course_rad)
    # A trailer's bearing falls from 160 degrees to 74 in 3 s at 2 m/s (`test_tow_bar`).
    assert turned_deg == pytest.approx(160.0 - 74.0 if buckles else 0.0, abs=6.0)
    assert (last.guided.slot_mps == pytest.approx(velocity[:2])) is not buckles


@pytest.mark.parametrize(("slots", "most_mps"), [([Slot(3.0)], 0.0), ([Slot(3.0)] * 2, 1.0)])
def test_who_has_another_behind_goes_back_no_faster_than_it_comes(
    slots: list[Slot], most_mps: float
) -> None:
    """Too near by 2 m: alone it goes back by the place, at once; onto another, by speed."""
    there = known([slots[0], *(replace(slot, behind=0) for slot in slots[1:])])
    follower = next(iter(there.followers.values()))
    fix = LeaderFix(10.0, HERE, (0.0, 0.0, 0.0), 0.0)
    there.leader.fix = fix
    follower.position, follower.position_at_s = displace(HERE, (-1.0, 0.0, 0.0)), 10.0
    guided = planned(there, follower, fix, 10.0)
    assert guided.velocity_mps[0] == pytest.approx(-most_mps, abs=0.05)
    back_m = ned_between(follower.position, guided.point)[0]
    assert (back_m < -1.5) is (most_mps == 0.0)


def test_with_nobody_behind_it_a_follower_holds_its_distance() -> None:
    plans = [FollowerPlan(LEADER + n, Slot(3.0, n), sonar=shipped_sonar()) for n in (1, 2)]
    session = FollowSession(LEADER, plans, GuidanceSettings())
    free, plan = Allowed(HERE, (2.0, 0.0)), Plan(HERE, (2.0, 0.0))
    for follower in session.followers.values():
        assert session._for_applet(follower, plan, free, 10.0) == ForApplet(0.0, Manner.HOLD)


def test_who_is_behind_another_follower_keeps_its_pace() -> None:
    plans = [
        FollowerPlan(LEADER + 1, Slot(3.0), sonar=shipped_sonar()),
        FollowerPlan(LEADER + 2, Slot(3.0, behind=0), sonar=shipped_sonar()),
    ]
    session = FollowSession(LEADER, plans, GuidanceSettings())
    first, second = session.followers.values()
    free = Allowed(HERE, (2.0, 0.0))
    gives_way = Allowed(HERE, (2.0, 0.0), "follower 4", makes_way=True)
    plan = Plan(HERE, (2.0, 0.0), opens_m=3.4)
    assert session._for_applet(first, plan, free, 10.0) == ForApplet(3.4, Manner.HEAD)
    assert session._for_applet(second, plan, free, 10.0) == ForApplet(3.4, Manner.KEEP_PACE)
    assert session._for_applet(second, plan, gives_way, 10.0) == ForApplet(3.4, Manner.MAKE_WAY)


def test_a_slot_is_behind_who_flies_ahead_and_moves_as_his_slot() -> None:
    there = known([Slot(3.0), Slot(3.0, behind=0)])
    first, second = there.followers.values()
    slot = displace(HERE, (5.0, 0.0, 0.0))
    first.position, first.velocity_mps = displace(HERE, (4.0, 1.0, 0.0)), (0.0, 3.0)
    first.position_at_s = 10.0
    first.guided = GuidedPoint(slot, slot, HERE, None, slot_mps=(2.0, 0.0), at_s=10.0)
    fix = there.followed_then(second, LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0), 10.0)
    off_m = ned_between(slot, fix.position)[:2]
    assert off_m == pytest.approx((-FLOWN_SHARE, FLOWN_SHARE), abs=0.05)
    assert fix.velocity_ned_mps == (2.0, 0.0, 0.0)
