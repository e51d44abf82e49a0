"""What is done with each follower, and why: one answer for points, views and logs. Pure.

`Supervisor.RULES` is read from top to bottom, and the first rule that has something to say decides.
A follower of which none does is led. What lasts until its pilot has left Guided is in `steps.Turn`.
"""

from collections.abc import Callable
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.engage import Engagement
from echowing.flight.follower import GUIDED_MODE, FollowerState
from echowing.flight.guard import Guard, is_flying, mode_name
from echowing.flight.holds import Holds
from echowing.flight.joining import Joining
from echowing.flight.known import Known
from echowing.flight.said import Say
from echowing.flight.steps import Phase, Standing, Turn
from echowing.flight.take_off import Lift, TakeOffs

STALE = "leader is stale"
HOLDS, WAITS = "holding the distance", "waiting for the leader"
KEEPS_OFF = "keeps off until its sonar hears whom it follows"
# After so many heartbeats in a row that do not say Guided, or not in flight, its pilot counts as
# having left Guided, which ends every hold. One alone may be another vehicle's, or false.
AWAY_BEATS = 2

LIFTING = {
    Lift.WAITING: "waiting to take off",
    Lift.WARNED: "about to take off",
    Lift.CLIMBING: "taking off",
}

Why = str | None
"""Why something is so, in words; None: it is not."""


