"""How much of its lean the wind leaves a follower to brake with. Pure.

A copter leans against the wind and the drag of its own flight. What it needs of its lean for that
is not there to brake with: blown at its leader with all of its lean in use, it cannot stop at all.
"""

import math

from echowing.flight.guidance import Horizontal
from echowing.geo import GRAVITY_MPS2

# The mean lean and the mean velocity of this time tell the wind, without the follower's own
# manoeuvres; gusts are shorter.
MEAN_S = 4.0
# A gust a quarter above the mean wind pushes half as hard again: drag grows with the square.
GUST_SHARE = 0.5
# Something is left to brake with: the lean is limited before the thrust is.
LEAST_MPS2 = 0.5


class Wind:
    """What one follower leans against, from its ATTITUDE and its velocity."""

    def __init__(self) -> None:
        self._mean_lean_mps2: Horizontal = (0.0, 0.0)
        self._mean_mps: Horizontal | None = None
        self._steady_mps2: Horizontal = (0.0, 0.0)
        self._at_s = -math.inf

    def leans(
        self, attitude_rad: tuple[float, float, float], velocity_mps: Horizontal, now_s: float
    ) -> None:
        """Take roll, pitch and yaw, and the velocity (north, east) at that time."""
        lean_mps2 = _lean_mps2(*attitude_rad)
        elapsed_s = now_s - self._at_s
        self._at_s = now_s
        if self._mean_mps is None or elapsed_s > MEAN_S:
            self._mean_mps, self._mean_lean_mps2 = velocity_mps, lean_mps2
        share = 1.0 - math.exp(-elapsed_s / MEAN_S)
        self._mean_mps = _towards(self._mean_mps, velocity_mps, share)
        self._mean_lean_mps2 = _towards(self._mean_lean_mps2, lean_mps2, share)
        # The mean acceleration is how far the velocity is from its mean, over the time of the mean.
        north_mps2, east_mps2 = self._mean_lean_mps2
        self._steady_mps2 = (
            north_mps2 - (velocity_mps[0] - self._mean_mps[0]) / MEAN_S,
            east_mps2 - (velocity_mps[1] - self._mean_mps[1]) / MEAN_S,
        )

    def leaves_mps2(self, bearing_rad: float, lean_max_rad: float) -> float:
        """The hardest braking, in a gust, of a flight towards a bearing."""
        north_mps2, east_mps2 = self._steady_mps2
        cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
        along_mps2 = north_mps2 * cos + east_mps2 * sin
        across_mps2 = (1.0 + GUST_SHARE) * (east_mps2 * cos - north_mps2 * sin)
        most_mps2 = GRAVITY_MPS2 * math.tan(lean_max_rad)
        back_mps2 = math.sqrt(max(0.0, most_mps2**2 - across_mps2**2))
        gust_mps2 = GUST_SHARE * math.hypot(north_mps2, east_mps2)
        return max(LEAST_MPS2, back_mps2 + along_mps2 - gust_mps2)


def _lean_mps2(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Horizontal:
    """The level acceleration of a lean that keeps the height, (north, east)."""
    forward_mps2 = -GRAVITY_MPS2 * math.tan(pitch_rad)
    right_mps2 = GRAVITY_MPS2 * math.tan(roll_rad) / math.cos(pitch_rad)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward_mps2 * cos - right_mps2 * sin, forward_mps2 * sin + right_mps2 * cos


def _towards(mean: Horizontal, value: Horizontal, share: float) -> Horizontal:
    return mean[0] + share * (value[0] - mean[0]), mean[1] + share * (value[1] - mean[1])
