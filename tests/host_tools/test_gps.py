import itertools
import math
import random
import statistics
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from echowing.sim.world.gps import Drift, Errors, Filter

DT_S = 0.5
WANDERS = Errors(sigma_m=0.8, tau_s=60.0)


def drift_of(seed: int, errors: Errors, **other: Any) -> Drift:
    return Drift(errors, lambda name: random.Random(f"{seed} {name}"), **other)


def series(seed: int, seconds: float, errors: Errors = WANDERS, axis: int = 0) -> list[float]:
    """The error on one axis, every half second."""
    drift = drift_of(seed, errors)
    return [drift.step(DT_S)[axis] for _ in range(int(seconds / DT_S))]


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
    starts = [drift_of(seed, WANDERS).step(0.0)[0] for seed in range(500)]

    assert statistics.pstdev(starts) == pytest.approx(0.8, rel=0.1)


def test_it_glides() -> None:
    steps = [abs(b - a) for a, b in itertools.pairwise(series(5, 2_000))]

    # A filter lag of 1.5 s leaves well under 10 cm in half a second.
    assert max(steps) < 0.2


def test_an_autopilot_that_follows_its_barometer_later_glides_more() -> None:
    wanders = Errors(height_sigma_m=0.8, height_tau_s=60.0)
    moved_m = {}
    for follows_s in (1.0, 3.0):
        values = np.array(series(5, 40_000, replace(wanders, height_follows_s=follows_s), 2))
        moved_m[follows_s] = float(np.diff(values).std())
        # Behind a drift of 60 s it sees that share of its square.
        assert values.std() == pytest.approx(0.8 * math.sqrt(60.0 / (60.0 + follows_s)), rel=0.12)

    # A filter that makes up for a share b of what it is behind, each time, moves by b / (2 - b) of
    # the variance of what it follows.
    share = {one: 1.0 - math.exp(-DT_S / one) for one in moved_m}
    variance = {one: b / (2.0 - b) for one, b in share.items()}
    wanted = math.sqrt(variance[3.0] / variance[1.0])
    assert moved_m[3.0] / moved_m[1.0] == pytest.approx(wanted, rel=0.05)


@pytest.mark.parametrize("follows_s", [0.5, 1.5, 3.0])
def test_of_a_step_of_its_receiver_0_63_are_followed_in_time(follows_s: float) -> None:
    filter_ = Filter(follows_s, 0.0)
    for _ in range(round(follows_s / 0.005)):
        filter_.step(1.0, 0.0, 0.005)

    assert filter_.error_m == pytest.approx(1.0 - math.exp(-1.0), abs=0.02)


def test_velocity_tells_of_the_drift_what_it_does_on_arducopter_sitl() -> None:
    """SITL: slope 0.49 to 0.65, correlation 0.78 to 0.85, hovering 0.88, off by 0.05 m/s."""
    drift, step_s = drift_of(8, replace(WANDERS, velocity_sigma_mps=0.05)), 0.02
    flown = [(drift.step(step_s)[0], drift.velocity_mps[0]) for _ in range(200_000)]
    place_m, off_mps = np.array(flown[::5]).T
    told_m = place_m[1:] - np.cumsum(off_mps[1:]) * 5 * step_s
    later = round(3.0 / (5 * step_s))
    moved_m, seen_m = (one[later:] - one[:-later] for one in (place_m[1:], told_m))

    assert off_mps.std() == pytest.approx(0.046, abs=0.006)
    assert np.polyfit(moved_m, seen_m, 1)[0] == pytest.approx(0.56, abs=0.06)
    assert np.corrcoef(moved_m, seen_m)[0, 1] == pytest.approx(0.84, abs=0.04)


def test_a_step_draws_the_velocity_along_as_ekf3s() -> None:
    """Of 2.7 m, hovering on SITL 4.6 and 4.8: by 0.49 m/s, and soon 0.09 m/s the other way."""
    filter_, flown = Filter(1.5, 0.0), []
    for _ in range(1_000):
        filter_.step(2.7, 0.0, 0.01)
        flown.append((filter_.error_m, filter_.error_mps))
    place_m, off_mps = np.array(flown).T

    assert off_mps.max() == pytest.approx(0.49, abs=0.05)
    assert place_m[off_mps.argmax()] == pytest.approx(2.0, abs=0.4)
    assert off_mps.min() == pytest.approx(-0.09, abs=0.03)
    assert place_m.max() == pytest.approx(2.78, abs=0.15)


