"""Parameters of the simulated autopilot: names, units and defaults by ArduCopter generation."""

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.parameter_table import TABLE
from echowing.sim.vehicle.wpnav import LeanLimits, TrackLimits

NAME_CHARACTERS = 16  # AP_MAX_NAME_SIZE, and the width of the field in MAVLink
SCRIPT_TABLES = 5  # AP_Param.cpp: dynamic tables for scripts, at most so many
SCRIPT_TABLE_KEYS = range(1, 201)  # add_table takes a key of 1 to 200
SCRIPT_TABLE_PARAMETERS = range(1, 64)  # and so many parameters in one


class Generation(Enum):
    """A released line of ArduCopter. They differ in names, units and how they fly (`tuning_of`)."""

    V4_5 = "4.5"
    V4_6 = "4.6"
    V4_7 = "4.7"
    V4_8 = "4.8"


@dataclass(frozen=True)
class Dialect:
    """How one generation names and scales what the autopilot model itself uses.

    Scales turn the parameter's unit into SI.
    """

    speed: str
    speed_scale: float
    speed_floor: float  # in the parameter's unit; AC_WPNav.cpp
    system_id: str
    ground_station_id: str
    range_min: str
    range_max: str
    range_scale: float
    rtl_altitude: str
    rtl_altitude_scale: float
    rtl_speed: str
    rtl_speed_scale: float
    stream_prefix: str
    first_stream: int
    skips_checks: bool  # ARMING_SKIPCHK names what is left out; ARMING_CHECK what is done
    filters_address: bool  # RNGFND1_ADDR picks a MAVLink rangefinder by its id
    limits: Mapping[str, tuple[str, float]]  # of `TrackLimits`: parameter and scale
    version: tuple[int, int]


_METRIC_LIMITS = {
    "acceleration_mps2": ("WP_ACC", 1.0),
    "vertical_acceleration_mps2": ("WP_ACC_Z", 1.0),
    "corner_acceleration_mps2": ("WP_ACC_CNR", 1.0),
    "jerk_mps3": ("WP_JERK", 1.0),
    "climb_mps": ("WP_SPD_UP", 1.0),
    "descent_mps": ("WP_SPD_DN", 1.0),
    "radius_m": ("WP_RADIUS_M", 1.0),
    "shaping_jerk_mps3": ("PSC_JERK_NE", 1.0),
}
_CENTIMETRE_LIMITS = {
    "acceleration_mps2": ("WPNAV_ACCEL", 0.01),
    "vertical_acceleration_mps2": ("WPNAV_ACCEL_Z", 0.01),
    "corner_acceleration_mps2": ("WPNAV_ACCEL_C", 0.01),
    "jerk_mps3": ("WPNAV_JERK", 1.0),
    "climb_mps": ("WPNAV_SPEED_UP", 0.01),
    "descent_mps": ("WPNAV_SPEED_DN", 0.01),
    "radius_m": ("WPNAV_RADIUS", 0.01),
    "shaping_jerk_mps3": ("PSC_JERK_XY", 1.0),
}

# What `LeanLimits` is made of, in all generations.
_LEAN = (
    "PSC_ANGLE_MAX",
    *("ATC_ANGLE_MAX", "ANGLE_MAX"),
    "ATC_INPUT_TC",
    *("ATC_RATE_R_MAX", "ATC_RATE_P_MAX"),
    *("ATC_ACC_R_MAX", "ATC_ACC_P_MAX", "ATC_ACCEL_R_MAX", "ATC_ACCEL_P_MAX"),
)


