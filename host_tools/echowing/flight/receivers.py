"""How far two receivers wander apart, how soon they forget that, and how both are learnt. Pure.

It is of what is left when vehicles' own velocities have told their part of it (`drift`).

A receiver's error drifts, and what its autopilot believes follows it a little later, smoothly. Both
are modelled: taken for a random walk, the smooth path of a receiver that wanders far looks like
that of one that wanders less.
"""

import math
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# How quickly receivers and barometers forget (correlation time).
FORGETS_S = 60.0
# What velocities leave of a receiver's drift (`drift`) changes more slowly, as they tell the quick
# part of it: 86 s on ArduCopter SITL 4.8, eight vehicles (tests/sitl/follows.py), and the same in
# the simulator, of receivers that forget in 60 s. Reports too far apart to tell anything
# (`LONGEST_GAP_S`) leave all of it, which forgets sooner.
REST_FORGETS_S = 90.0
# Some forget sooner: those of a flight that broke the promise in 20 s; like receivers side by side
# in 23 to 158 s (RESULTS.md). Two minutes of readings tell 20 s from 90 s, 30 s in half of the
# cases, 45 s not. How many are quick is a guess.
QUICKLY_S, QUICK_SHARE = 25.0, 0.2
# How much further than believed receivers may wander. Not less: that costs the leader if it is
# wrong.
FURTHER = (1.0, 1.4, 2.0, 2.8, 4.0)
# How much later an autopilot follows. EKF3 does by 1.5 s on ArduCopter SITL; where its velocity has
# told the rest, less is left. One that follows by 3 s is taken for a receiver that wanders a
# quarter less. To learn that, too, gained nothing in flight, at 0.3, 1.5 and 3 s.
FOLLOWS_S = 1.0
# What is learnt of a pair fades in that time: what is over its receivers changes. Else who keeps
# far off, as they wandered far, would never hear again.
CHANGES_S = 120.0


def passing(elapsed_s: float, follows_s: float) -> tuple[float, float]:
    """How what follows a drift changes.

    Returns `left`, `part`: where a drift d becomes kept * d + e, e by chance, what follows it, f,
    becomes left * f + (1 - left) * kept * d + part * e. Within the step the drift counts as a
    random walk, and its change and that of what follows it as one: over 0.25 s they truly agree to
    0.9.
    """
    # Below that the sum under the root is only rounding.
    ratio = max(elapsed_s / follows_s, 1e-6)
    left = math.exp(-ratio)
    part = math.sqrt(max(0.0, ratio + 2.0 * left - 0.5 * left * left - 1.5) / ratio)
    return left, part


class Receivers:
    """How far a pair of receivers wanders, and how soon it forgets that: how likely each cell is.

    A cell is one of `FURTHER`, forgotten slowly or quickly, with a Kalman filter of its own of the
    pair's drift and of what their autopilots believe, north and east (multiple models; Magill
    1965). With one time for all, what is forgotten quickly would count as what wanders twice as
    far.
    """

    def __init__(self, sigma_m: float, sigma_spread: float, tau_s: float) -> None:
        """sigma_m, sigma_spread, tau_s: as in `cloud.Wandering`."""
        # Those that wander less than believed count as the first.
        believed = NormalDist(sigma=sigma_spread)
        between = [believed.cdf(math.log(math.sqrt(a * b))) for a, b in pairwise(FURTHER)]
        # In this order neighbours are alike: as shares change, a guess moves from one to the next
        # (`cloud`).
        self.sigma_m: Array = sigma_m * np.array((*FURTHER[::-1], *FURTHER))
        """Of each receiver, per axis; by cell."""
        self.tau_s: Array = np.repeat((tau_s, QUICKLY_S), len(FURTHER))
        """Its correlation time, by cell."""
        further = np.diff([0.0, *between, 1.0])
        self._at_first: Array = np.concatenate(
            ((1.0 - QUICK_SHARE) * further[::-1], QUICK_SHARE * further)
        )
        self.share = self._at_first
        """How likely each cell is."""
        self.turn_to((0.0, 0.0), math.sqrt(float(self.share @ self._variance())))

    def turn_to(self, off_m: tuple[float, float], sigma_m: float) -> None:
        """Be of another pair; how far they wander stays.

        off_m: what they disagree by, (north, east); sigma_m: standard deviation of that, per axis.
        """
        variance = self._variance()
        variance *= sigma_m * sigma_m / float(self.share @ variance)
        # By cell: (drift north, drift east, believed north, believed east), and its covariance.
        self._state: Array = np.tile(off_m, (len(self.share), 2))
        self._covariance: Array = variance[:, None, None] * self._by_axis(np.ones((2, 2)))

    def take(
        self, along: tuple[float, float], off_m: float, sigma_m: float, wrong_per_m: float
    ) -> None:
        """Take what a reading says, which may be wrong.

        Each cell weighs it by how likely it is right (probabilistic data association; Bar-Shalom
        and Tse 1975): else one wild reading would make receivers of 0.8 m count as ones of 3 m. How
        likely a right one is heard at all is left out.

        Args:
            along: unit vector (north, east).
            off_m: what they were seen to disagree by along it.
            sigma_m: standard deviation of that.
            wrong_per_m: how likely it is wrong and says so, for each metre of range.

        """
        seen = np.array((0.0, 0.0, *along))
        shared = self._covariance @ seen
        variance = shared @ seen + sigma_m * sigma_m
        surprise = off_m - self._state @ seen
        fits = np.exp(-0.5 * surprise**2 / variance) / np.sqrt(2.0 * math.pi * variance)
        right = (fits / (fits + wrong_per_m))[:, None]
        gain = shared / variance[:, None]
        step = gain * surprise[:, None]
        unsure = (1.0 - right) * step
        self._state = self._state + right * step
        self._covariance = self._covariance + right[:, :, None] * (
            unsure[:, :, None] * step[:, None, :] - gain[:, :, None] * shared[:, None, :]
        )
        self.share = self.share * (fits + wrong_per_m)
        self.share /= self.share.sum()

    def wander(self, elapsed_s: float) -> None:
        """Let them drift on."""
        kept = np.exp(-elapsed_s / self.tau_s)
        left, part = passing(elapsed_s, FOLLOWS_S)
        follows = self._by_axis(np.array(((1.0, 0.0), (1.0 - left, left))))
        moves = np.tile(follows, (len(kept), 1, 1))
        moves[:, :, :2] *= kept[:, None, None]
        change = self._by_axis(np.array(((1.0, part), (part, part * part))))
        variance = (self._variance() * (1.0 - kept * kept))[:, None, None]
        self._state = (moves @ self._state[:, :, None])[:, :, 0]
        self._covariance = moves @ self._covariance @ moves.transpose(0, 2, 1) + variance * change
        forgotten = -math.expm1(-elapsed_s / CHANGES_S)
        self.share = self.share + forgotten * (self._at_first - self.share)

    def _variance(self) -> Array:
        """Of the difference of two receivers that wander alike."""
        return 2.0 * self.sigma_m**2

    @staticmethod
    def _by_axis(of_one: Array) -> Array:
        """The same for north and for east: 2 x 2 become 4 x 4."""
        both = np.zeros((4, 4))  # as `np.kron` with a unit matrix, which takes ten times as long
        both[::2, ::2] = both[1::2, 1::2] = of_one
        return both
