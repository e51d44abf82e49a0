"""Mission upload and download (MAVLink's mission protocol), and what Auto flies of it."""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.modes import LAND, RTL, FlightModes
from echowing.sim.vehicle.places import Places, altitude_frame

_HOME_ITEMS = 1  # item 0 is home, and is not flown
_ENDINGS = {mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: RTL, mavlink.MAV_CMD_NAV_LAND: LAND}
_FLOWN = {
    mavlink.MAV_CMD_NAV_WAYPOINT,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_DO_CHANGE_SPEED,
    *_ENDINGS,
}
Send = Callable[[Any], None]


class Mission:
    """The stored mission of one vehicle.

    Waypoints, a take-off at the start, one speed, and a return or landing at the end are flown;
    other items are refused as unsupported.
    """

    def __init__(self, modes: FlightModes, places: Places) -> None:
        self._modes = modes
        self._places = places
        self._items: list[Any] = []
        self._coming: list[Any] = []
        self._expected = 0

    def receive(self, message: Any, send: Send) -> None:
        """A message of the mission protocol; answers go to `send`."""
        kind = message.get_type()
        partner = message.get_srcSystem(), message.get_srcComponent()
        if kind == "MISSION_COUNT":
            self._coming, self._expected = [], message.count
            self._ask_next(partner, send)
        elif kind == "MISSION_ITEM_INT":
            self._take(message, partner, send)
        elif kind == "MISSION_CLEAR_ALL":
            self._coming, self._expected = [], 0
            self._ask_next(partner, send)
        elif kind == "MISSION_REQUEST_LIST":
            send(mavlink.MAVLink_mission_count_message(*partner, len(self._items)))
        elif kind == "MISSION_REQUEST_INT" and message.seq < len(self._items):
            send(self._items[message.seq])

    def _take(self, item: Any, partner: tuple[int, int], send: Send) -> None:
        if item.seq != len(self._coming) or len(self._coming) >= self._expected:
            result = mavlink.MAV_MISSION_INVALID_SEQUENCE
            send(mavlink.MAVLink_mission_ack_message(*partner, result))
        elif item.seq >= _HOME_ITEMS and item.command not in _FLOWN:
            self._coming, self._expected = [], 0
            result = mavlink.MAV_MISSION_UNSUPPORTED
            send(mavlink.MAVLink_mission_ack_message(*partner, result))
        else:
            item.target_system, item.target_component = partner
            self._coming.append(item)
            self._ask_next(partner, send)

    def _ask_next(self, partner: tuple[int, int], send: Send) -> None:
        if len(self._coming) < self._expected:
            send(mavlink.MAVLink_mission_request_int_message(*partner, len(self._coming)))
            return
        self._items, self._expected = self._coming, 0
        self._hand_over()
        send(mavlink.MAVLink_mission_ack_message(*partner, mavlink.MAV_MISSION_ACCEPTED))

    def _hand_over(self) -> None:
        """Tell Auto what to fly."""
        modes = self._modes
        modes.waypoints = []
        modes.mission_speed_mps = modes.take_off_first_m = modes.after_mission = None
        for item in self._items[_HOME_ITEMS:]:
            if item.command == mavlink.MAV_CMD_NAV_WAYPOINT:
                frame = altitude_frame(item.frame) or "above_home"
                modes.waypoints.append(self._places.ned(item.x / 1e7, item.y / 1e7, item.z, frame))
            elif item.command == mavlink.MAV_CMD_NAV_TAKEOFF:
                modes.take_off_first_m = item.z
            elif item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
                modes.mission_speed_mps = item.param2
            else:
                modes.after_mission = _ENDINGS[item.command]
