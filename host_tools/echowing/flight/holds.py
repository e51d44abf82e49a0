"""A follower that is stopped: where it stands, until there is no reason left. Pure."""

import math

from echowing.flight.guard import Guard
from echowing.flight.heights import Heights
from echowing.flight.state import FollowerState
from echowing.geo import GlobalPosition, displace

# A stop begins once it leans against its motion; a follower that hardly moves stops where it is.
LEAN_S, STANDS_MPS = 0.3, 0.3


class Holds:
    """Stops followers and lets them go again."""

    def __init__(self, heights: Heights, guard: Guard | None) -> None:
        self._heights, self._guard = heights, guard

    def hold(self, follower: FollowerState, reason: str, now_s: float) -> bool:
        """Hold it; True: it was not held before."""
        begins = follower.held_at is None and follower.position is not None
        if begins:
            self._here(follower, now_s)
        follower.hold_reason = reason
        return begins

    def hold_anew(self, follower: FollowerState, now_s: float) -> None:
        """Hold it where it is now: it was held while nothing went to it, and has moved since."""
        self._here(follower, now_s)
        if self._guard is not None:
            self._guard.moving(follower.plan.system_id)

    def release(self, follower: FollowerState) -> None:
        """Hold it no longer."""
        follower.held_at = follower.hold_reason = follower.held_altitude_m = None
        if self._guard is not None:
            self._guard.moving(follower.plan.system_id)

    def _here(self, follower: FollowerState, now_s: float) -> None:
        follower.held_at = _stopping_place(follower, now_s)
        follower.held_altitude_m = self._heights.to_keep_m(follower)


def _stopping_place(follower: FollowerState, now_s: float) -> GlobalPosition | None:
    """Where a follower comes to a stop: flying back to an earlier place would take longer."""
    arrives_s = now_s + follower.way_s
    here = follower.then(arrives_s)
    if here is None:
        return follower.position
    north, east = follower.velocity_then(arrives_s)
    mps = math.hypot(north, east)
    if mps <= STANDS_MPS:
        return here
    share_s = LEAN_S + mps / (2.0 * follower.handling.answer.decel_mps2)
    return displace(here, (north * share_s, east * share_s, -follower.climb_mps * share_s))
