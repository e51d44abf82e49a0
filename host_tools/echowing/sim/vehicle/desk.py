"""A vehicle on the desk: what a script sees is set by hand, what it does is recorded.

For tests and measurements of applets.
"""

# ruff: noqa: D102 - each method does what VehicleApi says

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from echowing.sim.vehicle.dataflash import ScriptMessage
from echowing.sim.vehicle.luahost import AltitudeFrame, Ned, Position, RangefinderBackend

NO_DATA = 1
GOOD = 4


@dataclass
class DeskVehicle:
    """Implements `VehicleApi`; every attribute may be changed between steps."""

    parameters: dict[str, float]
    saved: dict[str, float] = field(default_factory=dict)
    """Script parameters that a former flight saved, by full name."""
    t_ms: int = 0
    is_armed: bool = True
    is_flying: bool = True
    mode: int = 4
    ranges: dict[int, tuple[int, float]] = field(default_factory=lambda: {0: (NO_DATA, 0.0)})
    """Orientation -> (status, metres)."""
    range_type: int = 10
    """RNGFNDn_TYPE of all of them: MAVLink."""
    range_read_ms: int = 0
    """When their driver took the newest reading."""
    first_sensors: list[RangefinderBackend] = field(default_factory=list)
    """More of them, numbered before those."""
    switches: dict[int, int] = field(default_factory=dict)
    position: Ned | None = (0.0, 0.0, -10.0)
    velocity: Ned | None = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    place: tuple[float, float, float] | None = (39.34, -86.03, 260.0)
    height_m: float = 10.0
    """Above home."""
    target: Position | None = None
    takes_posvel: bool = True
    """Whether targets with a velocity are accepted."""
    free_auth_ids: int = 3
    inbox: deque[tuple[bytes, int]] = field(default_factory=deque)
    links: int = 2
    has_room: bool = True
    """Whether its links take what scripts send."""

    desired_speeds: list[float] = field(default_factory=list)
    targets: list[tuple[str, tuple[float | str | None, ...]]] = field(default_factory=list)
    texts: list[tuple[int, str]] = field(default_factory=list)
    named: dict[str, list[float]] = field(default_factory=dict)
    log: list[tuple[str, tuple[float | int | str, ...]]] = field(default_factory=list)
    sent: list[tuple[int, int, bytes]] = field(default_factory=list)
    """MAVLink messages of scripts: link, id, payload."""
    auth: dict[int, str | None] = field(default_factory=dict)
    """Authorisation id -> reason of refusal, None: passed."""
    tables: dict[int, str] = field(default_factory=dict)
    added: set[str] = field(default_factory=set)
    """Script parameters that exist since the start."""
    numbers: dict[str, int] = field(default_factory=dict)
    """The number by which the autopilot keeps each of them."""

    def millis(self) -> int:
        return self.t_ms

    def armed(self) -> bool:
        return self.is_armed

    def mode_number(self) -> int:
        return self.mode

    def flying(self) -> bool:
        return self.is_flying

    def parameter_get(self, name: str) -> float | None:
        return self.parameters.get(name)

    def parameter_set(self, name: str, value: float) -> bool:
        if name not in self.parameters:
            return False
        self.parameters[name] = value
        return True

    def parameter_save(self, name: str, value: float) -> bool:
        if not self.parameter_set(name, value):
            return False
        self.saved[name] = value
        return True

    def parameter_add_table(self, key: int, prefix: str, count: int) -> bool:
        if self.tables.get(key, prefix) != prefix:
            return False
        self.tables[key] = prefix
        return True

    def parameter_add(self, key: int, index: int, name: str, default: float) -> bool:
        """As AP_Param::add_param: a script that comes again finds what was saved, or the default.

        A parameter that was there before any script is one that a pilot has saved.
        """
        full = self.tables[key] + name
        if full not in self.added and full in self.parameters:
            self.saved.setdefault(full, self.parameters[full])
        self.added.add(full)
        self.numbers[full] = index
        self.parameters[full] = self.saved.get(full, default)
        return True

    def rangefinder_orientations(self) -> Sequence[int]:
        return [one.orientation for one in self.first_sensors] + list(self.ranges)

    def rangefinder_status(self, orientation: int) -> int:
        return self.ranges.get(orientation, (0, 0.0))[0]

    def rangefinder_distance_m(self, orientation: int) -> float:
        return self.ranges.get(orientation, (0, 0.0))[1]

    def rangefinder_signal_quality(self, orientation: int) -> int:
        return -1

    def rangefinder_backend(self, number: int) -> RangefinderBackend | None:
        sensors = self.first_sensors + [
            RangefinderBackend(orientation, self.range_type, status, metres, self.range_read_ms)
            for orientation, (status, metres) in self.ranges.items()
        ]
        return sensors[number] if number < len(sensors) else None

    def set_desired_speed(self, speed_mps: float) -> bool:
        self.desired_speeds.append(speed_mps)
        return self.mode == 4

    def set_target_location(
        self, lat_deg: float, lon_deg: float, alt_m: float, frame: AltitudeFrame
    ) -> bool:
        self.targets.append(("location", (lat_deg, lon_deg, alt_m, frame)))
        self.target = (lat_deg, lon_deg, alt_m, frame)
        return self.mode == 4

    def get_target_location(self) -> Position | None:
        return self.target

    def set_target_position_ned(self, position_ned_m: Ned, yaw_rad: float | None) -> bool:
        self.targets.append(("position", (*position_ned_m, yaw_rad)))
        if self.place is not None and self.position is not None:
            ahead_m = position_ned_m[0] - self.position[0]
            self.target = (self.place[0] + ahead_m / 111318.845, *self.place[1:], "absolute")
        return self.mode == 4

    def set_target_posvel_ned(
        self,
        position_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> bool:
        how = (yaw_rad, *acceleration_ned_mps2, yaw_rate_rps)
        target = (*position_ned_m, *velocity_ned_mps, *how)
        self.targets.append(("posvel", target))
        self.target = None
        return self.mode == 4 and self.takes_posvel

    def set_target_velocity_ned(self, velocity_ned_mps: Ned) -> bool:
        self.targets.append(("velocity", velocity_ned_mps))
        self.target = None
        return self.mode == 4

    def position_ned_m(self) -> Ned | None:
        return self.position

    def height_above_home_m(self) -> float:
        return self.height_m

    def velocity_ned_mps(self) -> Ned | None:
        return self.velocity

    def location(self) -> tuple[float, float, float] | None:
        return self.place

    def yaw_rad(self) -> float:
        return self.yaw

    def rc_option_position(self, option: int) -> int | None:
        return self.switches.get(option)

    def send_text(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))

    def send_named_float(self, name: str, value: float) -> None:
        self.named.setdefault(name, []).append(value)

    def log_write(self, message: ScriptMessage) -> None:
        self.log.append((message.name, tuple(message.values)))

    def aux_auth_id(self) -> int | None:
        if not self.free_auth_ids:
            return None
        self.free_auth_ids -= 1
        return self.free_auth_ids

    def aux_auth_passed(self, auth_id: int) -> None:
        self.auth[auth_id] = None

    def aux_auth_failed(self, auth_id: int, reason: str) -> None:
        self.auth[auth_id] = reason

    def next_mavlink(self) -> tuple[bytes, int] | None:
        return self.inbox.popleft() if self.inbox else None

    def send_mavlink(self, link: int, message_id: int, payload: bytes) -> bool | None:
        if link >= self.links:
            return None
        if self.has_room:
            self.sent.append((link, message_id, payload))
        return self.has_room


def restarted(old: DeskVehicle, parameters: Mapping[str, float]) -> DeskVehicle:
    """The same vehicle after a reboot: the firmware's `parameters` and what scripts saved."""
    return DeskVehicle(dict(parameters), dict(old.saved))