def test_a_jump_comes_at_once() -> None:
    drift = drift_of(1, Errors())
    drift.jump_to((15.0, -10.0, 0.0))

    assert drift.step(0.02) == pytest.approx((15.0, -10.0, 0.0))
    assert drift.taken_reset() == (15.0, -10.0, 0.0)
    assert drift.taken_reset() == (0.0, 0.0, 0.0)


def test_the_same_seed_drifts_the_same_way() -> None:
    assert series(7, 100) == series(7, 100)
    assert series(7, 100) != series(8, 100)


def test_the_height_wanders_by_a_sigma_and_a_time_of_its_own_and_moves_nothing_else() -> None:
    high = Errors(0.8, 60.0, height_sigma_m=1.6, height_tau_s=20.0)
    level, both = drift_of(3, WANDERS), drift_of(3, high)
    heights = []
    for _ in range(80_000):
        north, east, down = both.step(DT_S)
        assert (north, east, 0.0) == level.step(DT_S)
        heights.append(down)

    assert statistics.pstdev(heights) == pytest.approx(1.6, rel=0.12)
    assert statistics.fmean(heights) == pytest.approx(0.0, abs=0.4)
    lag = int(20.0 / DT_S)
    assert np.corrcoef(heights[:-lag], heights[lag:])[0, 1] == pytest.approx(0.37, abs=0.1)


def test_barometer_and_receiver_are_apart() -> None:
    """The autopilot flies by one; the other is only told, unless it flies by that."""
    errors = Errors(height_sigma_m=0.5, receiver_height_sigma_m=1.6)
    usual, by_receiver = drift_of(6, errors), drift_of(6, errors, by_receiver=True)
    flown, told, flown_by_receiver = [], [], []
    for _ in range(40_000):
        flown.append(usual.step(DT_S)[2])
        told.append(usual.receiver_down_m)
        flown_by_receiver.append(by_receiver.step(DT_S)[2])

    assert statistics.pstdev(flown) == pytest.approx(0.5, rel=0.15)
    assert statistics.pstdev(told) == pytest.approx(1.6, rel=0.15)
    assert abs(np.corrcoef(flown, told)[0, 1]) < 0.2
    assert np.corrcoef(flown_by_receiver, told)[0, 1] > 0.95


def test_a_parked_vehicle_takes_its_barometer_for_right() -> None:
    errors = Errors(sigma_m=0.8, height_sigma_m=0.5)
    parked = drift_of(2, errors, parked=True)

    north, _, down = parked.step(0.0)
    assert (north, down) == (drift_of(2, errors).step(0.0)[0], 0.0)
    assert statistics.pstdev(parked.step(DT_S)[2] for _ in range(40_000)) == pytest.approx(
        0.5, rel=0.15
    )


def test_steps_come_as_often_as_told_and_fade() -> None:
    errors = Errors(tau_s=5.0, step_m=3.0, step_every_s=60.0)
    values = np.array(series(9, 60_000, errors))

    # A step is on its way within a second, and then 1 m further in half a second or so.
    begins = np.abs(np.diff(values)) > 0.3
    steps = int(np.sum(begins[1:] & ~begins[:-1]))
    # 1,000 come; a fourth of them is smaller than 1 m and not counted.
    assert 600 < steps < 1_000
    # Each begins at 3 m and fades in 5 s: 3 m x sqrt(5 s / 2 / 60 s), a little less by the filter.
    assert statistics.pstdev(values) == pytest.approx(0.61, rel=0.2)


def test_multipath_comes_beside_the_slow_drift() -> None:
    errors = Errors(0.8, 60.0, multipath_m=0.6, multipath_s=5.0)
    slow, both = np.array(series(4, 20_000)), np.array(series(4, 20_000, errors))
    beside = both - slow

    # The filter's second takes a tenth of its square: 0.6 x sqrt(5 / 6).
    assert statistics.pstdev(beside) == pytest.approx(0.55, rel=0.1)
    lag = int(10.0 / DT_S)
    assert abs(np.corrcoef(beside[:-lag], beside[lag:])[0, 1]) < 0.3
