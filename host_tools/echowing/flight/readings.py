"""Which messages are sonar readings, when each was taken, and where the sonar looked. Pure."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.axis import Axis, axis_of
from echowing.flight.estimate import Estimate
from echowing.flight.jumps import RangeMemory
from echowing.flight.leader_track import VehicleClock
from echowing.mavlink.messages import (
    FORWARD,
    gimbal_attitude,
    is_forward_rangefinder,
    sonar_range_m,
)

# The co-processor's newest single reading (firmware/README.md). If none has come for so long (a
# signed link refuses it, as no autopilot signs it), DISTANCE_SENSOR is used.
SONAR_READING = "SNR_RAW"
RAW_FRESH_S = 1.0
# The co-processor averages over 0.45 s: its middle.
AVERAGE_AGE_S = 0.225
# What the autopilot has read itself is so old as it sends it, with the time of sending. A lidar's
# is up to 0.1 s old; a MaxBotix is read 0.1 s after its ping, and handed out up to 0.1 s later.
FIXED_AGE_S = 0.1
# Without a newer ATTITUDE its reading was taken along the heading, level.
NOSE_FRESH_S = 0.3


class Readings:
    """Hands what a follower's sonar measures to its estimate.

    clock: its autopilot's; sender_id: the component that sends single readings, None: none does;
    ranges: what it has measured of whom it looks at.
    """

    def __init__(self, estimate: Estimate, clock: VehicleClock) -> None:
        self.ranges = RangeMemory()
        self.sender_id: int | None = None
        self._estimate, self._clock = estimate, clock
        self._single_at_s = -math.inf
        self._nose = -math.inf, Axis(0.0)

    def are_single(self, now_s: float) -> bool:
        """Whether the co-processor's single readings come."""
        return now_s - self._single_at_s <= RAW_FRESH_S

    @property
    def were_single(self) -> bool:
        """Whether a co-processor's single reading has ever come."""
        return math.isfinite(self._single_at_s)

    def leaned(self, message: Any, now_s: float) -> None:
        """Take its vehicle's ATTITUDE: where a sonar that is fixed to it points."""
        self._nose = now_s, Axis(message.yaw, message.pitch)

    def receive(self, kind: str, message: Any, now_s: float) -> None:
        """Take a message that may be its sonar's; single readings count before averages."""
        is_single = kind == "NAMED_VALUE_FLOAT" and message.name == SONAR_READING
        if is_single:
            self._single_at_s = now_s
        if self._estimate.sonar.fixed:
            self._read_by_autopilot(kind, message, now_s)
        elif is_single:
            stamp_s = message.time_boot_ms / 1e3
            time_s = self._estimate.sonar_clock.to_ours(stamp_s, now_s, self._clock.way_s)
            self.sender_id = message.get_srcComponent()
            self._take(time_s, message.value, message.time_boot_ms)
        elif kind == "GIMBAL_DEVICE_ATTITUDE_STATUS":
            quaternion = gimbal_attitude(message)
            axis = None if quaternion is None else axis_of(quaternion)
            if axis is not None and message.get_srcComponent() == self.sender_id:
                self._estimate.pointed(message.time_boot_ms, axis, now_s)
        elif (
            kind == "DISTANCE_SENSOR"
            and message.orientation == FORWARD
            and not self.are_single(now_s)
        ):
            self._take(now_s - self._clock.way_s - AVERAGE_AGE_S, self._range_m(message))

    def _read_by_autopilot(self, kind: str, message: Any, now_s: float) -> None:
        """Take a reading of the autopilot's own; one that is too near for its sensor is none."""
        own = message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
        if kind != "DISTANCE_SENSOR" or not own or not is_forward_rangefinder(message):
            return
        if message.current_distance >= message.min_distance:
            time_s = self._clock.to_ours(message.time_boot_ms / 1e3, now_s)
            stamp_ms, (seen_s, nose) = message.time_boot_ms, self._nose
            self._take(time_s - FIXED_AGE_S, self._range_m(message), stamp_ms)
            if now_s - seen_s < NOSE_FRESH_S:
                self._estimate.pointed(stamp_ms, nose, now_s)

    def _range_m(self, message: Any) -> float:
        """The range in a DISTANCE_SENSOR; the sonar's reach: it detects nothing."""
        reach_m = self._estimate.sonar.reach_m
        range_m = sonar_range_m(message, reach_m)
        return reach_m if range_m is None else range_m

    def _take(self, time_s: float, range_m: float, stamp_ms: int | None = None) -> None:
        self._estimate.heard(time_s, range_m, stamp_ms)
        if 0.0 < range_m < self._estimate.sonar.reach_m and self._estimate.is_believed:
            self.ranges.add(time_s, range_m)