@cache
def dialect_of(generation: Generation) -> Dialect:
    """The names and scales of a generation."""
    major, minor = (int(number) for number in generation.value.split("."))
    metric = minor >= 7  # WP_SPD, MAV_SYSID, RNGFND1_MAX, MAV1_*
    metric_rtl = minor >= 8  # RTL_ALT_M
    floors = {5: 20.0, 6: 20.0, 7: 0.1, 8: 0.01}
    return Dialect(
        speed="WP_SPD" if metric else "WPNAV_SPEED",
        speed_scale=1.0 if metric else 0.01,
        speed_floor=floors[minor],
        system_id="MAV_SYSID" if metric else "SYSID_THISMAV",
        ground_station_id="MAV_GCS_SYSID" if metric else "SYSID_MYGCS",
        range_min="RNGFND1_MIN" if metric else "RNGFND1_MIN_CM",
        range_max="RNGFND1_MAX" if metric else "RNGFND1_MAX_CM",
        range_scale=1.0 if metric else 0.01,
        rtl_altitude="RTL_ALT_M" if metric_rtl else "RTL_ALT",
        rtl_altitude_scale=1.0 if metric_rtl else 0.01,
        rtl_speed="RTL_SPEED_MS" if metric_rtl else "RTL_SPEED",
        rtl_speed_scale=1.0 if metric_rtl else 0.01,
        stream_prefix="MAV" if metric else "SR",
        first_stream=1 if metric else 0,
        skips_checks=minor >= 8,
        filters_address=minor >= 8,
        limits=_METRIC_LIMITS if metric else _CENTIMETRE_LIMITS,
        version=(major, minor),
    )


_MAVLINK_TYPES = {
    "int8": mavlink.MAV_PARAM_TYPE_INT8,
    "int16": mavlink.MAV_PARAM_TYPE_INT16,
    "int32": mavlink.MAV_PARAM_TYPE_INT32,
    "real32": mavlink.MAV_PARAM_TYPE_REAL32,
}
_SPANS = {"int8": 2**7, "int16": 2**15, "int32": 2**31}
_LARGEST = 3.4e38  # a 32-bit float


@cache
def _rows(generation: Generation) -> tuple[tuple[str, str, float], ...]:
    column = 2 + list(Generation).index(generation)
    fields = [line.split() for line in TABLE.strip().splitlines()]
    return tuple((f[0], f[1], float(f[column])) for f in fields if f[column] != "-")


@cache
def spans_of(generation: Generation) -> Mapping[str, tuple[float, float]]:
    """The least and greatest value of each parameter that this generation has, by its type."""
    spans = {kind: (float(-span), float(span - 1)) for kind, span in _SPANS.items()}
    return {name: spans.get(kind, (-_LARGEST, _LARGEST)) for name, kind, _ in _rows(generation)}


def float32(value: float) -> float:
    """The nearest 32-bit float, which is what the autopilot keeps."""
    return float(struct.unpack("f", struct.pack("f", value))[0])


