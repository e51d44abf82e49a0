"""How high each follower flies, above its own home. Pure."""

import math

from echowing.flight.follower import FollowerState
from echowing.flight.known import Known
from echowing.flight.lowest import LOWEST_M

# By so much the barometers of two vehicles in flight may disagree, and a vehicle climbs no faster
# than this for it, so that nothing else notices.
MOST_M, CLIMB_MPS = 3.0, 0.3
# What the beam tells of heights is flown after up to so many standard deviations: within them the
# leader may as well be where it is.
SURE_SIGMAS = 1.5
# A follower that stops this near its wanted altitude keeps that (barometers wander), else its own.
SAME_ALTITUDE_M = 1.0


class Heights:
    """leaders: where no altitude was asked for, a follower flies as high as the leader does."""

    def __init__(self, known: Known, *, leaders: bool) -> None:
        self._known, self.leaders = known, leaders

    def commanded_m(self, follower: FollowerState) -> float:
        """The same height above its home as the leader's altitude above the leader's."""
        plan = follower.plan
        return plan.wanted_m + self._known.homes.shift_m(plan.system_id)

    def level_m(self, follower: FollowerState, now_s: float) -> float:
        """As `commanded_m`, and as high as the leader truly is, as far as the sonar shows it.

        The beam tells how far the two barometers disagree; flown after, that leaves the beam.
        """
        elapsed_s, follower.levelled_at_s = now_s - follower.levelled_at_s, now_s
        offset = follower.estimate.offset
        if follower.estimate.hears(now_s):
            ahead = self._known.ahead_of(follower)
            its_m = 0.0 if ahead is None else ahead.level_m
            off_m = max(-MOST_M, min(MOST_M, its_m - offset.up_m)) - follower.level_m
            sure_m = max(0.0, abs(off_m) - SURE_SIGMAS * offset.up_sigma_m)
            change_m = min(sure_m, CLIMB_MPS * min(elapsed_s, 1.0))
            follower.level_m += math.copysign(change_m, off_m)
        return max(LOWEST_M, self.commanded_m(follower) + follower.level_m)

    def wanted_m(self, follower: FollowerState) -> float | None:
        """As `commanded_m`; None: not known yet."""
        if self.leaders and self._leaders_m() is None:
            return None
        return self.commanded_m(follower)

    def take_leaders(self, follower: FollowerState) -> None:
        """Where no altitude was asked for: a follower flies as high as the leader does now."""
        height_m = self._leaders_m()
        if self.leaders and height_m is not None:
            follower.plan.altitude_m = round(height_m, 1)

    def to_keep_m(self, follower: FollowerState) -> float:
        """For a stop: the wanted altitude where it is about there, else its own."""
        wanted_m = self.commanded_m(follower)
        if follower.altitude_m is None or abs(follower.altitude_m - wanted_m) <= SAME_ALTITUDE_M:
            return wanted_m
        return follower.altitude_m

    def _leaders_m(self) -> float | None:
        """The leader's altitude above its home."""
        fix, home_m = self._known.leader.fix, self._known.homes.above_sea_m(self._known.leader_id)
        return None if home_m is None or fix is None else fix.position.alt_m - home_m
