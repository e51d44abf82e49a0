"""The checks before a follower is sent its first point. Pure.

The tool first shows one table over all vehicles, and says of each fault what to do. Until a fault
is fixed, no point goes to the follower that it concerns. Some faults stop a follower in flight too.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.applets import FORMAT, HOLD, IDENTIFYING, LAW, SPEED, Applet, identify
from echowing.flight.by_sonar import DETECT, INSET, applet_by_sonar
from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.follower import FollowerState
from echowing.flight.formation import receivers_demand_m
from echowing.flight.guard import Guard
from echowing.flight.guidance import MOVING_MPS, Horizontal, LeaderFix, slot_offset_m
from echowing.flight.handling import Handling, least_slot_m
from echowing.flight.heights import Heights
from echowing.flight.known import Known
from echowing.flight.leader_speed import MOST_LEADER_MPS, LeaderSpeed
from echowing.flight.lowest import LOWEST_M
from echowing.flight.readiness import Readiness
from echowing.flight.said import Said, Say
from echowing.geo import GlobalPosition, ned_between
from echowing.mavlink.messages import read_parameter

# The applet's parameters that are checked (lua/echowing.md), and those that tell which one it is.
ENABLE, DIST, WATCHDOG = "ECHO_ENABLE", "ECHO_DIST", "ECHO_STREAM_T"
CHECKED = (ENABLE, DIST, INSET, DETECT, WATCHDOG)
APPLET = (*CHECKED, *IDENTIFYING)
# No applet has all of those: what has not come after so many requests counts as not there, until it
# is read again. A radio that loses a fifth each way loses all three in 1 of 20 cases.
REQUESTS_IN_VAIN = 3
# The altitude at which a vehicle returns: in m (from later 4.7 on), in cm.
RTL_M, RTL_CM = RTL = ("RTL_ALT_M", "RTL_ALT")
# Where something is wrong the parameters are read again, as somebody may be setting them.
READ_AGAIN_S = 5.0
# An unknown value counts as wrong only after this long: three requests over a slow radio.
PATIENCE_S = 4.0
# Requested message rates, Hz.
EKF_HZ, GPS_HZ, BATTERY_HZ = 1.0, 1.0, 0.5

# The applet's distance and the slot's may differ by this: half a metre in a range of three.
DISTANCE_M = 0.5
# Two receivers on one field differ by a metre in height: beyond HOMES_M the operator has to say
# what that means. A climb or descent beyond HEIGHTS_M begins only if the operator asks for it.
HOMES_M, HEIGHTS_M = 1.0, 3.0
# A leader may turn round at this speed without danger: the thesis's leader flew at it.
TURNS_MPS = 2.0
# A follower that can brake no harder is not engaged: a stop from 1 m/s takes a second.
WIND_LEAVES_MPS2 = 1.0
# Charge that is enough for a flight of some minutes and the way home.
LEAST_BATTERY_PERCENT = 20
# What ArduPilot requires of a receiver before arming (GPS_HDOP_GOOD, EK3_GPS_CHECK), and the
# variance from which its own fail-safe distrusts the EKF (FS_EKF_THRESH).
GOOD_HDOP, GOOD_SATELLITES = 1.4, 6
DOUBTED_VARIANCE = 0.8
UNKNOWN_EPH = 65_535
# Characters of a line of the table: a terminal of 80 columns, less the time before each event.
TABLE_WIDTH = 80 - 11
# A position that moves less than STAYS_M while its velocities add up to FLOWN_M is stuck.
STAYS_M, FLOWN_M = 0.5, 2.0
# Positions further apart in time do not show what was flown between them.
LONGEST_GAP_MS = 2_000
_NUMBERS = re.compile(r"[-+]?\d+(\.\d+)?")
_EKF_OFF = mavlink.EKF_CONST_POS_MODE | mavlink.EKF_UNINITIALIZED


@dataclass(frozen=True, slots=True)
class Finding:
    """One cell of the table.

    wrong: what is wrong and what to do, empty: nothing; note: a warning, which does not prevent
    engaging.
    """

    name: str
    shown: str
    wrong: str = ""
    note: str = ""


@dataclass(slots=True)
class StuckPosition:
    """Whether a vehicle's position stays put while its own velocity says that it moves."""

    stuck: bool = False
    _from: Any = None
    _before: Any = None
    _flown_m: Horizontal = (0.0, 0.0)

    def report(self, message: Any) -> None:
        """Take a GLOBAL_POSITION_INT."""
        before, self._before = self._before, message
        gap_ms = 0 if before is None else message.time_boot_ms - before.time_boot_ms
        if not 0 < gap_ms <= LONGEST_GAP_MS:
            if gap_ms != 0 or self._from is None:
                self._begin(message)
            return
        if math.hypot(*_flat_m(self._from, message)) > STAYS_M:
            self._begin(message)
            return
        north_m, east_m = self._flown_m
        share = gap_ms / 1e3 / 2.0 / 100.0  # the mean of two speeds in cm/s
        self._flown_m = (
            north_m + (before.vx + message.vx) * share,
            east_m + (before.vy + message.vy) * share,
        )
        self.stuck = math.hypot(*self._flown_m) > FLOWN_M

    def _begin(self, message: Any) -> None:
        self._from, self._flown_m, self.stuck = message, (0.0, 0.0), False


