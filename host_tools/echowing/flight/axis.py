"""The direction a sonar looks along, in the earth frame, and its quaternion. Pure.

The co-processor reckons the same way (`firmware/echowing/src/core`), and so does the applet.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from echowing.geo import Ned

Quaternion = tuple[float, float, float, float]
# A quaternion of a rotation has the length 1; 32-bit floats and a sender's own sums are off by far
# less than this.
LENGTH_OFF = 0.1
# Nearer than this a direction turns faster than anything could follow.
NEAREST_M = 1.0


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


def turns_rps(to_it: Ned, past_mps: Ned) -> tuple[float, float]:
    """How fast the direction (azimuth, elevation) turns of what moves past at a velocity, NED."""
    (north, east, _), (north_mps, east_mps, down_mps) = to_it, past_mps
    level_m = max(NEAREST_M, math.hypot(north, east))
    return (north * east_mps - east * north_mps) / (level_m * level_m), -down_mps / level_m


def apart_rad(one: Iterable[float], other: Iterable[float]) -> float:
    """The angle between two directions, vectors in the same frame; to none it is a right angle."""
    one, other = list(one), list(other)
    lengths = math.hypot(*one) * math.hypot(*other) or 1.0
    along = sum(x * y for x, y in zip(one, other, strict=True))
    return math.acos(max(-1.0, min(1.0, along / lengths)))


def spread_rad(across_m: float, to_it: Ned) -> float:
    """The angle by which something is seen aside that is so far across."""
    return math.atan2(across_m, max(NEAREST_M, math.hypot(*to_it)))


def axis_of(quaternion: Sequence[float]) -> Axis | None:
    """The axis of a rotation (w, x, y, z) from north; None: that is no rotation."""
    w, x, y, z = quaternion
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= LENGTH_OFF:  # NaN is none either
        return None
    return along((w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)))
