"""A swarm: followers without a slot, led by weighted rules (`swarm_rules`). Pure.

The rules only propose. The envelope (`spacing`) keeps a follower apart from everybody, and a stale
leader holds it (`supervisor`), as one that has a slot. Where a slot would be, the swarm has a place
for its centre, on a tow bar behind the leader.

Who is linked to whom is a graph: near enough for a sonar, as `health` has it. A vehicle whose loss
would cut it in two changes the weights (S. K. Lee and J. McLurkin, IROS 2014; thesis 2.2).
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import networkx as nx

from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import FASTEST_MPS, SURE_SIGMAS
from echowing.flight.follower import FollowerState
from echowing.flight.guidance import GuidedPoint, Horizontal, LeaderFix, Slot, bearing_rad
from echowing.flight.known import Known
from echowing.flight.swarm_rules import (
    Around,
    Seen,
    Weights,
    align,
    bounded,
    correction_mps,
    eased,
    middle,
)
from echowing.flight.tow_bar import LONGEST_STEP_S, TowBar
from echowing.geo import GlobalPosition, displace, distance_m, ned_between

# One that is not heard is watched at least so long: each change begins with an estimate that knows
# nothing, and the co-processor's search takes some seconds (`look.FIGURE_S`).
WATCHED_S = 8.0
# Who is watched is nearer to the leader by so much, so that nobody watches in a circle.
AHEAD_M = 1.0
# The weights stay changed for so long after the swarm hung on one vehicle.
CLUSTERS_S = 3.0


class Swarm:
    """Places for the followers of one session that have no slots.

    clusters: whether the weights are changed now.
    """

    def __init__(self, known: Known, weights: Weights) -> None:
        self._known, self.weights = known, weights
        self.clusters = False
        self._link_m = min(link_m(one.plan.sonar) for one in known.followers.values())
        self._cut_at_s = -math.inf
        self._since_s: dict[int, float] = {}
        self._added: dict[int, tuple[Horizontal, float]] = {}
        radius_m = weights.centre_m(len(known.followers))
        self._bars = {system_id: TowBar(Slot(radius_m)) for system_id in known.followers}

    def prepare(self, now_s: float) -> None:
        """Once a tick, before anybody is judged: who watches whom, and whether the swarm holds."""
        known = self._known
        there = ((one, follower.then(now_s)) for one, follower in known.followers.items())
        places = {one: place for one, place in there if place is not None}
        for follower in known.followers.values():
            self._choose(follower, places, now_s)
        if hangs_on_one(links(places, self._link_m)):
            self._cut_at_s = now_s
        self.clusters = now_s - self._cut_at_s < CLUSTERS_S

    # ---- whom a sonar watches -------------------------------------------------------------------

    def _choose(
        self, follower: FollowerState, places: dict[int, GlobalPosition], now_s: float
    ) -> None:
        """Let its sonar watch the nearest ahead, once it does not hear whom it watches."""
        system_id, watched = follower.plan.system_id, self._known.ahead_of(follower)
        led = watched is None or _is_led(watched)
        if led and follower.estimate.hears(now_s):
            self._since_s[system_id] = now_s
        if led and now_s - self._since_s.get(system_id, -math.inf) < WATCHED_S:
            return
        self._since_s[system_id] = now_s
        nearest = self._nearest_ahead(follower, places)
        if nearest is not watched:
            self._known.watch({system_id: nearest})

    def _nearest_ahead(
        self, follower: FollowerState, places: dict[int, GlobalPosition]
    ) -> FollowerState | None:
        """The nearest of those that are nearer to the leader and within reach; None: the leader."""
        here, fix = places.get(follower.plan.system_id), self._known.leader.fix
        if here is None or fix is None:
            return None
        to_leader_m = distance_m(here, fix.position)
        nearest, nearest_m = None, min(to_leader_m, self._link_m)
        for system_id, there in places.items():
            other, apart_m = self._known.followers[system_id], distance_m(here, there)
            ahead = distance_m(there, fix.position) < to_leader_m - AHEAD_M
            circle = follower in self._known.chain(other)
            if ahead and apart_m < nearest_m and not circle and _is_led(other):
                nearest, nearest_m = other, apart_m
        return nearest

    # ---- where it is to be ----------------------------------------------------------------------

    def guided(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GuidedPoint:
        """Where a follower is to be when the order arrives, and how fast.

        The way is sent as a velocity, as to a slot whose leader is not heard (`plan`): `slot` is
        where it would be after a second.
        """
        known, arrives_s = self._known, now_s + follower.way_s
        leader = known.leader_then(follower, arrives_s) or known.seen_by(follower, fix)
        bar, here = self._bars[follower.plan.system_id], follower.then(arrives_s)
        if here is None:
            return bar.update(leader, arrives_s)
        weights = self._weights_for(follower)
        others = self._others(follower, here, arrives_s)
        neighbours = [one for one in others if one.far_m <= weights.sees_m]
        centre_m = middle([(0.0, 0.0), *(one.to_it_m for one in neighbours)])
        centre = displace(here, (*centre_m, 0.0))
        towed = bar.update(leader, arrives_s, centre)
        around = Around(
            leader=self._leader(follower, here, leader),
            neighbours=neighbours,
            own_mps=follower.velocity_then(arrives_s),
            towed_mps=towed.velocity_mps,
            to_place_m=ned_between(centre, towed.slot)[:2],
        )
        common = align(around.towed_mps, neighbours, weights.align)
        more = self._eased(follower, correction_mps(weights, around), now_s)
        velocity_mps = bounded((common[0] + more[0], common[1] + more[1]), FASTEST_MPS)
        watched = known.watched_then(follower, arrives_s) or leader
        return replace(
            towed,
            point=here,
            slot=displace(here, (*more, 0.0)),
            leader=watched.position,
            yaw_rad=bearing_rad(here, watched.position),
            age_s=max(0.0, now_s - fix.time_s),
            offset_m=ned_between(watched.position, here)[:2],
            velocity_mps=velocity_mps,
            slot_mps=common,
            at_s=arrives_s,
        )

    def _eased(self, follower: FollowerState, more_mps: Horizontal, now_s: float) -> Horizontal:
        """What the rules add, changed no faster than a vehicle leans gently."""
        system_id = follower.plan.system_id
        before_mps, before_s = self._added.get(system_id, ((0.0, 0.0), now_s))
        most_mps = self.weights.eases_mps2 * min(LONGEST_STEP_S, now_s - before_s)
        more_mps = eased(before_mps, more_mps, most_mps)
        self._added[system_id] = more_mps, now_s
        return more_mps

    def _weights_for(self, follower: FollowerState) -> Weights:
        """The weights of now; further from a leader that may turn round (`plan`)."""
        weights = self.weights.clustered() if self.clusters else self.weights
        return replace(weights, near_m=max(weights.near_m, follower.opens_m))

    def _leader(self, follower: FollowerState, here: GlobalPosition, leader: LeaderFix) -> Seen:
        known, to_it_m = self._known, ned_between(here, leader.position)[:2]
        unsure_m = SURE_SIGMAS * known.leader_sigma_m(follower)
        if known.ahead_of(follower) is None:
            unsure_m = min(unsure_m, known.nearer_m(follower, to_it_m, self.weights.apart_m))
        return Seen(to_it_m, leader.velocity_ned_mps[:2], unsure_m)

    def _others(self, follower: FollowerState, here: GlobalPosition, at_s: float) -> Iterator[Seen]:
        """The other followers that report."""
        known = self._known
        for other in known.followers.values():
            there = other.then(at_s)
            if other is follower or there is None or not other.flying:
                continue
            seen, unsure_m = known.seen(follower, here, other, there, self.weights.apart_m)
            to_it_m = ned_between(here, seen)[:2]
            yield Seen(to_it_m, other.velocity_then(at_s), unsure_m)


def _is_led(follower: FollowerState) -> bool:
    """Whether another may follow it (as `Supervisor` asks)."""
    return follower.standing.sent_to and not follower.doubted


def link_m(sonar: SonarBelief) -> float:
    """Two are linked within reach of a sonar, by receivers that wander."""
    return sonar.reach_m + UNRANGED_SIGMA_M


def links(places: dict[int, GlobalPosition], within_m: float) -> "nx.Graph[int]":
    """Who is linked to whom."""
    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(places)
    graph.add_edges_from(
        (a, b) for a, b in combinations(places, 2) if distance_m(places[a], places[b]) <= within_m
    )
    return graph


def hangs_on_one(graph: "nx.Graph[int]") -> bool:
    """Whether the loss of one vehicle would cut the swarm in two, or it is in two parts."""
    if len(graph) < 2:
        return False
    return not nx.is_connected(graph) or any(True for _ in nx.articulation_points(graph))
