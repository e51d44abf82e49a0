"""MAV_CMDs as ArduCopter answers them (GCS_MAVLink/GCS_Common.cpp, ArduCopter's own)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.modes import AUTO, GUIDED, LAND, LOITER, RTL, FlightModes
from echowing.sim.vehicle.parameters import Parameters
from echowing.sim.vehicle.places import Places, altitude_frame
from echowing.sim.vehicle.targets import LAT_LIMIT_E7, LON_LIMIT_E7

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
NOT_NOW = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
FAILED = mavlink.MAV_RESULT_FAILED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED

_FORCE_ARM = 21196  # the magic of MAV_CMD_COMPONENT_ARM_DISARM's second field
_REBOOT_AUTOPILOT = 1


class Port(Protocol):
    """What commands need of the link they came by."""

    def set_interval(self, message_id: int, interval_us: int) -> bool:
        """Send a message at an interval; False: no such message."""

    def interval_us(self, message_id: int) -> int:
        """Interval in force; -1: not sent."""

    def report(self, message_id: int) -> bool:
        """Send a message once; False: no such message, or it makes no sense now."""

    def send(self, message: Any) -> None:
        """Send a message."""


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG and COMMAND_INT alike; x and y in 1e-7 degrees, z in metres."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    x_e7: int
    y_e7: int
    z: float
    frame: int


def command_of(message: Any) -> Command:
    """The command in a COMMAND_LONG or a COMMAND_INT."""
    m = message
    if m.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_INT:
        return Command(m.command, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z, m.frame)
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
    x_e7, y_e7 = _e7(m.param5), _e7(m.param6)
    return Command(m.command, m.param1, m.param2, m.param3, m.param4, x_e7, y_e7, m.param7, frame)


def _e7(degrees: float) -> int:
    return round(degrees * 1e7) if math.isfinite(degrees) else 0


class Commands:
    """Carries out commands; `run` returns a MAV_RESULT.

    `reboot` restarts the autopilot, `restart_scripting` its scripts.
    """

    def __init__(
        self,
        modes: FlightModes,
        parameters: Parameters,
        places: Places,
        *,
        reboot: Callable[[], None],
        restart_scripting: Callable[[], None],
    ) -> None:
        self._modes = modes
        self._parameters = parameters
        self._places = places
        self._reboot = reboot
        self._restart_scripting = restart_scripting
        self._table: dict[int, Callable[[Command, Port], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda c, p: self._to_mode(LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda c, p: self._to_mode(RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda c, p: self._to_mode(LOITER),
            mavlink.MAV_CMD_MISSION_START: lambda c, p: self._to_mode(AUTO),
            mavlink.MAV_CMD_DO_SET_MODE: self._set_mode,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            mavlink.MAV_CMD_DO_PAUSE_CONTINUE: self._pause_continue,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_SET_HOME: self._set_home,
            mavlink.MAV_CMD_DO_FENCE_ENABLE: self._enable_fence,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._home_position,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._restart,
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._run_prearm_checks,
            mavlink.MAV_CMD_SCRIPTING: self._scripting,
        }

    def run(self, command: Command, port: Port) -> int:
        """Carry out a command that came by `port`."""
        act = self._table.get(command.number)
        return UNSUPPORTED if act is None else act(command, port)

    def _to_mode(self, mode: int) -> int:
        return int(ACCEPTED if self._modes.set_mode(mode) else FAILED)

    def _set_mode(self, command: Command, port: Port) -> int:
        if not int(command.p1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(DENIED)
        return self._to_mode(int(command.p2))

    def _arm(self, command: Command, port: Port) -> int:
        if command.p1 == 1.0:
            done = self._modes.arm(force=command.p2 == _FORCE_ARM)
        elif command.p1 == 0.0:
            done = self._modes.disarm()
        else:
            return int(UNSUPPORTED)
        return int(ACCEPTED if done else FAILED)

    def _take_off(self, command: Command, port: Port) -> int:
        return int(ACCEPTED if self._modes.take_off(command.z) else FAILED)

    def _change_speed(self, command: Command, port: Port) -> int:
        horizontal = command.p1 in (mavlink.SPEED_TYPE_AIRSPEED, mavlink.SPEED_TYPE_GROUNDSPEED)
        if not command.p2 > 0.0 or not horizontal:
            return int(DENIED)
        return int(ACCEPTED if self._modes.set_speed(command.p2) else FAILED)

    def _pause_continue(self, command: Command, port: Port) -> int:
        if command.p1 not in (0.0, 1.0):
            return int(DENIED)
        return int(ACCEPTED if self._modes.pause(command.p1 == 0.0) else FAILED)

    def _reposition(self, command: Command, port: Port) -> int:
        frame = altitude_frame(command.frame)
        inside = abs(command.x_e7) <= LAT_LIMIT_E7 and abs(command.y_e7) <= LON_LIMIT_E7
        may_change = int(command.p2) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
        if frame is None or not inside or not (self._modes.mode == GUIDED or may_change):
            return int(DENIED)
        target = self._places.ned(command.x_e7 / 1e7, command.y_e7 / 1e7, command.z, frame)
        if not self._modes.set_mode(GUIDED) or not self._modes.guided.position(target):
            return int(FAILED)
        return int(ACCEPTED)

    def _set_home(self, command: Command, port: Port) -> int:
        frame = altitude_frame(command.frame)
        if command.p1 == 1.0:
            self._places.set_home_here()
        elif frame is None:
            return int(DENIED)
        else:
            self._places.home_ned_m = self._places.ned(
                command.x_e7 / 1e7, command.y_e7 / 1e7, command.z, frame
            )
        return int(ACCEPTED)

    def _enable_fence(self, command: Command, port: Port) -> int:
        self._parameters.set("FENCE_ENABLE", 1.0 if command.p1 == 1.0 else 0.0)
        return int(ACCEPTED)

    def _home_position(self, command: Command, port: Port) -> int:
        return int(ACCEPTED if port.report(mavlink.MAVLINK_MSG_ID_HOME_POSITION) else FAILED)

    def _set_interval(self, command: Command, port: Port) -> int:
        if not math.isfinite(command.p2):
            return int(DENIED)
        return int(ACCEPTED if port.set_interval(int(command.p1), int(command.p2)) else DENIED)

    def _get_interval(self, command: Command, port: Port) -> int:
        number = int(command.p1)
        port.send(mavlink.MAVLink_message_interval_message(number, port.interval_us(number)))
        return int(ACCEPTED)

    def _request_message(self, command: Command, port: Port) -> int:
        return int(ACCEPTED if port.report(int(command.p1)) else FAILED)

    def _capabilities(self, command: Command, port: Port) -> int:
        port.report(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        return int(ACCEPTED)

    def _restart(self, command: Command, port: Port) -> int:
        if command.p1 != _REBOOT_AUTOPILOT or self._modes.armed:
            return int(FAILED)
        self._reboot()
        return int(ACCEPTED)

    def _run_prearm_checks(self, command: Command, port: Port) -> int:
        if self._modes.armed:
            return int(NOT_NOW)
        self._modes.tell_objection()
        return int(ACCEPTED)

    def _scripting(self, command: Command, port: Port) -> int:
        """Of AP_Scripting's commands only the one that loads the card's scripts again."""
        if command.p1 != mavlink.SCRIPTING_CMD_STOP_AND_RESTART:
            return int(DENIED)
        self._restart_scripting()
        return int(ACCEPTED)
