"""A leader that is not heard is looked for from both sides, at the same distance, for a while."""

import math
from itertools import pairwise

import pytest

from echowing.analysis.metrics import found_s
from echowing.flight.guidance import GuidedPoint
from echowing.flight.search import BACK_RPS, GATHERS_S, LOST, NEW, ROUNDS, Search, Swing, swung
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.sim.fault_section import FaultSection
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario
from echowing.sim.summary import fly

from ..world import CLEARLY

LEADER = GlobalPosition(39.34, -86.03, 260.0)
TICK_S = 0.125
SAID = "no echo, looking from the side"


class Flown:
    """A search, tick by tick; `sides`: time, how far aside, the rate that was given."""

    def __init__(self, swing: Swing = NEW) -> None:
        self.search, self.now_s, self.swing = Search(), 0.0, swing
        self.sides: list[tuple[float, float, float]] = []

    def on(self, span_s: float, *, misses: bool = True, in_slot: bool = True) -> "Flown":
        for _ in range(round(span_s / TICK_S)):
            self.now_s += TICK_S
            rate_rps = self.search.update(
                self.now_s, misses=misses, in_slot=in_slot, new=self.swing is NEW
            )
            self.sides.append((self.now_s, self.search.aside_rad, rate_rps))
        return self

    def whole(self) -> "Flown":
        """All of a search without an echo."""
        return self.on(self.swing.patience_s + ROUNDS * self.swing.period_s + GATHERS_S + 1.0)

    @property
    def swings(self) -> bool:
        return self.search.is_under_way(self.now_s)


# The patience at the tail, a second lost at the start, three quarters of a round.
@pytest.mark.parametrize(("swing", "aside_deg", "by_s"), [(NEW, 70.0, 19.5), (LOST, 60.0, 19.0)])
def test_one_never_heard_is_looked_for_further_round(
    swing: Swing, aside_deg: float, by_s: float
) -> None:
    sides = Flown(swing).on(by_s).sides
    assert max(aside for _, aside, _ in sides) == pytest.approx(math.radians(aside_deg), rel=0.01)
    assert min(aside for _, aside, _ in sides) == pytest.approx(-math.radians(aside_deg), rel=0.01)


def test_the_rate_is_that_of_the_angle() -> None:
    sides = Flown().on(30.0).on(10.0, misses=False).sides
    for (_, before, _), (_, aside, rate_rps) in pairwise(sides):
        assert rate_rps * TICK_S == pytest.approx(aside - before, abs=1e-9)


def test_it_sets_out_and_ends_gently() -> None:
    """A quarter of a rad/s2 at the most: 0.8 m/s2 at 3 m."""
    rates = [rate for _, _, rate in Flown().whole().on(5.0).sides]
    hardest = max(abs(b - a) / TICK_S for a, b in pairwise(rates))
    assert hardest < 0.25
    assert max(rates) > 0.3


def test_it_begins_in_its_slot_and_after_some_patience() -> None:
    flown = Flown().on(30.0, in_slot=False)
    assert not flown.swings
    assert flown.search.aside_rad == 0.0
    assert not flown.on(NEW.patience_s - 1.0).swings
    assert flown.on(2.0).swings
    assert flown.on(5.0, in_slot=False).swings, "on its way round it is not in its slot"


def test_before_it_swings_the_nose_looks_to_both_sides_once() -> None:
    flown = Flown()
    looks = []
    for _ in range(round(10.0 / TICK_S)):
        flown.on(TICK_S)
        looks.append(math.degrees(flown.search.look_rad(flown.now_s)))
        if abs(looks[-1]) > 25.0:
            assert abs(math.degrees(flown.search.aside_rad)) < 10.0, "it looks before it goes"
    assert (max(looks), min(looks)) == pytest.approx((30.0, -30.0), rel=0.01)
    assert looks[round(5.0 / TICK_S) :] == [0.0] * round(5.0 / TICK_S)
    assert Flown(LOST).on(1.0).search.look_rad(1.0) == 0.0, "one that was heard is near the tail"


@pytest.mark.parametrize("seed", [26, 42])
def test_a_leader_beside_the_beam_is_not_flown_at(seed: int) -> None:
    """Receivers 3.2 m apart: 0.66 and 0.78 m without the look."""
    assert fly(load_scenario("echowing", ["duration_s=20", "settle_s=10"]), seed).closest_m > 2.0


