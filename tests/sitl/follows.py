"""How much later an autopilot's estimate follows its receiver and its barometer.

    python -m tests.sitl.follows LOG.BIN…

The log of an autopilot in SITL has the truth, too (SIM). What its receiver and its barometer err by
(GPS, BARO) is passed through a filter of the first order, whose time constant is fitted to what the
estimate errs by (POS): 0.63 of a step are followed in that time, as by the built-in simulator's
filters (`echowing.sim.world.gps`). Its velocity (XKF1) is compared with the true one (SIM2), and
where its place moves otherwise than that with how its error changes (`echowing.flight.drift`); how
far and how quickly the rest wanders is fitted over all logs.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from numpy.typing import NDArray
from pymavlink import DFReader
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter, lfiltic

from echowing.flight.alignment import Report
from echowing.flight.drift import Drift
from echowing.flight.receivers import FORGETS_S
from echowing.geo import GlobalPosition, displace

Floats = NDArray[np.float64]
FIELDS = {
    "SIM": ("Lat", "Lng", "Alt"),
    "POS": ("Lat", "Lng", "Alt"),
    "GPS": ("Lat", "Lng", "Alt"),
    "BARO": ("Alt",),
    "SIM2": ("VN", "VE"),
    "XKF1": ("VN", "VE"),
}
STEP_S = 0.1
# On the ground, and while a filter that begins at rest settles.
LEFT_OUT_S, SETTLES_S = 40.0, 20.0
LEAST_S = LEFT_OUT_S + 3.0 * SETTLES_S
# SITL's receiver tells where it was a tenth of a second ago (SIM_GPS1_LAG_MS 100).
RECEIVER_LATE_S = 0.1
LONGEST_S = 10.0
CHANGES_S = 3.0
REST_CHANGES_S = 20.0


@dataclass(frozen=True, slots=True)
class Follows:
    """How much later one axis follows, and what the fit leaves of its error (metres)."""

    axis: str
    later_s: float
    left_m: float
    of_m: float
    """Standard deviation of the estimate's error."""


def fitted(axis: str, told_m: Floats, believed_m: Floats) -> Follows:
    """The filter that makes of a sensor's error the estimate's: both every `STEP_S`, (n,)."""

    def left_m(later_s: float) -> float:
        keep = math.exp(-STEP_S / later_s)
        begins = lfiltic([1.0 - keep], [1.0, -keep], [told_m[0]])
        filtered, _ = lfilter([1.0 - keep], [1.0, -keep], told_m, zi=begins)
        return float(np.std((believed_m - filtered)[round(SETTLES_S / STEP_S) :]))

    found = minimize_scalar(left_m, bounds=(STEP_S / 2.0, LONGEST_S), method="bounded")
    return Follows(axis, float(found.x), float(found.fun), float(np.std(believed_m)))


def follows(log: Path) -> list[Follows]:
    """North and east behind the receiver, height behind the barometer.

    Raises:
        ValueError: too short a flight for that.

    """
    told = _read(log)
    logged_s = np.ptp(told["POS"][:, 0])
    if logged_s < LEAST_S:
        raise ValueError(f"{logged_s:.0f} s logged, {LEAST_S:.0f} s are needed for a fit")
    origin = told["SIM"][0, 1:]
    sim, pos, gps = (_ned_m(told[name], origin) for name in ("SIM", "POS", "GPS"))
    times_s = np.arange(pos[0, 0] + LEFT_OUT_S, pos[-1, 0], STEP_S)

    def errs_m(track: Floats, axis: int, late_s: float = 0.0) -> Floats:
        true_m = np.interp(track[:, 0] - late_s, sim[:, 0], sim[:, axis])
        return np.interp(times_s, track[:, 0], track[:, axis] - true_m)

    level = [
        fitted(name, errs_m(gps, axis, RECEIVER_LATE_S), errs_m(pos, axis))
        for axis, name in enumerate(("north", "east"), start=1)
    ]
    barometer = told["BARO"]
    down = np.column_stack([barometer[:, :1], np.zeros((len(barometer), 2)), -barometer[:, 1:]])
    return [*level, fitted("height", errs_m(down, 3), errs_m(pos, 3))]


def velocity_tells(log: Path) -> list[tuple[str, float, float]]:
    """What of a change of the error within 3 s its own velocity tells: by axis.

    The slope of what is told over what is true, and their correlation.
    """
    errors_m, told_m = _errors_told_m(log)
    later = round(CHANGES_S / STEP_S)
    found = []
    for name, error_m, each_m in zip(("north", "east"), errors_m, told_m, strict=True):
        so_far_m = np.cumsum(each_m)
        true_m, seen_m = (one[later:] - one[:-later] for one in (error_m, so_far_m))
        slope, correlation = np.polyfit(true_m, seen_m, 1)[0], np.corrcoef(true_m, seen_m)[0, 1]
        found.append((name, float(slope), float(correlation)))
    return found


