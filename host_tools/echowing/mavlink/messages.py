"""MAVLink messages as the ground tools write and read them. Pure."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

if TYPE_CHECKING:
    from collections.abc import Sequence

    from echowing.geo import GlobalPosition

# Not 255: heartbeats with the id of the pilot's ground station would mask its fail-safe.
TOOL_SYSTEM_ID = 245
TOOL_COMPONENT_ID = mavlink.MAV_COMP_ID_MISSIONPLANNER
HEARTBEAT_PERIOD_S = 1.0

FORWARD = mavlink.MAV_SENSOR_ROTATION_NONE
# An autopilot's DISTANCE_SENSOR with an id from here on is a sector of its proximity sensor
# (GCS_Common.cpp, PROXIMITY_SENSOR_ID_START).
PROXIMITY_IDS_FROM = 10

# Of a vehicle's components but its autopilot: the co-processor's readings, and where it looked.
_COPROCESSOR_SAYS = {"DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS", "NAMED_VALUE_FLOAT"}

STATUS_TEXT_BYTES = 50

# GLOBAL_POSITION_INT: MAVLink's value for no heading.
UNKNOWN_HEADING = 65_535

# How a point with a velocity carries more than a point, in fields that the autopilot ignores. The
# applet refuses another format, and shows its own as ECHO_FORMAT.
POINT_FORMAT = 4.0


class Manner(IntEnum):
    """How the applet flies a point with a velocity while its sonar is heard.

    HOLD: at the wanted distance, and as fast as the leader, as the sonar sees it. MAKE_WAY: as it
    is, for it leads past another vehicle than the leader. KEEP_PACE: at the wanted distance from
    another follower, at the point's velocity. HEAD: as HOLD, with others behind it in a line. In a
    line nobody flies back faster than the one ahead comes: who flies behind would be met.
    """

    HOLD = 0
    MAKE_WAY = 1
    KEEP_PACE = 2
    HEAD = 3


@dataclass(frozen=True, slots=True)
class ForApplet:
    """What a point with a velocity tells the applet, in fields that the autopilot ignores.

    opens_m: the distance to keep where the slot has opened, 0: it has not; quickens_mps2: by how
    much a follower that keeps its distance has to speed up along the yaw.
    """

    opens_m: float = 0.0
    manner: Manner = Manner.HOLD
    quickens_mps2: float = 0.0


_POSITION_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
_POSITION_ONLY = (
    _POSITION_VELOCITY
    | mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)

_VELOCITY_ONLY = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | _POSITION_VELOCITY
)


def guides(message: Any) -> bool:
    """Whether guidance reads what this component of a vehicle says."""
    if message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
        return True
    return message.get_type() in _COPROCESSOR_SAYS


def position_target(
    system_id: int,
    point: "GlobalPosition",
    altitude_m: float,
    yaw_rad: float | None,
    now_s: float,
    velocity_mps: tuple[float, float] | None = None,
    for_applet: ForApplet = ForApplet(),
) -> Any:
    """SET_POSITION_TARGET_GLOBAL_INT; `altitude_m` above the vehicle's home.

    velocity_mps: (north, east); None: the position only. What is for the applet stands in the
    fields of vertical speed, acceleration and yaw rate, its format in that of acceleration down.
    """
    mask = _POSITION_ONLY if velocity_mps is None else _POSITION_VELOCITY
    if yaw_rad is None:
        mask |= mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    return mavlink.MAVLink_set_position_target_global_int_message(
        round(now_s * 1000.0) & 0xFFFFFFFF,
        system_id,
        mavlink.MAV_COMP_ID_AUTOPILOT1,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        mask,
        round(point.lat_deg * 1e7),
        round(point.lon_deg * 1e7),
        altitude_m,
        *(velocity_mps or (0.0, 0.0)),
        0.0,
        for_applet.opens_m,
        float(for_applet.manner),
        POINT_FORMAT,
        yaw_rad or 0.0,
        for_applet.quickens_mps2,
    )


def no_velocity(system_id: int, now_s: float) -> Any:
    """A velocity of nothing, with no place: whatever Guided was about to do, it begins anew.

    From 4.8 on an autopilot whose filter has reset its position slews over to the old place, and a
    new place alone does not end that (AC_PosControl.cpp, NE_update_offsets); a sub-mode that begins
    does (ModeGuided::pva_control_start). No applet takes it for a point: those are global.
    """
    return mavlink.MAVLink_set_position_target_local_ned_message(
        round(now_s * 1000.0) & 0xFFFFFFFF,
        system_id,
        mavlink.MAV_COMP_ID_AUTOPILOT1,
        mavlink.MAV_FRAME_LOCAL_NED,
        _VELOCITY_ONLY,
        *([0.0] * 11),
    )


# The axis holds still against every turn of its vehicle, and its bearing is from north.
EARTH_FRAME = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
)
# The applet's: it knows no height.
WITHOUT_HEIGHT = EARTH_FRAME & ~mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK


def look_order(
    system_id: int,
    component_id: int,
    quaternion: "Sequence[float]",
    rate_rps: tuple[float, float],
    sigma_rad: float,
) -> Any:
    """GIMBAL_DEVICE_SET_ATTITUDE for the co-processor: look along an axis.

    quaternion: the rotation from north to it (w, x, y, z);
    rate_rps: by which its azimuth and elevation change; sigma_rad: standard deviation of the
    leader's direction, in the field of the roll's rate, as a beam has no roll.
    """
    return mavlink.MAVLink_gimbal_device_set_attitude_message(
        system_id,
        component_id,
        EARTH_FRAME,
        list(quaternion),
        sigma_rad,
        rate_rps[1],
        rate_rps[0],
    )


def gimbal_attitude(message: Any) -> "Sequence[float] | None":
    """The quaternion in a GIMBAL_DEVICE_ATTITUDE_STATUS; None: it is not in the earth frame."""
    in_earth_frame = message.flags & EARTH_FRAME == EARTH_FRAME
    return message.q if in_earth_frame else None


def heading_of(message: Any, before_rad: float) -> float:
    """The heading in a GLOBAL_POSITION_INT; the one before if it is not known."""
    return before_rad if message.hdg == UNKNOWN_HEADING else math.radians(message.hdg / 100.0)


def is_forward_rangefinder(message: Any) -> bool:
    """Whether an autopilot's DISTANCE_SENSOR is of a rangefinder of its own that looks forward."""
    return bool(message.orientation == FORWARD and message.id < PROXIMITY_IDS_FROM)


