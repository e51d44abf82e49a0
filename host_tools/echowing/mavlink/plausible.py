"""The door through which messages enter: what no vehicle of ours can mean is not let in. Pure.

A checksum shows that a message arrived as it was sent, not that it makes sense. Scripts, filters
and other senders with a vehicle's id fail, and one number that is none goes through every sum of
the flight core. So each number is finite and within what a small copter can be before anything
reads it, and each text is printable. What is not is counted, and told once.
"""

import math
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.vehicle_limits import LIMITS

Span = tuple[float, float]
"""The least and the greatest value; a value that is not a number is in no span."""

_FINITE: Span = (-sys.float_info.max, sys.float_info.max)
_DEGREES_E7 = {"lat": (-900_000_000, 900_000_000), "lon": (-1_800_000_000, 1_800_000_000)}
# Below the Dead Sea, above the highest mountains; ArduPilot counts altitudes from sea level and
# from home.
_DOWN_M = (-10_000.0, 1_000.0)
_ALTITUDE_MM = (-1_000_000, 10_000_000)
# No copter that is followed flies faster (WP_SPD ends at 20 m/s), and none falls faster.
_MPS, _CMPS = (-50.0, 50.0), (-5_000, 5_000)
# From the EKF's origin, which is where the vehicle was switched on.
_LOCAL_M = (-100_000.0, 100_000.0)
_TURN_RAD = (-3.15, 3.15)
# Of an angle that turns by 50 revolutions a second nothing is flown any more.
_TURN_RADPS = (-315.0, 315.0)
# Checked elsewhere: by the value's name, or by a rule for which not a number is the worst of all.
_ANY: Span = (-math.inf, math.inf)

FIELDS: dict[str, dict[str, Span]] = {
    "ATTITUDE": {
        # The largest lean that ArduCopter accepts is 80 degrees (ATC_ANGLE_MAX): beyond, a lean
        # tells no wind, and its tangent has no end.
        "roll": (-1.4, 1.4),
        "pitch": (-1.4, 1.4),
        "yaw": _TURN_RAD,
        "rollspeed": _TURN_RADPS,
        "pitchspeed": _TURN_RADPS,
        "yawspeed": _TURN_RADPS,
    },
    "AUTOPILOT_VERSION": {},
    "COMMAND_ACK": {},
    "DISTANCE_SENSOR": {},
    # A vehicle that says no number is doubted (`engage.Vehicle`).
    "EKF_STATUS_REPORT": {
        "velocity_variance": _ANY,
        "pos_horiz_variance": _ANY,
        "pos_vert_variance": _ANY,
        "compass_variance": _ANY,
        "terrain_alt_variance": _ANY,
        "airspeed_variance": _ANY,
    },
    "FILE_TRANSFER_PROTOCOL": {},
    # Of a quaternion that is none the axis is not known; rates are not read, and may be no numbers.
    "GIMBAL_DEVICE_ATTITUDE_STATUS": {
        "angular_velocity_x": _ANY,
        "angular_velocity_y": _ANY,
        "angular_velocity_z": _ANY,
        "delta_yaw": _ANY,
        "delta_yaw_velocity": _ANY,
    },
    "GLOBAL_POSITION_INT": {
        **_DEGREES_E7,
        "alt": _ALTITUDE_MM,
        "relative_alt": _ALTITUDE_MM,
        "vx": _CMPS,
        "vy": _CMPS,
        "vz": _CMPS,
    },
    "GPS_RAW_INT": {"fix_type": (0, 8)},
    # ArduPilot's modes are below 30; other firmware packs several numbers into one.
    "HEARTBEAT": {"custom_mode": (0, 255), "system_status": (0, 8)},
    "LOCAL_POSITION_NED": {
        "x": _LOCAL_M,
        "y": _LOCAL_M,
        "z": _DOWN_M,
        "vx": _MPS,
        "vy": _MPS,
        "vz": _MPS,
    },
    "NAMED_VALUE_FLOAT": {"value": _ANY},
    "PARAM_ERROR": {},
    "PARAM_VALUE": {"param_value": _ANY},
    "POSITION_TARGET_GLOBAL_INT": {
        "lat_int": _DEGREES_E7["lat"],
        "lon_int": _DEGREES_E7["lon"],
    },
    "POSITION_TARGET_LOCAL_NED": {"x": _LOCAL_M, "y": _LOCAL_M},
    "RC_CHANNELS": {},
    "STATUSTEXT": {"severity": (0, 7)},
    "SYS_STATUS": {"battery_remaining": (-1, 100)},
    # A vehicle's clock is the time since it was switched on: no more than three years, in ns.
    "TIMESYNC": {"tc1": (0, 10**17)},
}
"""The messages that are read, and the spans of their fields; a float without one is finite.

Nobody reads any other message: they pass, for the links' counts.
"""

