"""Pigeon-inspired optimisation, by Duan and Qiao (2014), doi 10.1108/IJICC-02-2014-0005.

Pigeons fly home first by map and compass, each towards the best place that any has found, then by
landmarks: the worse half is left behind, and the others fly to the middle of those that know the
way, and so on. The thesis's review names a relative of it (Hao, Luo and Duan 2014).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cost = Callable[[Array], float]
# Map and compass factor, pigeons, and rounds by map and compass, as implementations of the paper
# have them; then as many rounds by landmarks as halve the flock to one.
COMPASS, PIGEONS, BY_COMPASS = 0.2, 50, 150
TINY = 1e-9


def fly_home(cost: Cost, unknowns: int, chance: np.random.Generator) -> Array:
    """The best place of one flight home, in the cube from 0 to 1."""
    places = chance.random((PIGEONS, unknowns))
    speeds = np.zeros_like(places)
    best: Array = places[0]
    least = math.inf
    for number in range(1, BY_COMPASS + 1):
        best, least = _better(best, least, places, _costs(cost, places))
        pull = chance.random((PIGEONS, 1)) * (best - places)
        speeds = speeds * math.exp(-COMPASS * number) + pull
        places = np.clip(places + speeds, 0.0, 1.0)
    while len(places) > 1:
        costs = _costs(cost, places)
        best, least = _better(best, least, places, costs)
        know = np.argsort(costs)[: len(places) // 2]
        places, weights = places[know], 1.0 / (costs[know] + TINY)
        middle = np.average(places, axis=0, weights=weights)
        places = places + chance.random((len(places), 1)) * (middle - places)
    return best


def _costs(cost: Cost, places: Array) -> Array:
    return np.array([cost(one) for one in places])


def _better(best: Array, least: float, places: Array, costs: Array) -> tuple[Array, float]:
    first = int(costs.argmin())
    return (places[first].copy(), float(costs[first])) if costs[first] < least else (best, least)
