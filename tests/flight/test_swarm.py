"""A swarm: each rule's way by hand, what is sent, who is watched, and that it keeps apart."""

import math
import random
from dataclasses import replace

import networkx as nx
import pytest

from echowing.errors import EchowingError
from echowing.flight.envelope import (
    FASTEST_MPS,
    Answer,
    Other,
    certain_distance_m,
    keep_apart,
)
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.steps import Phase, Standing
from echowing.flight.supervisor import STALE
from echowing.flight.swarm import CLUSTERS_S, Swarm, hangs_on_one, link_m, links
from echowing.flight.swarm_rules import (
    Around,
    Seen,
    Weights,
    align,
    bounded,
    cluster_away,
    cluster_towards,
    correction_mps,
    eased,
    evade,
    repel,
    unpressed,
)
from echowing.geo import ned_between
from echowing.mavlink.messages import Manner
from echowing.sim.flight import FormationFlight, scattered_m
from echowing.sim.scenario import load_scenario
from echowing.sim.serve_flight import serve
from echowing.sonar_file import shipped_sonar

from .told import Told, at
from .yard import FOLLOWER, LEADER, SECOND, Vehicle, Yard

pytestmark = pytest.mark.seconds(6)

THIRD = 4
WEIGHTS = Weights()
LINK_M = link_m(shipped_sonar())
STILL = (0.0, 0.0)
FAR = Seen((50.0, 0.0), STILL)
SWARM = GuidanceSettings(learn_offset=False, swarm=WEIGHTS)


def seen(north_m: float, east_m: float, unsure_m: float = 0.0) -> Seen:
    return Seen((north_m, east_m), STILL, unsure_m)


def around(
    *neighbours: Seen, leader: Seen = FAR, to_place_m: tuple[float, float] = STILL
) -> Around:
    return Around(leader, neighbours, STILL, STILL, to_place_m)


# ---- the rules -----------------------------------------------------------------------------------


def test_align_mixes_the_towed_velocity_with_the_neighbours() -> None:
    others = [Seen((3.0, 0.0), (1.0, 0.0)), Seen((0.0, 3.0), (0.0, 1.0))]
    assert align((2.0, 0.0), others, 0.8) == pytest.approx((1.7, 0.1))
    assert align((2.0, 0.0), [], 0.8) == (2.0, 0.0)


def test_cluster_towards_goes_to_the_middle_of_the_neighbours() -> None:
    assert cluster_towards([seen(4.0, 0.0), seen(0.0, 6.0)]) == (2.0, 3.0)
    assert cluster_towards([]) == STILL


def test_cluster_away_goes_by_what_is_missing_most_likely_or_for_certain() -> None:
    near_m, apart_m = 3.5, 2.0
    assert cluster_away([seen(3.0, 0.0)], near_m, apart_m) == pytest.approx((-0.5, 0.0))
    # At 4 m it is far enough, but it may be at 1 m.
    assert cluster_away([seen(0.0, 4.0, 3.0)], near_m, apart_m) == pytest.approx((0.0, -1.0))
    assert cluster_away([seen(4.0, 0.0)], near_m, apart_m) == STILL
    # Three on one side do not add up.
    assert cluster_away([seen(3.0, 0.0)] * 3, near_m, apart_m) == pytest.approx((-0.5, 0.0))


def test_repel_points_from_the_leader() -> None:
    assert repel(seen(2.5, 0.0), 3.5, 2.0) == pytest.approx((-1.0, 0.0))
    assert repel(seen(5.0, 0.0), 3.5, 2.0) == STILL


def test_evade_goes_aside_from_where_the_other_passes() -> None:
    """It comes from 4 m ahead at 2 m/s and passes 1 m on the right in 2 s: 1 m is missing."""
    comes = Seen((4.0, 1.0), (-2.0, 0.0))
    assert evade([comes], STILL, 2.0, 3.0) == pytest.approx((0.0, -1.0))
    assert evade([comes], STILL, 2.0, 1.0) == STILL, "not so soon"
    assert evade([replace(comes, velocity_mps=(2.0, 0.0))], STILL, 2.0, 3.0) == STILL, "it leaves"
    north_m, east_m = evade([Seen((4.0, 0.0), (-2.0, 0.0))], STILL, 2.0, 3.0)
    assert (north_m, east_m) == pytest.approx((0.0, 1.99)), "it would hit: to the right"