NAMED: dict[str, Span] = {
    "ECHO_SPD": (0.0, 100.0),
    "ECHO_STATE": (0.0, 255.0),
    "SNR_PAN": (0.0, 10_000.0),
    # A range in metres; the sonar's own ends at 7.65.
    "SNR_RAW": (0.0, 100.0),
    "SNR_STATE": (0.0, 255.0),
    "SNR_TILT": (0.0, 10_000.0),
}
"""The spans of named floats; others are finite."""

# A 32-bit float carries seven digits: the ends of a span are in it.
_WIDER = 1e-6

PARAMETERS: dict[str, Span] = {
    **{
        # Of some 0 stands for no limit; what else is below their span the flight core refuses.
        name: (
            0.0 if limit.none_at_0 else (1.0 - _WIDER) * limit.least / unit,
            (1.0 + _WIDER) * limit.most / unit,
        )
        for limit in LIMITS
        for name, unit in limit.names.items()
    },
    "ECHO_ENABLE": (0.0, 1.0),
    "ECHO_LAW": (0.0, 2.0),
    "ECHO_DIST": (0.0, 100.0),
    "ECHO_FORMAT": (0.0, 255.0),
    "ECHO_GAIN_P": (0.0, 100.0),
    "ECHO_INSET": (-10.0, 10.0),
    "ECHO_DETECT": (0.0, 100.0),
    "ECHO_STREAM_T": (0.0, 60.0),
    "RTL_ALT_M": (0.0, 3_000.0),
    "RTL_ALT": (0.0, 300_000.0),
}
"""What parameters may be for the flight core; one that is not is as unknown."""

# A sender that invents kinds of nonsense does not fill the screen.
MOST_TOLD = 30


@dataclass(frozen=True, slots=True)
class Fault:
    """A value of a message that cannot be, and what it is a value of."""

    name: str
    value: float

    def __str__(self) -> str:
        return f"{self.name} {self.value:g}"


@cache
def _types(message_id: int) -> dict[str, str]:
    """The fields of a kind of message, and their types."""
    kind = mavlink.mavlink_map[message_id]
    return dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))


@cache
def _checks(message_id: int) -> tuple[tuple[str, float, float], ...]:
    """The fields to check of a kind of message, and their spans."""
    spans = FIELDS.get(mavlink.mavlink_map[message_id].msgname)
    if spans is None:
        return ()
    floats = (name for name, one in _types(message_id).items() if one in ("float", "double"))
    wanted = {**dict.fromkeys(floats, _FINITE), **spans}
    return tuple((name, *span) for name, span in wanted.items() if span is not _ANY)


@cache
def _texts(message_id: int) -> tuple[str, ...]:
    return tuple(name for name, one in _types(message_id).items() if one == "char")


def fault_of(message: Any, parameters: Mapping[str, Span] = PARAMETERS) -> Fault | None:
    """What is wrong with a message; None: nothing."""
    kind = message.get_type()
    for name, least, most in _checks(message.get_msgId()):
        value = getattr(message, name)
        for one in value if isinstance(value, list | tuple) else (value,):
            if not least <= one <= most:
                return Fault(f"{kind}.{name}", one)
    if kind == "NAMED_VALUE_FLOAT":
        return _named_fault(message.name, message.value, NAMED)
    if kind == "PARAM_VALUE":
        return _named_fault(message.param_id, message.param_value, parameters)
    return None


def _named_fault(name: str, value: float, spans: Mapping[str, Span]) -> Fault | None:
    least, most = spans.get(name, _FINITE)
    return None if least <= value <= most else Fault(name, value)


def printable(text: str) -> str:
    """A text without control characters, which a terminal would obey."""
    return text if text.isprintable() else "".join(one for one in text if one.isprintable())


class Door:
    """Lets the messages of a link in, one by one.

    parameters: the spans of parameters' values; empty: any number, for those who look at the
    parameters themselves. `refused` counts what was not let in; `news` holds texts for the
    operator, and its owner empties it.
    """

    def __init__(self, parameters: Mapping[str, Span] = PARAMETERS) -> None:
        self.refused: Counter[str] = Counter()
        self.news: list[str] = []
        self._parameters = parameters
        self._told: set[tuple[int, str]] = set()

    def admits(self, message: Any) -> bool:
        """Whether a message makes sense; its texts are made printable."""
        fault = fault_of(message, self._parameters)
        if fault is not None:
            self._refuse(message, fault)
            return False
        for name in _texts(message.get_msgId()):
            setattr(message, name, printable(getattr(message, name)))
        return True

    @property
    def summary(self) -> str:
        """What was not let in, in words."""
        return ", ".join(f"{count} {kind}" for kind, count in sorted(self.refused.items()))

    def _refuse(self, message: Any, fault: Fault) -> None:
        self.refused[message.get_type()] += 1
        who = message.get_srcSystem(), fault.name
        if who in self._told or len(self._told) >= MOST_TOLD:
            return
        self._told.add(who)
        system_id, component_id = message.get_srcSystem(), message.get_srcComponent()
        sender = f"system {system_id}"
        if component_id != mavlink.MAV_COMP_ID_AUTOPILOT1:
            sender += f", component {component_id}"
        self.news.append(f"{sender}: {fault} cannot be: not believed")
