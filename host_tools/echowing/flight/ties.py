"""What receivers disagree by, any two of them, from what sonars tell of some pairs. Pure.

A sonar tells what two receivers disagree by, not which of them is off. But all are as likely to be
off, each by itself: so one that disagrees with several others is itself the one that is off, and a
vehicle that no sonar has heard yet most likely disagrees with it, too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Link(NamedTuple):
    """What a sonar tells: by how much the watched receiver is off, less the follower's.

    (north, east) metres; sigma_m: standard deviation per axis.
    """

    follower_id: int
    watched_id: int
    north_m: float
    east_m: float
    sigma_m: float


@dataclass(frozen=True)
class Errors:
    """Each one's error, (n, 2) metres north and east, and their covariance per axis, (n, n)."""

    system_ids: Sequence[int]
    error_m: Array
    covariance_m2: Array

    def between(self, watched_id: int, follower_id: int) -> tuple[float, float, float]:
        """What two disagree by, as in `Link`, and the standard deviation of that per axis."""
        a, b = self.system_ids.index(watched_id), self.system_ids.index(follower_id)
        north_m, east_m = self.error_m[a] - self.error_m[b]
        of, both = self.covariance_m2, self.covariance_m2[a, b]
        return float(north_m), float(east_m), math.sqrt(of[a, a] + of[b, b] - 2.0 * both)


def errors(system_ids: Sequence[int], links: Sequence[Link], receiver_sigma_m: float) -> Errors:
    """All receivers' errors; receiver_sigma_m: how far each is off per axis, standard deviation."""
    known = np.eye(len(system_ids)) / receiver_sigma_m**2
    told = np.zeros((len(system_ids), 2))
    for link in links:
        # A sonar that has heard nothing tells what two receivers do by themselves.
        new = 1.0 / link.sigma_m**2 - 1.0 / (2.0 * receiver_sigma_m**2)
        if new <= 0.0:
            continue
        a, b = system_ids.index(link.watched_id), system_ids.index(link.follower_id)
        known[[a, b], [a, b]] += new
        known[[a, b], [b, a]] -= new
        off = np.array((link.north_m, link.east_m)) / link.sigma_m**2
        told[a] += off
        told[b] -= off
    covariance = np.asarray(np.linalg.inv(known), np.float64)
    return Errors(system_ids, covariance @ told, covariance)