def _flat_m(origin: Any, there: Any) -> Horizontal:
    places = (GlobalPosition(one.lat / 1e7, one.lon / 1e7, 0.0) for one in (origin, there))
    north_m, east_m, _ = ned_between(*places)
    return north_m, east_m


@dataclass(slots=True)
class Vehicle:
    """What one vehicle has reported of itself; None: nothing yet."""

    fix_type: int | None = None
    satellites: int | None = None
    hdop: float | None = None
    ekf_flags: int | None = None
    ekf_doubts: bool = False
    battery_percent: int | None = None
    voltage_mv: int | None = None
    position: StuckPosition = field(default_factory=StuckPosition)
    parameters: dict[str, float] = field(default_factory=dict)
    asked_at_s: float = -math.inf
    format_asked: int = 0
    """How often it was asked which applet it runs, since its applet answers."""

    def receive(self, kind: str, message: Any) -> None:
        """Take a message of this vehicle's autopilot."""
        if kind == "GLOBAL_POSITION_INT":
            self.position.report(message)
        elif kind == "GPS_RAW_INT":
            self.fix_type, self.satellites = message.fix_type, message.satellites_visible
            self.hdop = message.eph / 100.0 if 0 < message.eph < UNKNOWN_EPH else None
        elif kind == "EKF_STATUS_REPORT":
            self.ekf_flags = message.flags
            # Not a number is no reason to trust it.
            self.ekf_doubts = not message.pos_horiz_variance < DOUBTED_VARIANCE
        elif kind == "SYS_STATUS":
            self.battery_percent, self.voltage_mv = (
                message.battery_remaining,
                message.voltage_battery,
            )
        elif kind == "PARAM_VALUE" and message.param_id in (*APPLET, *RTL):
            self.parameters[message.param_id] = message.param_value

    @property
    def unknown_of_applet(self) -> list[str]:
        """Parameters of its applet that are still to be asked for."""
        names: tuple[str, ...] = CHECKED if self.applet_told else (*CHECKED, FORMAT)
        if ENABLE in self.parameters and not self.applet_told:
            names = APPLET  # it answers, and which it is may have to be told without its format
        return [name for name in names if name not in self.parameters]

    def forget_applet(self) -> None:
        """Ask anew which applet it runs."""
        self.format_asked = 0
        for name in IDENTIFYING:
            self.parameters.pop(name, None)

    @property
    def applet_told(self) -> bool:
        """Whether its parameters tell which applet it runs."""
        return FORMAT in self.parameters or self.format_asked >= REQUESTS_IN_VAIN

    @property
    def rtl_m(self) -> float | None:
        """The least height above its home at which it returns; None: not known."""
        if RTL_M in self.parameters:
            return self.parameters[RTL_M]
        return self.parameters[RTL_CM] / 100.0 if RTL_CM in self.parameters else None

    @property
    def fault(self) -> str | None:
        """Why its position cannot be used, by its own reports; None: no reason."""
        if self.fix_type is not None and self.fix_type < mavlink.GPS_FIX_TYPE_3D_FIX:
            return "has no GPS fix"
        if self.ekf_flags is not None and not _has_position(self.ekf_flags):
            return "has an EKF without a position"
        if self.ekf_doubts:
            return "has an EKF that doubts its position"
        return "reports a position that stays put while it moves" if self.position.stuck else None

    @property
    def weakness(self) -> str | None:
        """Why its receiver is too weak although it has a fix; None: no reason known."""
        satellites = self.satellites
        if satellites is not None and satellites < GOOD_SATELLITES:
            return f"has {satellites} satellites: wait for {GOOD_SATELLITES}"
        if self.hdop is not None and self.hdop > GOOD_HDOP:
            return f"has a GPS with HDOP {self.hdop:.1f}: wait for {GOOD_HDOP:g}"
        return None


