"""What the autopilot reports on its links: the messages, and when each is due on which link."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import GlobalPosition
from echowing.sim.vehicle.copter import HOVER_THROTTLE
from echowing.sim.vehicle.guided import Body, SubMode
from echowing.sim.vehicle.modes import AUTO, BRAKE, GUIDED, LAND, RTL, FlightModes
from echowing.sim.vehicle.parameters import Parameters
from echowing.sim.vehicle.places import ORIGIN, Places
from echowing.sim.vehicle.rangefinder import NO_DATA, NOT_CONNECTED, MavlinkRangefinder

# UTC of a flight's time zero, 2026-01-01 00:00: flights of one seed are the same to the byte.
START_UNIX_S = 1_767_225_600

# A still thing to report: a healthy battery and receiver, so that no tool complains about them.
_EKF_FLAGS = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS
    | mavlink.EKF_POS_VERT_ABS
    | mavlink.EKF_PRED_POS_HORIZ_REL
    | mavlink.EKF_PRED_POS_HORIZ_ABS
)
# The same once the receiver is lost for good (AP_NavEKF3: constant position mode).
_EKF_FLAGS_LOST = mavlink.EKF_ATTITUDE | mavlink.EKF_POS_VERT_ABS | mavlink.EKF_CONST_POS_MODE
_VOLTAGE_MV, _CURRENT_CA, _REMAINING_PERCENT = 12_600, 1_000, 80
_SATELLITES, _EPH_CM = 10, 121  # SITL's receiver: HDOP 1.21
_RC_UNKNOWN_RSSI = 255

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_POSITION_ONLY = 0xFDF8  # every field but x, y, z is to be ignored; the top bits as ArduPilot sets
_POSITION_VELOCITY = 0xFDC0
_VELOCITY_ONLY = 0xFDC7
BOARD_ID = 140  # a Cube Orange
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)
# Modes that steer themselves show as such in the heartbeat.
_SELF_STEERING = {AUTO, GUIDED, RTL, LAND, BRAKE}


def _e7(degrees: float) -> int:
    return round(degrees * 1e7)


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def _heading_cdeg(yaw_rad: float) -> int:
    return round(math.degrees(yaw_rad) * 100.0) % 36000


class Reports:
    """Builds each message of the vehicle's state as of now.

    `t_s` is the time since the autopilot started and `unix_s` the same as UTC; both are set before
    use. `has_fix`: of the receiver; `has_position`: of the estimator; `receiver_down_m`: how far
    off the receiver's own height is. A message that makes no sense now is None.
    """

    def __init__(
        self,
        body: Body,
        parameters: Parameters,
        places: Places,
        modes: FlightModes,
        rangefinder: MavlinkRangefinder,
        rc_us: list[int],
    ) -> None:
        self.t_s = 0.0
        self.unix_s = float(START_UNIX_S)
        self.has_fix = self.has_position = True
        self.receiver_down_m = 0.0
        self._body = body
        self._parameters = parameters
        self._places = places
        self._modes = modes
        self._rangefinder = rangefinder
        self._rc_us = rc_us
        self._here: tuple[float, GlobalPosition] | None = None
        self.builders: dict[int, Callable[[], Any]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status_report,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._gps_global_origin,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: self._rc_channels,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._position_target_local_ned,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target_global_int,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance_sensor,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
            mavlink.MAVLINK_MSG_ID_RANGEFINDER: self._downward_rangefinder,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
        }

    def build(self, message_id: int) -> Any | None:
        """The message, or None where it is unknown or makes no sense now."""
        builder = self.builders.get(message_id)
        return builder() if builder else None

    @property
    def _boot_ms(self) -> int:
        return int(self.t_s * 1000.0 + 0.5) & 0xFFFFFFFF

    def here(self) -> GlobalPosition:
        """Estimated position, worked out once a step."""
        if self._here is None or self._here[0] != self.t_s:
            self._here = (self.t_s, self._places.here())
        return self._here[1]

    def _heartbeat(self) -> Any:
        modes = self._modes
        base = (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        )
        if modes.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if modes.mode in _SELF_STEERING:
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        state = mavlink.MAV_STATE_ACTIVE if modes.flying else mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            base,
            modes.mode,
            mavlink.MAV_STATE_CRITICAL if modes.failsafe else state,
            3,  # MAVLink's own version number
        )

    def _sys_status(self) -> Any:
        present = _SENSORS
        healthy = _SENSORS
        if self._rangefinder.status != NOT_CONNECTED:
            present |= mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION
            if self._rangefinder.status != NO_DATA:
                healthy |= mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION
        return mavlink.MAVLink_sys_status_message(
            present,
            present,
            healthy,
            100,  # main loop load, in 0.1 %
            _VOLTAGE_MV,
            _CURRENT_CA,
            _REMAINING_PERCENT,
            *(0,) * 6,
        )

    def _system_time(self) -> Any:
        return mavlink.MAVLink_system_time_message(round(self.unix_s * 1e6), self._boot_ms)

    def _gps_raw_int(self) -> Any:
        here, body = self.here(), self._body
        course = _heading_cdeg(math.atan2(body.est_ve_mps, body.est_vn_mps))
        return mavlink.MAVLink_gps_raw_int_message(
            int(self.t_s * 1e6 + 0.5),
            mavlink.GPS_FIX_TYPE_3D_FIX if self.has_fix else mavlink.GPS_FIX_TYPE_NO_FIX,
            _e7(here.lat_deg),
            _e7(here.lon_deg),
            round((ORIGIN.alt_m - body.down_m - self.receiver_down_m) * 1e3),
            _EPH_CM,
            _EPH_CM,
            min(65534, round(math.hypot(body.est_vn_mps, body.est_ve_mps) * 100.0)),
            course,
            _SATELLITES if self.has_fix else 0,
        )

    def _ekf_status_report(self) -> Any:
        """An estimator that has settled: all of what a GPS gives, none of what is for flow."""
        flags = _EKF_FLAGS if self.has_position else _EKF_FLAGS_LOST
        return mavlink.MAVLink_ekf_status_report_message(flags, *(0.05,) * 5)

    def _attitude(self) -> Any:
        body = self._body
        return mavlink.MAVLink_attitude_message(
            self._boot_ms,
            body.roll_rad,
            body.pitch_rad,
            body.yaw_rad,
            body.rollspeed_rps,
            body.pitchspeed_rps,
            body.yawspeed_rps,
        )

    def _local_position_ned(self) -> Any:
        body = self._body
        return mavlink.MAVLink_local_position_ned_message(
            self._boot_ms,
            *self._places.here_ned_m(),
            body.est_vn_mps,
            body.est_ve_mps,
            body.vd_mps,
        )

    def _global_position_int(self) -> Any:
        here, body = self.here(), self._body
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms,
            _e7(here.lat_deg),
            _e7(here.lon_deg),
            round(here.alt_m * 1e3),
            round(self._places.height_m() * 1e3),
            _int16(body.est_vn_mps * 100.0),
            _int16(body.est_ve_mps * 100.0),
            _int16(body.vd_mps * 100.0),
            _heading_cdeg(body.yaw_rad),
        )

    def _mission_current(self) -> Any:
        navigator = getattr(self._modes.controls, "navigator", None)
        index = navigator.waypoint_index + 1 if navigator is not None else 0
        return mavlink.MAVLink_mission_current_message(index, len(self._modes.waypoints))

    def _gps_global_origin(self) -> Any:
        return mavlink.MAVLink_gps_global_origin_message(
            _e7(ORIGIN.lat_deg), _e7(ORIGIN.lon_deg), round(ORIGIN.alt_m * 1e3)
        )

    def _rc_channels(self) -> Any:
        channels = self._rc_us
        return mavlink.MAVLink_rc_channels_message(
            self._boot_ms, len(channels), *channels, 0, 0, _RC_UNKNOWN_RSSI
        )

    def _vfr_hud(self) -> Any:
        body = self._body
        speed_mps = math.hypot(body.est_vn_mps, body.est_ve_mps)
        return mavlink.MAVLink_vfr_hud_message(
            speed_mps,
            speed_mps,
            round(math.degrees(body.yaw_rad)) % 360,
            round(100.0 * HOVER_THROTTLE) if self._modes.flying else 0,
            ORIGIN.alt_m - body.est_down_m,
            -body.vd_mps,
        )

    def _position_target_global_int(self) -> Any | None:
        target = self._modes.position_target()
        if target is None:
            return None
        place = self._places.place(target)
        return mavlink.MAVLink_position_target_global_int_message(
            self._boot_ms,
            mavlink.MAV_FRAME_GLOBAL,
            _POSITION_ONLY,
            _e7(place.lat_deg),
            _e7(place.lon_deg),
            place.alt_m,
            *(0.0,) * 8,
        )

    def _position_target_local_ned(self) -> Any | None:
        guided = self._modes.guided
        if self._modes.mode != GUIDED or guided.sub_mode is SubMode.TAKE_OFF:
            return None
        masks = {
            SubMode.POSITION: _POSITION_ONLY,
            SubMode.POSITION_VELOCITY: _POSITION_VELOCITY,
            SubMode.VELOCITY: _VELOCITY_ONLY,
        }
        target = getattr(self._modes.controls, "target_ned_m", None) or (0.0, 0.0, 0.0)
        return mavlink.MAVLink_position_target_local_ned_message(
            self._boot_ms,
            mavlink.MAV_FRAME_LOCAL_NED,
            masks[guided.sub_mode],
            *target,
            *guided.velocity_ned_mps,
            *(0.0,) * 5,
        )

    def _distance_sensor(self) -> Any | None:
        sensor = self._rangefinder
        if sensor.status in (NOT_CONNECTED, NO_DATA):
            return None
        return mavlink.MAVLink_distance_sensor_message(
            self._boot_ms,
            round(sensor.min_m() * 100.0),
            round(sensor.max_m() * 100.0),
            round(sensor.distance_m * 100.0),
            sensor.kind,
            0,  # the first rangefinder, whatever the sensor calls itself
            sensor.orientation,
            0,
            0.0,
            0.0,
            [0.0] * 4,
            {-1: 0, 0: 1}.get(sensor.quality, sensor.quality),
        )

    def _downward_rangefinder(self) -> Any | None:
        """RANGEFINDER tells of a sensor that looks down, and of no other."""
        sensor = self._rangefinder
        downward = sensor.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
        if sensor.status == NOT_CONNECTED or not downward:
            return None
        return mavlink.MAVLink_rangefinder_message(sensor.distance_m, 0.0)

    def _autopilot_version(self) -> Any:
        major, minor = self._parameters.dialect.version
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES,
            major << 24 | minor << 16 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL,
            *(0,) * 2,
            BOARD_ID << 16,
            [0] * 8,
            [0] * 8,
            [0] * 8,
            *(0,) * 3,
        )

    def _home_position(self) -> Any:
        home = self._places.home()
        return mavlink.MAVLink_home_position_message(
            _e7(home.lat_deg),
            _e7(home.lon_deg),
            round(home.alt_m * 1e3),
            *self._places.home_ned_m,
            [1.0, 0.0, 0.0, 0.0],
            0.0,
            0.0,
            0.0,
            round(self.unix_s * 1e6),
        )


# Which stream (the parameters' suffixes) carries which message: ArduCopter/GCS_MAVLink_Copter.cpp.
STREAMS: dict[str, tuple[int, ...]] = {
    "EXT_STAT": (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    ),
    "POSITION": (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    "RC_CHAN": (mavlink.MAVLINK_MSG_ID_RC_CHANNELS,),
    "EXTRA1": (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    "EXTRA2": (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    "EXTRA3": (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_RANGEFINDER,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    ),
}
# REQUEST_DATA_STREAM's numbers.
STREAM_NUMBERS: dict[int, tuple[str, ...]] = {
    mavlink.MAV_DATA_STREAM_ALL: tuple(STREAMS),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: ("EXT_STAT",),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: ("RC_CHAN",),
    mavlink.MAV_DATA_STREAM_POSITION: ("POSITION",),
    mavlink.MAV_DATA_STREAM_EXTRA1: ("EXTRA1",),
    mavlink.MAV_DATA_STREAM_EXTRA2: ("EXTRA2",),
    mavlink.MAV_DATA_STREAM_EXTRA3: ("EXTRA3",),
}
HEARTBEAT_PERIOD_S = 1.0
_ROUNDING_S = 1e-6  # sums of steps and of periods differ in their last bits
# SET_MESSAGE_INTERVAL's special values.
INTERVAL_DISABLED_US, INTERVAL_DEFAULT_US = -1, 0


@dataclass(slots=True)
class _Entry:
    message_id: int
    period_s: float
    due_s: float


@dataclass(slots=True)
class Schedule:
    """When each message is due on one link.

    `rates_hz` gives the rate of each stream; `set_interval` overrides single messages.
    """

    intervals_us: dict[int, int] = field(default_factory=dict)
    _entries: list[_Entry] = field(default_factory=list)
    _next_s: float = -math.inf

    def set_interval(self, message_id: int, interval_us: int) -> None:
        """Send a message at this interval; -1: never, 0: as its stream says."""
        if interval_us == INTERVAL_DEFAULT_US:
            self.intervals_us.pop(message_id, None)
        else:
            self.intervals_us[message_id] = interval_us

    def interval_us(self, message_id: int) -> int:
        """Interval in force; -1: not sent."""
        for entry in self._entries:
            if entry.message_id == message_id:
                return round(entry.period_s * 1e6)
        return INTERVAL_DISABLED_US

    def plan(self, rates_hz: dict[str, float], t_s: float) -> None:
        """Work out the periods anew; what keeps its period keeps its beat."""
        periods_s = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_PERIOD_S}
        for stream, rate_hz in rates_hz.items():
            if rate_hz > 0.0:
                periods_s.update(dict.fromkeys(STREAMS[stream], 1.0 / rate_hz))
        for message_id, interval_us in self.intervals_us.items():
            if interval_us > 0:
                periods_s[message_id] = interval_us / 1e6
            else:
                periods_s.pop(message_id, None)
        former = {(entry.message_id, entry.period_s): entry.due_s for entry in self._entries}
        self._entries = [
            _Entry(message_id, period_s, former.get((message_id, period_s), t_s))
            for message_id, period_s in periods_s.items()
        ]
        self._next_s = -math.inf

    def due(self, t_s: float) -> Iterable[int]:
        """The messages to send at `t_s`."""
        t_s += _ROUNDING_S
        if t_s < self._next_s:
            return ()
        due = []
        next_s = math.inf
        for entry in self._entries:
            if t_s >= entry.due_s:
                due.append(entry.message_id)
                # A period shorter than a step: once a step is all there is.
                entry.due_s = max(t_s, entry.due_s + entry.period_s)
            next_s = min(next_s, entry.due_s)
        self._next_s = next_s
        return due
