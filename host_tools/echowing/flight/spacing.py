"""The envelope's place in a tick: who is near a follower, and what it may be commanded. Pure."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from echowing.flight.envelope import (
    FASTEST_MPS,
    OTHERS_MPS2,
    SURE_SIGMAS,
    Other,
    is_in_the_way,
    keep_apart,
    straight_out,
)
from echowing.flight.follower import FollowerState
from echowing.flight.guard import Guard
from echowing.flight.guidance import Horizontal
from echowing.flight.jumps import SAME_RANGE_M
from echowing.flight.known import Known
from echowing.flight.plan import LEAST_MPS
from echowing.flight.said import Said
from echowing.flight.steps import Allowed, Phase, Plan, name_of
from echowing.geo import GlobalPosition, Ned, displace, ned_between

# A leader in its sonar is held by the applet, and points with a velocity are answered by it: 1 m/s
# for each metre (`gently` in lua/echowing.lua). Other points are Guided's (`Closing`).
HOLD_PER_S = 1.0
# In a line it flies back by so much faster than its point, whatever is missing (lua/echowing.lua).
LINE_BACK_MPS = 0.4
# ECHO_SPD_LOST of the applet: how fast a follower closes on its point that hears nobody.
CLOSES_MPS = 3.0


class Spacing:
    """Keeps the followers of one session `min_separation_m` from everybody, where that is set.

    gives_way(system_id, name, now_s): reports for which vehicle a follower leaves its plan.
    """

    def __init__(
        self, known: Known, guard: Guard | None, gives_way: Callable[[int, str, float], None]
    ) -> None:
        self._known, self._guard, self._gives_way = known, guard, gives_way
        self._least_m = None if guard is None else guard.limits.min_separation_m
        self._said = Said()

    def allowed(self, follower: FollowerState, plan: Plan, now_s: float) -> Allowed:
        """The place and velocity nearest to the plan's that leave everybody room (`envelope`)."""
        unchanged, here = Allowed(plan.place, plan.velocity_mps), follower.on_arrival(now_s)
        if self._least_m is None or here is None or self._switched(follower):
            return unchanged
        wanted = self._wanted_mps(follower, here, plan, now_s)
        others = self._others(follower, here, now_s)
        own_mps = (*follower.velocity_then(now_s + follower.way_s), -follower.climb_mps)
        answer = follower.handling.answer
        # Who has others behind does not fly back faster than he has to.
        pushes = any(one.standing.sent_to for one in self._known.behind(follower))
        braked_mps = None if pushes else own_mps
        flown, other = keep_apart(wanted, others, answer, self._least_m, braked_mps)
        if other is None:
            return unchanged
        self._remark(follower, other.name, now_s)
        urgent = straight_out(flown, other, others, answer, self._least_m, own_mps)
        if plan.velocity_mps is None or (other.led and _by_guided(follower, now_s)):
            flies = _point_moved(follower, here, plan, urgent or flown)
        else:
            flies = _redirected(here, plan, (wanted, flown), urgent)
        return replace(flies, gives_way_to=other.name, makes_way=not other.watched)

    def _wanted_mps(
        self, follower: FollowerState, here: GlobalPosition, plan: Plan, now_s: float
    ) -> Ned:
        """The velocity with which a follower that is here answers its plan."""
        north, east, _ = ned_between(here, plan.place)
        far_m = math.hypot(north, east)
        feed_north, feed_east = plan.velocity_mps or (0.0, 0.0)
        if plan.velocity_mps is None or not follower.estimate.hears(now_s):
            pace = follower.handling.closing.pace_per_s(far_m)
            return feed_north + pace * north, feed_east + pace * east, 0.0
        pace = min(HOLD_PER_S, FASTEST_MPS / max(far_m, 1e-9))
        north_mps, east_mps = pace * north, pace * east
        wanted = feed_north + north_mps, feed_east + east_mps, 0.0
        if self._known.ahead_of(follower) is None:
            return wanted
        back_mps = self._not_flown_back_mps(
            follower, plan.velocity_mps, (north_mps, east_mps), now_s
        )
        return wanted[0] + back_mps[0], wanted[1] + back_mps[1], 0.0

    def _not_flown_back_mps(
        self,
        follower: FollowerState,
        point_mps: Horizontal,
        correction_mps: Horizontal,
        now_s: float,
    ) -> Horizontal:
        """What the applet of one in a line takes off a correction that leads back."""
        bearing = self._known.bearing_of_watched(follower, now_s)
        if bearing is None:
            return 0.0, 0.0
        north, east = math.cos(bearing), math.sin(bearing)
        feed_mps = point_mps[0] * north + point_mps[1] * east
        flown_mps = feed_mps + correction_mps[0] * north + correction_mps[1] * east
        less_mps = max(0.0, min(0.0, feed_mps) - LINE_BACK_MPS - flown_mps)
        return less_mps * north, less_mps * east

    def _switched(self, follower: FollowerState) -> bool:
        """Whether its pilot's stop switch has stopped it: then nothing of ours moves it."""
        return self._guard is not None and self._guard.switched(follower.plan.system_id)

    def _remark(self, follower: FollowerState, name: str, now_s: float) -> None:
        """Say for which vehicle a follower leaves its plan."""
        system_id = follower.plan.system_id
        if self._said.may_say((system_id, name), now_s):
            self._gives_way(system_id, name, now_s)

    def _others(self, follower: FollowerState, here: GlobalPosition, now_s: float) -> list[Other]:
        """The vehicles around a follower that is `here` when the order reaches it."""
        arrives_s = now_s + follower.way_s
        others = list(self._leaders(follower, here, now_s, arrives_s))
        goal = here if follower.guided is None else follower.guided.slot
        goal = goal if follower.hold is None else follower.hold.place
        to_goal_m = ned_between(here, goal)
        for other in self._known.followers.values():
            if other is not follower and self._makes_room(follower, other):
                others.extend(self._other(follower, here, other, to_goal_m, arrives_s))
        return others

    def _leaders(
        self, follower: FollowerState, here: GlobalPosition, now_s: float, arrives_s: float
    ) -> Iterator[Other]:
        """The leader where it is seen, and where it is if receivers that have jumped erred."""
        known, least_m = self._known, self._least_m
        assert least_m is not None
        leader = known.leader_then(follower, arrives_s)
        # Of a stale leader only an old place is known. By now it may be anywhere: to fly away from
        # all of that is no safer than to stand.
        if leader is None or known.leader_is_stale(now_s):
            return
        ranged = known.ahead_of(follower) is None
        unsure_m = SURE_SIGMAS * known.leader_sigma_m(follower)
        for place in (leader.position, *_if_erred(leader.position, known.doubted_m(follower))):
            yield Other(
                name_of(known.leader_id, known.leader_id),
                known.from_it_m(known.leader_id, place, follower, here),
                leader.velocity_ned_mps,
                known.nearer_m(follower, ned_between(here, place)[:2], least_m)
                if ranged
                else unsure_m,
                known.leader_age_s(arrives_s),
                brakes_mps2=0.0 if self._looks_for_it(follower, now_s) else OTHERS_MPS2,
                watched=ranged,
            )

    def _looks_for_it(self, follower: FollowerState, now_s: float) -> bool:
        """Whether its sonar is still to find the leader.

        Until then it is kept further off, because the receivers may be wrong. With room for its
        braking on top the follower would stay out of the sonar's reach, and never find it.
        """
        ranged = self._known.ahead_of(follower) is None
        within_reach = ranged and follower.plan.slot.radius_m < follower.plan.sonar.reach_m
        return within_reach and not follower.estimate.hears(now_s)

    def _makes_room(self, one: FollowerState, other: FollowerState) -> bool:
        """Whether one keeps away from another: held it stands, and those led past it give way.

        Two that are held keep apart, and it gives way to one that its applet flies by itself.
        """
        led_past = other.standing.phase is Phase.LED and not self._flies_itself(other)
        return not (one.standing.held and led_past)

    def _flies_itself(self, follower: FollowerState) -> bool:
        """Whether its applet flies it, and takes no points."""
        system_id = follower.plan.system_id
        return self._guard is not None and self._guard.ignores_points(system_id)

    def _other(
        self,
        follower: FollowerState,
        here: GlobalPosition,
        other: FollowerState,
        to_goal_m: Ned,
        arrives_s: float,
    ) -> Iterator[Other]:
        """Another follower: where it is seen, and where it is if its receiver, or ours, erred.

        Where no sonar ranges it, nothing tells which place is right after a receiver has jumped.
        """
        system_id = other.plan.system_id
        by_itself = self._flies_itself(other)
        led = other.standing.sent_to and not by_itself
        age_s, velocity = 0.0, (0.0, 0.0, 0.0)
        there, flown_mps = other.straight_on(arrives_s), other.velocity_mps
        if there is None:
            there = other.left_at
        else:
            if not by_itself:
                there, flown_mps = _worse(follower, here, other, arrives_s)
            velocity = (*flown_mps, -other.climb_mps)
            age_s = arrives_s - other.position_at_s
        if there is None:
            return
        mine, its = follower.own_jump.total_m, other.own_jump.total_m
        assert self._least_m is not None
        seen, unsure_m = self._known.seen(follower, here, other, there, self._least_m)
        for place in (seen, *_if_erred(there, (mine[0] - its[0], mine[1] - its[1]))):
            yield Other(
                name_of(system_id, self._known.leader_id),
                self._known.from_it_m(system_id, place, follower, here),
                velocity,
                unsure_m,
                age_s,
                is_in_the_way(ned_between(here, place), to_goal_m),
                # An applet that flies by itself knows of nobody beside it.
                led=led,
                makes_room=led and self._makes_room(other, follower),
                stops_mps2=other.handling.answer.decel_mps2,
                watched=self._known.ahead_of(follower) is other,
            )


