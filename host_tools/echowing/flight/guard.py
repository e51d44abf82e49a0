"""What stops a follower in the field, and whether it really stopped. Pure.

The follow session asks the guard before every point. The guard never frees a vehicle: what it
has stopped for a reason that does not pass by itself (a refused target, the stop switch) stays
stopped until the pilot has left Guided and come back.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.clocks import UNHEARD_S
from echowing.flight.envelope import LEAST_M
from echowing.flight.follower import FollowerState
from echowing.flight.homes import Homes
from echowing.flight.known import Known
from echowing.flight.lowest import LOWEST_M
from echowing.flight.readiness import Readiness
from echowing.flight.said import Say
from echowing.flight.steps import Command
from echowing.flight.switch import StopSwitch, Switches
from echowing.geo import GlobalPosition, displace, distance_m, nearer_than, ned_between

# A hovering copter's estimate wanders by a decimetre a second; below this it stands.
STILL_MPS = 0.3
STILL_FOR_S = 1.0
# Positions are asked for at 10 Hz and slow radios take half a second; an older speed does not show
# a stop.
FRESH_S = 1.0
# From 2 m/s a copter stands within 3 s; the tool reports one that still moves then.
REMIND_S = 3.0
# One that was led and reports again is held until it has done so for this long: its pilot sees on
# the display that the tool is back before it moves.
STEADY_S = 3.0
# A stop ends only when things are this much better than what caused it.
CLEAR_M = 0.5
CLEAR_SHARE = 0.9
# A point is as far as the leader may be away, with a slot beyond it and what an envelope adds.
NEAR_SHARE = 1.5
# A correction of the altitude is reported when it begins and when it changes by more than this.
DATUM_TOLD_M = 0.3

# Targets are read back in 1e-7 degrees (1 cm): one this far from all points sent means a refusal.
REFUSED_M = 0.5
REFUSED_FOR_S = 2.0
# A follower sent on this fast moves within a second; one that stands for so long is blocked.
SENT_ON_MPS, STUCK_FOR_S = 1.0, 4.0
# Type mask of a target without a position; reports this near in time count as one place (0.1 m
# apart at 5 m/s).
NO_POSITION = 0x7
SAME_MOMENT_MS = 20
REMEMBERED_S = 1.5  # longer than any link takes there and back
# The applet's own targets (lua/echowing.md): too close, stream lost, backing off, holding.
APPLET_STATE = "ECHO_STATE"
APPLET_FLIES = (3, 5, 6, 7)
APPLET_BACKS_OFF, APPLET_HOLDS = 6, 7
# In these states it flies targets of its own, whatever points the vehicle is sent.
APPLET_IGNORES_POINTS = (5, 6)

# Asked for: often enough to notice within a second, on a radio that loses one message in three.
READ_BACK_HZ = 4.0
SWITCH_HZ = 4.0
# No target read back for so long since the first point: the tool says so.
READ_BACK_S = 8.0


def mode_name(number: int) -> str:
    """Copter's name of a mode."""
    entry = mavlink.enums["COPTER_MODE"].get(number)
    return entry.name.removeprefix("COPTER_MODE_") if entry else f"mode {number}"


@dataclass(frozen=True, slots=True)
class Limits:
    """When to stop.

    max_distance_m: from follower to leader; min_separation_m: between any two vehicles, heights
    included; home_difference_m: the largest difference in altitude between the leader's home and
    the follower's that is corrected (each counts its altitude from its own); level_homes: both
    homes are known to be level, so their difference is the receivers' error and is not corrected;
    leader_flies: the leader has to be armed and in the air; ready: the checks before the first
    point, None: none.
    """

    max_distance_m: float | None = None
    min_separation_m: float | None = None
    home_difference_m: float | None = None
    level_homes: bool = False
    leader_flies: bool = True
    switch: StopSwitch | None = None
    ready: Readiness | None = None

    def homes(self, leader_id: int) -> Homes:
        """The homes of a session with these limits."""
        corrects = self.home_difference_m is not None and not self.level_homes
        return Homes(leader_id, level=self.level_homes, corrects=corrects)


