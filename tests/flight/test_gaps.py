"""A follower that has left: who is behind it takes its slot, or holds."""

import math
from copy import deepcopy

import pytest

from echowing.errors import EchowingError
from echowing.flight.formation import check_gaps
from echowing.flight.gaps import LEAVES_S, Gaps
from echowing.flight.guidance import GuidanceSettings, LeaderFix, Slot, place_m
from echowing.flight.joining import Joining
from echowing.flight.known import Known
from echowing.flight.shapes import shape
from echowing.flight.steps import Phase, Standing
from echowing.geo import displace, ned_between
from echowing.sim.fault_section import FaultSection
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

from .test_chain import HERE, known, taught
from .yard import FOLLOWER, LEADER, LOITER, SECOND, Vehicle, Yard

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
    line.stands(GONE, 3)
    assert line.ahead() == {2: 1, 4: 2, 5: 4, 3: 5}
    north_m = {one: north for one, (north, _) in line.places_m().items()}
    assert north_m == pytest.approx({2: -3.0, 4: -6.0, 5: -9.0, 3: -12.0})
    # The pilot of the one that has left reads it, too.
    assert line.alerted == [3, 4, 5]
    assert line.said == [
        "follower 4: takes the slot of follower 3, which has left",
        "follower 5: takes the slot of follower 4, which has left",
    ]
    # Who looks at another vehicle now comes in anew; who looks at the same one does not.
    assert not line.known.followers[4].turn.joined
    assert line.known.followers[5].turn.joined


def test_what_sonars_taught_on_the_way_to_the_one_that_is_watched_now_stays_known() -> None:
    """Of the one that has left, too: its receiver tied the two that are neighbours now."""
    line = Line(shape("column", 4, 3.0))
    followers = line.known.followers
    for one, north_m in ((3, 1.0), (4, 0.5), (5, -1.0)):
        taught(followers[one], north_m)
    line.stands(GONE, 3)
    assert followers[4].estimate.offset.north_m == pytest.approx(1.5, abs=0.4)
    assert followers[4].turn.joined, "it is known well enough to come in at once"
    assert followers[5].estimate.hears(60.0), "it looks at the same one as before"
    assert followers[5].estimate.offset.north_m == pytest.approx(-1.0, abs=0.2)


def test_gaps_wait_while_the_shape_changes_and_a_short_one_then_is_none() -> None:
    line = Line(shape("column", 4, 3.0))
    for _ in range(3):
        line.now_s += LEAVES_S
        line.gaps.close(line.now_s, reshapes=True)
    line.known.followers[3].standing = GONE
    line.now_s += LEAVES_S - 1.0
    line.gaps.close(line.now_s)
    assert not line.said
    line.now_s += 1.0
    line.gaps.close(line.now_s, reshapes=True)
    assert not line.said
    line.gaps.close(line.now_s)
    assert line.said


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
    assert line.ahead() == {3: 1, 4: 3, 2: 3}
    assert not line.known.followers[4].turn.joined, "it knows nothing of that one"
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


def test_who_comes_back_flies_at_the_end_once_its_pilot_has_said_so() -> None:
    line = Line(shape("column", 3, 3.0))
    line.stands(GONE, 2)
    assert line.known.followers[2].turn.latched is not None
    line.stands(LED, 2)
    line.stands(LED, seconds=60.0)
    assert line.ahead() == {3: 1, 4: 3, 2: 4}


def test_who_is_stopped_for_another_reason_stays_where_it_is() -> None:
    line = Line(shape("column", 3, 3.0))
    line.known.followers[3].turn.latched = "its position jumped"
    line.stands(GONE, 2)
    assert line.ahead() == {2: 1, 3: 2, 4: 3}


def test_once_all_have_left_the_next_flight_begins_anew() -> None:
    line = Line(shape("column", 2, 3.0))
    line.stands(GONE, 2, 3)
    line.stands(GONE, seconds=60.0)
    line.stands(HELD, 3)
    line.stands(HELD, seconds=60.0)
    assert line.ahead() == {2: 1, 3: 2}


