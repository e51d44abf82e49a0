"""Flights by a sensor on the nose that the autopilot reads itself, without co-processor."""

import pytest

from .flown import flown

pytestmark = pytest.mark.seconds(18)

FIXED = "sonar.file=mb1202-fixed", "duration_s=90"


@pytest.mark.parametrize(
    "seed", [11, *(pytest.param(seed, marks=pytest.mark.long) for seed in (12, 13, 14))]
)
def test_it_holds_better_than_points_alone(seed: int) -> None:
    points_alone = "law=none", "guidance.learn_offset=false"
    held, alone = flown("echowing", seed, *FIXED), flown("echowing", seed, *FIXED, *points_alone)

    assert held.metrics[0].mean_abs_error_m < 0.5 * alone.metrics[0].mean_abs_error_m
    assert held.closest_m > 1.0


def test_the_applet_holds_by_it() -> None:
    """Not only the tool, which learns from the same readings."""
    held, told = flown("echowing", 11, *FIXED), flown("echowing", 11, *FIXED, "law=none")

    assert held.metrics[0].mean_abs_error_m < told.metrics[0].mean_abs_error_m