def _has_position(flags: int) -> bool:
    return bool(flags & mavlink.EKF_POS_HORIZ_ABS) and not flags & _EKF_OFF


@dataclass(slots=True)
class _Checks:
    """How far a follower is from being engaged, since it was put in Guided.

    said: the texts said of it, without numbers; level: it was said that the leader would return at
    its height.
    """

    level: bool = False
    said: Said = field(default_factory=Said)
    wrong: list[Finding] = field(default_factory=list)


class Engagement:
    """Checks whether followers may be engaged.

    say(now_s, text) is for the operator, alert(system_id, text) for a follower's pilot.
    """

    def __init__(
        self,
        readiness: Readiness,
        known: Known,
        guard: Guard,
        heights: Heights,
        say: Say,
        alert: Callable[[int, str], None],
    ) -> None:
        self.readiness = readiness
        self._known, self._guard, self._heights = known, guard, heights
        self._leader_id = known.leader_id
        self._checks = {system_id: _Checks() for system_id in known.followers}
        self._vehicles = {system_id: Vehicle() for system_id in (known.leader_id, *self._checks)}
        self._say, self._alert = say, alert
        self._since_s: float | None = None
        self._table_shown = False
        self._doubts: dict[int, str] = {}
        self._rising_m: Mapping[int, float] = {}
        self._leader_speed = LeaderSpeed()

    # ---- what comes in, and what is asked -------------------------------------------------------

    def receive(self, system_id: int, kind: str, message: Any) -> None:
        """Take a message of the leader or of a follower."""
        vehicle = self._vehicles.get(system_id)
        if vehicle is not None:
            vehicle.receive(kind, message)

    def doubt(self, system_id: int, text: str, now_s: float) -> None:
        """Note for good that it is not known who this vehicle is (see `seats.StrangerWatch`)."""
        if system_id not in self._doubts:
            self._doubts[system_id] = text
            self._say(now_s, text)

    def requests(self) -> list[tuple[int, int, float]]:
        """Messages wanted: system id, message id, rate in Hz."""
        rates = {
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: EKF_HZ,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: GPS_HZ,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: BATTERY_HZ,
        }
        return [(system_id, *item) for system_id in self._vehicles for item in rates.items()]

    def messages(self, now_s: float) -> list[tuple[int, Any]]:
        """Requests for the parameters of applets and autopilots."""
        asked = self._ask_rtl(now_s) + [
            (system_id, read_parameter(system_id, name))
            for system_id, follower in self._known.followers.items()
            for name in follower.handling.asks(now_s)
        ]
        return asked + (self._questions_to_applets(now_s) if self.readiness.applet else [])

    def _questions_to_applets(self, now_s: float) -> list[tuple[int, Any]]:
        asked = []
        for system_id, checks in self._checks.items():
            vehicle = self._vehicles[system_id]
            missing = vehicle.unknown_of_applet
            doubted = {finding.name for finding in checks.wrong} & {"applet", "distance"}
            period_s = ASK_PERIOD_S if missing else READ_AGAIN_S
            if not (missing or doubted) or now_s - vehicle.asked_at_s < period_s:
                continue
            vehicle.asked_at_s = now_s
            if not missing and "applet" in doubted:
                vehicle.forget_applet()  # the pilot may have put another one on the card
            vehicle.format_asked += ENABLE in vehicle.parameters
            asked += [(system_id, read_parameter(system_id, name)) for name in missing or APPLET]
        return asked

    def _ask_rtl(self, now_s: float) -> list[tuple[int, Any]]:
        leader = self._vehicles[self._leader_id]
        if self.readiness.apart_m is None or leader.rtl_m is not None:
            return []
        period_s = READ_AGAIN_S if self._table_shown else ASK_PERIOD_S
        if now_s - leader.asked_at_s < period_s:
            return []
        leader.asked_at_s = now_s
        return [(self._leader_id, read_parameter(self._leader_id, name)) for name in RTL]

    def entered_guided(self, system_id: int) -> None:
        """The pilot has put a follower in Guided: check it again."""
        self._checks[system_id] = _Checks()

    # ---- results --------------------------------------------------------------------------------

    def prepare(
        self, now_s: float, *, engaged: bool, rising_m: Mapping[int, float] | None = None
    ) -> None:
        """Once a tick, before any point: show the table, and check those not engaged yet.

        rising_m: how high the followers take off that are still to be up. They are judged then.
        """
        self._rising_m = rising_m or {}
        if self._since_s is None:
            self._since_s = now_s
        if not self._table_shown:
            self._show_table(now_s)
        self._warn_of_speed(now_s)
        for system_id, follower in self._known.followers.items():
            checks = self._checks[system_id]
            self._warn_of_return(follower, checks, now_s)
            if follower.turn.cleared:
                continue
            self._heights.take_leaders(follower)
            up = system_id not in self._rising_m
            if self._table_shown and engaged and follower.in_guided and up:
                self._judge(follower, checks, now_s)

    def objection(self, system_id: int) -> str | None:
        """What keeps a follower from being engaged, in a few words; None: nothing."""
        wrong = self._checks[system_id].wrong
        return wrong[0].wrong.partition(":")[0] if wrong else None

    def _judge(self, follower: FollowerState, checks: _Checks, now_s: float) -> None:
        system_id = follower.plan.system_id
        checks.wrong = [one for one in self.findings(follower, now_s) if one.wrong]
        if checks.wrong:
            for text in self._tell(system_id, checks, now_s):
                self._alert(system_id, f"not engaged, {text}")
            return
        follower.turn.cleared = True
        if self._heights.leaders:
            self._say(
                now_s,
                f"follower {system_id}: flies {follower.plan.wanted_m:.1f} m above the leader's "
                "home, by the leader's height now; --altitude chooses another",
            )

    def objection_to_take_off(self, follower: FollowerState, now_s: float) -> str | None:
        """As `objection`, for a follower on the ground: height and side do not count yet."""
        airborne = ("height", "side", "wind")
        wrong = (
            one.wrong
            for one in self.findings(follower, now_s)
            if one.wrong and one.name not in airborne
        )
        return next((text.partition(":")[0] for text in wrong), None)

    def reason_to_stop(self, follower: FollowerState) -> str | None:
        """Why a follower that is led has to be held; None: no reason is known."""
        system_id = follower.plan.system_id
        for name, one, clock in (
            ("leader", self._leader_id, self._known.leader.clock),
            ("it", system_id, follower.clock),
        ):
            fault = self._vehicles[one].fault
            if fault is not None:
                return f"{name} {fault}"
            if not clock.known:
                return f"{name} has a clock that is not known"
            if one in self._doubts:
                return f"{name} may not be the vehicle that was meant"
        return None

    def _show_table(self, now_s: float) -> None:
        """Show the table, and what is wrong in it, once all is known or the wait is over."""
        rows = [(f"leader {self._leader_id}", self.leader_findings(now_s))]
        rows += [
            (f"follower {system_id}", self.findings(follower, now_s, own=True))
            for system_id, follower in self._known.followers.items()
        ]
        known = all(one.shown != "?" for _, findings in rows for one in findings)
        if not known and not self._waited(now_s):
            return
        self._table_shown = True
        for line in table(rows):
            self._say(now_s, line)
        if self.readiness.reversal:
            self._say(now_s, f"the leader may fly at up to {MOST_LEADER_MPS:g} m/s")
        for name, findings in rows:
            for one in findings:
                if one.wrong:
                    self._say(now_s, f"{name}: {one.wrong}")

    def _warn_of_return(self, follower: FollowerState, checks: _Checks, now_s: float) -> None:
        """Warn when the leader would return at this follower's height."""
        note = "".join(one.note for one in self._return(follower))
        if note and not checks.level and self._table_shown:
            system_id = follower.plan.system_id
            self._say(now_s, f"follower {system_id}: {note}")
            self._alert(system_id, note)
        checks.level = bool(note) and self._table_shown

    def _warn_of_speed(self, now_s: float) -> None:
        """Warn of a leader that its followers will lose at the next corner."""
        fix = self._known.leader.fix
        if fix is None or not self.readiness.reversal:
            return
        warning = self._leader_speed.warning(fix.speed_mps, now_s)
        if warning is None:
            return
        self._say(now_s, f"{warning}: its followers lose it at corners")
        for system_id, follower in self._known.followers.items():
            if follower.in_guided:
                self._alert(system_id, warning)

    def _waited(self, now_s: float) -> bool:
        return self._since_s is not None and now_s - self._since_s >= PATIENCE_S

    def _tell(self, system_id: int, checks: _Checks, now_s: float) -> list[str]:
        """Say what is wrong, without early repeats; wait for what is not known yet.

        Returns what was said, in short.
        """
        said = []
        for one in checks.wrong:
            text = _NUMBERS.sub("", one.wrong)
            known = self._waited(now_s) or one.shown != "?"
            if known and checks.said.may_say(text, now_s):
                self._say(now_s, f"follower {system_id}: not engaged, {one.wrong}")
                said.append(one.wrong.partition(":")[0])
        return said

    # ---- the checks -----------------------------------------------------------------------------

    def leader_findings(self, now_s: float) -> list[Finding]:
        """The leader's row of the table."""
        system_id = self._leader_id
        return [
            _clock("leader", self._known.leader.clock),
            *self._switch("leader", system_id, now_s),
            *self._state("leader", system_id),
            *self._stranger("leader", system_id),
        ]

    def findings(
        self,
        follower: FollowerState,
        now_s: float,
        *,
        own: bool = False,
    ) -> list[Finding]:
        """All that concerns a follower; `own`: its row of the table, without the leader's."""
        system_id = follower.plan.system_id
        return [
            *([] if own else self.leader_findings(now_s)),
            _clock("its", follower.clock),
            *self._switch("its", system_id, now_s),
            *self._applet(system_id, follower),
            *_sonar(follower),
            *self._reversal(follower, follower.plan.slot.radius_m),
            *self._wind(follower),
            *self._homes(follower),
            *self._height(follower),
            *self._state("its", system_id),
            *self._return(follower),
            *self._side(follower),
            *self._room(follower, now_s),
            *self._stranger("it", system_id),
        ]

    def _switch(self, whose: str, system_id: int, now_s: float) -> list[Finding]:
        shown = self._guard.switches.shown(system_id, now_s)
        if shown is None:
            return []
        whose = "the leader's" if whose == "leader" else whose
        wrong = {
            "not seen": f"{whose} stop switch is not seen: check its transmitter and the channel",
            "on": f"{whose} stop switch is on: switch it off, then leave Guided for 2 s",
            "was on": f"{whose} stop switch was on: leave Guided for 2 s",
        }
        return [Finding("switch", "?" if shown == "not seen" else shown, wrong.get(shown, ""))]

    def _applet(self, system_id: int, follower: FollowerState) -> list[Finding]:
        if not self.readiness.applet:
            return []
        vehicle = self._vehicles[system_id]
        known = vehicle.parameters
        findings = [Finding("applet", *_applet_state(vehicle, self._wanted_applet))]
        if self.readiness.distance and {DIST, INSET, DETECT} <= known.keys():
            distance = _distance(known, follower)
            findings += [] if distance is None else [distance]
        return findings

    @property
    def _wanted_applet(self) -> Applet | None:
        """The applet that flies the points that are sent; None: any."""
        if self.readiness.any_applet:
            return None
        return HOLD if self._known.settings.feed_forward else SPEED

    def objection_to_radius(self, follower: FollowerState, radius_m: float) -> str | None:
        """Why its slot may not be so near to the leader; None: it may."""
        return next((one.wrong for one in self._reversal(follower, radius_m) if one.wrong), None)

    def _reversal(self, follower: FollowerState, radius_m: float) -> list[Finding]:
        """The least distance from which it gets away from a leader that turns round."""
        if not self.readiness.reversal:
            return []
        handling = follower.handling
        unsure = _unsure_of(handling)
        if not handling.known:
            wrong = f"its acceleration and jerk are not known (WP_ACC){unsure}"
            return [Finding("least", "?", wrong)]
        least_m = least_slot_m(
            TURNS_MPS, handling.answer_in_calm, noticed_s=follower.plan.sonar.noticed_s
        )
        wrong = ""
        if radius_m < least_m:
            wrong = (
                f"its slot is {radius_m:g} m from the leader, and {least_m:.1f} m is the least at "
                f"which it gets away from a leader that turns round at {TURNS_MPS:g} m/s: "
                f"`echowing setup apply` (WP_ACC, PSC_JERK_NE), or a larger --radius{unsure}"
            )
        return [Finding("least", f"{least_m:.1f} m", wrong)]

    def _wind(self, follower: FollowerState) -> list[Finding]:
        """Whether the wind leaves it enough of its lean; no cell where it does."""
        leaves_mps2 = follower.handling.wind_leaves_mps2
        if not self.readiness.reversal or leaves_mps2 >= WIND_LEAVES_MPS2:
            return []
        wrong = (
            f"the wind leaves it {leaves_mps2:.1f} m/s2 to brake with, {WIND_LEAVES_MPS2:.1f} are "
            "the least: wait until it is calmer"
        )
        return [Finding("wind", f"{leaves_mps2:.1f} m/s2", wrong)]

    def _homes(self, follower: FollowerState) -> list[Finding]:
        if self._guard.limits.home_difference_m is None:
            return []
        higher_m = self._known.homes.above_leaders_m(follower.plan.system_id)
        if higher_m is None:
            return [Finding("home", "?", "homes are not known: no positions yet")]
        wrong = ""
        if abs(higher_m) > HOMES_M and not self.readiness.homes_told:
            wrong = (
                f"its home is {higher_m:+.1f} m from the leader's by their receivers: give "
                "--level-homes where the ground is level (the difference is their error), "
                "--correct-homes where it is not"
            )
        return [Finding("home", f"{higher_m:+.1f} m", wrong)]

    def _height(self, follower: FollowerState) -> list[Finding]:
        rises_to_m = self._rising_m.get(follower.plan.system_id)
        if rises_to_m is not None:
            return [Finding("height", f"to {rises_to_m:.1f} m")]
        wanted_m, height_m = self._heights.wanted_m(follower), follower.altitude_m
        if wanted_m is None or height_m is None:
            return [Finding("height", "?", "its height or the leader's is not known")]
        wrong = ""
        if wanted_m < LOWEST_M:
            wrong = (
                f"it would be flown at {wanted_m:.1f} m: fly the leader higher, or give --altitude"
            )
        elif abs(height_m - wanted_m) > HEIGHTS_M and not self.readiness.height_told:
            wrong = (
                f"it is {height_m:.1f} m up and would be flown to {wanted_m:.1f} m: fly it to "
                f"within {HEIGHTS_M:g} m of that, or give --altitude"
            )
        return [Finding("height", f"{height_m:.1f} m", wrong)]

    def _return(self, follower: FollowerState) -> list[Finding]:
        """The height at which the leader returns, against this follower's height."""
        least_m = self.readiness.apart_m
        if least_m is None:
            return []
        rtl_m = self._vehicles[self._leader_id].rtl_m
        fix = self._known.leader.fix
        higher_m = self._known.homes.above_leaders_m(follower.plan.system_id)
        home_m = self._known.homes.above_sea_m(self._leader_id)
        wanted_m = self._heights.wanted_m(follower)
        if rtl_m is None:
            note = f"how high the leader comes back is not known ({RTL_M} does not answer)"
            return [Finding("RTL", "?", note=note)]
        if fix is None or home_m is None or higher_m is None or wanted_m is None:
            return [Finding("RTL", "?")]
        back_m = max(rtl_m, fix.position.alt_m - home_m)
        above_m = back_m - wanted_m - higher_m
        note = ""
        if abs(above_m) < least_m:
            note = (
                f"the leader comes back at {back_m:.1f} m, {abs(above_m):.1f} m "
                f"{'above' if above_m > 0.0 else 'below'} it: fly {least_m:g} m apart (--altitude)"
            )
        return [Finding("RTL", f"{back_m:.1f} m", note=note)]

    def _state(self, whose: str, system_id: int) -> list[Finding]:
        vehicle = self._vehicles[system_id]
        name = "the leader" if whose == "leader" else "it"
        fix, ekf = vehicle.fix_type, vehicle.ekf_flags
        fault = f"{name} {vehicle.fault}: wait, or land it" if vehicle.fault else ""
        shown_gps = "?" if fix is None else f"{min(fix, 3)}D {vehicle.satellites}"
        weak = f"{name} {vehicle.weakness}" if vehicle.weakness else ""
        unheard = f"{name} does not report GPS_RAW_INT: check its link"
        gps = fault or (unheard if fix is None else weak)
        unheard = f"{name} does not report EKF_STATUS_REPORT: check its link"
        shown_ekf = "?" if ekf is None else "ok" if _has_position(ekf) else "no position"
        shown_ekf = "doubts" if vehicle.ekf_doubts and shown_ekf == "ok" else shown_ekf
        return [
            Finding("GPS", shown_gps, gps),
            Finding("EKF", shown_ekf, unheard if ekf is None else ""),
            _battery(name, vehicle),
        ]

    def _side(self, follower: FollowerState) -> list[Finding]:
        if not self.readiness.sides or len(self._known.followers) < 2:
            return []
        way = _way(self._known.leader.fix, follower)
        for system_id, other in self._known.followers.items():
            others_way = None if other is follower else _way(self._known.leader.fix, other)
            if way is not None and others_way is not None and _cross(way, others_way):
                wrong = (
                    f"its way to its slot crosses follower {system_id}'s: change the order of "
                    "--follower, or fly them to their own sides"
                )
                return [Finding("side", "crosses", wrong)]
        return [Finding("side", "ok")]

    def _room(self, follower: FollowerState, now_s: float) -> list[Finding]:
        """Whether all other followers are certain to leave it room; no cell for one alone.

        Else it would get away from one before any sonar hears, and perhaps onto the next.
        """
        least_m = self._guard.limits.min_separation_m
        if least_m is None:
            return []
        near = self._known.least_room_m(follower, least_m, now_s)
        if near is None:
            return []
        other, apart_m, unsure_m = near
        wrong = ""
        if apart_m - unsure_m < least_m:
            wrong = (
                f"it is {apart_m:.1f} m from follower {other.plan.system_id} by receivers that may "
                f"err by {unsure_m:.1f} m: fly them {receivers_demand_m(least_m):.1f} m apart"
            )
        return [Finding("room", f"{apart_m:.1f} m", wrong)]

    def _stranger(self, name: str, system_id: int) -> list[Finding]:
        text = self._doubts.get(system_id)
        return [] if text is None else [Finding("who", "doubtful", text)]


