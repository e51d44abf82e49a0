"""Velocities between walls: the nearest that none forbids, or the one that breaks least. Pure.

In the plane of velocities a wall is a line, and forbids what lies on one side of it; a disc round
nought bounds the plane. Both programs are solved exactly, one wall after another (Seidel): what
was best before a wall stays best if the wall allows it, else the best lies on the wall's own line.
So a wall that does not bind costs one product.
"""

import math
from collections.abc import Sequence

# North, east.
Level = tuple[float, float]
# A direction (unit vector: north, east), and the least speed along it.
Wall = tuple[float, float, float]

# What rounding leaves: of a speed, and of the sine of an angle. Further than any velocity.
SAME_MPS, PARALLEL, FAR_MPS = 1e-6, 1e-9, 1e6


def short_of_mps(velocity: Sequence[float], wall: Wall) -> float:
    """By how much a velocity (north, east, ...) falls short of a wall; up to 0: it does not."""
    return wall[2] - velocity[0] * wall[0] - velocity[1] * wall[1]


def nearest(aim: Level, walls: Sequence[Wall], most_mps: float) -> Level | None:
    """The velocity nearest to `aim` in the disc that no wall forbids; None: there is none."""
    mps = math.hypot(*aim)
    share = min(1.0, most_mps / mps) if mps > 0.0 else 0.0
    flown: Level | None = (share * aim[0], share * aim[1])
    for number, wall in enumerate(walls):
        if flown is not None and short_of_mps(flown, wall) > 0.0:
            flown = _nearest_on(wall, aim, walls[:number], most_mps)
    return flown


def _nearest_on(line: Wall, aim: Level, walls: Sequence[Wall], most_mps: float) -> Level | None:
    """The same on a wall's line: the disc and the other walls leave a piece of it, or nothing."""
    north, east, least_mps = line
    if least_mps > most_mps:
        return None
    last = math.sqrt(most_mps * most_mps - least_mps * least_mps)
    first = -last
    for wall in walls:
        rises = wall[1] * north - wall[0] * east
        missing_mps = wall[2] - least_mps * (wall[0] * north + wall[1] * east)
        if abs(rises) < PARALLEL:
            last = last if missing_mps <= SAME_MPS else -math.inf
        elif rises > 0.0:
            first = max(first, missing_mps / rises)
        else:
            last = min(last, missing_mps / rises)
    if first > last:
        return None
    along = min(last, max(first, aim[1] * north - aim[0] * east))
    return least_mps * north - along * east, least_mps * east + along * north


def breaking_least(walls: Sequence[Wall], most_mps: float, worst: Wall) -> Level:
    """The velocity whose greatest breach of a wall is least; of several the one furthest right.

    Right is seen towards the vehicle of the `worst` wall: between two that come from both sides
    all velocities across break alike, and the one across leads out.
    """
    flown, breach_mps = (0.0, 0.0), -math.inf
    for number, wall in enumerate(walls):
        if short_of_mps(flown, wall) > breach_mps:
            # Now this one is broken most: as far along it as the others are broken no more.
            no_more = [_broken_no_more(each, wall) for each in walls[:number]]
            flown = nearest(_far(wall[0], wall[1]), no_more, most_mps) or flown
            breach_mps = short_of_mps(flown, wall)
    lowered = [(north, east, least_mps - breach_mps - SAME_MPS) for north, east, least_mps in walls]
    return nearest(_far(worst[1], -worst[0]), lowered, most_mps) or flown


def _far(north: float, east: float) -> Level:
    """A velocity to aim at that stands for its direction alone."""
    return FAR_MPS * north, FAR_MPS * east


def _broken_no_more(wall: Wall, than: Wall) -> Wall:
    """The velocities that break a wall by no more than another, as a wall."""
    north, east = wall[0] - than[0], wall[1] - than[1]
    length = math.hypot(north, east)
    if length < PARALLEL:
        return 1.0, 0.0, -math.inf
    return north / length, east / length, (wall[2] - than[2]) / length
