"""Recorded flights as moments: the logs of `follow`, or the vehicles' own logs.

A long flight of many vehicles has hundreds of megabytes. So only the places where its moments begin
are kept; a moment is read when it is shown.
"""

import bisect
import csv
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Protocol, cast, get_type_hints

from echowing.analysis.flight import Flight
from echowing.analysis.logs import read_flights
from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.flight.health import assess
from echowing.geo import GlobalPosition, displace
from echowing.tool.moment import Moment, members, places
from echowing.tool.panel import PREFIXES, Row, VehicleHealth
from echowing.tool.track import Track

# Place on the globe for logs in metres; nothing that is shown depends on it.
NOWHERE = GlobalPosition(0.0, 0.0, 0.0)
HEIGHTS = "heights are above the place where the leader's log begins"

Event = tuple[float, str]


class Recording(Protocol):
    """A flight, moment by moment."""

    title: str

    @property
    def times_s(self) -> Sequence[float]:
        """The times of its moments, rising."""

    @property
    def events(self) -> Sequence[Event]:
        """Its events: time and text."""

    def moment(self, index: int) -> Moment:
        """The moment at `times_s[index]`."""


def open_recording(paths: Sequence[Path], sonar: SonarBelief) -> Recording:
    """The flight in some paths: a folder or table of `follow --log`, else logs as `analyze` reads.

    sonar: what is believed of the followers' sonars. Raises EchowingError if there is none.
    """
    tables = [table for path in paths for table in _tables(path)]
    if not tables:
        return FlightsRecording(read_flights(paths), sonar)
    if len(tables) > 1:
        listed = ", ".join(str(table) for table in tables)
        raise EchowingError(f"replay: {len(tables)} flights ({listed}): give one of the files")
    return TableRecording(tables[0], sonar)


