"""How far receivers wander, and how smoothly, is learnt within a minute of readings."""

import math
import random

import numpy as np
import pytest

from echowing.flight.cloud import Wandering
from echowing.flight.receivers import FURTHER, LEAST_SHARE, Receivers, passing
from echowing.sim.world.gps import Drift, Errors

# Followed by a cell's own time: what lies between two is learnt more slowly.
AS_BELIEVED, FURTHER_OFF = (
    Errors(sigma_m=sigma_m, tau_s=60.0, follows_s=1.0) for sigma_m in (0.8, 1.6)
)
STEP_S = 0.05
READING_S = 0.25
SIGMA_M = 0.15


def new() -> Receivers:
    believed = Wandering()
    return Receivers(believed.sigma_m, believed.sigma_spread, believed.tau_s)


def wander_m(receivers: Receivers) -> float:
    return float(receivers.share @ receivers.sigma_m)


def follows_s(receivers: Receivers) -> float:
    return float(receivers.share @ receivers.follows_s)


def seen(
    errors: Errors,
    seed: int,
    seconds: float,
    turns_rps: float = 0.0,
    receivers: Receivers | None = None,
) -> Receivers:
    """What is learnt of two receivers from a leader whose bearing turns."""
    receivers = receivers or new()
    begins_s = receivers.seen_s if math.isfinite(receivers.seen_s) else 0.0
    leader = Drift(errors, lambda name: random.Random(f"{seed} leader {name}"))
    follower = Drift(errors, lambda name: random.Random(f"{seed} follower {name}"))
    chance = random.Random(seed)
    for number in range(round(seconds / READING_S)):
        for _ in range(round(READING_S / STEP_S)):
            its, own = leader.step(STEP_S), follower.step(STEP_S)
        time_s = begins_s + (number + 1) * READING_S
        along = math.cos(turns_rps * time_s), math.sin(turns_rps * time_s)
        off_m = (its[0] - own[0]) * along[0] + (its[1] - own[1]) * along[1]
        receivers.take(time_s, along, off_m + chance.gauss(0.0, SIGMA_M), SIGMA_M)
    return receivers


def test_at_first_two_of_three_wander_as_believed_and_hardly_one_thrice_as_far() -> None:
    """The logarithm's spread is 0.4: half are below 0.8 m, and a sixth up to a fifth further."""
    receivers = new()
    by_sigma = receivers.share.reshape(3, len(FURTHER)).sum(axis=0)

    assert by_sigma[0] == pytest.approx(0.66, abs=0.01)
    assert by_sigma[-1] < 0.005
    assert math.sqrt(receivers.share @ receivers.sigma_m**2) == pytest.approx(1.25 * 0.8, rel=0.02)
    assert receivers.share.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("turns_rps", [0.0, 0.1], ids=["straight", "turning"])
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_receivers_that_wander_further_are_known_in_a_minute(seed: int, turns_rps: float) -> None:
    """In a minute it is known to a tenth or so, and a cell is 1.4 times as far as the next."""
    learnt_m = wander_m(seen(FURTHER_OFF, seed, 60.0, turns_rps))

    assert learnt_m == pytest.approx(1.6, rel=0.3)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_receivers_as_believed_stay_so(seed: int) -> None:
    assert wander_m(seen(AS_BELIEVED, seed, 240.0)) < 1.0


def test_less_than_believed_is_not_learnt() -> None:
    """A quiet hour is no proof of a quiet minute; a leader would be lost for it."""
    assert wander_m(seen(Errors(sigma_m=0.3, tau_s=60.0), 1, 600.0)) >= 0.8


@pytest.mark.parametrize("truly_s", [0.3, 1.0, 1.5, 3.0])
def test_how_much_later_autopilots_follow_is_learnt_and_not_taken_for_quiet(truly_s: float) -> None:
    errors = Errors(sigma_m=1.6, tau_s=60.0, follows_s=truly_s)
    learnt = [seen(errors, seed, 240.0, 0.1) for seed in (1, 2, 3)]

    assert np.mean([follows_s(one) for one in learnt]) == pytest.approx(truly_s, rel=0.5)
    assert np.mean([wander_m(one) for one in learnt]) == pytest.approx(1.6, rel=0.2)


def test_receivers_that_change_are_learnt_again() -> None:
    """Ten quiet minutes, then trees: no cell is ever ruled out."""
    receivers = seen(Errors(sigma_m=0.8, tau_s=60.0), 1, 600.0)
    assert receivers.share.min() >= 0.9 * LEAST_SHARE

    seen(Errors(sigma_m=2.4, tau_s=60.0), 2, 30.0, receivers=receivers)

    assert wander_m(receivers) > 1.6


@pytest.mark.parametrize("follows", [0.3, 3.0])
def test_passing_is_the_same_in_one_step_and_in_many(follows: float) -> None:
    """Variance of what follows a drift that was known, after 2 s: once, and in 400 steps."""
    kept, left, part = passing(2.0, 60.0, np.array((follows,)))
    at_once = part[0] ** 2 * (1.0 - kept * kept)
    kept, left, part = passing(0.005, 60.0, np.array((follows,)))
    moves = np.array(((kept, 0.0), ((1.0 - left[0]) * kept, left[0])))
    shape = np.array((1.0, part[0]))
    covariance = np.zeros((2, 2))
    for _ in range(400):
        covariance = moves @ covariance @ moves.T + (1.0 - kept * kept) * np.outer(shape, shape)

    assert covariance[1, 1] == pytest.approx(at_once, rel=0.03)
