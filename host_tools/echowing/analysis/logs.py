"""Flights from real logs: the recordings of leader and followers, set on one clock.

Positions are what the vehicles' estimators logged, so both receivers' errors are in them: a
separation of 3 m by logs may be 2 m or 4 m in truth. `compare_with_truth` says by how much where
somebody knows better.
"""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Flight, Floats
from echowing.analysis.follow_table import read_table
from echowing.analysis.metrics import APPROACHED_M
from echowing.analysis.slots import slot_offsets
from echowing.analysis.vehicle_log import Series, VehicleLog, read_vehicles
from echowing.errors import EchowingError
from echowing.flight.guidance import Slot

TABLE, LOGS = ".csv", (".tlog", ".bin")
CLOCK_HZ = 10.0
SHORTEST_S = 1.0  # less in common is no flight
LONGEST_GAP_S = 1.0  # positions further apart in time are not joined by a line
SONAR_FRESH_S = 0.5  # ArduPilot's own limit for a MAVLink rangefinder
GIMBAL_FRESH_S = 2.0  # the co-processor reports its gimbal about once per second
SAME_TRACK_M = 0.3  # two copters cannot be nearer than this on average; one recorded twice is
DEFAULT_SLOT = Slot(3.0)  # the thesis's formation


def read_flights(
    paths: Sequence[Path],
    *,
    leader: Path | int | None = None,
    slot: Slot | None = None,
) -> list[Flight]:
    """One flight a follower, from the logs of a leader and its followers.

    paths: .tlog and .BIN in any mix, one a vehicle (a .tlog may hold several); tables of `echowing
    follow --log`, which hold all of a flight; folders of either. leader: its file or its system
    id; without, it is the one that has no forward rangefinder, or is not in Guided. slot: where the
    followers should have been; without, as the table says, or the thesis's. Raises EchowingError
    when no pair can be made; what could only be guessed is in `Flight.warnings`.
    """
    files = [file for path in paths for file in _files(path)]
    tables = [file for file in files if file.suffix.lower() == TABLE]
    logs = [file for file in files if file not in tables]
    flights = [flight for table in tables for flight in read_table(table, slot)]
    if logs or not tables:
        flights += _paired(logs, leader, slot or DEFAULT_SLOT)
    return flights


def _files(path: Path) -> list[Path]:
    """The logs meant by a path: of a folder its tables, or all logs where it has none."""
    if not path.is_dir():
        return [path]
    inside = sorted(path.iterdir())
    tables = [file for file in inside if file.name.startswith("follow-") and file.suffix == TABLE]
    logs = tables or [file for file in inside if file.suffix.lower() in LOGS]
    if not logs:
        raise EchowingError(f"log {path}: a folder without follow-*.csv, .tlog or .BIN files")
    return logs


def _paired(paths: Sequence[Path], leader: Path | int | None, slot: Slot) -> list[Flight]:
    vehicles = [vehicle for path in paths for vehicle in read_vehicles(path)]
    if len(vehicles) < 2:
        raise EchowingError(
            "analysis: a flight needs a leader and a follower; give the log of each "
            f"(found {len(vehicles)} vehicle in {len(paths)} file)"
        )
    ahead = _leader(vehicles, leader)
    warnings = _one_clock(vehicles)
    followers = [vehicle for vehicle in vehicles if vehicle is not ahead]
    return [_flight(ahead, follower, slot, warnings) for follower in followers]


@dataclass(frozen=True)
class TruthComparison:
    """How far a flight by logs is from the truth.

    bias_m: mean of logged minus true separation; rms_m: root mean square of it; samples of the
    truth compared; truth_mean_m, log_mean_m: mean separations over them. clock_shift_s: what was
    added to the truth's times: its clock need not be the vehicles' (see compare_with_truth).
    """

    bias_m: float
    rms_m: float
    samples: int
    truth_mean_m: float
    log_mean_m: float
    clock_shift_s: float


