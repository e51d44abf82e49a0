"""How high each follower flies, above its own home. Pure."""

from echowing.flight.guard import Guard
from echowing.flight.state import FollowerState, Known

# A follower that stops this near its wanted altitude keeps that (barometers wander), else its own.
SAME_ALTITUDE_M = 1.0


class Heights:
    """leaders: where no altitude was asked for, a follower flies as high as the leader does."""

    def __init__(self, known: Known, guard: Guard | None, *, leaders: bool) -> None:
        self.leaders = leaders
        self._known, self._guard = known, guard

    def commanded_m(self, follower: FollowerState) -> float:
        """The same height above its home as the leader's altitude above the leader's."""
        plan = follower.plan
        shift_m = 0.0 if self._guard is None else self._guard.altitude_shift_m(plan.system_id)
        return plan.wanted_m + shift_m

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
        guard, fix = self._guard, self._known.leader.fix
        home_m = None if guard is None else guard.home_m(self._known.leader_id)
        return None if home_m is None or fix is None else fix.position.alt_m - home_m
