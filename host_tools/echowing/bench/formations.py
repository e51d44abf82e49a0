"""How well formations are kept, shape by shape: for `echowing bench`.

Each *gap* is between a follower and the vehicle that its sonar watches. It counts from when the
last follower has come in; the least distance counts from the start.
"""

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from echowing.analysis.metrics import metrics
from echowing.bench.accuracy import Goal
from echowing.bench.pool import flown
from echowing.campaign.properties import LEAST_M
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

# Nobody has flown these to choose anything.
FIRST_SEED = 1401
# Receivers drift by what is believed; sonars and heights are drawn around it.
WORLD = ("gps.spread=0", "gps.sigma_m=0.8")
TWELVE = ("formation.followers=12", "duration_s=200")
# Each joins within ten seconds of the one before it, mostly.
JOINED_S, TWELVE_JOINED_S = 60.0, 120.0
SLOW, QUICK = "radio.leader.latency_s=0.46", "radio.leader.latency_s=0.05"
WINDY = ("wind.speed_mps=6", "gps.vertical_sigma_m=0.5")
VEE = ("formation.shape=vee", "formation.followers=4")
KEPT = Goal(0.15, 0.25, 1.2)
TURNS_ROUND = Goal(math.inf, math.inf, 1.0)


@dataclass(frozen=True)
class Row:
    """One row: a scenario, what differs from it, its goal, and when all have joined."""

    name: str
    scenario: str
    changes: tuple[str, ...]
    goal: Goal
    joined_s: float = JOINED_S


ROWS = (
    Row("column of 5", "column", (SLOW,), KEPT),
    Row("column of 5, leader 0.05 s old", "column", (QUICK,), KEPT),
    Row("vee of 4", "vee", (SLOW,), KEPT),
    Row("echelon of 4", "echelon", (SLOW,), KEPT),
    Row("diamond of 3", "diamond", (SLOW,), KEPT),
    Row("column of 12", "column", (SLOW, *TWELVE), Goal(0.20, 0.35, 1.2), TWELVE_JOINED_S),
    Row("vee of 4, 6 m/s of wind", "vee", (SLOW, *WINDY), Goal(0.25, 0.40, 1.0)),
    Row("four change their shape, four times", "reshape", (SLOW,), TURNS_ROUND),
    Row("leader turns round, column of 5", "column-back", (SLOW,), TURNS_ROUND),
    Row("leader turns round, vee of 4", "column-back", (SLOW, *VEE), TURNS_ROUND),
)


@dataclass(frozen=True)
class Flown:
    """One flight: mean error and RMSD of each gap, and the least between any two vehicles."""

    mean_errors_m: tuple[float, ...]
    rmsds_m: tuple[float, ...]
    least_m: float


@dataclass(frozen=True)
class FormationRow:
    """A row as it was flown."""

    row: Row
    flights: tuple[Flown, ...]

    @property
    def mean_errors_m(self) -> list[float]:
        """Of each gap, mean of all flights."""
        return _means([one.mean_errors_m for one in self.flights])

    @property
    def rmsds_m(self) -> list[float]:
        """Of each gap, mean of all flights."""
        return _means([one.rmsds_m for one in self.flights])

    @property
    def least_m(self) -> float:
        """Between any two vehicles in any flight."""
        return min(one.least_m for one in self.flights)

    @property
    def under(self) -> int:
        """How many flights came under 1.0 m."""
        return sum(one.least_m < LEAST_M for one in self.flights)


def _means(of_flights: Sequence[tuple[float, ...]]) -> list[float]:
    return [statistics.mean(of_gap) for of_gap in zip(*of_flights, strict=True)]


def flight_count(seeds: int) -> int:
    """How many flights `fly_formations` flies."""
    return len(ROWS) * seeds


def fly_formations(
    seeds: int, advance: Callable[[], None], rows: Sequence[Row] = ROWS
) -> list[FormationRow]:
    """Fly every row with `seeds` seeds; `advance` is called after each flight."""
    numbers = range(FIRST_SEED, FIRST_SEED + seeds)
    flights = flown(fly_one, rows, numbers, advance)
    return [FormationRow(row, tuple(of_row)) for row, of_row in zip(rows, flights, strict=True)]


def fly_one(row: Row, seed: int) -> Flown:
    """One flight of a row."""
    result = FormationFlight(load_scenario(row.scenario, [*WORLD, *row.changes]), seed).run()
    gaps = [metrics(one, row.joined_s) for one in result.flights]
    return Flown(
        tuple(one.mean_abs_error_m for one in gaps),
        tuple(one.rmsd_m for one in gaps),
        result.closest_m,
    )


def markdown(rows: Sequence[FormationRow]) -> str:
    """The table of all rows; in brackets the goal."""
    lines = [
        "| formation | n | mean error of each gap, m | RMSD, m | least between any two, m | "
        "flights under 1.0 m |",
        "|---|---:|---|---|---:|---:|",
    ]
    for one in rows:
        goal = one.row.goal
        errors = " ".join(f"{error_m:.2f}" for error_m in one.mean_errors_m)
        rmsds = " ".join(f"{rmsd_m:.2f}" for rmsd_m in one.rmsds_m)
        if math.isfinite(goal.rmsd_m):
            errors, rmsds = f"{errors} ({goal.mean_error_m:.2f})", f"{rmsds} ({goal.rmsd_m:.2f})"
        lines.append(
            f"| {one.row.name} | {len(one.flights)} | {errors} | {rmsds} "
            f"| {one.least_m:.2f} ({goal.least_m:.1f}) | {one.under} |"
        )
    return "\n".join(lines)
