"""Holds the followers of a session whose own tick has failed. Pure.

It uses no more of the session than what its followers have reported, so that what made the tick
fail does not make this fail.
"""

import math
from typing import Any

from echowing.flight.clocks import UNHEARD_S
from echowing.flight.follower import FollowerState
from echowing.flight.guard import Guard
from echowing.flight.known import Known
from echowing.geo import GlobalPosition
from echowing.mavlink.messages import no_velocity, position_target

Place = tuple[GlobalPosition, float]


class Standstill:
    """Where each follower that was moved comes to a stand."""

    def __init__(self, known: Known, guard: Guard | None) -> None:
        self._known, self._guard = known, guard
        self._places: dict[int, Place] = {}

    def messages(self, now_s: float) -> list[tuple[int, Any]]:
        """A point at its place for each follower that was moved, flies in Guided and reports."""
        feed_mps = (0.0, 0.0) if self._known.settings.feed_forward else None
        messages = []
        for system_id, follower in self._known.followers.items():
            heard = now_s - follower.position_at_s <= UNHEARD_S
            if not (follower.in_guided and follower.turn.flown and heard):
                self._places.pop(system_id, None)
                continue
            place = self._places.get(system_id) or _place(follower)
            if place is not None:
                if follower.slewed():
                    messages.append((system_id, no_velocity(system_id, now_s)))
                self._places[system_id] = place
                point = position_target(system_id, *place, None, now_s, feed_mps)
                messages.append((system_id, point))
        return messages

    def verify(self, now_s: float) -> None:
        """Check whether they stand, as a hold of the session does."""
        for system_id in self._places:
            if self._guard is not None:
                self._guard.holding(self._known.followers[system_id], now_s)


def _place(follower: FollowerState) -> Place | None:
    """Where it was to hold already, or where it comes to a stop."""
    hold, here, height_m = follower.hold, follower.left_at, follower.altitude_m
    for at in (
        None if hold is None else (hold.place, hold.altitude_m),
        None if here is None or height_m is None else (here, height_m),
    ):
        if at is not None and all(map(math.isfinite, (*at[0], at[1]))):
            return at
    return None
