"""The plan: where a follower is to be, how fast, and where it looks. Pure."""

import math
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerState
from echowing.flight.formation import receivers_demand_m
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    LeaderFix,
    held_behind,
    lead_share,
)
from echowing.flight.handling import least_slot_m
from echowing.flight.hearing import Heard
from echowing.flight.known import Known
from echowing.flight.leader_track import MOST_MPS2
from echowing.flight.look import Look
from echowing.flight.said import Said, Say
from echowing.flight.steps import Plan
from echowing.flight.swarm import Swarm
from echowing.geo import displace, distance_m, ned_between

# A slot is approached no faster than this, beside its own velocity: a copter stops from it within
# the beam's reach, even if the receivers are wrong. Half of what is left is closed in a second.
# With all of it a follower on 4.8 went back and forth by a metre: its answer comes half a second
# late.
JOIN_MPS, CATCH_UP_PER_S = 1.5, 0.5
# A leader that is not heard gets more room, the less its place is known; but the follower stays so
# far within the sonar's reach.
WITHIN_REACH_M = 0.7
# So much of that room is given up at the most to stay where the leader's legs are heard: who is
# there stops 0.75 m from a leader that stops while it is not heard.
GIVEN_UP_M = 0.25
# One that looks for whom it is to follow comes in this fast: a metre takes a round of the figure 8.
COMES_IN_MPS = 0.25
# Within this time a leader's acceleration is another: ArduCopter changes it by 5 m/s3
# (PSC_JERK_NE), all of its 2.5 m/s2 in half a second.
QUICKENS_S = 0.5
# The speed sent for a slot that stands: the applet takes a point without any velocity for a hold.
LEAST_MPS = 0.001
# A slot that opened for a fast leader counts as closed when it needs less than its radius by this.
SLACK_M = 0.3
# A sonar that hears worse than believed is told of once it has for so long, then after so long.
WORSE_LASTS_S, WORSE_AGAIN_S = 5.0, 120.0
# At most as long as what `hearing` tells pilots.
UNDIRECTED = "sonar axis unknown: update firmware"


