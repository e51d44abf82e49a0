"""The follow session: MAVLink of leader and followers in, guided points out. Pure.

Messages and the time are arguments; sockets, radios and clocks are the caller's. The simulator
and the tool for real vehicles drive this same class. A tick reads

    messages -> what is known -> standing -> plan -> allowed -> command
                (state, trust)  (supervisor) (plan) (spacing)  (here)

and each step only reads from those before it (`steps` has what they hand on). `engage` and `guard`
say whether a follower may be flown at all, `holds` stops one that may not.

What it will not do (design rule 6): it never changes a vehicle's mode of its own accord (a stop
switch in the pilot's hand may), it sends points only to a vehicle that reports itself flying in
Guided, and on old or jumping leader data it stops the follower where it is.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.engage import Engagement
from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.gaps import Gaps
from echowing.flight.guard import Guard, Limits
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.heights import Heights
from echowing.flight.holds import Holds
from echowing.flight.known import Known
from echowing.flight.leader_track import LeaderTrack
from echowing.flight.look import Look, look_at
from echowing.flight.plan import Planner, quickens_mps2
from echowing.flight.requests import Rate, Requests, positions
from echowing.flight.reshape import Reshape
from echowing.flight.spacing import Spacing
from echowing.flight.steps import Allowed, Command, Plan
from echowing.flight.supervisor import Supervisor
from echowing.flight.swarm import Swarm
from echowing.flight.take_off import Lift, TakeOff, TakeOffs
from echowing.flight.trust import Trust
from echowing.mavlink.messages import (
    TOOL_SYSTEM_ID,
    ForApplet,
    Manner,
    guides,
    look_order,
    no_velocity,
    position_target,
    status_text,
)

# Asked of a follower: the average is made of 0.45 s; a sensor on the nose (FIXED) has nothing but
# it, ten times a second; a lean of wind changes within seconds.
DISTANCE_HZ, FIXED_HZ, ATTITUDE_HZ = 5.0, 10.0, 2.0
# No copter flies faster (WP_SPD ends at 20 m/s): the applet uses no faster point (FASTEST_MPS).
FASTEST_MPS = 30.0

PlanStep = Callable[[FollowerState, Look | None, float], Plan | None]


class FollowSession:
    """One leader, any number of followers.

    `tick` is called at the rate of the guided points (thesis Table 4: 8 Hz) and returns the
    messages to send, each with the system id of the vehicle it is for. With `limits` a guard
    watches (see `guard`); while not `engaged`, points are sent only to stop what has taken off by
    `take_off`. Where `settings.swarm` is set, weighted rules lead the followers, and a slot only
    says how near to the leader they come.
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
        homes = None if limits is None else limits.homes(leader_id)
        self.known = Known(leader_id, plans, settings, homes)
        self.followers = self.known.followers
        self.events: list[tuple[float, str]] = []
        self.guard = None if limits is None else Guard(limits, self.known, self._say, self.alert)
        self.take_offs = None if take_off is None else TakeOffs(take_off, self.followers, self._say)
        self.heights = Heights(self.known, leaders=leaders_height)
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
        doubt = None if self.engagement is None else self.engagement.doubt
        strict = self.guard is not None
        self._trust = Trust(self.known, self._say, self.alert, doubt, strict=strict)
        self._holds = Holds(self.heights, self.guard)
        self._supervisor = Supervisor(
            self.known,
            self._holds,
            self.guard,
            self.engagement,
            self.take_offs,
            self._say,
            self.alert,
        )
        self._supervisor.engaged = engaged
        reverses = self.engagement is not None and self.engagement.readiness.reversal
        weights = settings.swarm
        self.swarm = None if weights is None else Swarm(self.known, weights)
        planner = Planner(self.known, self._say, self.alert, reverses=reverses, swarm=self.swarm)
        self.plan: PlanStep = planner.plan
        """The plan step; simulated flights may have one of their user's (`sim.own_plan`)."""
        self._gaps = Gaps(self.known, self._say, self.alert) if settings.close_gaps else None
        self.reshape = Reshape(self.known, self._say)
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
        if not guides(message):
            return
        system_id = message.get_srcSystem()
        kind = message.get_type()
        if kind == "GLOBAL_POSITION_INT" and not self._trust.is_sure(system_id, message, now_s):
            return
        if system_id == self.leader_id or system_id in self.followers:
            if kind == "GLOBAL_POSITION_INT":
                self.known.homes.reported(system_id, message)
            if self.guard is not None:
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
        elif kind == "HEARTBEAT":
            self.known.leader_mode = message.custom_mode

    def _follower_message(
        self, follower: FollowerState, kind: str, message: Any, now_s: float
    ) -> None:
        follower.readings.receive(kind, message, now_s)
        if kind == "PARAM_VALUE":
            follower.handling.receive(message.param_id, message.param_value)
        if kind == "GLOBAL_POSITION_INT":
            report = follower.reported(message, now_s)
            if report is not None:
                self._trust.follower_reported(follower, report)
        elif kind == "ATTITUDE" and (self.guard is not None or follower.plan.sonar.fixed):
            follower.leaned(message, now_s)
        elif kind == "HEARTBEAT":
            self._supervisor.heard_mode(follower, message, now_s)
        elif kind == "COMMAND_ACK":
            self._acknowledged(follower, message, now_s)

    def _acknowledged(self, follower: FollowerState, message: Any, now_s: float) -> None:
        ours = message.target_system in (0, TOOL_SYSTEM_ID)
        if self.take_offs is not None and ours:
            self.take_offs.acknowledged(follower, message, now_s)
        if self.guard is not None and ours:
            self.guard.switches.mode_answered(follower.plan.system_id, message, now_s)

    # ---- the tick -------------------------------------------------------------------------------

    def tick(self, now_s: float) -> list[tuple[int, Any]]:
        """The messages to send now: guided points, time synchronisation, heartbeat, rates."""
        messages = self._requests.messages(now_s)
        self._foretell(now_s)
        if self.engagement is not None:
            rising_m = {} if self.take_offs is None else self.take_offs.rising_m()
            self.engagement.prepare(now_s, engaged=self.engaged, rising_m=rising_m)
            messages.extend(self.engagement.messages(now_s))
        if self.take_offs is not None:
            messages.extend(self._lift(self.take_offs, now_s))
        if self.swarm is not None:
            self.swarm.prepare(now_s)
        if self._supervisor.stopping is None:
            self.reshape.advance(now_s)
            if self._gaps is not None:
                self._gaps.close(now_s, reshapes=self.reshape.moves)
        for follower in self.followers.values():
            self._trust.settle(follower, now_s)
            self.known.feel_wind(follower, now_s)
            look = look_at(self.known, follower, now_s) if self.settings.learn_offset else None
            messages.extend(self._led(follower, look, now_s))
            messages.extend(self._looking(follower, look))
        messages.extend(self._hud)
        self._hud.clear()
        if self.guard is not None and (self.engaged or self.take_offs is not None):
            messages.extend(self.guard.messages(now_s))
        return messages

    def _foretell(self, now_s: float) -> None:
        """Let all that is asked of the receivers in this tick be of when its points arrive."""
        if not self.settings.learn_offset:
            return
        for follower in self.followers.values():
            follower.estimate.offset.foretell(now_s + follower.way_s)

    def _led(
        self, follower: FollowerState, look: Look | None, now_s: float
    ) -> list[tuple[int, Any]]:
        """The point for one follower, where points go to it."""
        self._supervisor.judge(follower, now_s)
        plan = self.plan(follower, look, now_s)
        allowed = None if plan is None else self._allowed(follower, plan, now_s)
        if plan is None or allowed is None:
            follower.not_ordered()
            return []
        self._remember(follower, allowed, now_s)
        command = follower.command = Command(
            allowed.place,
            allowed.velocity_mps,
            self._altitude_m(follower, now_s),
            plan.yaw_rad,
            self._for_applet(follower, plan, allowed, now_s),
        )
        if self.guard is not None:
            self.guard.sent(follower, command, now_s)
            if follower.standing.held:
                self.guard.holding(follower, now_s)
        system_id = follower.plan.system_id
        messages = [(system_id, _message(follower, command, now_s))]
        if follower.slewed():
            messages.insert(0, (system_id, no_velocity(system_id, now_s)))
        return messages

    def _allowed(self, follower: FollowerState, plan: Plan, now_s: float) -> Allowed | None:
        """What of its plan it may fly; None: nothing is sent to it."""
        if not follower.standing.sent_to:
            return None
        if self._may_leave(follower, plan):
            allowed = self._spacing.allowed(follower, plan, now_s)
            if self._may_leave(follower, allowed):
                return allowed
        return self._stopped_out_of_reach(follower, now_s)

    def _for_applet(
        self, follower: FollowerState, plan: Plan, allowed: Allowed, now_s: float
    ) -> ForApplet:
        """How its applet is to fly the point."""
        if allowed.makes_way or self.swarm is not None:
            return ForApplet(plan.opens_m, Manner.MAKE_WAY)
        if self.known.ahead_of(follower) is not None:
            return ForApplet(plan.opens_m, Manner.KEEP_PACE)
        quickens = quickens_mps2(self.known, follower, now_s)
        manner = Manner.HEAD if self.known.is_watched(follower) else Manner.HOLD
        return ForApplet(plan.opens_m, manner, quickens)

    def _remember(self, follower: FollowerState, allowed: Allowed, now_s: float) -> None:
        """What the next tick has to know of this one."""
        follower.allowed = allowed
        follower.turn.flown = True
        self._holds.pushed(follower, allowed)
        follower.ordered(allowed, now_s)

    def _altitude_m(self, follower: FollowerState, now_s: float) -> float:
        hold = follower.hold
        return self.heights.level_m(follower, now_s) if hold is None else hold.altitude_m

    def _looking(self, follower: FollowerState, look: Look | None) -> list[tuple[int, Any]]:
        """Tell its gimbal where to look, whoever flies it."""
        system_id, sonar_id = follower.plan.system_id, follower.readings.sender_id
        if look is None or sonar_id is None:
            return []
        order = look_order(system_id, sonar_id, look.axis.quaternion, look.rate_rps, look.sigma_rad)
        return [(system_id, order)]

    def _may_leave(self, follower: FollowerState, point: Plan | Allowed) -> bool:
        """Whether a point is finite, near and flyable: nothing else leaves, whatever went in."""
        mps = math.hypot(*(point.velocity_mps or ()))
        if not all(map(math.isfinite, point.place)) or not mps <= FASTEST_MPS:
            return False
        return self.guard is None or self.guard.is_near(follower, point.place)

    def _stopped_out_of_reach(self, follower: FollowerState, now_s: float) -> Allowed | None:
        """Where it is held instead; None: nobody knows where it is."""
        follower.turn.latched = "its point was out of reach, until it leaves Guided"
        self._holds.release(follower)
        self._supervisor.judge(follower, now_s)
        velocity = (0.0, 0.0) if self.settings.feed_forward else None
        if follower.hold is not None:
            held = Allowed(follower.hold.place, velocity)
            if self._may_leave(follower, held):
                return held
        return None if follower.position is None else Allowed(follower.position, velocity)

    # ---- stopping -------------------------------------------------------------------------------

    @property
    def engaged(self) -> bool:
        """Whether points are sent to the followers that may be led."""
        return self._supervisor.engaged

    def engage(self) -> None:
        """Send points to the followers that may be led."""
        self._supervisor.engaged = True

    def stop(self, reason: str) -> None:
        """Stop every follower that has been moved, for good; the others are left alone."""
        self._supervisor.stopping = reason

    def stopped(self) -> bool:
        """Whether every follower that was moved stands, is its pilot's, or does not report."""
        return all(
            not follower.standing.sent_to
            or (self.guard is not None and self.guard.stands(system_id))
            for system_id, follower in self.followers.items()
        )

    # ---- taking off -----------------------------------------------------------------------------

    def _lift(self, take_offs: TakeOffs, now_s: float) -> list[tuple[int, Any]]:
        if self._supervisor.stopping is not None:
            take_offs.stop(self._supervisor.stopping, now_s)
        messages = take_offs.messages(
            self.followers, lambda follower: self._objection_to_lift(follower, now_s), now_s
        )
        for follower in self.followers.values():
            # A point at its own place ends a take-off that is under way, on the ground too.
            stopped = take_offs.lift(follower.plan.system_id) is Lift.STOPPED
            follower.turn.flown = follower.turn.flown or stopped
        return messages

    def _objection_to_lift(self, follower: FollowerState, now_s: float) -> str | None:
        if self.guard is None:
            return None
        if self.guard.switched(follower.plan.system_id):
            return "stop switch"
        fix = self.leader.fix
        leader = None if fix is None else self.known.leader_for(follower, fix, now_s)
        if self.engagement is not None and not follower.flying:
            unready = self.engagement.objection_to_take_off(follower, now_s)
            if unready is not None:
                return unready
        return self.guard.too_near(follower, leader, now_s)

    # ---- what others ask ------------------------------------------------------------------------

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
        self.alert(system_id, f"gives way to {name}", mavlink.MAV_SEVERITY_NOTICE)
        self._say(now_s, f"follower {system_id}: gives way to {name}")

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
            wanted += [
                (system_id, distance, FIXED_HZ if one.plan.sonar.fixed else DISTANCE_HZ)
                for system_id, one in self.followers.items()
            ]
        attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE
        wanted += [
            (system_id, attitude, FIXED_HZ if one.plan.sonar.fixed else ATTITUDE_HZ)
            for system_id, one in self.followers.items()
        ]
        return wanted


def _message(follower: FollowerState, command: Command, now_s: float) -> Any:
    return position_target(
        follower.plan.system_id,
        command.place,
        command.altitude_m,
        command.yaw_rad,
        now_s,
        command.velocity_mps,
        command.for_applet,
    )