def _tables(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(path.glob("follow-*.csv"))
    return [path] if path.suffix == ".csv" else []


def judged(moment: Moment, sonar: SonarBelief) -> Moment:
    """The moment with the formation's health, judged by this moment alone."""
    origin = moment.origin
    if origin is None:
        return moment
    vehicles = members(moment, places(moment, origin), sonar)
    health = assess(vehicles, moment.leader_id, sonar)
    return Moment(moment.time_s, moment.rows, moment.tracks, health)


# ---- what follow has logged ---------------------------------------------------------------------


class TableRecording:
    """The CSV of `follow --log`, and the events beside it. Raises EchowingError."""

    def __init__(self, path: Path, sonar: SonarBelief) -> None:
        self._path, self._sonar = path, sonar
        self.title = f"replay of {path.name}"
        self.times_s: list[float] = []
        self._begins: list[int] = []
        try:
            self._file: BinaryIO = path.open("rb")
            self._end = self._index()
        except OSError as error:
            raise EchowingError(f"replay: {path}: cannot be read: {error.strerror}") from error
        if not self.times_s:
            raise EchowingError(f"replay: {path}: holds no rows; did the vehicle ever report?")
        self.events = self._read_events()

    def moment(self, index: int) -> Moment:
        """As `Recording`."""
        self._file.seek(self._begins[index])
        end = self._begins[index + 1] if index + 1 < len(self._begins) else self._end
        text = self._file.read(end - self._begins[index]).decode("utf-8", "replace")
        rows = [
            dict(zip(self._names, cells, strict=False)) for cells in csv.reader([*_lines(text)])
        ]
        try:
            return judged(
                Moment(
                    self.times_s[index],
                    [_row(row) for row in rows],
                    [_made(Track, row) for row in rows],
                ),
                self._sonar,
            )
        except (KeyError, ValueError) as error:
            at_s = self.times_s[index]
            raise EchowingError(
                f"replay: {self._path}: damaged at {at_s:.1f} s: {error}"
            ) from error

    def _index(self) -> int:
        """Find where each moment begins; returns where the last ends. A cut line is left out."""
        self._names = next(csv.reader([self._file.readline().decode("utf-8", "replace")]), [])
        if "time_s" not in self._names or "system_id" not in self._names:
            raise EchowingError(f"replay: {self._path}: not a table of echowing follow --log")
        self._start_unix_s: float | None = None
        place, column = self._file.tell(), self._names.index("time_s")
        for line in self._file:
            cells = line.split(b",", column + 1)
            if not line.endswith(b"\n") or len(cells) <= column:
                break
            time_s = self._number(cells[column])
            if not self.times_s or time_s > self.times_s[-1]:
                self.times_s.append(time_s)
                self._begins.append(place)
            if self._start_unix_s is None:
                self._start_unix_s = self._number(cells[0]) - time_s
            place += len(line)
        return place

    def _number(self, cell: bytes) -> float:
        try:
            return float(cell)
        except ValueError:
            shown = cell.decode("utf-8", "replace")
            raise EchowingError(
                f"replay: {self._path}: {shown!r} is not a time; is the file damaged?"
            ) from None

    def _read_events(self) -> list[Event]:
        """The events of the text file beside the table; logs of older versions have none."""
        path = self._path.with_suffix(".txt")
        try:
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return []
        return list(self._dated(lines))

    def _dated(self, lines: Sequence[str]) -> Iterator[Event]:
        for line in lines:
            stamp, _, text = line.partition(" ")
            try:
                yield float(stamp) - (self._start_unix_s or 0.0), text
            except ValueError:
                continue


def _lines(text: str) -> Iterator[str]:
    return (line for line in text.split("\n") if line)


def _row(cells: dict[str, str]) -> Row:
    healths = {name: _made(VehicleHealth, cells, prefix) for name, prefix in PREFIXES.items()}
    return cast("Row", _made(Row, cells, **healths))


def _made(kind: type[Any], cells: dict[str, str], prefix: str = "", **made: Any) -> Any:
    """An object of the cells named like its fields, and of `made`; None: a cell is missing."""
    values = {
        name: read(cells.get(prefix + name) or "")
        for name, read in _READERS[kind].items()
        if name not in made
    }
    return kind(**values, **made)


def _reader(hint: str) -> Callable[[str], Any]:
    if "None" in hint:
        known = _reader(hint.replace("None", ""))
        return lambda cell: known(cell) if cell else None
    if "int" in hint:
        return lambda cell: int(float(cell))
    return float if "float" in hint else str


# How to read the cells of each, by their names.
_READERS = {
    kind: {name: _reader(str(hint)) for name, hint in get_type_hints(kind).items()}
    for kind in (Row, VehicleHealth, Track)
}


# ---- vehicles' own logs -------------------------------------------------------------------------


class FlightsRecording:
    """Flights as `analyze` reads them, behind one leader, on the clock of the first flight."""

    def __init__(self, flights: Sequence[Flight], sonar: SonarBelief) -> None:
        self._sonar = sonar
        self._flights = [flight for flight in flights if len(flight.time_s)]
        if not self._flights:
            raise EchowingError("replay: the logs hold no common time")
        first = self._flights[0]
        self.title = f"replay of {first.name}"
        self.times_s: list[float] = first.time_s.tolist()
        notes = [HEIGHTS, *(text for flight in self._flights for text in flight.warnings)]
        self.events: list[Event] = [(0.0, text) for text in notes]

    def moment(self, index: int) -> Moment:
        """As `Recording`."""
        time_s = self.times_s[index]
        found = [
            (number, flight, index_at(flight.time_s.tolist(), self._on(flight, time_s)))
            for number, flight in enumerate(self._flights)
        ]
        rows = [
            _logged_row(flight, 2 + number, at, time_s, self._sonar.reach_m)
            for number, flight, at in found
        ]
        tracks = [_logged_track(flight, at) for _, flight, at in found]
        return judged(Moment(time_s, rows, tracks), self._sonar)

    def _on(self, flight: Flight, time_s: float) -> float:
        """The first flight's time on another one's clock."""
        first = self._flights[0]
        if flight.start_unix_s is None or first.start_unix_s is None:
            return time_s
        return time_s + first.start_unix_s - flight.start_unix_s


def _logged_row(flight: Flight, number: int, at: int, time_s: float, reach_m: float) -> Row:
    sonar_m = _known(flight.sonar_m[at])
    return Row(
        time_s=time_s,
        system_id=number,
        state="",
        separation_m=_known(flight.separation_m[at]),
        error_m=None,
        slot_error_m=None,
        sonar_m=None if sonar_m is None or sonar_m >= reach_m else sonar_m,
        gimbal=None,
        leader_age_s=0.0,
        age_s=0.0,
        command_mps=_known(flight.speed_command_mps[at]),
        speed_mps=math.hypot(*flight.follower_velocity_mps[at, :2].tolist()),
        leader_speed_mps=_known(math.hypot(*flight.leader_velocity_mps[at, :2].tolist())),
        link_percent=None,
        north_offset_m=0.0,
        east_offset_m=0.0,
        own=VehicleHealth(altitude_m=_known(-float(flight.follower_ned_m[at, 2]))),
    )


def _logged_track(flight: Flight, at: int) -> Track:
    leader, own, slot = (
        _on_globe(series[at].tolist())
        for series in (flight.leader_ned_m, flight.follower_ned_m, flight.slot_ned_m)
    )
    north_mps, east_mps = flight.leader_velocity_mps[at, :2].tolist()
    course_rad = math.atan2(east_mps, north_mps)
    return Track(
        wanted_radius_m=flight.wanted_separation_m,
        wanted_angle_deg=math.degrees(flight.wanted_angle_rad),
        wanted_step_m=0.0,
        leader_lat_deg=leader[0],
        leader_lon_deg=leader[1],
        leader_alt_m=leader[2],
        leader_north_mps=_known(north_mps),
        leader_east_mps=_known(east_mps),
        leader_heading_deg=_known(math.degrees(course_rad) % 360.0),
        lat_deg=own[0],
        lon_deg=own[1],
        alt_m=own[2],
        north_mps=_known(float(flight.follower_velocity_mps[at, 0])) or 0.0,
        east_mps=_known(float(flight.follower_velocity_mps[at, 1])) or 0.0,
        heading_deg=(_known(math.degrees(float(flight.follower_yaw_rad[at]))) or 0.0) % 360.0,
        slot_lat_deg=slot[0],
        slot_lon_deg=slot[1],
        point_lat_deg=None,
        point_lon_deg=None,
        yaw_deg=None,
        pan_us=_known(float(flight.pan_us[at])),
        tilt_us=_known(float(flight.tilt_us[at])),
        leader_id=1,
        leader_height_m=_known(-float(flight.leader_ned_m[at, 2])),
        wanted_height_m=_known(-float(flight.slot_ned_m[at, 2])),
    )


def _on_globe(ned_m: Sequence[float]) -> tuple[float | None, float | None, float | None]:
    if any(map(math.isnan, ned_m)):
        return None, None, None
    return displace(NOWHERE, (ned_m[0], ned_m[1], ned_m[2]))


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def index_at(times_s: Sequence[float], time_s: float) -> int:
    """The last moment that is not later than `time_s`; the first one if all are."""
    return max(0, bisect.bisect_right(times_s, time_s) - 1)