def test_each_weight_counts() -> None:
    there = around(
        seen(3.0, 0.0),
        Seen((6.0, 1.0), (-3.0, 0.0)),
        leader=seen(-3.0, 0.0),
        to_place_m=(-1.0, 0.5),
    )
    flown = correction_mps(WEIGHTS, there)
    for name in ("towards_per_s", "away_per_s", "attract_per_s", "repel_per_s", "evade_per_s"):
        assert correction_mps(replace(WEIGHTS, **{name: 0.0}), there) != flown, name


def test_what_draws_together_presses_nobody() -> None:
    """A neighbour at 3 m is too near: the pull past it keeps only the part across."""
    near = seen(3.0, 0.0)
    assert unpressed((1.0, 0.5), [near]) == pytest.approx((0.0, 0.5))
    assert unpressed((-1.0, 0.5), [near]) == pytest.approx((-1.0, 0.5))
    strong = replace(WEIGHTS, attract_per_s=10.0, draws_mps=1.4)
    north_mps, _ = correction_mps(strong, around(near, to_place_m=(5.0, 0.0)))
    assert north_mps < 0.0


def test_what_the_rules_add_is_bounded_and_eased() -> None:
    crowd = [seen(0.5 * math.cos(a), 0.5 * math.sin(a)) for a in (0.0, 0.3, 0.6)]
    strong = replace(WEIGHTS, away_per_s=50.0, attract_per_s=50.0)
    mps = math.hypot(*correction_mps(strong, around(*crowd, to_place_m=(-90.0, 0.0))))
    assert mps == pytest.approx(WEIGHTS.most_mps)
    assert bounded((3.0, 4.0), 1.0) == pytest.approx((0.6, 0.8))
    assert eased((1.0, 0.0), (1.0, 3.0), 0.5) == pytest.approx((1.0, 0.5))


def test_the_switch_lets_the_swarm_cluster() -> None:
    clustered = WEIGHTS.clustered()
    assert clustered.towards_per_s == WEIGHTS.switch * WEIGHTS.towards_per_s
    assert replace(clustered, towards_per_s=WEIGHTS.towards_per_s) == WEIGHTS
    assert replace(WEIGHTS, switch=1.0).clustered() == replace(WEIGHTS, switch=1.0)


# ---- articulation points -------------------------------------------------------------------------


def test_an_articulation_point_is_found() -> None:
    chain = {1: at(0.0), 2: at(-4.0), 3: at(-8.0)}
    assert set(nx.articulation_points(links(chain, LINK_M))) == {2}
    assert hangs_on_one(links(chain, LINK_M))
    assert not hangs_on_one(links({1: at(0.0), 2: at(-4.0), 3: at(-2.0, 3.0)}, LINK_M))
    assert hangs_on_one(links({1: at(0.0), 2: at(-LINK_M - 0.1)}, LINK_M)), (
        "it is in two parts already"
    )
    assert not hangs_on_one(links({1: at(0.0)}, LINK_M))


def test_weights_change_while_one_vehicle_holds_two_parts_together() -> None:
    told = three((-4.0, 0.0), (-8.0, 0.0), (-12.0, 0.0))
    swarm = Swarm(told.known, WEIGHTS)
    swarm.prepare(0.0)
    assert swarm.clusters
    for system_id, place_m in ((SECOND, (-6.0, 3.0)), (THIRD, (-6.0, -1.0))):
        told.vehicles[system_id].at_m = place_m
        told.now_s = 0.1
        told.report(system_id)
    swarm.prepare(0.1)
    assert swarm.clusters, "for a while longer"
    told.now_s = 0.2 + CLUSTERS_S
    for system_id in told.vehicles:
        told.report(system_id)
    swarm.prepare(told.now_s)
    assert not swarm.clusters


# ---- whom a sonar watches ------------------------------------------------------------------------