def table(rows: Iterable[tuple[str, Iterable[Finding]]]) -> list[str]:
    """Lines of the table: a row per vehicle, `!` after what is wrong.

    Columns that do not fit on a line go into a second table below.
    """
    listed = [(name, {one.name: one for one in findings}) for name, findings in rows]
    names = list(dict.fromkeys(name for _, findings in listed for name in findings))
    vehicles = _padded(["before engaging", *(vehicle for vehicle, _ in listed)])
    columns = [
        _padded([name, *(_cell(findings.get(name)) for _, findings in listed)]) for name in names
    ]
    lines: list[str] = []
    while columns:
        count = _that_fit(vehicles, columns)
        rows_of_part = zip(vehicles, *columns[:count], strict=True)
        lines += ["  ".join(cells).rstrip() for cells in rows_of_part]
        vehicles = [" " * len(vehicles[0]), *vehicles[1:]]
        columns = columns[count:]
    return lines


def _padded(cells: list[str]) -> list[str]:
    width = max(map(len, cells))
    return [cell.ljust(width) for cell in cells]


def _that_fit(vehicles: list[str], columns: list[list[str]]) -> int:
    """How many columns have room beside the vehicles' names; at least one."""
    room = TABLE_WIDTH - len(vehicles[0])
    for count, column in enumerate(columns):
        room -= 2 + len(column[0])
        if room < 0:
            return max(1, count)
    return len(columns)


