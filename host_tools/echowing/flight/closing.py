"""How Guided closes the distance to its point, from the vehicle's acceleration and jerk. Pure.

shape_pos_vel_accel_xy (libraries/AP_Math/control.cpp): the speed is proportional to the distance at
first, then to its square root, as a constant deceleration allows. Up to ArduCopter 4.7 half of
jerk / acceleration and half the acceleration are used; 4.8 uses the whole of both and takes off
what the closing speed is about to use up, which leaves the same half in steady flight.
"""

import math
from dataclasses import dataclass

from echowing.flight.envelope import OTHERS_MPS2

# The fastest correction that is reckoned with: WPNAV_SPEED's default up to 4.7.
MOST_MPS = 5.0


@dataclass(frozen=True, slots=True)
class Closing:
    """The law of one vehicle. The defaults are ArduCopter's WP_ACC and PSC_JERK_NE."""

    accel_mps2: float = OTHERS_MPS2
    jerk_mps3: float = 5.0

    @property
    def per_s(self) -> float:
        """The speed for each metre, near the point."""
        return 0.5 * self.jerk_mps3 / self.accel_mps2

    @property
    def turns_per_s(self) -> float:
        """The acceleration for each m/s that the velocity is off, up to `accel_mps2`."""
        return self.jerk_mps3 / self.accel_mps2

    @property
    def _linear_m(self) -> float:
        return 0.5 * self.accel_mps2 / self.per_s**2

    def speed_mps(self, far_m: float) -> float:
        """How fast it flies towards a point at this distance, on top of the point's velocity."""
        if far_m <= self._linear_m:
            return self.per_s * far_m
        return min(MOST_MPS, math.sqrt(self.accel_mps2 * (far_m - 0.5 * self._linear_m)))

    def distance_m(self, speed_mps: float) -> float:
        """The distance at which it flies so fast."""
        if speed_mps <= self.per_s * self._linear_m:
            return speed_mps / self.per_s
        return speed_mps**2 / self.accel_mps2 + 0.5 * self._linear_m

    def pace_per_s(self, far_m: float) -> float:
        """`speed_mps` for each metre."""
        return self.speed_mps(far_m) / far_m if far_m > self._linear_m else self.per_s
