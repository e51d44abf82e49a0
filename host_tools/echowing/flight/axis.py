"""The direction a sonar looks along, in the earth frame, and its quaternion. Pure.

The co-processor reckons the same way (`firmware/echowing/src/core`), and so does the applet.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from echowing.geo import Ned

Quaternion = tuple[float, float, float, float]
# A quaternion of a rotation has the length 1; 32-bit floats and a sender's own sums are off by far
# less than this.
LENGTH_OFF = 0.1


@dataclass(frozen=True, slots=True)
class Axis:
    """azimuth_rad: clockwise from true north; elevation_rad: upwards from level."""

    azimuth_rad: float
    elevation_rad: float = 0.0

    @property
    def unit_ned(self) -> Ned:
        """The unit vector along it."""
        level = math.cos(self.elevation_rad)
        return (
            level * math.cos(self.azimuth_rad),
            level * math.sin(self.azimuth_rad),
            -math.sin(self.elevation_rad),
        )

    @property
    def quaternion(self) -> Quaternion:
        """The rotation from north to it (w, x, y, z): to its azimuth, then up."""
        sin_a, cos_a = math.sin(0.5 * self.azimuth_rad), math.cos(0.5 * self.azimuth_rad)
        sin_e, cos_e = math.sin(0.5 * self.elevation_rad), math.cos(0.5 * self.elevation_rad)
        return cos_a * cos_e, -sin_a * sin_e, cos_a * sin_e, sin_a * cos_e


def along(vector: Ned) -> Axis:
    """The axis along a vector of any length, NED."""
    north, east, down = vector
    return Axis(math.atan2(east, north), math.atan2(-down, math.hypot(north, east)))


def axis_of(quaternion: Sequence[float]) -> Axis | None:
    """The axis of a rotation (w, x, y, z) from north; None: that is no rotation."""
    w, x, y, z = quaternion
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= LENGTH_OFF:  # NaN is none either
        return None
    return along((w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)))
