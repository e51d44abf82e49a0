"""The leads that move with the gimbal: where they run at a pose, how sharply they bend.

A lead is clamped at both ends and keeps its length: an elastic rod. It takes the shape that bends
least.
"""

from dataclasses import dataclass

import numpy as np

from echowing.rig.search import Aim
from hwtools.facts import HardwareError
from hwtools.rig import Point, Points, rotation

PIECES = 24  # of the chain
LENGTH_WEIGHT = 10.0  # a piece that is 0.1 mm off counts as much as a bend of 1 mm in it
SETTLED = 1e-5  # part of the cost that a round must still gain
ROUNDS = 400
BACK = np.array([-1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Lead:
    """A lead's moving piece: where it starts, gimbal centred, and where the clamp's tie holds it.

    It leaves both backwards. tilts: it starts on the cradle, else on the yoke.
    """

    name: str
    start: Point
    tie: Point
    pivot: Point
    tilts: bool
    diameter_mm: float
    free_mm: float


def curve(lead: Lead, aim: Aim) -> Points:
    """Return the lead's points at a pose, from the gimbal to the tie.

    Raises:
        HardwareError: it is too short to reach.

    """
    turn = rotation(aim if lead.tilts else Aim(aim.right_deg, 0.0))
    start, way = turn @ (lead.start - lead.pivot) + lead.pivot, turn @ BACK
    piece_mm = lead.free_mm / PIECES
    ends = np.array([start, start + piece_mm * way, lead.tie + piece_mm * BACK, lead.tie])
    if np.linalg.norm(ends[2] - ends[1]) > 0.98 * (PIECES - 2) * piece_mm:
        raise HardwareError(f"the {lead.name} is too short at {aim}: make it longer")
    return _relaxed(ends, piece_mm)


def bend_radius_mm(points: Points) -> float:
    """Return the smallest radius of the circles through three points in turn."""
    a, b, c = points[:-2], points[1:-1], points[2:]
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    with np.errstate(divide="ignore"):
        radii = sides[0] * sides[1] * sides[2] / (4 * area)
    return float(radii.min())


def _relaxed(ends: Points, piece_mm: float) -> Points:
    """Return the chain that bends least; its first and last piece are held.

    Levenberg and Marquardt's least squares: the bends, and heavily the pieces' lengths.
    """
    points = _first_guess(ends, piece_mm)
    bend = np.kron(np.diff(np.eye(len(points)), n=2, axis=0), np.eye(3))[:, 6:-6]
    damping, cost = 1e-3, _cost(points, piece_mm)
    for _ in range(ROUNDS):
        slopes, misses = _lengths(points, piece_mm)
        jacobian = np.vstack([bend, LENGTH_WEIGHT * slopes])
        residual = np.concatenate([np.diff(points, n=2, axis=0).ravel(), LENGTH_WEIGHT * misses])
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.eye(len(normal)), -jacobian.T @ residual)
        tried = points.copy()
        tried[2:-2] += step.reshape(-1, 3)
        gained = cost - _cost(tried, piece_mm)
        damping *= 0.3 if gained > 0 else 10.0
        if gained > 0:
            points, cost = tried, cost - gained
        if 0 <= gained < SETTLED * cost or damping > 1e9:
            break
    return points


def _first_guess(ends: Points, piece_mm: float) -> Points:
    t = np.linspace(0.0, 1.0, PIECES - 1)[:, None]
    handle = PIECES / 3
    corners = (
        ends[1],
        ends[1] + handle * (ends[1] - ends[0]),
        ends[2] + handle * (ends[2] - ends[3]),
        ends[2],
    )
    weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
    between = sum(w * corner for w, corner in zip(weights, corners, strict=True))
    guess: Points = np.vstack([ends[:1], between, ends[3:]])
    return guess


def _lengths(points: Points, piece_mm: float) -> tuple[Points, Points]:
    """Return how each free piece is off its length, and how that grows with the free points."""
    away = np.diff(points, axis=0)
    length = np.linalg.norm(away, axis=1)
    pieces = np.arange(1, len(away) - 1)
    slopes = np.zeros((len(pieces), len(points), 3))
    slopes[pieces - 1, pieces] = -(away / length[:, None])[pieces]
    slopes[pieces - 1, pieces + 1] = (away / length[:, None])[pieces]
    return slopes[:, 2:-2].reshape(len(pieces), -1), length[pieces] - piece_mm


def _cost(points: Points, piece_mm: float) -> float:
    misses = np.linalg.norm(np.diff(points, axis=0), axis=1)[1:-1] - piece_mm
    return float(
        (np.diff(points, n=2, axis=0) ** 2).sum()
        + (LENGTH_WEIGHT * misses**2).sum() * LENGTH_WEIGHT
    )
