"""SET_POSITION_TARGET_* as ArduCopter reads them (ArduCopter/GCS_MAVLink_Copter.cpp)."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import Ned, wrap_angle_rad
from echowing.sim.vehicle.guided import Body, Guided
from echowing.sim.vehicle.places import Places, altitude_frame

# Any ignored part of a group leaves the whole group out.
_POSITION, _VELOCITY, _ACCELERATION = 0x007, 0x038, 0x1C0
_FORCE, _YAW = 0x200, 0x400

_BODY_FRAMES = {mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED}
_OFFSET_FRAMES = _BODY_FRAMES | {mavlink.MAV_FRAME_LOCAL_OFFSET_NED}
_LOCAL_FRAMES = _OFFSET_FRAMES | {mavlink.MAV_FRAME_LOCAL_NED}

LAT_LIMIT_E7, LON_LIMIT_E7 = 900_000_000, 1_800_000_000


class TargetReader:
    """Turns target messages into Guided's targets. What is invalid stops the vehicle.

    Stopping means that Guided starts anew, so the speed limit is read anew too. Acceleration-only
    targets and yaw rates are not flown: the former stop the vehicle, the latter are ignored.
    """

    def __init__(self, body: Body, places: Places, guided: Guided) -> None:
        self._body = body
        self._places = places
        self._guided = guided

    def read_global(self, message: Any) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        mask = message.type_mask
        position: Ned | None = None
        frame = altitude_frame(message.coordinate_frame)
        if not mask & _POSITION:
            inside = abs(message.lat_int) <= LAT_LIMIT_E7 and abs(message.lon_int) <= LON_LIMIT_E7
            if not inside or frame is None or not math.isfinite(message.alt):
                self._guided.start()
                return
            if frame == "above_terrain" and not mask & _VELOCITY:
                self._guided.start()  # position and velocity fly no terrain
                return
            position = self._places.ned(
                message.lat_int / 1e7, message.lon_int / 1e7, message.alt, frame
            )
        self._take(message, position, (message.vx, message.vy, message.vz), 0.0)

    def read_local(self, message: Any) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        frame = message.coordinate_frame
        position: Ned = (message.x, message.y, message.z)
        velocity: Ned = (message.vx, message.vy, message.vz)
        yaw_from_rad = 0.0
        if frame not in _LOCAL_FRAMES:
            self._guided.start()
            return
        if frame in _BODY_FRAMES:
            yaw_from_rad = self._body.yaw_rad
            position = _turned(position, yaw_from_rad)
            velocity = _turned(velocity, yaw_from_rad)
        if frame in _OFFSET_FRAMES:
            north_m, east_m, down_m = self._places.here_ned_m()
            position = (position[0] + north_m, position[1] + east_m, position[2] + down_m)
        self._take(message, position, velocity, yaw_from_rad)

    def _take(self, message: Any, position: Ned | None, velocity: Ned, yaw_from_rad: float) -> None:
        mask = message.type_mask
        if mask & _FORCE and not mask & _ACCELERATION:
            return  # forces are not flown, and nothing else in the message is
        yaw_rad = None if mask & _YAW else wrap_angle_rad(message.yaw + yaw_from_rad)
        wants_position, wants_velocity = not mask & _POSITION, not mask & _VELOCITY
        numbers = [*(position or ())] * wants_position + [*velocity] * wants_velocity
        numbers += [] if yaw_rad is None else [yaw_rad]
        if not all(map(math.isfinite, numbers)):
            self._guided.start()
        elif wants_position and wants_velocity and position is not None:
            self._guided.position_velocity(position, velocity, yaw_rad)
        elif wants_velocity:
            self._guided.velocity(velocity, yaw_rad)
        elif wants_position and mask & _ACCELERATION and position is not None:
            self._guided.position(position, yaw_rad)
        else:
            self._guided.start()


def _turned(vector: Ned, yaw_rad: float) -> Ned:
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right, down = vector
    return forward * cosine - right * sine, forward * sine + right * cosine, down
