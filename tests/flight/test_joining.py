"""Followers come into their slots one after the other."""

import math
from dataclasses import replace

import pytest
from tests.flight.test_chain import HERE, known, taught

from echowing.flight.cloud import SURE_AFTER_S
from echowing.flight.follower import FollowerState
from echowing.flight.formation import receivers_demand_m
from echowing.flight.guidance import LeaderFix, Slot
from echowing.flight.joining import JOINS_WITHIN_S, Joining
from echowing.flight.known import Known
from echowing.flight.plan import planned
from echowing.flight.steps import Phase, Standing, Turn
from echowing.geo import displace

# The third is 3 m behind the first, and 6 m from the second.
VEE = [Slot(3.0, 0.6), Slot(3.0, -0.6), Slot(3.0, 0.6, behind=0)]


def led(there: Known) -> list[FollowerState]:
    followers = list(there.followers.values())
    for one in followers:
        one.standing = Standing(Phase.LED)
    return followers


def hears(follower: FollowerState, now_s: float, sigma_m: float = 0.3) -> None:
    follower.estimate.offset._heard_at_s = follower.estimate._used_to_s = now_s
    follower.estimate.offset.level_sigma_m = sigma_m


def listens(follower: FollowerState, now_s: float) -> None:
    """It hears nothing in its reach."""
    follower.estimate.heard(now_s, 7.65)


def test_each_waits_for_its_neighbours_before_it() -> None:
    there = known(VEE)
    first, second, third = led(there)
    listens(first, 0.0)
    joining = Joining(there)
    assert [joining.waits_for(one, 1.0) for one in (first, second, third)] == [None, first, first]
    hears(first, 2.0)
    assert [joining.waits_for(one, 2.0) for one in (first, second, third)] == [None, None, None]
    # Who has joined has joined, also while his sonar hears nothing.
    hears(second, 3.0)
    joining.waits_for(second, 3.0)
    second.estimate.forget()
    assert joining.waits_for(third, 60.0) is joining.waits_for(second, 60.0) is None


@pytest.mark.parametrize("phase", [Phase.WATCHED, Phase.HELD, Phase.LEFT])
def test_nobody_waits_for_one_that_is_not_led(phase: Phase) -> None:
    there = known(VEE)
    first, second, _ = led(there)
    first.standing = Standing(phase)
    assert Joining(there).waits_for(second, 1.0) is None


def test_who_comes_in_expects_what_the_others_sonars_tell_and_that_is_no_reading() -> None:
    """Of two receivers that disagree by 3 m each is off by half of it, the first to the south."""
    there = known([Slot(3.0), Slot(3.0, behind=0), Slot(3.0, behind=1)])
    first, second, third = led(there)
    taught(first, 3.0)
    first.turn.joined = True
    joining = Joining(there)
    for now_s in (60.0, 60.1, 60.2):  # as its pilot leaves Guided and comes back
        second.turn = Turn()
        joining.waits_for(second, now_s)
        offset = second.estimate.offset
        assert offset.north_m == pytest.approx(-1.5, abs=0.2)
        assert offset.level_sigma_m == pytest.approx(math.sqrt(1.5) * 0.8, abs=0.1)
    there.expect(third)
    assert third.estimate.offset.north_m == pytest.approx(0.0, abs=0.1)


def test_who_does_not_find_his_leader_keeps_off_for_a_while_and_tries_again() -> None:
    there = known(VEE)
    first, second, _ = led(there)
    joining = Joining(there)
    late_s = 2.0 * JOINS_WITHIN_S
    for now_s, tries in (
        *((0.0, True), (JOINS_WITHIN_S - 0.1, True), (JOINS_WITHIN_S + 0.1, False)),
        *((late_s - 0.1, False), (late_s + 0.1, True)),
    ):
        listens(first, now_s)
        assert joining.waits_for(first, now_s) is None
        assert first.turn.waits is first.turn.gave_up is not tries
        # Meanwhile the next one comes in.
        assert (joining.waits_for(second, now_s) is first) is tries
    hears(first, late_s + 1.0)
    joining.waits_for(first, late_s + 1.0)
    assert (first.turn.joined, first.turn.waits, first.turn.gave_up) == (True, False, False)


def test_without_readings_of_its_sonar_nobody_comes_nearer_than_receivers_allow() -> None:
    there = known([Slot(3.0), Slot(9.0)])
    follower, _ = led(there)
    Joining(there).waits_for(follower, 0.0)
    fix = LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0)
    offset_m = planned(there, follower, fix, 10.0).offset_m
    assert abs(complex(*offset_m)) == pytest.approx(receivers_demand_m(1.0), abs=0.01)


def test_a_pair_comes_together_without_a_sonar_as_with_a_deaf_one() -> None:
    there = known([Slot(3.0)])
    (follower,) = led(there)
    joining = Joining(there)
    for now_s in (0.0, JOINS_WITHIN_S + 0.1, 3.0 * JOINS_WITHIN_S):
        joining.waits_for(follower, now_s)
        assert follower.turn.waits is False


