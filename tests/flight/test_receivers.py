"""How far receivers wander, and how smoothly, is learnt within a minute of readings."""

import math
import random

import numpy as np
import pytest

from echowing.flight.cloud import Wandering
from echowing.flight.receivers import (
    CHANGES_S,
    QUICK_SHARE,
    QUICKLY_S,
    REST_FORGETS_S,
    Receivers,
    passing,
)

TAU_S = REST_FORGETS_S
STEP_S = 0.05
READING_S = 0.25
SIGMA_M = 0.15
# One reading in fifty is wrong, and says anything within 4 m.
WRONG_PER_M = 0.02 / 4.0


class Pair:
    """What the autopilots of two receivers disagree by, (north, east): as `receivers` has it."""

    def __init__(self, sigma_m: float, tau_s: float, follows_s: float, seed: int) -> None:
        self._chance, self._sigma_m = np.random.default_rng(seed), math.sqrt(2.0) * sigma_m
        self._keep, self._blend = math.exp(-STEP_S / tau_s), -math.expm1(-STEP_S / follows_s)
        self._drift_m = self._chance.normal(0.0, self._sigma_m, 2)
        self.off_m = self._drift_m.copy()

    def step(self) -> None:
        kick_m = self._sigma_m * math.sqrt(1.0 - self._keep**2)
        self._drift_m = self._keep * self._drift_m + self._chance.normal(0.0, kick_m, 2)
        self.off_m += self._blend * (self._drift_m - self.off_m)


def new() -> Receivers:
    believed = Wandering()
    return Receivers(believed.sigma_m, believed.sigma_spread, believed.tau_s)


def wander_m(receivers: Receivers) -> float:
    return float(receivers.share @ receivers.sigma_m)


def seen(
    sigma_m: float,
    seed: int,
    seconds: float,
    turns_rps: float = 0.0,
    receivers: Receivers | None = None,
    follows_s: float = 1.0,
    tau_s: float = TAU_S,
) -> Receivers:
    """What is learnt of two receivers from a leader whose bearing turns.

    Followed by a cell's own time: what lies between two is learnt more slowly.
    """
    receivers = receivers or new()
    pair, chance = Pair(sigma_m, tau_s, follows_s, seed), random.Random(seed)
    for number in range(round(seconds / READING_S)):
        for _ in range(round(READING_S / STEP_S)):
            pair.step()
        time_s = (number + 1) * READING_S
        receivers.wander(READING_S)
        along = math.cos(turns_rps * time_s), math.sin(turns_rps * time_s)
        off_m = float(pair.off_m @ along)
        off_m += chance.gauss(0.0, SIGMA_M)
        receivers.take(along, off_m, SIGMA_M, WRONG_PER_M)
    return receivers


def test_at_first_six_of_ten_wander_as_believed_and_one_in_fifteen_thrice_as_far() -> None:
    """The logarithm's spread is 0.8: half are below 0.8 m, and a twelfth up to a fifth further."""
    receivers = new()
    slowly, quickly = np.split(receivers.share, 2)

    assert slowly[-1] + quickly[0] == pytest.approx(0.58, abs=0.01)
    assert slowly[0] + quickly[-1] == pytest.approx(1.0 / 15.0, abs=0.005)
    assert quickly.sum() == pytest.approx(QUICK_SHARE)
    assert math.sqrt(receivers.share @ receivers.sigma_m**2) == pytest.approx(1.73 * 0.8, rel=0.02)
    assert receivers.share.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("turns_rps", "seems_m"), [(0.0, 1.25), (0.1, 1.5)], ids=["straight", "turning"]
)
def test_receivers_that_wander_further_are_partly_known_in_a_minute(
    turns_rps: float, seems_m: float
) -> None:
    """They are of 1.6 m, and 1.2 m is believed at first: quick ones of less explain as much.

    What is learnt fades in two minutes, too. A straight line shows one axis of two.
    """
    learnt_m = [wander_m(seen(1.6, seed, 60.0, turns_rps)) for seed in range(12)]

    assert np.median(learnt_m) == pytest.approx(seems_m, rel=0.15)
    assert min(learnt_m) > 0.9


@pytest.mark.parametrize(("sigma_m", "most_m"), [(0.8, 1.15), (1.5, 2.2)])
def test_what_is_forgotten_quickly_does_not_count_as_what_wanders_far(
    sigma_m: float, most_m: float
) -> None:
    """With 90 s for all, receivers that forget in 20 s are learnt to wander twice as far."""
    learnt = [seen(sigma_m, seed, 90.0, 0.1, tau_s=20.0) for seed in range(8)]

    assert sigma_m <= np.mean([wander_m(one) for one in learnt]) < most_m
    quick = [one.share[one.tau_s == QUICKLY_S].sum() for one in learnt]
    assert np.mean(quick) > 2.0 * QUICK_SHARE


