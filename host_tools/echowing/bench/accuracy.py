"""How well a follower keeps its distance, on paths and radios that differ: for `echowing bench`.

Echowing with its defaults, in every row the same; seeds that nothing was chosen by. The world is as
the product believes it but for what a row says, so that prediction, estimate and control show:
`echowing.bench.robust` flies worlds that are not. *Error* is the absolute separation error; a row's
mean error and RMSD are the means of its flights', its least distance is the least of any flight and
its time to find the leader the longest of any.

Each flight is flown twice: as it is, and with the receivers' disagreement known. The second says
what the rest of the product leaves, and with the estimate's own uncertainty what can be reached.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from echowing.analysis.metrics import approach_s, found_s, metrics, within_s
from echowing.bench.pool import flown
from echowing.campaign.properties import LEAST_M
from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import Cloud
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.guidance import Horizontal
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

# Nobody has flown these to choose anything; 301 to 320 have served for that.
FIRST_SEED = 2901
# From the start, where a follower hovers 3 m outside its slot, until its sonar has the leader.
FOUND_WITHIN_S = 10.0


@dataclass(frozen=True)
class Goal:
    """What a row has to keep to, metres; and until when its leader has to be found."""

    mean_error_m: float
    rmsd_m: float
    least_m: float
    found_s: float = FOUND_WITHIN_S

    def missed(
        self, mean_error_m: float, rmsd_m: float, least_m: float, found_s: float = 0.0
    ) -> tuple[str, ...]:
        """What was missed, by name. Errors count to a centimetre, as the goals do."""
        met = {
            "mean error": round(mean_error_m, 2) <= self.mean_error_m,
            "RMSD": round(rmsd_m, 2) <= self.rmsd_m,
            "least": least_m >= self.least_m,
            "found": found_s <= self.found_s,
        }
        return tuple(name for name, is_met in met.items() if not is_met)


@dataclass(frozen=True)
class Row:
    """One row of the table: what differs from the scenario `echowing`, and its goal."""

    name: str
    changes: tuple[str, ...]
    goal: Goal


# Receivers drift by what is taken for granted, heights are right, and the sonar hears all in a cone
# of 20 degrees.
AS_BELIEVED = (
    "gps.spread=0",
    "gps.vertical_sigma_m=0",
    "sonar.spread=0",
    "sonar.heard_share=1",
    "sonar.beam_near_deg=20",
    "sonar.noise_m=0.01",
    "sonar.wild_share=0.01",
    "sonar.inset_m=0.2",
)
USUAL, HARDER = Goal(0.08, 0.13, 2.0), Goal(0.12, 0.22, 1.8)
ROWS = tuple(
    Row(name, (*AS_BELIEVED, *changes), goal)
    for name, changes, goal in (
        ("leader 0.46 s old at 4 Hz, follower's radio 0.05 s", (), USUAL),
        ("both radios 0.46 s", ("radio.follower.latency_s=0.46",), USUAL),
        ("figure eight", ("leader.path=figure-eight",), USUAL),
        ("stop and go", ("leader.path=stop-and-go",), USUAL),
        (
            "leader 0.05 s old at 10 Hz",
            ("radio.leader.latency_s=0.05", "guidance.telemetry_hz=10"),
            Goal(0.07, 0.11, 2.0),
        ),
        ("leader at 4 m/s", ("leader.speed_mps=4",), Goal(0.22, 0.40, 1.5)),
        ("heights wander by 0.5 m", ("gps.vertical_sigma_m=0.5",), HARDER),
        ("beam of 20 degrees to 2 m, 6 at 4.6 m", ("sonar.beam_far_deg=6",), HARDER),
        ("receivers wander by 1.5 m", ("gps.sigma_m=1.5",), Goal(0.30, 0.50, 1.5)),
    )
)


@dataclass(frozen=True)
class Flown:
    """One flight of a row.

    found_s: until the sonar had the leader; reached_s: until the leader was within its reach,
    wherever the nose pointed; infinite for never. sigma_m: what the estimate gives itself along the
    line to the leader (root mean square). beyond_share: of the time in which it is off along that
    line by more than `SURE_SIGMAS` of its own standard deviations.
    """

    mean_error_m: float
    rmsd_m: float
    least_m: float
    found_s: float
    reached_s: float
    sigma_m: float
    beyond_share: float


@dataclass(frozen=True)
class Kept:
    """A row as it was flown, and whether each of its goals was met.

    known: the same seeds with the receivers' disagreement known, where they were flown so too.
    """

    row: Row
    flights: tuple[Flown, ...]
    known: tuple[Flown, ...] = ()

    @property
    def mean_error_m(self) -> float:
        """Mean of the flights' mean errors."""
        return _mean(one.mean_error_m for one in self.flights)

    @property
    def rmsd_m(self) -> float:
        """Mean of the flights' RMSD."""
        return _mean(one.rmsd_m for one in self.flights)

    @property
    def least_m(self) -> float:
        """Least distance in any flight."""
        return min(one.least_m for one in self.flights)

    @property
    def found_s(self) -> float:
        """Longest time to find the leader in any flight."""
        return max(one.found_s for one in self.flights)

    @property
    def reached_s(self) -> float:
        """Longest time in any flight until the leader was within the sonar's reach."""
        return max(one.reached_s for one in self.flights)

    @property
    def known_error_m(self) -> float:
        """Mean error with the receivers' disagreement known: no estimate of it leaves less."""
        return _mean(one.mean_error_m for one in self.known)

    @property
    def bound_rmsd_m(self) -> float:
        """What an estimate as unsure as it says it is adds to the RMSD with it known."""
        known_m2 = _mean(one.rmsd_m**2 for one in self.known)
        return math.sqrt(known_m2 + _mean(one.sigma_m**2 for one in self.flights))

    @property
    def beyond_share(self) -> float:
        """Share of time in which the estimate is off by more than it may; an honest one: 1 %."""
        return _mean(one.beyond_share for one in self.flights)

    @property
    def under(self) -> int:
        """Flights that came under the metre that is promised."""
        return sum(one.least_m < LEAST_M for one in self.flights)

    @property
    def missed(self) -> tuple[str, ...]:
        """The goals that were missed, by name."""
        figures = self.mean_error_m, self.rmsd_m, self.least_m, self.found_s
        return self.row.goal.missed(*figures)


