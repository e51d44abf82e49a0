"""How fast a leader may fly, and the word to its operator when it is faster. Pure."""

from echowing.flight.said import Said

# At a corner a leader is behind another leg before its follower has answered. Up to 4 m/s the sonar
# keeps it; faster, it is lost at each corner, and caught up with by GPS. Mean error 0.3 m at 4 m/s,
# 0.7 at 5, 1.4 at 6, 9 m at 8 (RESULTS.md, Leader's speed). The follower's speed parameter does not
# matter: of points with a velocity it limits the correction alone. Points without one are flown at
# ECHO_SPD_MAX (5 m/s) at the most, and catching up takes 1 m/s of it: 4 m/s again.
MOST_LEADER_MPS = 4.0
# Gusts, corners and the receiver's noise take a leader so far over its speed.
OVERSHOOT_MPS = 0.5


class LeaderSpeed:
    """Watches the leader's speed."""

    def __init__(self) -> None:
        self._said, self._fast = Said(), False

    def warning(self, speed_mps: float, now_s: float) -> str | None:
        """What to say of a leader that is too fast, at first and then every 30 s; None: nothing."""
        if speed_mps <= MOST_LEADER_MPS:
            self._fast = False
        if speed_mps > MOST_LEADER_MPS + OVERSHOOT_MPS:
            self._fast = True
        if not self._fast or not self._said.may_say("too fast", now_s):
            return None
        return f"leader too fast, {speed_mps:.1f} m/s (most {MOST_LEADER_MPS:g})"
