"""The follow session: MAVLink of leader and followers in, guided points out. Pure.

Messages and the time are arguments; sockets, radios and clocks are the caller's. The simulator
and the tool for real vehicles drive this same class. A tick reads

    messages -> what is known -> estimate -> plan -> envelope -> command
                (state, trust)   (estimate)  (plan)  (spacing)  (here)

and each step only reads from those before it. `engage` and `guard` say whether a follower may be
flown at all, `holds` stops one that may not.

What it will not do (design rule 6): it never changes a vehicle's mode of its own accord (a stop
switch in the pilot's hand may), it sends points only to a vehicle that reports itself flying in
Guided, and on old or jumping leader data it stops the follower where it is.
"""

import math
from collections.abc import Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.engage import Engagement
from echowing.flight.guard import Guard, Limits, is_flying, mode_name
from echowing.flight.guidance import GuidanceSettings, LeaderFix
from echowing.flight.handling import least_slot_m
from echowing.flight.heights import Heights
from echowing.flight.holds import Holds
from echowing.flight.leader_track import LeaderTrack
from echowing.flight.look import Look, look_at
from echowing.flight.plan import planned
from echowing.flight.requests import Rate, Requests, positions
from echowing.flight.spacing import Spacing
from echowing.flight.state import GUIDED_MODE, FollowerPlan, FollowerState, Known
from echowing.flight.take_off import Lift, TakeOff, TakeOffs
from echowing.flight.trust import Trust
from echowing.geo import GlobalPosition
from echowing.mavlink.messages import (
    TOOL_SYSTEM_ID,
    look_order,
    position_target,
    status_text,
)

STALE = "leader is stale"
DISTANCE_HZ, ATTITUDE_HZ = 5.0, 2.0
# After so many heartbeats in a row that do not say Guided, or not in flight, its pilot counts as
# having left Guided, which ends every hold. One alone may be another vehicle's, or false.
AWAY_BEATS = 2
# The speed sent for a slot that stands.
LEAST_MPS = 0.001
# A sonar that hears worse than believed is told of once it has for so long, then after so long.
WORSE_LASTS_S, WORSE_AGAIN_S = 5.0, 120.0
# A slot that opened for a fast leader counts as closed when it needs less than its radius by this.
SLACK_M = 0.3