def sonar_range_m(message: Any, reach_m: float) -> float | None:
    """The range in a DISTANCE_SENSOR; None: the sonar detects no target within its reach."""
    range_m = float(message.current_distance) / 100.0
    nothing = range_m >= min(reach_m, message.max_distance / 100.0)
    return None if nothing else range_m


def tool_heartbeat() -> Any:
    """HEARTBEAT of a ground tool that is not a ground station."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )


def status_text(severity: int, text: str) -> Any:
    """STATUSTEXT for the ground stations behind a vehicle, which passes it on to all its links."""
    return mavlink.MAVLink_statustext_message(severity, text.encode()[:STATUS_TEXT_BYTES])


def message_interval(system_id: int, message_id: int, period_us: int) -> Any:
    """Ask a vehicle to send a message at an interval."""
    return command_long(system_id, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, period_us)


def command_long(
    system_id: int,
    command: int,
    *params: float,
    component_id: int = mavlink.MAV_COMP_ID_AUTOPILOT1,
    confirmation: int = 0,
) -> Any:
    """COMMAND_LONG with its first parameters, the rest 0; `confirmation` counts the repetitions."""
    filled = (*params, *(0.0,) * (7 - len(params)))
    return mavlink.MAVLink_command_long_message(
        system_id, component_id, command, confirmation, *filled
    )


def read_parameter(system_id: int, name: str) -> Any:
    """Ask a vehicle's autopilot for one parameter."""
    return mavlink.MAVLink_param_request_read_message(
        system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
    )
