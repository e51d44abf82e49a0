"""What the autopilot records of a flight in its dataflash log, and how often."""

import math
from collections.abc import Iterable
from typing import Protocol

from echowing.geo import GlobalPosition, Ned
from echowing.sim.vehicle.dataflash import DataflashLog
from echowing.sim.vehicle.guided import Body, SubMode
from echowing.sim.vehicle.modes import FlightModes
from echowing.sim.vehicle.parameters import Generation, Parameters
from echowing.sim.vehicle.places import ORIGIN, Places
from echowing.sim.vehicle.rangefinder import NOT_CONNECTED, MavlinkRangefinder

# Rates of ArduCopter's default LOG_BITMASK, as its logs show them.
_ATTITUDE_PERIOD_S = _POSITION_PERIOD_S = 0.1
_GPS_PERIOD_S = 0.2
_RANGEFINDER_PERIOD_S = 0.05
_REASON_COMMAND = 2  # ModeReason::GCS_COMMAND
_EKF3 = 3


class Logged(Protocol):
    """What is recorded: the parts of an `Autopilot`."""

    copter: Body
    generation: Generation
    parameters: Parameters
    places: Places
    modes: FlightModes
    rangefinder: MavlinkRangefinder


class _Beat:
    """Says when it is time again."""

    __slots__ = ("_due_s", "_period_s")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = -math.inf

    def due(self, t_s: float) -> bool:
        if t_s < self._due_s - 1e-9:
            return False
        self._due_s = (t_s if math.isinf(self._due_s) else self._due_s) + self._period_s
        return True


class FlightLog:
    """Writes one vehicle's messages into a log."""

    def __init__(self, log: DataflashLog, vehicle: Logged) -> None:
        self._log = log
        self._vehicle = vehicle
        self._attitude_beat = _Beat(_ATTITUDE_PERIOD_S)
        self._position_beat = _Beat(_POSITION_PERIOD_S)
        self._gps_beat = _Beat(_GPS_PERIOD_S)
        self._rangefinder_beat = _Beat(_RANGEFINDER_PERIOD_S)

    def begin(self, t_s: float) -> None:
        """The head of a log: firmware, parameters, mode."""
        self.text(t_s, f"ArduCopter V{self._vehicle.generation.value}.0 (simulated)")
        self._parameters(t_s, self._vehicle.parameters)
        self.mode(t_s)

    def _parameters(self, t_s: float, rows: Iterable[tuple[str, float, float]]) -> None:
        for name, value, default in rows:
            self._log.write("PARM", t_s, name, value, default)

    def parameter(self, t_s: float, name: str) -> None:
        """A parameter has a new value."""
        self._log.write("PARM", t_s, name, self._vehicle.parameters.value(name), math.nan)

    def text(self, t_s: float, text: str) -> None:
        """A text has gone to the ground."""
        self._log.message(t_s, text)

    def mode(self, t_s: float) -> None:
        """The mode has changed."""
        mode = self._vehicle.modes.mode
        self._log.write("MODE", t_s, mode, mode, _REASON_COMMAND)

    def target(self, t_s: float, sub_mode: SubMode, position: Ned, velocity: Ned) -> None:
        """A target of Guided was taken. Positions are logged as they are flown: NED, height up."""
        north_m, east_m, down_m = position
        vn_mps, ve_mps, vd_mps = velocity
        no_terrain = 0
        self._log.write(
            "GUIP",
            t_s,
            int(sub_mode),
            north_m,
            east_m,
            -down_m,
            no_terrain,
            vn_mps,
            ve_mps,
            -vd_mps,
            0.0,
            0.0,
            0.0,
        )

    def step(self, t_s: float, unix_s: float) -> None:
        """Record what is due."""
        place: GlobalPosition | None = None
        if self._rangefinder_beat.due(t_s):
            self._rangefinder(t_s)
        if self._attitude_beat.due(t_s):
            self._attitude(t_s)
        if self._position_beat.due(t_s):
            place = self._vehicle.places.here()
            self._position(t_s, place)
        if self._gps_beat.due(t_s):
            self._gps(t_s, unix_s, place or self._vehicle.places.here())

    def _rangefinder(self, t_s: float) -> None:
        sensor = self._vehicle.rangefinder
        if sensor.status != NOT_CONNECTED:
            values = (sensor.distance_m, sensor.status, sensor.orientation, sensor.quality)
            self._log.write("RFND", t_s, 0, *values)

    def _attitude(self, t_s: float) -> None:
        body = self._vehicle.copter
        roll, pitch = math.degrees(body.roll_rad), math.degrees(body.pitch_rad)
        yaw = math.degrees(body.yaw_rad) % 360.0
        self._log.write("ATT", t_s, roll, roll, pitch, pitch, yaw, yaw, _EKF3)
        velocity = body.est_vn_mps, body.est_ve_mps, body.vd_mps
        place = body.est_north_m, body.est_east_m, body.est_down_m
        no_gyro_error = (0.0, 0.0, 0.0)
        self._log.write(
            *("XKF1", t_s, 0, roll, pitch, yaw, *velocity, body.vd_mps, *place),
            *(*no_gyro_error, ORIGIN.alt_m),
        )

    def _position(self, t_s: float, place: GlobalPosition) -> None:
        places = self._vehicle.places
        self._log.write("POS", t_s, *place, places.height_m(), place.alt_m - ORIGIN.alt_m)

    def _gps(self, t_s: float, unix_s: float, place: GlobalPosition) -> None:
        body = self._vehicle.copter
        speed_mps = math.hypot(body.est_vn_mps, body.est_ve_mps)
        course_deg = math.degrees(math.atan2(body.est_ve_mps, body.est_vn_mps)) % 360.0
        self._log.gps(t_s, unix_s, place, (speed_mps, course_deg, body.vd_mps))