def compare_with_truth(
    flight: Flight, path: Path, *, match_clocks: bool = False
) -> TruthComparison:
    """Separation by the flight against `truth.csv` (columns unix_time_s, separation_m).

    match_clocks: first shift the truth's times by up to 2 s so that the follower's speed fits
    best; for a truth stamped by another clock than the vehicles'. Raises EchowingError for a file
    without those columns or without common time.
    """
    if flight.start_unix_s is None:
        raise EchowingError(
            f"flight {flight.name!r} has no date, so the truth cannot be matched with it"
        )
    truth = _read_columns(path, ("unix_time_s", "separation_m", "follower_speed_mps"))
    time_s = truth[:, 0] - flight.start_unix_s
    shift_s = _clock_shift_s(flight, time_s, truth[:, 2]) if match_clocks else 0.0
    logged_m = np.interp(
        time_s + shift_s, flight.time_s, flight.separation_m, left=math.nan, right=math.nan
    )
    known = np.isfinite(logged_m) & np.isfinite(truth[:, 1])
    if not known.any():
        raise EchowingError(f"truth {path} and flight {flight.name!r} have no time in common")
    error_m = (logged_m - truth[:, 1])[known]
    return TruthComparison(
        bias_m=float(error_m.mean()),
        rms_m=float(np.sqrt(np.mean(error_m**2))),
        samples=int(known.sum()),
        truth_mean_m=float(truth[known, 1].mean()),
        log_mean_m=float(logged_m[known].mean()),
        clock_shift_s=shift_s,
    )


def truth_separation(flight: Flight, path: Path, shift_s: float, settle_s: float) -> Floats:
    """True separations, metres, (k,), while the flight was measured, `settle_s` left out.

    shift_s: what is added to the truth's times (`TruthComparison.clock_shift_s`).
    """
    truth = _read_columns(path, ("unix_time_s", "separation_m"))
    time_s = truth[:, 0] - (flight.start_unix_s or 0.0) + shift_s
    begin_s, end_s = flight.time_s[0] + settle_s, flight.time_s[-1]
    inside = (time_s >= begin_s) & (time_s <= end_s) & np.isfinite(truth[:, 1])
    if flight.counted is not None:
        inside &= flight.counted[
            np.searchsorted(flight.time_s, time_s).clip(0, len(flight.time_s) - 1)
        ]
    return np.asarray(truth[inside, 1])


def truth_approach_s(flight: Flight, path: Path, shift_s: float) -> float | None:
    """`approach_s` by the truth's own column slot_error_m; None: it has none, or never came near.

    From the flight's beginning, which may be after the truth's.
    """
    try:
        truth = _read_columns(path, ("unix_time_s", "slot_error_m"))
    except EchowingError:
        return None
    time_s = truth[:, 0] - (flight.start_unix_s or 0.0) + shift_s - flight.time_s[0]
    near = time_s[truth[:, 1] <= APPROACHED_M]
    return max(0.0, float(near[0])) if len(near) else None


def _clock_shift_s(flight: Flight, time_s: Floats, speed_mps: Floats) -> float:
    """The shift of the truth's clock at which the follower's speeds agree best."""
    logged_mps = np.hypot(*flight.follower_velocity_mps[:, :2].T)

    def misfit(shift_s: float) -> float:
        there = np.interp(
            time_s + shift_s, flight.time_s, logged_mps, left=math.nan, right=math.nan
        )
        known = np.isfinite(there)
        return float(np.mean((there - speed_mps)[known] ** 2)) if known.any() else math.inf

    return min((float(s) for s in np.arange(-2.0, 2.001, 0.02)), key=misfit)


def _read_columns(path: Path, names: Sequence[str]) -> Floats:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return np.array([[float(row[name]) for name in names] for row in rows]).reshape(
            -1, len(names)
        )
    except OSError as error:
        raise EchowingError(f"truth {path}: cannot be read: {error.strerror}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise EchowingError(
            f"truth {path}: needs the columns {', '.join(names)} with numbers ({error})"
        ) from error


def _leader(vehicles: Sequence[VehicleLog], stated: Path | int | None) -> VehicleLog:
    if stated is not None:
        chosen = [v for v in vehicles if stated in (v.path, v.system_id)]
        if len(chosen) != 1:
            raise EchowingError(f"leader {stated}: not one of {_listed(vehicles)}")
        return chosen[0]
    for follows in (_has_sonar, _is_guided):
        leaders = [vehicle for vehicle in vehicles if not follows(vehicle)]
        if len(leaders) == 1:
            return leaders[0]
    if len({vehicle.system_id for vehicle in vehicles}) == 1:
        raise EchowingError(
            f"all of {_listed(vehicles)} are of one system id: give the logs of two vehicles, or, "
            "if two vehicles share the id, say which file is the leader's"
        )
    raise EchowingError(
        f"the logs do not show which of {_listed(vehicles)} led: exactly one of them must "
        "have no forward rangefinder, or not fly in Guided; name the leader with --leader"
    )