class Supervisor:
    """Decides what is done with the followers of one session.

    engaged: points are sent to those that may be led; stopping: why all of them are stopped.
    say(now_s, text) is for the operator; alert(system_id, text, severity) for a follower's pilot.
    """

    def __init__(
        self,
        known: Known,
        holds: Holds,
        guard: Guard | None,
        engagement: Engagement | None,
        take_offs: TakeOffs | None,
        say: Say,
        alert: Callable[..., None],
    ) -> None:
        self.engaged = True
        self.stopping: str | None = None
        self._known, self._holds, self._guard = known, holds, guard
        self._joining = Joining(known)
        self._engagement, self._take_offs = engagement, take_offs
        self._say, self._alert = say, alert

    # ---- each tick ------------------------------------------------------------------------------

    def judge(self, follower: FollowerState, now_s: float) -> None:
        """Set what is done with a follower now, hold it or let it go, and announce that."""
        before, follower.standing = follower.standing, self._standing(follower, now_s)
        if follower.standing.held:
            self._holds.keep(follower, now_s)
        if follower.standing.phase is not before.phase:
            self._changed(follower, before, now_s)
        if not follower.standing.held:
            self._holds.release(follower)

    def _standing(self, follower: FollowerState, now_s: float) -> Standing:
        for phase, rule in self.RULES:
            why = rule(self, follower, now_s)
            if why is not None:
                return Standing(phase, why)
        return Standing(Phase.LED, self._how_led(follower, now_s))

    def _how_led(self, follower: FollowerState, now_s: float) -> str:
        if self._known.leader.fix is None and not follower.turn.flown:
            return WAITS
        if (before := self._joining.waits_for(follower, now_s)) is not None:
            return f"waits for follower {before.plan.system_id} to join"
        if follower.turn.gave_up:
            return KEEPS_OFF
        guard, system_id = self._guard, follower.plan.system_id
        return HOLDS if guard and guard.holds_the_distance(system_id, now_s) else ""

    def _changed(self, follower: FollowerState, before: Standing, now_s: float) -> None:
        """Say that it is held, or led again."""
        system_id, standing = follower.plan.system_id, follower.standing
        if standing.held and (follower.in_guided or self._guard is None):
            self._alert(system_id, f"holding, {standing.why}")
            self._say(now_s, f"follower {system_id}: {standing.why}, holding")
        elif before.held and standing.phase is Phase.LED:
            again = "leader reports again" if before.why == STALE else "clear again"
            self._alert(system_id, f"{again}, following", mavlink.MAV_SEVERITY_NOTICE)
            self._say(now_s, f"follower {system_id}: {again}, following")

    # ---- the rules ------------------------------------------------------------------------------

    def _lifting(self, follower: FollowerState, now_s: float) -> Why:
        lift = self.lift_of(follower)
        if lift is Lift.CLIMBING or not follower.in_guided:
            return None if lift is None else LIFTING.get(lift)
        return None

    def _not_engaged(self, follower: FollowerState, now_s: float) -> Why:
        if self.engaged or self.is_stopped_rising(follower):
            return None
        ends = follower.turn.flown and self.stopping is not None
        return None if ends else "only watched"

    def _not_in_guided(self, follower: FollowerState, now_s: float) -> Why:
        if follower.in_guided or self.is_stopped_rising(follower):
            return None
        return "no report yet" if follower.mode is None else "pilot has control"

    def _never_flown(self, follower: FollowerState, now_s: float) -> Why:
        return None if follower.turn.flown or self.stopping is None else self.stopping

    def _not_cleared(self, follower: FollowerState, now_s: float) -> Why:
        done = self.stopping is not None or self.is_stopped_rising(follower)
        if done or follower.turn.cleared or self._engagement is None:
            return None
        return self._engagement.objection(follower.plan.system_id) or ""

    def _unsure(self, follower: FollowerState, now_s: float) -> Why:
        # To a place of another vehicle's, or to two vehicles at once, no point goes: not a hold.
        return "two vehicles have its id" if follower.unsure else None

    def _left_alone(self, follower: FollowerState, now_s: float) -> Why:
        return None if self._guard is None else self._guard.reason_to_leave(follower, now_s)

    def _stopped(self, follower: FollowerState, now_s: float) -> Why:
        if self.stopping is not None or self._take_offs is None:
            return self.stopping
        return self._take_offs.reason_to_hold(follower.plan.system_id)

    def _leader_stale(self, follower: FollowerState, now_s: float) -> Why:
        known = self._known.leader.fix is not None
        return STALE if known and self._known.leader_is_stale(now_s) else None

    def _doubted(self, follower: FollowerState, now_s: float) -> Why:
        """Why its data, or the leader's, cannot be trusted."""
        if follower.doubted:
            return follower.turn.latched or "its position jumps"
        if self._engagement is None or not follower.turn.cleared:
            return None
        return self._engagement.reason_to_stop(follower)

    def _guarded(self, follower: FollowerState, now_s: float) -> Why:
        fix = self._known.leader.fix
        if self._guard is None or fix is None:
            return None
        leader = self._known.leader_for(follower, fix, now_s)
        return self._guard.reason_to_stop(follower, leader, now_s)

    def _ahead(self, follower: FollowerState, now_s: float) -> Why:
        """Why it cannot follow the one that its sonar looks at."""
        ahead = self._known.ahead_of(follower)
        if ahead is None:
            return None
        name = f"follower {ahead.plan.system_id} ahead of it"
        if not ahead.standing.sent_to:
            return f"{name} is not led"
        return f"{name} holds: {ahead.standing.why}" if ahead.doubted else None

    RULES: ClassVar = (
        (Phase.LIFTED, _lifting),
        (Phase.WATCHED, _not_engaged),
        (Phase.WATCHED, _not_in_guided),
        (Phase.WATCHED, _never_flown),
        (Phase.CHECKED, _not_cleared),
        (Phase.LEFT, _unsure),
        (Phase.LEFT, _left_alone),
        (Phase.HELD, _stopped),
        (Phase.HELD, _leader_stale),
        (Phase.HELD, _doubted),
        (Phase.HELD, _guarded),
        (Phase.HELD, _ahead),
    )

    # ---- what the rules ask ---------------------------------------------------------------------

    def lift_of(self, follower: FollowerState) -> Lift | None:
        """How far its take-off is; None: no take-off was asked for."""
        return None if self._take_offs is None else self._take_offs.lift(follower.plan.system_id)

    def is_stopped_rising(self, follower: FollowerState) -> bool:
        """Whether its take-off was stopped under way: held, whatever else is known of it."""
        rises = follower.guided_mode and (follower.in_guided or follower.armed)
        return rises and self.lift_of(follower) is Lift.STOPPED

    # ---- its pilot's mode switch ----------------------------------------------------------------

    def heard_mode(self, follower: FollowerState, heartbeat: Any, now_s: float) -> None:
        """Take a heartbeat of its autopilot."""
        follower.beat(heartbeat, now_s, flying=is_flying(heartbeat))
        if self._take_offs is not None and not (follower.armed and follower.guided_mode):
            self._take_offs.taken_over(follower.plan.system_id)
        in_guided = follower.flying and follower.guided_mode
        away_beats = follower.away_beats
        follower.away_beats = 0 if in_guided else away_beats + 1
        if follower.away_beats >= AWAY_BEATS:
            follower.turn.flown = False
        if in_guided is follower.in_guided:
            return
        follower.in_guided = in_guided
        follower.own_jump.settled()
        follower.slews = False  # a sub-mode has begun anew
        self._holds.release(follower)  # its place belongs to another flight
        if not in_guided:
            self._left_guided(follower, now_s)
        elif away_beats < AWAY_BEATS:
            self._back_in_guided(follower, now_s)
        else:
            self._entered_guided(follower, now_s)

    def _left_guided(self, follower: FollowerState, now_s: float) -> None:
        left = "not flying any more"
        if follower.mode is not None and follower.mode != GUIDED_MODE:
            left = f"left Guided for {mode_name(follower.mode)}"
        self._say(now_s, f"follower {follower.plan.system_id}: {left}, pilot has control")

    def _back_in_guided(self, follower: FollowerState, now_s: float) -> None:
        """One heartbeat did not say Guided: a false one, or a pilot who was away for a moment.

        No point went meanwhile; what has stopped it stops it still.
        """
        if self._guard is None:
            return
        system_id = follower.plan.system_id
        stopped = follower.turn.latched is not None or self._guard.switched(system_id)
        text = "what has stopped it still does: leave Guided for 2 s" if stopped else "as before"
        self._say(now_s, f"follower {system_id}: in Guided again after one heartbeat, {text}")

    def _entered_guided(self, follower: FollowerState, now_s: float) -> None:
        climbs = self.lift_of(follower) in (Lift.CLIMBING, Lift.STOPPED)
        follower.turn = Turn(flown=climbs)
        if self._guard is None:
            return
        system_id = follower.plan.system_id
        if self._engagement is not None:
            self._engagement.entered_guided(system_id)
        self._guard.entered_guided(system_id, now_s)
        deed = "taking off" if climbs else "following" if self.engaged else "only watched"
        self._say(now_s, f"follower {system_id}: in Guided, {deed}")
