"""How much of its lean the wind leaves a follower to brake with. Pure.

A copter leans against the air that it flies through. What it needs of its lean for that is not
there to brake with: blown at its leader with all of its lean in use, it cannot stop at all. It
brakes from its own speed to none, and on to as much the other way: so what counts is the lean with
which it would hover in the wind, not the one of its flight.
"""

import math

from echowing.flight.guidance import Horizontal, between
from echowing.geo import GRAVITY_MPS2

# The mean lean and the mean velocity of this time tell the wind, without the follower's own
# manoeuvres; gusts are shorter.
MEAN_S = 4.0
# A gust a quarter above the mean wind pushes half as hard again: drag grows with the square.
GUST_SHARE = 0.5
# The air's drag, by speed and by its square: rotors and body of ArduPilot's simulated quad, which
# leans by 45 degrees at 15 m/s (SIM_Frame.cpp). It only tells the drag of hovering from that of
# flight, so a copter with other drag is only wrong by what its own speed makes of that.
ROTORS_PER_S, BODY_PER_M = 0.246, 0.035
# Something is left to brake with: the lean is limited before the thrust is.
LEAST_MPS2 = 0.5


class Wind:
    """What one follower leans against, from its ATTITUDE and its velocity."""

    def __init__(self) -> None:
        self._mean_lean_mps2: Horizontal = (0.0, 0.0)
        self._mean_mps: Horizontal | None = None
        self._hovers_mps2: Horizontal = (0.0, 0.0)
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
        self._mean_mps = between(self._mean_mps, velocity_mps, share)
        self._mean_lean_mps2 = between(self._mean_lean_mps2, lean_mps2, share)
        # The mean acceleration is how far the velocity is from its mean, over the time of the mean.
        north_mps2, east_mps2 = self._mean_lean_mps2
        north_mps, east_mps = _airspeed_mps(
            north_mps2 - (velocity_mps[0] - self._mean_mps[0]) / MEAN_S,
            east_mps2 - (velocity_mps[1] - self._mean_mps[1]) / MEAN_S,
        )
        self._hovers_mps2 = _drag_mps2(north_mps - self._mean_mps[0], east_mps - self._mean_mps[1])

    def leaves_mps2(self, bearing_rad: float, lean_max_rad: float) -> float:
        """The hardest braking, in a gust, of a flight towards a bearing."""
        north_mps2, east_mps2 = self._hovers_mps2
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


def _drag_mps2(north_mps: float, east_mps: float) -> Horizontal:
    """The lean that flight through the air takes, at this airspeed."""
    per_s = ROTORS_PER_S + BODY_PER_M * math.hypot(north_mps, east_mps)
    return per_s * north_mps, per_s * east_mps


def _airspeed_mps(north_mps2: float, east_mps2: float) -> Horizontal:
    """The airspeed that takes this lean."""
    drag_mps2 = math.hypot(north_mps2, east_mps2)
    root = math.sqrt(ROTORS_PER_S**2 + 4.0 * BODY_PER_M * drag_mps2)
    per_s = 0.5 * (ROTORS_PER_S + root)
    return north_mps2 / per_s, east_mps2 / per_s
