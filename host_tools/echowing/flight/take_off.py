"""Taking off one follower after the other, for `echowing follow --take-off`. Pure.

Only a vehicle that its pilot has armed, in Guided, on the ground is told to take off: nothing here
arms, and nothing changes a mode. While it climbs no guided point may reach it, since a point would
end the take-off and send it sideways at whatever height it has. Anything unexpected with one
vehicle cancels the take-off of all that have not left the ground.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.follower import FollowerState
from echowing.flight.said import Say
from echowing.mavlink.messages import command_long

# From the announcement to the command: time to step back, and for the pilot to change his mind.
WARNING_S = 3.0
ASKS = 3
# Motors of a copter need some 2 s to come up to speed.
LEAVES_GROUND_S = 10.0
# Within this of the wanted altitude the climb is over (barometers wander).
ARRIVED_M = 0.5
RISEN_M = 0.5
# Positions are asked for at 10 Hz; if none is younger than this, nobody sees the climb.
STALE_S = 1.5
# A vehicle in Loiter takes off when told to as well: its mode has to be known, and heartbeats come
# once a second.
MODE_KNOWN_S = 2.5
NEXT_SHARE = 0.8  # of the altitude, for `next_at_m`, where nothing else is asked for


class Lift(Enum):
    """How far a follower's take-off is; LEFT: it is its pilot's, or never left the ground."""

    WAITING = auto()
    WARNED = auto()
    CLIMBING = auto()
    STOPPED = auto()
    DONE = auto()
    LEFT = auto()


@dataclass(frozen=True, slots=True)
class TakeOff:
    """What the operator has asked for, metres above each vehicle's home.

    next_at_m: how high each has to be before the next takes off.
    """

    altitude_m: float
    next_at_m: float


@dataclass(slots=True)
class _Climber:
    lift: Lift = Lift.WAITING
    since_s: float = 0.0
    asks: int = 0
    asked_at_s: float = -math.inf
    accepted: bool = False
    waits_for: str | None = None
    reason: str = ""


class TakeOffs:
    """The take-offs of one session, in the order of `follower_ids`."""

    def __init__(self, plan: TakeOff, follower_ids: Iterable[int], say: Say) -> None:
        self.plan = plan
        self._climbers = {system_id: _Climber() for system_id in follower_ids}
        self._say = say

    def lift(self, system_id: int) -> Lift:
        """How far a follower's take-off is."""
        return self._climbers[system_id].lift

    def rising_m(self) -> dict[int, float]:
        """How high each follower takes off that is still to be up."""
        under_way = (Lift.WAITING, Lift.WARNED, Lift.CLIMBING)
        return {
            system_id: self.plan.altitude_m
            for system_id, climber in self._climbers.items()
            if climber.lift in under_way
        }

    def reason_to_hold(self, system_id: int) -> str | None:
        """Why a follower is stopped on its way up; None: it is not."""
        climber = self._climbers[system_id]
        return climber.reason if climber.lift is Lift.STOPPED else None

    def stop(self, reason: str, now_s: float) -> None:
        """Cancel further take-offs, and stop a follower that climbs where it is."""
        self._end()
        for system_id, climber in self._climbers.items():
            if climber.lift is Lift.CLIMBING:
                self._stop(system_id, climber, reason, now_s)

    def taken_over(self, system_id: int) -> None:
        """Its pilot has taken over: a stop on the way up is over."""
        climber = self._climbers[system_id]
        if climber.lift is Lift.STOPPED:
            climber.lift = Lift.LEFT

    def acknowledged(self, follower: FollowerState, message: Any, now_s: float) -> None:
        """Take a COMMAND_ACK of a follower."""
        system_id = follower.plan.system_id
        climber = self._climbers[system_id]
        if message.command != mavlink.MAV_CMD_NAV_TAKEOFF or climber.lift is not Lift.CLIMBING:
            return
        # A vehicle that has left the ground refuses the repeated command.
        risen = (follower.altitude_m or 0.0) > RISEN_M
        accepted = message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
        if accepted or climber.accepted or risen:
            climber.accepted = True
            return
        word = mavlink.enums["MAV_RESULT"].get(message.result)
        told = word.name.removeprefix("MAV_RESULT_") if word else message.result
        self._leave(system_id, climber, f"its autopilot refuses to take off ({told})", now_s)

    def messages(
        self,
        followers: Mapping[int, FollowerState],
        objection: Callable[[FollowerState], str | None],
        now_s: float,
    ) -> list[tuple[int, Any]]:
        """The take-off commands to send now. `objection`: why a follower may not take off."""
        for system_id, follower in followers.items():
            if self.lift(system_id) is Lift.CLIMBING:
                self._watch(follower, objection(follower), now_s)
        turn = self._whose_turn(followers)
        if turn is not None:
            self._prepare(followers[turn], objection(followers[turn]), now_s)
        return [
            (system_id, _take_off(system_id, self.plan.altitude_m))
            for system_id in self._climbers
            if self._asks_now(followers[system_id], now_s)
        ]

    # ---- before it climbs -----------------------------------------------------------------------

    def _whose_turn(self, followers: Mapping[int, FollowerState]) -> int | None:
        """The first that waits, when all before it are high enough."""
        for system_id, climber in self._climbers.items():
            if climber.lift in (Lift.WAITING, Lift.WARNED):
                return system_id
            height_m = followers[system_id].altitude_m or 0.0
            if climber.lift is Lift.CLIMBING and height_m < self.plan.next_at_m:
                return None
        return None

    def _prepare(self, follower: FollowerState, objection: str | None, now_s: float) -> None:
        system_id = follower.plan.system_id
        climber = self._climbers[system_id]
        if follower.flying:
            climber.lift = Lift.DONE
            self._say(now_s, f"follower {system_id}: flies already, no take-off")
            return
        waits_for = _not_ready(follower, now_s) or objection
        if waits_for is not None:
            self._wait(system_id, climber, waits_for, now_s)
        elif climber.lift is Lift.WAITING:
            climber.lift, climber.since_s, climber.waits_for = Lift.WARNED, now_s, None
            self._say(
                now_s,
                f"follower {system_id}: takes off in {WARNING_S:g} s to {self.plan.altitude_m:g} m",
            )
        elif now_s - climber.since_s >= WARNING_S:
            climber.lift, climber.since_s = Lift.CLIMBING, now_s
            self._say(now_s, f"follower {system_id}: takes off")

    def _wait(self, system_id: int, climber: _Climber, waits_for: str, now_s: float) -> None:
        called_off = climber.lift is Lift.WARNED
        climber.lift = Lift.WAITING
        if waits_for == climber.waits_for:
            return
        climber.waits_for = waits_for
        what = "take-off called off" if called_off else "waits to take off"
        self._say(now_s, f"follower {system_id}: {what}, {waits_for}")

    # ---- while it climbs ------------------------------------------------------------------------

    def _asks_now(self, follower: FollowerState, now_s: float) -> bool:
        climber = self._climbers[follower.plan.system_id]
        wanted = climber.lift is Lift.CLIMBING and not climber.accepted and not follower.flying
        if not wanted or climber.asks >= ASKS or now_s - climber.asked_at_s < ASK_PERIOD_S:
            return False
        climber.asks += 1
        climber.asked_at_s = now_s
        return True

    def _watch(self, follower: FollowerState, objection: str | None, now_s: float) -> None:
        system_id = follower.plan.system_id
        climber = self._climbers[system_id]
        height_m = follower.altitude_m or 0.0
        if not follower.armed or not follower.guided_mode:
            what = "has left Guided" if follower.armed else "is disarmed"
            self._leave(system_id, climber, f"{what}, take-off given up", now_s)
        elif not follower.flying and now_s - climber.since_s > LEAVES_GROUND_S:
            # Not just left alone: it may have accepted, and lift off when nobody expects it.
            self._stop(system_id, climber, "it does not leave the ground", now_s)
        elif _is_stale(follower, now_s):
            self._stop(system_id, climber, "its telemetry is stale", now_s)
        elif objection is not None:
            self._stop(system_id, climber, objection, now_s)
        elif follower.flying and height_m >= self.plan.altitude_m - ARRIVED_M:
            climber.lift = Lift.DONE
            self._say(now_s, f"follower {system_id}: has taken off, {height_m:.1f} m up")

    def _stop(self, system_id: int, climber: _Climber, reason: str, now_s: float) -> None:
        climber.lift, climber.reason = Lift.STOPPED, f"take-off stopped, {reason}"
        self._say(now_s, f"follower {system_id}: {climber.reason}; nobody else takes off")
        self._end()

    def _leave(self, system_id: int, climber: _Climber, what: str, now_s: float) -> None:
        climber.lift = Lift.LEFT
        self._say(now_s, f"follower {system_id}: {what}; nobody else takes off")
        self._end()

    def _end(self) -> None:
        """Those that are still on the ground stay there."""
        for climber in self._climbers.values():
            if climber.lift in (Lift.WAITING, Lift.WARNED):
                climber.lift = Lift.LEFT


def _not_ready(follower: FollowerState, now_s: float) -> str | None:
    """What its pilot has to do first, or which report is missing; None: nothing."""
    if _is_stale(follower, now_s):
        return "no report of its position and mode yet"
    if not follower.guided_mode:
        return "until its pilot puts it in Guided"
    return None if follower.armed else "until its pilot arms it"


def _is_stale(follower: FollowerState, now_s: float) -> bool:
    mode_unknown = now_s - follower.mode_at_s > MODE_KNOWN_S
    return mode_unknown or now_s - follower.position_at_s > STALE_S


def _take_off(system_id: int, altitude_m: float) -> Any:
    return command_long(system_id, mavlink.MAV_CMD_NAV_TAKEOFF, *(0.0,) * 6, altitude_m)