class FollowSession:
    """One leader, any number of followers.

    `tick` is called at the rate of the guided points (thesis Table 4: 8 Hz) and returns the
    messages to send, each with the system id of the vehicle it is for. With `limits` a guard
    watches (see `guard`); while not `engaged`, points are sent only to stop what has taken off by
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
        self.leader_id = leader_id
        self.settings = settings
        self.known = Known(leader_id, plans, settings)
        self.followers = self.known.followers
        self.events: list[tuple[float, str]] = []
        self.engaged = engaged
        self.guard = None
        if limits is not None:
            self.guard = Guard(limits, leader_id, self.followers, self._say, self.alert)
            self.known.in_height = self.guard.in_height
        self.take_offs = None if take_off is None else TakeOffs(take_off, self.followers, self._say)
        self.heights = Heights(self.known, self.guard, leaders=leaders_height)
        self.engagement: Engagement | None = None
        if self.guard is not None and self.guard.limits.ready is not None:
            self.engagement = Engagement(
                self.guard.limits.ready,
                self.known,
                self.guard,
                self.heights,
                self._say,
                self.alert,
            )
        self.alerts = 0
        """How much has been said that somebody should look up for."""
        self._hud: list[tuple[int, Any]] = []
        self._stopping: str | None = None
        doubt = None if self.engagement is None else self.engagement.doubt
        strict = self.guard is not None
        self._trust = Trust(self.known, self._say, self.alert, doubt, strict=strict)
        self._holds = Holds(self.heights, self.guard)
        self._spacing = Spacing(self.known, self.guard, self._gives_way)
        wanted = positions(self.known, leader_rate_hz)
        if self.guard is not None:
            wanted += self.guard.requests()
        self._requests = Requests(
            self.known, wanted, self._wanted_at_times, self._say, watched=self.guard is not None
        )

    @property
    def leader(self) -> LeaderTrack:
        """What is known of the leader."""
        return self.known.leader

    # ---- messages -------------------------------------------------------------------------------

    def receive(self, message: Any, now_s: float) -> None:
        """Take any message that has come through a link's door (see `mavlink.plausible`).

        What is not needed is ignored.
        """
        system_id = message.get_srcSystem()
        kind = message.get_type()
        if kind == "GLOBAL_POSITION_INT" and not self._trust.is_sure(system_id, message, now_s):
            return
        if self.guard is not None and (system_id == self.leader_id or system_id in self.followers):
            self.guard.receive(system_id, kind, message, now_s)
        if self.engagement is not None:
            self.engagement.receive(system_id, kind, message)
        self._requests.receive(message)
        if kind == "TIMESYNC":
            self._requests.answered(message, now_s)
        elif system_id == self.leader_id:
            self._leader_message(kind, message, now_s)
        elif system_id in self.followers:
            self._follower_message(self.followers[system_id], kind, message, now_s)

    def _leader_message(self, kind: str, message: Any, now_s: float) -> None:
        if kind == "GLOBAL_POSITION_INT":
            self._trust.leader_reported(message, now_s)
        elif kind == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.known.leader_mode = message.custom_mode

    def _follower_message(
        self, follower: FollowerState, kind: str, message: Any, now_s: float
    ) -> None:
        follower.ranged(kind, message, now_s)
        if kind == "PARAM_VALUE":
            follower.handling.receive(message.param_id, message.param_value)
        if kind == "GLOBAL_POSITION_INT":
            report = follower.reported(message, now_s)
            if report is not None:
                self._trust.follower_reported(follower, report)
        elif kind == "ATTITUDE" and self.guard is not None:
            follower.leaned(message, now_s)
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

    def _mode(self, follower: FollowerState, heartbeat: Any, now_s: float) -> None:
        follower.mode, follower.mode_at_s = heartbeat.custom_mode, now_s
        follower.armed = bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        follower.flying = is_flying(heartbeat)
        if self.take_offs is not None and not (follower.armed and follower.guided_mode):
            self.take_offs.taken_over(follower.plan.system_id)
        in_guided = follower.flying and follower.guided_mode
        away_beats = follower.away_beats
        follower.away_beats = 0 if in_guided else away_beats + 1
        if follower.away_beats >= AWAY_BEATS:
            follower.flown = False
        if in_guided is follower.in_guided:
            return
        follower.in_guided = in_guided
        follower.own_jump.settled()
        self._holds.release(follower)  # its place belongs to another flight
        climbs = self.lift_of(follower) in (Lift.CLIMBING, Lift.STOPPED)
        if in_guided and away_beats < AWAY_BEATS:
            self._back_in_guided(follower, now_s)
            return
        if in_guided:
            follower.latched = None
            follower.flown = climbs
            self._entered_guided(follower, now_s, climbs=climbs)
            return
        left = f"left Guided for {mode_name(heartbeat.custom_mode)}"
        if heartbeat.custom_mode == GUIDED_MODE:
            left = "not flying any more"
        self._say(now_s, f"follower {follower.plan.system_id}: {left}, pilot has control")

    def _back_in_guided(self, follower: FollowerState, now_s: float) -> None:
        """One heartbeat did not say Guided: a false one, or a pilot who was away for a moment.

        No point went meanwhile; what has stopped it stops it still.
        """
        if self.guard is None:
            return
        system_id = follower.plan.system_id
        stopped = follower.latched is not None or self.guard.switched(system_id)
        text = "what has stopped it still does: leave Guided for 2 s" if stopped else "as before"
        self._say(now_s, f"follower {system_id}: in Guided again after one heartbeat, {text}")

    def _entered_guided(self, follower: FollowerState, now_s: float, *, climbs: bool) -> None:
        if self.guard is None:
            return
        system_id = follower.plan.system_id
        if self.engagement is not None:
            self.engagement.entered_guided(system_id)
        self.guard.entered_guided(system_id, now_s)
        deed = "taking off" if climbs else "following" if self.engaged else "only watched"
        self._say(now_s, f"follower {system_id}: in Guided, {deed}")

    # ---- the tick -------------------------------------------------------------------------------

    def tick(self, now_s: float) -> list[tuple[int, Any]]:
        """The messages to send now: guided points, time synchronisation, heartbeat, rates."""
        messages = self._requests.messages(now_s)
        if self.engagement is not None:
            rising_m = {} if self.take_offs is None else self.take_offs.rising_m()
            self.engagement.prepare(now_s, engaged=self.engaged, rising_m=rising_m)
            messages.extend(self.engagement.messages(now_s))
        if self.take_offs is not None:
            messages.extend(self._lift(self.take_offs, now_s))
        for follower in self.followers.values():
            self._trust.settle(follower, now_s)
            self.known.feel_wind(follower, now_s)
            look = look_at(self.known, follower, now_s) if self.settings.learn_offset else None
            messages.extend(self._led(follower, look, now_s))
            messages.extend(self._looking(follower, look))
        messages.extend(self._hud)
        self._hud.clear()
        if self.guard is not None and (self.engaged or self.take_offs is not None):
            messages.extend(self.guard.messages(self.followers, now_s))
        return messages

    def _led(
        self, follower: FollowerState, look: Look | None, now_s: float
    ) -> list[tuple[int, Any]]:
        """The point for one follower, where points go to it: plan, envelope, command."""
        point = self._point_for(follower, now_s)
        before, follower.sent_to = follower.sent_to, self.sends_to(follower, now_s)
        if follower.sent_to and not before and follower.held_at is not None:
            self._holds.hold_anew(follower, now_s)
            point = follower.held_at
        if point is None or not follower.sent_to:
            follower.not_ordered()
            return []
        point = self._spacing.kept_apart(follower, point, now_s)
        if not self._may_leave(follower, point):
            self._stop_out_of_reach(follower, now_s)
            point = follower.held_at or point
        follower.ordered(point, now_s)
        command = self._command(follower, point, look, now_s)
        follower.flown = True
        if self.guard is not None:
            self.guard.sent(follower, point, now_s)
            if follower.held_at is not None:
                self.guard.holding(follower, now_s)
        return [(follower.plan.system_id, command)]

    def _looking(self, follower: FollowerState, look: Look | None) -> list[tuple[int, Any]]:
        """Tell its gimbal where to look, whoever flies it."""
        if look is None or follower.sonar_id is None:
            return []
        system_id, sonar_id = follower.plan.system_id, follower.sonar_id
        order = look_order(system_id, sonar_id, look.axis.quaternion, look.rate_rps, look.sigma_rad)
        return [(system_id, order)]

    def _may_leave(self, follower: FollowerState, point: GlobalPosition) -> bool:
        """Whether a point is finite, and near: whatever was reckoned with, nothing else leaves."""
        if not all(map(math.isfinite, (*point, *(follower.feed_mps or ())))):
            return False
        return self.guard is None or self.guard.is_near(follower, point)

    def _stop_out_of_reach(self, follower: FollowerState, now_s: float) -> None:
        follower.latched = "its point was out of reach, until it leaves Guided"
        self._holds.release(follower)
        self._hold(follower, follower.latched, now_s)
        follower.feed_mps = (0.0, 0.0) if self.settings.feed_forward else None

    def _point_for(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        """Where it is to be; None: not known."""
        fix = self.leader.fix
        # A hold has a velocity too: for another kind of target Guided restarts, with the present
        # lean for its steady part (init_xy_controller); one that brakes would swing for seconds.
        follower.feed_mps = (0.0, 0.0) if self.settings.feed_forward else None
        reason = self._reason_to_stop(follower, fix, now_s)
        if reason is not None:
            self._hold(follower, reason, now_s)
            self._holds.go_along(follower, now_s)
            return follower.held_at
        if fix is None:
            return None
        reversal = self.engagement is not None and self.engagement.readiness.reversal
        # Until it is cleared, its limits may be on their way, and what is not known is the worst.
        if reversal and self._cleared(follower):
            self._allow_for_reversal(follower, fix, now_s)
        if follower.held_at is not None:
            self._let_go(follower, now_s)
        follower.guided = planned(self.known, follower, fix, now_s)
        self._tell_of_hearing(follower, now_s)
        if self.settings.feed_forward:
            north_mps, east_mps = follower.guided.velocity_mps
            # The applet takes a point without any velocity for a hold.
            follower.feed_mps = north_mps or LEAST_MPS, east_mps
        return follower.guided.point

    def _allow_for_reversal(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> None:
        """Open the slot so far that it gets away if the leader turns round at its speed."""
        speed_mps = round(fix.speed_mps, 1)
        radius_m = follower.plan.slot.radius_m
        brakes_mps2 = self.known.leader_brakes_mps2
        follower.reversal_m = least_slot_m(
            speed_mps, follower.handling.answer, brakes_mps2=brakes_mps2
        )
        opens = follower.opens_m > 0.0
        if opens and not follower.opens:
            why = f"leader at {speed_mps:.1f} m/s"
            in_calm_m = least_slot_m(
                speed_mps, follower.handling.answer_in_calm, brakes_mps2=brakes_mps2
            )
            if in_calm_m <= radius_m:
                why = f"wind leaves {follower.handling.wind_leaves_mps2:.1f} m/s2 to brake"
            text = f"slot opens to {follower.reversal_m:.1f} m, {why}"
            self.alert(follower.plan.system_id, text, mavlink.MAV_SEVERITY_NOTICE)
            self._say(
                now_s,
                f"follower {follower.plan.system_id}: {text}: the least from which it gets away "
                "should the leader turn round",
            )
        follower.opens = opens or (follower.opens and follower.reversal_m > radius_m - SLACK_M)

    def _tell_of_hearing(self, follower: FollowerState, now_s: float) -> None:
        """Say that its sonar hears worse than its file says: its pilots decide whether it may."""
        worse = follower.estimate.hearing.heard().worse
        if worse is None:
            follower.worse_since_s = math.inf
            return
        follower.worse_since_s = min(follower.worse_since_s, now_s)
        lasts, again = now_s - follower.worse_since_s, now_s - follower.worse_said_s
        if lasts >= WORSE_LASTS_S and again >= WORSE_AGAIN_S and self._moves(follower):
            follower.worse_said_s = now_s
            self._remark(follower.plan.system_id, worse, now_s)

    def _command(
        self, follower: FollowerState, point: GlobalPosition, look: Look | None, now_s: float
    ) -> Any:
        if follower.held_at is None:
            follower.yaw_rad = None if follower.guided is None else follower.guided.yaw_rad
            if follower.yaw_rad is not None and look and not follower.estimate.points(now_s):
                # A sonar without a gimbal looks with its vehicle.
                follower.yaw_rad = look.axis.azimuth_rad
        elif self.settings.face_leader:
            bearing_rad = self.known.bearing_of_leader(follower, now_s)
            follower.yaw_rad = follower.yaw_rad if bearing_rad is None else bearing_rad
        altitude_m = follower.held_altitude_m
        if altitude_m is None:
            altitude_m = self.heights.level_m(follower, now_s)
        return position_target(
            follower.plan.system_id,
            point,
            altitude_m,
            follower.yaw_rad,
            now_s,
            follower.feed_mps,
            follower.opens_m,
            makes_way=follower.makes_way,
        )

    # ---- stopping -------------------------------------------------------------------------------

    def stop(self, reason: str) -> None:
        """Stop every follower that has been moved, for good; the others are left alone."""
        self._stopping = reason

    def stopped(self, now_s: float) -> bool:
        """Whether every follower that was moved stands, is its pilot's, or does not report."""
        return all(
            not self.sends_to(follower, now_s)
            or (self.guard is not None and self.guard.stands(system_id))
            for system_id, follower in self.followers.items()
        )

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
        if self.known.leader_is_stale(now_s):
            return STALE
        if self.guard is None:
            return None
        leader = self.leader_for(follower, fix, now_s)
        stop = self.guard.reason_to_stop(follower, leader, self.followers, now_s)
        return self._doubt(follower) or stop

    def _doubt(self, follower: FollowerState) -> str | None:
        """Why its data, or the leader's, cannot be trusted now."""
        if follower.latched is not None or follower.own_jump.since_s is not None:
            return follower.latched or "its position jumps"
        if self.engagement is None or not self._cleared(follower):
            return None
        return self.engagement.reason_to_stop(follower)

    def _hold(self, follower: FollowerState, reason: str, now_s: float) -> None:
        if self._holds.hold(follower, reason, now_s) and self._moves(follower):
            self.alert(follower.plan.system_id, f"holding, {reason}")
            self._say(now_s, f"follower {follower.plan.system_id}: {reason}, holding")

    def _let_go(self, follower: FollowerState, now_s: float) -> None:
        again = "leader reports again" if follower.hold_reason == STALE else "clear again"
        self._holds.release(follower)
        if self._moves(follower):
            self.alert(follower.plan.system_id, f"{again}, following", mavlink.MAV_SEVERITY_NOTICE)
            self._say(now_s, f"follower {follower.plan.system_id}: {again}, following")

    # ---- who may be flown -----------------------------------------------------------------------

    def sends_to(self, follower: FollowerState, now_s: float) -> bool:
        """Whether points go to this follower now."""
        stopped_rising = self.lift_of(follower) is Lift.STOPPED and follower.guided_mode
        ours = follower.in_guided or (stopped_rising and follower.armed)
        # To a place of another vehicle's, or to two vehicles at once, no point goes: not a hold.
        if not ours or follower.unsure or not self._may_lead(follower):
            return False
        if self._stopping is not None and not follower.flown:
            return False
        if self._stopping is None and not stopped_rising and not self._cleared(follower):
            return False
        return self.guard is None or self.guard.lets(follower, now_s)

    def _cleared(self, follower: FollowerState) -> bool:
        """Whether it has passed all checks before its first point."""
        return self.engagement is None or self.engagement.cleared(follower.plan.system_id)

    def _may_lead(self, follower: FollowerState) -> bool:
        """Whether points may go to one that flies in Guided: none while it takes off."""
        lift = self.lift_of(follower)
        if lift in (Lift.CLIMBING, Lift.STOPPED):
            return lift is Lift.STOPPED
        return self.engaged or (follower.flown and self._stopping is not None)

    def _moves(self, follower: FollowerState) -> bool:
        """Whether the tool moves it, so that a stop has to be reported."""
        engaged = self.engaged and self._cleared(follower)
        return self.guard is None or (follower.in_guided and (engaged or follower.flown))

    # ---- taking off -----------------------------------------------------------------------------

    def lift_of(self, follower: FollowerState) -> Lift | None:
        """How far its take-off is; None: no take-off was asked for."""
        if self.take_offs is None:
            return None
        return self.take_offs.lift(follower.plan.system_id)

    def _lift(self, take_offs: TakeOffs, now_s: float) -> list[tuple[int, Any]]:
        if self._stopping is not None:
            take_offs.stop(self._stopping, now_s)
        messages = take_offs.messages(
            self.followers, lambda follower: self._objection_to_lift(follower, now_s), now_s
        )
        for follower in self.followers.values():
            # A point at its own place ends a take-off that is under way, on the ground too.
            follower.flown = follower.flown or self.lift_of(follower) is Lift.STOPPED
        return messages

    def _objection_to_lift(self, follower: FollowerState, now_s: float) -> str | None:
        if self.guard is None:
            return None
        if self.guard.switched(follower.plan.system_id):
            return "stop switch"
        fix = self.leader.fix
        leader = None if fix is None else self.leader_for(follower, fix, now_s)
        if self.engagement is not None and not follower.flying:
            unready = self.engagement.objection_to_take_off(follower, now_s)
            if unready is not None:
                return unready
        return self.guard.too_near(follower, leader, self.followers, now_s)

    # ---- what others ask ------------------------------------------------------------------------

    def leader_for(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GlobalPosition:
        """Where the leader is now, in the frame of this follower's receiver."""
        return self.known.leader_for(follower, fix, now_s)

    def alert(
        self, system_id: int, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING
    ) -> None:
        """Show a text to a follower's and the leader's pilot, and count it; in the field only."""
        if self.engagement is not None:
            self.alerts += 1
            self._hud.append((system_id, status_text(severity, f"Echowing: {text}")))
            # The leader's pilot has to know whom he has lost.
            told = f"Echowing: {system_id} {text}"
            self._hud.append((self.leader_id, status_text(severity, told)))

    def _gives_way(self, system_id: int, name: str, now_s: float) -> None:
        self._remark(system_id, f"gives way to {name}", now_s)

    def _remark(self, system_id: int, text: str, now_s: float) -> None:
        """Show and say what a follower does of its own accord."""
        self.alert(system_id, text, mavlink.MAV_SEVERITY_NOTICE)
        self._say(now_s, f"follower {system_id}: {text}")

    def _say(self, now_s: float, text: str) -> None:
        self.events.append((now_s, text))

    def _wanted_at_times(self) -> list[Rate]:
        """The messages that do not always come."""
        if self.guard is None:
            return []
        wanted = self.guard.read_back_requests(feed_forward=self.settings.feed_forward)
        if self.engagement is not None:
            wanted += self.engagement.requests()
        if self.settings.learn_offset:
            distance = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
            wanted += [(system_id, distance, DISTANCE_HZ) for system_id in self.followers]
        attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE
        wanted += [(system_id, attitude, ATTITUDE_HZ) for system_id in self.followers]
        return wanted
