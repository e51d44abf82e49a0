"""Where a vehicle's home and origin are, and its positions in MAVLink's frames."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.sim.vehicle.guided import Body
from echowing.sim.vehicle.parameters import Parameters

# The world's origin: 39.34 N 86.03 W, 250 m above sea level, ground level of every flight.
ORIGIN = GlobalPosition(39.34, -86.03, 250.0)

_ABSOLUTE = {mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT}
_ABOVE_HOME = {
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
}
_ABOVE_TERRAIN = {
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
}
# AC_Fence.h
_FENCE_ALT_MAX, _FENCE_CIRCLE, _FENCE_ALT_MIN = 1, 2, 8


class Places:
    """Estimated positions of one vehicle, its home and its fence.

    The estimator's origin is the world's; the ground is flat, so terrain is the ground under home.
    """

    def __init__(self, body: Body, parameters: Parameters) -> None:
        self._body = body
        self._parameters = parameters
        ground_m = float(getattr(body, "ground_down_m", 0.0))
        self.home_ned_m: Ned = (body.est_north_m, body.est_east_m, ground_m)

    def set_home_here(self) -> None:
        """Home is where the vehicle believes to be."""
        self.home_ned_m = self.here_ned_m()

    def here_ned_m(self) -> Ned:
        """Estimated position."""
        body = self._body
        return body.est_north_m, body.est_east_m, body.est_down_m

    def here(self) -> GlobalPosition:
        """Estimated position, altitude above mean sea level."""
        return displace(ORIGIN, self.here_ned_m())

    def home(self) -> GlobalPosition:
        """Home, altitude above mean sea level."""
        return displace(ORIGIN, self.home_ned_m)

    def place(self, ned_m: Ned) -> GlobalPosition:
        """The place of a local position, altitude above mean sea level."""
        return displace(ORIGIN, ned_m)

    def height_m(self) -> float:
        """Estimated height above home."""
        return self.home_ned_m[2] - self._body.est_down_m

    def ned(self, lat_deg: float, lon_deg: float, alt_m: float, frame: str) -> Ned:
        """Local NED of a place; `frame` in Lua's words: absolute, above_home, above_origin."""
        north_m, east_m, _ = ned_between(ORIGIN, GlobalPosition(lat_deg, lon_deg, ORIGIN.alt_m))
        if frame == "absolute":
            return north_m, east_m, ORIGIN.alt_m - alt_m
        if frame == "above_origin":
            return north_m, east_m, -alt_m
        return north_m, east_m, self.home_ned_m[2] - alt_m

    def within_fence(self, target: Ned) -> bool:
        """Whether a target lies within the altitude and circle fences that are enabled."""
        parameters = self._parameters
        if parameters.value("FENCE_ENABLE") == 0.0:
            return True
        kinds = int(parameters.value("FENCE_TYPE"))
        height_m = self.home_ned_m[2] - target[2]
        if kinds & _FENCE_ALT_MAX and height_m > parameters.value("FENCE_ALT_MAX"):
            return False
        if kinds & _FENCE_ALT_MIN and height_m < parameters.value("FENCE_ALT_MIN"):
            return False
        away_m = math.hypot(target[0] - self.home_ned_m[0], target[1] - self.home_ned_m[1])
        return not (kinds & _FENCE_CIRCLE and away_m > parameters.value("FENCE_RADIUS"))


def altitude_frame(mav_frame: int) -> str | None:
    """The altitude's frame of a MAV_FRAME, in Lua's words; None: not a global frame."""
    if mav_frame in _ABSOLUTE:
        return "absolute"
    if mav_frame in _ABOVE_HOME:
        return "above_home"
    return "above_terrain" if mav_frame in _ABOVE_TERRAIN else None
