"""Followers come into their slots one after the other. Pure.

Until its sonar has found the vehicle that it looks at, a follower's place is known no better than
the receivers tell. Two that come in side by side have an error each, and take each other's echoes
for the leader's. So who has neighbours before it in the formation waits behind its slot, as far off
as receivers alone allow, until they are in theirs. Who does not find the one it looks at goes back
there and lets the next one come in, and tries again later: never found, it is not near for long.
"""

import math

from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.follower import FollowerState
from echowing.flight.formation import receivers_demand_m
from echowing.flight.guidance import place_m
from echowing.flight.known import Known
from echowing.flight.steps import Phase

# A follower finds its leader within 7 s, with most sonars that are worse than believed within 20
# (`echowing bench --only robust`). So long it tries, and then keeps off before it tries again.
JOINS_WITHIN_S = 20.0
# Whose sonar knows twice as much as receivers tell. Where the first of a vee was known less well,
# the next one took its echo for the leader's.
FOUND_SIGMA_M = 0.5 * UNRANGED_SIGMA_M


class Joining:
    """Whose turn it is among the followers of one session."""

    def __init__(self, known: Known) -> None:
        self._known = known

    def waits_for(self, follower: FollowerState, now_s: float) -> FollowerState | None:
        """Who has to be in his slot before this one comes into its own; None: nobody.

        Asked in each tick in which the follower is led.
        """
        turn, settings = follower.turn, self._known.settings
        if turn.joined or not settings.learn_offset or settings.swarm is not None:
            return None
        before = self._before(follower)
        if before is None:
            if math.isinf(turn.joins_at_s) and not follower.estimate.offset.has_heard:
                self._known.expect(follower)
            turn.joins_at_s = min(turn.joins_at_s, now_s)
            tries = int((now_s - turn.joins_at_s) / JOINS_WITHIN_S)
            turn.joined = self._has_found(follower, now_s) or (self._alone and tries > 0)
            turns = tries % 2 == 0 or follower.estimate.hears(now_s)
            seeks = self._alone or (turns and follower.estimate.listens(now_s))
            turn.gave_up = not (turn.joined or seeks)
        turn.waits = before is not None or turn.gave_up
        comes_in = not (turn.waits or turn.joined or self._alone)
        turn.seeks_at_s = min(turn.seeks_at_s, now_s) if comes_in else math.inf
        return before

    @property
    def _alone(self) -> bool:
        return len(self._known.followers) == 1

    def _has_found(self, follower: FollowerState, now_s: float) -> bool:
        """Whether its sonar tells much more of the one that it looks at than receivers do."""
        estimate = follower.estimate
        found = estimate.hears(now_s) and estimate.offset.level_sigma_m < FOUND_SIGMA_M
        return found and not estimate.elsewhere_m

    def _before(self, follower: FollowerState) -> FollowerState | None:
        """The first neighbour before it in the formation that is led and has not joined."""
        followers = list(self._known.followers.values())
        slots = [one.plan.slot for one in followers]
        apart_m = receivers_demand_m(self._known.settings.clearance_m)
        here_m = place_m(slots, followers.index(follower))
        for one in sorted(followers, key=self._links):  # those with as many stay in order
            if one is follower:
                break
            joins = one.standing.phase is Phase.LED and not (one.turn.joined or one.turn.gave_up)
            if joins and math.dist(place_m(slots, followers.index(one)), here_m) < apart_m:
                return one
        return None

    def _links(self, follower: FollowerState) -> int:
        """How many sonars it is behind the leader."""
        return len(list(self._known.chain(follower)))