class Parameters:
    """The parameters of one vehicle: values in force, and values that survive a restart.

    `saved` are the values kept from former flights. Names unknown to this firmware are kept for a
    script that may add them, and otherwise ignored in silence, as in a parameter file.
    """

    def __init__(self, generation: Generation, saved: Mapping[str, float]) -> None:
        self.dialect = dialect_of(generation)
        self.saved = {name: float32(value) for name, value in saved.items()}
        self._types: dict[str, str] = {}
        self._defaults: dict[str, float] = {}
        self._values: dict[str, float] = {}
        self._names: list[str] = []
        self._tables: dict[int, tuple[str, int]] = {}
        self._motion_limits: TrackLimits | None = None
        """None: one of the parameters that they are made of was set."""
        self._of_motion = {*_LEAN, *(name for name, _ in self.dialect.limits.values())}
        for name, kind, default in _rows(generation):
            self._declare(name, kind, default)

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[tuple[str, float, float]]:
        """Name, value and default of each, in the order of the indices."""
        return ((name, self._values[name], self._defaults[name]) for name in self._names)

    def _declare(self, name: str, kind: str, default: float) -> None:
        self._types[name] = kind
        self._defaults[name] = float32(default)
        self._names.append(name)
        self._values[name] = self._fitted(name, self.saved.get(name, default))

    def _fitted(self, name: str, value: float) -> float:
        span = _SPANS.get(self._types[name])
        if span is None:
            return float32(value)
        return float(max(-span, min(span - 1, round(value))))

    def get(self, name: str) -> float | None:
        """Value in force, or None where there is no such parameter."""
        return self._values.get(name)

    def value(self, name: str) -> float:
        """Value in force; 0 where this firmware lacks it."""
        return self._values.get(name, 0.0)

    def set(self, name: str, value: float) -> bool:
        """Put a value in force until the next restart; False: no such parameter, or no number."""
        if name not in self._values or not math.isfinite(value):
            return False
        self._values[name] = self._fitted(name, value)
        if name in self._of_motion:
            self._motion_limits = None
        return True

    def save(self, name: str, value: float) -> bool:
        """Put a value in force and keep it; False as for `set`."""
        if not self.set(name, value):
            return False
        self.saved[name] = self._values[name]
        return True

    def add_table(self, key: int, prefix: str, count: int) -> bool:
        """Room for `count` parameters of a script; False: key, prefix or size taken or wrong."""
        known = self._tables.get(key)
        if known is not None:
            return known[0] == prefix and known[1] >= count
        taken = any(prefix == other for other, _ in self._tables.values())
        names_taken = any(name.startswith(prefix) for name in self._names)
        fits = key in SCRIPT_TABLE_KEYS and count in SCRIPT_TABLE_PARAMETERS
        if taken or names_taken or not fits or len(self._tables) >= SCRIPT_TABLES:
            return False
        self._tables[key] = (prefix, count)
        return True

    def add(self, key: int, index: int, name: str, default: float) -> bool:
        """Add one parameter of a script (`name` without prefix): its saved value, or the default.

        So it is, too, for a script that is restarted (AP_Param::add_param): a value that was only
        set is gone then.
        """
        table = self._tables.get(key)
        if table is None or not 1 <= index <= table[1]:
            return False
        full = table[0] + name
        if len(full) > NAME_CHARACTERS:
            return False
        if full in self._values:
            self._values[full] = float32(self.saved.get(full, default))
        else:
            self._declare(full, "real32", default)
        return True

    def index(self, name: str) -> int:
        """Place of a parameter in the list."""
        return self._names.index(name)

    def name(self, index: int) -> str | None:
        """Name at a place, None beyond the list."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def mavlink_type(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter."""
        return int(_MAVLINK_TYPES[self._types[name]])

    def speed_mps(self) -> float:
        """The speed parameter."""
        return self.value(self.dialect.speed) * self.dialect.speed_scale

    def motion_limits(self) -> TrackLimits:
        """The limits of acceleration, jerk and vertical speed; defaults where 0 or less is set."""
        if self._motion_limits is None:
            self._motion_limits = self._read_motion_limits()
        return self._motion_limits

    def _read_motion_limits(self) -> TrackLimits:
        names, defaults = self.dialect.limits, TrackLimits()
        read = {
            key: self.value(name) * scale
            for key, (name, scale) in names.items()
            if self.value(name) > 0.0
        }
        acceleration = read.get("acceleration_mps2", defaults.acceleration_mps2)
        read = {"corner_acceleration_mps2": 2.0 * acceleration, **read}
        return replace(defaults, **read, lean=self._lean_limits())

    def _lean_limits(self) -> LeanLimits:
        """How far and how quickly it leans; of a name that this firmware lacks the value is 0."""
        lean_deg = self.value("ATC_ANGLE_MAX") + 0.01 * self.value("ANGLE_MAX")
        rate_dps = min(self.value(f"ATC_RATE_{axis}_MAX") for axis in "RP")
        acceleration_dps2 = min(
            self.value(f"ATC_ACC_{axis}_MAX") + 0.01 * self.value(f"ATC_ACCEL_{axis}_MAX")
            for axis in "RP"
        )
        return LeanLimits(
            most_rad=math.radians(self.value("PSC_ANGLE_MAX") or lean_deg),
            # Seven digits: of the 32-bit float, the decimal that it stands for.
            input_s=float(f"{self.value('ATC_INPUT_TC'):.7g}"),
            rate_rps=math.radians(rate_dps) if rate_dps > 0.0 else math.inf,
            acceleration_rps2=(
                math.radians(acceleration_dps2) if acceleration_dps2 > 0.0 else math.inf
            ),
        )

    def waypoint_start_speed_mps(self) -> float:
        """The speed parameter as a waypoint start reads it: below its floor, the floor is saved."""
        if self.value(self.dialect.speed) < self.dialect.speed_floor:
            self.save(self.dialect.speed, self.dialect.speed_floor)
        return self.speed_mps()
