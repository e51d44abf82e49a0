"""Replay recordings of a vehicle through the copter model and say how far they part.

A recording is a CSV file, 25 rows a second or so, with the columns of `STATE_COLUMNS` (SI units,
local NED) and, for Guided flight, those of `COMMAND_COLUMNS`: the target in force, its velocity
(empty: position only) and the last speed limit. A recording without command columns is an Auto
mission. Its waypoints and speed stand in `NAME.toml` beside `NAME.csv` (`speed_mps = 2.0`,
`waypoints_m = [[60, 0], [60, 40]]`, north and east and, if wanted, down), or else are estimated
from the track: straight stretches are fitted with lines, neighbouring lines intersected, the last
waypoint is where the vehicle stays, the speed is the median of the legs' own, to the next
0.05 m/s. A way straight back shows its waypoint only to the metre: give such missions a sidecar.

What a row cannot say is taken from its rate: the first command came one row before the first row;
a command that appears in a row was given half a row before it. A mission starts when its motion
fits the recorded one best.

ArduCopter's generations fly differently. A recording is flown with the generation asked for, else
with the one its folder is named after (`4.6`), else with 4.8.
"""

import csv
import math
import tomllib
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median

from echowing.errors import EchowingError
from echowing.sim.vehicle.copter import LONGEST_STEP_S, Copter, tuning_of, wrap_pi
from echowing.sim.vehicle.parameters import Generation
from echowing.sim.vehicle.wpnav import Ned

STATE_COLUMNS = (
    "time_s",
    "north_m",
    "east_m",
    "down_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "yaw_rad",
)
COMMAND_COLUMNS = ("cmd_n", "cmd_e", "cmd_vn", "cmd_ve", "speed_cap")
# A leg is seen where the vehicle keeps this share of its speed and this heading for this long.
LEG_SPEED_SHARE = 0.8
LEG_HEADING_RAD = math.radians(2.0)
LEG_LEAST_S = 1.0
# Lines nearer to parallel than this do not meet in a waypoint: they are one leg, or a way back.
PARALLEL_RAD = math.radians(4.0)
# The track shows the speed to about 1 %, people set it in round numbers: steps of this, m/s.
SPEED_STEP_MPS = 0.05
# A leg cruises where its speed stays within this share for this long.
CRUISE_S = 1.0
STEADY_SHARE = 0.985
# Any speed above the peak then gives the same flight: the legs' length is what limits it.
NO_CRUISE_FACTOR = 1.5
# A mission has visibly begun at this share of its speed. Below it, the track hangs on the noise of
# the autopilot's estimate: its point waits for a vehicle that seems to drift back (AC_WPNav.cpp).
BEGUN_SHARE = 0.5


STILL_AIR: Ned = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Flyer:
    """Who flew a recording, and in which wind."""

    generation: Generation
    wind_ned_mps: Ned

    def copter(self, rows: Sequence["Row"]) -> Copter:
        """A vehicle in the recording's first state, one row earlier."""
        first, back_s = rows[0], _row_s(rows)
        position = [
            place - speed * back_s
            for place, speed in zip(first.position_m, first.velocity_mps, strict=True)
        ]
        copter = Copter(
            (position[0], position[1], position[2]),
            first.yaw_rad,
            tuning=tuning_of(self.generation),
            flying=True,
            velocity_ned_mps=first.velocity_mps,
            ground_down_m=math.inf,
        )
        copter.wind_ned_mps = self.wind_ned_mps
        copter.settle()
        return copter


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """How one replay went: horizontal position errors, metres.

    `kind` is "guided" or "auto"; `generation` the ArduCopter whose model flew it.
    """

    name: str
    rms_position_error_m: float
    max_error_m: float
    duration_s: float
    kind: str
    generation: str
    rms_3d_error_m: float


