"""Flights by a sensor on the nose that the autopilot reads itself, without co-processor."""

import statistics

import pytest

from echowing.sim.summary import FlownScenario

from .flown import flown

pytestmark = pytest.mark.seconds(18)

FIXED = "sonar.file=mb1202-fixed", "duration_s=90"


@pytest.mark.parametrize(
    "seeds", [(21,), pytest.param((21, 22, 23, 24), marks=pytest.mark.long)], ids=len
)
def test_it_holds_better_than_points_alone(seeds: tuple[int, ...]) -> None:
    """Over several seeds: of a leader that is out of reach all the time it hears nothing."""
    points_alone = "law=none", "guidance.learn_offset=false"
    held = [flown("echowing", seed, *FIXED) for seed in seeds]
    alone = [flown("echowing", seed, *FIXED, *points_alone) for seed in seeds]

    assert error_m(held) < 0.5 * error_m(alone)
    assert min(one.closest_m for one in held) > 1.0


def error_m(flights: list[FlownScenario]) -> float:
    return statistics.mean(one.metrics[0].mean_abs_error_m for one in flights)


def test_the_applet_holds_by_it() -> None:
    """Not only the tool, which learns from the same readings."""
    held, told = flown("echowing", 21, *FIXED), flown("echowing", 21, *FIXED, "law=none")

    assert held.metrics[0].mean_abs_error_m < told.metrics[0].mean_abs_error_m
