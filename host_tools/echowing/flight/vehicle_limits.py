"""The parameters that limit how an ArduCopter moves: names by generation, and spans. Pure.

A value outside its span is no vehicle's: it counts as not reported.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VehicleLimit:
    """One limit: metres, seconds and degrees.

    names: of the parameter, newest generation first, with the factor from its unit; least, most:
    what a vehicle may have.
    """

    names: Mapping[str, float]
    least: float
    most: float

    def read(self, name: str, value: float) -> float | None:
        """The limit by a parameter's value; None: no vehicle has it."""
        # A 32-bit float carries seven digits: 0.15 comes as 0.15000000596.
        limit = float(f"{value * self.names[name]:.6g}")
        return limit if self.least <= limit <= self.most else None


# Least: the lower end of ArduPilot's @Range. Most: well above its upper end, which pilots exceed.
ACCELERATION = VehicleLimit({"WP_ACC": 1.0, "WPNAV_ACCEL": 0.01}, 0.5, 20.0)
JERK = VehicleLimit({"PSC_JERK_NE": 1.0, "PSC_JERK_XY": 1.0}, 1.0, 100.0)
LEAN = VehicleLimit({"ATC_ANGLE_MAX": 1.0, "ANGLE_MAX": 0.01}, 10.0, 80.0)
LIMITS = (ACCELERATION, JERK, LEAN)
BY_NAME = {name: limit for limit in LIMITS for name in limit.names}


def is_plausible(name: str, value: float) -> bool:
    """Whether a vehicle may have this parameter; True for one that is not in the table."""
    limit = BY_NAME.get(name)
    return math.isfinite(value) if limit is None else limit.read(name, value) is not None