def test_an_echo_that_does_not_tell_where_the_leader_is_lets_nobody_in() -> None:
    there = known(VEE)
    first, *_ = led(there)
    joining = Joining(there)
    for sigma_m, joined in ((1.5, False), (0.5, True)):
        hears(first, 1.0, sigma_m)
        joining.waits_for(first, 1.0)
        assert first.turn.joined is joined


def test_who_may_have_found_another_one_has_not_joined_until_that_is_looked_for() -> None:
    there = known(VEE)
    first, *_ = led(there)
    joining = Joining(there)
    first.estimate._elsewhere_m = [(0.0, -3.0, 0.0)]
    for now_s, joined in ((1.0, False), (SURE_AFTER_S + 0.9, False), (SURE_AFTER_S + 1.1, True)):
        hears(first, now_s)
        first.estimate.offset._found_at_s = 1.0
        joining.waits_for(first, now_s)
        assert first.turn.joined is joined


def test_slots_as_far_apart_as_receivers_demand_are_joined_at_once() -> None:
    there = known([Slot(3.0), Slot(3.1 + receivers_demand_m(1.0))])
    first, second = led(there)
    joining = Joining(there)
    assert joining.waits_for(first, 0.0) is joining.waits_for(second, 0.0) is None


def test_without_sonars_nobody_would_ever_have_joined() -> None:
    there = known(VEE)
    there.settings = replace(there.settings, learn_offset=False)
    assert [Joining(there).waits_for(one, 0.0) for one in led(there)] == [None] * 3


@pytest.mark.parametrize(
    ("slots", "after_s", "radius_m"),
    [
        # A metre in 4 s, until what is known of the leader is less: of what receivers may be off by
        # one in 160 is within a metre of the way there, and nearer.
        (VEE, 0.0, receivers_demand_m(1.0)),
        (VEE, 2.0, receivers_demand_m(1.0) - 0.5),
        (VEE, 10.0, None),
        ([Slot(3.0)], 0.0, None),  # it can take nobody for another one
    ],
)
def test_who_has_not_found_whom_he_follows_comes_in_slowly(
    slots: list[Slot], after_s: float, radius_m: float | None
) -> None:
    """radius_m: None is as its guesses have it, whose draw has a standard deviation of 0.25 m."""
    there = known(slots)
    first, *_ = led(there)
    joining = Joining(there)
    for now_s in (10.0 - after_s, 10.0):
        listens(first, now_s)
        joining.waits_for(first, now_s)
    fix = LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0)
    first.position, first.position_at_s = displace(HERE, (-9.0, 0.0, 0.0)), 10.0
    offset_m = planned(there, first, fix, 10.0).offset_m
    by_guesses_m = there.nearest_m(first, (9.0, 0.0), there.settings.clearance_m)
    wanted_m = by_guesses_m if radius_m is None else radius_m
    assert abs(complex(*offset_m)) == pytest.approx(wanted_m, abs=0.1)
    assert by_guesses_m == pytest.approx(4.2, abs=0.5)


def test_who_has_found_him_does_not() -> None:
    there = known(VEE)
    first, *_ = led(there)
    hears(first, 10.0)
    Joining(there).waits_for(first, 10.0)
    fix = LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0)
    first.position, first.position_at_s = displace(HERE, (-9.0, 0.0, 0.0)), 10.0
    offset_m = planned(there, first, fix, 10.0).offset_m
    assert abs(complex(*offset_m)) < receivers_demand_m(1.0) - 0.5


def test_who_tries_again_comes_in_slowly_again() -> None:
    there = known(VEE)
    first, *_ = led(there)
    joining = Joining(there)
    for now_s in (0.0, JOINS_WITHIN_S + 1.0, 2.0 * JOINS_WITHIN_S + 1.0):
        listens(first, now_s)
        joining.waits_for(first, now_s)
    assert not first.turn.waits
    assert first.turn.seeks_at_s == now_s


def test_who_hears_him_as_his_time_is_up_goes_on() -> None:
    there = known(VEE)
    first, *_ = led(there)
    joining = Joining(there)
    for now_s in (0.0, JOINS_WITHIN_S + 1.0):
        listens(first, now_s)
        hears(first, now_s, sigma_m=1.5)
        joining.waits_for(first, now_s)
    assert (first.turn.joined, first.turn.gave_up) == (False, False)


def test_who_waits_is_led_as_far_off_as_receivers_alone_allow() -> None:
    there = known(VEE)
    _, second, _ = led(there)
    fix = LeaderFix(10.0, HERE, (2.0, 0.0, 0.0), 0.0)
    second.turn.waits = True
    offset_m = planned(there, second, fix, 10.0).offset_m
    assert abs(complex(*offset_m)) == pytest.approx(receivers_demand_m(1.0), abs=0.01)
