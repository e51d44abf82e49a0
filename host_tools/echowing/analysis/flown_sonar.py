"""What a sonar has heard in a flight, from the log of `echowing follow`: for `analyze --sonar`."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from echowing.analysis.sonar_measure import Measured, Readings, flown_sonar
from echowing.errors import EchowingError
from echowing.flight.hearing import Reading, scatter_m
from echowing.sonar_file import Legs, SonarFile
from echowing.tool.log import SONAR

# Readings at about the same place count as of one: metres and degrees.
STEP_M, STEP_DEG = 0.5, 4.0
# A leader whose direction is known worse tells nothing of the beam.
SURE_DEG = 8.0
# Fewer say nothing.
LEAST_READINGS = 300


def sonar_from(log: Path, base: SonarFile, legs: Legs) -> Measured:
    """The sonar file of the one follower of a flight.

    Raises EchowingError where the log has no readings, or too few.
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
    return flown_sonar(_binned(sure, base), base, legs, scatter_m(readings))


def _readings_of(log: Path) -> Path:
    """The file of the readings: named itself, beside a table of follow's, or in its folder."""
    if log.name.endswith(SONAR):
        return log
    places = log.glob(f"*{SONAR}") if log.is_dir() else [log.with_name(log.stem + SONAR)]
    found = [path for path in sorted(places) if path.exists()]
    if len(found) != 1:
        raise EchowingError(
            f"{log}: {len(found)} files *{SONAR}: give one, as `echowing follow --log` writes it"
        )
    return found[0]


def _read(path: Path) -> Iterator[tuple[int, Reading]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise EchowingError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        try:
            yield _reading(json.loads(line))
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


def _binned(readings: list[Reading], base: SonarFile) -> list[Readings]:
    """Readings of the same place, each moved to where its place's middle is."""
    inset_m = sum(base.inset_m) / 2.0
    places: dict[tuple[float, float], Readings] = {}
    for one in readings:
        range_m = STEP_M * max(1, round(one.expected_m / STEP_M))
        off_deg = STEP_DEG * round(math.degrees(one.off_rad) / STEP_DEG)
        place = places.setdefault(
            (range_m, off_deg), Readings(range_m + inset_m, off_deg, 0.0, [[]], inset_m)
        )
        moved_m = None if one.range_m is None else one.range_m - one.expected_m + range_m
        place.runs[0].append(moved_m)
    return list(places.values())
