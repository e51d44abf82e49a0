"""The follow session: MAVLink of leader and followers in, guided points out. Pure.

Messages and the time are arguments; sockets, radios and clocks are the caller's. The simulator
and the tool for real vehicles drive this same class.

What it will not do (design rule 6): it never changes a vehicle's mode of its own accord (a stop
switch in the pilot's hand may), it sends points only to a vehicle that reports itself flying in
Guided, and on old or jumping leader data it stops the follower where it is. In the field a
`guard` stops it for more reasons, and sees that it stands.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.alignment import History, Report
from echowing.flight.engage import Engagement
from echowing.flight.envelope import Answer, Other, is_in_the_way, keep_apart
from echowing.flight.estimate import (
    LONGEST_CARRY_S,
    Estimate,
    carried_on,
    place_then,
)
from echowing.flight.guard import Guard, Limits, RateWatch, is_flying, mode_name
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    Horizontal,
    LeaderFix,
    Slot,
    SlotGuide,
    bearing_rad,
    is_stale,
    lead_share,
    predicted,
    sway_rad,
)
from echowing.flight.jumps import SAME_RANGE_M, UNCONFIRMED_S, OwnJump, RangeMemory
from echowing.flight.leader_track import LeaderTrack, VehicleClock, is_late
from echowing.flight.offset_grid import Wandering
from echowing.flight.sonar import DETECTION_LIMIT_M
from echowing.flight.take_off import Lift, TakeOff, TakeOffs
from echowing.flight.tow_bar import TowBar
from echowing.geo import GlobalPosition, Ned, displace, distance_m, ned_between, wrap_angle_rad
from echowing.mavlink.messages import (
    FORWARD,
    HEARTBEAT_PERIOD_S,
    TOOL_SYSTEM_ID,
    heading_of,
    is_nonsense,
    message_interval,
    position_target,
    sonar_range_m,
    status_text,
    tool_heartbeat,
)

GUIDED_MODE = 4
STALE = "leader is stale"

# The co-processor's newest single reading (firmware/README.md). Where it has not come for so long
# (a signed link refuses it, as no autopilot signs it), DISTANCE_SENSOR stands in.
SONAR_READING = "SNR_RAW"
RAW_FRESH_S = 1.0

# The co-processor averages over 0.45 s: its middle.
AVERAGE_AGE_S = 0.225

# Reports that agree on a leader's new place before the sonar is asked of it (0.5 s at 4 Hz), and
# how long before the jump it has to have detected the leader.
CONFIRMING_REPORTS, HEARD_S = 2, 3.0
# A stop keeps the wanted altitude where it is this near (barometers wander), else its own.
SAME_ALTITUDE_M = 1.0
FOLLOWER_POSITION_HZ = 10.0
DISTANCE_HZ = 5.0
# The same is not said again sooner, however often it comes and goes.
REMARK_GAP_S = 10.0

RATE_REQUEST_PERIOD_S = 5.0

# Guided's answer to a place off its own: 1 m/s for each metre (PSC_NE_POS_P), 5 m/s at the most.
POSITION_GAIN_PER_S, CORRECTION_MOST_MPS = 1.0, 5.0
# A longer way to the vehicle than this is not led over: the leader may have turned by then.
LONGEST_WAY_S = 1.0
# A leader that the sonar does not hear is approached no faster than this, for a copter stops from
# it within the beam's reach less what receivers are off.
JOIN_MPS, HEARD_LATELY_S = 1.5, 1.5
# Not heard for so long, the leader is looked for where it most likely is.
LOST_S = 1.0
# A stop begins once it leans against its motion; a follower that hardly moves stops where it is.
LEAN_S, STANDS_MPS = 0.3, 0.3
# A hold that had to give way is from then on where the vehicle has been moved to.
MOVED_M = 0.5
# Two receivers of which no sonar knows more.
UNRANGED_SIGMA_M = math.sqrt(2.0) * Wandering().sigma_m


@dataclass(slots=True)
class FollowerPlan:
    """One follower: its system id, its slot, its altitude above its home."""

    system_id: int
    slot: Slot
    altitude_m: float = 10.0

    @property
    def wanted_m(self) -> float:
        """Its altitude above its home, the slot's step included."""
        return self.altitude_m + self.slot.altitude_step_m


class Guide(Protocol):
    """Where a follower is to be: a `SlotGuide`, or anything that answers like one."""

    def update(
        self,
        fix: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
    ) -> GuidedPoint:
        """The guided point at `now_s` from the newest report of the leader."""


