"""Health of the formation: who sees whom, and whose loss would cut the rest in two. Pure.

The vehicles do not talk to each other: all that one knows of another comes through the ground
station. A radio is therefore no edge between two vehicles but a property of one: the age of its
report. What holds a formation together without the ground is who *sees* whom. So an edge joins two
vehicles when

- one of them *ranges* the other: its sonar has measured a distance that fits the other vehicle
  within `RANGED_S`; or
- they are *near*: both have reported within `UNHEARD_S`, and are within reach of a sonar of each
  other by their receivers, so that one could be ranged if the other were turned to it.

A vehicle is an *articulation point* (S. K. Lee and J. McLurkin, "Distributed cohesive configuration
control for swarm robots with boundary information and network sensing", IROS 2014; thesis chapter
2) when its loss would leave parts that do not see each other. A follower without any edge sees
nobody. Neither is a fault by itself: at a radius of 8 m nobody sees anybody, and two followers far
apart are always joined by their leader only. The tool reports only changes: a vehicle becomes an
articulation point, or a follower whose slot is within somebody's reach has seen somebody and now
sees nobody.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import networkx as nx

from echowing.flight.belief import SonarBelief
from echowing.flight.clocks import UNHEARD_S
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.said import Said
from echowing.flight.steps import name_of
from echowing.geo import Ned, wrap_angle_rad

# A sonar that hears one ping in ten, over a radio that loses half, is heard once in this time.
RANGED_S = 2.0
# A range belongs to the vehicle that it fits best. If it fits worse than this (a GPS and a beam's
# width, as `panel.MISMATCH_M`), or that vehicle is so far outside the widest beam (two receivers'
# errors at 3 m), it belongs to something else.
FIT_M, ASIDE_RAD = 2.0, math.radians(30.0)
# A change counts when it has lasted so long: a state that comes and goes is not worth a report.
LASTS_S = 2.0

Pair = frozenset[int]


@dataclass(frozen=True, slots=True)
class Member:
    """One vehicle at one moment.

    at_ned_m: by its own receiver, from an origin that all share; None: no report yet; age_s: of
    that report; heading_rad: of its nose (of the sonar's axis where that is known); range_m:
    distance between centres by its sonar now, None: no target in its reach. leader_ned_m: where it
    takes the leader to be, in its own receiver's frame; None: where the leader reports itself.
    apart: whether its slot is out of everybody's reach, so that it sees nobody by plan.
    """

    system_id: int
    at_ned_m: Ned | None
    age_s: float
    heading_rad: float = 0.0
    range_m: float | None = None
    leader_ned_m: Ned | None = None
    apart: bool = False

    @property
    def heard(self) -> bool:
        """Whether it has reported recently."""
        return self.at_ned_m is not None and self.age_s <= UNHEARD_S


@dataclass(frozen=True, slots=True)
class Cut:
    """A vehicle whose loss would leave `parts` that do not see each other, largest first."""

    system_id: int
    parts: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Health:
    """How the formation holds together.

    ranges: (who, whom); near: pairs; cuts: articulation points; alone: followers that see nobody;
    lost: those of them that have seen somebody before, and are not apart by plan.
    """

    ranges: tuple[tuple[int, int], ...] = ()
    near: tuple[tuple[int, int], ...] = ()
    cuts: tuple[Cut, ...] = ()
    alone: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()


def ranged(
    member: Member, others: Iterable[Member], leader_id: int, sonar: SonarBelief
) -> int | None:
    """Which vehicle a member's sonar measures now; None: the range fits none."""
    here = member.at_ned_m
    if here is None or member.range_m is None:
        return None
    fits = [
        (off_m, system_id)
        for system_id, there in _around(member, others, leader_id)
        if (off_m := abs(math.dist(here, there) - member.range_m)) <= FIT_M
        and _off_rad(here, member.heading_rad, there)
        <= sonar.widest_rad.at(member.range_m) + ASIDE_RAD
    ]
    return min(fits)[1] if fits else None


def _around(member: Member, others: Iterable[Member], leader_id: int) -> Iterator[tuple[int, Ned]]:
    """The others, and where they are as this member knows it."""
    for other in others:
        seen = member.leader_ned_m if other.system_id == leader_id else None
        there = seen or other.at_ned_m
        if other is not member and there is not None:
            yield other.system_id, there


def _off_rad(here: Ned, heading_rad: float, there: Ned) -> float:
    north, east, _ = (b - a for a, b in zip(here, there, strict=True))
    return abs(wrap_angle_rad(math.atan2(east, north) - heading_rad))


def near_pairs(
    members: Sequence[Member], sonar: SonarBelief, before: Iterable[Pair] = ()
) -> set[Pair]:
    """Pairs within reach of a sonar; those of `before` until receivers alone may not say so."""
    before = set(before)
    heard = [(one.system_id, one.at_ned_m) for one in members if one.heard and one.at_ned_m]
    close = (
        (frozenset((a, b)), apart_m)
        for (a, there_a), (b, there_b) in combinations(heard, 2)
        if (apart_m := math.dist(there_a, there_b)) <= sonar.reach_m + UNRANGED_SIGMA_M
    )
    return {pair for pair, apart_m in close if apart_m <= sonar.reach_m or pair in before}


def assess(
    members: Sequence[Member],
    leader_id: int,
    sonar: SonarBelief,
    ranges: Mapping[int, int] | None = None,
    near: Iterable[Pair] | None = None,
) -> Health:
    """The health of a formation at one moment.

    ranges: who has ranged whom recently; near: the near pairs; None: as they are at this moment.
    """
    if ranges is None:
        seen = ((member.system_id, ranged(member, members, leader_id, sonar)) for member in members)
        ranges = {who: whom for who, whom in seen if whom is not None}
    pairs = near_pairs(members, sonar) if near is None else set(near)
    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(member.system_id for member in members)
    graph.add_edges_from(ranges.items())
    graph.add_edges_from((min(pair), max(pair)) for pair in pairs)
    alone = tuple(one for one in sorted(graph) if one != leader_id and not graph.degree(one))
    return Health(
        ranges=tuple(sorted(ranges.items())),
        near=tuple(sorted((min(pair), max(pair)) for pair in pairs)),
        cuts=tuple(_cuts(graph)),
        alone=alone,
    )


def _cuts(graph: "nx.Graph[int]") -> Iterator[Cut]:
    for system_id in sorted(nx.articulation_points(graph)):
        mates = list(graph[system_id])
        graph.remove_node(system_id)
        parts = [tuple(sorted(part)) for part in nx.connected_components(graph)]
        graph.add_edges_from((system_id, mate) for mate in mates)
        left = [part for part in parts if not set(part).isdisjoint(mates)]
        yield Cut(system_id, tuple(sorted(left, key=lambda part: (-len(part), part))))


@dataclass(slots=True)
class _Change:
    """A state of one vehicle that has to last before it counts."""

    counts: bool = False
    other_since_s: float | None = None

    def update(self, now_s: float, *, is_so: bool) -> bool:
        """Whether the state that counts has just changed."""
        if is_so is self.counts:
            self.other_since_s = None
            return False
        if self.other_since_s is None:
            self.other_since_s = now_s
        if now_s - self.other_since_s < LASTS_S:
            return False
        self.counts, self.other_since_s = is_so, None
        return True


@dataclass(slots=True)
class Cohesion:
    """Tracks a formation's health over time. `update` returns what to say about changes."""

    leader_id: int
    sonar: SonarBelief
    health: Health = field(default_factory=Health)
    _ranged: dict[int, tuple[float, int]] = field(default_factory=dict)
    _near: set[Pair] = field(default_factory=set)
    _cut: dict[int, _Change] = field(default_factory=dict)
    _alone: dict[int, _Change] = field(default_factory=dict)
    _said: Said = field(default_factory=Said)

    def update(self, members: Sequence[Member], now_s: float) -> list[str]:
        """Take the vehicles as they are now; a sentence for each change that has lasted."""
        for member in members:
            whom = ranged(member, members, self.leader_id, self.sonar)
            if whom is not None:
                self._ranged[member.system_id] = (now_s, whom)
        fresh = {
            who: whom for who, (at_s, whom) in self._ranged.items() if now_s - at_s <= RANGED_S
        }
        self._near = near_pairs(members, self.sonar, self._near)
        self.health = assess(members, self.leader_id, self.sonar, fresh, self._near)
        said = [*self._say_cuts(now_s), *self._say_alone(members, now_s)]
        lost = tuple(one for one, change in sorted(self._alone.items()) if change.counts)
        self.health = replace(self.health, lost=lost)
        return said

    def _say_cuts(self, now_s: float) -> Iterator[str]:
        cuts = {cut.system_id: cut for cut in self.health.cuts}
        for system_id in sorted({*cuts, *self._cut}):
            change = self._cut.setdefault(system_id, _Change())
            begins = change.update(now_s, is_so=system_id in cuts) and change.counts
            if begins and self._said.may_say(("cut", system_id), now_s):
                yield cut_text(cuts[system_id], self.leader_id)

    def _say_alone(self, members: Sequence[Member], now_s: float) -> Iterator[str]:
        """A follower is lost once it has seen somebody; at a wide radius none ever does."""
        alone = set(self.health.alone) - {one.system_id for one in members if one.apart}
        for member in members:
            system_id = member.system_id
            change = self._alone.get(system_id)
            if change is None:
                if system_id not in alone and system_id != self.leader_id:
                    self._alone[system_id] = _Change()
                continue
            if not change.update(now_s, is_so=system_id in alone):
                continue
            if change.counts and self._said.may_say(("alone", system_id), now_s):
                meant = f"no range of a vehicle, and none within {self.sonar.reach_m:g} m of it"
                yield f"follower {system_id} does not see anybody any more: {meant}"
            elif not change.counts and ("alone", system_id) in self._said:
                yield f"follower {system_id} sees a vehicle again"


def cut_text(cut: Cut, leader_id: int) -> str:
    """What an articulation point means."""
    parts = " | ".join(_listed(part, leader_id) for part in cut.parts)
    return f"{name_of(cut.system_id, leader_id)}: its loss would cut the formation apart: {parts}"


def _listed(part: Sequence[int], leader_id: int) -> str:
    return ", ".join(name_of(system_id, leader_id) for system_id in part)