def test_a_wild_reading_is_not_receivers_that_wander_far() -> None:
    """Of 1.5 m, after a minute of right ones. Taken for right it makes them of 3.1 m."""
    for seed in range(8):
        receivers = seen(0.8, seed, 60.0)
        off_m = float(receivers._state[:, 2] @ receivers.share)
        receivers.wander(READING_S)
        receivers.take((1.0, 0.0), off_m + 1.5, SIGMA_M, WRONG_PER_M)
        assert wander_m(receivers) < 1.1


def test_a_step_is_believed_once_readings_agree_on_it() -> None:
    """Of 1.5 m between one reading and the next: that one may be wrong, five of them are not."""
    receivers = seen(0.8, 1, 60.0)
    off_m = [float(receivers._state[:, 2] @ receivers.share)]
    for _ in range(5):
        receivers.wander(READING_S)
        receivers.take((1.0, 0.0), off_m[0] + 1.5, SIGMA_M, WRONG_PER_M)
        off_m.append(float(receivers._state[:, 2] @ receivers.share))

    assert off_m[1] - off_m[0] < 0.1
    assert off_m[5] - off_m[0] == pytest.approx(1.5, abs=0.1)


def test_what_is_forgotten_slowly_is_known_as_that() -> None:
    learnt = [seen(0.8, seed, 90.0, 0.1) for seed in range(8)]

    assert np.mean([one.share[one.tau_s == QUICKLY_S].sum() for one in learnt]) < 0.1


def test_receivers_as_believed_stay_so() -> None:
    """Between the first cell, 0.8 m, and the second, 1.12 m."""
    assert np.median([wander_m(seen(0.8, seed, 240.0)) for seed in range(8)]) < 0.9


def test_less_than_believed_is_not_learnt() -> None:
    """A quiet hour is no proof of a quiet minute; a leader would be lost for it."""
    assert wander_m(seen(0.3, 1, 600.0)) >= 0.8


@pytest.mark.parametrize(("follows_s", "seems_m"), [(0.3, 1.9), (1.0, 1.6), (3.0, 1.15)])
def test_one_that_is_followed_later_than_believed_seems_to_wander_less(
    follows_s: float, seems_m: float
) -> None:
    """Believed is 1 s. Taken for a random walk, receivers of 1.6 m would seem to be of 1.1 m."""
    learnt_m = [wander_m(seen(1.6, seed, 240.0, 0.1, follows_s=follows_s)) for seed in range(8)]

    assert np.mean(learnt_m) == pytest.approx(seems_m, rel=0.2)


def test_receivers_that_change_are_learnt_again() -> None:
    """Ten quiet minutes, then trees."""
    learnt_m = []
    for seed in range(8):
        receivers = seen(0.8, seed, 600.0)
        learnt_m.append(wander_m(seen(2.4, seed + 100, 30.0, receivers=receivers)))

    assert np.median(learnt_m) > 1.6


def test_of_whom_nothing_is_heard_what_was_learnt_is_forgotten() -> None:
    """Else one that keeps far off, as they wandered far, would never hear again."""
    receivers = seen(2.4, 1, 60.0)
    learnt_m, at_first_m = wander_m(receivers), wander_m(new())
    for _ in range(round(CHANGES_S / READING_S)):
        receivers.wander(READING_S)

    left = (wander_m(receivers) - at_first_m) / (learnt_m - at_first_m)
    assert left == pytest.approx(math.exp(-1.0), abs=0.01)


@pytest.mark.parametrize("follows", [0.3, 3.0])
def test_passing_is_the_same_in_one_step_and_in_many(follows: float) -> None:
    """Variance of what follows a drift that was known, after 2 s: once, and in 400 steps."""
    _, part = passing(2.0, follows)
    at_once = part**2 * -math.expm1(-2.0 * 2.0 / TAU_S)
    kept = math.exp(-0.005 / TAU_S)
    left, part = passing(0.005, follows)
    moves = np.array(((kept, 0.0), ((1.0 - left) * kept, left)))
    shape = np.array((1.0, part))
    covariance = np.zeros((2, 2))
    for _ in range(400):
        covariance = moves @ covariance @ moves.T + (1.0 - kept * kept) * np.outer(shape, shape)

    assert covariance[1, 1] == pytest.approx(at_once, rel=0.03)