@dataclass(frozen=True, slots=True)
class Command:
    """What a row says was commanded; None where nothing was."""

    target_ne_m: tuple[float, float] | None
    velocity_ne_mps: tuple[float, float] | None
    speed_cap_mps: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a recording (SI units, local NED)."""

    time_s: float
    position_m: Ned
    velocity_mps: Ned
    yaw_rad: float
    command: Command | None

    @property
    def speed_mps(self) -> float:
        """Horizontal speed."""
        return math.hypot(self.velocity_mps[0], self.velocity_mps[1])

    @property
    def course_rad(self) -> float:
        """Direction of the horizontal velocity."""
        return math.atan2(self.velocity_mps[1], self.velocity_mps[0])


@dataclass(frozen=True, slots=True)
class Mission:
    """Waypoints (NED, metres) and speed of an Auto flight."""

    waypoints_m: tuple[Ned, ...]
    speed_mps: float


# ---- reading


def read_recording(path: Path) -> list[Row]:
    """Rows of a recording; raises `EchowingError` with file and line for anything malformed."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(_rows(path, csv.reader(file)))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise EchowingError(f"{path}: cannot be read as CSV: {error}") from error
    if len(rows) < 2:
        raise EchowingError(f"{path}: {len(rows)} rows of data; a recording needs at least 2")
    return rows


def _rows(path: Path, lines: Iterator[list[str]]) -> Iterator[Row]:
    header = [name.strip() for name in next(lines, [])]
    commanded = _check_header(path, header)
    last_s = -math.inf
    for number, cells in enumerate(lines, start=2):
        if not cells:
            continue
        if len(cells) != len(header):
            raise EchowingError(
                f"{path}, line {number}: {len(cells)} columns where the header has {len(header)}"
            )
        row = _row(f"{path}, line {number}", dict(zip(header, cells, strict=True)), commanded)
        if row.time_s <= last_s:
            raise EchowingError(f"{path}, line {number}: time_s does not increase")
        last_s = row.time_s
        yield row


def _check_header(path: Path, header: Sequence[str]) -> bool:
    """True if the recording has command columns."""
    if not header:
        raise EchowingError(f"{path}, line 1: the file is empty")
    commanded = any(name in header for name in COMMAND_COLUMNS)
    wanted = STATE_COLUMNS + (COMMAND_COLUMNS if commanded else ())
    missing = [name for name in wanted if name not in header]
    if missing:
        raise EchowingError(f"{path}, line 1: columns missing: {', '.join(missing)}")
    return commanded


def _row(where: str, cells: dict[str, str], commanded: bool) -> Row:
    state = [_number(where, name, cells[name]) for name in STATE_COLUMNS]
    time_s, north, east, down, vn, ve, vd, yaw = state
    command = _command(where, cells) if commanded else None
    return Row(time_s, (north, east, down), (vn, ve, vd), yaw, command)


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise EchowingError(f"{where}: {name} is {text!r}, not a number")
    return value


def _command(where: str, cells: dict[str, str]) -> Command:
    cap = cells["speed_cap"].strip()
    cap_mps = _number(where, "speed_cap", cap) if cap else None
    if cap_mps is not None and cap_mps < 0.0:
        raise EchowingError(f"{where}: speed_cap is {cap}; a limit is 0 (none) or more")
    target = _pair(where, cells, "cmd_n", "cmd_e")
    velocity = _pair(where, cells, "cmd_vn", "cmd_ve")
    if velocity is not None and target is None:
        raise EchowingError(f"{where}: cmd_vn without a target cmd_n, cmd_e")
    return Command(target, velocity, cap_mps)


def _pair(where: str, cells: dict[str, str], one: str, two: str) -> tuple[float, float] | None:
    if bool(cells[one].strip()) != bool(cells[two].strip()):
        raise EchowingError(f"{where}: {one} and {two} must be given together")
    if not cells[one].strip():
        return None
    return _number(where, one, cells[one]), _number(where, two, cells[two])


# ---- replaying


def replay_directory(
    directory: Path, generation: Generation | None = None, wind_ned_mps: Ned = STILL_AIR
) -> list[CalibrationResult]:
    """Replay every *.csv of a folder, then those in its folders named after a generation (`4.6`).

    `generation`: which ArduCopter flew them; None: as the folders' names say. `wind_ned_mps`: the
    mean velocity of the air.
    """
    if not directory.is_dir():
        raise EchowingError(f"{directory}: not a folder; name the one that holds the recordings")
    folders = [directory, *(directory / known.value for known in Generation)]
    files = [file for folder in folders for file in sorted(folder.glob("*.csv"))]
    if not files:
        raise EchowingError(f"{directory}: no recordings (*.csv) in this folder")
    return [replay(file, generation, wind_ned_mps) for file in files]