def test_what_is_heard_again_within_the_patience_moves_nobody() -> None:
    flown = Flown()
    for _ in range(10):
        flown.on(NEW.patience_s - 0.5).on(0.5, misses=False)
    assert {aside for _, aside, _ in flown.sides} == {0.0}


def test_heard_it_goes_back_to_the_tail_slowly() -> None:
    flown = Flown().on(NEW.patience_s + NEW.period_s / 4.0)
    aside_rad = flown.search.aside_rad
    flown.on(1.0, misses=False)
    assert flown.search.aside_rad == pytest.approx(aside_rad - BACK_RPS, abs=1e-6)
    assert not flown.swings
    assert flown.on(10.0, misses=False).search.aside_rad == 0.0


def test_it_gives_up_until_it_has_heard_the_leader_again() -> None:
    flown = Flown().whole()
    assert not flown.swings
    assert not flown.on(60.0).swings
    assert flown.search.aside_rad == 0.0
    assert flown.on(1.0, misses=False).on(NEW.patience_s + 1.0).swings


@pytest.mark.parametrize("aside_deg", [-60.0, 25.0, 60.0])
def test_a_slot_is_swung_at_its_distance_and_height_and_moves_along(aside_deg: float) -> None:
    slot = displace(LEADER, (-4.0, 0.0, -1.5))
    tail = GuidedPoint(slot, slot, LEADER, 0.0, 0.0, (-4.0, 0.0), (2.0, 0.0))
    aside_rad, rate_rps = math.radians(aside_deg), 0.3
    now, then = (swung(tail, aside_rad + rate_rps * after_s, rate_rps) for after_s in (0.0, 0.001))
    north_m, east_m, down_m = ned_between(LEADER, now.point)
    # Clockwise from above, one on the south of its leader goes west.
    assert (north_m, east_m, down_m) == pytest.approx(
        (-4.0 * math.cos(aside_rad), -4.0 * math.sin(aside_rad), -1.5), abs=1e-5
    )
    moved_m = ned_between(now.point, then.point)
    own_mps = now.velocity_mps[0] - 2.0, now.velocity_mps[1]
    assert own_mps == pytest.approx((moved_m[0] / 0.001, moved_m[1] / 0.001), abs=0.01)
    assert now.slot == now.point


# Receivers that disagree by 1.5 m and more along the line: from the tail the sonar heard nothing
# for half a minute and more.
@pytest.mark.parametrize("seed", [309, 310, 341])
def test_a_leader_out_of_reach_from_the_tail_is_found_from_the_side(seed: int) -> None:
    one = fly(load_scenario("echowing", ["duration_s=60", "settle_s=20", *CLEARLY]), seed)
    (measured,) = one.metrics
    assert any(SAID in text for _, text in one.events)
    # Without the search: 1.3 to 3.2 m.
    assert measured.mean_abs_error_m < 0.5 * 1.3
    assert one.closest_m > 1.5


def test_a_leader_that_was_never_heard_is_found_from_further_round() -> None:
    """Swung by 60 degrees the follower found it after 41 s."""
    scenario = load_scenario("echowing", ["leader.path=figure-eight", "duration_s=35", *CLEARLY])
    one = FormationFlight(scenario, 310).run()
    found_at_s = found_s(one.flights[0], scenario.sonar_belief.inset_m)
    assert found_at_s is not None
    assert found_at_s < 30.0


def test_one_that_was_heard_is_looked_for_nearer_to_the_tail() -> None:
    dead = FaultSection(kind="sonar_dead", vehicle=2, at_s=12.0)
    scenario = load_scenario("echowing", ["duration_s=24", *CLEARLY]).model_copy(
        update={"fault": (dead,)}
    )
    flight = FormationFlight(scenario, 303)
    asides: list[float] = []
    search = flight.ground.session.followers[2].search
    flight.run(after_step=lambda: asides.append(search.aside_rad))
    assert max(asides) == pytest.approx(LOST.aside_rad, rel=0.01)


def test_a_leader_above_the_beam_is_not_looked_for_from_the_side() -> None:
    """It climbs by 10 m, comes back 1 m higher, and turns to the east.

    With the silence of that time believed the follower was 4 m wrong in the end, and flew below its
    leader, swinging to the side; 0.98 m apart were left.
    """
    one = fly(load_scenario("hostile", ["duration_s=135", *CLEARLY]), 1269)
    assert not any(SAID in text for at_s, text in one.events if at_s > 100.0)
    # The receivers alone, a minute after the last reading: 3 m and more.
    assert one.phases["east"] > 2.5
