"""The rules of a swarm, and how much each of them counts. Pure.

They are those of the thesis's review (2.2): SWARMFARE (Nowak, Price and Lamont, 2007), which are
Reynolds's three (Flocks, Herds, and Schools, SIGGRAPH 1987) and more. Each rule says how far one
follower would move for one reason, (north, east) metres; `correction_mps` adds them up.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

Horizontal = tuple[float, float]

# What a rule says that has nothing to say.
NOWHERE: Horizontal = (0.0, 0.0)
# Nearer, two places are the same: no direction leads from one to the other.
SAME_PLACE_M = 0.01


@dataclass(frozen=True, slots=True)
class Weights:
    """How a swarm moves. Metres, and for each rule how much of its way is flown in a second."""

    align: float = 0.8
    """Share of the velocity of the towed centre in a follower's own; the rest is that of its
    neighbours. Guess: with less, each amplifies what the one before it does."""
    towards_per_s: float = 0.05
    """To the middle of its neighbours. Guess: a tenth of `away_per_s`."""
    away_per_s: float = 0.6
    """Away from who is too near. As `plan.CATCH_UP_PER_S`: an answer comes half a second late."""
    attract_per_s: float = 0.15
    """To the place behind the leader."""
    repel_per_s: float = 0.6
    """Away from the leader. As `away_per_s`."""
    evade_per_s: float = 0.6
    """Out of the way of who comes too near soon. As `away_per_s`."""
    near_m: float = 3.5
    """Nobody wants to be nearer to anybody: within the sonar's reach (4.5 m), and so far that the
    applets, which back off without a look behind, seldom have to."""
    apart_m: float = 2.0
    """Nobody wants to be nearer to anybody for certain: the envelope's 1.0 m, and as much again so
    that the envelope seldom has to act."""
    room_m: float = 4.0
    """Between neighbours where all is well, about: from it follows how far behind the leader the
    centre is. Guess: half way from what sonars allow (3 m) to what receivers do (4.8 m)."""
    sees_m: float = 12.0
    """Who is further away is no neighbour."""
    evade_s: float = 3.0
    """How far ahead a meeting is foreseen: twice what a vehicle at 5 m/s takes to stop."""
    most_mps: float = 1.5
    """The rules together, on top of the common velocity. As `plan.JOIN_MPS`."""
    draws_mps: float = 1.0
    """What draws together, `towards` and `attract`, at most. Guess: less than
    what keeps apart."""
    eases_mps2: float = 1.0
    """How fast what the rules add may change: a vehicle that leans by 6 degrees keeps its sonar."""
    switch: float = 8.0
    """By so much more `towards_per_s` counts while the swarm may split; 1: no switch."""

    def centre_m(self, followers: int) -> float:
        """How far behind the leader the centre is towed, for the nearest to be `near_m` from it.

        So many vehicles on a disc, each with a hexagon of `room_m` across.
        """
        radius_m = self.room_m * math.sqrt(followers * math.sqrt(3.0) / (2.0 * math.pi))
        return self.near_m + max(0.0, radius_m - self.room_m / 2.0)

    def clustered(self) -> "Weights":
        """The weights while one vehicle holds two parts together (Lee and McLurkin, IROS 2014)."""
        return replace(self, towards_per_s=self.switch * self.towards_per_s)


@dataclass(frozen=True, slots=True)
class Seen:
    """Another vehicle as one follower knows it.

    to_it_m: from here; unsure_m: by so much it may be nearer, one case in 160 left out.
    """

    to_it_m: Horizontal
    velocity_mps: Horizontal
    unsure_m: float = 0.0

    @property
    def far_m(self) -> float:
        """How far it most likely is."""
        return math.hypot(*self.to_it_m)

    @property
    def certain_m(self) -> float:
        """How far it is at least."""
        return max(0.0, self.far_m - self.unsure_m)

    def missing_m(self, near_m: float, apart_m: float) -> float:
        """How much it is too near: most likely, or for certain."""
        return max(0.0, near_m - self.far_m, apart_m - self.certain_m)


def align(towed_mps: Horizontal, neighbours: Sequence[Seen], share: float) -> Horizontal:
    """Fly as the swarm's centre does on its tow bar, and as the neighbours do, m/s.

    Reynolds: velocity matching; SWARMFARE: flat align. The leader's motion reaches everybody at
    once and not from one to the next.
    """
    if not neighbours:
        return towed_mps
    north, east = middle(one.velocity_mps for one in neighbours)
    return (
        share * towed_mps[0] + (1.0 - share) * north,
        share * towed_mps[1] + (1.0 - share) * east,
    )


def cluster_towards(neighbours: Sequence[Seen]) -> Horizontal:
    """To the middle of the neighbours.

    Reynolds: flock centring; SWARMFARE: cluster range towards.
    """
    return middle(one.to_it_m for one in neighbours) if neighbours else NOWHERE


def cluster_away(neighbours: Sequence[Seen], near_m: float, apart_m: float) -> Horizontal:
    """Away from each that is, or may be, too near. SWARMFARE: cluster range away (separation).

    No further than the worst of them asks for: with late answers a sum would swing.
    """
    missing_m = [one.missing_m(near_m, apart_m) for one in neighbours]
    away_m = _sum(_away(one, m) for one, m in zip(neighbours, missing_m, strict=True))
    return bounded(away_m, max(missing_m, default=0.0))


def repel(leader: Seen, near_m: float, apart_m: float) -> Horizontal:
    """Away from a leader that is, or may be, too near. SWARMFARE: target repel."""
    return _away(leader, leader.missing_m(near_m, apart_m))


def evade(
    others: Sequence[Seen], own_mps: Horizontal, apart_m: float, within_s: float
) -> Horizontal:
    """Aside from who would pass too near soon, as both fly now. Reynolds: collision avoidance."""
    return _sum(_aside(one, own_mps, apart_m, within_s) for one in others)


@dataclass(frozen=True, slots=True)
class Around:
    """What the rules read. The centre is the middle of a follower and its neighbours.

    towed_mps: the velocity of the place to which the leader tows it; to_place_m: from it to there.
    """

    leader: Seen
    neighbours: Sequence[Seen]
    own_mps: Horizontal
    towed_mps: Horizontal
    to_place_m: Horizontal


def correction_mps(weights: Weights, around: Around) -> Horizontal:
    """What the other rules add to the common velocity, `align`'s, together.

    Reynolds's order: what keeps apart comes first, what draws together gets what that leaves, and
    presses nobody against another.
    """
    leader, neighbours, apart_m = around.leader, around.neighbours, weights.apart_m
    others = (leader, *neighbours)
    apart = _weighted(
        (weights.away_per_s, cluster_away(neighbours, weights.near_m, apart_m)),
        (weights.repel_per_s, repel(leader, weights.near_m, apart_m)),
        (weights.evade_per_s, evade(others, around.own_mps, apart_m, weights.evade_s)),
    )
    together = _weighted(
        (weights.towards_per_s, cluster_towards(neighbours)),
        # All attract the same way, so that nobody presses another.
        (weights.attract_per_s, around.to_place_m),
    )
    near = [one for one in others if one.missing_m(weights.near_m, apart_m) > 0.0]
    apart, together = bounded(apart, weights.most_mps), bounded(together, weights.draws_mps)
    left = bounded(unpressed(together, near), weights.most_mps - math.hypot(*apart))
    return apart[0] + left[0], apart[1] + left[1]


def unpressed(velocity_mps: Horizontal, near: Iterable[Seen]) -> Horizontal:
    """A velocity without what leads at those that are near already."""
    north, east = velocity_mps
    for one in near:
        share = max(0.0, north * one.to_it_m[0] + east * one.to_it_m[1])
        share /= max(one.far_m, SAME_PLACE_M) ** 2
        north, east = north - share * one.to_it_m[0], east - share * one.to_it_m[1]
    return north, east


def _weighted(*parts: tuple[float, Horizontal]) -> Horizontal:
    return _sum((per_s * north_m, per_s * east_m) for per_s, (north_m, east_m) in parts)


def eased(from_mps: Horizontal, to_mps: Horizontal, most_mps: float) -> Horizontal:
    """A velocity changed towards another by so much at most."""
    north, east = bounded((to_mps[0] - from_mps[0], to_mps[1] - from_mps[1]), most_mps)
    return from_mps[0] + north, from_mps[1] + east


def bounded(vector: Horizontal, most: float) -> Horizontal:
    """A vector made no longer than that."""
    share = min(1.0, most / max(math.hypot(*vector), 1e-9))
    return share * vector[0], share * vector[1]


def _away(one: Seen, missing_m: float) -> Horizontal:
    """Straight away from another, by what is missing of the distance."""
    share = -max(0.0, missing_m) / max(one.far_m, SAME_PLACE_M)
    return share * one.to_it_m[0], share * one.to_it_m[1]


def _aside(one: Seen, own_mps: Horizontal, apart_m: float, within_s: float) -> Horizontal:
    """Away from where it passes nearest, by what is missing; if it would hit, to the right."""
    north_mps, east_mps = one.velocity_mps[0] - own_mps[0], one.velocity_mps[1] - own_mps[1]
    mps2 = north_mps * north_mps + east_mps * east_mps
    comes_m2ps = -(one.to_it_m[0] * north_mps + one.to_it_m[1] * east_mps)
    if not 0.0 < comes_m2ps <= within_s * mps2:
        return NOWHERE
    in_s = comes_m2ps / mps2
    passes = one.to_it_m[0] + in_s * north_mps, one.to_it_m[1] + in_s * east_mps
    if math.hypot(*passes) < SAME_PLACE_M:
        # Its nose is at -velocity from here: on the left of that is its right.
        mps = math.sqrt(mps2)
        passes = -SAME_PLACE_M * east_mps / mps, SAME_PLACE_M * north_mps / mps
    return _away(replace(one, to_it_m=passes), apart_m - math.hypot(*passes))


def _sum(vectors: Iterable[Horizontal]) -> Horizontal:
    pairs = list(vectors)
    return sum(north for north, _ in pairs), sum(east for _, east in pairs)


def middle(vectors: Iterable[Horizontal]) -> Horizontal:
    """The mean of vectors, of which there is one at least."""
    pairs = list(vectors)
    north, east = _sum(pairs)
    return north / len(pairs), east / len(pairs)
