"""How well a formation keeps together, by the figures used for flocks and swarms. Pure.

Reynolds' three rules (Flocks, Herds, and Schools, SIGGRAPH 1987) as figures: separation is the
distance to the nearest neighbour, alignment the difference from the mean velocity, cohesion the
extent about the centre. Couzin's two figures of a group (Couzin et al., J. Theor. Biol. 218, 2002):
polarisation, 1 where all fly the same way, and rotation about the centre, 1 where all go round it.
"""

from dataclasses import dataclass

import numpy as np

from echowing.analysis.flight import Floats
from echowing.analysis.flock import FLIES_MPS, extent_m, nearest_m, polarisation, rotation
from echowing.campaign.record import FlightRecord
from echowing.flight.guidance import place_m

# Two are a pair; three are a group.
LEAST_FOLLOWERS = 3
# A formation has begun to follow by then: the leader's mission starts after 5 s.
SETTLED_S = 20.0


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
    there_m = record.position_ned_m[settled, 1:, :2]
    velocity_mps = record.velocity_ned_mps[settled, 1:, :2]
    from_centre_m = there_m - there_m.mean(axis=1, keepdims=True)
    against_mps = velocity_mps - velocity_mps.mean(axis=1, keepdims=True)
    held = np.array(record.hold, dtype=object)[settled] != ""
    directions = [
        (polarisation(one), rotation(one, there))
        for one, there in zip(velocity_mps, from_centre_m, strict=True)
        if (np.linalg.norm(one, axis=1) >= FLIES_MPS).any()
    ]
    if not directions:
        return None
    polarised, turning = np.mean(directions, axis=0)
    return Swarm(
        nearest_m=float(np.mean([nearest_m(one) for one in there_m])),
        misaligned_mps=float(np.linalg.norm(against_mps, axis=2).mean()),
        spread=extent_m(from_centre_m) / extent_m(_slots_m(record)),
        polarisation=float(polarised),
        rotation=float(turning),
        held=float(held.mean()),
    )


def _slots_m(record: FlightRecord) -> Floats:
    """The slots from their centre, (f, 2); which way the formation points does not matter."""
    slots = record.scenario.slots()
    places_m = np.array([place_m(slots, number)[:2] for number in range(len(slots))])
    return np.asarray(places_m - places_m.mean(axis=0))
