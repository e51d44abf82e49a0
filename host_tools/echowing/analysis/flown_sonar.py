"""What a sonar has heard in a flight, from the log of `echowing follow`: for `analyze --sonar`."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from echowing.analysis.flight import Floats
from echowing.analysis.sonar_measure import Flown, Measured, Readings, flown_sonar
from echowing.analysis.vehicle_log import VehicleLog, read_vehicles
from echowing.errors import EchowingError
from echowing.flight.hearing import Reading, scatter_m
from echowing.sonar_file import FlownBy, Legs, SonarFile
from echowing.tool.log import FLOWN_BY, SONAR

# Readings at about the same place and throttle count as of one: metres, degrees, share.
STEP_M, STEP_DEG, STEP_THROTTLE = 0.5, 4.0, 0.1
# A leader whose direction is known worse tells nothing of the beam.
SURE_DEG = 8.0
# Throttles further apart in time say nothing of what lies between: a log that is cut off, or whose
# middle is damaged.
LONGEST_HOLE_S = 10.0
# Fewer say nothing.
LEAST_READINGS = 300


def flown_by(log: Path) -> FlownBy | None:
    """By which sonar file a flight was flown, as its log says; None: it does not.

    Raises EchowingError for one that says it wrongly.
    """
    found = _readings_files(log)
    if len(found) != 1:
        return None
    try:
        with found[0].open(encoding="utf-8") as file:
            told = json.loads(file.readline())
    except (OSError, ValueError):
        return None  # who reads its readings says so
    says = told.get(FLOWN_BY) if isinstance(told, dict) else None
    return FlownBy.of(says, f"{found[0]}, line 1") if isinstance(says, dict) else None


def sonar_from(
    log: Path,
    base: SonarFile,
    legs: Legs,
    autopilot: Path | None = None,
    *,
    legs_told: bool = True,
) -> Measured:
    """The sonar file of the one follower of a flight.

    autopilot: the follower's own log (.BIN), which tells its throttle. legs_told: somebody has said
    that these are the leader's. Raises EchowingError where the log has no readings, or too few.
    """
    path = _readings_of(log)
    told = list(_read(path))
    followers = {system_id for system_id, _ in told}
    if len(followers) > 1:
        raise EchowingError(
            f"{path}: is of {len(followers)} followers: fly one alone for its sonar"
        )
    readings = [one for _, one in told]
    sure = [one for one in readings if math.degrees(one.sure_rad) <= SURE_DEG]
    if len(sure) < LEAST_READINGS:
        raise EchowingError(
            f"{path}: {len(sure)} readings of a leader whose place was known, and "
            f"{LEAST_READINGS} are needed: fly longer, and nearer"
        )
    throttle = _throttle(path, followers.pop(), autopilot)
    how = Flown(legs, scatter_m(readings), throttle.why_none, legs_told=legs_told)
    measured = flown_sonar(_binned(sure, base, throttle.told), base, how)
    return replace(measured, notes=(*measured.notes, *throttle.warnings))


@dataclass(frozen=True, slots=True)
class _Throttle:
    """A follower's throttle: times on the ground's clock, and values; why there are none.

    warnings: of the logs that were read for it.
    """

    told: Floats
    why_none: str = ""
    warnings: tuple[str, ...] = ()


def _throttle(path: Path, system_id: int, autopilot: Path | None) -> _Throttle:
    """As the follower's own log tells it, else the tool's.

    The tool asks for no VFR_HUD, but its log has it where another ground station does.
    """
    log = path.with_name(path.name.removesuffix(SONAR) + ".tlog")
    try:
        own = _vehicle_in(log, system_id)
    except EchowingError as error:
        if autopilot is None:
            return _Throttle(np.empty((0, 2)), f"no log tells the throttle: {error}")
        raise EchowingError(
            f"{error}; without vehicle {system_id}'s clock the throttle in {autopilot} has no time"
        ) from None
    told = own if autopilot is None else _autopilots(autopilot, system_id)
    told.shift(own.to_ground_s)
    throttle = told.throttle.array()
    if autopilot is not None and not len(throttle):
        raise EchowingError(f"{autopilot}: tells no throttle (CTUN; LOG_BITMASK bit 4)")
    why = "" if len(throttle) else f"{log} has no VFR_HUD; give the follower's .BIN, too"
    return _Throttle(throttle, why, tuple(dict.fromkeys((*own.warnings, *told.warnings))))


def _vehicle_in(log: Path, system_id: int) -> VehicleLog:
    """A vehicle of a log; EchowingError where it is not there, and whether damage may be why."""
    vehicles = read_vehicles(log)
    own = next((one for one in vehicles if one.system_id == system_id), None)
    if own is None:
        damage = {text for one in vehicles for text in one.warnings if text.startswith(str(log))}
        lacks = f"log {log}: no track of vehicle {system_id}"
        raise EchowingError("; ".join((lacks, *sorted(damage))))
    return own


def _autopilots(path: Path, system_id: int) -> VehicleLog:
    (log,) = read_vehicles(path)[:1]
    if log.system_id not in (0, system_id):
        raise EchowingError(f"{path}: is of vehicle {log.system_id}, the readings of {system_id}")
    return log


def _readings_of(log: Path) -> Path:
    """The file of the readings: named itself, beside a table of follow's, or in its folder."""
    found = _readings_files(log)
    if len(found) != 1:
        raise EchowingError(
            f"{log}: {len(found)} files *{SONAR}: give one, as `echowing follow --log` writes it"
        )
    return found[0]