def _worse(
    follower: FollowerState, here: GlobalPosition, other: FollowerState, arrives_s: float
) -> tuple[GlobalPosition, Horizontal]:
    """Where another follower is then, and its velocity: by its orders or as it last flew.

    By its orders, so that nobody runs into one in front that brakes; as it last flew, as its applet
    flies it back from one that its sonar hears too near, whatever it is ordered. Of both the one
    that comes nearer faster.
    """
    answers_s = arrives_s + follower.handling.answer.dead_s
    ordered, straight = other.then(arrives_s), other.straight_on(arrives_s)
    assert ordered is not None and straight is not None
    north_m, east_m, _ = ned_between(ordered, here)
    motions = (ordered, other.velocity_then(answers_s)), (straight, other.velocity_mps)
    return max(motions, key=lambda one: one[1][0] * north_m + one[1][1] * east_m)


def _if_erred(there: GlobalPosition, shift_m: Horizontal) -> Iterator[GlobalPosition]:
    """The other's place if its jumps and ours were errors of the receivers, not movements."""
    if math.hypot(*shift_m) >= SAME_RANGE_M:
        yield displace(there, (*shift_m, 0.0))


def _by_guided(follower: FollowerState, now_s: float) -> bool:
    """Whether Guided flies its points as they are: its applet holds none that does not hear."""
    return follower.standing.held or not follower.estimate.hears(now_s)


