"""The laws beside each other, over many seeds: the figures the product is judged by."""

import statistics
from collections.abc import Sequence

import pytest

from echowing.analysis.flight import Flight
from echowing.sim.summary import FlownScenario

from .flown import flown

pytestmark = pytest.mark.seconds(60)
FEW, SEEDS = range(1, 4), range(1, 8)
SHORT = "duration_s=130"
GRAY_SEEDS = range(1, 13)
LOST_M = 10.0  # mean error of a follower that lost its leader for good; else it is under 3.2
LEADER_MPS = 2.0
GUARD_MPS = 5.0  # ECHO_SPD_MAX, with which the guard backs off


def mean_of(flights: Sequence[FlownScenario], figure: str) -> float:
    return statistics.mean(float(getattr(one.metrics[0], figure)) for one in flights)


@pytest.mark.long
def test_grays_scheme_flies_as_ardupilot_does() -> None:
    """The figures of two ArduCopter 4.8 in SITL, flown the same way over eight seeds."""
    flights = [flown("gray", seed) for seed in GRAY_SEEDS]

    assert mean_of(flights, "mean_separation_m") == pytest.approx(4.6, abs=0.3)
    assert mean_of(flights, "mean_abs_error_m") == pytest.approx(1.65, abs=0.25)
    assert mean_of(flights, "rmsd_m") == pytest.approx(1.95, abs=0.3)


@pytest.mark.long
def test_the_thesis_law_flown_unchanged_dead_locks() -> None:
    """Repelled to less than the leader's speed, then out of sight: no change for ever.

    The guard backs off from a ghost now and then, so the command is not low all the time: after
    it, the law is where it was.
    """
    locked = [seed for seed in SEEDS if _is_locked(flown("thesis", seed).flights[0])]

    assert len(locked) >= 2, locked


def _is_locked(flight: Flight) -> bool:
    late_mps = flight.speed_command_mps[flight.time_s > flight.time_s[-1] - 100.0]
    low_mps = min(late_mps)
    stays = {float(one) for one in late_mps} <= {low_mps, GUARD_MPS}
    return bool(stays and low_mps < LEADER_MPS and flight.separation_m[-1] > 15.0)


@pytest.mark.parametrize(
    ("seeds", "changes"), [(FEW, (SHORT,)), pytest.param(SEEDS, (), marks=pytest.mark.long)]
)
@pytest.mark.parametrize("figure", ["mean_abs_error_m", "rmsd_m"])
def test_echowing_is_ahead_of_gray_and_of_the_thesis(
    figure: str, seeds: range, changes: tuple[str, ...]
) -> None:
    ours, gray, thesis = (
        [flown(law, seed, *changes) for seed in seeds] for law in ("echowing", "gray", "thesis")
    )
    unlocked = [one for one in thesis if one.metrics[0].mean_abs_error_m < LOST_M]

    # Even leaving out the flights that the thesis law lost.
    for others in (gray, thesis, unlocked):
        assert mean_of(ours, figure) < mean_of(others, figure)


@pytest.mark.parametrize("seed", FEW)
def test_echowing_never_comes_within_a_metre(seed: int) -> None:
    assert flown("echowing", seed, SHORT).closest_m > 1.0


def test_a_sonar_that_sees_its_leader_most_of_the_time() -> None:
    seen = [flown("echowing", seed, SHORT).metrics[0].seen_share for seed in FEW]

    assert statistics.mean(seen) > 0.6
