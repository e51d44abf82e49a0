"""Followers come into their slots one after the other. Pure.

Until its sonar has found the vehicle that it looks at, a follower's place is known no better than
the receivers tell. Two that come in side by side have an error each, and take each other's echoes
for the leader's. So who has neighbours before it in the formation waits behind its slot, as far off
as receivers alone allow, until they are in theirs.
"""

import math

from echowing.flight.formation import place_m, receivers_demand_m
from echowing.flight.state import FollowerState, Known
from echowing.flight.steps import Phase

# A follower finds its leader within 5 s, with most sonars that are worse than believed within 20
# (`echowing bench --only robust`). Nobody waits for a deaf one for ever.
JOINS_WITHIN_S = 20.0


class Joining:
    """Whose turn it is among the followers of one session."""

    def __init__(self, known: Known) -> None:
        self._known = known

    def waits_for(self, follower: FollowerState, now_s: float) -> FollowerState | None:
        """Who has to be in his slot before this one comes into its own; None: nobody.

        Asked in each tick in which the follower is led.
        """
        turn = follower.turn
        if turn.joined:
            return None
        before = self._before(follower)
        turn.waits = before is not None
        if not turn.waits:
            turn.joins_at_s = min(turn.joins_at_s, now_s)
            late = now_s - turn.joins_at_s > JOINS_WITHIN_S
            turn.joined = late or follower.estimate.hears(now_s)
        return before

    def _before(self, follower: FollowerState) -> FollowerState | None:
        """The first neighbour before it in the formation that is led and has not joined."""
        followers = list(self._known.followers.values())
        slots = [one.plan.slot for one in followers]
        number = followers.index(follower)
        settings = self._known.settings
        if not settings.learn_offset or settings.swarm is not None:
            return None
        apart_m = receivers_demand_m(settings.clearance_m)
        here_m = place_m(slots, number)
        for other, one in enumerate(followers[:number]):
            joins = one.standing.phase is Phase.LED and not one.turn.joined
            if joins and math.dist(place_m(slots, other), here_m) < apart_m:
                return one
        return None
