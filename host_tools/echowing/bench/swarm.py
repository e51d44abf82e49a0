"""What holds a swarm together: its rules, their switch, the sonars. For `echowing bench`.

The same flights with and without sonars, and with weights that change when one vehicle holds two
parts together or do not (S. K. Lee and J. McLurkin, IROS 2014). Figures count from when the swarm
has gathered.
"""

import statistics
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from echowing.analysis.flock import (
    FLIES_MPS,
    extent_m,
    in_one_piece,
    nearest_m,
    polarisation,
    rotation,
)
from echowing.bench.pool import flown
from echowing.flight.swarm import link_m
from echowing.sim.flight import FlightResult, FormationFlight
from echowing.sim.scenario import load_scenario

# Nobody has flown these to choose anything.
FIRST_SEED = 8101
# Scattered over 30 m, six have gathered by then.
GATHERED_S = 20.0
DURATION_S = 90.0

DEAF, FIXED = "sonar.heard_share=0", "swarm.switch=1"
SCENARIOS = {"swarm": "round a rectangle", "swarm-back": "leader flies back through them"}
WAYS: dict[str, tuple[str, ...]] = {
    "as shipped": (),
    "fixed weights": (FIXED,),
    "without sonars": (DEAF,),
    "without sonars, fixed weights": (DEAF, FIXED),
}


@dataclass(frozen=True)
class Flock:
    """Figures of one flight, or means of several; least_m and worst are the least of any.

    whole: share of the time in which links (`link_m`) join all followers, worst: of the flight in
    which it is least; polarisation, rotation: Couzin's, 0 to 1; nearest_m: to the nearest other
    follower; extent_m: root mean square distance from the centre; least_m: between any two vehicles
    at any time.
    """

    whole: float
    worst: float
    polarisation: float
    rotation: float
    nearest_m: float
    extent_m: float
    least_m: float


@dataclass(frozen=True)
class SwarmRow:
    """One row: what was flown, how, how often, and its figures."""

    flown: str
    way: str
    flights: int
    flock: Flock


def flight_count(seeds: int) -> int:
    """How many flights `fly_swarm` flies."""
    return len(SCENARIOS) * len(WAYS) * seeds


def fly_swarm(
    seeds: int, advance: Callable[[], None], jobs: int | None = None, first_seed: int = FIRST_SEED
) -> list[SwarmRow]:
    """Fly every row with `seeds` seeds; `advance` is called after each flight."""
    rows = [(scenario, way) for scenario in SCENARIOS for way in WAYS]
    flights = flown(fly_one, rows, range(first_seed, first_seed + seeds), advance, jobs)
    return [
        SwarmRow(SCENARIOS[scenario], way, seeds, pooled(of_row))
        for (scenario, way), of_row in zip(rows, flights, strict=True)
    ]


def fly_one(row: tuple[str, str], seed: int) -> Flock:
    """One flight of a row: a scenario, and which way."""
    scenario, way = row
    scene = load_scenario(scenario, [f"duration_s={DURATION_S}", *WAYS[way]])
    return flock(FormationFlight(scene, seed).run(), link_m(scene.sonar_belief))


def flock(result: FlightResult, within_m: float) -> Flock:
    """The figures of a flight; within_m: so near to each other two are linked."""
    counted = result.flights[0].time_s >= GATHERED_S
    place_m = np.stack([one.follower_ned_m[counted] for one in result.flights], axis=1)
    velocity_mps = np.stack([one.follower_velocity_mps[counted] for one in result.flights], axis=1)
    level_m, level_mps = place_m[..., :2], velocity_mps[..., :2]
    from_centre_m = level_m - level_m.mean(axis=1, keepdims=True)
    flies = np.linalg.norm(level_mps, axis=2).max(axis=1) >= FLIES_MPS
    whole = float(np.mean([in_one_piece(one, within_m) for one in place_m]))
    return Flock(
        whole=whole,
        worst=whole,
        polarisation=float(np.mean([polarisation(one) for one in level_mps[flies]])),
        rotation=float(np.mean(list(map(rotation, level_mps[flies], from_centre_m[flies])))),
        nearest_m=float(np.mean([nearest_m(one) for one in level_m])),
        extent_m=extent_m(from_centre_m),
        least_m=result.closest_m,
    )


def pooled(flocks: list[Flock]) -> Flock:
    """Several flights as one: means, and the least of what is a least."""
    values = {one.name: [getattr(each, one.name) for each in flocks] for one in fields(Flock)}
    return Flock(
        **{
            name: min(of_all) if name in ("worst", "least_m") else statistics.mean(of_all)
            for name, of_all in values.items()
        }
    )


def markdown(rows: list[SwarmRow]) -> str:
    """The table of all rows."""
    head = "| leader | followers | n | in one piece (worst) | polarisation | rotation | nearest |"
    lines = [f"{head} from the centre | least |", "|---|---|---:|---:|---:|---:|---:|---:|---:|"]
    for row in rows:
        one = row.flock
        lines.append(
            f"| {row.flown} | {row.way} | {row.flights} | {one.whole:.0%} ({one.worst:.0%}) "
            f"| {one.polarisation:.2f} | {one.rotation:.2f} | {one.nearest_m:.1f} m "
            f"| {one.extent_m:.1f} m | {one.least_m:.2f} m |"
        )
    return "\n".join(lines)