def three(*places_m: tuple[float, float]) -> Told:
    """A leader at the origin and three followers that are led."""
    followers = dict(zip((FOLLOWER, SECOND, THIRD), map(Vehicle, places_m), strict=True))
    told = Told({LEADER: Vehicle((0.0, 0.0)), **followers}, settings=SWARM)
    for follower in told.known.followers.values():
        follower.standing, follower.flying = Standing(Phase.LED), True
    return told


def test_a_sonar_watches_the_nearest_ahead_within_reach_else_the_leader() -> None:
    told = three((-4.0, 0.0), (-8.0, 0.0), (-30.0, 0.0))
    Swarm(told.known, WEIGHTS).prepare(0.0)
    first, second, third = told.known.followers.values()
    assert told.known.ahead_of(first) is None
    assert told.known.ahead_of(second) is first
    assert told.known.ahead_of(third) is None, "nobody is within its reach"


def test_one_that_is_not_led_is_watched_no_longer() -> None:
    told = three((-4.0, 0.0), (-8.0, 0.0), (-30.0, 0.0))
    swarm = Swarm(told.known, WEIGHTS)
    swarm.prepare(0.0)
    first, second, _ = told.known.followers.values()
    first.standing = Standing(Phase.WATCHED)
    swarm.prepare(0.1)
    assert told.known.ahead_of(second) is None


def test_it_looks_at_whom_it_watches_and_flies_no_faster_than_is_flown() -> None:
    told = three((-4.0, 0.0), (-8.0, 3.0), (-9.0, -3.0))
    told.vehicles[LEADER].velocity_mps = (60.0, 0.0)
    told.now_s = 0.1
    told.report(LEADER)
    swarm = Swarm(told.known, WEIGHTS)
    swarm.prepare(0.1)
    _, second, _ = told.known.followers.values()
    fix = told.known.leader.fix
    assert fix is not None
    guided = swarm.guided(second, fix, 0.1)
    assert guided.yaw_rad == pytest.approx(math.atan2(-3.0, 4.0), abs=0.01)
    assert math.hypot(*guided.velocity_mps) == pytest.approx(FASTEST_MPS)


def test_what_is_known_of_the_receivers_goes_with_a_sonar_to_the_next_one() -> None:
    """The second's own receiver jumped: it sees everybody off by as much."""
    told = three((-4.0, 0.0), (-8.0, 0.0), (-30.0, 0.0))
    first, second, _ = told.known.followers.values()
    second.estimate.jumped((1.0, 0.0))
    told.known.watch({second.plan.system_id: first})
    assert second.estimate.shift_m == pytest.approx((1.0, 0.0), abs=1e-9)
    assert list(told.known.chain(second)) == [second, first]
    told.known.watch({second.plan.system_id: None})
    assert list(told.known.chain(second)) == [second]


# ---- in a session --------------------------------------------------------------------------------


def yard() -> Yard:
    """Three followers far apart behind a leader at 1 m/s, and they fly as fast."""
    places_m = {
        LEADER: (0.0, 0.0),
        FOLLOWER: (-9.0, 0.0),
        SECOND: (-16.0, 6.0),
        THIRD: (-16.0, -6.0),
    }
    vehicles = {one: Vehicle(place_m, (1.0, 0.0)) for one, place_m in places_m.items()}
    for one in vehicles.values():
        one.parameters["ECHO_DIST"] = WEIGHTS.near_m
    limits = Limits(min_separation_m=1.0, home_difference_m=5.0)
    return Yard(vehicles=vehicles, slots=[Slot(WEIGHTS.near_m)] * 3, limits=limits, settings=SWARM)


def test_points_carry_the_rules_velocity_and_the_applet_flies_them_as_they_are() -> None:
    there = yard()
    first, *behind = there.fly(6.0)[-3:]
    assert first.vx < 0.5, "in front, 9 m from the leader, it waits for the others"
    assert all(1.5 < point.vx < 2.6 for point in behind)
    assert behind[0].vy < 0.0 < behind[1].vy, "they draw together"
    for follower in there.session.followers.values():
        assert follower.command is not None
        assert follower.command.for_applet.manner is Manner.MAKE_WAY
        assert follower.guided is not None
        assert ned_between(follower.guided.point, follower.command.place) == pytest.approx(
            (*STILL, 0.0), abs=0.1
        )