def _cell(finding: Finding | None) -> str:
    return "-" if finding is None else finding.shown + ("!" if finding.wrong else "")


def _unsure_of(handling: Handling) -> str:
    """What a follower's limits are computed without, as the end of a sentence."""
    missing = handling.missing if handling.known else []
    return f"; not known, so taken as the worst: {', '.join(missing)}" if missing else ""


def _sonar(follower: FollowerState) -> list[Finding]:
    """No cell where it is read as its file says."""
    if not follower.plan.sonar.fixed or not follower.readings.were_single:
        return []
    wrong = (
        "its sonar is read by a co-processor, and by its file the autopilot reads it: start again "
        "with --sonar of what it carries"
    )
    return [Finding("sonar", "co-processor", wrong)]


def _clock(whose: str, clock: Any) -> Finding:
    if clock.known:
        return Finding("clock", f"{clock.round_trip_s:.2f} s")
    whose = "the leader's" if whose == "leader" else whose
    return Finding("clock", "?", f"{whose} clock is not known: it does not answer TIMESYNC")


def _applet_state(vehicle: Vehicle, wanted: Applet | None) -> tuple[str, str]:
    """What to show of a vehicle's applet, and what is wrong."""
    known = vehicle.parameters
    if ENABLE not in known or WATCHDOG not in known:
        return "?", f"no applet ({WATCHDOG} does not answer): `echowing setup lua`, then `apply`"
    if not vehicle.applet_told:
        return "?", "it does not answer which applet it runs"
    runs = identify(known)
    misfit = _misfit(runs, wanted)
    if misfit:
        return "outdated" if runs is None else runs.name, misfit
    if known[ENABLE] != 1.0:
        return "off", f"its applet is off: param set {ENABLE} 1"
    if not known[WATCHDOG] > 0.0:
        return "no watchdog", f"its stream watchdog is off: param set {WATCHDOG} 1"
    law = f"law {known[LAW]:.0f}" if runs is SPEED else HOLD.name
    return f"{law}, {known[WATCHDOG]:.1f} s", ""