def _generation_of(path: Path) -> Generation:
    """Which ArduCopter flew a recording, by the name of its folder."""
    name = path.resolve().parent.name
    return next((known for known in Generation if known.value == name), Generation.V4_8)


def replay(
    path: Path, generation: Generation | None = None, wind_ned_mps: Ned = STILL_AIR
) -> CalibrationResult:
    """Fly a recording's commands with the model, from the recording's first state."""
    rows = read_recording(path)
    flyer = _Flyer(generation or _generation_of(path), wind_ned_mps)
    if rows[0].command is not None:
        return _compare(path.stem, flyer, rows, _Guided(rows, flyer))
    mission = read_mission(path.with_suffix(".toml"), rows)
    if mission is None:
        mission = estimate_mission(path, rows)
    return _replay_auto(path.stem, rows, mission, flyer)


def _row_s(rows: Sequence[Row]) -> float:
    """Time between rows."""
    return median(after.time_s - before.time_s for before, after in pairwise(rows))


class _Guided:
    """Gives the commands of a Guided recording at their times."""

    def __init__(self, rows: Sequence[Row], flyer: _Flyer) -> None:
        self.copter = flyer.copter(rows)
        self._row_s = _row_s(rows)
        self.start_s = rows[0].time_s - self._row_s
        self._down_m = median(row.position_m[2] for row in rows)
        self._in_force = Command(None, None, None)
        self._due = list(self._changes(rows))
        self._due.reverse()

    def _changes(self, rows: Sequence[Row]) -> Iterator[tuple[float, Command]]:
        last: Command | None = None
        for row in rows:
            if row.command is not None and row.command != last:
                given_s = row.time_s - 0.5 * self._row_s
                yield (self.start_s if last is None else given_s), row.command
                last = row.command

    def command(self, time_s: float) -> None:
        """Give what is due at this time."""
        while self._due and self._due[-1][0] <= time_s + 1e-9:
            self._give(self._due.pop()[1])

    def _give(self, command: Command) -> None:
        before, self._in_force = self._in_force, command
        target = command.target_ne_m
        moved = (target, command.velocity_ne_mps) != (before.target_ne_m, before.velocity_ne_mps)
        if target is not None and moved:
            self._aim((target[0], target[1], self._down_m), command.velocity_ne_mps)
        cap = command.speed_cap_mps
        if cap is not None and cap != before.speed_cap_mps:
            self.copter.set_speed_limit(cap)

    def _aim(self, target: Ned, velocity: tuple[float, float] | None) -> None:
        if velocity is None:
            self.copter.guided_position(target)
        else:
            self.copter.guided_posvel(target, (velocity[0], velocity[1], 0.0))


class _Auto:
    """Starts a mission `late_s` after the time at which its first motion fits the recording's."""

    def __init__(
        self, rows: Sequence[Row], mission: Mission, flyer: _Flyer, late_s: float = 0.0
    ) -> None:
        self.copter = flyer.copter(rows)
        self._mission: Mission | None = mission
        begun = BEGUN_SHARE * mission.speed_mps
        first_s = rows[0].time_s - _row_s(rows)
        recorded_s = next((row.time_s for row in rows if row.speed_mps > begun), first_s)
        trial = flyer.copter(rows)
        trial.start_auto(mission.waypoints_m, mission.speed_mps)
        steps = 0
        while math.hypot(trial.vn_mps, trial.ve_mps) <= begun and steps * LONGEST_STEP_S < 10.0:
            trial.step(LONGEST_STEP_S)
            steps += 1
        self._begin_s = recorded_s - steps * LONGEST_STEP_S + late_s
        self.start_s = min(first_s, self._begin_s)

    def command(self, time_s: float) -> None:
        """Start the mission if it is time."""
        mission = self._mission
        if mission is not None and time_s >= self._begin_s:
            self.copter.start_auto(mission.waypoints_m, mission.speed_mps)
            self._mission = None


def _replay_auto(
    name: str, rows: Sequence[Row], mission: Mission, flyer: _Flyer
) -> CalibrationResult:
    """Fly a mission twice: the second time without the first one's mean lag."""
    early_s = _mean_lag_s(rows, _fly(rows, _Auto(rows, mission, flyer)))
    return _compare(name, flyer, rows, _Auto(rows, mission, flyer, -early_s))


