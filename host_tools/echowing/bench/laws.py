"""The speed laws beside each other: many flights on all cores, one row a law and leader path."""

import math
import os
import statistics
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

from echowing.analysis.flight import Flight, Floats
from echowing.sim.own_plan import OWN_PLAN
from echowing.sim.scenario import LAWS, load_scenario
from echowing.sim.summary import FlownScenario, fly

PATHS = ("rectangle", "figure-eight", "stop-and-go")
HOSTILE = "hostile"
# A minute: two corners of the rectangle, a whole eight, and the table in six minutes on two cores.
DURATION_S = 60.0
# The smaller step of the thesis's law: less than it is no change that a pilot would notice.
CHANGE_MPS = 0.5
# The parts of the hostile script in which the leader itself flies at its follower.
ATTACKS = frozenset({"reverses", "flies at its follower"})
LEAST_M = 1.0
LEAST_ATTACKED_M = 0.5


@dataclass(frozen=True)
class LawFlight:
    """What one flight says of its law. attacked_m: least separation from a leader that attacks."""

    law: str
    path: str
    mean_error_m: float
    rmsd_m: float
    least_m: float
    attacked_m: float
    changes_per_min: float
    dead_locked: bool

    @property
    def safe(self) -> bool:
        """Whether it kept its distance: 1 m, and 0.5 m from a leader that flies at it."""
        return self.least_m > LEAST_M and self.attacked_m > LEAST_ATTACKED_M


@dataclass(frozen=True)
class LawRow:
    """Means over the flights of one law on one path (path "all": all that are not hostile).

    least_m and attacked_m are the least of any flight; attacked_m is infinite where nobody attacks.
    """

    law: str
    path: str
    flights: int
    mean_error_m: float
    rmsd_m: float
    least_m: float
    attacked_m: float
    changes_per_min: float
    dead_locked: int
    safe: bool


def speed_changes_per_min(time_s: Floats, speed_mps: Floats) -> float:
    """How often a speed has moved by CHANGE_MPS since it was last counted; NaN where unset."""
    known = [float(speed) for speed in speed_mps if math.isfinite(speed)]
    if len(known) < 2:
        return 0.0
    changes, counted_mps = 0, known[0]
    for speed in known:
        # A thousandth: half a metre a second in 32 bits is as often a hair less.
        if abs(speed - counted_mps) >= CHANGE_MPS - 1e-3:
            changes, counted_mps = changes + 1, speed
    return changes * 60.0 / float(time_s[-1] - time_s[0])


def fly_laws(
    seeds: int,
    advance: Callable[[], None],
    jobs: int | None = None,
    *,
    laws: Sequence[str] = LAWS,
) -> list[LawRow]:
    """Fly every law on every path with seeds 1 to `seeds`; `advance` is called after each flight.

    Returns a row a law and path, and one of all formation paths together.
    """
    # The longest first, so that the cores end together.
    plan = [
        (law, path, seed)
        for path in (HOSTILE, *PATHS)
        for seed in range(1, seeds + 1)
        for law in laws
    ]
    flown: dict[tuple[str, str, int], LawFlight] = {}
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        futures = {pool.submit(fly_law, *one): one for one in plan}
        for future in as_completed(futures):
            flown[futures[future]] = future.result()
            advance()
    return list(rows([flown[one] for one in plan]))


def flight_count(seeds: int, laws: Sequence[str] = LAWS) -> int:
    """How many flights `fly_laws` flies."""
    return len(laws) * (len(PATHS) + 1) * seeds


def flown_as(law: str) -> str:
    """The change of a scenario that flies a law, or the hold with a plan of the user's own."""
    return f'plan="{law}"' if law.endswith(OWN_PLAN) else f'law="{law}"'


def fly_law(law: str, path: str, seed: int) -> LawFlight:
    """One flight: the default formation on a path, or the hostile scenario."""
    changes = [flown_as(law)]
    if path != HOSTILE:
        changes += [f'leader.path="{path}"', f"duration_s={DURATION_S}"]
    scenario = load_scenario(HOSTILE if path == HOSTILE else "echowing", changes)
    return law_flight(fly(scenario, seed), path)


def law_flight(flown: FlownScenario, path: str) -> LawFlight:
    """The figures of a flown scenario's first follower."""
    calm = {label: m for label, m in flown.phases.items() if label not in ATTACKS}
    attacks = [m for label, m in flown.phases.items() if label in ATTACKS]
    flight: Flight = flown.flights[0]
    settled = flight.time_s >= flown.metrics[0].settle_s
    return LawFlight(
        law=flown.law,
        path=path,
        mean_error_m=flown.metrics[0].mean_abs_error_m,
        rmsd_m=flown.metrics[0].rmsd_m,
        least_m=min(calm.values(), default=flown.closest_m),
        attacked_m=min(attacks, default=math.inf),
        changes_per_min=speed_changes_per_min(
            flight.time_s[settled], flight.speed_command_mps[settled]
        ),
        dead_locked=flown.dead_locked,
    )


def rows(flights: Sequence[LawFlight]) -> Iterator[LawRow]:
    """A row a path and law; then one a law of all formation paths, safe only if hostile was too."""
    laws = list(dict.fromkeys(flight.law for flight in flights))
    for path in (*PATHS, HOSTILE):
        for law in laws:
            yield _row(law, path, [f for f in flights if (f.law, f.path) == (law, path)])
    for law in laws:
        formation = [f for f in flights if f.law == law and f.path != HOSTILE]
        everywhere = all(f.safe for f in flights if f.law == law)
        yield _row(law, "all", formation, safe=everywhere)


def _row(law: str, path: str, flights: Sequence[LawFlight], *, safe: bool | None = None) -> LawRow:
    return LawRow(
        law=law,
        path=path,
        flights=len(flights),
        mean_error_m=statistics.mean(f.mean_error_m for f in flights),
        rmsd_m=statistics.mean(f.rmsd_m for f in flights),
        least_m=min(f.least_m for f in flights),
        attacked_m=min(f.attacked_m for f in flights),
        changes_per_min=statistics.mean(f.changes_per_min for f in flights),
        dead_locked=sum(f.dead_locked for f in flights),
        safe=all(f.safe for f in flights) if safe is None else safe,
    )


def best_law(table: Sequence[LawRow]) -> str | None:
    """The law of lowest RMSD over the formation paths among those safe in every run, if any."""
    safe = [row for row in table if row.path == "all" and row.safe]
    return min(safe, key=lambda row: row.rmsd_m).law if safe else None