def _misfit(runs: Applet | None, wanted: Applet | None) -> str:
    """Why the applet that a vehicle runs does not fly these points; empty: it does."""
    if runs is None:
        return "its applet is of another version: update it (`echowing setup apply`)"
    if wanted in (None, runs):
        return ""
    flies = {
        HOLD: "the hold, which needs points with a velocity: leave out --position-only",
        SPEED: "the speed applet, which needs points without a velocity: give --position-only",
    }
    return f"it runs {flies[runs]}, or `echowing setup apply --applet {wanted.name} --replace`"


def _distance(known: Mapping[str, float], follower: FollowerState) -> Finding | None:
    """The applet's distance against the slot's, where the sonar reaches the leader from there."""
    radius_m, sonar = follower.plan.slot.radius_m, follower.plan.sonar
    if not 0.0 < radius_m - sonar.inset_m < sonar.reach_m:
        return None
    objection = ""
    for name, by_file in applet_by_sonar(sonar).items():
        if not by_file.fits(known[name]):
            objection = (
                f"its {name} is {known[name]:g} m and the sonar file's is {by_file.value:g} m: "
                f"give the file of its mount (--sonar), or param set {name} {by_file.value:g}"
            )
    if not objection and abs(known[DIST] - radius_m) > DISTANCE_M:
        objection = (
            f"its {DIST} is {known[DIST]:g} m and its slot is {radius_m:g} m from the leader: "
            f"param set {DIST} {radius_m:g}, or change --radius"
        )
    return Finding("distance", f"{known[DIST]:.1f} m", objection)


