"""What a sonar hears, fitted to counted pings: share on the axis, half angle and edge, by range.

At a range r and an angle a off the axis a share s(r) / (1 + exp((a - h(r)) / (e / 2))) of the pings
is heard. For each range the likelihood of all s and h is worked out on a grid; the edge e is one
for all ranges. What is given as least and most are 90 % intervals by the likelihood's profile.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# The 90 % point of chi-squared with one degree of freedom; a profile falls by half of it.
NINE_OF_TEN = 2.706
PROFILE_DROP = 0.5 * NINE_OF_TEN
# A reading of something else is near the target by chance: this share is heard anywhere.
BY_CHANCE = 0.003
# With less heard on the axis, an angle cannot be told.
TELLS_AN_ANGLE = 0.2

SHARES = np.linspace(0.0, 1.0, 101)
HALVES_DEG = np.arange(1.0, 60.5, 0.5)
EDGES_DEG = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 8.0])

Grid = NDArray[np.float64]
Between = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Tally:
    """Pings at a target, and how many of them were heard."""

    range_m: float
    off_deg: float
    pings: int
    heard: int


@dataclass(frozen=True, slots=True)
class AtRange:
    """What is heard at one range; half_deg: None where too little is heard to tell."""

    range_m: float
    share: float
    share_between: Between
    half_deg: float | None
    half_between_deg: Between


@dataclass(frozen=True, slots=True)
class Fit:
    """What a sonar hears, by range, the nearest first."""

    at: tuple[AtRange, ...]
    edge_deg: float
    edge_between_deg: Between

    def share(self, range_m: float, off_deg: float) -> float:
        """The share that is heard at one of its ranges, off the axis."""
        here = next(one for one in self.at if one.range_m == range_m)
        if here.half_deg is None:
            return here.share
        steps = min(40.0, (off_deg - here.half_deg) / (0.5 * self.edge_deg))
        return here.share / (1.0 + math.exp(steps))


def fitted(tallies: Iterable[Tally], dependence: float = 1.0) -> Fit:
    """The fit; `dependence`: so many pings tell as much as one that depends on none before it."""
    by_range: dict[float, list[Tally]] = {}
    for tally in tallies:
        by_range.setdefault(tally.range_m, []).append(tally)
    drop = PROFILE_DROP * dependence
    grids = {range_m: _likelihood(group) for range_m, group in sorted(by_range.items())}
    by_edge = sum((grid.max(axis=(0, 1)) for grid in grids.values()), np.zeros(len(EDGES_DEG)))
    edge = int(by_edge.argmax())
    return Fit(
        tuple(_at_range(range_m, grid[:, :, edge], drop) for range_m, grid in grids.items()),
        float(EDGES_DEG[edge]),
        _between(EDGES_DEG, by_edge, drop),
    )


def _likelihood(group: Sequence[Tally]) -> Grid:
    """Logarithm of the likelihood, for each share, half angle and edge."""
    found: Grid = np.zeros((len(SHARES), len(HALVES_DEG), len(EDGES_DEG)))
    for tally in group:
        steps = (tally.off_deg - HALVES_DEG[:, np.newaxis]) / (0.5 * EDGES_DEG)
        inside = 1.0 / (1.0 + np.exp(np.minimum(steps, 40.0)))
        share = BY_CHANCE + (1.0 - 2.0 * BY_CHANCE) * SHARES[:, np.newaxis, np.newaxis] * inside
        found += tally.heard * np.log(share) + (tally.pings - tally.heard) * np.log(1.0 - share)
    return found


def _at_range(range_m: float, likelihood: Grid, drop: float) -> AtRange:
    by_share, by_half = likelihood.max(axis=1), likelihood.max(axis=0)
    share, half_deg = float(SHARES[by_share.argmax()]), float(HALVES_DEG[by_half.argmax()])
    return AtRange(
        range_m,
        share,
        _between(SHARES, by_share, drop),
        half_deg if share >= TELLS_AN_ANGLE else None,
        _between(HALVES_DEG, by_half, drop),
    )


def _between(values: Grid, profile: Grid, drop: float) -> Between:
    """The values that the profile does not rule out."""
    kept = values[profile >= profile.max() - drop]
    return float(kept.min()), float(kept.max())


def dependence(heard: Iterable[Sequence[bool]]) -> float:
    """How many pings tell as much as one, by how alike each is to the one before it (at least 1).

    heard: runs of pings under the same conditions; each is compared with its run's own mean.
    """
    products = squares = 0.0
    for run in heard:
        off = np.asarray(run, dtype=float)
        off = off - off.mean() if len(off) else off
        products += float(off[:-1] @ off[1:])
        squares += float(off @ off)
    alike = max(0.0, min(0.9, products / squares)) if squares > 0.0 else 0.0
    return (1.0 + alike) / (1.0 - alike)


def share_between(count: int, of: int, dependence: float = 1.0) -> Between:
    """The 90 % interval of a share (Wilson's); nothing is known of none."""
    if of == 0:
        return 0.0, 1.0
    n, share, z2 = of / dependence, count / of, NINE_OF_TEN
    middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n)
    half = math.sqrt(z2 * (share * (1.0 - share) + z2 / (4.0 * n)) / n) / (1.0 + z2 / n)
    return max(0.0, middle - half), min(1.0, middle + half)
