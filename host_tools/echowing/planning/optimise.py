"""Optimisers, and how well they do on the same formations."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from echowing.planning.cost import Formation, Limits
from echowing.planning.pigeons import fly_home
from echowing.planning.ties import Array

# Evaluations of the cost: a quarter of a minute for twelve followers. For eight and more another
# seed, or more of them, may find a better formation.
EVALUATIONS = 20_000
# How wide annealing jumps; with scipy's own 2.62 it finds worse formations of 5 and of 12.
VISIT = 2.2
# With a larger population or less crossing over evolution finds worse formations of 8 and of 12.
POPULATION, CROSSING = 1, 0.9


class SpentError(Exception):
    """All evaluations are spent."""


class Counted:
    """The cost of what shares of 0 to 1 describe; keeps the best, and ends after so many."""

    def __init__(self, limits: Limits, evaluations: int) -> None:
        self._limits, self._left = limits, evaluations
        self.best: Formation | None = None

    def __call__(self, shares: Array) -> float:
        """The cost, in metres."""
        if self._left == 0:
            raise SpentError
        self._left -= 1
        formation = Formation(self._limits.places_m(shares), self._limits)
        if self.best is None or formation.cost < self.best.cost:
            self.best = formation
        return formation.cost


def _anneal(cost: Counted, unknowns: int, chance: np.random.Generator) -> None:
    within = [(0.0, 1.0)] * unknowns
    optimize.dual_annealing(cost, within, rng=chance, visit=VISIT, no_local_search=True)


def _evolve(cost: Counted, unknowns: int, chance: np.random.Generator) -> None:
    within = [(0.0, 1.0)] * unknowns
    optimize.differential_evolution(
        cost, within, rng=chance, popsize=POPULATION, recombination=CROSSING, polish=False
    )


# The first is the default: it wins for 5 and 8 followers, annealing narrowly for 3, and for 12
# (RESULTS.md, "Formations without a name").
METHODS: dict[str, Callable[[Counted, int, np.random.Generator], object]] = {
    "evolution": _evolve,
    "annealing": _anneal,
    "pigeons": fly_home,
}
DEFAULT = next(iter(METHODS))


def best_of(limits: Limits, method: str, evaluations: int, seed: int) -> Formation:
    """The best formation that a method finds with so many evaluations of the cost.

    A method that ends before begins anew.
    """
    cost, chance = Counted(limits, evaluations), np.random.default_rng(seed)
    while True:
        try:
            METHODS[method](cost, limits.unknowns, chance)
        except SpentError:
            break
    assert cost.best is not None
    return cost.best


@dataclass(frozen=True, slots=True)
class Row:
    """What a method finds for a number of followers; cpu_s: of one run on this machine."""

    followers: int
    method: str
    found: tuple[Formation, ...]
    cpu_s: float

    @property
    def kept(self) -> int:
        """In how many runs all limits are kept."""
        return sum(one.is_within_limits for one in self.found)

    @property
    def spared(self) -> int:
        """In how many of these no single loss splits the formation."""
        return sum(one.is_within_limits and not one.left_alone for one in self.found)

    @property
    def costs_m(self) -> list[float]:
        """What is made least, of each run."""
        return sorted(one.cost for one in self.found)

    @property
    def worst_m(self) -> list[float]:
        """Standard deviation of the worst pair, of each run."""
        return sorted(float(one.sigma_m.max()) for one in self.found)


def compare(
    limits: Limits, followers: Sequence[int], seeds: Sequence[int], evaluations: int
) -> Iterator[Row]:
    """All methods on the same formations, each with the same seeds and as many evaluations."""
    for number in followers:
        for method in METHODS:
            started_s = time.process_time()
            of = replace(limits, followers=number)
            found = tuple(best_of(of, method, evaluations, seed) for seed in seeds)
            yield Row(number, method, found, (time.process_time() - started_s) / len(seeds))
