"""A formation that takes another shape in flight."""

import itertools
import math

import pytest

from echowing.analysis.metrics import metrics
from echowing.errors import EchowingError
from echowing.flight.build_up import SLOT_MPS
from echowing.flight.guidance import Slot, place_m
from echowing.flight.reshape import LEAST_APART_M, Reshape, check_changes, ways
from echowing.flight.shapes import SHAPES, shape
from echowing.flight.steps import Phase, Standing
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

from .test_chain import known, taught

LED, HELD = Standing(Phase.LED), Standing(Phase.HELD, "held by the operator")


class InShape:
    """A formation whose followers 2, 3, … are led, and the changes of its shape."""

    def __init__(self, name: str, followers: int) -> None:
        self.known = known(shape(name, followers, 3.0))
        self.said: list[str] = []
        self.reshape = Reshape(self.known, lambda _, text: self.said.append(text))
        self.stand(LED)

    def stand(self, standing: Standing) -> None:
        for one in self.known.followers.values():
            one.standing = standing

    def form(self, name: str) -> None:
        self.reshape.begin((name, shape(name, len(self.known.followers), 3.0)), 0.0)

    def watched(self) -> list[int]:
        return [self.known.watched_id(one) for one in self.known.followers.values()]

    def places_m(self) -> list[tuple[float, float]]:
        """Where the slots are, (north, east) of a leader that flies north, opened as they are."""
        slots = [one.slot for one in self.known.followers.values()]
        return [place_m(slots, number)[:2] for number in range(len(slots))]

    def fly(self, seconds: float, tick_s: float = 0.1) -> list[list[tuple[float, float]]]:
        """The slots at each tick."""
        seen = []
        for tick in range(1, round(seconds / tick_s) + 1):
            self.reshape.advance(tick * tick_s)
            seen.append(self.places_m())
        return seen


def least_m(places_m: list[tuple[float, float]]) -> float:
    everybody = [(0.0, 0.0), *places_m]
    return min(math.dist(a, b) for a, b in itertools.combinations(everybody, 2))


def test_slots_go_from_where_they_are_into_the_new_shape_and_keep_apart() -> None:
    there = InShape("column", 4)
    before_m = there.places_m()
    there.form("vee")
    assert there.places_m() == [pytest.approx(one, abs=1e-6) for one in before_m]
    seen = there.fly(30.0)
    assert sorted(seen[-1]) == [
        pytest.approx(place_m(shape("vee", 4, 3.0), number)[:2], abs=1e-6)
        for number in sorted(range(4), key=lambda number: place_m(shape("vee", 4, 3.0), number)[:2])
    ]
    assert min(map(least_m, seen)) >= LEAST_APART_M
    assert not there.reshape.moves
    assert there.said == ["to vee, 16 s", "in vee"]


def test_no_slot_is_faster_than_a_follower_that_keeps_up_with_it() -> None:
    there = InShape("column", 4)
    there.form("vee")
    seen = there.fly(30.0)
    fastest_mps = max(
        math.dist(a, b) / 0.1
        for now, then in itertools.pairwise(seen)
        for a, b in zip(now, then, strict=True)
    )
    # The longest way at SLOT_MPS on average; on its spiral it is a little faster here and there.
    assert SLOT_MPS <= fastest_mps <= 1.3 * SLOT_MPS


@pytest.mark.parametrize("followers", range(2, 13))
def test_from_shape_to_shape_slots_keep_apart(followers: int) -> None:
    for one, other in itertools.permutations(SHAPES, 2):
        check_changes([(name, shape(name, followers, 3.0)) for name in (one, other)])


def test_a_way_on_which_slots_meet_is_refused() -> None:
    shapes = [(name, shape(name, 8, 1.9)) for name in ("column", "vee")]
    with pytest.raises(EchowingError, match=r"from column to vee two slots come to 1\.6 m"):
        check_changes(shapes)


def test_each_follower_takes_the_slot_that_makes_all_ways_shortest() -> None:
    mirrored = [Slot(3.0, -0.6), Slot(3.0, 0.6)]
    found = ways([Slot(3.0, 0.5), Slot(3.0, -0.5)], mirrored)
    assert [way.to.angle_rad for way in found] == [0.6, -0.6]


def test_what_sonars_know_goes_with_them_to_whom_they_watch_next() -> None:
    """The leader's receiver is 2 m too far north, the first one's is right, the second's 1 m so."""
    there = InShape("column", 2)
    first, second = there.known.followers.values()
    taught(first, 2.0)
    taught(second, -1.0)
    first.turn.joined = second.turn.joined = True
    second.estimate.jumped_m = (0.5, 0.0)
    sigma_m = there.known.sigma_m((first, second))
    there.form("vee")
    assert there.watched() == [1, 1]
    assert second.estimate.offset.north_m == pytest.approx(1.0, abs=0.3)
    assert second.estimate.offset.level_sigma_m == pytest.approx(sigma_m, abs=0.1)
    assert second.estimate.jumped_m == (0.5, 0.0)
    assert second.turn.joined
    assert not second.estimate.hears(60.0), "it has not heard this one yet"


def test_who_knows_no_more_than_receivers_tell_comes_in_anew() -> None:
    there = InShape("column", 2)
    first, second = there.known.followers.values()
    first.turn.joined = second.turn.joined = True
    there.form("vee")
    assert first.turn.joined, "it watches the same one as before"
    assert not second.turn.joined


def test_slots_wait_while_all_are_held() -> None:
    there = InShape("column", 3)
    there.form("vee")
    before_m = there.places_m()
    there.stand(HELD)
    there.fly(5.0)
    assert there.places_m() == before_m
    there.stand(LED)
    there.fly(1.0)
    assert there.places_m() != before_m


def test_why_the_shape_cannot_change_now() -> None:
    there = InShape("column", 3)
    vee = "vee", shape("vee", 3, 3.0)
    assert there.reshape.objection(vee) is None
    near = "vee", shape("vee", 3, 1.9)
    assert "two slots come to" in (there.reshape.objection(near) or "")
    second = there.known.followers[3]
    second.standing = HELD
    assert there.reshape.objection(vee) == "follower 3 is not led: held by the operator"
    second.standing = Standing(Phase.WATCHED)
    assert there.reshape.objection(vee) == "follower 3 is not led"
    there.stand(LED)
    there.form("vee")
    assert there.reshape.objection(vee) == "still on the way to vee"


@pytest.mark.parametrize("followers", [2, pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.seconds(20)
def test_a_formation_in_flight_changes_its_shape_and_nobody_comes_near(followers: int) -> None:
    scenario = load_scenario(
        "column",
        [
            f"formation.followers={followers}",
            *("duration_s=95", "sonar.spread=0", "gps.spread=0"),
            "formation.changes=[{shape='vee', at_s=35}, {shape='column', at_s=58}]",
        ],
    )
    flight = FormationFlight(scenario, 1)
    flown = flight.run()
    told = [text for _, text in flown.events]
    assert [text for text in told if text in ("in vee", "in column")] == ["in vee", "in column"]
    assert flown.closest_m >= 1.5
    for gap in flown.flights:
        assert abs(metrics(gap, 85.0).mean_separation_m - 3.0) < 0.3
