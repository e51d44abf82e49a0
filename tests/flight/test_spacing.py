"""The point that is sent where others are near; how near they may come is of `test_envelope`."""

from collections.abc import Sequence

import pytest

from echowing.flight.clocks import SAY_AGAIN_S
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import LEAST_M, SURE_SIGMAS, Other
from echowing.flight.estimate import Estimate
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidedPoint
from echowing.flight.spacing import Spacing
from echowing.flight.steps import Allowed, Phase, Plan, Standing
from echowing.geo import Ned

from .told import Told, at, from_here_m
from .yard import FOLLOWER, LEADER, SECOND, Vehicle

KEPT = Limits(min_separation_m=1.0, leader_flies=False)
INTO_THE_LEADER, INTO_THE_SECOND = at(-1.0), at(0.0, -40.0)


def spacing(told: Told) -> Spacing:
    return Spacing(told.known, told.guard, told.tell)


def led(follower_north_m: float, limits: Limits | None = KEPT) -> Told:
    """A leader that hovers, and a follower that hovers south of it."""
    return Told({LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((follower_north_m, 0.0))}, limits)


def beside_a_second(behind_m: float = 6.0, phase: Phase = Phase.WATCHED) -> Told:
    """The leader is far off; a second follower hovers in front of the first."""
    ahead, first = Vehicle((0.0, -40.0)), Vehicle((-behind_m, -40.0))
    told = Told({LEADER: Vehicle((300.0, 0.0)), FOLLOWER: first, SECOND: ahead}, KEPT)
    told.known.followers[SECOND].standing = Standing(phase)
    return told


def test_a_plan_that_leaves_room_is_sent_as_it_is() -> None:
    told = led(-20.0)
    allowed = spacing(told).allowed(told.follower, Plan(at(-18.0), None), 0.0)
    assert allowed == Allowed(at(-18.0), None)
    assert told.said == []


@pytest.mark.parametrize("limits", [None, Limits(leader_flies=False)])
def test_without_a_least_separation_the_plan_is_sent_as_it_is(limits: Limits | None) -> None:
    told = led(-6.0, limits)
    allowed = spacing(told).allowed(told.follower, Plan(INTO_THE_LEADER, None), 0.0)
    assert allowed.place == INTO_THE_LEADER


def test_a_plan_into_the_leader_is_cut_short_and_said() -> None:
    told = led(-6.0)
    allowed = spacing(told).allowed(told.follower, Plan(INTO_THE_LEADER, None), 0.0)
    north_m, east_m = from_here_m(allowed.place)
    assert -6.0 < north_m < -2.0
    assert east_m == pytest.approx(0.0, abs=0.5)
    assert allowed.gives_way_to == "the leader"
    assert not allowed.makes_way
    assert told.said == [(FOLLOWER, "the leader", 0.0)]


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every sonar hears whom it looks at, so that an applet flies the points with a velocity."""
    monkeypatch.setattr(Estimate, "hears", lambda self, now_s: True)


@pytest.mark.usefixtures("heard")
def test_a_plan_with_a_velocity_keeps_its_place_and_closes_more_slowly() -> None:
    told = led(-6.0)
    allowed = spacing(told).allowed(told.follower, Plan(at(-5.0), (4.0, 0.0)), 0.0)
    assert allowed.place == at(-5.0)
    assert allowed.velocity_mps is not None
    assert allowed.velocity_mps[0] < 3.0


@pytest.mark.parametrize(("slot_mps", "sent_mps"), [(0.0, 0.001), (1.5, 1.5), (4.0, 2.23)])
def test_one_that_guided_flies_gives_way_by_its_place_at_the_velocity_of_its_slot(
    slot_mps: float, sent_mps: float
) -> None:
    """Both together are what it has to fly; of the place the applet makes 3 m/s at the most."""
    told = beside_a_second(2.8, Phase.LED)
    follower = told.follower
    place = at(-3.0, -40.0)
    follower.guided = GuidedPoint(place, place, at(0.0, -40.0), None, slot_mps=(slot_mps, 0.0))
    allowed = spacing(told).allowed(follower, Plan(at(-1.0, -40.0), (3.0, 0.0)), 0.0)
    assert allowed.velocity_mps is not None
    back_m = -2.8 - from_here_m(allowed.place)[0]
    pace_mps = follower.handling.closing.speed_mps(back_m)
    assert pace_mps <= 3.001
    assert allowed.velocity_mps[0] == pytest.approx(sent_mps, abs=0.1)
    assert allowed.velocity_mps[0] - pace_mps == pytest.approx(-0.77, abs=0.1)


@pytest.mark.usefixtures("heard")
def test_one_that_is_held_gives_way_by_its_place_alone_whatever_its_sonar_hears() -> None:
    """A point with a velocity would end the hold: its applet would keep the leader's distance."""
    told = beside_a_second(2.0, Phase.HELD)
    told.follower.standing = Standing(Phase.HELD)
    allowed = spacing(told).allowed(told.follower, Plan(at(-2.0, -40.0), (0.0, 0.0)), 0.0)
    assert allowed.gives_way_to == "follower 3"
    assert allowed.velocity_mps == (0.0, 0.0)
    assert from_here_m(allowed.place)[0] < -2.5


