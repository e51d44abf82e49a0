"""Formations by name: column, vee, echelon, line abreast, diamond. Pure.

A shape is steps along two arms, to the leader's right and to the left, each as long as the
spacing. Each follower hangs on the one that is a step ahead of it, at whom its sonar looks: nobody
stands between, and no two sonars face each other. So a line abreast has one arm: on both sides of
the leader the sonars would look at each other.
"""

import math
from collections.abc import Iterator
from itertools import count, islice
from typing import Literal, get_args

from echowing.errors import EchowingError, nearest
from echowing.flight.guidance import SMALLEST_RADIUS_M, Slot

Shape = Literal["column", "vee", "echelon", "abreast", "diamond"]
SHAPES: tuple[str, ...] = get_args(Shape)
# What has been flown by name (RESULTS.md).
MOST_FOLLOWERS = 12
# How far an arm is off the tail, by shape. Two arms at 35 degrees begin 1.15 spacings apart.
_ARM_DEG = {
    "column": 0.0,
    "echelon": 35.0,
    "vee": 35.0,
    "abreast": 90.0,
    "diamond": 45.0,
    "wedge": 45.0,
}
# Steps along the right arm, and along the left one.
_Cell = tuple[int, int]


def shape(name: str, followers: int, spacing_m: float) -> tuple[Slot, ...]:
    """A slot for each follower; `spacing_m` is between each and the one that its sonar watches.

    No two vehicles are nearer to each other than that. Raises EchowingError for what is no shape.
    """
    if name not in SHAPES:
        raise EchowingError(f"no shape {name!r}: give {', '.join(SHAPES)}{nearest(name, SHAPES)}")
    if not 1 <= followers <= MOST_FOLLOWERS:
        raise EchowingError(f"{name}: {followers} followers: give 1 to {MOST_FOLLOWERS}")
    if not SMALLEST_RADIUS_M <= spacing_m < math.inf:
        raise EchowingError(
            f"{name}: a spacing of {spacing_m:g} m: give {SMALLEST_RADIUS_M:g} m or more"
        )
    return arranged(name, followers, spacing_m)


def arranged(name: str, followers: int, spacing_m: float) -> tuple[Slot, ...]:
    """As `shape`, for any number of followers, and for a `wedge` too: a vee that is filled."""
    arm_rad = math.radians(_ARM_DEG[name])
    cells = list(islice(_cells(name), followers))
    slots = []
    for right, left in cells:
        to_the_right = right >= left
        watched = (right - 1, left) if to_the_right else (right, left - 1)
        behind = None if watched == (0, 0) else cells.index(watched)
        slots.append(Slot(spacing_m, arm_rad if to_the_right else -arm_rad, behind=behind))
    return tuple(slots)


def _cells(name: str) -> Iterator[_Cell]:
    """Where the followers of a shape are, each behind one that came before it."""
    for row in count(1):
        if name == "vee":
            yield from ((row, 0), (0, row))
        elif name == "wedge":
            yield from ((row - left, left) for left in range(row + 1))
        elif name == "diamond":  # squares that stand on a corner, one round the other
            yield from (cell for near in range(row) for cell in ((row, near), (near, row)))
            yield row, row
        else:
            yield row, 0
