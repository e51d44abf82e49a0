"""Leaders: the missions they fly, the walks they are carried on, the tracks they once flew."""

import bisect
import csv
import math
from collections.abc import Sequence
from pathlib import Path

from echowing.errors import EchowingError
from echowing.geo import GlobalPosition, Ned, ned_between
from echowing.sim.scenario import LeaderSection
from echowing.sim.vehicle.estimate import EstimatedPosition

# Points on a circle, so near that the corners between them vanish in the corner cutting.
CIRCLE_POINTS = 36
# A walker turns a corner at a brisk walk, and brakes for it as a runner does with something heavy
# in his hands: half of a sprinter's 5 m/s2.
WALKS_MPS, WALKER_MPS2 = 1.5, 2.5

TrackRow = tuple[float, float, float, float, float]  # time_s, north_m, east_m, down_m, yaw_rad


def mission(leader: LeaderSection) -> list[Ned]:
    """The waypoints of an Auto mission, NED metres, all laps; it begins where the leader is."""
    lap = _LAPS[leader.path](leader)
    down_m = -leader.altitude_m
    return [(north, east, down_m) for _ in range(leader.laps) for north, east in lap]


def _rectangle(leader: LeaderSection) -> list[tuple[float, float]]:
    north, east = leader.north_m, leader.east_m
    return [(north, 0.0), (north, east), (0.0, east), (0.0, 0.0)]


def _circle(leader: LeaderSection) -> list[tuple[float, float]]:
    """Clockwise, tangent to north at the start."""
    return [_on_circle(leader.radius_m, k / CIRCLE_POINTS) for k in range(1, CIRCLE_POINTS + 1)]


def _figure_eight(leader: LeaderSection) -> list[tuple[float, float]]:
    """A circle to the right, then one to the left."""
    right = _circle(leader)
    return right + [(north, -east) for north, east in right]


def _on_circle(radius_m: float, turn: float) -> tuple[float, float]:
    angle = 2.0 * math.pi * turn
    return radius_m * math.sin(angle), radius_m * (1.0 - math.cos(angle))


_LAPS = {
    "rectangle": _rectangle,
    "stop-and-go": _rectangle,
    "circle": _circle,
    "figure-eight": _figure_eight,
}


class TrackedBody(EstimatedPosition):
    """A body moved along a track, with the attributes of a `Copter`: walked, or replayed.

    The first and last rows hold before and after the track.
    """

    def __init__(self, rows: Sequence[TrackRow]) -> None:
        self._rows = list(rows)
        self._times_s = [row[0] for row in rows]
        self._t_s = self._times_s[0]
        super().__init__()
        self.roll_rad = self.pitch_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0
        self.target_ned_m: Ned | None = None
        self.landed = False
        self._place()

    def step(self, dt_s: float) -> None:
        """Move `dt_s` along the track."""
        self._t_s += dt_s
        self._place()

    def _place(self) -> None:
        index = bisect.bisect_right(self._times_s, self._t_s) - 1
        index = max(0, min(index, len(self._rows) - 2))
        a, b = self._rows[index], self._rows[index + 1]
        span_s = b[0] - a[0]
        share = max(0.0, min(1.0, (self._t_s - a[0]) / span_s))
        self.north_m, self.east_m, self.down_m = (a[i] + share * (b[i] - a[i]) for i in (1, 2, 3))
        moving = 0.0 < share < 1.0
        self.vn_mps, self.ve_mps, self.vd_mps = (
            (b[i] - a[i]) / span_s if moving else 0.0 for i in (1, 2, 3)
        )
        self.yaw_rad = a[4]


def walk(leader: LeaderSection, duration_s: float) -> list[TrackRow]:
    """A copter carried by hand round the rectangle (thesis 4.2.3), sampled every 0.2 s.

    The walker turns sharply, within a step, but runs round no corner: he slows down before it. The
    copter points where he goes.
    """
    corners = [(0.0, 0.0), *_rectangle(leader)]
    rows: list[TrackRow] = []
    position, target, step_s = list(corners[0]), 1, 0.2
    for k in range(int(duration_s / step_s) + 2):
        goal = corners[1 + (target - 1) % 4]
        north, east = goal[0] - position[0], goal[1] - position[1]
        distance = math.hypot(north, east)
        gone = math.dist(position, corners[1 + (target - 2) % 4])
        yaw = math.atan2(east, north)
        rows.append((k * step_s, position[0], position[1], -leader.altitude_m, yaw))
        speed_mps = min(leader.speed_mps, _corner_speed_mps(min(distance, gone)))
        stride = min(distance, speed_mps * step_s)
        if distance > 0.0:
            position = [
                position[0] + stride * north / distance,
                position[1] + stride * east / distance,
            ]
        if distance - stride < 1e-9:
            target += 1
    return rows


def _corner_speed_mps(distance_m: float) -> float:
    """The fastest that a walker is at this distance from a corner."""
    return math.sqrt(WALKS_MPS**2 + 2.0 * WALKER_MPS2 * distance_m)


def load_track(path: Path) -> list[TrackRow]:
    """A recorded track: a CSV with time_s, north_m, east_m, down_m and maybe yaw_rad, or a .tlog.

    Raises EchowingError if the file cannot be read or holds fewer than two points.
    """
    rows = _tlog_rows(path) if path.suffix == ".tlog" else _csv_rows(path)
    if len(rows) < 2:
        raise EchowingError(f"{path}: a track needs at least two points, this has {len(rows)}")
    return rows


def _csv_rows(path: Path) -> list[TrackRow]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            records = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise EchowingError(f"{path}: cannot read the track: {error}") from error
    rows: list[TrackRow] = []
    for number, record in enumerate(records, 2):
        try:
            t, n, e, d = (float(record[key]) for key in ("time_s", "north_m", "east_m", "down_m"))
            yaw = float(record.get("yaw_rad") or 0.0)
        except (KeyError, TypeError, ValueError) as error:
            raise EchowingError(
                f"{path}, line {number}: needs numbers in time_s, north_m, east_m, down_m"
            ) from error
        if rows and t <= rows[-1][0]:
            raise EchowingError(f"{path}, line {number}: time_s does not rise")
        rows.append((t, n, e, d, yaw))
    return rows


def _tlog_rows(path: Path) -> list[TrackRow]:
    from pymavlink import mavutil  # noqa: PLC0415 (slow import, seldom needed)

    if not path.is_file():
        raise EchowingError(f"{path}: no such file")
    log = mavutil.mavlink_connection(str(path))
    rows: list[TrackRow] = []
    origin: GlobalPosition | None = None
    while (message := log.recv_match(type="GLOBAL_POSITION_INT")) is not None:
        here = GlobalPosition(message.lat / 1e7, message.lon / 1e7, message.relative_alt / 1e3)
        origin = origin or GlobalPosition(here.lat_deg, here.lon_deg, 0.0)
        t_s = message.time_boot_ms / 1e3
        if not rows or t_s > rows[-1][0]:
            rows.append((t_s, *ned_between(origin, here), math.radians(message.hdg / 100.0)))
    return rows
