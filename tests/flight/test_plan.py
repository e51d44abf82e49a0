"""Where a follower is to be, of what is known of its leader."""

import math
from dataclasses import replace

import pytest

from echowing.flight.cloud import Off
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.plan import WITHIN_REACH_M, planned
from echowing.geo import ned_between
from echowing.sonar_file import Legs, load_sonar

from .told import Told
from .yard import FOLLOWER, LEADER, Vehicle


def unheard_slot_m(legs: Legs) -> float:
    """How far behind a leader at 2 m/s the slot of one is that has not heard it.

    Where the leader is is known well, from reports that may be old.
    """
    vehicles = {
        LEADER: Vehicle((0.0, 0.0), (2.0, 0.0)),
        FOLLOWER: Vehicle((-5.0, 0.0), (2.0, 0.0)),
    }
    told = Told(vehicles, settings=replace(GuidanceSettings(), learn_offset=True))
    follower, fix = told.follower, told.known.leader.fix
    assert fix is not None
    follower.plan.sonar = load_sonar("mb1202").belief(legs)
    follower.estimate.offset.turn_to(Off(0.0, 0.0, 0.0, 0.05, 0.05))
    told.known.leader.oldest_s = 1.0
    guided = planned(told.known, follower, fix, 0.0)
    return math.hypot(*ned_between(guided.slot, guided.leader)[:2])


@pytest.mark.parametrize(("legs", "to_m"), [("foil", 4.5 - WITHIN_REACH_M), ("stock", 2.8 + 0.2)])
def test_the_slot_stays_where_the_leaders_legs_are_heard(legs: Legs, to_m: float) -> None:
    """Foil is heard to 4 m, further than a slot opens; stock legs to 2.8 m, and the inset."""
    assert unheard_slot_m(legs) == pytest.approx(to_m, abs=0.01)
