"""The velocity that the envelope flies, held against grids of all velocities: 20,000 cases.

`make test-long` tries 100,000.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from echowing.flight.envelope import (
    FASTEST_MPS,
    LEAST_M,
    RETREAT_MOST_MPS,
    Answer,
    Other,
    certain_distance_m,
    closing_limit_mps,
    keep_apart,
)
from echowing.geo import Ned

Floats = NDArray[np.float64]
CASES = (20_000, pytest.param(100_000, marks=pytest.mark.long))
AT_ONCE, MOST_OTHERS = 500, 5
ANSWERS = Answer(), Answer(0.47, 5.0)  # ArduCopter's defaults, and what `setup` recommends
# Both programs are convex: whoever is beaten by no velocity close by is beaten by none. The fine
# grid lies round the answer, the coarse one over the disc round the plan, as a share of its radius.
COARSE_STEPS, FINE_STEPS, FINE_M_PER_S = 21, 11, 0.1
# What rounding may cost; the promise is 0.01 m/s.
EPS_MPS = 1e-4


def grid(steps: int) -> Floats:
    """Points of the square from -1 to 1."""
    axis = np.linspace(-1.0, 1.0, steps)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


DISC = grid(COARSE_STEPS)
DISC = DISC[np.hypot(*DISC.T) <= 1.0]
ROUND = FINE_M_PER_S * grid(FINE_STEPS)


@dataclass(frozen=True)
class Case:
    wanted: Ned
    about: list[Other]
    answer: Answer
    own_mps: Ned | None


def drawn_case(chance: np.random.Generator) -> Case:
    def level(length: float) -> Ned:
        bearing_rad = chance.uniform(-math.pi, math.pi)
        return length * math.cos(bearing_rad), length * math.sin(bearing_rad), 0.0

    def other(number: int) -> Other:
        north, east, _ = level(chance.uniform(0.3, 8.0))
        from_it_m = north, east, chance.uniform(-2.0, 2.0)
        nearer_m, age_s = chance.uniform(0.0, 1.5), chance.uniform(0.0, 0.8)
        return Other(str(number), from_it_m, level(chance.uniform(0.0, 5.0)), nearer_m, age_s)

    about = [other(number) for number in range(chance.integers(1, MOST_OTHERS + 1))]
    own_mps = level(chance.uniform(0.0, 5.0)) if chance.random() < 0.5 else None
    return Case(level(chance.uniform(0.0, 6.0)), about, ANSWERS[chance.integers(2)], own_mps)


def half_plane(other: Other, case: Case) -> tuple[float, float, float]:
    """The velocities that are allowed beside another: a direction, and the least along it."""
    north, east = (part / math.hypot(*other.from_it_m[:2]) for part in other.from_it_m[:2])
    limit_mps = closing_limit_mps(certain_distance_m(other), case.answer)
    its_mps = north * other.velocity_mps[0] + east * other.velocity_mps[1]
    if case.own_mps is None:
        return north, east, its_mps - limit_mps
    closing_mps = its_mps - north * case.own_mps[0] - east * case.own_mps[1]
    too_fast_mps = max(0.0, closing_mps - max(0.0, limit_mps))
    return north, east, its_mps - limit_mps + min(RETREAT_MOST_MPS, too_fast_mps)


class Chunk:
    """Some cases at once: what the envelope flies in them, and what else could be flown."""

    def __init__(self, cases: list[Case]) -> None:
        nobody = (0.0, 0.0, -math.inf)
        walls = [[half_plane(other, case) for other in case.about] for case in cases]
        self._walls = np.array([(*each, *[nobody] * (MOST_OTHERS - len(each))) for each in walls])
        self._wanted = np.array([case.wanted[:2] for case in cases])
        flown = [keep_apart(c.wanted, c.about, c.answer, LEAST_M, c.own_mps)[0] for c in cases]
        self._flown = np.array([velocity[:2] for velocity in flown])
        self._most_mps = np.maximum(FASTEST_MPS, self._short_mps().max(axis=1))

    def judge(self) -> tuple[Floats, Floats, Floats]:
        """By how much the answers break and are beaten, and whether a velocity fits (1, 0)."""
        tried = np.concatenate(
            (
                self._wanted[:, None] + self._most_mps[:, None, None] * DISC,
                self._flown[:, None] + ROUND,
            ),
            axis=1,
        )
        outside = self._away_mps(tried) > self._most_mps[:, None]
        breach_mps = np.where(outside, np.inf, self._breach_mps(tried))
        fits = breach_mps.min(axis=1) <= 0.0
        nearest_mps = np.where(breach_mps <= 0.0, self._away_mps(tried), np.inf).min(axis=1)
        broken_mps = self._breach_mps(self._flown[:, None])[:, 0]
        away_mps = self._away_mps(self._flown[:, None])[:, 0]
        beaten_mps = np.where(fits, away_mps - nearest_mps, broken_mps - breach_mps.min(axis=1))
        beyond_mps = away_mps - self._most_mps
        broken_mps = np.where(fits, np.maximum(broken_mps, beyond_mps), beyond_mps)
        return broken_mps, beaten_mps, fits.astype(float)

    def _short_mps(self) -> Floats:
        """By how much each of the others alone changes the plan; negative: it does not."""
        ways, least_mps = self._walls[:, :, :2], self._walls[:, :, 2]
        short_mps: Floats = least_mps - (ways * self._wanted[:, None]).sum(axis=2)
        return short_mps

    def _away_mps(self, velocities: Floats) -> Floats:
        away: Floats = np.linalg.norm(velocities - self._wanted[:, None], axis=2)
        return away

    def _breach_mps(self, velocities: Floats) -> Floats:
        """The greatest of all walls; negative: none is broken."""
        breach_mps = np.full(velocities.shape[:2], -np.inf)
        for wall in range(MOST_OTHERS):
            north, east, least_mps = self._walls[:, wall, :, None].transpose(1, 0, 2)
            short_mps = least_mps - north * velocities[..., 0] - east * velocities[..., 1]
            np.maximum(breach_mps, short_mps, out=breach_mps)
        return breach_mps


def chunks(cases: int) -> Iterator[Chunk]:
    chance = np.random.default_rng(30)
    for _ in range(cases // AT_ONCE):
        yield Chunk([drawn_case(chance) for _ in range(AT_ONCE)])


@pytest.mark.parametrize("cases", CASES)
def test_no_velocity_is_nearer_to_the_plan_and_none_breaks_less(cases: int) -> None:
    """Where one fits nobody is closed on faster than allowed; else the greatest breach is least."""
    broken_mps, beaten_mps, fits = map(
        np.concatenate, zip(*map(Chunk.judge, chunks(cases)), strict=True)
    )

    assert fits.size == cases
    assert 0.05 < 1.0 - fits.mean() < 0.5  # of both kinds there are enough
    assert broken_mps.max() < EPS_MPS
    assert beaten_mps.max() < EPS_MPS