def velocity_leaves(logs: Sequence[Path]) -> tuple[float, float, float]:
    """What of the errors is left if what the core takes for drift is taken off.

    The share of how far they wander (standard deviation), that of how far they move within 20 s,
    and how quickly what does so is forgotten (correlation time, seconds) where they are in 60 s.

    Raises:
        ValueError: no logs.

    """
    if not logs:
        raise ValueError("give the logs of a flight or more")
    wanders_m2, moves_m2 = np.zeros(2), np.zeros(2)
    later = round(REST_CHANGES_S / STEP_S)
    for log in logs:
        for error_m, told_m in zip(_errors_told_m(log)[0], drifted_m(log), strict=True):
            both_m = np.stack((error_m, error_m - told_m))
            wanders_m2 += np.sum(both_m**2, axis=1)
            moves_m2 += np.sum((both_m[:, later:] - both_m[:, :-later]) ** 2, axis=1)
    wanders, moves = (float(rest / of) for of, rest in (wanders_m2, moves_m2))
    moved = -math.expm1(-REST_CHANGES_S / FORGETS_S) * moves / wanders
    return math.sqrt(wanders), math.sqrt(moves), -REST_CHANGES_S / math.log1p(-moved)


def drifted_m(log: Path) -> Floats:
    """How far its receiver has drifted, as the core is told by its reports: (2, n)."""
    place_m, _, mps = _flown(log)
    origin = GlobalPosition(*_read(log)["SIM"][0, 1:])
    drift, found = Drift(), []
    for number, (north_m, east_m, *velocity) in enumerate(zip(*place_m, *mps, strict=True)):
        there = displace(origin, (north_m, east_m, 0.0))
        drift.reported(Report(number * STEP_S, there, (velocity[0], velocity[1]), 0.0))
        found.append(drift.lately_m)
    return np.array(found).T[:, 1:]


def _errors_told_m(log: Path) -> tuple[Floats, Floats]:
    """The estimate's error, and what velocity tells of its change: (2, n) each, every `STEP_S`."""
    place_m, true_m, mps = _flown(log)
    flown_m = (mps[:, 1:] + mps[:, :-1]) / 2.0 * STEP_S
    return (place_m - true_m)[:, 1:], np.diff(place_m, axis=1) - flown_m


def _flown(log: Path) -> tuple[Floats, Floats, Floats]:
    """Where it believed to be, where it was, and its velocity: (2, n) each, every `STEP_S`."""
    told = _read(log)
    origin = told["SIM"][0, 1:]
    sim, pos = (_ned_m(told[name], origin) for name in ("SIM", "POS"))
    velocity = told["XKF1"]
    times_s = np.arange(pos[0, 0] + LEFT_OUT_S, pos[-1, 0], STEP_S)

    def axis_of(track: Floats, axis: int) -> Floats:
        return np.interp(times_s, track[:, 0], track[:, axis])

    place_m, true_m, mps = (
        np.stack([axis_of(track, axis) for axis in (1, 2)]) for track in (pos, sim, velocity)
    )
    return place_m, true_m, mps


def velocity_errs_mps(log: Path) -> Floats:
    """By how much the estimated velocity is off, north and east, after take-off: (n, 2)."""
    told = _read(log)
    true, believed = told["SIM2"], told["XKF1"]
    flown = believed[believed[:, 0] > believed[0, 0] + LEFT_OUT_S]
    true_mps = (np.interp(flown[:, 0], true[:, 0], true[:, axis]) for axis in (1, 2))
    return np.array(flown[:, 1:] - np.column_stack(list(true_mps)))


@cache
def _read(log: Path) -> dict[str, Floats]:
    """Rows of (seconds, fields): of the first receiver, barometer and core of the filter."""
    rows: dict[str, list[list[float]]] = {kind: [] for kind in FIELDS}
    reader: Any = DFReader.DFReader_binary(str(log))
    while (message := reader.recv_match(type=list(FIELDS))) is not None:
        kind = message.get_type()
        if getattr(message, "I", 0) == getattr(message, "C", 0) == 0:
            values = [getattr(message, field) for field in FIELDS[kind]]
            rows[kind].append([message.TimeUS / 1e6, *values])
    return {kind: np.array(values) for kind, values in rows.items()}


def _ned_m(track: Floats, origin: Floats) -> Floats:
    """(seconds, latitude, longitude, altitude) as (seconds, north, east, down) about the origin."""
    return np.column_stack([track[:, 0], *pymap3d.geodetic2ned(*track[:, 1:].T, *origin)])


def main() -> None:
    """Print it for each log."""
    logs = [Path(name) for name in sys.argv[1:]]
    for name in logs:
        try:
            found = follows(name)
        except ValueError as error:
            sys.exit(f"{name}: {error}")
        for one in found:
            left = f"{one.left_m:.3f} m left of {one.of_m:.2f} m"
            print(f"{name}: {one.axis} {one.later_s:.2f} s later, {left}")
        for axis, slope, correlation in velocity_tells(name):
            print(f"{name}: {axis} velocity tells {slope:.2f}, correlation {correlation:.2f}")
        off_mps = velocity_errs_mps(name)
        usual_mps, most_mps = np.std(off_mps), np.abs(off_mps).max()
        print(f"{name}: velocity off by {usual_mps:.2f} m/s, at most {most_mps:.2f} m/s")
    try:
        wanders, moves, forgets_s = velocity_leaves(logs)
    except ValueError as error:
        sys.exit(str(error))
    leaves = f"{wanders:.2f} of how far errors wander, {moves:.2f} of how they move within 20 s"
    print(f"all: velocities leave {leaves}: forgotten in {forgets_s:.0f} s")


if __name__ == "__main__":
    main()
