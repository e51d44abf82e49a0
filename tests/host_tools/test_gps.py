import itertools
import random
import statistics

import numpy as np
import pytest

from echowing.sim.gps import GpsDrift
from echowing.sim.hangar import Hangar
from echowing.sim.scenario import load_scenario

DT_S = 0.5


def series(seed: int, seconds: float, sigma_m: float = 0.8, tau_s: float = 60.0) -> list[float]:
    drift = GpsDrift(sigma_m, tau_s, random.Random(seed))
    return [drift.step(DT_S)[0] for _ in range(int(seconds / DT_S))]


def test_the_spread_is_sigma() -> None:
    # 40 000 s hold some 330 independent samples: the deviation is known to about 4 %.
    assert statistics.pstdev(series(3, 40_000)) == pytest.approx(0.8, rel=0.12)


def test_after_one_time_constant_a_third_is_remembered() -> None:
    values = np.array(series(4, 40_000))
    lag = int(60.0 / DT_S)

    correlation = np.corrcoef(values[:-lag], values[lag:])[0, 1]

    # exp(-1) = 0.37, known to about 0.05 from this many samples.
    assert correlation == pytest.approx(0.37, abs=0.15)


def test_it_starts_spread_out_as_it_goes_on() -> None:
    starts = [GpsDrift(0.8, 60.0, random.Random(seed)).step(0.0)[0] for seed in range(500)]

    assert statistics.pstdev(starts) == pytest.approx(0.8, rel=0.1)


def test_it_glides() -> None:
    steps = [abs(b - a) for a, b in itertools.pairwise(series(5, 2_000))]

    # A filter lag of 1 s leaves well under 10 cm in half a second.
    assert max(steps) < 0.2


def test_a_jump_comes_at_once() -> None:
    drift = GpsDrift(0.0, 60.0, random.Random(1))
    drift.jump_ned_m = (15.0, -10.0, 0.0)

    assert drift.step(0.02) == pytest.approx((15.0, -10.0, 0.0))


def test_the_same_seed_drifts_the_same_way() -> None:
    assert series(7, 100) == series(7, 100)
    assert series(7, 100) != series(8, 100)


def test_the_height_wanders_by_a_sigma_of_its_own_and_moves_nothing_else() -> None:
    level = GpsDrift(0.8, 60.0, random.Random(3))
    both = GpsDrift(
        0.8, 60.0, random.Random(3), vertical_sigma_m=1.6, vertical_rng=random.Random(4)
    )
    heights = []
    for _ in range(80_000):
        north, east, down = both.step(DT_S)
        assert (north, east, 0.0) == level.step(DT_S)
        heights.append(down)

    assert statistics.pstdev(heights) == pytest.approx(1.6, rel=0.12)
    assert statistics.fmean(heights) == pytest.approx(0.0, abs=0.4)


def test_the_height_of_a_scenario_is_off_unless_asked_for() -> None:
    right = Hangar(load_scenario("echowing"), 1).leader()
    wrong = Hangar(load_scenario("echowing", ["gps.vertical_sigma_m=1.6"]), 1).leader()

    assert right.body.est_down_m == right.body.down_m
    assert abs(wrong.body.est_down_m - wrong.body.down_m) > 0.01
    assert wrong.body.est_north_m == right.body.est_north_m
