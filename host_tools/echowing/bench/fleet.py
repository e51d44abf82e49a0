"""A fleet of points that speak MAVLink: many followers for `echowing follow` at little cost.

No dynamics, no applet, no sonar physics: each follower goes straight to its last point. What is
true to life is the traffic: the messages of a real follower at the rates that the tool asks for.
`python -m echowing.bench.fleet PORT FOLLOWERS` sends all of it, as a router would, to one UDP port
of this machine until it is ended.
"""

import math
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.guidance import Slot, slot_offset_m
from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.mavlink.vehicle_limits import usual_parameters

LEADER_ID = 1
FIRST_FOLLOWER_ID = 2
HERE = GlobalPosition(39.34, -86.03, 250.0)  # the simulator's home (sim/vehicle/places.py)
HEIGHT_M = 10.0
LEADER_MPS = 2.0
TOP_MPS = 5.0
STEP_S = 0.02
_COPROCESSOR = 191  # lua/echowing.md: the sonar's component

# Messages of a follower in flight, Hz: what `follow` asks for, and what applet and sonar send.
RATES_HZ = {
    "heartbeat": 1.0,
    "position": 10.0,
    "target": 4.0,
    "range": 10.0,
    "reading": 2.0,
    "limit": 2.0,
    "gimbal": 1.0,
}
LEADER_RATES_HZ = {"heartbeat": 1.0, "position": 4.0}


_PARAMETERS = {"ECHO_ENABLE": 1.0, "ECHO_LAW": 2.0, "ECHO_INSET": 0.2, **usual_parameters()}


class Point:
    """One vehicle: where it is (NED metres from `HERE`), how it moves, what it says when."""

    def __init__(self, system_id: int, at_ned_m: Ned, rates_hz: dict[str, float]) -> None:
        self.system_id = system_id
        self.at_ned_m = at_ned_m
        self.velocity_mps = (0.0, 0.0)
        self.target: GlobalPosition | None = None
        self._autopilot = mavlink.MAVLink(None, system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._sonar = mavlink.MAVLink(None, system_id, _COPROCESSOR)
        self._periods_s = {kind: 1.0 / rate_hz for kind, rate_hz in rates_hz.items()}
        # Spread over the second, as vehicles that were not switched on together.
        shift = system_id * 0.618 % 1.0
        self._due_s = {kind: shift * period_s for kind, period_s in self._periods_s.items()}

    def move(self, dt_s: float) -> None:
        """One step towards its target, slowing down before it as a copter does."""
        north, east, down = self.at_ned_m
        if self.target is not None:
            wanted_n, wanted_e, down = ned_between(HERE, self.target)
            off_n, off_e = wanted_n - north, wanted_e - east
            pace = min(1.0, TOP_MPS / max(math.hypot(off_n, off_e), 1e-6))
            self.velocity_mps = (off_n * pace, off_e * pace)
        self.at_ned_m = (
            north + self.velocity_mps[0] * dt_s,
            east + self.velocity_mps[1] * dt_s,
            down,
        )

    def hear(self, message: Any, t_s: float) -> bytes:
        """Take a message; returns the answer, if it has one."""
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            return self._pack(mavlink.MAVLink_timesync_message(round(t_s * 1e9), message.ts1))
        if getattr(message, "target_system", None) != self.system_id:
            return b""
        if kind == "SET_POSITION_TARGET_GLOBAL_INT":
            at_m = HERE.alt_m + message.alt
            self.target = GlobalPosition(message.lat_int / 1e7, message.lon_int / 1e7, at_m)
        elif kind == "PARAM_REQUEST_READ":
            name, real = message.param_id.encode(), mavlink.MAV_PARAM_TYPE_REAL32
            value = _PARAMETERS.get(message.param_id, 3.0)
            return self._pack(mavlink.MAVLink_param_value_message(name, value, real, 1, 0))
        return b""

    def says(self, t_s: float) -> Iterator[bytes]:
        """What is due at `t_s`, seconds since it was switched on."""
        for kind, period_s in self._periods_s.items():
            if t_s >= self._due_s[kind]:
                self._due_s[kind] += period_s
                message = getattr(self, f"_{kind}")(round(t_s * 1e3))
                yield self._pack(message, sonar=kind in ("range", "reading", "gimbal"))

    def _pack(self, message: Any, *, sonar: bool = False) -> bytes:
        sender = self._sonar if sonar else self._autopilot
        frame = bytes(message.pack(sender))
        sender.seq = (sender.seq + 1) % 256
        return frame

    def _heartbeat(self, boot_ms: int) -> Any:
        flags = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode, flying = mavlink.COPTER_MODE_GUIDED, mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, mode, flying, 3
        )

    def _position(self, boot_ms: int) -> Any:
        at = displace(HERE, self.at_ned_m)
        north_mps, east_mps = self.velocity_mps
        return mavlink.MAVLink_global_position_int_message(
            *(boot_ms, round(at.lat_deg * 1e7), round(at.lon_deg * 1e7), round(at.alt_m * 1e3)),
            *(round(-self.at_ned_m[2] * 1e3), round(north_mps * 100), round(east_mps * 100), 0, 0),
        )

    def _target(self, boot_ms: int) -> Any:
        at = self.target or displace(HERE, self.at_ned_m)
        frame = mavlink.MAV_FRAME_GLOBAL_INT
        return mavlink.MAVLink_position_target_global_int_message(
            *(boot_ms, frame, 0xFDF8, round(at.lat_deg * 1e7), round(at.lon_deg * 1e7), at.alt_m),
            *(0.0,) * 8,
        )

    def _range(self, boot_ms: int) -> Any:
        nothing_cm, beyond_cm = 765, 766  # it hears nobody: beyond its reach
        return mavlink.MAVLink_distance_sensor_message(
            boot_ms, 20, nothing_cm, beyond_cm, 1, 0, mavlink.MAV_SENSOR_ROTATION_NONE, 255
        )

    def _reading(self, boot_ms: int) -> Any:
        return mavlink.MAVLink_named_value_float_message(boot_ms, b"SNR_RAW", 7.65)

    def _limit(self, boot_ms: int) -> Any:
        return mavlink.MAVLink_named_value_float_message(boot_ms, b"ECHO_SPD", 3.0)

    def _gimbal(self, boot_ms: int) -> Any:
        return mavlink.MAVLink_named_value_float_message(boot_ms, b"SNR_STATE", 1.0)


