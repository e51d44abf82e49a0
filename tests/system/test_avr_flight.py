"""Whole flights on the board's own binary, emulated, beside the same core built for the host."""

import statistics

import numpy as np
import pytest

from echowing.sim.scenario import load_scenario
from echowing.sim.summary import FlownScenario, fly

from ..world import CLEARLY
from .flown import flown

pytestmark = pytest.mark.seconds(11)
SEEDS = (1, 2, 3)
NATIVE_SEEDS = range(1, 8)
RADIUS_M, JOINED_S, FLOWN_S, SHORT_S = 3.0, 45.0, 150.0, 40.0


def flight(firmware: str, seed: int, flown_s: float = FLOWN_S) -> FlownScenario:
    return flown("echowing", seed, f"duration_s={flown_s:g}", *CLEARLY, firmware=firmware)


def usual_error_m(firmware: str, seed: int) -> float:
    """Median of the distance error, once the follower has joined."""
    one = flight(firmware, seed).flights[0]
    return float(np.median(np.abs(one.separation_m[one.time_s > JOINED_S] - RADIUS_M)))


@pytest.mark.long
def test_the_binary_and_the_native_core_fly_alike() -> None:
    """Pings fall at other milliseconds, so single flights part ways; on average they agree.

    Median, not mean: in which flight the sonar loses the leader at a corner for a second is chance,
    and that second makes half of a flight's mean error. The medians of native flights have a
    standard deviation of 7.7 mm, so the means of seven and of three differ by 5.3 mm: the sonar's
    step of 1 cm is more than chance, and what a firmware that reads wrong would show.
    """
    errors_m = {
        firmware: statistics.mean(usual_error_m(firmware, seed) for seed in seeds)
        for firmware, seeds in (("avr", SEEDS), ("native", NATIVE_SEEDS))
    }
    assert errors_m["avr"] == pytest.approx(errors_m["native"], abs=0.01)


def test_the_binary_keeps_its_distance() -> None:
    one = flight("avr", SEEDS[0], SHORT_S)

    assert one.closest_m > 1.0
    assert one.metrics[0].seen_share > 0.6


def test_a_flight_of_the_binary_is_deterministic() -> None:
    first, second = (
        fly(load_scenario("echowing", ["duration_s=8"]), 1, firmware="avr").summaries[0]
        for _ in range(2)
    )

    assert {**first, "wall_s": 0} == {**second, "wall_s": 0}