def _mean(values: Iterable[float]) -> float:
    return statistics.mean(values)


def fly_accuracy(seeds: int, advance: Callable[[], None]) -> list[Kept]:
    """Fly every row, as it is and with the receivers' disagreement known."""
    return fly_rows(ROWS, seeds, advance, first_seed=FIRST_SEED, known=True)


def flight_count(seeds: int) -> int:
    """How many flights `fly_accuracy` flies."""
    return 2 * len(ROWS) * seeds


def fly_rows(
    rows: Sequence[Row],
    seeds: int,
    advance: Callable[[], None],
    *,
    first_seed: int,
    known: bool,
) -> list[Kept]:
    """Fly rows with `seeds` seeds on all cores; `advance` is called after each flight.

    known: each is flown a second time with the receivers' disagreement known.
    """
    numbers = range(first_seed, first_seed + seeds)
    ways = (False, True) if known else (False,)
    flights = flown(_fly_way, [(row, way) for row in rows for way in ways], numbers, advance)
    each = iter(map(tuple, flights))
    return [Kept(row, *(next(each) for _ in ways)) for row in rows]


def _fly_way(row_and_way: tuple[Row, bool], seed: int) -> Flown:
    row, known = row_and_way
    return fly_row(row, seed, known=known)


def fly_row(row: Row, seed: int, changes: Sequence[str] = (), *, known: bool = False) -> Flown:
    """One flight of a row; `changes` come on top. known: the receivers' disagreement is known."""
    scenario = load_scenario("echowing", [*row.changes, *changes])
    flight = FormationFlight(scenario, seed)
    watch = _Watch(flight, known=known)
    result = flight.run(after_step=watch.step)
    (flown,) = result.flights
    approached_s, sonar = approach_s(flown), flight.followers[0].ear.sonar
    inset_m = sonar.inset_m
    measured = metrics(flown, approached_s)
    return Flown(
        mean_error_m=measured.mean_abs_error_m,
        rmsd_m=measured.rmsd_m,
        least_m=result.closest_m,
        found_s=_or_never(found_s(flown, inset_m)),
        reached_s=_or_never(within_s(flown, sonar.foil_m + inset_m)),
        sigma_m=watch.sigma_m(approached_s),
        beyond_share=watch.beyond_share(approached_s),
    )