def make_fleet(slots: Sequence[Slot]) -> list[Point]:
    """A leader that flies north, and a follower in each slot behind it."""
    leader = Point(LEADER_ID, (0.0, 0.0, -HEIGHT_M), LEADER_RATES_HZ)
    leader.velocity_mps = (LEADER_MPS, 0.0)
    fleet = [leader]
    for number, slot in enumerate(slots):
        at_ned_m = (*slot_offset_m(slot, 0.0), -HEIGHT_M - slot.altitude_step_m)
        fleet.append(Point(FIRST_FOLLOWER_ID + number, at_ned_m, RATES_HZ))
    return fleet


def serve(fleet: Sequence[Point], port: int) -> None:
    """Fly and talk until the process is ended."""
    air = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    air.setblocking(False)
    ears = mavlink.MAVLink(None)
    ears.robust_parsing = True
    tool, started_s, next_s = ("127.0.0.1", port), time.monotonic(), time.monotonic()
    while True:
        next_s += STEP_S
        time.sleep(max(0.0, next_s - time.monotonic()))
        t_s = time.monotonic() - started_s
        for frame in _turn(fleet, ears, _arrived(air), t_s):
            try:
                air.sendto(frame, tool)
            except OSError:  # the tool is not there yet, or no more
                break


def _arrived(air: socket.socket) -> bytes:
    data = b""
    while True:
        try:
            data += air.recv(65_535)
        except BlockingIOError:
            return data
        except OSError:
            continue


def _turn(fleet: Sequence[Point], ears: Any, data: bytes, t_s: float) -> Iterator[bytes]:
    """Answers to what has come, and what is due."""
    by_id = {point.system_id: point for point in fleet}
    for message in ears.parse_buffer(data) or () if data else ():
        addressed = by_id.get(getattr(message, "target_system", 0))
        for point in fleet if addressed is None else (addressed,):
            if answer := point.hear(message, t_s):
                yield answer
    for point in fleet:
        point.move(STEP_S)
        yield from point.says(t_s)


def main() -> None:
    """The process: PORT FOLLOWERS, the first so many slots of the scenario `many`."""
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415 (only here)

    port, followers = int(sys.argv[1]), int(sys.argv[2])
    serve(make_fleet(load_scenario("many").slots()[:followers]), port)


if __name__ == "__main__":
    main()
