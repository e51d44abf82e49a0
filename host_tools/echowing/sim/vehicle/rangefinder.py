"""A rangefinder as the autopilot treats it: by MAVLink, or read by a driver of its own.

AP_RangeFinder_MAVLink.cpp, AP_RangeFinder_MaxsonarI2CXL.cpp, AP_RangeFinder_Backend.cpp.
"""

from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.parameters import Parameters

NOT_CONNECTED, NO_DATA, OUT_OF_RANGE_LOW, OUT_OF_RANGE_HIGH, GOOD = range(5)
TIMEOUT_MS = 500  # AP_RangeFinder_MAVLink.cpp: older data is dumped
DRIVER_TIMEOUT_MS = 300  # AP_RangeFinder_MaxsonarI2CXL.cpp
UPDATE_MS = 50  # Copter.cpp, read_rangefinder: what a driver has read is there from then on
MAXBOTIX_TYPE, MAVLINK_TYPE = 2, 10  # RNGFND1_TYPE; the first by I2C
QUALITY_UNKNOWN = -1


class MavlinkRangefinder:
    """State of RNGFND1: distance, status, quality.

    driven: a driver of the autopilot's own reads a sensor of this type, which is not MAVLink.
    """

    __slots__ = (
        "_cm",
        "_heard_ms",
        "_max_cm",
        "_min_cm",
        "_parameters",
        "_quality",
        "_read_cm",
        "_updated_ms",
        "distance_m",
        "driven",
        "kind",
        "quality",
        "read_ms",
        "status",
    )

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._heard_ms: int | None = None
        self._cm = self._min_cm = self._max_cm = 0
        self._quality = QUALITY_UNKNOWN
        self._read_cm = self._updated_ms = 0
        self.driven = False
        self.read_ms = 0
        self.kind = mavlink.MAV_DISTANCE_SENSOR_UNKNOWN
        self.status = NOT_CONNECTED
        self.distance_m = 0.0
        self.quality = QUALITY_UNKNOWN

    @property
    def configured(self) -> bool:
        """Whether RNGFND1_TYPE is MAVLink, or a driver reads what is there."""
        return self.type == MAVLINK_TYPE or (self.type != 0 and self.driven)

    @property
    def type(self) -> int:
        """RNGFND1_TYPE."""
        return int(self._parameters.value("RNGFND1_TYPE"))

    @property
    def orientation(self) -> int:
        """RNGFND1_ORIENT: 0 forward, 25 down."""
        return int(self._parameters.value("RNGFND1_ORIENT"))

    def receive(self, message: Any, t_ms: int) -> None:
        """Take a DISTANCE_SENSOR, if it is meant for this sensor."""
        if self.type != MAVLINK_TYPE or message.orientation != self.orientation:
            return
        address = self._parameters.value("RNGFND1_ADDR")
        if self._parameters.dialect.filters_address and address not in (0, message.id):
            return
        self._heard_ms = t_ms
        self._cm = message.current_distance
        self._min_cm, self._max_cm = message.min_distance, message.max_distance
        self.kind = message.type
        # On the wire 0 is "unknown" and 1 the worst; inside, -1 and 0.
        on_wire = message.signal_quality
        self._quality = {0: QUALITY_UNKNOWN, 1: 0}.get(on_wire, on_wire)

    def read(self, centimetres: int, t_ms: int) -> None:
        """Take what the driver has read: its stamp counts now, the distance from the next update.

        So does a MaxBotix' driver, whose timer stamps. Others take both at an update.
        """
        self.read_ms, self._read_cm = t_ms, centimetres
        if self.type != MAXBOTIX_TYPE:
            self._heard_ms, self._cm = t_ms, centimetres

    def _hand_out(self, t_ms: int) -> None:
        if t_ms - self._updated_ms >= UPDATE_MS:
            self._updated_ms = t_ms - t_ms % UPDATE_MS
            if self.read_ms:
                self._heard_ms, self._cm = self.read_ms, self._read_cm

    def update(self, t_ms: int) -> None:
        """Judge what was heard, at `t_ms`."""
        if self.driven:
            self._hand_out(t_ms)
        if not self.configured:
            self.status, self.distance_m, self.quality = NOT_CONNECTED, 0.0, QUALITY_UNKNOWN
            return
        timeout_ms = DRIVER_TIMEOUT_MS if self.driven else TIMEOUT_MS
        if self._heard_ms is None or t_ms - self._heard_ms > timeout_ms:
            self.status, self.distance_m, self.quality = NO_DATA, 0.0, QUALITY_UNKNOWN
            return
        self.distance_m = self._cm * 0.01
        self.quality = self._quality
        if self.distance_m > self.max_m():
            self.status = OUT_OF_RANGE_HIGH
        elif self.distance_m < self.min_m():
            self.status = OUT_OF_RANGE_LOW
        else:
            self.status = GOOD

    def max_m(self) -> float:
        """Farthest believed range: the nearer of the parameter and the sensor's own."""
        parameter = self._span(self._parameters.dialect.range_max)
        if self._max_cm == 0 and self._min_cm == 0:  # the sensor names no limits
            return parameter
        return min(parameter, self._max_cm * 0.01)

    def min_m(self) -> float:
        """Nearest believed range: the farther of the parameter and the sensor's own."""
        parameter = self._span(self._parameters.dialect.range_min)
        if self._max_cm == 0 and self._min_cm == 0:
            return parameter
        return max(parameter, self._min_cm * 0.01)

    def _span(self, name: str) -> float:
        return _metres(self._parameters.value(name), self._parameters.dialect.range_scale)


@lru_cache(maxsize=64)
def _metres(value: float, scale: float) -> float:
    """Rounded because 0.2 as a 32-bit float lies a hair above 20 cm times 0.01."""
    return round(value * scale, 6)