def _has_sonar(vehicle: VehicleLog) -> bool:
    return bool(vehicle.sonar)


def _is_guided(vehicle: VehicleLog) -> bool:
    """Whether it spent most of the recording in Guided (a leader may take off in it)."""
    modes, end_s = vehicle.guided.array(), vehicle.position.array()[-1, 0]
    if len(modes) == 0:
        return False
    held_s = np.diff(modes[:, 0], append=max(end_s, modes[-1, 0]))
    return bool(held_s[modes[:, 1] > 0.0].sum() > 0.5 * held_s.sum())


def _listed(vehicles: Iterable[VehicleLog]) -> str:
    return ", ".join(vehicle.label for vehicle in vehicles)


def _one_clock(vehicles: Sequence[VehicleLog]) -> list[str]:
    """Set all on GPS time, or all on the ground computer's where one has no GPS time."""
    if all(vehicle.clock == "gps" for vehicle in vehicles):
        return []
    for vehicle in vehicles:
        if vehicle.clock == "gps" and math.isfinite(vehicle.to_ground_s):
            vehicle.shift(vehicle.to_ground_s)
    return [
        f"no GPS time in {_listed(timeless)}: {_GROUND_CLOCKS[clock]} is in the separation"
        for clock in _GROUND_CLOCKS
        if (timeless := [vehicle for vehicle in vehicles if vehicle.clock == clock])
    ]


_GROUND_CLOCKS = {
    "ground": "aligned by TIMESYNC; half of the difference between the radio's delays in the "
    "two directions",
    "receive": "aligned by the times of reception; a difference in radio delay",
}


def _flight(leader: VehicleLog, follower: VehicleLog, slot: Slot, warnings: list[str]) -> Flight:
    start_s, end_s, notes = _common_time(leader, follower)
    time_s = start_s + np.arange(0.0, end_s - start_s, 1.0 / CLOCK_HZ)
    origin = leader.position.array()[0, 1:4]
    leader_m = _ned(leader, time_s, origin)
    follower_m = _ned(follower, time_s, origin)
    apart_m = float(np.nanmean(np.linalg.norm(follower_m - leader_m, axis=1)))
    if apart_m < SAME_TRACK_M:
        raise EchowingError(
            f"{leader.label} and {follower.label} hold the same track (mean distance "
            f"{apart_m:.2f} m): give the logs of two different vehicles"
        )
    velocity = _joined(leader.velocity, time_s, 3)
    counted, left_out = _in_guided(follower, time_s)
    names = [leader.path.name, follower.path.name]
    return Flight(
        name=" + ".join(dict.fromkeys(names)),
        wanted_separation_m=math.hypot(slot.radius_m, slot.altitude_step_m),
        wanted_angle_rad=slot.angle_rad,
        time_s=time_s - start_s,
        leader_ned_m=leader_m,
        leader_velocity_mps=velocity,
        follower_ned_m=follower_m,
        follower_velocity_mps=_joined(follower.velocity, time_s, 3),
        follower_yaw_rad=_yaw(follower, time_s),
        slot_ned_m=leader_m + slot_offsets(slot, velocity, _yaw(leader, time_s)),
        sonar_m=_held(follower.sonar, time_s, SONAR_FRESH_S),
        speed_command_mps=_held(follower.speed_command, time_s, math.inf),
        pan_us=_held(follower.pan, time_s, GIMBAL_FRESH_S),
        tilt_us=_held(follower.tilt, time_s, GIMBAL_FRESH_S),
        source="logs",
        sonar_known=bool(follower.sonar),
        sonar_inset_m=follower.sonar_inset_m,
        start_unix_s=start_s,
        warnings=(*warnings, *leader.warnings, *follower.warnings, *notes),
        counted=counted,
        left_out=left_out,
    )


