"""Where a follower is to be, of what is known of its leader."""

import math
from dataclasses import replace

import pytest

from echowing.flight.cloud import Off
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.known import place_guides
from echowing.flight.plan import GIVEN_UP_M, WITHIN_REACH_M, planned
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
    follower.plan.slot = replace(follower.plan.slot, radius_m=2.0)
    place_guides([follower])
    follower.plan.sonar = load_sonar("mb1202").belief(legs)
    follower.estimate.offset.turn_to(Off(0.0, 0.0, 0.0, 0.05, 0.05))
    told.known.leader.oldest_s = 1.0
    guided = planned(told.known, follower, fix, 0.0)
    return math.hypot(*ned_between(guided.slot, guided.leader)[:2])


def test_the_slot_opens_no_further_than_the_sonar_reaches() -> None:
    """By old reports alone it would take more, and the leader would never be heard again."""
    for legs in ("foil", "stock"):
        assert unheard_slot_m(legs) == pytest.approx(4.5 - WITHIN_REACH_M, abs=0.01)


@pytest.mark.parametrize(
    ("legs", "needs_m", "opens_m"),
    [
        ("foil", 3.2, 3.2),  # heard to 4 m, and more
        ("stock", 3.2, 3.0),  # heard to 2.8 m, and the inset
        ("stock", 3.6, 3.6 - GIVEN_UP_M),  # room to stop goes first
        ("stock", 2.6, 2.6),
    ],
)
def test_the_slot_stays_where_the_leaders_legs_are_heard_if_there_is_room_to_stop(
    monkeypatch: pytest.MonkeyPatch, legs: Legs, needs_m: float, opens_m: float
) -> None:
    monkeypatch.setattr("echowing.flight.plan.least_slot_m", lambda *_, **__: needs_m)
    assert unheard_slot_m(legs) == pytest.approx(opens_m, abs=0.01)