class Planner:
    """Plans for the followers of one session.

    reverses: slots leave room for a leader that turns round; swarm: what leads followers that have
    no slots. say(now_s, text) is for the operator, alert(system_id, text, severity) for a
    follower's pilot.
    """

    def __init__(
        self,
        known: Known,
        say: Say,
        alert: Callable[..., None],
        *,
        reverses: bool,
        swarm: Swarm | None = None,
    ) -> None:
        self._known, self._say, self._alert = known, say, alert
        self._reverses, self._swarm = reverses, swarm
        self._said = Said(WORSE_AGAIN_S)

    def plan(self, follower: FollowerState, look: Look | None, now_s: float) -> Plan | None:
        """Where a follower is to be, also one that is only watched; None: that is not known."""
        if follower.standing.held:
            return self._staying(follower, now_s)
        fix = self._known.leader.fix
        if fix is None or self._known.leader_is_stale(now_s):
            return None
        # Until it is cleared, its limits may be on their way, and what is not known is the worst.
        if self._reverses and follower.turn.cleared:
            self._allow_for_reversal(follower, fix, now_s)
        if self._swarm is None:
            guided = follower.guided = planned(self._known, follower, fix, now_s)
        else:
            guided = follower.guided = self._swarm.guided(follower, fix, now_s)
        heard = follower.estimate.hearing.heard()
        self._tell_of_hearing(follower, heard, now_s)
        self._allow_for_hearing(follower, heard, fix, now_s)
        yaw_rad = guided.yaw_rad
        if yaw_rad is not None and look and look.nose_rad is not None:
            yaw_rad = look.nose_rad
        north_mps, east_mps = guided.velocity_mps
        velocity = (north_mps or LEAST_MPS, east_mps) if self._feeds else None
        return Plan(guided.point, velocity, yaw_rad, follower.opens_m)

    @property
    def _feeds(self) -> bool:
        return self._known.settings.feed_forward

    def _staying(self, follower: FollowerState, now_s: float) -> Plan | None:
        """The plan of one that is held.

        It has a velocity too: for another kind of target Guided restarts, with the present lean for
        its steady part (init_xy_controller); one that brakes would swing for seconds.
        """
        if follower.hold is None:
            return None
        yaw_rad = None if follower.command is None else follower.command.yaw_rad
        if self._known.settings.face_leader:
            bearing_rad = self._known.bearing_of_watched(follower, now_s)
            yaw_rad = yaw_rad if bearing_rad is None else bearing_rad
        velocity = (0.0, 0.0) if self._feeds else None
        return Plan(follower.hold.place, velocity, yaw_rad, follower.opens_m)

    def _allow_for_reversal(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> None:
        """Open the slot so far that it gets away if the leader turns round at its speed."""
        speed_mps, handling = round(fix.speed_mps, 1), follower.handling
        radius_m, brakes_mps2 = follower.plan.slot.radius_m, self._known.leader_brakes_mps2
        noticed_s = follower.plan.sonar.noticed_s
        needs_m, calm_m = (
            least_slot_m(speed_mps, answer, noticed_s, brakes_mps2=brakes_mps2)
            for answer in (handling.answer, handling.answer_in_calm)
        )
        follower.reversal_m = needs_m
        opens = needs_m > radius_m
        if opens and not follower.opens:
            why = f"leader at {speed_mps:.1f} m/s"
            if calm_m <= radius_m:
                why = f"wind leaves {handling.wind_leaves_mps2:.1f} m/s2 to brake"
            system_id, text = follower.plan.system_id, f"slot opens to {needs_m:.1f} m, {why}"
            self._alert(system_id, text, mavlink.MAV_SEVERITY_NOTICE)
            self._say(
                now_s,
                f"follower {system_id}: {text}: the least from which it gets away should the "
                "leader turn round",
            )
        follower.opens = opens or (follower.opens and needs_m > radius_m - SLACK_M)

    def _tell_of_hearing(self, follower: FollowerState, heard: Heard, now_s: float) -> None:
        """Say that its sonar hears worse than its file says: its pilots decide whether it may.

        Or that its co-processor's readings come and where it looks does not.
        """
        undirected = follower.readings.are_single(now_s) and not follower.estimate.points(now_s)
        self._tell_if_lasting(follower, "axis", UNDIRECTED if undirected else None, now_s)
        self._tell_if_lasting(follower, "hearing", None if undirected else heard.worse, now_s)

    def _tell_if_lasting(
        self, follower: FollowerState, what: str, worse: str | None, now_s: float
    ) -> None:
        if worse is None:
            follower.worse_since_s.pop(what, None)
            return
        system_id = follower.plan.system_id
        lasts = now_s - follower.worse_since_s.setdefault(what, now_s) >= WORSE_LASTS_S
        if lasts and follower.standing.sent_to and self._said.may_say((system_id, what), now_s):
            self._alert(system_id, worse, mavlink.MAV_SEVERITY_NOTICE)
            self._say(now_s, f"follower {system_id}: {worse}")

    def _allow_for_hearing(
        self, follower: FollowerState, heard: Heard, fix: LeaderFix, now_s: float
    ) -> None:
        """Open the slot once its sonar, as it is heard, carries it no more.

        To the nearest that it carries, else as far as reports alone allow. Until as much is heard
        as its file says: around what a slot takes it would open and close each minute.
        """
        before, radius_m = follower.heard_as, follower.slot.radius_m
        if not follower.standing.sent_to:
            follower.heard_as, follower.by_ear_m = None, 0.0
            return
        why = self._against(follower, heard, radius_m)
        lasts = now_s - follower.worse_since_s.get("hearing", math.inf) >= WORSE_LASTS_S
        if why and lasts:
            follower.heard_as = heard.sonar
        elif heard.worse is None and (heard.of_believed or 0.0) >= 1.0:
            follower.heard_as = None
        follower.by_ear_m = self._by_ear_m(follower, fix)
        if (follower.heard_as is None) is (before is None):
            return
        slot = f"slot {max(radius_m, follower.least_m):.1f} m"
        again = "sonar not good enough" if follower.heard_as else "sonar as believed again"
        text = f"{again}, {slot}"
        system_id = follower.plan.system_id
        self._alert(system_id, text, mavlink.MAV_SEVERITY_NOTICE)
        self._say(now_s, ": ".join(filter(None, (f"follower {system_id}", text, why))))

    @staticmethod
    def _against(follower: FollowerState, heard: Heard, radius_m: float) -> str | None:
        """What its sonar, as it is heard, has against its slot.

        Of a kind that its file does not name: that is known, and flown all the same. One that its
        file says is too far would be heard still less from a wider one.
        """
        if heard.sonar is None:
            return None
        known = follower.plan.sonar.objections(radius_m)
        if "far" in known:
            return None
        found = heard.sonar.objections(radius_m).items()
        return next((text for kind, text in found if kind not in known), None)

    def _by_ear_m(self, follower: FollowerState, fix: LeaderFix) -> float:
        """The nearest slot by a sonar that hears too little; 0: it hears enough.

        No further than readings tell how much it hears, or it would never be seen to hear again.
        """
        sonar, radius_m = follower.heard_as, follower.slot.radius_m
        if sonar is None:
            return 0.0
        carried_m = sonar.nearest_carried_m(radius_m, (radius_m, sonar.reach_m))
        opens_m = _by_radio_m(self._known, follower, fix) if carried_m is None else carried_m
        return min(opens_m, follower.estimate.hearing.counts_to_m)


def planned(known: Known, follower: FollowerState, fix: LeaderFix, now_s: float) -> GuidedPoint:
    """The slot at the moment the point reaches the vehicle, and the point that leads to it.

    With feed-forward: the slot and its velocity. Position alone: a point ahead of the slot.
    """
    settings = known.settings
    least_m = max(follower.least_m, _comes_in_m(known, follower, now_s))
    arrives_s = now_s + follower.way_s
    leader, here = known.followed_then(follower, fix, arrives_s), follower.then(arrives_s)
    if settings.learn_offset:
        if here is not None:
            watched = known.watched_then(follower, arrives_s) or leader
            to_it_m = ned_between(here, watched.position)[:2]
            least_m = max(least_m, known.nearest_m(follower, to_it_m, settings.clearance_m))
        if not follower.estimate.hears(now_s):
            least_m = max(least_m, _by_radio_m(known, follower, fix))
    formation_mps = known.formation_mps(fix, arrives_s)
    guided = follower.guide.update(leader, arrives_s, here, least_m, formation_mps)
    age_s = max(0.0, now_s - fix.time_s)
    guided = replace(guided, age_s=age_s, at_s=arrives_s, slot_mps=guided.velocity_mps)
    if settings.feed_forward:
        guided = _gently(known, follower, guided, now_s)
    elif settings.lead_time_s > 0.0:
        guided = _led(guided, leader, settings)
    return guided if settings.face_leader else replace(guided, yaw_rad=None)


def _comes_in_m(known: Known, follower: FollowerState, now_s: float) -> float:
    """The nearest slot of one that has not found whom its sonar looks at; 0: any.

    Who waits stays as far off as receivers alone allow. From there he comes in slowly, so that his
    sonar has looked to all sides before he is where it hears the next one in the line: one took
    that for whom he looked for, and came to 0.1 m of him.
    """
    turn, waits_m = follower.turn, receivers_demand_m(known.settings.clearance_m)
    if turn.waits:
        return waits_m
    if math.isinf(turn.seeks_at_s):
        return 0.0
    return max(0.0, waits_m - COMES_IN_MPS * (now_s - turn.seeks_at_s))


def _by_radio_m(known: Known, follower: FollowerState, fix: LeaderFix) -> float:
    """The nearest slot from which it still stops if its leader does and only reports show that.

    With a sonar that has heard the leader, and is likely deaf now or hears too little: gets away
    from a reversal. No further than the sonar's reach, less what the receivers may be off: beyond,
    the leader would never be heard again. Nor, by a sonar that works, than the leader's legs are
    heard, if that leaves nearly as much room.
    """
    estimate = follower.estimate
    trusted = follower.heard_as is None and estimate.offset.deaf_share <= 0.5
    stops = math.isinf(estimate.missed_s) or trusted
    noticed_s = round(known.leader.oldest_s + follower.way_s, 1)
    speed_mps, brakes_mps2 = round(fix.speed_mps, 1), known.leader_brakes_mps2
    answer, clear_m = follower.handling.answer, known.settings.clearance_m
    least_m = least_slot_m(speed_mps, answer, noticed_s, clear_m, brakes_mps2, stops=stops)
    sonar = follower.plan.sonar
    if stops:
        heard_m = sonar.heard_to_m + sonar.inset_m
        least_m = min(least_m, max(heard_m, least_m - GIVEN_UP_M))
    return min(sonar.reach_m - WITHIN_REACH_M, least_m)


def quickens_mps2(known: Known, follower: FollowerState, now_s: float) -> float:
    """By how much it has to speed up towards its leader, to keep its distance; held: not at all.

    The distance keeps its rate where the follower's acceleration along the beam is the leader's,
    and what turns the beam: the square of the speed across, over the distance. The older the
    report is, the less it tells of the acceleration.
    """
    fix, arrives_s = known.leader.fix, now_s + follower.way_s
    if fix is None or follower.standing.held:
        return 0.0
    share = 1.0 - (arrives_s - fix.time_s) / QUICKENS_S
    leader, here = known.leader_then(follower, arrives_s), follower.then(arrives_s)
    if leader is None or here is None or share <= 0.0:
        return 0.0
    north_m, east_m, _ = ned_between(here, leader.position)
    far_m = max(known.settings.clearance_m, math.hypot(north_m, east_m))
    own_north_mps, own_east_mps = follower.velocity_then(arrives_s)
    north_mps, east_mps, _ = leader.velocity_ned_mps
    north_mps2, east_mps2, _ = leader.acceleration_ned_mps2
    along_mps2 = (north_mps2 * north_m + east_mps2 * east_m) / far_m
    across_mps = (
        (east_mps - own_east_mps) * north_m - (north_mps - own_north_mps) * east_m
    ) / far_m
    quickens = share * (along_mps2 + across_mps * across_mps / far_m)
    return max(-MOST_MPS2, min(MOST_MPS2, quickens))


def _led(guided: GuidedPoint, leader: LeaderFix, settings: GuidanceSettings) -> GuidedPoint:
    """The slot moved along the formation's course by L1, for a point without a velocity.

    The leader's speed is taken along that course: if the leader flies back at its follower it is
    negative, and the point is further back than the slot.
    """
    cos, sin = math.cos(guided.course_rad), math.sin(guided.course_rad)
    north_mps, east_mps, _ = leader.velocity_ned_mps
    lead_s = settings.lead_time_s * lead_share(guided.age_s, settings)
    lead_m = lead_s * (north_mps * cos + east_mps * sin)
    offset_m = guided.offset_m[0] + lead_m * cos, guided.offset_m[1] + lead_m * sin
    if settings.tow_bar:
        offset_m = held_behind(offset_m, guided.course_rad, settings.clearance_m)
    up_m = guided.slot.alt_m - guided.leader.alt_m
    return replace(guided, point=displace(guided.leader, (*offset_m, -up_m)))


def _gently(
    known: Known, follower: FollowerState, guided: GuidedPoint, now_s: float
) -> GuidedPoint:
    """Send the way to a slot as a velocity.

    A place ahead would be overshot: it moves on with the vehicle that flies towards it, and Guided
    closes the last metre hard.
    """
    here = follower.on_arrival(now_s)
    if here is None:
        return guided
    # Away from the leader nothing is too fast, unless somebody is behind.
    away = distance_m(guided.point, guided.leader) >= distance_m(here, guided.leader)
    if away and not known.is_watched(follower):
        return guided
    north_m, east_m, down_m = ned_between(here, guided.point)
    per_s = JOIN_MPS / max(math.hypot(north_m, east_m), JOIN_MPS / CATCH_UP_PER_S)
    slot_north_mps, slot_east_mps = guided.velocity_mps
    return replace(
        guided,
        point=displace(here, (0.0, 0.0, down_m)),
        velocity_mps=(slot_north_mps + per_s * north_m, slot_east_mps + per_s * east_m),
    )
