"""What is done with a follower, from its first report to its last, and why."""

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.guidance import Slot
from echowing.flight.steps import NEXT, Phase, Standing
from echowing.flight.supervisor import HOLDS
from echowing.paths import repository_root
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

from .yard import FOLLOWER, LEADER, LOITER, Vehicle, Yard

pytestmark = pytest.mark.seconds(7)

FLYING_BEATS = 3.0


def standing(yard: Yard, system_id: int = FOLLOWER) -> Standing:
    return yard.session.followers[system_id].standing


def test_a_follower_goes_from_watched_over_checked_to_led() -> None:
    yard = Yard(engaged=False)
    yard.vehicles[FOLLOWER].battery_percent = 5
    yard.fly(2.0)
    assert standing(yard) == Standing(Phase.WATCHED, "only watched")
    yard.session.engage()
    yard.fly(10.0)
    assert standing(yard).phase is Phase.CHECKED
    assert "battery" in standing(yard).why
    yard.vehicles[FOLLOWER].battery_percent = 80
    yard.fly(10.0)
    assert standing(yard) == Standing(Phase.LED)


def test_nothing_goes_to_one_that_is_only_watched_checked_or_left() -> None:
    yard = Yard()
    yard.vehicles[FOLLOWER].battery_percent = 5
    assert yard.fly(10.0) == []
    yard.vehicles[FOLLOWER].battery_percent = 80
    yard.fly(10.0)
    assert standing(yard).sent_to
    yard.vehicles[FOLLOWER].silent = True
    yard.fly(2.5)
    assert standing(yard) == Standing(Phase.LEFT, "does not report")
    assert yard.fly(1.0) == []


def test_who_comes_back_is_held_before_it_is_led() -> None:
    yard = Yard()
    yard.fly(10.0)
    yard.vehicles[FOLLOWER].silent = True
    yard.fly(2.5)
    yard.vehicles[FOLLOWER].silent = False
    yard.fly(0.5)
    assert standing(yard) == Standing(Phase.HELD, "its link was lost")
    yard.fly(4.0)
    assert standing(yard).phase is Phase.LED


def test_a_stop_holds_whoever_was_moved_and_leaves_the_others_alone() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0)),
        FOLLOWER: Vehicle((-4.0, 0.0)),
        3: Vehicle((-4.0, -8.0), mode=LOITER),
    }
    yard = Yard(vehicles=vehicles, slots=(Slot(3.0), Slot(8.0, 1.0)))
    yard.fly(10.0)
    yard.session.stop("the tool ends")
    yard.fly(0.125)
    assert standing(yard) == Standing(Phase.HELD, "the tool ends")
    assert standing(yard, 3).phase is Phase.WATCHED


def test_what_its_pilot_ended_is_new_when_he_comes_back() -> None:
    yard = Yard()
    yard.fly(10.0)
    turn = yard.session.followers[FOLLOWER].turn
    turn.latched = "the reason"
    yard.fly(0.125)
    assert standing(yard) == Standing(Phase.HELD, "the reason")
    yard.vehicles[FOLLOWER].mode = LOITER
    yard.fly(FLYING_BEATS)
    assert standing(yard) == Standing(Phase.WATCHED, "pilot has control")
    yard.vehicles[FOLLOWER].mode = mavlink.COPTER_MODE_GUIDED
    yard.fly(10.0)
    assert standing(yard).phase is Phase.LED
    assert yard.session.followers[FOLLOWER].turn is not turn


def test_that_the_applet_holds_the_distance_is_shown_while_it_says_so() -> None:
    yard = Yard()
    yard.fly(10.0)
    said = mavlink.MAVLink_named_value_float_message(0, b"ECHO_STATE", 7.0)
    yard.tell(FOLLOWER, said)
    yard.fly(0.5)
    assert standing(yard) == Standing(Phase.LED, HOLDS)
    assert yard.state() == f"following: {HOLDS}"
    yard.fly(2.0)
    assert yard.state() == "following", "a script that has died says nothing any more"


FOUND = repository_root() / "tests" / "campaign" / "fixed"


@pytest.mark.parametrize(
    "name",
    [
        str(FOUND / "silent-follower-is-flown-through.toml"),
        pytest.param("hostile", marks=pytest.mark.long),
    ],
    ids=lambda name: Path(name).stem,
)
def test_in_flight_one_follows_another_only_as_the_table_says(name: str) -> None:
    """A leader that jumps and goes silent, a pilot who takes over, a follower that goes silent."""
    seen: set[tuple[Phase, Phase]] = set()
    flight = FormationFlight(load_scenario(name), 3)
    before: dict[int, Phase] = {}

    def watch() -> None:
        for system_id, follower in flight.ground.session.followers.items():
            phase = follower.standing.phase
            seen.add((before.get(system_id, phase), phase))
            before[system_id] = phase

    flight.run(after_step=watch)
    assert {(one, other) for one, other in seen if other not in NEXT[one]} == set()
    assert seen & {(Phase.LED, Phase.HELD), (Phase.LED, Phase.LEFT)}
