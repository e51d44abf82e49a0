"""Flights from the CSV that `echowing follow --log` writes: all on the ground computer's clock."""

import csv
import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray

from echowing.analysis.flight import SHIPPED_INSET_M, Flight, Floats
from echowing.analysis.slots import slot_offsets
from echowing.errors import EchowingError
from echowing.flight.guidance import Slot
from echowing.paths import SHIPPED_SONAR

SHORTEST_ROWS = 10  # a second at 10 Hz; less is no flight
ROWS_HZ = 10.0
FOLLOWING, GIVES_WAY, RADIUS = "following", "gives way", "wanted_radius_m"
DEEDS = {"holding": "holding", "pilot has control": "flown by its pilot"}
NUMBERS = (
    *("unix_time_s", "age_s", "sonar_m", "command_mps", RADIUS, "wanted_angle_deg"),
    *("wanted_step_m", "leader_lat_deg", "leader_lon_deg", "leader_alt_m", "leader_north_mps"),
    *("leader_east_mps", "leader_heading_deg", "lat_deg", "lon_deg", "alt_m", "north_mps"),
    *("east_mps", "heading_deg", "pan_us", "tilt_us"),
)
# Not in the tables of former versions.
OFFSETS, INSET, WATCHES = ("north_offset_m", "east_offset_m"), "sonar_inset_m", "watches"
WORDS = ("system_id", "state", "gimbal")

Row = Mapping[str, str | None]


def read_table(path: Path, slot: Slot | None = None) -> list[Flight]:
    """One flight a follower in the table. slot: where it should have been, else as it was told.

    The flight's leader is whom the follower's sonar watches. Positions are by the vehicles'
    receivers, as in their own logs: each carried on over the age of its report. Raises
    EchowingError for a file that cannot be read, or is no such table.
    """
    rows, warnings = _rows(path)
    by_system: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_system[str(row["system_id"])].append(row)
    return [
        _flight(
            path,
            _label(path, system, len(by_system)),
            own,
            by_system.get(str(own[-1].get(WATCHES))),
            slot,
            warnings,
        )
        for system, own in by_system.items()
    ]


def _label(path: Path, system: str, systems: int) -> str:
    return path.name if systems == 1 else f"{path.name}, system {system}"


def _rows(path: Path) -> tuple[list[Row], list[str]]:
    """The whole rows of the table; a last one that was cut off is left out."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows: list[Row] = list(reader)
            missing = [name for name in (*NUMBERS, *WORDS) if name not in (reader.fieldnames or ())]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise EchowingError(f"log {path}: cannot be read: {error}") from error
    if missing:
        raise EchowingError(
            f"log {path}: not a table of echowing follow --log: no column {missing[0]}"
        )
    whole = [row for row in rows if None not in row and None not in row.values()]
    if not whole:
        raise EchowingError(f"log {path}: holds no rows; did the vehicle ever report?")
    cut = len(rows) - len(whole)
    return whole, [f"{path}: damaged or cut off; the readable part is used"] if cut else []


def _flight(
    path: Path,
    label: str,
    rows: Sequence[Row],
    ahead: Sequence[Row] | None,
    slot: Slot | None,
    notes: list[str],
) -> Flight:
    """Of one follower. ahead: the rows of the follower that its sonar watches; None: the leader."""
    flown, warnings = _flown(label, rows)
    number = {name: _numbers(path, flown, name) for name in (*NUMBERS, *OFFSETS, INSET)}
    time_s = number["unix_time_s"]
    origin = _origin(label, number)
    wanted = slot or Slot(
        float(number[RADIUS][0]),
        math.radians(number["wanted_angle_deg"][0]),
        float(number["wanted_step_m"][0]),
    )
    if wanted.radius_m <= 0.0:
        raise EchowingError(f"log {label}: of a relay, which has no place behind a leader")
    follower_m, velocity = _carried_on(number, origin)
    leader_m = _ned(number, "leader_", origin)
    leader_velocity = _columns(number, "leader_north_mps", "leader_east_mps")
    if ahead is not None:
        there = {name: _numbers(path, ahead, name) for name in NUMBERS}
        leader_m, leader_velocity = (
            _at_times(time_s, there["unix_time_s"], one) for one in _carried_on(there, origin)
        )
    heading = np.radians(number["leader_heading_deg"])
    counted, left_out = _counted(flown)
    inset_m, no_inset = _inset_m(number)
    return Flight(
        name=label,
        wanted_separation_m=math.hypot(wanted.radius_m, wanted.altitude_step_m),
        wanted_angle_rad=wanted.angle_rad,
        time_s=time_s - time_s[0],
        leader_ned_m=leader_m,
        leader_velocity_mps=leader_velocity,
        follower_ned_m=follower_m,
        follower_velocity_mps=velocity,
        follower_yaw_rad=_wrapped(np.radians(number["heading_deg"])),
        slot_ned_m=leader_m + slot_offsets(wanted, leader_velocity, heading),
        sonar_m=number["sonar_m"],
        sonar_inset_m=inset_m,
        speed_command_mps=number["command_mps"],
        pan_us=number["pan_us"],
        tilt_us=number["tilt_us"],
        source="logs",
        sonar_known=any(row["sonar_m"] or row["gimbal"] for row in rows),
        start_unix_s=float(time_s[0]),
        warnings=(*notes, *warnings, *no_inset),
        estimated_m=_estimated_m(number, leader_m, follower_m),
        counted=counted,
        left_out=left_out,
    )


def _inset_m(number: Mapping[str, Floats]) -> tuple[float, list[str]]:
    """The sonar's inset, and what to know of it: tables of former versions do not tell it."""
    told_m = float(number[INSET][0])
    if math.isfinite(told_m):
        return told_m, []
    assumed = f"the sonar's inset is not told; {SHIPPED_INSET_M:g} m is taken, as {SHIPPED_SONAR}'s"
    return SHIPPED_INSET_M, [assumed] if np.isfinite(number["sonar_m"]).any() else []


