"""Health of the formation: who sees whom, and whose loss would cut the rest in two."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from echowing.flight.belief import Curve
from echowing.flight.clocks import SAY_AGAIN_S, UNHEARD_S
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.health import (
    LASTS_S,
    RANGED_S,
    Cohesion,
    Member,
    assess,
    near_pairs,
    ranged,
)
from echowing.sonar_file import shipped_sonar

LEADER = 1
NORTH, SOUTH = 0.0, math.pi
SONAR = shipped_sonar()


def at(system_id: int, north_m: float, east_m: float = 0.0, **more: float | None) -> Member:
    return replace(Member(system_id, (north_m, east_m, -10.0), 0.1), **more)  # type: ignore[arg-type]


def line(step_m: float = 4.0, count: int = 4) -> list[Member]:
    """A leader and followers behind one another."""
    return [at(number, -step_m * number) for number in range(1, count + 1)]


# ---- who sees whom ----------------------------------------------------------------------------


def test_a_range_is_of_the_vehicle_that_it_fits() -> None:
    leader, other = at(LEADER, 0.0), at(3, -3.0, 2.5)
    follower = at(2, -3.0, heading_rad=NORTH, range_m=3.1)
    assert ranged(follower, [leader, follower, other], LEADER, SONAR) == LEADER
    # The other is ahead too, where the nose points at it; then it is nearer to what was measured.
    turned = replace(follower, heading_rad=math.radians(60.0), range_m=2.4)
    assert ranged(turned, [leader, turned, other], LEADER, SONAR) == 3


def test_the_leader_is_where_the_follower_has_learnt_it_to_be() -> None:
    """By its receiver it is 5 m away; a vehicle 4.5 m away would fit the range better."""
    leader, other = at(LEADER, 0.0), at(3, -5.0, 4.5)
    follower = at(2, -5.0, heading_rad=math.radians(45.0), range_m=4.0)
    assert ranged(follower, [leader, follower, other], LEADER, SONAR) == 3
    learnt = replace(follower, leader_ned_m=(-1.2, 0.0, -10.0))
    assert ranged(learnt, [leader, learnt, other], LEADER, SONAR) == LEADER


@pytest.mark.parametrize(
    ("range_m", "heading_rad"),
    [(None, NORTH), (0.5, NORTH), (3.0, SOUTH)],
)
def test_a_range_that_fits_nobody_is_of_nobody(range_m: float | None, heading_rad: float) -> None:
    """Nothing, the ground at half a metre, a vehicle behind."""
    leader = at(LEADER, 0.0)
    follower = at(2, -3.0, heading_rad=heading_rad, range_m=range_m)
    assert ranged(follower, [leader, follower], LEADER, SONAR) is None


def test_near_is_within_a_sonars_reach_and_a_little_further_once_it_was() -> None:
    limit_m = SONAR.reach_m
    apart = [at(1, 0.0), at(2, -limit_m - 0.1)]
    assert near_pairs(apart, SONAR) == set()
    pair = frozenset((1, 2))
    assert near_pairs([at(1, 0.0), at(2, -limit_m + 0.1)], SONAR) == {pair}
    assert near_pairs(apart, SONAR, [pair]) == {pair}
    assert (
        near_pairs([at(1, 0.0), at(2, -limit_m - UNRANGED_SIGMA_M - 0.1)], SONAR, [pair]) == set()
    )


def test_how_far_and_how_wide_is_what_the_sonar_file_says() -> None:
    """A lidar that sees 7 m, through a straw."""
    lidar = replace(SONAR, reach_m=7.0, widest_rad=Curve((0.0,), (math.radians(3.0),)))
    apart = [at(1, 0.0), at(2, -6.5, heading_rad=math.radians(45.0), range_m=6.5)]
    assert not near_pairs(apart, SONAR)
    assert near_pairs(apart, lidar) == {frozenset((1, 2))}
    assert ranged(apart[1], apart, LEADER, SONAR) == LEADER
    assert ranged(apart[1], apart, LEADER, lidar) is None
    cohesion = Cohesion(LEADER, lidar)
    fly(cohesion, apart, 0, 3)
    (text,) = fly(cohesion, [at(1, 0.0), at(2, -20.0)], 3, 10)
    assert "none within 7 m" in text


def test_one_that_is_not_heard_is_near_nobody() -> None:
    unheard = replace(at(2, -3.0), age_s=UNHEARD_S + 0.1)
    assert near_pairs([at(1, 0.0), unheard], SONAR) == set()
    assert assess([at(1, 0.0), unheard], LEADER, SONAR).alone == (2,)


# ---- whose loss cuts --------------------------------------------------------------------------


def test_in_a_line_every_vehicle_but_the_ends_cuts_it() -> None:
    cuts = {cut.system_id: cut.parts for cut in assess(line(), LEADER, SONAR).cuts}
    assert cuts == {2: ((3, 4), (1,)), 3: ((1, 2), (4,))}


def test_in_a_ring_nobody_cuts() -> None:
    ring = [at(1, 0.0), at(2, 0.0, 4.0), at(3, 4.0, 4.0), at(4, 4.0)]
    assert assess(ring, LEADER, SONAR).cuts == ()


def test_a_range_joins_two_that_receivers_put_apart() -> None:
    leader = at(LEADER, 0.0)
    follower = at(2, -5.5, heading_rad=NORTH, range_m=4.0)  # receivers off by 1.5 m
    health = assess([leader, follower], LEADER, SONAR)
    assert health.near == ()
    assert health.ranges == ((2, LEADER),)
    assert health.alone == ()


# ---- over time --------------------------------------------------------------------------------


def fly(cohesion: Cohesion, members: list[Member], from_s: int, to_s: int) -> list[str]:
    return [
        text for second in range(from_s, to_s) for text in cohesion.update(members, float(second))
    ]


def test_an_articulation_point_is_said_when_it_has_become_one() -> None:
    cohesion = Cohesion(LEADER, SONAR)
    square = [at(1, 0.0), at(2, -4.0), at(3, -4.0, 4.0), at(4, 0.0, 4.0)]
    assert fly(cohesion, square, 0, 5) == []
    opened = [*square[:3], at(4, -4.0, 8.0)]
    began_s = 5
    assert fly(cohesion, opened, began_s, began_s + round(LASTS_S)) == []
    said = fly(cohesion, opened, began_s + round(LASTS_S), 30)
    assert said == [
        "follower 2: its loss would cut the formation apart: follower 3, follower 4 | the leader",
        "follower 3: its loss would cut the formation apart: the leader, follower 2 | follower 4",
    ]


def test_a_moment_of_an_articulation_point_is_no_news() -> None:
    cohesion = Cohesion(LEADER, SONAR)
    square = [at(1, 0.0), at(2, -4.0), at(3, -4.0, 4.0), at(4, 0.0, 4.0)]
    opened = [*square[:3], at(4, -4.0, 8.0)]
    said = [cohesion.update(square if s % 2 else opened, float(s)) for s in range(40)]
    assert said == [[]] * 40


def test_what_comes_and_goes_is_not_said_each_time() -> None:
    cohesion = Cohesion(LEADER, SONAR)
    square = [at(1, 0.0), at(2, -4.0), at(3, -4.0, 4.0), at(4, 0.0, 4.0)]
    opened = [*square[:3], at(4, -4.0, 8.0)]
    said = []
    for second in range(90):
        members = opened if second // 5 % 2 else square
        said += [(second, text) for text in cohesion.update(members, float(second))]
    times_s = [second for second, text in said if text.startswith("follower 2:")]
    assert len(times_s) == 3
    assert all(b - a >= SAY_AGAIN_S for a, b in pairwise(times_s))


def test_a_follower_that_sees_nobody_any_more_is_named_and_told_of_when_it_does_again() -> None:
    cohesion = Cohesion(LEADER, SONAR)
    near, far = line(count=2), [at(1, -4.0), at(2, -12.0)]
    assert fly(cohesion, near, 0, 3) == []
    (lost,) = fly(cohesion, far, 3, 20)
    assert lost == (
        "follower 2 does not see anybody any more: no range of a vehicle, and none within 4.5 m "
        "of it"
    )
    assert cohesion.health.lost == (2,)
    assert fly(cohesion, near, 20, 30) == ["follower 2 sees a vehicle again"]
    assert not cohesion.health.lost


def test_one_that_never_saw_anybody_is_no_news() -> None:
    """Eight metres behind the leader no sonar reaches anybody, and that is how it is flown."""
    cohesion = Cohesion(LEADER, SONAR)
    assert fly(cohesion, [at(1, 0.0), at(2, -8.0)], 0, 30) == []
    assert (cohesion.health.alone, cohesion.health.lost) == ((2,), ())


def test_one_whose_slot_is_out_of_sight_is_no_news() -> None:
    """It has passed near another on its way there."""
    cohesion = Cohesion(LEADER, SONAR)
    near, there = [at(1, 0.0), at(2, -3.0)], [at(1, 0.0), replace(at(2, -8.0), apart=True)]
    assert fly(cohesion, near, 0, 5) == []
    assert fly(cohesion, there, 5, 30) == []
    assert cohesion.health.lost == ()


def test_a_range_counts_for_a_while() -> None:
    cohesion = Cohesion(LEADER, SONAR)
    leader = at(LEADER, 0.0)
    cohesion.update([leader, at(2, -6.0, heading_rad=NORTH, range_m=4.3)], 0.0)
    silent = [leader, at(2, -6.0)]
    cohesion.update(silent, RANGED_S - 0.1)
    assert cohesion.health.ranges == ((2, LEADER),)
    cohesion.update(silent, RANGED_S + 0.1)
    assert not cohesion.health.ranges