def _point_moved(
    follower: FollowerState, here: GlobalPosition, plan: Plan, flown_mps: Ned
) -> Allowed:
    """The place which Guided closes with what the envelope wants to be flown; its slot's velocity.

    Were all of it in the velocity, a vehicle that the next orders do not reach would fly on with
    it, and faster, as its place goes ahead of it. For one that is led, and makes way too, that is
    worse than the later answer; before the leader it is not. Guided closes with `CLOSES_MPS` at the
    most: what is more has to be velocity.
    """
    feeds = plan.velocity_mps is not None and not follower.standing.held
    feed = follower.guided.slot_mps if feeds and follower.guided is not None else (0.0, 0.0)
    north, east = flown_mps[0] - feed[0], flown_mps[1] - feed[1]
    mps = max(math.hypot(north, east), 1e-9)
    closes_mps = min(mps, CLOSES_MPS) if feeds else mps
    share_s = follower.handling.closing.distance_m(closes_mps) / mps
    place = displace(here, (share_s * north, share_s * east, here.alt_m - plan.place.alt_m))
    if not feeds:
        return Allowed(place, plan.velocity_mps)
    left = 1.0 - closes_mps / mps
    return Allowed(place, (feed[0] + left * north or LEAST_MPS, feed[1] + left * east))


def _redirected(
    here: GlobalPosition,
    plan: Plan,
    wanted_flown_mps: tuple[Ned, Ned],
    urgent_mps: Ned | None,
) -> Allowed:
    """The velocity which it answers with what the envelope wants to be flown."""
    if urgent_mps is not None:
        # The place is where the vehicle is, so that it corrects nothing across the way out.
        up_m = here.alt_m - plan.place.alt_m
        return Allowed(displace(here, (0.0, 0.0, up_m)), urgent_mps[:2])
    wanted, flown = wanted_flown_mps
    north, east = plan.velocity_mps or (0.0, 0.0)
    return Allowed(plan.place, (north + flown[0] - wanted[0], east + flown[1] - wanted[1]))
