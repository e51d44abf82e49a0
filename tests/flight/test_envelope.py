import math
import tomllib
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import (
    FASTEST_MPS,
    LEAST_M,
    OTHERS_MPS2,
    RETREAT_MOST_MPS,
    SURE_SIGMAS,
    Answer,
    Other,
    certain_distance_m,
    closing_limit_mps,
    is_in_the_way,
    keep_apart,
    straight_out,
)
from echowing.geo import Ned

ANSWER = Answer()
QUICK = Answer(0.47, 5.0)  # with the limits that `setup` recommends
EPS_MPS = 1e-4

angles = st.floats(-math.pi, math.pi)
distances = st.floats(0.05, 30.0)
speeds = st.floats(0.0, 6.0)


def level(bearing_rad: float, length: float) -> Ned:
    return length * math.cos(bearing_rad), length * math.sin(bearing_rad), 0.0


velocities = st.builds(level, angles, speeds)
others = st.builds(
    Other,
    name=st.just("another"),
    from_it_m=st.builds(level, angles, distances),
    velocity_mps=velocities,
    nearer_m=st.floats(0.0, 3.0),
    age_s=st.floats(0.0, 1.5),
    in_the_way=st.booleans(),
)
always = settings(max_examples=150, deadline=None, derandomize=True)


def leaving_mps(flown: Ned, other: Other) -> float:
    """How fast the horizontal distance to another grows."""
    north, east, _ = other.from_it_m
    gained = flown[0] - other.velocity_mps[0], flown[1] - other.velocity_mps[1]
    return (gained[0] * north + gained[1] * east) / math.hypot(north, east)


def limit_mps(other: Other) -> float:
    return closing_limit_mps(certain_distance_m(other), ANSWER)


# ---- the two figures -----


def test_what_is_not_known_is_against_us() -> None:
    other = Other("leader", (3.0, 0.0, 4.0), (0.0, 0.0, 0.0), nearer_m=1.0, age_s=0.8)

    least_m = 5.0 - SURE_SIGMAS * 0.4 - 0.5 * OTHERS_MPS2 * 0.8**2
    assert certain_distance_m(other) == pytest.approx(least_m)
    assert certain_distance_m(replace(other, age_s=1.0)) < least_m
    assert certain_distance_m(replace(other, nearer_m=1.25)) < least_m