def _mean_lag_s(rows: Sequence[Row], flown: Sequence[Ned]) -> float:
    """How late a flight is behind the recorded one, where that one moves; s."""
    fast = LEG_SPEED_SHARE * max(row.speed_mps for row in rows)
    lags = [
        (
            (row.position_m[0] - place[0]) * row.velocity_mps[0]
            + (row.position_m[1] - place[1]) * row.velocity_mps[1]
        )
        / row.speed_mps**2
        for row, place in zip(rows, flown, strict=True)
        if row.speed_mps > fast
    ]
    return fmean(lags) if lags else 0.0


def _fly(rows: Sequence[Row], pilot: _Guided | _Auto) -> list[Ned]:
    """Where the model is at the time of each row."""
    copter, time_s = pilot.copter, pilot.start_s
    places: list[Ned] = []
    for row in rows:
        steps = max(1, math.ceil((row.time_s - time_s) / LONGEST_STEP_S - 1e-6))
        step_s = (row.time_s - time_s) / steps
        for _ in range(steps):
            pilot.command(time_s)
            copter.step(step_s)
            time_s += step_s
        places.append((copter.north_m, copter.east_m, copter.down_m))
    return places


def _compare(
    name: str, flyer: _Flyer, rows: Sequence[Row], pilot: _Guided | _Auto
) -> CalibrationResult:
    level = spatial = worst = 0.0
    for row, place in zip(rows, _fly(rows, pilot), strict=True):
        north, east, down = row.position_m
        squared = (place[0] - north) ** 2 + (place[1] - east) ** 2
        level += squared
        spatial += squared + (place[2] - down) ** 2
        worst = max(worst, squared)
    return CalibrationResult(
        name=name,
        rms_position_error_m=math.sqrt(level / len(rows)),
        max_error_m=math.sqrt(worst),
        duration_s=rows[-1].time_s - rows[0].time_s,
        kind="guided" if isinstance(pilot, _Guided) else "auto",
        generation=flyer.generation.value,
        rms_3d_error_m=math.sqrt(spatial / len(rows)),
    )


# ---- missions


def read_mission(path: Path, rows: Sequence[Row]) -> Mission | None:
    """The mission of a sidecar file, or None if there is none."""
    if not path.exists():
        return None
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise EchowingError(f"{path}: {error}") from error
    unknown = sorted(set(table) - {"speed_mps", "waypoints_m"})
    if unknown:
        raise EchowingError(f"{path}: unknown keys {', '.join(unknown)}; speed_mps, waypoints_m")
    speed = table.get("speed_mps")
    if not isinstance(speed, int | float) or not 0.0 < speed < math.inf:
        raise EchowingError(f"{path}: speed_mps must be a speed above 0 m/s, not {speed!r}")
    points = table.get("waypoints_m")
    if not isinstance(points, list) or not points:
        raise EchowingError(f"{path}: waypoints_m must be a list of [north, east] in metres")
    down_m = rows[0].position_m[2]
    return Mission(tuple(_waypoint(path, point, down_m) for point in points), float(speed))


def _waypoint(path: Path, point: object, down_m: float) -> Ned:
    numbers = (
        [part for part in point if isinstance(part, int | float)] if isinstance(point, list) else []
    )
    if not isinstance(point, list) or len(numbers) != len(point) or len(point) not in (2, 3):
        raise EchowingError(f"{path}: {point!r} is not a waypoint [north, east] or with down")
    return float(numbers[0]), float(numbers[1]), float(numbers[2]) if len(point) == 3 else down_m


@dataclass(frozen=True, slots=True)
class _Line:
    """A straight stretch of a track: its middle and direction, horizontal."""

    north_m: float
    east_m: float
    course_rad: float
    rows: tuple[Row, ...]


def estimate_mission(path: Path, rows: Sequence[Row]) -> Mission:
    """Waypoints and speed from the track alone (see the module's text for how)."""
    fast = LEG_SPEED_SHARE * max(row.speed_mps for row in rows)
    lines = _merge([_fit(stretch) for stretch in _stretches(rows, fast)])
    if not lines:
        raise EchowingError(
            f"{path}: no straight legs in this track; give waypoints_m and speed_mps "
            f"in {path.with_suffix('.toml').name}"
        )
    speed = _cruise_mps(lines)
    points = [_corner(before, after, rows) for before, after in pairwise(lines)]
    end = rows[-1].position_m
    return Mission((*points, (*_foot(lines[-1], end[0], end[1]), end[2])), speed)