def test_a_stale_leader_stops_a_swarm_as_it_stops_slots() -> None:
    there = yard()
    there.fly(6.0)
    there.vehicles[LEADER].silent = True
    points = there.fly(2.0)[-3:]
    for follower in there.session.followers.values():
        assert follower.standing == Standing(Phase.HELD, STALE)
    assert all((point.vx, point.vy) == STILL for point in points)


def test_stale_neighbours_are_no_neighbours_and_are_kept_clear_of() -> None:
    """One that has fallen silent is out of the rules; the envelope knows where it stands."""
    there = yard()
    there.fly(6.0)
    there.vehicles[SECOND].silent = True
    there.fly(5.0)
    follower = there.session.followers[FOLLOWER]
    swarm = there.session.swarm
    assert swarm is not None
    here = follower.then(there.now_s)
    assert here is not None
    assert len(list(swarm._others(follower, here, there.now_s))) == 1
    assert there.session.followers[SECOND].left_at is not None


def test_the_envelope_bends_what_the_rules_want() -> None:
    """Six neighbours anywhere: what is flown closes on none of them faster than it may."""
    chance, answer = random.Random(7), Answer()
    for _ in range(50):
        at_m = [(chance.uniform(-8.0, 8.0), chance.uniform(-8.0, 8.0)) for _ in range(6)]
        others = [Other("o", (-n, -e, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0) for n, e in at_m]
        if min(map(certain_distance_m, others)) < 2.0:
            continue
        wanted = correction_mps(
            WEIGHTS, around(*(seen(*one) for one in at_m), to_place_m=(9.0, 0.0))
        )
        (north, east, _), _ = keep_apart((*wanted, 0.0), others, answer)
        for (n, e), other in zip(at_m, others, strict=True):
            closing_mps = (north * n + east * e) / math.hypot(n, e)
            stops_m = closing_mps * answer.dead_s + closing_mps**2 / (2.0 * answer.decel_mps2)
            assert closing_mps <= 0.01 or certain_distance_m(other) - stops_m >= 0.99


# ---- in the simulator ----------------------------------------------------------------------------


def test_the_shipped_swarm_starts_scattered_and_keeps_apart() -> None:
    scenario = load_scenario("swarm", ["duration_s=12"])
    assert len(scenario.slots()) == scenario.swarm.followers == 6
    assert scenario.guidance_settings().swarm == WEIGHTS
    assert scenario.leader.speed_mps == 2.0
    flight = FormationFlight(scenario, 8001)
    result = flight.run()
    assert result.closest_m >= 1.0
    moved_m = math.dist(result.flights[0].follower_ned_m[0], result.flights[0].follower_ned_m[-1])
    assert moved_m > 5.0


def test_a_swarm_starts_behind_its_leader_and_apart() -> None:
    swarm = load_scenario("swarm", ["swarm.followers=50"]).swarm
    places_m = scattered_m(swarm, random.Random(1))
    assert len(places_m) == 50
    assert max(north_m for north_m, _ in places_m) < -swarm.near_m
    apart_m = [math.dist(a, b) for i, a in enumerate(places_m) for b in places_m[:i]]
    assert min(apart_m) >= swarm.scatter_m


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("swarm.followers=-1", "swarm.followers"),
        ("swarm.followers=many", "swarm.followers"),
        ("swarm.align=2", "swarm.align"),
        ("swarm.near_m=0.5", "swarm.near_m"),
        ("swarm.cohesion=1", "swarm.cohesion: no such key"),
        ("formation.slots=[{radius_m=3.0}]", "a swarm has no slots"),
        ('law="bands"', "a swarm needs points with a velocity"),
        ("guidance.gray=true", "a swarm needs points with a velocity"),
    ],
)
def test_what_a_swarm_cannot_be_is_said(change: str, said: str) -> None:
    with pytest.raises(EchowingError, match=said):
        load_scenario("swarm", [change])


def test_a_swarm_is_not_served_to_the_field_tool() -> None:
    with pytest.raises(EchowingError, match="a swarm is for simulated flights"):
        serve(load_scenario("swarm"), 1, 5760)