@dataclass(slots=True)
class FollowerState:
    """What is known and wanted of one follower.

    held_at, held_altitude_m, hold_reason: where, how high above its home and why it was stopped;
    in_guided: flies in Guided; flown: it was put in the air, or a point has gone to it, by us since
    it was put in Guided; sent_to: points might go to it at the last tick; position_at_s: when it
    was there, as far as TIMESYNC tells, else when the report came; feed_mps: the velocity to go
    with the point (north, east), None: none; yaw_rad: where it was last told to look; gives_way_to:
    for whose sake it is not flown as planned; latched: why it is held until it leaves Guided.
    """

    plan: FollowerPlan
    guide: Guide
    bar: TowBar
    clock: VehicleClock = field(default_factory=VehicleClock)
    estimate: Estimate = field(default_factory=Estimate)
    ranges: RangeMemory = field(default_factory=RangeMemory)
    own_jump: OwnJump = field(default_factory=OwnJump)
    latched: str | None = None
    raw_at_s: float = -math.inf
    feed_mps: Horizontal | None = None
    yaw_rad: float | None = None
    gives_way_to: str | None = None
    gave_way_at_s: float = -math.inf
    position: GlobalPosition | None = None
    newest_boot_ms: int = -1
    position_at_s: float = -math.inf
    altitude_m: float | None = None
    velocity_mps: Horizontal = (0.0, 0.0)
    ground_speed_mps: float = 0.0
    climb_mps: float = 0.0
    heading_rad: float = 0.0
    mode: int | None = None
    mode_at_s: float = -math.inf
    armed: bool = False
    flying: bool = False
    in_guided: bool = False
    flown: bool = False
    sent_to: bool = False
    held_at: GlobalPosition | None = None
    held_altitude_m: float | None = None
    hold_reason: str | None = None
    guided: GuidedPoint | None = None

    @property
    def guided_mode(self) -> bool:
        """Whether it is in Guided, in the air or not."""
        return self.mode == GUIDED_MODE


