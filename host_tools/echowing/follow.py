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

from echowing.feed_forward import (
    DETECTION_LIMIT_M,
    SLACK_M,
    Keeper,
    backed_off,
    moving_slot,
    no_further,
    retreat_m,
    sonar_range_m,
)
from echowing.geo import GlobalPosition, displace, ned_between, wrap_angle_rad
from echowing.guard import Guard, Limits, RateWatch, is_flying, mode_name
from echowing.guidance import (
    GuidanceSettings,
    GuidedPoint,
    Horizontal,
    LeaderFix,
    Slot,
    SlotGuide,
    is_stale,
    predicted,
    sweep_rad,
)
from echowing.leader_track import LeaderTrack, VehicleClock, is_late
from echowing.messages import (
    FORWARD,
    HEARTBEAT_PERIOD_S,
    TOOL_SYSTEM_ID,
    heading_of,
    is_nonsense,
    message_interval,
    position_target,
    tool_heartbeat,
)
from echowing.offset import RelativeOffset
from echowing.take_off import Lift, TakeOff, TakeOffs

GUIDED_MODE = 4
STALE = "leader is stale"

# The co-processor's newest single reading (firmware/README.md). Where it has not come for so long
# (a signed link refuses it, as no autopilot signs it), DISTANCE_SENSOR stands in.
SONAR_READING = "SNR_RAW"
RAW_FRESH_S = 1.0

# Propellers make single wild readings: one counts when the one before it was like it.
CONFIRM_S, CONFIRM_M = 0.3, 0.5

# A stop keeps the wanted altitude where it is this near (barometers wander), else its own.
SAME_ALTITUDE_M = 1.0
FOLLOWER_POSITION_HZ = 10.0
DISTANCE_HZ, REPELLING_HZ = 5.0, 10.0
# The same remark is not made again sooner, however often it comes and goes.
REMARK_GAP_S = 10.0

RATE_REQUEST_PERIOD_S = 5.0