def _or_never(first_s: float | None) -> float:
    return math.inf if first_s is None else first_s


class Known(Cloud):
    """The receivers' disagreement itself, in place of its estimate; `truth` gives it."""

    def __init__(self, sonar: SonarBelief, truth: Callable[[], Horizontal]) -> None:
        super().__init__(sonar)
        self._truth = truth
        self._covariance = (0.0, 0.0, 0.0)

    def copy(self) -> "Known":
        """Nothing that anybody could forget."""
        return self

    def foretell(self, then_s: float) -> None:
        """As good as heard at this moment."""
        self._heard_at_s = then_s
        self.north_m, self.east_m = self._truth()

    def nearest_m(self, to_it_m: Horizontal, above_m: float, clear_m: float) -> float:
        """Where it is known, so far and no nearer."""
        return clear_m

    def advance(self, to_s: float) -> None:
        """Nothing that wanders."""

    def heard(self, *_: object) -> None:
        """Nothing to learn."""

    def silent(self, *_: object) -> None:
        """Nothing to learn."""


class _Watch:
    """Looks at the estimate while it flies, or puts the truth in its place."""

    def __init__(self, flight: FormationFlight, *, known: bool) -> None:
        self._flight = flight
        (follower,) = flight.ground.session.followers.values()
        self._estimate = follower.estimate
        self._seen: list[tuple[float, float, float]] = []
        """When, how far off along the line to the leader, and by the estimate's own figure."""
        if known:
            self._estimate.offset = Known(self._estimate.sonar, self._truth)

    def step(self) -> None:
        """After each step."""
        flight, offset = self._flight, self._estimate.offset
        if isinstance(offset, Known):
            offset.foretell(flight.t_s)
        leader, follower = flight.leader.body, flight.followers[0].body
        north_m, east_m = leader.north_m - follower.north_m, leader.east_m - follower.east_m
        bearing_rad = math.atan2(east_m, north_m)
        true_north_m, true_east_m = self._truth()
        off_north_m, off_east_m = true_north_m - offset.north_m, true_east_m - offset.east_m
        off_m = off_north_m * math.cos(bearing_rad) + off_east_m * math.sin(bearing_rad)
        self._seen.append((flight.t_s, off_m, offset.sigma_m(bearing_rad)))

    def sigma_m(self, from_s: float) -> float:
        """Root mean square of what the estimate gives itself along the line to the leader."""
        return math.sqrt(_mean(own_m**2 for t_s, _, own_m in self._seen if t_s >= from_s))

    def beyond_share(self, from_s: float) -> float:
        """Share of time in which it is off by more than `SURE_SIGMAS` of its own deviations."""
        seen = [one for one in self._seen if one[0] >= from_s]
        return sum(abs(off_m) > SURE_SIGMAS * own_m for _, off_m, own_m in seen) / len(seen)

    def _truth(self) -> Horizontal:
        """What the receivers disagree by, less what they are known to have drifted."""
        leader, follower = self._flight.leader.body, self._flight.followers[0].body
        north_m, east_m = self._estimate.drifted_m
        return (
            leader.est_north_m - leader.north_m - follower.est_north_m + follower.north_m - north_m,
            leader.est_east_m - leader.east_m - follower.est_east_m + follower.east_m - east_m,
        )