@pytest.mark.parametrize("certain_m", [1.0, 1.2, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("answer", [Answer(), Answer(0.3, 4.0), Answer(1.2, 1.0)])
def test_a_vehicle_at_the_limit_stops_in_time(certain_m: float, answer: Answer) -> None:
    """Dead time at that speed, then braking: it stands exactly at the least distance."""
    speed_mps = closing_limit_mps(certain_m, answer)
    way_m = speed_mps * answer.dead_s + speed_mps**2 / (2.0 * answer.decel_mps2)

    assert certain_m - way_m == pytest.approx(LEAST_M, abs=1e-6)


VECTORS = tomllib.loads((Path(__file__).parent / "envelope.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("one", VECTORS["closing"])
def test_the_limit_is_the_one_of_the_table(one: dict[str, float]) -> None:
    answer = Answer(one["dead_s"], one["decel_mps2"])

    assert closing_limit_mps(one["certain_m"], answer, one["least_m"]) == pytest.approx(
        one["limit_mps"], abs=1e-4
    )


def test_nearer_than_the_least_distance_it_is_left() -> None:
    assert closing_limit_mps(0.5, ANSWER) == pytest.approx(-0.75)
    assert closing_limit_mps(-30.0, ANSWER) == -RETREAT_MOST_MPS
    assert closing_limit_mps(1.0, ANSWER) == pytest.approx(0.0, abs=1e-9)


@given(near_m=st.floats(-5.0, 30.0), more_m=st.floats(0.0, 5.0))
@always
def test_more_room_never_means_less_speed(near_m: float, more_m: float) -> None:
    assert closing_limit_mps(near_m + more_m, ANSWER) >= closing_limit_mps(near_m, ANSWER)


# ---- what is flown -----


@given(wanted=velocities, other=others)
@always
def test_nobody_is_closed_on_faster_than_the_limit(wanted: Ned, other: Other) -> None:
    flown, _ = keep_apart(wanted, [other], ANSWER)

    assert -leaving_mps(flown, other) <= limit_mps(other) + EPS_MPS


@given(wanted=velocities, other=others)
@always
def test_a_short_distance_is_never_shortened(wanted: Ned, other: Other) -> None:
    assume(certain_distance_m(other) < LEAST_M)
    flown, _ = keep_apart(wanted, [other], ANSWER)

    assert leaving_mps(flown, other) > -EPS_MPS


@given(wanted=velocities, about=st.lists(others, max_size=4))
@always
def test_a_plan_that_keeps_the_limits_is_flown_as_it_is(wanted: Ned, about: list[Other]) -> None:
    fits = all(-leaving_mps(wanted, other) <= limit_mps(other) for other in about)
    flown, whose = keep_apart(wanted, about, ANSWER)

    assert (whose is None) is fits
    if fits:
        assert flown == wanted


@given(wanted=velocities, other=others, turn_rad=angles)
@always
def test_all_directions_are_alike(wanted: Ned, other: Other, turn_rad: float) -> None:
    def turned(vector: Ned) -> Ned:
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos, vector[2]

    flown, _ = keep_apart(wanted, [other], ANSWER)
    again = replace(
        other, from_it_m=turned(other.from_it_m), velocity_mps=turned(other.velocity_mps)
    )
    assert keep_apart(turned(wanted), [again], ANSWER)[0] == pytest.approx(turned(flown), abs=1e-5)


def test_from_one_that_only_the_tool_knows_it_flies_back_half_as_fast() -> None:
    """Its answer is a second late, and 1.5 m/s for each metre would swing.

    Among fifty behind radios that lose half (`many`) neighbours swung by 2.5 m/s; where led ones
    flew back from held ones in full two of three flights came to 0.79 and 1.08 m, not to 2 m.
    """
    one = Other("another", (1.5, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.0, led=True)

    def retreat_mps(other: Other) -> float:
        return keep_apart((0.0, 0.0, 0.0), [other], ANSWER)[0][0]

    alone_mps = -closing_limit_mps(0.5, ANSWER)
    assert retreat_mps(one) == pytest.approx(alone_mps / 2.0, abs=EPS_MPS)
    for other in (replace(one, led=False), replace(one, watched=True)):
        assert retreat_mps(other) == pytest.approx(alone_mps, abs=EPS_MPS)


def test_past_a_vehicle_the_plan_is_bent_not_stopped() -> None:
    """A leader 2 m ahead, the plan 60 degrees to its side: what leads aside is flown in full."""
    leader = Other("the leader", (-2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)

    flown, whose = keep_apart((2.0, 3.5, 0.5), [leader], ANSWER)

    assert whose is leader
    assert flown[1:] == (3.5, 0.5)
    assert flown[0] == pytest.approx(closing_limit_mps(2.0, ANSWER), abs=1e-5)


def test_a_leader_that_flies_back_is_backed_away_from() -> None:
    leader = Other("the leader", (-1.2, 0.0, 0.0), (-2.0, 0.0, 0.0), 0.0, 0.0)

    flown, _ = keep_apart((0.0, 0.0, 0.0), [leader], ANSWER)

    assert flown[0] == pytest.approx(-2.0 + closing_limit_mps(1.2, ANSWER), abs=1e-5)


def test_the_worst_of_several_is_named() -> None:
    near = Other("follower 3", (-1.1, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
    far = Other("the leader", (-3.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)

    assert keep_apart((4.0, 0.0, 0.0), [far, near], ANSWER)[1] is near


@pytest.mark.parametrize("turn_rad", [0.0, 0.02, -0.02])
def test_between_two_that_come_from_both_sides_it_goes_aside(turn_rad: float) -> None:
    """Back from the one is towards the other: across is what leaves most, on the right or not."""
    from_north = Other("a", (-1.0, 0.0, 0.0), (-2.0, 0.0, 0.0), 0.0, 0.0)
    from_south = Other("b", level(turn_rad, 1.0), level(turn_rad, 2.0), 0.0, 0.0)

    flown, _ = keep_apart((0.0, 0.0, 0.0), [from_north, from_south], ANSWER)

    assert abs(flown[0]) < 0.2
    assert math.copysign(flown[1], turn_rad) == pytest.approx(flown[1])
    assert abs(flown[1]) == pytest.approx(FASTEST_MPS, abs=0.01)


def test_where_nothing_fits_one_that_makes_room_does_so() -> None:
    """The leader backs onto it, another is close behind: it may count on that one's moving off."""
    leader = Other("the leader", (-1.2, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.0, 0.0)
    behind = Other("follower 3", (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), 2.5, 0.4)

    alone, _ = keep_apart((0.0, 0.0, 0.0), [leader], ANSWER)
    held, _ = keep_apart((0.0, 0.0, 0.0), [leader, behind], ANSWER)
    led, _ = keep_apart((0.0, 0.0, 0.0), [leader, replace(behind, makes_room=True)], ANSWER)

    assert led == alone
    assert held[0] > alone[0] + 0.3


@pytest.mark.parametrize("turn_rad", [0.2, -0.2])
def test_rather_than_fly_out_aside_it_counts_on_one_behind_that_can_brake(turn_rad: float) -> None:
    """The leader backs onto it, and the next one is behind it, 11 degrees aside, and makes room."""
    leader = Other("the leader", (-1.2, 0.0, 0.0), (-2.0, 0.0, 0.0), 0.0, 0.0)
    behind = Other("follower 3", level(turn_rad, 2.0), (0.0, 0.0, 0.0), 0.0, 0.0)

    aside, _ = keep_apart((0.0, 0.0, 0.0), [leader, behind], ANSWER)
    limp, _ = keep_apart(
        (0, 0, 0), [leader, replace(behind, makes_room=True, stops_mps2=0.0)], ANSWER
    )
    led, _ = keep_apart(
        (0, 0, 0), [leader, replace(behind, makes_room=True, stops_mps2=5.0)], ANSWER
    )

    assert abs(aside[1]) > 2.0
    assert abs(led[1]) < 0.6 * abs(aside[1])
    assert limp == pytest.approx(aside, abs=0.01)


def test_what_one_alone_calls_for_takes_nothing_off_the_plan_across_it() -> None:
    """However fast that is: a follower keeps on turning with its leader while it backs off."""
    leader = Other("the leader", (1.0, 0.0, 0.0), (5.0, 0.0, 0.0), 0.0, 0.0)

    flown, _ = keep_apart((0.0, 4.0, 0.0), [leader], ANSWER)

    assert flown == pytest.approx((5.0, 4.0, 0.0), abs=EPS_MPS)


def test_the_plan_is_changed_by_no_more_than_vehicles_correct_or_one_alone_calls_for() -> None:
    """Of two walls nearly opposite the corner lies far out: nobody is sent there."""
    ahead = Other("a", level(0.0, 1.0), (1.0, 0.0, 0.0), 0.0, 0.0)
    behind = Other("b", level(math.pi - 0.1, 1.0), (-1.0, 0.0, 0.0), 0.0, 0.0)

    flown, _ = keep_apart((0.0, 0.0, 0.0), [ahead, behind], ANSWER)

    # What rounding leaves of a breach (1e-6) is twenty times as much across.
    assert math.hypot(*flown) == pytest.approx(FASTEST_MPS, abs=EPS_MPS)


@pytest.mark.parametrize("apart_deg", [100.0, 120.0, 134.0])
def test_what_two_on_different_sides_leave_is_flown(apart_deg: float) -> None:
    """The way out from the one is along the edge of the other's: a little more is called for."""
    coming = Other("a", (-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.0, 0.0)
    still = Other("b", level(math.radians(180.0 + apart_deg), 1.0), (0.0, 0.0, 0.0), 0.0, 0.0)

    flown, _ = keep_apart((0.0, 0.0, 0.0), [coming, still], ANSWER)

    for other in (coming, still):
        closing_mps = sum(
            (its - own) * away / math.hypot(*other.from_it_m)
            for its, own, away in zip(other.velocity_mps, flown, other.from_it_m, strict=True)
        )
        assert closing_mps <= closing_limit_mps(1.0, ANSWER) + EPS_MPS


def test_one_in_two_places_calls_for_no_more_than_in_one() -> None:
    """Where a receiver has jumped nobody knows which place is right: both count."""
    sides = [Other(str(n), (n, 0.0, 0.0), (2.0 * n, 0.0, 0.0), 0.0, 0.0) for n in (-1.0, 1.0)]

    flown, _ = keep_apart((0.0, 0.0, 0.0), 3 * sides, ANSWER)

    assert math.hypot(*flown) <= FASTEST_MPS


def test_the_way_out_never_leads_through_the_one_that_comes_nearer() -> None:
    """Beyond it there is most room a second later: a follower flew there, 0.7 m past its leader."""
    leader = Other("the leader", (-2.0, 0.0, 0.0), (-2.0, 0.0, 0.0), nearer_m=0.5, age_s=0.5)
    behind = Other("follower 3", (5.9, 0.0, 0.0), (0.0, 0.0, 0.0), UNRANGED_SIGMA_M, age_s=0.5)

    flown, _ = keep_apart((0.5, 0.0, 0.0), [leader, behind], QUICK, own_mps=(0.5, 0.0, 0.0))

    assert flown[0] < -1.0


# ---- two vehicles, closed loop -----


class Flyer:
    """A vehicle in a plane that flies at what it is told, 0.2 s and 2.5 m/s2 later."""

    def __init__(self, place_m: tuple[float, float], goal_m: tuple[float, float]) -> None:
        self.place_m, self.goal_m = place_m, goal_m
        self.velocity: Ned = (0.0, 0.0, 0.0)
        self.told: Ned = (0.0, 0.0, 0.0)

    def wanted(self) -> Ned:
        north, east = self.goal_m[0] - self.place_m[0], self.goal_m[1] - self.place_m[1]
        far_m = math.hypot(north, east)
        pace = min(1.0, 2.0 / max(far_m, 1e-6))
        return pace * north, pace * east, 0.0

    def step(self, seconds: float) -> None:
        north, east, _ = (told - now for told, now in zip(self.told, self.velocity, strict=True))
        share = min(1.0, 2.5 * seconds / max(math.hypot(north, east), 1e-6))
        self.velocity = (
            self.velocity[0] + share * north,
            self.velocity[1] + share * east,
            0.0,
        )
        self.place_m = (
            self.place_m[0] + self.velocity[0] * seconds,
            self.place_m[1] + self.velocity[1] * seconds,
        )


def seen(other: Flyer, by: Flyer) -> Other:
    from_it = by.place_m[0] - other.place_m[0], by.place_m[1] - other.place_m[1], 0.0
    to_goal = by.goal_m[0] - by.place_m[0], by.goal_m[1] - by.place_m[1], 0.0
    in_the_way = is_in_the_way((-from_it[0], -from_it[1], 0.0), to_goal)
    return Other("the other", from_it, other.velocity, 0.3, 0.2, in_the_way)


def fly(flyers: list[Flyer], seconds: float) -> float:
    """All of them for so long; returns how near two of them came."""
    nearest_m = math.inf
    for _ in range(round(seconds / 0.05)):
        for one in flyers:
            others = [seen(other, one) for other in flyers if other is not one]
            one.told = keep_apart(one.wanted(), others, ANSWER)[0]
        for one in flyers:
            one.step(0.05)
        pairs = combinations(flyers, 2)
        nearest_m = min(nearest_m, *(math.dist(a.place_m, b.place_m) for a, b in pairs))
    return nearest_m


def off_goal_m(one: Flyer) -> float:
    return math.dist(one.place_m, one.goal_m)


@pytest.mark.parametrize("aside_m", [0.0, 0.001, -0.001, 0.3, -0.3, 1.0, -1.0])
@pytest.mark.parametrize("start_m", [4.0, 8.0, 12.0])
def test_two_head_on_pass_each_other(start_m: float, aside_m: float) -> None:
    """Each where the other wants to be: neither waits for ever, and they stay apart.

    12 m at 2 m/s and the way round take 10 s; 20 s are enough for all.
    """
    here, there = (0.0, 0.0), (start_m, aside_m)
    one, two = Flyer(here, there), Flyer(there, here)

    nearest_m = fly([one, two], 20.0)

    assert max(off_goal_m(one), off_goal_m(two)) < 0.3
    assert nearest_m > LEAST_M


@pytest.mark.parametrize("count", [3, 4])
def test_several_that_cross_in_one_place_pass_each_other(count: int) -> None:
    """On a circle, each to the opposite side."""
    places = [level(math.tau * number / count, 8.0)[:2] for number in range(count)]
    flyers = [Flyer(place, (-place[0], -place[1])) for place in places]

    nearest_m = fly(flyers, 60.0)

    assert max(map(off_goal_m, flyers)) < 0.3
    assert nearest_m > LEAST_M


def test_one_that_stands_in_the_way_is_flown_round() -> None:
    one, two = Flyer((0.0, 0.0), (8.0, 0.0)), Flyer((4.0, 0.0), (4.0, 0.0))

    nearest_m = fly([one, two], 30.0)

    assert off_goal_m(one) < 0.3
    assert nearest_m > LEAST_M


@pytest.mark.parametrize(
    ("to_it", "to_goal", "in_the_way"),
    [
        ((4.0, 0.0, 0.0), (8.0, 0.0, 0.0), True),
        ((4.0, 2.0, 0.0), (8.0, 0.0, 0.0), True),
        ((4.0, 0.0, 0.0), (1.0, 0.0, 0.0), False),  # it is beyond the goal
        ((-4.0, 0.0, 0.0), (8.0, 0.0, 0.0), False),  # it is behind
        ((4.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # nowhere to go
    ],
)
def test_in_the_way_is_what_lies_before_the_goal(
    to_it: Ned, to_goal: Ned, in_the_way: bool
) -> None:
    assert is_in_the_way(to_it, to_goal) is in_the_way


def test_what_is_beyond_the_goal_is_not_flown_round() -> None:
    """A leader, or a follower in the next slot: what is too fast towards it is slowed, no more."""
    leader = Other("the leader", (-2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.3, 0.2)

    flown, _ = keep_apart((3.0, 0.0, 0.0), [leader], ANSWER)

    assert flown[1] == 0.0


# ---- a leader that brakes -----


@pytest.mark.parametrize("certain_m", [1.8, 2.5, 4.0, 8.0])
@pytest.mark.parametrize("answer", [Answer(0.5, 5.0), Answer(0.6, 4.0)])
def test_at_the_limit_a_leader_that_brakes_and_turns_round_is_not_met(
    certain_m: float, answer: Answer
) -> None:
    """Flown in steps: the leader brakes at once and on, the follower after its dead time."""
    closing_mps = closing_limit_mps(certain_m, answer, LEAST_M, OTHERS_MPS2)
    left_m, t_s, step_s = certain_m, 0.0, 1e-4
    least_m = left_m
    while t_s < answer.dead_s or closing_mps > 0.0:
        closing_mps += (OTHERS_MPS2 - (answer.decel_mps2 if t_s >= answer.dead_s else 0.0)) * step_s
        left_m -= closing_mps * step_s
        least_m, t_s = min(least_m, left_m), t_s + step_s

    assert least_m == pytest.approx(LEAST_M, abs=0.01)


def test_a_leader_that_may_brake_is_closed_on_more_slowly_than_one_that_stands() -> None:
    quick = Answer(0.5, 5.0)
    braking = closing_limit_mps(3.0, quick, LEAST_M, OTHERS_MPS2)
    assert 0.0 < braking < 0.5 * closing_limit_mps(3.0, quick)


def test_a_vehicle_no_quicker_than_its_leader_counts_on_its_slot() -> None:
    """No distance is enough for one that brakes no harder: `least_slot_m` keeps it away."""
    assert closing_limit_mps(3.0, ANSWER, LEAST_M, OTHERS_MPS2) == closing_limit_mps(3.0, ANSWER)


def test_what_is_closed_too_fast_is_braked_besides() -> None:
    other = Other("leader", (-3.0, 0.0, 0.0), (0.0, 0.0, 0.0), nearer_m=0.0, age_s=0.0)
    limit = closing_limit_mps(3.0, ANSWER)
    slow, _ = keep_apart((limit, 0.0, 0.0), [other], ANSWER, own_mps=(limit, 0.0, 0.0))
    fast, _ = keep_apart((limit, 0.0, 0.0), [other], ANSWER, own_mps=(limit + 1.0, 0.0, 0.0))
    assert slow[0] == pytest.approx(limit, abs=EPS_MPS)
    assert fast[0] == pytest.approx(limit - 1.0, abs=EPS_MPS)


def test_nothing_is_braked_besides_for_another_that_is_led() -> None:
    """In a line each would fly back faster than the one before it."""
    other = Other("ahead", (-3.0, 0.0, 0.0), (0.0, 0.0, 0.0), nearer_m=0.0, age_s=0.0, led=True)
    limit = closing_limit_mps(3.0, ANSWER)
    flown, _ = keep_apart((9.0, 0.0, 0.0), [other], ANSWER, own_mps=(limit + 1.0, 0.0, 0.0))
    assert flown[0] == pytest.approx(limit, abs=EPS_MPS)


# ---- far too fast: all the lean goes into the way out -----

AHEAD = Other("the leader", (-3.0, 0.0, 0.0), (-2.0, 0.0, 0.0), nearer_m=0.25, age_s=0.2)
ASIDE_MPS = (-4.0, 1.5, 0.3)  # north as the envelope wants it, east as the plan does


def test_far_too_fast_it_changes_nothing_across_the_way_out() -> None:
    flown = straight_out(ASIDE_MPS, AHEAD, [AHEAD], ANSWER, LEAST_M, (2.0, -0.4, 0.0))

    assert flown == pytest.approx((-4.0, -0.4, 0.3))


@pytest.mark.parametrize(
    ("own_mps", "in_the_way"),
    [((-4.0, -0.4, 0.0), False), ((2.0, -0.4, 0.0), True)],
    ids=["fast enough", "passing"],
)
def test_otherwise_the_plan_counts_across_it(own_mps: Ned, in_the_way: bool) -> None:
    other = replace(AHEAD, in_the_way=in_the_way)
    assert straight_out(ASIDE_MPS, other, [other], ANSWER, LEAST_M, own_mps) is None


def test_nor_does_it_fly_straight_into_a_third() -> None:
    third = Other("follower 3", (0.3, 1.2, 0.0), (0.0, 0.0, 0.0), nearer_m=0.25, age_s=0.2)
    about = [AHEAD, third]
    assert straight_out(ASIDE_MPS, AHEAD, about, ANSWER, LEAST_M, (2.0, -0.4, 0.0)) is None