def _carried_on(
    number: Mapping[str, Floats], origin: tuple[float, float, float]
) -> tuple[Floats, Floats]:
    """A follower's place, carried on over the age of its report, and its velocity, (n, 3)."""
    velocity = _columns(number, "north_mps", "east_mps")
    return _ned(number, "", origin) + velocity * number["age_s"][:, np.newaxis], velocity


def _at_times(time_s: Floats, known_s: Floats, known: Floats) -> Floats:
    return np.column_stack([np.interp(time_s, known_s, column) for column in known.T])


def _flown(label: str, rows: Sequence[Row]) -> tuple[Sequence[Row], list[str]]:
    """From the first to the last moment at which it was led; what to know of them."""
    led = [index for index, row in enumerate(rows) if str(row["state"]).startswith(FOLLOWING)]
    if not led:
        return rows, ["never followed; all of the log is used"]
    flown, notes = _at_one_radius(rows[led[0] : led[-1] + 1])
    if len(flown) < SHORTEST_ROWS:
        raise EchowingError(f"log {label}: followed for less than a second")
    return flown, notes


def _counted(rows: Sequence[Row]) -> tuple[NDArray[np.bool_] | None, tuple[str, ...]]:
    """When it was led to its slot, and what it did else, with the seconds of each."""
    following = np.array([str(row["state"]).startswith(FOLLOWING) for row in rows])
    if not following.any():
        return None, ()
    others = Counter(
        _deed(str(row["state"])) for row, led in zip(rows, following, strict=True) if not led
    )
    return following, tuple(f"{count / ROWS_HZ:.0f} s {deed}" for deed, count in others.items())


def _deed(state: str) -> str:
    """What a follower did that was not led to its slot (`panel.state_of`)."""
    word = state.partition(": ")[0]
    if word.startswith(GIVES_WAY):
        return "giving way"
    return DEEDS.get(word, f"in the state `{word}`")


def _estimated_m(
    number: Mapping[str, Floats], leader_m: Floats, follower_m: Floats
) -> Floats | None:
    """The separation with the leader where the tool took it to be; None: it never learnt where."""
    offset_m = np.nan_to_num(_columns(number, *OFFSETS))
    if not offset_m.any():
        return None
    return np.asarray(np.linalg.norm(follower_m - (leader_m - offset_m), axis=1))


def _at_one_radius(rows: Sequence[Row]) -> tuple[Sequence[Row], list[str]]:
    """The longest time without a change of the radius (`follow --build-up`), and a word of it."""
    runs = [(radius, list(run)) for radius, run in groupby(rows, itemgetter(RADIUS))]
    radius, longest = max(runs, key=lambda one: len(one[1]))
    if len(runs) == 1:
        return rows, []
    note = f"the radius was changed in flight; the {len(longest) / 10:.0f} s at {radius} m are used"
    return longest, [note]


def _numbers(path: Path, rows: Sequence[Row], name: str) -> Floats:
    try:
        return np.array([float(row.get(name) or math.nan) for row in rows])
    except ValueError as error:
        raise EchowingError(f"log {path}: column {name}: {error}") from error


def _columns(number: Mapping[str, Floats], north: str, east: str) -> Floats:
    """(n, 3); no vertical speed is logged."""
    return np.column_stack([number[north], number[east], np.zeros(len(number[north]))])


def _origin(label: str, number: Mapping[str, Floats]) -> tuple[float, float, float]:
    """The leader's first known place."""
    known = np.flatnonzero(np.isfinite(number["leader_lat_deg"]))
    if len(known) == 0:
        raise EchowingError(f"log {label}: the leader never reported; there is nothing to measure")
    names = ("leader_lat_deg", "leader_lon_deg", "leader_alt_m")
    lat, lon, alt = (float(number[name][known[0]]) for name in names)
    return lat, lon, alt


def _ned(number: Mapping[str, Floats], who: str, origin: tuple[float, float, float]) -> Floats:
    names = (f"{who}lat_deg", f"{who}lon_deg", f"{who}alt_m")
    return np.column_stack(pymap3d.geodetic2ned(*(number[name] for name in names), *origin))


def _wrapped(angle_rad: Floats) -> Floats:
    return np.asarray(np.mod(angle_rad + math.pi, 2.0 * math.pi) - math.pi)
