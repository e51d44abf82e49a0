"""How Guided closes the distance to its point, from the vehicle's acceleration and jerk. Pure.

shape_pos_vel_accel_xy (libraries/AP_Math/control.cpp): the speed is proportional to the distance at
first, then to its square root, as a constant deceleration allows. Up to ArduCopter 4.7 half of
jerk / acceleration and half the acceleration are used; 4.8 uses the whole of both and takes off
what the closing speed is about to use up, which leaves the same half in steady flight.
"""

import math
from dataclasses import dataclass

from echowing.flight.envelope import FASTEST_MPS, OTHERS_MPS2


def sqrt_controller(error: float, gain: float, slope_limit: float) -> float:
    """Rate of correction for an error: proportional near zero, then a square root.

    The square root is what a constant deceleration of `slope_limit` allows. A `slope_limit` of 0
    is no limit.
    """
    if slope_limit <= 0.0:
        return error * gain
    linear = slope_limit / (gain * gain)
    if error > linear:
        return math.sqrt(2.0 * slope_limit * (error - 0.5 * linear))
    if error < -linear:
        return -math.sqrt(2.0 * slope_limit * (-error - 0.5 * linear))
    return error * gain


def inverse_sqrt_controller(rate: float, gain: float, slope_limit: float) -> float:
    """Error at which `sqrt_controller` gives this rate: also the distance a stop takes."""
    if slope_limit <= 0.0 or abs(rate) < slope_limit / gain:
        return rate / gain
    distance = 0.5 * slope_limit / (gain * gain) + 0.5 * rate * rate / slope_limit
    return distance if rate > 0.0 else -distance


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

    def speed_mps(self, far_m: float) -> float:
        """How fast it flies towards a point at this distance, on top of the point's velocity."""
        return min(FASTEST_MPS, sqrt_controller(far_m, self.per_s, 0.5 * self.accel_mps2))

    def distance_m(self, speed_mps: float) -> float:
        """The distance at which it flies so fast."""
        return inverse_sqrt_controller(speed_mps, self.per_s, 0.5 * self.accel_mps2)

    def pace_per_s(self, far_m: float) -> float:
        """`speed_mps` for each metre."""
        return self.speed_mps(far_m) / far_m if far_m > 0.0 else self.per_s
