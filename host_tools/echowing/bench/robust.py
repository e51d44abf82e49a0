"""How well a distance is kept in a world that is worse than believed: `bench --only robust`.

One thing at a time is different from what the simulator draws by default, then any two of them at
once. Flown and measured as for accuracy, on seeds that nothing was chosen by.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

from echowing.bench.accuracy import Goal, Kept, Row, fly_rows

# Nobody has flown these to choose anything; 701 to 760, 1701 to 1720 and 2701 to 2720 have served
# for that.
FIRST_SEED = 2801


def _goal(mean_error_m: float, rmsd_m: float, least_m: float) -> Goal:
    """How long it takes to find the leader is shown, and not judged."""
    return Goal(mean_error_m, rmsd_m, least_m, found_s=math.inf)


SHIPPED = _goal(0.12, 0.20, 1.5)
WORSE = _goal(0.15, 0.25, 1.5)
BAD = _goal(0.25, 0.40, 1.2)
WORST = _goal(0.30, 0.50, 1.0)
# Any two together: only that nobody comes too near.
APART = _goal(math.inf, math.inf, 1.0)

# As far as the row says, not drawn around it.
EXACTLY = "gps.spread=0"

ONE_BY_ONE = (
    Row(
        "beam of 20 degrees to 2 m, 6 at 4.6 m",
        ("sonar.beam_near_deg=20", "sonar.beam_far_deg=6"),
        WORSE,
    ),
    Row("beam of 12 degrees", ("sonar.beam_near_deg=12",), WORSE),
    Row("seven pings of ten heard", ("sonar.heard_share=0.7",), WORSE),
    Row("four pings of ten heard", ("sonar.heard_share=0.4",), BAD),
    Row("deaf for 1 s in 3", (f"sonar.deaf_share={1 / 3}", "sonar.deaf_s=1"), BAD),
    Row("noise of 5 cm", ("sonar.noise_m=0.05",), BAD),
    Row("stock legs", ("leader.target=stock",), WORST),
    Row("receivers of 1.5 m", ("gps.sigma_m=1.5", EXACTLY), WORST),
    Row("heights of 1.0 m", ("gps.vertical_sigma_m=1.0", EXACTLY), WORST),
)
ROWS = (Row("as shipped", (), SHIPPED), *ONE_BY_ONE)


def _together(a: Row, b: Row) -> Row | None:
    """Two of them at once; None: each wants another value of the same."""
    changes = tuple(dict.fromkeys((*a.changes, *b.changes)))
    if len({change.partition("=")[0] for change in changes}) < len(changes):
        return None
    return Row(f"{a.name}; {b.name}", changes, APART)


PAIRS = tuple(row for a, b in combinations(ONE_BY_ONE, 2) if (row := _together(a, b)) is not None)


@dataclass(frozen=True)
class Robust:
    """What was flown: one by one, and any two of them."""

    rows: list[Kept]
    pairs: list[Kept]

    @property
    def together(self) -> Kept:
        """All flights of all pairs as one row."""
        flights = tuple(flight for kept in self.pairs for flight in kept.flights)
        return Kept(Row("any two of them together", (), APART), flights)


def flight_count(seeds: int) -> int:
    """How many flights `fly_robust` flies."""
    return (len(ROWS) + len(PAIRS)) * seeds


def fly_robust(seeds: int, advance: Callable[[], None]) -> Robust:
    """Fly every row and every pair with `seeds` seeds on all cores."""
    flown = fly_rows((*ROWS, *PAIRS), seeds, advance, first_seed=FIRST_SEED, known=False)
    return Robust(flown[: len(ROWS)], flown[len(ROWS) :])