def test_one_that_hears_no_more_orders_soon_gives_way_no_more() -> None:
    """Of fifty behind a radio that loses half, one flew on with 5.5 m/s until it met another."""
    told = beside_a_second(2.0, Phase.LED)
    follower = told.follower
    allowed = spacing(told).allowed(follower, Plan(at(-2.0, -40.0), (0.001, 0.0)), 0.0)
    assert allowed.gives_way_to == "follower 3"
    follower.ordered(allowed, 0.0)
    assert follower.position is not None
    begins_s = follower.way_s
    moved_m, mps = follower.motion.carried_on(
        follower.position, (0.0, 0.0), begins_s, begins_s + 2.0
    )
    place_m = from_here_m(allowed.place)[0] + 2.0
    assert place_m < moved_m[0] < -0.5
    assert -1.5 < mps[0] < 0.0  # told by a velocity it was 4.3 m back by then, and flew on


@pytest.mark.usefixtures("heard")
def test_too_near_and_still_closing_the_whole_lean_goes_into_the_way_out() -> None:
    """The point is where it is, so that nothing but the velocity out is flown."""
    told = Told({LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-1.5, 0.0), (3.0, 0.0))}, KEPT)
    allowed = spacing(told).allowed(told.follower, Plan(at(-1.0), (3.0, 0.0)), 0.0)
    assert from_here_m(allowed.place) == pytest.approx((-1.5, 0.0), abs=0.01)
    assert allowed.velocity_mps is not None
    assert allowed.velocity_mps[0] < -1.0


@pytest.mark.usefixtures("heard")
def test_who_has_another_behind_backs_off_no_faster_than_it_has_to() -> None:
    """Else each in a line flies back faster than the one before: the last two came to 0.65 m."""
    backs_mps = []
    for has_one_behind in (False, True):
        told = Told(
            {
                LEADER: Vehicle((0.0, 0.0), (-0.6, 0.0)),
                FOLLOWER: Vehicle((-4.0, 0.0)),
                SECOND: Vehicle((-30.0, 0.0)),
            },
            KEPT,
        )
        if has_one_behind:
            told.known.watch({SECOND: told.follower})
            told.known.followers[SECOND].standing = Standing(Phase.LED)
        allowed = spacing(told).allowed(told.follower, Plan(at(-4.0), (0.0, 0.0)), 0.0)
        assert allowed.gives_way_to == "the leader"
        assert allowed.velocity_mps is not None
        backs_mps.append(-allowed.velocity_mps[0])
    alone_mps, in_line_mps = backs_mps
    assert 0.1 < in_line_mps < alone_mps - 0.1


def into_the_second(told: Told, step: Spacing, now_s: float) -> Allowed:
    told.now_s = now_s
    for system_id in told.vehicles:
        told.report(system_id)
    return step.allowed(told.follower, Plan(INTO_THE_SECOND, None), now_s)


def test_another_follower_is_kept_away_from_by_its_id() -> None:
    told = beside_a_second()
    allowed = into_the_second(told, spacing(told), 0.2)
    assert allowed.place != INTO_THE_SECOND
    assert allowed.gives_way_to == "follower 3"
    assert allowed.makes_way


def test_who_is_held_gives_way_to_nobody_that_is_led_past() -> None:
    told = beside_a_second()
    told.follower.standing = Standing(Phase.HELD)
    told.known.followers[SECOND].standing = Standing(Phase.LED)
    assert into_the_second(told, spacing(told), 0.2).place == INTO_THE_SECOND


def test_who_is_held_gives_way_to_one_that_its_applet_flies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """That one takes no points: nobody else can make room."""
    told = beside_a_second(phase=Phase.LED)
    told.follower.standing = Standing(Phase.HELD)
    assert told.guard is not None
    monkeypatch.setattr(told.guard, "ignores_points", lambda system_id: system_id == SECOND)
    assert into_the_second(told, spacing(told), 0.2).gives_way_to == "follower 3"


