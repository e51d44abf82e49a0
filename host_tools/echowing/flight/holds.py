"""A follower that is stopped: where it stands, until there is no reason left. Pure."""

import math
from dataclasses import replace

from echowing.flight.follower import FollowerState
from echowing.flight.guard import STILL_MPS, Guard
from echowing.flight.guidance import Horizontal
from echowing.flight.heights import Heights
from echowing.flight.own_motion import NOT_YET_S
from echowing.flight.steps import Allowed, Hold
from echowing.geo import GlobalPosition, displace, distance_m

# A stop begins once it leans against its motion; a follower that hardly moves stops where it is.
LEAN_S = 0.3
# A hold that has been moved by this much has its place where the vehicle is.
MOVED_M = 0.5


class Holds:
    """Stops followers and lets them go again."""

    def __init__(self, heights: Heights, guard: Guard | None) -> None:
        self._heights, self._guard = heights, guard

    def keep(self, follower: FollowerState, now_s: float) -> None:
        """Hold it where it comes to a stop, or where it was held before."""
        if follower.hold is None:
            self._here(follower, now_s)
        self._go_along(follower, now_s)

    def _go_along(self, follower: FollowerState, now_s: float) -> None:
        """Hold one that its applet has flown back where it gets to, not where it was.

        Back there it would meet the leader again, and move although it is stopped.
        """
        stands = follower.ground_speed_mps <= STILL_MPS
        if (
            self._guard is not None
            and self._guard.has_backed_off(follower.plan.system_id, stands=stands)
            and moved_off(follower)
        ):
            self._here(follower, now_s)

    def release(self, follower: FollowerState) -> None:
        """Hold it no longer."""
        if follower.hold is None:
            return
        follower.hold = None
        if self._guard is not None:
            self._guard.moving(follower.plan.system_id)

    def pushed(self, follower: FollowerState, allowed: Allowed) -> None:
        """Hold one that gives way where it has been moved to."""
        if follower.hold is None or follower.position is None or allowed.gives_way_to is None:
            return
        if moved_off(follower):
            follower.hold = replace(follower.hold, place=follower.position)

    def _here(self, follower: FollowerState, now_s: float) -> None:
        place = _stopping_place(follower, now_s)
        if place is not None:
            follower.hold = Hold(place, self._heights.to_keep_m(follower))


def moved_off(follower: FollowerState) -> bool:
    """Whether one that is held has been moved away from its place."""
    if follower.hold is None or follower.position is None:
        return False
    return distance_m(follower.hold.place, follower.position) > MOVED_M


def _stopping_place(follower: FollowerState, now_s: float) -> GlobalPosition | None:
    """Where a follower comes to a stop: flying back to an earlier place would take longer."""
    arrives_s = now_s + follower.way_s
    here = follower.then(arrives_s)
    if here is None:
        return follower.position
    north, east = follower.velocity_then(arrives_s)
    mps = math.hypot(north, east)
    if mps <= STILL_MPS:
        return here
    since_s = min(NOT_YET_S, max(0.0, arrives_s - follower.position_at_s))
    share_s = _stopping_m(mps, _gains_mps2(follower, (north, east)), since_s, follower) / mps
    return displace(here, (north * share_s, east * share_s, -follower.climb_mps * share_s))


def _gains_mps2(follower: FollowerState, velocity_mps: Horizontal) -> float:
    """How fast it is gaining speed, no more than it can; negative: it brakes already."""
    north_mps2, east_mps2 = follower.acceleration_mps2
    north, east = velocity_mps
    gains_mps2 = (north_mps2 * north + east_mps2 * east) / math.hypot(north, east)
    most_mps2 = follower.handling.closing.accel_mps2
    return max(-most_mps2, min(most_mps2, gains_mps2))


def _stopping_m(mps: float, gains_mps2: float, since_s: float, follower: FollowerState) -> float:
    """Metres to a stop: its speed goes on changing until it leans, from its report `since_s` ago.

    As `stopping_m` of the applet. The wind is left out: a vehicle would speed up to a place that is
    too far; from one that is too near it only comes back.
    """
    changes_s = since_s + LEAN_S
    then_mps = max(0.0, mps + gains_mps2 * changes_s)
    until_m = 0.5 * (mps + then_mps) * changes_s - mps * since_s
    brakes_mps2 = follower.handling.closing.accel_mps2
    return until_m + then_mps * then_mps / (2.0 * brakes_mps2)