def _battery(name: str, vehicle: Vehicle) -> Finding:
    percent = vehicle.battery_percent
    if percent is None:
        return Finding("battery", "not reported")
    if percent < 0:  # in MAVLink: not known
        return Finding("battery", f"{(vehicle.voltage_mv or 0) / 1e3:.1f} V")
    low = f"{name} has {percent} % of its battery left: land it and change the battery"
    return Finding("battery", f"{percent} %", low if percent < LEAST_BATTERY_PERCENT else "")


Way = tuple[Horizontal, Horizontal]


def _way(fix: LeaderFix | None, follower: FollowerState) -> Way | None:
    """A follower's straight way to its slot, (north, east) of the leader; None: not known."""
    if fix is None or follower.position is None or not follower.in_guided:
        return None
    north_mps, east_mps, _ = fix.velocity_ned_mps
    moves = math.hypot(north_mps, east_mps) >= MOVING_MPS
    course_rad = math.atan2(east_mps, north_mps) if moves else fix.heading_rad
    north_m, east_m, _ = ned_between(fix.position, follower.position)
    return (north_m, east_m), slot_offset_m(follower.plan.slot, course_rad)


def _cross(one: Way, other: Way) -> bool:
    """Whether two straight ways cross."""
    return (
        _side_of(*one, other[0]) * _side_of(*one, other[1]) < 0.0
        and _side_of(*other, one[0]) * _side_of(*other, one[1]) < 0.0
    )


def _side_of(a: Horizontal, b: Horizontal, c: Horizontal) -> float:
    """On which side of the line from a to b a point is."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