@pytest.mark.parametrize("phase", [Phase.LED, Phase.HELD])
def test_who_is_led_past_another_counts_on_its_room_only_if_that_makes_some(
    phase: Phase, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A held one gives way to nobody that is led."""
    counted: list[bool] = []

    def noted(wanted: Ned, others: Sequence[Other], *_: object) -> tuple[Ned, Other | None]:
        counted.extend(one.makes_room for one in others if one.led)
        return wanted, None

    monkeypatch.setattr("echowing.flight.spacing.keep_apart", noted)
    told = beside_a_second(2.0, phase)
    told.follower.standing = Standing(Phase.LED)
    spacing(told).allowed(told.follower, Plan(at(-2.0, -40.0), None), 0.0)
    assert counted == [phase is Phase.LED]


def test_two_that_are_held_keep_apart() -> None:
    """Fifty were held as their leader was stale: two that had come near each other met so."""
    told = beside_a_second()
    for one in told.known.followers.values():
        one.standing = Standing(Phase.HELD)
    allowed = into_the_second(told, spacing(told), 0.2)
    assert allowed.gives_way_to == "follower 3"


def test_a_way_that_is_given_again_and_again_is_said_once_in_a_while() -> None:
    told = beside_a_second()
    step = spacing(told)
    for now_s in (0.2, 1.0, 2.0, SAY_AGAIN_S, SAY_AGAIN_S + 1.0):
        into_the_second(told, step, now_s)
        told.follower.allowed = None
    assert told.said == [
        (FOLLOWER, "follower 3", 0.2),
        (FOLLOWER, "follower 3", SAY_AGAIN_S + 1.0),
    ]


def test_who_gives_way_to_another_one_says_so_at_once() -> None:
    ahead, behind = Vehicle((0.0, -40.0)), Vehicle((-12.0, -40.0))
    told = Told({LEADER: behind, FOLLOWER: Vehicle((-6.0, -40.0)), SECOND: ahead}, KEPT)
    step = spacing(told)
    into_the_second(told, step, 0.2)
    step.allowed(told.follower, Plan(at(-11.0, -40.0), None), 0.2)
    assert told.said == [(FOLLOWER, "follower 3", 0.2), (FOLLOWER, "the leader", 0.2)]


@pytest.mark.usefixtures("heard")
def test_of_what_one_ahead_flies_and_is_ordered_the_worse_counts() -> None:
    """It flies on; its applet flies it back, whatever it is ordered; or it is ordered back."""
    told = beside_a_second()
    second, follower = told.known.followers[SECOND], told.follower
    second.standing = follower.standing = Standing(Phase.LED)
    plan = Plan(at(-5.0, -40.0), (1.5, 0.0))
    flown = []
    for its_mps, ordered_mps in ((1.5, 1.5), (-1.5, 1.5), (1.5, -1.5)):
        told.vehicles[SECOND].velocity_mps = its_mps, 0.0
        told.now_s += 0.1
        for system_id in told.vehicles:
            told.report(system_id)
        second.not_ordered()
        second.ordered(Allowed(at(0.0, -40.0), (ordered_mps, 0.0)), told.now_s)
        allowed = spacing(told).allowed(follower, plan, told.now_s + 0.5)
        assert allowed.velocity_mps is not None
        flown.append(allowed.velocity_mps[0])
    assert max(flown[1:]) < flown[0] - 1.0


def test_one_that_its_sonar_looks_at_is_its_applets_and_others_are_the_tools() -> None:
    """The applet knows that one alone: led past it by the tool it flew back at 1.9 m/s (SITL)."""
    told = beside_a_second()
    assert into_the_second(told, spacing(told), 0.2).makes_way
    told.known.watch({told.follower.plan.system_id: told.known.followers[SECOND]})
    watched = into_the_second(told, spacing(told), 0.4)
    assert watched.gives_way_to == "follower 3"
    assert not watched.makes_way


@pytest.mark.usefixtures("heard")
def test_a_point_far_back_does_not_count_as_flown_to_by_the_applet_of_one_in_a_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It takes the place from the sonar, and no more than 0.4 m/s: the velocity has to say it."""
    told = beside_a_second()
    second, follower = told.known.followers[SECOND], told.follower
    second.standing = follower.standing = Standing(Phase.LED)
    monkeypatch.setattr(
        type(told.known), "seen", lambda self, one, here, other, there, m: (there, 0.3)
    )
    told.known.watch({follower.plan.system_id: second})
    told.vehicles[SECOND].at_m, told.vehicles[SECOND].velocity_mps = (-3.8, -40.0), (-1.5, 0.0)
    told.now_s += 0.1
    for system_id in told.vehicles:
        told.report(system_id)
    allowed = spacing(told).allowed(follower, Plan(at(-8.5, -40.0), (0.3, 0.0)), told.now_s)
    assert allowed.gives_way_to == "follower 3"
    assert allowed.velocity_mps is not None
    assert allowed.velocity_mps[0] < -0.4


def test_who_has_not_heard_yet_keeps_no_further_from_the_leader_than_receivers_demand() -> None:
    """By the sonars between it was 5.0 m: the last of a diamond never came to where it hears."""
    for room_m, gives_way in ((0.3, False), (-0.3, True)):
        far_m = LEAST_M + SURE_SIGMAS * UNRANGED_SIGMA_M + room_m
        told = Told(
            {
                LEADER: Vehicle((0.0, 0.0)),
                FOLLOWER: Vehicle((-far_m, 0.0)),
                SECOND: Vehicle((-far_m, 20.0)),
            },
            KEPT,
        )
        told.known.watch({FOLLOWER: told.known.followers[SECOND]})
        allowed = spacing(told).allowed(told.follower, Plan(at(-far_m), (0.0, 0.0)), 0.0)
        assert (allowed.gives_way_to == "the leader") is gives_way
