"""A follower that has left: who is behind it takes its slot, or holds."""

import math

import pytest

from echowing.errors import EchowingError
from echowing.flight.formation import place_m
from echowing.flight.gaps import LEAVES_S, Gaps, check_gaps
from echowing.flight.guidance import Slot
from echowing.flight.shapes import shape
from echowing.flight.state import Known
from echowing.flight.steps import Phase, Standing
from echowing.sim.fault_section import FaultSection
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

from .test_chain import known

LED, GONE, HELD = Standing(Phase.LED), Standing(Phase.WATCHED), Standing(Phase.HELD)


class Line:
    """A formation whose followers 2, 3, … are led, and the gaps of its session."""

    def __init__(self, slots: tuple[Slot, ...]) -> None:
        self.known: Known = known(slots)
        self.said: list[str] = []
        self.gaps = Gaps(self.known, lambda _, text: self.said.append(text), self._alert)
        self.alerted: list[int] = []
        self.now_s = 0.0
        for one in self.known.followers.values():
            one.standing = LED
            one.turn.joined = True
        self.gaps.close(self.now_s)

    def _alert(self, system_id: int, text: str, severity: int) -> None:
        self.alerted.append(system_id)

    def stands(self, standing: Standing, *system_ids: int, seconds: float = LEAVES_S) -> None:
        for system_id in system_ids:
            self.known.followers[system_id].standing = standing
        self.now_s += seconds
        self.gaps.close(self.now_s)

    def ahead(self) -> dict[int, int]:
        """At whom each one's sonar looks."""
        return {one: self.known.watched_id(state) for one, state in self.known.followers.items()}

    def places_m(self) -> dict[int, tuple[float, float]]:
        """Where each one's slot is, (north, east) of a leader that flies north."""
        slots = [one.plan.slot for one in self.known.followers.values()]
        places = (place_m(slots, number) for number in range(len(slots)))
        return {
            one: (north, east) for one, (north, east, _) in zip(self.ahead(), places, strict=True)
        }


def test_who_is_behind_moves_up_to_the_end_of_the_line() -> None:
    line = Line(shape("column", 4, 3.0))
    bars = {one: state.guide for one, state in line.known.followers.items()}
    line.stands(GONE, 3)
    assert line.ahead() == {2: 1, 4: 2, 5: 4, 3: 5}
    north_m = {one: north for one, (north, _) in line.places_m().items()}
    assert north_m == pytest.approx({2: -3.0, 4: -6.0, 5: -9.0, 3: -12.0})
    # A slot's bar swings on as before, whoever flies behind it.
    assert line.known.followers[4].guide is bars[3]
    assert line.alerted == [4, 5]
    assert line.said == [
        "follower 4: takes the slot of follower 3, which has left",
        "follower 5: takes the slot of follower 4, which has left",
    ]
    # Who looks at another vehicle now comes in anew; who looks at the same one does not.
    assert not line.known.followers[4].turn.joined
    assert line.known.followers[5].turn.joined


def test_what_a_sonar_taught_of_another_vehicle_is_forgotten_and_of_the_same_one_kept() -> None:
    line = Line(shape("column", 4, 3.0))
    estimates = {one: state.estimate.offset for one, state in line.known.followers.items()}
    line.stands(GONE, 3)
    same = [
        one for one, was in estimates.items() if line.known.followers[one].estimate.offset is was
    ]
    assert same == [2, 5]


def test_an_arm_closes_by_itself() -> None:
    line = Line(shape("vee", 4, 3.0))  # 2 and 4 to the right, 3 and 5 to the left
    was_m = line.places_m()
    line.stands(GONE, 2)
    assert line.ahead() == {2: 4, 3: 1, 4: 1, 5: 3}
    now_m = line.places_m()
    assert (now_m[4], now_m[2]) == (was_m[2], was_m[4])
    assert (now_m[3], now_m[5]) == (was_m[3], was_m[5])


def test_of_two_that_are_behind_one_the_other_ranges_who_has_moved_up() -> None:
    slots = (Slot(3.0), Slot(3.0, 0.8, behind=0), Slot(3.0, -0.8, behind=0))
    line = Line(slots)
    line.stands(GONE, 2)
    assert line.ahead() == {3: 1, 4: 3, 2: 1} | {2: 3}
    assert math.dist(line.places_m()[3], (-3.0, 0.0)) < 1e-9


def test_two_that_leave_at_once_leave_no_gap_either() -> None:
    line = Line(shape("column", 4, 3.0))
    line.stands(GONE, 2, 3)
    assert line.ahead()[4] == 1
    assert line.ahead()[5] == 4


@pytest.mark.parametrize(
    ("standing", "seconds"), [(GONE, LEAVES_S - 0.2), (HELD, LEAVES_S), (HELD, 60.0)]
)
def test_who_is_away_for_a_moment_or_held_keeps_its_slot(
    standing: Standing, seconds: float
) -> None:
    line = Line(shape("column", 3, 3.0))
    line.stands(standing, 2, seconds=seconds)
    assert line.ahead() == {2: 1, 3: 2, 4: 3}


def test_who_was_never_led_has_not_left() -> None:
    """Pilots put theirs in Guided one after the other, not always the first one first."""
    line = Line(shape("column", 2, 3.0))
    fresh = Gaps(line.known, lambda *_: None, lambda *_: None)
    line.known.followers[2].standing = GONE
    for now_s in (0.0, 60.0):
        fresh.close(now_s)
    assert line.ahead() == {2: 1, 3: 2}


def test_who_comes_back_flies_at_the_end() -> None:
    line = Line(shape("column", 3, 3.0))
    line.stands(GONE, 2)
    line.stands(LED, 2)
    line.stands(LED, seconds=60.0)
    assert line.ahead() == {3: 1, 4: 3, 2: 4}


def test_slots_that_another_ones_applet_does_not_hold_are_refused() -> None:
    check_gaps(shape("diamond", 8, 3.0))
    with pytest.raises(EchowingError, match=r"slot 2 has a radius of 4 m, and slot 1.* of 3 m"):
        check_gaps([Slot(3.0), Slot(4.0, behind=0)])


@pytest.mark.parametrize("close_gaps", [True, False])
@pytest.mark.seconds(20)
def test_flown(close_gaps: bool) -> None:
    told = f"formation.close_gaps={str(close_gaps).lower()}"
    scenario = load_scenario("column", ["formation.followers=2", "duration_s=85", told])
    leaves = FaultSection(kind="pilot_takes_over", at_s=45.0, vehicle=2, mode="RTL")
    flight = FormationFlight(scenario.model_copy(update={"fault": (leaves,)}), 3)
    flight.run()
    behind_m = math.dist(flight.leader.position_ned_m, flight.followers[1].position_ned_m)
    if close_gaps:
        assert behind_m == pytest.approx(3.0, abs=0.5)
    else:
        assert behind_m > 20.0
        assert flight.ground.session.followers[3].standing.phase is Phase.HELD
    assert flight.closest_m > 1.0