def _stretches(rows: Sequence[Row], fast_mps: float) -> Iterator[list[Row]]:
    """Runs of rows with speed whose course stays that of the run."""
    run: list[Row] = []
    for row in rows:
        straight = row.speed_mps > fast_mps
        if straight and run:
            straight = (
                abs(wrap_pi(row.course_rad - run[len(run) // 2].course_rad)) < LEG_HEADING_RAD
            )
        if not straight:
            if run and run[-1].time_s - run[0].time_s >= LEG_LEAST_S:
                yield run
            run = []
        if row.speed_mps > fast_mps:
            run.append(row)
    if run and run[-1].time_s - run[0].time_s >= LEG_LEAST_S:
        yield run


def _fit(rows: Sequence[Row]) -> _Line:
    """Line through the second half of a stretch, where the last corner's swing has died out."""
    settled = rows[len(rows) // 2 :]
    middle = len(settled) // 2
    begin, end = _mean(settled[:middle]), _mean(settled[middle:])
    course = math.atan2(end[1] - begin[1], end[0] - begin[0])
    north, east = _mean(settled)
    return _Line(north, east, course, tuple(rows))


def _cruise_mps(lines: Sequence[_Line]) -> float:
    """Speed the mission was set to; where no leg comes to cruise, one that holds nothing back."""
    steady = [pace for pace in map(_pace, lines) if pace is not None]
    if steady:
        return round(median(steady) / SPEED_STEP_MPS) * SPEED_STEP_MPS
    return NO_CRUISE_FACTOR * max(row.speed_mps for line in lines for row in line.rows)


def _pace(line: _Line) -> float | None:
    """Speed of a leg's fastest steady window, by its positions; None if it never cruises.

    Positions, because a receiver's velocity has a bias; the settled half of the leg only.
    """
    settled = line.rows[len(line.rows) // 2 :]
    count = bisect_left(settled, settled[0].time_s + CRUISE_S, key=lambda row: row.time_s)
    paces = []
    for begin in range(len(settled) - count):
        window = settled[begin : begin + count + 1]
        speeds = [row.speed_mps for row in window]
        if min(speeds) > STEADY_SHARE * max(speeds):
            way_m = math.dist(window[0].position_m[:2], window[-1].position_m[:2])
            paces.append(way_m / (window[-1].time_s - window[0].time_s))
    return max(paces, default=None)


def _mean(rows: Sequence[Row]) -> tuple[float, float]:
    count = len(rows)
    return (
        sum(row.position_m[0] for row in rows) / count,
        sum(row.position_m[1] for row in rows) / count,
    )


def _merge(lines: Sequence[_Line]) -> list[_Line]:
    """Join neighbours of the same course: one leg seen in two pieces."""
    merged: list[_Line] = []
    for line in lines:
        if merged and abs(wrap_pi(line.course_rad - merged[-1].course_rad)) < PARALLEL_RAD:
            merged[-1] = _fit(merged[-1].rows + line.rows)
        else:
            merged.append(line)
    return merged


def _corner(before: _Line, after: _Line, rows: Sequence[Row]) -> Ned:
    """Where two legs meet; for a way straight back, the farthest the vehicle came."""
    along = (math.cos(before.course_rad), math.sin(before.course_rad))
    sine = math.sin(after.course_rad - before.course_rad)
    between = [row for row in rows if before.rows[-1].time_s <= row.time_s <= after.rows[0].time_s]
    north, east = after.north_m - before.north_m, after.east_m - before.east_m
    if abs(sine) < math.sin(PARALLEL_RAD):
        reach = max(
            (row.position_m[0] - before.north_m) * along[0]
            + (row.position_m[1] - before.east_m) * along[1]
            for row in between
        )
    else:
        reach = (north * math.sin(after.course_rad) - east * math.cos(after.course_rad)) / sine
    down_m = between[len(between) // 2].position_m[2]
    return before.north_m + reach * along[0], before.east_m + reach * along[1], down_m


def _foot(line: _Line, north_m: float, east_m: float) -> tuple[float, float]:
    """The point of a line nearest to a place."""
    along = (math.cos(line.course_rad), math.sin(line.course_rad))
    reach = (north_m - line.north_m) * along[0] + (east_m - line.east_m) * along[1]
    return line.north_m + reach * along[0], line.east_m + reach * along[1]
