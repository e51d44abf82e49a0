"""The parameters that limit how an ArduCopter moves: names by generation, and spans. Pure.

A value outside its span is no vehicle's: it counts as not reported.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class VehicleLimit:
    """One limit: metres, seconds and degrees.

    names: of the parameter, newest generation first, with the factor from its unit; least, most:
    what a vehicle may have; usual: ArduCopter's default, infinite: no limit; none_at_0: 0 stands
    for no limit; slower_if_high: the most is the worst.
    """

    names: Mapping[str, float]
    least: float
    most: float
    usual: float = math.inf
    none_at_0: bool = False
    slower_if_high: bool = False

    @property
    def worst(self) -> float:
        """What a vehicle counts with that has not reported it."""
        return self.most if self.slower_if_high else self.least

    def read(self, name: str, value: float) -> float | None:
        """The limit by a parameter's value, infinite: there is none; None: no vehicle has it."""
        if value == 0.0 and self.none_at_0:
            return math.inf
        # A 32-bit float carries seven digits: 0.15 comes as 0.15000000596.
        limit = float(f"{value * self.names[name]:.6g}")
        return limit if self.least <= limit <= self.most else None


def _same(*names: str) -> dict[str, float]:
    return dict.fromkeys(names, 1.0)


# Least: the lower end of ArduPilot's @Range, or the least that AutoTune sets (40 deg/s2); of the
# rates a third of "slow". Most: well above the upper end of @Range, which pilots exceed.
ACCELERATION = VehicleLimit({"WP_ACC": 1.0, "WPNAV_ACCEL": 0.01}, 0.5, 20.0, 2.5)
JERK = VehicleLimit(_same("PSC_JERK_NE", "PSC_JERK_XY"), 1.0, 100.0, 5.0)
LEAN = VehicleLimit({"ATC_ANGLE_MAX": 1.0, "ANGLE_MAX": 0.01}, 10.0, 80.0, 30.0)
# Of the position controller alone; without it `LEAN` is its limit, too.
GUIDED_LEAN = VehicleLimit(_same("PSC_ANGLE_MAX"), 10.0, 80.0, none_at_0=True)
ROLL_ACCELERATION, PITCH_ACCELERATION = (
    VehicleLimit(
        {f"ATC_ACC_{axis}_MAX": 1.0, f"ATC_ACCEL_{axis}_MAX": 0.01},
        *(40.0, 10_000.0, 1_100.0),
        none_at_0=True,
    )
    for axis in "RP"
)
ROLL_RATE, PITCH_RATE = (
    VehicleLimit(_same(f"ATC_RATE_{axis}_MAX"), 20.0, 2_000.0, none_at_0=True) for axis in "RP"
)
INPUT_TIME = VehicleLimit(_same("ATC_INPUT_TC"), 0.0, 1.0, 0.15, slower_if_high=True)
LIMITS = (
    ACCELERATION,
    JERK,
    LEAN,
    GUIDED_LEAN,
    ROLL_ACCELERATION,
    PITCH_ACCELERATION,
    ROLL_RATE,
    PITCH_RATE,
    INPUT_TIME,
)
BY_NAME = {name: limit for limit in LIMITS for name in limit.names}


def usual_parameters() -> dict[str, float]:
    """What the newest ArduCopter comes with."""
    usual = {next(iter(one.names)): one.usual for one in LIMITS}
    return {name: value if math.isfinite(value) else 0.0 for name, value in usual.items()}


def is_plausible(name: str, value: float) -> bool:
    """Whether a vehicle may have this parameter; of one that is not in the table: any number."""
    limit = BY_NAME.get(name)
    return math.isfinite(value) if limit is None else limit.read(name, value) is not None