def _common_time(leader: VehicleLog, follower: VehicleLog) -> tuple[float, float, list[str]]:
    """When both were recorded and the follower was in Guided; UTC seconds."""
    spans = [vehicle.position.array()[[0, -1], 0] for vehicle in (leader, follower)]
    start_s, end_s = max(span[0] for span in spans), min(span[1] for span in spans)
    if end_s - start_s < SHORTEST_S:
        told = "; ".join(
            f"{vehicle.label} {_clock(span[0])} to {_clock(span[1])}"
            for vehicle, span in zip((leader, follower), spans, strict=True)
        )
        raise EchowingError(f"the logs do not overlap in time: {told} UTC; give logs of one flight")
    guided = _guided_span(follower, start_s, end_s)
    if guided is None:
        return start_s, end_s, [f"{follower.label}: never in Guided; all of the log is used"]
    return *guided, _short_of(start_s, end_s, guided)


def _guided_span(follower: VehicleLog, start_s: float, end_s: float) -> tuple[float, float] | None:
    modes = follower.guided.array()
    on = np.flatnonzero(modes[:, 1] > 0.0) if len(modes) else np.array([], dtype=int)
    if len(on) == 0:
        return None
    after = modes[on[-1] + 1, 0] if on[-1] + 1 < len(modes) else end_s
    first, last = max(start_s, float(modes[on[0], 0])), min(end_s, float(after))
    return (first, last) if last - first >= SHORTEST_S else None


def _in_guided(
    follower: VehicleLog, time_s: Floats
) -> tuple[NDArray[np.bool_] | None, tuple[str, ...]]:
    """When the follower was in Guided, and what lies between; all where it never was."""
    guided = _held(follower.guided, time_s, math.inf) > 0.0
    if not guided.any() or guided.all():
        return None, ()
    left_s = float((~guided).sum()) / CLOCK_HZ
    return guided, (f"{left_s:.0f} s not in Guided",)


def _short_of(start_s: float, end_s: float, guided: tuple[float, float]) -> list[str]:
    left_s = (end_s - start_s) - (guided[1] - guided[0])
    if left_s < 2.0:  # heartbeats come once per second: no more can be told from them
        return []
    return [f"{left_s:.0f} s in which the follower was not in Guided are left out"]


def _clock(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _ned(vehicle: VehicleLog, time_s: Floats, origin: Floats) -> Floats:
    import pymap3d  # noqa: PLC0415 (only here)

    fixes = vehicle.position.array()
    ned = np.column_stack(pymap3d.geodetic2ned(*fixes[:, 1:4].T, *origin))
    return _interpolated(fixes[:, 0], ned, time_s)


def _joined(series: Series, time_s: Floats, columns: int) -> Floats:
    rows = series.array()
    if len(rows) == 0:
        return np.full((len(time_s), columns), math.nan)
    return _interpolated(rows[:, 0], rows[:, 1:], time_s)


def _interpolated(times: Floats, values: Floats, wanted: Floats) -> Floats:
    """Linear between neighbours, NaN outside and across gaps; values (n, k)."""
    result = np.column_stack(
        [np.interp(wanted, times, column, left=math.nan, right=math.nan) for column in values.T]
    )
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    if len(times) > 1:
        result[times[after] - times[after - 1] > LONGEST_GAP_S] = math.nan
    return result


def _yaw(vehicle: VehicleLog, time_s: Floats) -> Floats:
    rows = vehicle.yaw.array()
    if len(rows) == 0:
        return np.full(len(time_s), math.nan)
    turned = _interpolated(rows[:, 0], np.unwrap(rows[:, 1])[:, np.newaxis], time_s)[:, 0]
    return np.asarray(np.mod(turned + math.pi, 2.0 * math.pi) - math.pi)


def _held(series: Series, time_s: Floats, fresh_s: float) -> Floats:
    """The newest value at each time, NaN before the first and when older than `fresh_s`."""
    rows = series.array()
    if len(rows) == 0:
        return np.full(len(time_s), math.nan)
    newest = np.searchsorted(rows[:, 0], time_s, side="right") - 1
    values = rows[np.maximum(newest, 0), 1]
    stale = (newest < 0) | (time_s - rows[np.maximum(newest, 0), 0] > fresh_s)
    return np.where(stale, math.nan, values)
