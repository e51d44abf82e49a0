"""Where a follower that is stopped stands, and until when."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.guard import APPLET_BACKS_OFF, APPLET_STATE, Limits
from echowing.flight.heights import SAME_ALTITUDE_M, Heights
from echowing.flight.holds import LEAN_S, MOVED_M, Holds, moved_off
from echowing.flight.steps import Allowed, Hold
from echowing.geo import displace

from .told import HEIGHT_M, Told, at, from_here_m
from .yard import FOLLOWER, HERE, LEADER, Vehicle

MPS = 4.0


def stopped(
    velocity_mps: tuple[float, float] = (0.0, 0.0), limits: Limits | None = None
) -> tuple[Told, Holds]:
    """A follower 6 m south of its leader that flies at this velocity, and what stops it."""
    told = Told({LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-6.0, 0.0), velocity_mps)}, limits)
    return told, Holds(Heights(told.known, leaders=False), told.guard)


def test_one_that_hovers_is_held_where_it_is() -> None:
    told, holds = stopped()
    holds.keep(told.follower, 0.0)
    assert told.follower.hold is not None
    assert told.follower.hold.place == told.follower.position


@pytest.mark.parametrize("course_deg", [0, 90, 225])
def test_one_that_flies_is_held_where_it_can_stop(course_deg: int) -> None:
    """On its course: the way until it leans against it, and that of its braking, v^2 / 2a."""
    course_rad = math.radians(course_deg)
    told, holds = stopped((MPS * math.cos(course_rad), MPS * math.sin(course_rad)))
    holds.keep(told.follower, 0.0)
    assert told.follower.hold is not None
    far_m = MPS * LEAN_S + MPS * MPS / (2.0 * told.follower.handling.closing.accel_mps2)
    wanted = displace(HERE, (far_m * math.cos(course_rad) - 6.0, far_m * math.sin(course_rad), 0.0))
    assert from_here_m(told.follower.hold.place) == pytest.approx(from_here_m(wanted), abs=0.05)


def test_braking_that_is_under_way_shortens_the_way_and_gathering_speed_lengthens_it() -> None:
    held_m = {}
    for gained_mps2 in (-2.0, 0.0, 2.0):
        told, holds = stopped((MPS, 0.0))
        told.follower.acceleration_mps2 = (gained_mps2, 0.0)
        holds.keep(told.follower, 0.0)
        assert told.follower.hold is not None
        held_m[gained_mps2] = from_here_m(told.follower.hold.place)[0]
    assert held_m[-2.0] < held_m[0.0] - 0.5
    assert held_m[0.0] < held_m[2.0] - 0.5


def test_a_hold_that_goes_on_stays_where_it_is_and_one_that_begins_anew_does_not() -> None:
    told, holds = stopped()
    holds.keep(told.follower, 0.0)
    first = told.follower.hold
    told.vehicles[FOLLOWER].at_m = (-9.0, 0.0)
    told.now_s = 0.5
    told.report(FOLLOWER)
    holds.keep(told.follower, 0.5)
    assert told.follower.hold == first
    holds.release(told.follower)
    holds.keep(told.follower, 0.5)
    assert told.follower.hold is not None
    assert told.follower.hold.place == told.follower.position


def test_nobody_of_whom_no_place_is_known_begins_to_be_held() -> None:
    told, holds = stopped()
    told.follower.position = None
    holds.keep(told.follower, 0.0)
    assert told.follower.hold is None


@pytest.mark.parametrize(
    ("height_m", "kept_m"),
    [
        (HEIGHT_M + 0.9 * SAME_ALTITUDE_M, HEIGHT_M),
        (HEIGHT_M + 1.1 * SAME_ALTITUDE_M, HEIGHT_M + 1.1 * SAME_ALTITUDE_M),
    ],
)
def test_a_hold_changes_no_height_on_purpose(height_m: float, kept_m: float) -> None:
    """About where it was to fly it keeps that; one that climbs to it stops on its way."""
    told, holds = stopped()
    told.follower.altitude_m = height_m
    holds.keep(told.follower, 0.0)
    assert told.follower.hold is not None
    assert told.follower.hold.altitude_m == pytest.approx(kept_m)


@pytest.mark.parametrize(("away_m", "moved"), [(0.9 * MOVED_M, False), (1.1 * MOVED_M, True)])
def test_a_hold_has_moved_beyond_half_a_metre(away_m: float, moved: bool) -> None:
    told, _ = stopped()
    told.follower.hold = Hold(at(-6.0 + away_m), HEIGHT_M)
    assert moved_off(told.follower) is moved


@pytest.mark.parametrize("backs_off", [True, False])
def test_a_hold_goes_along_only_with_one_that_its_applet_flies_back(backs_off: bool) -> None:
    told, holds = stopped(limits=Limits(leader_flies=False))
    assert told.guard is not None
    holds.keep(told.follower, 0.0)
    first = told.follower.hold
    if backs_off:
        state = mavlink.MAVLink_named_value_float_message(0, b"", APPLET_BACKS_OFF)
        state.name = APPLET_STATE
        told.guard.receive(FOLLOWER, "NAMED_VALUE_FLOAT", state, 0.0)
    told.vehicles[FOLLOWER] = Vehicle((-8.0, 0.0), (-1.0, 0.0))
    for told.now_s in (0.5, 1.0):
        told.report(FOLLOWER)
        holds.keep(told.follower, told.now_s)
    assert (told.follower.hold != first) is backs_off
    if backs_off:
        assert told.follower.hold is not None
        assert from_here_m(told.follower.hold.place)[0] < -8.0


def test_a_hold_that_had_to_give_way_is_held_where_it_has_got_to() -> None:
    told, holds = stopped()
    moved_from = Hold(at(-5.0), HEIGHT_M)
    for pushed_by, place in ((None, moved_from.place), ("follower 3", told.follower.position)):
        told.follower.hold = moved_from
        holds.pushed(told.follower, Allowed(at(-5.0), None, pushed_by))
        assert told.follower.hold.place == place
