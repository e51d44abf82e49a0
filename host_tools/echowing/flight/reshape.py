"""A formation takes another shape in flight. Pure.

Each follower gets the slot that makes all ways together shortest (squared), and flies there on a
spiral round the vehicle that its sonar watches from then on: distance and angle change evenly, so
nobody comes nearer to that one than a slot is. All begin and end together. What sonars know of the
receivers goes with them (`Known.watch`). On the way the envelope keeps all apart, as ever; that the
slots themselves stay apart is checked before anybody flies (`check_changes`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import networkx as nx

from echowing.errors import EchowingError
from echowing.flight.build_up import LONGEST_STEP_S, SLOT_MPS
from echowing.flight.guidance import Slot, place_m
from echowing.flight.known import Known
from echowing.flight.said import Say
from echowing.flight.steps import Phase

# Slots that pass each other are so far apart: what has to be certain, and a follower half a metre
# off at each end (`formation.IN_SLOT_M`).
LEAST_APART_M = 2.0
# The way is looked at so often.
LOOKS = 40

# A shape's name and its slots.
Named = tuple[str, Sequence[Slot]]


@dataclass(frozen=True, slots=True)
class Way:
    """From where a follower is to its new slot, round the vehicle that it then watches."""

    from_m: float
    from_rad: float
    to: Slot

    def slot(self, share: float) -> Slot:
        """The new slot, turned to where it is once that share of the way is flown."""
        angle_rad = self.from_rad + share * (self.to.angle_rad - self.from_rad)
        return replace(self.to, angle_rad=angle_rad)

    def far_m(self, share: float) -> float:
        """How far it is from the vehicle that is watched."""
        return self.from_m + share * (self.to.radius_m - self.from_m)


def ways(slots: Sequence[Slot], shape: Sequence[Slot]) -> list[Way]:
    """Each follower's way from its slot into a shape of as many."""
    here_m = [place_m(slots, number) for number in range(len(slots))]
    there_m = [place_m(shape, number) for number in range(len(shape))]
    takes = _shortest(
        [[round(1e6 * math.dist(here, there) ** 2) for there in there_m] for here in here_m]
    )
    flies_in = {slot: follower for follower, slot in enumerate(takes)}
    found = []
    for follower, number in enumerate(takes):
        behind = shape[number].behind
        ahead = None if behind is None else flies_in[behind]
        around_m = (0.0, 0.0, 0.0) if ahead is None else here_m[ahead]
        north_m, east_m = (here_m[follower][axis] - around_m[axis] for axis in (0, 1))
        to = replace(shape[number], behind=ahead)
        turn_rad = math.remainder(to.angle_rad - math.atan2(east_m, -north_m), math.tau)
        found.append(Way(math.hypot(north_m, east_m), to.angle_rad - turn_rad, to))
    return found


def _shortest(costs: Sequence[Sequence[int]]) -> list[int]:
    """Which column each row takes, so that the sum is least; whole numbers, so it is exact."""
    graph: nx.Graph[tuple[str, int]] = nx.Graph()
    most = max(map(max, costs))
    for row, of_row in enumerate(costs):
        for column, cost in enumerate(of_row):
            graph.add_edge(("row", row), ("column", column), weight=most - cost)
    pairs = (sorted(pair) for pair in nx.max_weight_matching(graph, maxcardinality=True))
    takes = {row: column for (_, column), (_, row) in pairs}
    return [takes[row] for row in range(len(costs))]


def check_changes(shapes: Sequence[Named]) -> None:
    """Raise EchowingError unless slots stay apart on the way from each shape to the next."""
    for (before, slots), (after, to_slots) in pairwise(shapes):
        least_m = _least_m(ways(slots, to_slots))
        if least_m < LEAST_APART_M:
            raise EchowingError(
                f"formation: from {before} to {after} two slots come to {least_m:.1f} m of each "
                f"other, less than {LEAST_APART_M:g} m; take another shape between, or more spacing"
            )


def _least_m(on_the_way: Sequence[Way]) -> float:
    """The least distance of any two, the leader included, on the way."""
    least_m = math.inf
    for look in range(LOOKS + 1):
        places_m = [(0.0, 0.0, 0.0), *_places_m(on_the_way, look / LOOKS)]
        least_m = min(least_m, *(math.dist(a, b) for a, b in combinations(places_m, 2)))
    return least_m


def _places_m(on_the_way: Sequence[Way], share: float) -> list[tuple[float, float, float]]:
    slots = [replace(way.slot(share), radius_m=way.far_m(share)) for way in on_the_way]
    return [place_m(slots, number) for number in range(len(slots))]


def _longest_m(on_the_way: Sequence[Way]) -> float:
    """The longest way."""
    looks = [_places_m(on_the_way, look / LOOKS) for look in range(LOOKS + 1)]
    return max(
        sum(math.dist(a, b) for a, b in pairwise(places_m)) for places_m in zip(*looks, strict=True)
    )


class Reshape:
    """The changes of shape of one session; say(now_s, text) is for the operator."""

    def __init__(self, known: Known, say: Say) -> None:
        self._known, self._say = known, say
        self._name = ""
        self._ways: list[Way] = []
        self._way_m = self._flown_m = 0.0
        self._at_s = 0.0

    @property
    def moves(self) -> bool:
        """Whether the slots are on their way."""
        return bool(self._ways)

    def objection(self, shape: Named) -> str | None:
        """Why they cannot fly into a shape now; None: they can."""
        if self.moves:
            return f"still on the way to {self._name}"
        for system_id, follower in self._known.followers.items():
            if follower.standing.phase is not Phase.LED:
                why = follower.standing.why and f": {follower.standing.why}"
                return f"follower {system_id} is not led{why}"
        try:
            check_changes([("here", self._slots()), shape])
        except EchowingError as error:
            return str(error)
        return None

    def _slots(self) -> list[Slot]:
        return [one.plan.slot for one in self._known.followers.values()]

    def begin(self, shape: Named, now_s: float) -> None:
        """Let all fly into a shape; it has a slot for each follower."""
        self._name, slots = shape
        self._ways = ways(self._slots(), slots)
        self._way_m, self._flown_m = _longest_m(self._ways), 0.0
        self._at_s = now_s
        self._say(now_s, f"to {self._name}, {self._way_m / SLOT_MPS:.0f} s")
        self._place()

    def advance(self, now_s: float) -> None:
        """Once a tick: move the slots, unless everybody is held."""
        elapsed_s = min(LONGEST_STEP_S, now_s - self._at_s)
        self._at_s = now_s
        led = any(one.standing.phase is Phase.LED for one in self._known.followers.values())
        if not self.moves or not led:
            return
        self._flown_m = min(self._way_m, self._flown_m + SLOT_MPS * elapsed_s)
        self._place()
        if self._flown_m >= self._way_m:
            self._ways = []
            for one in self._known.followers.values():
                one.on_way_m = 0.0
            self._say(now_s, f"in {self._name}")

    def _place(self) -> None:
        share = 1.0 if self._way_m == 0.0 else self._flown_m / self._way_m
        followers = list(zip(self._known.followers.values(), self._ways, strict=True))
        self._known.take({one.plan.system_id: way.slot(share) for one, way in followers})
        for one, way in followers:
            one.on_way_m = way.far_m(share)