def test_where_one_has_been_flown_to_swings_no_bar() -> None:
    """Its pilot flies it to the leader's side; who takes its slot is behind the leader."""
    line = Line(shape("column", 2, 3.0))
    ahead, behind = line.known.followers.values()
    still = LeaderFix(0.0, HERE, (0.0, 0.0, 0.0), 0.0)
    for now_s in range(5):
        for one, at_m in ((ahead, (2.0, 2.0)), (behind, (-6.0, 0.0))):
            one.guide.update(still, float(now_s), displace(HERE, (*at_m, 0.0)))
    line.stands(GONE, 2)
    slot = behind.guide.update(still, 6.0, displace(HERE, (-6.0, 0.0, 0.0))).slot
    assert ned_between(HERE, slot)[:2] == pytest.approx((-3.0, 0.0), abs=0.1)


def test_who_moved_to_the_end_comes_in_after_those_before_it() -> None:
    line = Line(shape("column", 3, 3.0))
    line.stands(GONE, 2)
    line.stands(LED, 2)
    for one in line.known.followers.values():
        one.turn.joined = one.plan.system_id == 3
        one.estimate.heard(line.now_s, 7.65)  # its sonar works, and hears nobody
    joining = Joining(line.known)
    last, first, middle = line.known.followers.values()
    assert joining.waits_for(middle, line.now_s) is None
    assert joining.waits_for(last, line.now_s) is middle
    assert joining.waits_for(first, line.now_s) is None


def test_who_was_stopped_for_good_takes_no_slot() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0)),
        FOLLOWER: Vehicle((-8.0, 0.0)),
        SECOND: Vehicle((-16.0, 0.0)),
    }
    settings = GuidanceSettings(learn_offset=False, close_gaps=True)
    slots = (Slot(8.0), Slot(8.0, behind=0))
    for stops in (False, True):
        yard = Yard(vehicles=deepcopy(vehicles), slots=slots, settings=settings)
        yard.fly(5.0)
        if stops:
            yard.session.stop("STOP")
        yard.fly(2.0)
        yard.vehicles[FOLLOWER].mode = LOITER
        yard.fly(LEAVES_S + 3.0)
        assert yard.said("follower 3: takes the slot of follower 2") is not stops


def test_who_has_fallen_silent_is_not_taken_for_the_leader() -> None:
    """It stands where it was; who moves up past it has only just begun to learn of the leader."""
    told = ["formation.followers=2", "duration_s=95", "formation.close_gaps=true"]
    scenario = load_scenario("column", [*told, "leader.path=stop-and-go", "leader.speed_mps=1"])
    silent = FaultSection(kind="outage", at_s=60.0, for_s=25.0, vehicle=2)
    flight = FormationFlight(scenario.model_copy(update={"fault": (silent,)}), 4)
    flight.run()
    second = flight.ground.session.followers[3]
    assert flight.ground.session.known.ahead_of(second) is None
    offset = second.estimate.offset
    assert math.hypot(offset.north_m, offset.east_m) < 3.0, "of two receivers of 0.8 m"
    assert flight.closest_m > 1.0


def test_slots_that_another_ones_applet_does_not_hold_are_refused() -> None:
    check_gaps(shape("diamond", 8, 3.0))
    for other in (Slot(4.0, behind=0), Slot(3.0, altitude_step_m=1.0, behind=0)):
        with pytest.raises(EchowingError, match=r"slot 2 and slot 1, .* differ in radius or alt"):
            check_gaps([Slot(3.0), other])


@pytest.mark.parametrize("close_gaps", [True, pytest.param(False, marks=pytest.mark.long)])
@pytest.mark.seconds(20)
def test_flown(close_gaps: bool) -> None:
    told = f"formation.close_gaps={str(close_gaps).lower()}"
    scenario = load_scenario("column", ["formation.followers=2", "duration_s=65", told])
    leaves = FaultSection(kind="pilot_takes_over", at_s=35.0, vehicle=2, mode="RTL")
    flight = FormationFlight(scenario.model_copy(update={"fault": (leaves,)}), 3)
    flight.run()
    behind_m = math.dist(flight.leader.position_ned_m, flight.followers[1].position_ned_m)
    if close_gaps:
        assert behind_m == pytest.approx(3.0, abs=0.5)
        # The record says who flew behind whom.
        recorded = flight.recorders[1].samples[-1]
        assert math.dist(recorded.leader, recorded.follower) == pytest.approx(behind_m, abs=0.1)
    else:
        assert behind_m > 20.0
        assert flight.ground.session.followers[3].standing.phase is Phase.HELD
    assert flight.closest_m > 1.0
