"""What sonars make of a formation: who can watch whom, and how sure of each other two are. Pure.

Places are rows (back, right, up) in metres from the leader, who is row 0 and flies straight on;
followers are rows 1 to N, from the front to the back. Each sonar ties the receivers of two vehicles
together. A follower has one sonar and watches a vehicle before it, so N sonars tie N + 1 vehicles
to a tree: between any two there is one way, and its variance is the sum over its sonars, as in
`flight.known.Known.sigma_m` (resistances in series; a tree has none in parallel).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echowing.flight.belief import Curve
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.formation import IN_SLOT_M

Array = NDArray[np.float64]
LEADER = 0
# What a sonar leaves open of two receivers' disagreement: a standard deviation along its axis, and
# across as an angle. Means of `Cloud.sigma_m` in 15 flights of `echowing sim echowing` (seeds 11 to
# 14, slots of 2.8 to 3.5 m, from 40 s on): 0.19 m; across 0.36 m at 2.8 m, 0.42 m at 3.5 m. In one
# more flight, at 3.25 m, the sonar did not find its leader.
ALONG_SIGMA_M, ACROSS_RAD = 0.19, math.radians(7.0)
# A metre out of sight is more than any uncertainty, in square metres per metre.
OUT_OF_SIGHT = 1e3


@dataclass(frozen=True, slots=True)
class Sight:
    """What a sonar can watch.

    range_m: least and most to who is watched. view_rad, tilt_rad: most to each side of the course,
    and up and down. beam_rad: half angle within which a nearer vehicle is heard
    instead, over that one's distance.
    """

    range_m: tuple[float, float]
    view_rad: float
    tilt_rad: float
    beam_rad: Curve


@dataclass(frozen=True, slots=True)
class Geometry:
    """Of places: `to_m[i, j]` leads from i to j, `far_m` is its length."""

    to_m: Array
    far_m: Array

    @classmethod
    def of(cls, places_m: Array) -> "Geometry":
        """From (N + 1, 3) places."""
        to_m = places_m[np.newaxis] - places_m[:, np.newaxis]
        return cls(to_m, np.sqrt((to_m * to_m).sum(axis=2)))


def tie_sigma_m(range_m: Array) -> Array:
    """Standard deviation of what one sonar leaves open at a range: the larger of its two axes."""
    across: Array = np.maximum(ALONG_SIGMA_M, range_m * math.tan(ACROSS_RAD))
    return np.minimum(UNRANGED_SIGMA_M, across)


def out_of_sight_m(geometry: Geometry, sight: Sight) -> Array:
    """[i, j]: how many metres j is off what the sonar of i can watch, past all others; 0: it can.

    Who is not ahead is never watched: so nobody watches in a circle.
    """
    to_m, far_m = geometry.to_m, geometry.far_m
    ahead_m, level_m = -to_m[..., 0], np.hypot(to_m[..., 0], to_m[..., 1])
    aside_rad = np.arctan2(np.abs(to_m[..., 1]), ahead_m) - sight.view_rad
    above_rad = np.arctan2(np.abs(to_m[..., 2]), level_m) - sight.tilt_rad
    near_m, most_m = sight.range_m
    off_m = np.maximum(near_m - far_m, 0.0) + np.maximum(far_m - most_m, 0.0)
    off_m += far_m * (np.maximum(aside_rad, 0.0) + np.maximum(above_rad, 0.0))
    off_m[ahead_m <= 0.0] += far_m.max() + most_m
    return off_m


def in_the_way_m(geometry: Geometry, sight: Sight) -> Array:
    """[i, j, k]: how many metres k is inside the beam in which i watches j; 0: it is not."""
    to_m, far_m = geometry.to_m, geometry.far_m
    unit = to_m / np.maximum(far_m, 1e-9)[..., np.newaxis]
    off_rad = np.arccos(np.clip(np.einsum("ija,ika->ijk", unit, unit), -1.0, 1.0))
    beam_rad = np.asarray(sight.beam_rad.at(far_m))
    inside_m = (beam_rad[:, np.newaxis] - off_rad) * far_m[:, np.newaxis]
    nearer_m = far_m[:, :, np.newaxis] + IN_SLOT_M - far_m[:, np.newaxis]
    blocked: Array = np.maximum(0.0, np.minimum(inside_m, nearer_m))
    each = np.arange(len(far_m))
    blocked[each, :, each] = 0.0  # oneself
    blocked[:, each, each] = 0.0  # who is watched
    return blocked


def watched(off_m: Array, tie_m: Array) -> list[int]:
    """Whom the sonars of followers 1 to N watch: who leaves the worst pair the surest.

    off_m[i, j]: how many metres j is out of sight of i; if nobody is in sight, the nearest to it
    counts. tie_m[i, j]: standard deviation of the sonar of i on j.
    """
    way_m2 = np.zeros_like(tie_m)
    watches: list[int] = []
    for one in range(1, len(tie_m)):
        worst_m2 = way_m2[:one, :one].max(axis=1) + tie_m[one, :one] ** 2
        its = int(np.argmin(worst_m2 + OUT_OF_SIGHT * off_m[one, :one]))
        watches.append(its)
        way_m2[one, :one] = way_m2[:one, one] = way_m2[its, :one] + tie_m[one, its] ** 2
    return watches


def pair_sigma_m(watches: Sequence[int], tie_m: Array) -> Array:
    """Standard deviation of what is known of any two: over the sonars between them.

    No more than what receivers leave open without any sonar. Arguments as `watched` has them.
    """
    way_m2 = np.zeros_like(tie_m)
    for one, its in enumerate(watches, 1):
        way_m2[one, :one] = way_m2[:one, one] = way_m2[its, :one] + tie_m[one, its] ** 2
    return np.minimum(UNRANGED_SIGMA_M, np.sqrt(way_m2))


def pair_links(watches: Sequence[int]) -> NDArray[np.int_]:
    """How many sonars are between any two."""
    links = np.zeros((len(watches) + 1, len(watches) + 1), int)
    for one, its in enumerate(watches, 1):
        links[one, :one] = links[:one, one] = links[its, :one] + 1
    return links


def without_spare_m(off_m: Array, blocked_m: Array) -> Array:
    """[i, k]: how many metres i lacks to watch somebody once follower k is lost; 0: it can.

    off_m: as seen past all others (`blocked_m` of `in_the_way_m`). Everybody stays in its slot and
    turns its sonar. Without its leader there is no formation, so nobody asks what is left then.
    """
    count = len(off_m)
    left_m = off_m[..., np.newaxis] - blocked_m
    each = np.arange(1, count)
    left_m[:, each, each] = np.inf  # nobody can watch it
    left_m[each, :, each] = 0.0  # and it needs nobody
    missing_m: Array = np.maximum(0.0, left_m.min(axis=1))
    missing_m[LEADER] = missing_m[:, LEADER] = 0.0
    return missing_m