class FollowSession:
    """One leader, any number of followers.

    `tick` is called at the rate of the guided points (thesis Table 4: 8 Hz) and returns the
    messages to send, each with the system id of the vehicle it is for. With `limits` a guard
    watches (see `guard`); while not `engaged`, no point is sent but to stop what has taken off by
    `take_off`.
    """

    def __init__(
        self,
        leader_id: int,
        plans: Iterable[FollowerPlan],
        settings: GuidanceSettings,
        *,
        leader_rate_hz: float = 4.0,
        limits: Limits | None = None,
        engaged: bool = True,
        take_off: TakeOff | None = None,
        leaders_height: bool = False,
    ) -> None:
        plans = list(plans)
        longest_m = max((plan.slot.radius_m for plan in plans), default=None)
        self.leader_id = leader_id
        self.settings = settings
        self.leader = LeaderTrack()
        self.followers = {
            plan.system_id: FollowerState(
                plan, SlotGuide(plan.slot, settings), TowBar(plan.slot, longest_m)
            )
            for plan in plans
        }
        self._leader_history = History()
        self.events: list[tuple[float, str]] = []
        self.engaged = engaged
        self.leaders_height = leaders_height
        self.guard = None if limits is None else self._make_guard(limits)
        self.engagement: Engagement | None = None
        if limits is not None and limits.ready is not None:
            self.engagement = Engagement(limits.ready, leader_id, self.followers, self._say)
        self.take_offs = None if take_off is None else TakeOffs(take_off, self.followers, self._say)
        self.alerts = 0
        """How much has been said that somebody should look up for."""
        self._hud: list[tuple[int, Any]] = []
        self._stopping: str | None = None
        self._leader_rate_hz = leader_rate_hz
        self._rates = None if limits is None else RateWatch(self._wanted(), self._say)
        self._leader_jumps = self._two_leaders = False
        self._beat_at_s = -math.inf
        self._rates_at_s = -math.inf
        self._heard: set[int] = set()

    def receive(self, message: Any, now_s: float) -> None:
        """Take any MAVLink message from any link; what is not needed is ignored."""
        system_id = message.get_srcSystem()
        kind = message.get_type()
        if is_nonsense(kind, message):
            return
        if self.guard is not None and (system_id == self.leader_id or system_id in self.followers):
            self.guard.receive(system_id, kind, message, now_s)
        if system_id not in self._heard and self._clock(system_id) is not None:
            # What was asked before may have had no way to it: a listening port knows none.
            self._heard.add(system_id)
            self._rates_at_s = -math.inf
        if self.engagement is not None:
            self.engagement.receive(system_id, kind, message)
        if self._rates is not None:
            self._rates.received(system_id, message.get_msgId())
        if kind == "TIMESYNC":
            self._timesync(system_id, message, now_s)
        elif system_id == self.leader_id and kind == "GLOBAL_POSITION_INT":
            self._leader_position(message, now_s)
        elif system_id in self.followers:
            self._follower_message(self.followers[system_id], kind, message, now_s)

    def tick(self, now_s: float) -> list[tuple[int, Any]]:
        """The messages to send now: guided points, time synchronisation, heartbeat, rates."""
        messages = self._housekeeping(now_s)
        if self.engagement is not None:
            self.engagement.prepare(self, now_s)
            messages.extend(self.engagement.messages(now_s))
        if self.take_offs is not None:
            messages.extend(self._lift(self.take_offs, now_s))
        for system_id, follower in self.followers.items():
            self._settle_own_jump(follower, now_s)
            point = self._point_for(follower, now_s)
            before, follower.sent_to = follower.sent_to, self.sends_to(follower, now_s)
            if follower.sent_to and not before and follower.held_at is not None:
                point = self._hold_anew(follower, now_s)
            if point is not None and follower.sent_to:
                point = self._kept_apart(follower, point, now_s)
                messages.append((system_id, self._target(follower, point, now_s)))
                self._sent(follower, point, now_s)
        messages.extend(self._hud)
        self._hud.clear()
        if self.guard is not None and (self.engaged or self.take_offs is not None):
            messages.extend(self.guard.messages(self.followers, now_s))
        return messages

    def stop(self, reason: str) -> None:
        """Stop every follower that has been moved, for good; the others are left alone."""
        self._stopping = reason

    def stopped(self, now_s: float) -> bool:
        """Whether all that has been moved stands, is the pilot's, or cannot be heard."""
        return all(
            not self.sends_to(follower, now_s)
            or (self.guard is not None and self.guard.stands(system_id))
            for system_id, follower in self.followers.items()
        )

    def _make_guard(self, limits: Limits) -> Guard:
        return Guard(limits, self.leader_id, self.followers, self._say)

    def sends_to(self, follower: FollowerState, now_s: float) -> bool:
        """Whether points go to this follower now."""
        stopped_rising = self.lift_of(follower) is Lift.STOPPED and follower.guided_mode
        ours = follower.in_guided or (stopped_rising and follower.armed)
        if not ours or not self._may_lead(follower):
            return False
        if self._stopping is not None and not follower.flown:
            return False
        if self._stopping is None and not stopped_rising and not self._cleared(follower):
            return False
        return self.guard is None or self.guard.lets(follower, now_s)

    def _cleared(self, follower: FollowerState) -> bool:
        """Whether all that has to be right before its first point is."""
        return self.engagement is None or self.engagement.cleared(follower.plan.system_id)

    def _may_lead(self, follower: FollowerState) -> bool:
        """Whether points may go to one that flies in Guided: none while it takes off."""
        lift = self.lift_of(follower)
        if lift in (Lift.CLIMBING, Lift.STOPPED):
            return lift is Lift.STOPPED
        return self.engaged or (follower.flown and self._stopping is not None)

    def lift_of(self, follower: FollowerState) -> Lift | None:
        """How far its take-off is; None: no take-off was asked for."""
        if self.take_offs is None:
            return None
        return self.take_offs.lift(follower.plan.system_id)

    def _lift(self, take_offs: TakeOffs, now_s: float) -> list[tuple[int, Any]]:
        if self._stopping is not None:
            take_offs.stop(self._stopping, now_s)

        def objection(follower: FollowerState) -> str | None:
            if self.guard is None:
                return None
            if self.guard.switched(follower.plan.system_id):
                return "stop switch"
            fix = self.leader.fix
            leader = None if fix is None else self.leader_for(follower, fix, now_s)
            if self.engagement is not None and not follower.flying:
                unready = self.engagement.objection_to_take_off(self, follower, now_s)
                if unready is not None:
                    return unready
            return self.guard.too_near(follower, leader, self.followers, now_s)

        messages = take_offs.messages(self.followers, objection, now_s)
        for follower in self.followers.values():
            # A point at its own place ends a take-off that is under way, on the ground too.
            follower.flown = follower.flown or self.lift_of(follower) is Lift.STOPPED
        return messages

    def _sent(self, follower: FollowerState, point: GlobalPosition, now_s: float) -> None:
        follower.flown = True
        if self.guard is None:
            return
        self.guard.sent(follower.plan.system_id, point, now_s)
        if follower.held_at is not None:
            self.guard.holding(follower, now_s)

    def _point_for(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        fix = self.leader.fix
        follower.feed_mps = None
        reason = self._reason_to_stop(follower, fix, now_s)
        if reason is not None:
            return self._hold(follower, reason, now_s)
        if fix is None:
            return None
        if follower.held_at is not None:
            self._let_go(follower, now_s)
        follower.guided = self._guide(follower, fix, now_s)
        if self.settings.feed_forward:
            follower.feed_mps = follower.guided.velocity_mps
            return self._joined_slowly(follower, follower.guided.point, now_s)
        return follower.guided.point

    def _joined_slowly(
        self, follower: FollowerState, point: GlobalPosition, now_s: float
    ) -> GlobalPosition:
        """The point, no further off than makes a fast approach to a leader that is not heard."""
        here = self._follower_then(follower, now_s + self._way_s(follower))
        if here is None or follower.estimate.offset.unheard_s(now_s) < HEARD_LATELY_S:
            return point
        north, east, down = ned_between(here, point)
        share = min(1.0, JOIN_MPS / POSITION_GAIN_PER_S / max(math.hypot(north, east), 1e-6))
        return displace(here, (share * north, share * east, down))

    def _kept_apart(
        self, follower: FollowerState, point: GlobalPosition, now_s: float
    ) -> GlobalPosition:
        """The point that leaves everybody room (see `flight.envelope`), its velocity with it."""
        least_m = None if self.guard is None else self.guard.limits.min_separation_m
        here = self._follower_then(follower, now_s + self._way_s(follower))
        if least_m is None or here is None:
            return point
        wanted = _wanted_mps(here, point, follower.feed_mps)
        others = self._others(follower, here, now_s)
        flown, other = keep_apart(wanted, others, Answer(), least_m)
        self._give_way(follower, other, now_s)
        if other is None:
            return point
        if _moved_off(follower):
            follower.held_at = follower.position
        if follower.feed_mps is None:
            north, east = (mps / POSITION_GAIN_PER_S for mps in flown[:2])
            return displace(here, (north, east, here.alt_m - point.alt_m))
        north, east = follower.feed_mps
        follower.feed_mps = north + flown[0] - wanted[0], east + flown[1] - wanted[1]
        return point

    def _give_way(self, follower: FollowerState, other: Other | None, now_s: float) -> None:
        """Note, and tell, for whose sake a follower is flown otherwise than planned."""
        name = None if other is None else other.name
        begins = name is not None and name != follower.gives_way_to
        if begins and now_s - follower.gave_way_at_s >= REMARK_GAP_S:
            follower.gave_way_at_s = now_s
            self._say(now_s, f"follower {follower.plan.system_id}: gives way to {name}")
        follower.gives_way_to = name

    def _others(self, follower: FollowerState, here: GlobalPosition, now_s: float) -> list[Other]:
        """The vehicles about a follower that is `here` when the order reaches it."""
        arrives_s = now_s + self._way_s(follower)
        mine = self._in_height(follower.plan.system_id, here)
        goal = here if follower.guided is None else follower.guided.slot
        others = []
        leader = self._leader_then(follower, arrives_s)
        # Of a stale leader nothing is known but that it was there: to flee from all that it could
        # have done since is no safer than to stand.
        stale = is_stale(self._leader_age_s(now_s), self.settings)
        if leader is not None and not stale:
            place = self._in_height(self.leader_id, leader.position)
            sigma_m = follower.estimate.offset.sigma_m(bearing_rad(here, leader.position))
            others.append(
                Other(
                    "the leader",
                    ned_between(place, mine),
                    leader.velocity_ned_mps,
                    sigma_m,
                    self._leader_age_s(arrives_s),
                )
            )
        for system_id, other in self.followers.items():
            there = None if other is follower else self._follower_then(other, arrives_s)
            if there is not None:
                place = self._in_height(system_id, there)
                velocity = (*other.velocity_mps, -other.climb_mps)
                age_s = arrives_s - other.position_at_s
                name = f"follower {system_id}"
                in_the_way = is_in_the_way(ned_between(here, there), ned_between(here, goal))
                from_it_m = ned_between(place, mine)
                others.append(Other(name, from_it_m, velocity, UNRANGED_SIGMA_M, age_s, in_the_way))
        return others

    def _in_height(self, system_id: int, place: GlobalPosition) -> GlobalPosition:
        return place if self.guard is None else self.guard.in_height(system_id, place)

    def _leader_age_s(self, at_s: float) -> float:
        return math.inf if self.leader.fix is None else max(0.0, at_s - self.leader.fix.time_s)

    def _leader_then(self, follower: FollowerState, at_s: float) -> LeaderFix | None:
        """The leader at a moment, in this follower's frame; None: nothing is known of it."""
        fix = self.leader.fix
        if fix is None or self._leader_age_s(at_s) > LONGEST_CARRY_S:
            return None
        if self.settings.learn_offset:
            fix = replace(fix, position=follower.estimate.as_seen(fix.position))
        return carried_on(fix, at_s)

    def _follower_then(self, follower: FollowerState, at_s: float) -> GlobalPosition | None:
        """Where a follower is at a moment; None: not known."""
        since_s = at_s - follower.position_at_s
        if follower.position is None or since_s > LONGEST_CARRY_S:
            return None
        velocity = (*follower.velocity_mps, -follower.climb_mps)
        return place_then(follower.position, velocity, since_s)

    @staticmethod
    def _way_s(follower: FollowerState) -> float:
        """How long a point takes to its vehicle."""
        return min(LONGEST_WAY_S, follower.clock.round_trip_s / 2.0)

    def _reason_to_stop(
        self, follower: FollowerState, fix: LeaderFix | None, now_s: float
    ) -> str | None:
        if self._stopping is not None:
            return self._stopping
        if self.take_offs is not None:
            stopped = self.take_offs.reason_to_hold(follower.plan.system_id)
            if stopped is not None:
                return stopped
        if fix is None:
            return None
        if is_stale(now_s - fix.time_s, self.settings):
            return STALE
        if self.guard is None:
            return None
        leader = self.leader_for(follower, fix, now_s)
        stop = self.guard.reason_to_stop(follower, leader, self.followers, now_s)
        return self._doubt(follower) or stop

    def _doubt(self, follower: FollowerState) -> str | None:
        """Why what is known of it, or of the leader, is not to be believed now."""
        if follower.latched is not None or follower.own_jump.since_s is not None:
            return follower.latched or "its position jumps"
        if self.engagement is None or not self._cleared(follower):
            return None
        return self.engagement.reason_to_stop(self, follower)

    def leader_for(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GlobalPosition:
        """Where the leader is now, as this follower's receiver would have it."""
        now = predicted(fix, max(0.0, now_s - fix.time_s)).position
        return follower.estimate.as_seen(now) if self.settings.learn_offset else now

    def _let_go(self, follower: FollowerState, now_s: float) -> None:
        again = "leader heard again" if follower.hold_reason == STALE else "clear again"
        self._release(follower)
        if self._moves(follower):
            self.alert(follower.plan.system_id, f"{again}, following", mavlink.MAV_SEVERITY_NOTICE)
            self._say(now_s, f"follower {follower.plan.system_id}: {again}, following")

    def _release(self, follower: FollowerState) -> None:
        follower.held_at = follower.hold_reason = follower.held_altitude_m = None
        if self.guard is not None:
            self.guard.moving(follower.plan.system_id)

    def _moves(self, follower: FollowerState) -> bool:
        """Whether it is ours to move, so that a stop is worth a word."""
        engaged = self.engaged and self._cleared(follower)
        return self.guard is None or (follower.in_guided and (engaged or follower.flown))

    def _guide(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GuidedPoint:
        settings, least_m = self.settings, 0.0
        if settings.learn_offset:
            offset = follower.estimate.offset
            offset.advance(now_s)
            line_rad = self._line_rad(follower, now_s)
            unsure_m = settings.standoff_sigmas * offset.unproven_sigma_m(line_rad, now_s)
            least_m = settings.clearance_m + unsure_m + offset.unproven_shift_m(line_rad, now_s)
        if settings.feed_forward:
            guided = self._towed(follower, fix, now_s, least_m)
        elif settings.learn_offset:
            seen = replace(fix, position=follower.estimate.as_seen(fix.position))
            guided = follower.guide.update(seen, now_s, follower.position, least_m)
        else:
            return follower.guide.update(fix, now_s, follower.position)
        return self._looking_around(follower, guided, now_s)

    def _towed(
        self, follower: FollowerState, fix: LeaderFix, now_s: float, least_m: float
    ) -> GuidedPoint:
        """The slot on its bar when the point reaches the vehicle, and its velocity.

        The velocity fades as the leader's report grows old.
        """
        arrives_s = now_s + self._way_s(follower)
        leader = self._leader_then(follower, arrives_s) or fix
        here = self._follower_then(follower, arrives_s)
        guided = follower.bar.update(leader, arrives_s, here, least_m)
        age_s = max(0.0, now_s - fix.time_s)
        share = lead_share(age_s, self.settings)
        north, east = guided.velocity_mps
        return replace(guided, age_s=age_s, velocity_mps=(share * north, share * east))

    def _looking_around(
        self, follower: FollowerState, guided: GuidedPoint, now_s: float
    ) -> GuidedPoint:
        """Turn the nose to where the leader most likely is, or to both sides to learn where."""
        offset, here = follower.estimate.offset, follower.position
        if guided.yaw_rad is None or here is None:
            return guided
        if offset.unheard_s(now_s) > LOST_S:
            north, east = offset.most_likely_m
            leader = displace(guided.leader, (offset.north_m - north, offset.east_m - east, 0.0))
            return replace(guided, yaw_rad=bearing_rad(here, leader))
        across_m = offset.sigma_m(guided.yaw_rad + math.pi / 2.0)
        unsure_rad = across_m / max(1.0, distance_m(here, guided.leader))
        off_rad = sway_rad(unsure_rad, now_s)
        return replace(guided, yaw_rad=wrap_angle_rad(guided.yaw_rad + off_rad))

    def _target(self, follower: FollowerState, point: GlobalPosition, now_s: float) -> Any:
        if follower.held_at is None:
            follower.yaw_rad = None if follower.guided is None else follower.guided.yaw_rad
        elif self.settings.face_leader:
            follower.yaw_rad = self._bearing_of_leader(follower, now_s)
        altitude_m = follower.held_altitude_m
        if altitude_m is None:
            altitude_m = self._wanted_m(follower)
        return position_target(
            follower.plan.system_id, point, altitude_m, follower.yaw_rad, now_s, follower.feed_mps
        )

    def _bearing_of_leader(self, follower: FollowerState, now_s: float) -> float | None:
        """Where to look while it is stopped: at the leader, or where it looked before."""
        leader = self._leader_then(follower, now_s)
        here = self._follower_then(follower, now_s)
        if leader is None or here is None:
            return follower.yaw_rad
        return bearing_rad(here, leader.position)

    def _wanted_m(self, follower: FollowerState) -> float:
        """Above its own home: the same height as the leader's altitude above the leader's."""
        plan = follower.plan
        shift_m = 0.0 if self.guard is None else self.guard.altitude_shift_m(plan.system_id)
        return plan.wanted_m + shift_m

    def take_leaders_height(self, follower: FollowerState) -> None:
        """Where no altitude was asked for: a follower flies as high as the leader does now."""
        height_m = self._leaders_height_m()
        if self.leaders_height and height_m is not None:
            follower.plan.altitude_m = round(height_m, 1)

    def height_wanted_m(self, follower: FollowerState) -> float | None:
        """What it is to fly at above its own home; None: not known yet."""
        if self.leaders_height and self._leaders_height_m() is None:
            return None
        return self._wanted_m(follower)

    def _leaders_height_m(self) -> float | None:
        """The leader's altitude above its home."""
        home_m = None if self.guard is None else self.guard.home_m(self.leader_id)
        if home_m is None or self.leader.fix is None:
            return None
        return self.leader.fix.position.alt_m - home_m

    def _line_rad(self, follower: FollowerState, now_s: float) -> float:
        """Bearing from the follower to the leader."""
        leader, here = self._leader_then(follower, now_s), self._follower_then(follower, now_s)
        return 0.0 if leader is None or here is None else bearing_rad(here, leader.position)

    def _hold(self, follower: FollowerState, reason: str, now_s: float) -> GlobalPosition | None:
        """Stop: a target where it comes to a stop, kept until there is no reason left."""
        if follower.held_at is None and follower.position is not None:
            follower.held_at = self._stopping_place(follower, now_s)
            follower.held_altitude_m = self._altitude_to_keep(follower)
            if self._moves(follower):
                self.alert(follower.plan.system_id, f"holding, {reason}")
                self._say(now_s, f"follower {follower.plan.system_id}: {reason}, holding")
        follower.hold_reason = reason
        return follower.held_at

    def _stopping_place(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        """Where a follower comes to a stop: a place it has to come back to would take longer."""
        mps = math.hypot(*follower.velocity_mps)
        share_s = LEAN_S + mps / (2.0 * Answer().decel_mps2) if mps > STANDS_MPS else 0.0
        then = self._follower_then(follower, now_s + self._way_s(follower) + share_s)
        return then or follower.position

    def _hold_anew(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        """Stop where it is now: it was held while nothing went to it, and has moved since."""
        follower.held_at = self._stopping_place(follower, now_s)
        follower.held_altitude_m = self._altitude_to_keep(follower)
        if self.guard is not None:
            self.guard.moving(follower.plan.system_id)
        return follower.held_at

    def _altitude_to_keep(self, follower: FollowerState) -> float:
        """Above its home: the wanted altitude where it is about there, else its own."""
        wanted_m = self._wanted_m(follower)
        if follower.altitude_m is None or abs(follower.altitude_m - wanted_m) <= SAME_ALTITUDE_M:
            return wanted_m
        return follower.altitude_m

    def alert(
        self, system_id: int, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING
    ) -> None:
        """Tell a follower's pilot on his display, in the field only, and whoever looks here."""
        if self.engagement is not None:
            self.alerts += 1
            self._hud.append((system_id, status_text(severity, f"Echowing: {text}")))

    def _say(self, now_s: float, text: str) -> None:
        self.events.append((now_s, text))

    def _timesync(self, system_id: int, message: Any, now_s: float) -> None:
        clock = self._clock(system_id)
        if clock is not None and message.tc1 != 0 and clock.has_asked(message.ts1):
            clock.answered(message.ts1 / 1e9, message.tc1 / 1e9, now_s)

    def _clock(self, system_id: int) -> VehicleClock | None:
        if system_id == self.leader_id:
            return self.leader.clock
        follower = self.followers.get(system_id)
        return follower.clock if follower else None

    def _follower_message(
        self, follower: FollowerState, kind: str, message: Any, now_s: float
    ) -> None:
        if kind == "GLOBAL_POSITION_INT":
            if is_late(message.time_boot_ms, follower.newest_boot_ms):
                return
            if message.time_boot_ms < follower.newest_boot_ms:
                follower.clock.restarted()
                follower.estimate.history.clear()
            follower.newest_boot_ms = message.time_boot_ms
            follower.position = GlobalPosition(
                message.lat / 1e7, message.lon / 1e7, message.alt / 1e3
            )
            follower.position_at_s = follower.clock.to_ours(message.time_boot_ms / 1e3, now_s)
            follower.altitude_m = message.relative_alt / 1e3
            follower.velocity_mps = message.vx / 100.0, message.vy / 100.0
            follower.ground_speed_mps = math.hypot(message.vx, message.vy) / 100.0
            follower.climb_mps = -message.vz / 100.0
            follower.heading_rad = heading_of(message, follower.heading_rad)
            report = Report(
                follower.position_at_s,
                follower.position,
                follower.velocity_mps,
                follower.heading_rad,
            )
            self._note_own_jump(follower, report)
            follower.estimate.reported(report)
        elif kind == "NAMED_VALUE_FLOAT" and message.name == SONAR_READING:
            self._raw_reading(follower, message, now_s)
        elif kind == "DISTANCE_SENSOR" and message.orientation == FORWARD:
            self._distance(follower, message, now_s)
        elif kind == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self._mode(follower, message, now_s)
        elif kind == "COMMAND_ACK":
            self._acknowledged(follower, message, now_s)

    def _acknowledged(self, follower: FollowerState, message: Any, now_s: float) -> None:
        ours = message.target_system in (0, TOOL_SYSTEM_ID)
        if self.take_offs is not None and ours:
            self.take_offs.acknowledged(follower, message, now_s)
        if self.guard is not None and ours:
            self.guard.switches.mode_answered(follower.plan.system_id, message, now_s)

    def _raw_reading(self, follower: FollowerState, message: Any, now_s: float) -> None:
        follower.raw_at_s = now_s
        way_s = self._way_s(follower)
        time_s = follower.estimate.sonar_clock.to_ours(message.time_boot_ms / 1e3, now_s, way_s)
        self._remember_range(follower, time_s, message.value)
        follower.estimate.heard(time_s, message.value, self.settings.sonar_inset_m)

    def _distance(self, follower: FollowerState, message: Any, now_s: float) -> None:
        """DISTANCE_SENSOR, an average: where single readings do not come it has to do."""
        range_m = sonar_range_m(message)
        if range_m is not None and now_s - follower.raw_at_s > RAW_FRESH_S:
            time_s = now_s - self._way_s(follower) - AVERAGE_AGE_S
            self._remember_range(follower, time_s, range_m)
            follower.estimate.heard(time_s, range_m, self.settings.sonar_inset_m)

    @staticmethod
    def _remember_range(follower: FollowerState, time_s: float, range_m: float) -> None:
        if 0.0 < range_m < DETECTION_LIMIT_M:
            follower.ranges.add(time_s, range_m)

    # ---- jumps ----------------------------------------------------------------------------------

    def _sonar_denies(self, follower: FollowerState, since_s: float) -> bool:
        """Whether its sonar, which detected the leader, ranges it as before that moment."""
        if not self.settings.learn_offset or follower.estimate.offset.unheard_s(since_s) > HEARD_S:
            return False
        return follower.ranges.unchanged(since_s)

    def _settle_leaders_jump(self, now_s: float) -> None:
        """A jump that the sonar denies is the receiver's: it goes into everybody's estimate."""
        since_s = self.leader.jump_since_s
        if since_s is None or self.leader.agreeing < CONFIRMING_REPORTS:
            return
        if not any(self._sonar_denies(one, since_s) for one in self.followers.values()):
            return
        moved_m = self.leader.believe_jump()
        self._leader_history.clear()
        for follower in self.followers.values():
            follower.estimate.jumped(moved_m)
        self._say(
            now_s,
            f"leader's receiver jumped by {math.hypot(*moved_m):.1f} m: the sonar's range did not "
            "change, allowed for",
        )

    def _believed_elsewhere(self, now_s: float) -> None:
        """The leader is believed in a new place that no sonar knows: nobody is flown there."""
        self._forget_offsets()
        jump_m = math.hypot(*self.leader.jump_m)
        for follower in self.followers.values():
            follower.latched = f"leader jumped by {jump_m:.1f} m, until it leaves Guided"
            if follower.flown:
                self.alert(follower.plan.system_id, f"holding, leader jumped by {jump_m:.1f} m")
        self._say(
            now_s,
            f"leader's reports agree {jump_m:.1f} m away from where it was: nobody is flown there "
            "until its pilot has left Guided and come back",
        )

    def _note_own_jump(self, follower: FollowerState, report: Report) -> None:
        moved_m = None if self.engagement is None else follower.own_jump.reported(report)
        if moved_m is None:
            return
        follower.estimate.history.clear()
        if follower.held_at is not None:
            # Where it stands has another name now.
            follower.held_at = displace(follower.held_at, (*moved_m, 0.0))

    def _settle_own_jump(self, follower: FollowerState, now_s: float) -> None:
        jump = follower.own_jump
        if jump.since_s is None:
            return
        moved_m = jump.moved_m
        far_m = math.hypot(*moved_m)
        denied = self._sonar_denies(follower, jump.since_s)
        if not denied and now_s - jump.since_s < UNCONFIRMED_S:
            return
        jump.settled()
        if not follower.in_guided or far_m < SAME_RANGE_M:
            return
        if denied:
            follower.estimate.jumped((-moved_m[0], -moved_m[1]))
            text = "the sonar's range did not change, allowed for"
        else:
            follower.latched = f"its position jumped by {far_m:.1f} m, until it leaves Guided"
            text = "held until its pilot has left Guided and come back"
        self._say(
            now_s,
            f"follower {follower.plan.system_id}: its receiver jumped by {far_m:.1f} m: {text}",
        )

    def _refuse_two_leaders(self, now_s: float) -> None:
        """Two boot clocks in turn: two vehicles with the leader's id."""
        if self._two_leaders or not self.leader.clocks.two_at_once(now_s):
            return
        self._two_leaders = True
        text = (
            f"system {self.leader_id}: two boot clocks at once: two vehicles with this id, or an "
            "old recording on the link; give each vehicle a MAV_SYSID (SYSID_THISMAV) of its own"
        )
        self._say(now_s, text)
        for follower in self.followers.values():
            follower.latched = "two vehicles with the leader's id, until it leaves Guided"
        if self.engagement is not None:
            self.engagement.doubt(self.leader_id, "two vehicles with the leader's id", now_s)

    def _forget_offsets(self) -> None:
        """A leader believed in a new place: what was learnt of its receiver is void."""
        self._leader_history.clear()
        for follower in self.followers.values():
            follower.estimate.forget()

    def _leader_position(self, message: Any, now_s: float) -> None:
        rejected, jumps = self.leader.rejected, self.leader.jumps
        before = self.leader.fix
        self.leader.receive(message, now_s)
        if self.leader.jumps > jumps and self.guard is None:
            self._forget_offsets()
        elif self.leader.jumps > jumps:
            self._believed_elsewhere(now_s)
        if self.guard is not None:
            self._settle_leaders_jump(now_s)
            self._refuse_two_leaders(now_s)
        if self.leader.fix is not None and self.leader.fix is not before:
            self._note_leader(self.leader.fix)
        jumped = self.leader.rejected > rejected
        if self.guard is not None and jumped and not self._leader_jumps:
            self._say(now_s, "leader jumps: not believed until its reports agree again")
        self._leader_jumps = jumped

    def _note_leader(self, fix: LeaderFix) -> None:
        self._leader_history.add(
            Report(fix.time_s, fix.position, fix.velocity_ned_mps[:2], fix.heading_rad)
        )
        if self.settings.learn_offset:
            for follower in self.followers.values():
                follower.estimate.learn(self._leader_history)

    def _mode(self, follower: FollowerState, heartbeat: Any, now_s: float) -> None:
        follower.mode, follower.mode_at_s = heartbeat.custom_mode, now_s
        follower.armed = bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        follower.flying = is_flying(heartbeat)
        if self.take_offs is not None and not (follower.armed and follower.guided_mode):
            self.take_offs.taken_over(follower.plan.system_id)
        in_guided = follower.flying and follower.guided_mode
        if in_guided is follower.in_guided:
            return
        follower.in_guided = in_guided
        follower.latched = None
        follower.own_jump.settled()
        # Whatever was held against it, and wherever it was held, was in another flight.
        climbs = self.lift_of(follower) in (Lift.CLIMBING, Lift.STOPPED)
        follower.flown = in_guided and climbs
        self._release(follower)
        if not in_guided:
            left = f"left Guided for {mode_name(heartbeat.custom_mode)}"
            if heartbeat.custom_mode == GUIDED_MODE:
                left = "not flying any more"
            self._say(now_s, f"follower {follower.plan.system_id}: {left}, hands off")
        elif self.guard is not None:
            if self.engagement is not None:
                self.engagement.entered_guided(follower.plan.system_id)
            self.guard.entered_guided(follower.plan.system_id, now_s)
            deed = "taking off" if climbs else "following" if self.engaged else "only watched"
            self._say(now_s, f"follower {follower.plan.system_id}: in Guided, {deed}")

    def _housekeeping(self, now_s: float) -> list[tuple[int, Any]]:
        messages: list[tuple[int, Any]] = []
        vehicles = [self.leader_id, *self.followers]
        for system_id in vehicles:
            clock = self._clock(system_id)
            if clock is not None and clock.due(now_s):
                stamp_ns = clock.asks(now_s)
                messages.append((system_id, mavlink.MAVLink_timesync_message(0, stamp_ns)))
        if now_s - self._beat_at_s >= HEARTBEAT_PERIOD_S:
            self._beat_at_s = now_s
            messages.extend((system_id, tool_heartbeat()) for system_id in vehicles)
        if now_s - self._rates_at_s >= RATE_REQUEST_PERIOD_S:
            self._rates_at_s = now_s
            messages.extend(self._rate_requests())
        if self._rates is not None:
            self._rates.check(now_s)
        return messages

    def _rate_requests(self) -> list[tuple[int, Any]]:
        return [
            (system_id, message_interval(system_id, message_id, round(1e6 / rate_hz)))
            for system_id, message_id, rate_hz in (*self._wanted(), *self._wanted_at_times())
        ]

    def _wanted_at_times(self) -> list[tuple[int, int, float]]:
        """As `_wanted`, but nobody is told where it does not come: it does not always."""
        if self.guard is None:
            return []
        wanted = self.guard.read_back_requests(feed_forward=self.settings.feed_forward)
        if self.engagement is not None:
            wanted += self.engagement.requests()
        if self.settings.learn_offset:
            distance = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
            wanted += [(system_id, distance, DISTANCE_HZ) for system_id in self.followers]
        return wanted

    def _wanted(self) -> list[tuple[int, int, float]]:
        """What each vehicle is to send: system id, message id, rate in Hz."""
        position = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        return [
            (self.leader_id, position, self._leader_rate_hz),
            *((system_id, position, FOLLOWER_POSITION_HZ) for system_id in self.followers),
            *(self.guard.requests() if self.guard is not None else ()),
        ]


def _moved_off(follower: FollowerState) -> bool:
    """Whether one that is held has been moved away from its place."""
    if follower.held_at is None or follower.position is None:
        return False
    return distance_m(follower.held_at, follower.position) > MOVED_M


def _wanted_mps(here: GlobalPosition, point: GlobalPosition, feed_mps: Horizontal | None) -> Ned:
    """The velocity with which Guided answers a point, and its velocity, from here."""
    north, east, _ = ned_between(here, point)
    pace = POSITION_GAIN_PER_S
    far_m = math.hypot(north, east)
    if far_m * pace > CORRECTION_MOST_MPS:
        pace = CORRECTION_MOST_MPS / far_m
    feed_north, feed_east = feed_mps or (0.0, 0.0)
    return feed_north + pace * north, feed_east + pace * east, 0.0
