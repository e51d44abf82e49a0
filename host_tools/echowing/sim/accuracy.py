"""How well a follower keeps its distance, on paths and radios that differ: for `echowing bench`.

Echowing with its defaults, in every row the same; seeds that nothing was chosen by. *Error* is the
absolute separation error; a row's mean error and RMSD are the means of its flights', its least
distance is the least of any flight and its time to find the leader the longest of any.
"""

import math
import os
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

from echowing.analysis.metrics import found_s
from echowing.sim.scenario import load_scenario
from echowing.sim.summary import fly

# Nobody has flown these to choose anything.
FIRST_SEED = 301
# From the start, where a follower hovers 3 m outside its slot, until its sonar has the leader.
FOUND_WITHIN_S = 20.0


@dataclass(frozen=True)
class Goal:
    """What a row has to keep to, metres."""

    mean_error_m: float
    rmsd_m: float
    least_m: float


@dataclass(frozen=True)
class Row:
    """One row of the table: what differs from the scenario `echowing`, and its goal."""

    name: str
    changes: tuple[str, ...]
    goal: Goal


ROWS = (
    Row("leader 0.46 s old at 4 Hz, follower's radio 0.05 s", (), Goal(0.15, 0.25, 1.2)),
    Row("both radios 0.46 s", ("radio.follower.latency_s=0.46",), Goal(0.20, 0.32, 1.2)),
    Row(
        "leader 0.05 s old at 10 Hz",
        ("radio.leader.latency_s=0.05", "guidance.telemetry_hz=10"),
        Goal(0.08, 0.14, 1.5),
    ),
    Row("figure eight", ("leader.path=figure-eight",), Goal(0.15, 0.25, 1.2)),
    Row("stop and go", ("leader.path=stop-and-go",), Goal(0.15, 0.25, 1.2)),
    Row("leader at 4 m/s", ("leader.speed_mps=4",), Goal(0.50, 0.75, 1.2)),
)


@dataclass(frozen=True)
class Flown:
    """One flight of a row. found_s: infinite where the sonar never had the leader."""

    mean_error_m: float
    rmsd_m: float
    least_m: float
    found_s: float


@dataclass(frozen=True)
class Kept:
    """A row as it was flown, and whether each of its goals was met."""

    row: Row
    flights: tuple[Flown, ...]

    @property
    def mean_error_m(self) -> float:
        """Mean of the flights' mean errors."""
        return statistics.mean(one.mean_error_m for one in self.flights)

    @property
    def rmsd_m(self) -> float:
        """Mean of the flights' RMSD."""
        return statistics.mean(one.rmsd_m for one in self.flights)

    @property
    def least_m(self) -> float:
        """Least distance in any flight."""
        return min(one.least_m for one in self.flights)

    @property
    def found_s(self) -> float:
        """Longest time to find the leader in any flight."""
        return max(one.found_s for one in self.flights)

    @property
    def missed(self) -> tuple[str, ...]:
        """The goals that were missed, by name. Figures count to a centimetre, as the goals do."""
        goal = self.row.goal
        met = {
            "mean error": round(self.mean_error_m, 2) <= goal.mean_error_m,
            "RMSD": round(self.rmsd_m, 2) <= goal.rmsd_m,
            "least": self.least_m >= goal.least_m,
            "found": self.found_s <= FOUND_WITHIN_S,
        }
        return tuple(name for name, is_met in met.items() if not is_met)


def fly_rows(seeds: int, advance: Callable[[], None], jobs: int | None = None) -> list[Kept]:
    """Fly every row with `seeds` seeds on all cores; `advance` is called after each flight."""
    plan = [(row, FIRST_SEED + number) for row in ROWS for number in range(seeds)]
    flown: dict[tuple[Row, int], Flown] = {}
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        futures = {pool.submit(fly_row, *one): one for one in plan}
        for future in as_completed(futures):
            flown[futures[future]] = future.result()
            advance()
    return kept(flown)


def kept(flown: dict[tuple[Row, int], Flown]) -> list[Kept]:
    """The flights by row, in the table's order."""
    listed = [(row, tuple(f for (of, _), f in flown.items() if of == row)) for row in ROWS]
    return [Kept(row, flights) for row, flights in listed]


def flight_count(seeds: int) -> int:
    """How many flights `fly_rows` flies."""
    return len(ROWS) * seeds


def fly_row(row: Row, seed: int, changes: Sequence[str] = ()) -> Flown:
    """One flight of a row; `changes` come on top."""
    scenario = load_scenario("echowing", [*row.changes, *changes])
    one = fly(scenario, seed)
    (measured,), (flight,) = one.metrics, one.flights
    first_s = found_s(flight, scenario.guidance.sonar_inset_m)
    return Flown(
        mean_error_m=measured.mean_abs_error_m,
        rmsd_m=measured.rmsd_m,
        least_m=one.closest_m,
        found_s=math.inf if first_s is None else first_s,
    )
