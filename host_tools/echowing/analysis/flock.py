"""Figures of a group that flies together: Reynolds's and Couzin's, and whether it is in one piece.

Reynolds's three rules (Flocks, Herds, and Schools, SIGGRAPH 1987) ask for a distance to the
nearest neighbour, for one velocity and for a small extent about the centre. Couzin's figures
(Couzin et al., J. Theor. Biol. 218, 2002) are polarisation, 1 where all fly the same way, and
rotation about the centre, 1 where all go round it.
"""

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Floats

# Slower than this a vehicle has no direction of flight: it wanders with its receiver.
FLIES_MPS = 0.5


def in_one_piece(place_m: Floats, link_m: float) -> bool:
    """Whether links that are no longer than this join all places (f, 3)."""
    apart_m = np.linalg.norm(place_m[:, None] - place_m[None], axis=2)
    return bool(nx.is_connected(nx.from_numpy_array(apart_m <= link_m)))


def nearest_m(place_m: Floats) -> float:
    """Mean distance to the nearest other, of places (f, 2)."""
    apart_m = np.linalg.norm(place_m[:, None] - place_m[None], axis=2)
    np.fill_diagonal(apart_m, np.inf)
    return float(apart_m.min(axis=1).mean())


def extent_m(from_centre_m: NDArray[np.float64]) -> float:
    """Root mean square distance from the centre, of vectors (…, 2)."""
    return float(np.sqrt((from_centre_m**2).sum(axis=-1).mean()))


def polarisation(velocity_mps: Floats) -> float:
    """Length of the mean direction of those that fly, of velocities (f, 2)."""
    return float(np.linalg.norm(_directions(velocity_mps, FLIES_MPS).mean(axis=0)))


def rotation(velocity_mps: Floats, from_centre_m: Floats) -> float:
    """Size of the mean turning moment about the centre, of directions only."""
    flies = np.linalg.norm(velocity_mps, axis=1) >= FLIES_MPS
    outwards, onwards = _directions(from_centre_m[flies]), _directions(velocity_mps[flies])
    moments = outwards[:, 0] * onwards[:, 1] - outwards[:, 1] * onwards[:, 0]
    return float(abs(moments.mean()))


def _directions(vectors: Floats, least: float = 0.0) -> Floats:
    """Unit vectors of those that are long enough, (n, 2)."""
    lengths = np.linalg.norm(vectors, axis=1)
    chosen = lengths >= least
    return np.asarray(vectors[chosen] / np.maximum(lengths[chosen], 1e-9)[:, None])