def _readings_files(log: Path) -> list[Path]:
    if log.name.endswith(SONAR):
        return [log]
    places = log.glob(f"*{SONAR}") if log.is_dir() else [log.with_name(log.stem + SONAR)]
    return [path for path in sorted(places) if path.exists()]


def _read(path: Path) -> Iterator[tuple[int, Reading]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise EchowingError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        try:
            told = json.loads(line)
            if number > 1 or FLOWN_BY not in told:
                yield _reading(told)
        except (ValueError, KeyError, TypeError) as error:
            if number == len(lines):  # cut off as the tool was killed
                return
            raise EchowingError(f"{path}, line {number}: is no reading: {error}") from error


def _reading(table: Any) -> tuple[int, Reading]:
    range_m = table["range_m"]
    return int(table["system_id"]), Reading(
        float(table["unix_time_s"]),
        None if range_m is None else float(range_m),
        float(table["expected_m"]),
        math.radians(float(table["off_deg"])),
        math.radians(float(table["sure_deg"])),
    )


def _binned(readings: list[Reading], base: SonarFile, throttle: Floats) -> list[Readings]:
    """Readings of the same place and throttle, each moved to where its place's middle is."""
    inset_m = sum(base.inset_m) / 2.0
    places: dict[tuple[float, float, float], Readings] = {}
    for one, thrust in zip(readings, _at(readings, throttle), strict=True):
        range_m = STEP_M * max(1, round(one.expected_m / STEP_M))
        off_deg = STEP_DEG * round(math.degrees(one.off_rad) / STEP_DEG)
        place = places.setdefault(
            (range_m, off_deg, thrust), Readings(range_m + inset_m, off_deg, thrust, [[]], inset_m)
        )
        moved_m = None if one.range_m is None else one.range_m - one.expected_m + range_m
        place.runs[0].append(moved_m)
    return list(places.values())


def _at(readings: list[Reading], throttle: Floats) -> list[float]:
    """The throttle at each reading, in steps; NaN, one and the same, where nobody tells it."""
    if not len(throttle):
        return [math.nan] * len(readings)
    told_s, wanted_s = throttle[:, 0], np.array([one.time_s for one in readings])
    after = np.searchsorted(told_s, wanted_s)
    edges_s = np.concatenate(([-math.inf], told_s, [math.inf]))
    near = edges_s[after + 1] - edges_s[after] <= LONGEST_HOLE_S
    steps = np.round(np.interp(wanted_s, told_s, throttle[:, 1]) / STEP_THROTTLE)
    return [
        round(STEP_THROTTLE * float(step), 3) if known else math.nan
        for step, known in zip(steps, near, strict=True)
    ]
