"""How well a formation keeps together, by the figures used for flocks and swarms. Pure.

Reynolds' three rules (Flocks, Herds, and Schools, SIGGRAPH 1987) as figures: separation is the
distance to the nearest neighbour, alignment the difference from the mean velocity, cohesion the
extent about the centre. Couzin's two figures of a group (Couzin et al., J. Theor. Biol. 218, 2002):
polarisation, 1 where all fly the same way, and rotation about the centre, 1 where all go round it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Floats
from echowing.campaign.record import FlightRecord

# Two are a pair; three are a group.
LEAST_FOLLOWERS = 3
# A formation has begun to follow by then: the leader's mission starts after 5 s.
SETTLED_S = 20.0
# Slower than this a vehicle has no direction of flight: it wanders with its receiver.
FLIES_MPS = 0.5


@dataclass(frozen=True)
class Swarm:
    """Means over the followers and over a flight from SETTLED_S on.

    nearest_m: horizontal distance to the nearest other follower; misaligned_mps: speed against the
    formation's mean velocity; spread: root mean square distance from the centre, as a share of what
    the slots ask for; polarisation, rotation: 0 to 1, of those that fly; held: share of the time
    in which a follower was held.
    """

    nearest_m: float
    misaligned_mps: float
    spread: float
    polarisation: float
    rotation: float
    held: float


def swarm(record: FlightRecord) -> Swarm | None:
    """The figures of a flight; None: too few followers, too short, or nobody flew on."""
    settled = record.time_s >= SETTLED_S
    if record.follower_count < LEAST_FOLLOWERS or not settled.any():
        return None
    place_m = record.position_ned_m[settled, 1:, :2]
    velocity_mps = record.velocity_ned_mps[settled, 1:, :2]
    from_centre_m = place_m - place_m.mean(axis=1, keepdims=True)
    against_mps = velocity_mps - velocity_mps.mean(axis=1, keepdims=True)
    held = np.array(record.hold, dtype=object)[settled] != ""
    directions = [
        (_polarisation(one), _rotation(one, there))
        for one, there in zip(velocity_mps, from_centre_m, strict=True)
        if (np.linalg.norm(one, axis=1) >= FLIES_MPS).any()
    ]
    if not directions:
        return None
    polarisation, rotation = np.mean(directions, axis=0)
    return Swarm(
        nearest_m=float(np.mean([_nearest_m(one) for one in place_m])),
        misaligned_mps=float(np.linalg.norm(against_mps, axis=2).mean()),
        spread=_extent_m(from_centre_m) / _extent_m(_slots_m(record)),
        polarisation=float(polarisation),
        rotation=float(rotation),
        held=float(held.mean()),
    )


def _nearest_m(place_m: Floats) -> float:
    """Mean distance to the nearest other, of places (f, 2)."""
    apart_m = np.linalg.norm(place_m[:, None] - place_m[None], axis=2)
    np.fill_diagonal(apart_m, np.inf)
    return float(apart_m.min(axis=1).mean())


def _extent_m(from_centre_m: NDArray[np.float64]) -> float:
    """Root mean square distance from the centre, of vectors (…, 2)."""
    return float(np.sqrt((from_centre_m**2).sum(axis=-1).mean()))


def _slots_m(record: FlightRecord) -> Floats:
    """The slots from their centre, (f, 2); which way the formation points does not matter."""
    slots = record.scenario.slots()
    angles_rad = np.array([slot.angle_rad for slot in slots])
    radii_m = np.array([slot.radius_m for slot in slots])
    place_m = radii_m[:, None] * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    return np.asarray(place_m - place_m.mean(axis=0))


def _polarisation(velocity_mps: Floats) -> float:
    """Length of the mean direction of those that fly, of velocities (f, 2)."""
    return float(np.linalg.norm(_directions(velocity_mps, FLIES_MPS).mean(axis=0)))


def _rotation(velocity_mps: Floats, from_centre_m: Floats) -> float:
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