POSITION_ONLY, BACKING_OFF = "position only", "backing off"
_REMARKS = {
    None: "the sonar hears the leader, points carry its velocity",
    POSITION_ONLY: "the sonar does not hear the leader, position only",
    BACKING_OFF: "too close by its sonar, backing off",
}


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
    was there, as far as TIMESYNC tells, else when the report came. With feed-forward, feed_mps: the
    velocity to go with the point (north, east), None: none; remark: what is done other than that.
    """

    plan: FollowerPlan
    guide: Guide
    clock: VehicleClock = field(default_factory=VehicleClock)
    offset: RelativeOffset = field(default_factory=RelativeOffset)
    reading: tuple[float, float] = (-math.inf, math.nan)
    """When the newest sonar reading came, and its range in metres."""
    raw_at_s: float = -math.inf
    keeper: Keeper = field(default_factory=Keeper)
    feed_mps: Horizontal | None = None
    remark: str | None = POSITION_ONLY
    remarked_at_s: dict[str | None, float] = field(default_factory=dict)
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
    ) -> None:
        self.leader_id = leader_id
        self.settings = settings
        self.leader = LeaderTrack()
        self.followers = {
            plan.system_id: FollowerState(plan, SlotGuide(plan.slot, settings)) for plan in plans
        }
        self.events: list[tuple[float, str]] = []
        self.engaged = engaged
        self.guard = None if limits is None else self._make_guard(limits)
        self.take_offs = None if take_off is None else TakeOffs(take_off, self.followers, self._say)
        self._stopping: str | None = None
        self._leader_rate_hz = leader_rate_hz
        self._rates = None if limits is None else RateWatch(self._wanted(), self._say)
        self._leader_jumps = False
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
        if self.take_offs is not None:
            messages.extend(self._lift(self.take_offs, now_s))
        for system_id, follower in self.followers.items():
            point = self._point_for(follower, now_s)
            before, follower.sent_to = follower.sent_to, self.sends_to(follower, now_s)
            if follower.sent_to and not before and follower.held_at is not None:
                point = self._hold_anew(follower)
            if point is not None and follower.sent_to:
                messages.append((system_id, self._target(follower, point, now_s)))
                self._sent(follower, point, now_s)
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
        return self.guard is None or self.guard.lets(follower, now_s)

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
        if not self.settings.feed_forward:
            return follower.guided.point
        return self._fed(follower, follower.guided, now_s)

    def _fed(
        self, follower: FollowerState, guided: GuidedPoint, now_s: float
    ) -> GlobalPosition | None:
        """The point with feed-forward: the moving slot, or the position alone, or backwards."""
        here, heading_rad = follower.position, follower.heading_rad
        keeper, way_s = follower.keeper, follower.clock.round_trip_s
        leader_mps = _along(guided.velocity_mps, heading_rad)
        closing_mps = _along(follower.velocity_mps, heading_rad) - leader_mps
        wanted_m = follower.plan.slot.radius_m - self.settings.sonar_inset_m
        if keeper.judge(now_s, closing_mps, way_s) and here is not None:
            self._remark(follower, BACKING_OFF, now_s)
            back_m = retreat_m(wanted_m, keeper.range_m(now_s, closing_mps), -leader_mps)
            return self._free_place(follower, backed_off(here, heading_rad, back_m))
        if here is None or not keeper.sees(now_s):
            self._remark(follower, POSITION_ONLY, now_s)
            return guided.point
        self._remark(follower, None, now_s)
        point, follower.feed_mps = moving_slot(guided, self.settings, way_s / 2.0)
        # Everything as it will be when the point arrives.
        north_mps, east_mps = follower.velocity_mps
        arrived = displace(here, (north_mps * way_s, east_mps * way_s, 0.0))
        most_m = keeper.range_m(now_s + way_s, closing_mps) - wanted_m + SLACK_M
        return no_further(point, arrived, heading_rad, most_m)

    def _free_place(self, follower: FollowerState, place: GlobalPosition) -> GlobalPosition | None:
        """A place to back off to; where it is, if another vehicle is there."""
        if self.guard is None or self.guard.is_free(place, follower, self.followers):
            return place
        return follower.position

    def _remark(self, follower: FollowerState, remark: str | None, now_s: float) -> None:
        """Note, and tell, what has become of the feed-forward."""
        if remark == follower.remark:
            return
        follower.remark = remark
        if now_s - follower.remarked_at_s.get(remark, -math.inf) >= REMARK_GAP_S:
            follower.remarked_at_s[remark] = now_s
            self._say(now_s, f"follower {follower.plan.system_id}: {_REMARKS[remark]}")

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
        return self.guard.reason_to_stop(follower, leader, self.followers, now_s)

    def leader_for(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GlobalPosition:
        """Where the leader is now, as this follower's receiver would have it."""
        now = predicted(fix, max(0.0, now_s - fix.time_s)).position
        if not self.settings.learn_offset:
            return now
        return displace(now, (-follower.offset.north_m, -follower.offset.east_m, 0.0))

    def _let_go(self, follower: FollowerState, now_s: float) -> None:
        again = "leader heard again" if follower.hold_reason == STALE else "clear again"
        self._release(follower)
        if self._moves(follower):
            self._say(now_s, f"follower {follower.plan.system_id}: {again}, following")

    def _release(self, follower: FollowerState) -> None:
        follower.held_at = follower.hold_reason = follower.held_altitude_m = None
        if self.guard is not None:
            self.guard.moving(follower.plan.system_id)

    def _moves(self, follower: FollowerState) -> bool:
        """Whether it is ours to move, so that a stop is worth a word."""
        return self.guard is None or (follower.in_guided and (self.engaged or follower.flown))

    def _guide(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GuidedPoint:
        if not self.settings.learn_offset:
            return follower.guide.update(fix, now_s, follower.position)
        offset = follower.offset
        offset.advance(now_s)
        moved = displace(fix.position, (-offset.north_m, -offset.east_m, 0.0))
        unsure_m = self.settings.standoff_sigmas * offset.sigma_m(self._line_rad(follower, now_s))
        least_m = self.settings.clearance_m + unsure_m
        guided = follower.guide.update(
            replace(fix, position=moved), now_s, follower.position, least_m
        )
        return self._looking_around(follower, guided, DETECTION_LIMIT_M + unsure_m, now_s)

    def _looking_around(
        self, follower: FollowerState, guided: GuidedPoint, hearing_m: float, now_s: float
    ) -> GuidedPoint:
        """Sweep the nose about the leader's bearing where the sonar could hear it and does not."""
        if guided.yaw_rad is None or follower.position is None:
            return guided
        north_m, east_m, _ = ned_between(follower.position, guided.leader)
        if math.hypot(north_m, east_m) > hearing_m:
            return guided
        off_rad = sweep_rad(follower.offset.unheard_s(now_s), now_s)
        return replace(guided, yaw_rad=wrap_angle_rad(guided.yaw_rad + off_rad))

    def _target(self, follower: FollowerState, point: GlobalPosition, now_s: float) -> Any:
        facing = follower.guided is not None and follower.held_at is None
        yaw_rad = follower.guided.yaw_rad if facing and follower.guided else None
        altitude_m = follower.held_altitude_m
        if altitude_m is None:
            altitude_m = self._wanted_m(follower)
        system_id = follower.plan.system_id
        return position_target(system_id, point, altitude_m, yaw_rad, now_s, follower.feed_mps)

    def _wanted_m(self, follower: FollowerState) -> float:
        """Above its own home: the same height as the leader's altitude above the leader's."""
        plan = follower.plan
        shift_m = 0.0 if self.guard is None else self.guard.altitude_shift_m(plan.system_id)
        return plan.wanted_m + shift_m

    def _line_rad(self, follower: FollowerState, now_s: float) -> float:
        """Bearing from the follower to the leader by their own receivers."""
        north_m, east_m = self._believed(follower, now_s) or (1.0, 0.0)
        return math.atan2(east_m, north_m)

    def _hold(self, follower: FollowerState, reason: str, now_s: float) -> GlobalPosition | None:
        """Stop where it is: a target at its own position, kept until there is no reason left."""
        if follower.held_at is None and follower.position is not None:
            follower.held_at = follower.position
            follower.held_altitude_m = self._altitude_to_keep(follower)
            if self._moves(follower):
                self._say(now_s, f"follower {follower.plan.system_id}: {reason}, holding")
        follower.hold_reason = reason
        return follower.held_at

    def _hold_anew(self, follower: FollowerState) -> GlobalPosition | None:
        """Stop where it is now: it was held while nothing went to it, and has moved since."""
        follower.held_at = follower.position
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

    def _say(self, now_s: float, text: str) -> None:
        self.events.append((now_s, text))

    def _timesync(self, system_id: int, message: Any, now_s: float) -> None:
        clock = self._clock(system_id)
        if clock is not None and message.tc1 != 0:
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
        elif kind == "NAMED_VALUE_FLOAT" and message.name == SONAR_READING:
            follower.raw_at_s = now_s
            self._sonar(follower, message.value, now_s)
        elif kind == "DISTANCE_SENSOR" and message.orientation == FORWARD:
            self._distance(follower, sonar_range_m(message), now_s)
        elif kind == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self._mode(follower, message, now_s)
        elif kind == "COMMAND_ACK":
            self._acknowledged(follower, message, now_s)

    def _acknowledged(self, follower: FollowerState, message: Any, now_s: float) -> None:
        ours = message.target_system in (0, TOOL_SYSTEM_ID)
        if self.take_offs is not None and ours:
            self.take_offs.acknowledged(follower, message, now_s)
        if self.guard is not None and ours:
            self.guard.mode_answered(follower.plan.system_id, message, now_s)

    def _distance(self, follower: FollowerState, range_m: float | None, now_s: float) -> None:
        follower.keeper.heard(now_s, range_m)
        if range_m is not None and now_s - follower.raw_at_s > RAW_FRESH_S:
            self._sonar(follower, range_m, now_s)

    def _sonar(self, follower: FollowerState, range_m: float, now_s: float) -> None:
        """Learn the receivers' disagreement from a reading that may be of the leader."""
        before_s, before_m = follower.reading
        follower.reading = (now_s, range_m)
        confirmed = now_s - before_s < CONFIRM_S and abs(range_m - before_m) < CONFIRM_M
        believed = self._believed(follower, now_s)
        if believed is None or not confirmed or not 0.0 < range_m < DETECTION_LIMIT_M:
            return
        distance_m = range_m + self.settings.sonar_inset_m
        follower.offset.heard(now_s, distance_m, follower.heading_rad, believed)

    def _believed(self, follower: FollowerState, now_s: float) -> Horizontal | None:
        """From follower to leader by their own receivers, (north, east) metres."""
        fix = self.leader.fix
        if fix is None or follower.position is None:
            return None
        age_s = max(0.0, now_s - fix.time_s)
        if is_stale(age_s, self.settings):
            return None
        north_m, east_m, _ = ned_between(follower.position, predicted(fix, age_s).position)
        return north_m, east_m

    def _forget_offsets(self) -> None:
        """A leader believed in a new place: what was learnt of its receiver is void."""
        for follower in self.followers.values():
            follower.offset = RelativeOffset()

    def _leader_position(self, message: Any, now_s: float) -> None:
        rejected, jumps = self.leader.rejected, self.leader.jumps
        self.leader.receive(message, now_s)
        if self.leader.jumps > jumps:
            self._forget_offsets()
        jumped = self.leader.rejected > rejected
        if self.guard is not None and jumped and not self._leader_jumps:
            self._say(now_s, "leader jumps: not believed until its reports agree again")
        self._leader_jumps = jumped

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
            self.guard.entered_guided(follower.plan.system_id)
            deed = "taking off" if climbs else "following" if self.engaged else "only watched"
            self._say(now_s, f"follower {follower.plan.system_id}: in Guided, {deed}")

    def _housekeeping(self, now_s: float) -> list[tuple[int, Any]]:
        messages: list[tuple[int, Any]] = []
        vehicles = [self.leader_id, *self.followers]
        for system_id in vehicles:
            clock = self._clock(system_id)
            if clock is not None and clock.due(now_s):
                messages.append(
                    (system_id, mavlink.MAVLink_timesync_message(0, round(now_s * 1e9)))
                )
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
        if self.settings.learn_offset and not self.settings.feed_forward:
            distance = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
            wanted += [(system_id, distance, DISTANCE_HZ) for system_id in self.followers]
        return wanted

    def _wanted(self) -> list[tuple[int, int, float]]:
        """What each vehicle is to send: system id, message id, rate in Hz."""
        position = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        distance = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
        repelled = self.followers if self.settings.feed_forward else ()
        return [
            (self.leader_id, position, self._leader_rate_hz),
            *((system_id, position, FOLLOWER_POSITION_HZ) for system_id in self.followers),
            *((system_id, distance, REPELLING_HZ) for system_id in repelled),
            *(self.guard.requests() if self.guard is not None else ()),
        ]


def _along(velocity_mps: Horizontal, bearing_rad: float) -> float:
    """The part of a velocity along a bearing."""
    return velocity_mps[0] * math.cos(bearing_rad) + velocity_mps[1] * math.sin(bearing_rad)