# The defaults of `echowing follow`, flown by the simulator too.
FIELD_LIMITS = Limits(
    max_distance_m=100.0,
    min_separation_m=LEAST_M,
    home_difference_m=5.0,
    ready=Readiness(),
)


@dataclass(slots=True)
class _Watch:
    """What the guard knows of one follower."""

    sent: deque[tuple[float, GlobalPosition]] = field(default_factory=deque)
    off_since_s: float | None = None
    stuck_since_s: float | None = None
    applet_state: int = 0
    applet_at_s: float = -math.inf
    backed_off: bool = False
    unheard: bool = False
    back_at_s: float = -math.inf
    low_told: bool = False
    still_since_s: float | None = None
    told_at_s: float | None = None
    led_since_s: float | None = None
    place: Any = None
    origin: GlobalPosition | None = None
    read_back: bool = False
    unread_told: bool = False
    verified: bool = False


class Guard:
    """Watches the vehicles of one session.

    say(now_s, text) is for the operator, alert(system_id, text) for a follower's pilot.
    """

    def __init__(
        self,
        limits: Limits,
        known: Known,
        say: Say,
        alert: Callable[[int, str], None] = lambda system_id, text: None,
    ) -> None:
        self.limits = limits
        self._known, self._leader_id = known, known.leader_id
        self._watches = {system_id: _Watch() for system_id in known.followers}
        self._say, self._alert = say, alert
        self._leader_flies: bool | None = None
        self._shifts_told_m: dict[int, float] = {}
        self.switches = Switches(limits.switch, known.leader_id, self._watches)

    # ---- what comes in --------------------------------------------------------------------------

    def receive(self, system_id: int, kind: str, message: Any, now_s: float) -> None:
        """Take a message of the leader or of a follower."""
        if kind == "RC_CHANNELS":
            self.switches.receive(system_id, message, now_s)
        elif system_id == self._leader_id:
            self._leader_message(kind, message)
        elif kind == "GLOBAL_POSITION_INT":
            self._watches[system_id].place = message
        elif kind == "POSITION_TARGET_GLOBAL_INT":
            target = GlobalPosition(message.lat_int / 1e7, message.lon_int / 1e7, 0.0)
            self._read_back(system_id, target, now_s)
        elif kind == "LOCAL_POSITION_NED":
            self._find_origin(self._watches[system_id], message)
        elif kind == "POSITION_TARGET_LOCAL_NED":
            self._read_back_local(system_id, message, now_s)
        elif kind == "NAMED_VALUE_FLOAT" and message.name == APPLET_STATE:
            self._applet_said(self._watches[system_id], round(message.value), now_s)

    def _applet_said(self, watch: _Watch, state: int, now_s: float) -> None:
        watch.applet_state, watch.applet_at_s = state, now_s
        watch.backed_off = watch.backed_off or state == APPLET_BACKS_OFF

    def _leader_message(self, kind: str, message: Any) -> None:
        if kind == "HEARTBEAT":
            self._leader_flies = is_flying(message)

    @staticmethod
    def _find_origin(watch: _Watch, local: Any) -> None:
        """Where a vehicle's local coordinates begin, from two reports of the same moment."""
        place = watch.place
        if place is None or abs(local.time_boot_ms - place.time_boot_ms) > SAME_MOMENT_MS:
            return
        here = GlobalPosition(place.lat / 1e7, place.lon / 1e7, 0.0)
        watch.origin = displace(here, (-local.x, -local.y, 0.0))

    def _read_back_local(self, system_id: int, message: Any, now_s: float) -> None:
        origin = self._watches[system_id].origin
        if origin is not None and not message.type_mask & NO_POSITION:
            target = displace(origin, (message.x, message.y, 0.0))._replace(alt_m=0.0)
            self._read_back(system_id, target, now_s)

    def _read_back(self, system_id: int, target: GlobalPosition, now_s: float) -> None:
        """Note a target that matches no point sent lately, unless the applet set it."""
        watch = self._watches[system_id]
        watch.read_back = True
        while watch.sent and now_s - watch.sent[0][0] > REMEMBERED_S:
            watch.sent.popleft()
        if (
            not watch.sent
            or watch.applet_state in APPLET_FLIES
            or any(_apart_m(target, point) < REFUSED_M for _, point in watch.sent)
        ):
            watch.off_since_s = None
        elif watch.off_since_s is None:
            watch.off_since_s = now_s
        elif now_s - watch.off_since_s >= REFUSED_FOR_S:
            self._refuse(system_id, now_s)

    def entered_guided(self, system_id: int, now_s: float) -> None:
        """The pilot has put a follower in Guided: drop the earlier reasons to stop it."""
        self.switches.entered_guided(system_id, now_s)
        self._watches[system_id] = _Watch(applet_state=self._watches[system_id].applet_state)

    # ---- what is to be done ---------------------------------------------------------------------

    def reason_to_stop(
        self, follower: FollowerState, leader: GlobalPosition, now_s: float
    ) -> str | None:
        """Why this follower may not move now; None: it may. `leader`: where it is believed."""
        watch = self._watches[follower.plan.system_id]
        if self.switched(follower.plan.system_id):
            return "stop switch"
        if follower.turn.refused:
            return "its points are refused"
        if follower.turn.flown and now_s - watch.back_at_s < STEADY_S:
            return "its link was lost"
        if self.limits.leader_flies and self._leader_flies is not True:
            return "leader is not known to fly"
        if follower.position is None:
            return None
        return self._other_datum(follower, now_s) or self._too_far(follower, leader)

    def _other_datum(self, follower: FollowerState, now_s: float) -> str | None:
        """A home so much higher or lower that the altitude cannot be corrected."""
        system_id = follower.plan.system_id
        most_m = self.limits.home_difference_m
        if most_m is None:
            return None
        higher_m = self._known.homes.above_leaders_m(system_id)
        if higher_m is None:
            return "homes are not known"
        if abs(higher_m) > most_m:
            return f"its home is {higher_m:+.1f} m from the leader's"
        wanted_m = follower.plan.wanted_m + self._known.homes.shift_m(system_id)
        if wanted_m < LOWEST_M:
            return f"the leader's altitude is only {wanted_m:.1f} m above its own home"
        self._tell_shift(system_id, wanted_m, now_s)
        return None

    def _tell_shift(self, system_id: int, wanted_m: float, now_s: float) -> None:
        shift_m = self._known.homes.shift_m(system_id)
        if abs(shift_m - self._shifts_told_m.get(system_id, 0.0)) <= DATUM_TOLD_M:
            return
        self._shifts_told_m[system_id] = shift_m
        self._say(
            now_s,
            f"follower {system_id}: its home is {-shift_m:+.1f} m from the leader's by their "
            f"receivers, so it flies {wanted_m:.1f} m above its own",
        )

    def _too_far(self, follower: FollowerState, leader: GlobalPosition) -> str | None:
        most_m = self.limits.max_distance_m
        if most_m is None or follower.position is None:
            return None
        if follower.hold is not None:
            most_m *= CLEAR_SHARE
        apart_m = distance_m(follower.position, leader)
        return f"leader is beyond {most_m:.0f} m" if apart_m > most_m else None

    def is_near(self, follower: FollowerState, point: GlobalPosition) -> bool:
        """Whether a point is where a follower may be sent: it flies about as far as its leader."""
        most_m = self.limits.max_distance_m
        if most_m is None or follower.position is None:
            return True
        most_m = NEAR_SHARE * most_m + 2.0 * follower.plan.slot.radius_m
        return _apart_m(point, follower.position) <= most_m

    def too_near(
        self,
        follower: FollowerState,
        leader: GlobalPosition | None,
        now_s: float,
    ) -> str | None:
        """Which other vehicle is too near, in words; None: none is."""
        least_m = self.limits.min_separation_m
        if least_m is None or follower.position is None:
            return None
        if follower.hold is not None:
            least_m += CLEAR_M
        here = self._known.in_height(follower.plan.system_id, follower.position)
        if leader is not None and nearer_than(
            here, self._known.in_height(self._leader_id, leader), least_m
        ):
            return f"nearer to the leader than {least_m:g} m"
        for system_id, other in self._known.followers.items():
            if other is follower or other.position is None:
                continue
            fresh = now_s - other.position_at_s < UNHEARD_S
            there = self._known.in_height(system_id, other.position)
            if fresh and nearer_than(here, there, least_m):
                return f"nearer to follower {system_id} than {least_m:g} m"
        return None

    def reason_to_leave(self, follower: FollowerState, now_s: float) -> str | None:
        """Why no points may go to this follower at all; None: they may."""
        system_id = follower.plan.system_id
        watch = self._watches[system_id]
        unheard = now_s - follower.position_at_s > UNHEARD_S
        if unheard is not watch.unheard:
            watch.unheard = unheard
            text = f"no report for {UNHEARD_S:g} s, no points sent" if unheard else "reports again"
            self._say(now_s, f"follower {system_id}: {text}")
            if not unheard and follower.turn.flown:
                watch.back_at_s = now_s
                self._alert(system_id, "link was lost, holding")
        if unheard:
            return "does not report"
        if follower.turn.released or (self.switched(system_id) and not follower.turn.flown):
            return "its pilot's, by the stop switch"
        return self._too_low(follower, watch, now_s)

    def _too_low(self, follower: FollowerState, watch: _Watch, now_s: float) -> str | None:
        """Whether it has just left the ground: a point would end its pilot's take-off there."""
        least_m = min(LOWEST_M, follower.plan.wanted_m / 2.0)
        low = follower.altitude_m is not None and follower.altitude_m < least_m
        if follower.turn.flown or not low:
            return None
        too_low = f"too low to be led, until it is {least_m:g} m up"
        if not watch.low_told:
            watch.low_told = True
            self._say(now_s, f"follower {follower.plan.system_id}: {too_low}")
        return too_low

    def sent(self, follower: FollowerState, command: Command, now_s: float) -> None:
        """Note that a point has gone to a follower."""
        system_id = follower.plan.system_id
        watch = self._watches[system_id]
        watch.sent.append((now_s, command.place))
        self._note_stuck(follower, watch, command, now_s)
        if watch.led_since_s is None:
            watch.led_since_s = now_s
        if watch.read_back or watch.unread_told or now_s - watch.led_since_s < READ_BACK_S:
            return
        watch.unread_told = True
        self._say(
            now_s,
            f"follower {system_id}: its target is not read back (no POSITION_TARGET_GLOBAL_INT): "
            "a point that a fence refuses would go unnoticed",
        )

    def _note_stuck(
        self, follower: FollowerState, watch: _Watch, command: Command, now_s: float
    ) -> None:
        """Detect a fence that accepts a point at the vehicle's place but blocks its way on."""
        here, sent_mps = follower.position, math.hypot(*(command.velocity_mps or (0.0, 0.0)))
        own = here is not None and _apart_m(command.place, here) < REFUSED_M
        sent_on = own and sent_mps > SENT_ON_MPS and not follower.standing.held
        moves = follower.ground_speed_mps > STILL_MPS or watch.applet_state in APPLET_FLIES
        if moves or not sent_on:
            watch.stuck_since_s = None
        elif watch.stuck_since_s is None:
            watch.stuck_since_s = now_s
        elif now_s - watch.stuck_since_s >= STUCK_FOR_S:
            self._refuse(follower.plan.system_id, now_s)

    def _refuse(self, system_id: int, now_s: float) -> None:
        turn = self._known.followers[system_id].turn
        if not turn.refused:
            turn.refused = True
            self._say(
                now_s,
                f"follower {system_id}: its autopilot did not take the points sent "
                "(a fence in the way?)",
            )

    def moving(self, system_id: int) -> None:
        """A follower is flown again: its next stop has to be verified anew."""
        watch = self._watches[system_id]
        watch.still_since_s = watch.told_at_s = None
        watch.verified = False

    def holding(self, follower: FollowerState, now_s: float) -> None:
        """Check whether a follower that is told to hold does so."""
        system_id = follower.plan.system_id
        watch = self._watches[system_id]
        if watch.told_at_s is None:
            watch.told_at_s = now_s
        if now_s - follower.position_at_s > FRESH_S:
            watch.still_since_s = None
        elif (speed_mps := math.hypot(follower.ground_speed_mps, follower.climb_mps)) > STILL_MPS:
            self._remind(system_id, watch, speed_mps, now_s)
        elif watch.still_since_s is None:
            watch.still_since_s = now_s
        elif now_s - watch.still_since_s >= STILL_FOR_S and not watch.verified:
            watch.verified = True
            self._say(now_s, f"follower {system_id}: has stopped")
            if self.switched(system_id):
                follower.turn.released = True
                self._say(now_s, f"follower {system_id}: pilot has control, by the stop switch")

    def _remind(self, system_id: int, watch: _Watch, speed_mps: float, now_s: float) -> None:
        watch.still_since_s = None
        watch.verified = False
        if watch.told_at_s is not None and now_s - watch.told_at_s >= REMIND_S:
            watch.told_at_s = now_s
            text = f"still moves at {speed_mps:.1f} m/s, stopped again"
            self._alert(system_id, text)
            self._say(now_s, f"follower {system_id}: {text}")

    def switched(self, system_id: int) -> bool:
        """Whether the pilot's stop switch, or the leader's, has stopped it."""
        return self.switches.stops(system_id)

    def ignores_points(self, system_id: int) -> bool:
        """Whether its applet flies it: back from its leader, or to a stop as no points reach it."""
        return self._watches[system_id].applet_state in APPLET_IGNORES_POINTS

    def holds_the_distance(self, system_id: int, now_s: float) -> bool:
        """Whether its applet says now that it holds the distance to its leader, by the sonar."""
        watch = self._watches[system_id]
        return watch.applet_state == APPLET_HOLDS and now_s - watch.applet_at_s < UNHEARD_S

    def has_backed_off(self, system_id: int, *, stands: bool) -> bool:
        """Whether its applet has flown it back; until that has ended, and it `stands`."""
        watch = self._watches[system_id]
        before, watch.backed_off = watch.backed_off, watch.backed_off and not stands
        watch.backed_off = watch.backed_off or watch.applet_state == APPLET_BACKS_OFF
        return before

    def stands(self, system_id: int) -> bool:
        """Whether this follower's stop has been verified."""
        return self._watches[system_id].verified

    # ---- what it asks of the vehicles -----------------------------------------------------------

    def messages(self, now_s: float) -> list[tuple[int, Any]]:
        """Mode changes that the pilot's switch asks for."""
        messages: list[tuple[int, Any]] = []
        for system_id, follower in self._known.followers.items():
            if follower.in_guided and follower.turn.flown:
                round_trip_s = follower.clock.round_trip_s
                asked = self.switches.message(system_id, follower.mode_at_s, round_trip_s, now_s)
                messages.extend([] if asked is None else [(system_id, asked)])
        return messages

    def requests(self) -> list[tuple[int, int, float]]:
        """Messages wanted beside the positions: system id, message id, rate in Hz."""
        if self.limits.switch is None:
            return []
        switches = mavlink.MAVLINK_MSG_ID_RC_CHANNELS
        return [(system_id, switches, SWITCH_HZ) for system_id in (self._leader_id, *self._watches)]

    def read_back_requests(self, *, feed_forward: bool) -> list[tuple[int, int, float]]:
        """As `requests`, for messages that come only while a vehicle has a target: no loss before.

        ArduPilot reports a target with a velocity in local coordinates only.
        """
        kinds = [mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT]
        if feed_forward:
            kinds.append(mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)
            kinds.append(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
        return [(system_id, kind, READ_BACK_HZ) for system_id in self._watches for kind in kinds]


def is_flying(heartbeat: Any) -> bool:
    """Armed and off the ground (ArduCopter says STANDBY while landed)."""
    armed = heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    return bool(armed) and heartbeat.system_status >= mavlink.MAV_STATE_ACTIVE


def _apart_m(a: GlobalPosition, b: GlobalPosition) -> float:
    north_m, east_m, _ = ned_between(a, b._replace(alt_m=a.alt_m))
    return math.hypot(north_m, east_m)
