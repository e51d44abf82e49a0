"""What the operator sees of each vehicle: readings from the links, and rows of them. Pure."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.clocks import UNHEARD_S
from echowing.flight.follower import FollowerState
from echowing.flight.guard import is_flying, mode_name
from echowing.flight.leader_track import VehicleClock
from echowing.flight.session import FollowSession
from echowing.flight.steps import Phase, name_of
from echowing.flight.supervisor import WAITS
from echowing.geo import distance_m, ned_between
from echowing.mavlink.messages import FORWARD, sonar_range_m

FOLLOWING = "following"
# The applet's and the co-processor's named floats (lua/echowing.md, firmware's DeviceState).
SPEED_LIMIT, GIMBAL_STATE = "ECHO_SPD", "SNR_STATE"
FIXES = {0: "none", 1: "none", 2: "2D"}  # of GPS_FIX_TYPE; all others are 3D and better
GIMBAL = {0: "starting", 1: "searching", 2: "tracking", 3: "sonar fault"}
SONAR_FRESH_S = 0.5  # ArduPilot's own limit for a MAVLink rangefinder
NAMED_FRESH_S = 2.0
# Battery and GPS come at 0.5 and 1 Hz, the mode at 1 Hz: five of them missed.
HEALTH_FRESH_S = 10.0
LINK_WINDOW_S = 5.0
# If sonar and receivers disagree by more than a beam's width and a GPS can explain, for this long,
# another vehicle, the ground or another sonar is in the beam.
MISMATCH_M = 2.0
MISMATCH_S = 2.0
UNKNOWN_MV = 0xFFFF  # of SYS_STATUS
MOST_LOST = 50  # in a row; more is a restart or another sender, not a gap


@dataclass(frozen=True, slots=True)
class VehicleHealth:
    """What decides whether a pilot must land, for one vehicle; None: not known, or too old.

    altitude_m: above its own home; gps: kind of fix and satellites; clock_s: TIMESYNC's round
    trip; switch: its stop switch.
    """

    mode: str | None = None
    altitude_m: float | None = None
    gps: str | None = None
    battery_percent: float | None = None
    battery_v: float | None = None
    clock_s: float | None = None
    switch: str | None = None


# Prefixes of the names of a row's two healths in a flat table, as in the log.
PREFIXES = {"own": "", "leader": "leader_"}


@dataclass(frozen=True, slots=True)
class Row:
    """One follower at one moment; None: not known. Times in seconds.

    separation_m, error_m: distance to whom its sonar watches, the leader or another follower, by
    their receivers, heights included, and the same minus the wanted radius, if there is one;
    slot_error_m: horizontally from the slot; leader_age_s: of the leader's report in use; age_s: of
    the follower's, both by their time stamps; command_mps: the applet's limit; own, leader: the
    follower's and the leader's health; watches: the follower that its sonar watches, None: the
    leader.
    heard_percent, scatter_m, wrong_percent: what its sonar has heard in the last minute: share of
    the pings at the leader, standard deviation of a range, share of readings of something else;
    worse: what of it is worse than its sonar file says.
    """

    time_s: float
    system_id: int
    state: str
    separation_m: float | None
    error_m: float | None
    slot_error_m: float | None
    sonar_m: float | None
    gimbal: str | None
    leader_age_s: float | None
    age_s: float | None
    command_mps: float | None
    speed_mps: float
    leader_speed_mps: float | None
    link_percent: float | None
    north_offset_m: float
    east_offset_m: float
    own: VehicleHealth = VehicleHealth()
    leader: VehicleHealth = VehicleHealth()
    heard_percent: float | None = None
    scatter_m: float | None = None
    wrong_percent: float | None = None
    worse: str | None = None
    watches: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Its fields and those of its healths, named as in `COLUMNS`, rounded to the millimetre."""
        parts = (self, *(getattr(self, name) for name in PREFIXES))
        values = (
            getattr(part, name) for part, names in zip(parts, _NAMES, strict=True) for name in names
        )
        return {
            name: round(value, 3) if isinstance(value, float) else value
            for name, value in zip(COLUMNS, values, strict=True)
        }


# The names of the fields of a row without its healths, and of each health.
_NAMES = (
    [column.name for column in fields(Row) if column.name not in PREFIXES],
    *([column.name for column in fields(VehicleHealth)] for _ in PREFIXES),
)
COLUMNS = [
    prefix + name
    for prefix, names in zip(("", *PREFIXES.values()), _NAMES, strict=True)
    for name in names
]


@dataclass(slots=True)
class _Quality:
    """Share of a vehicle's frames that arrive, by their sequence numbers."""

    last: int | None = None
    received: int = 0
    lost: int = 0
    since_s: float | None = None
    percent: float | None = None

    def count(self, sequence: int, now_s: float) -> None:
        gap = 0 if self.last is None else (sequence - self.last - 1) % 256
        self.last = sequence
        self.received += 1
        self.lost += gap if gap <= MOST_LOST else 0
        if self.since_s is None:
            self.since_s = now_s
        if now_s - self.since_s >= LINK_WINDOW_S:
            self.percent = 100.0 * self.received / (self.received + self.lost)
            self.received = self.lost = 0
            self.since_s = now_s


@dataclass(slots=True)
class _Readings:
    """The newest of each reading of a vehicle, and when it arrived."""

    quality: _Quality = field(default_factory=_Quality)
    mode: str | None = None
    sonar_m: float | None = None
    sonar_at_s: float = -math.inf
    named: dict[str, tuple[float, float]] = field(default_factory=dict)
    odd_since_s: float | None = None
    odd_told: bool = False
    beat_at_s: float = -math.inf
    altitude_m: float | None = None
    gps: tuple[float, str | None] = (-math.inf, None)
    battery: tuple[float, float | None, float | None] = (-math.inf, None, None)

    def newest(self, name: str, now_s: float) -> float | None:
        at_s, value = self.named.get(name, (-math.inf, math.nan))
        return value if now_s - at_s < NAMED_FRESH_S else None


class Panel:
    """Readings of the vehicles of one session. `texts` holds the warnings of the vehicles."""

    def __init__(self, system_ids: Iterable[int]) -> None:
        self._readings = {system_id: _Readings() for system_id in system_ids}
        self.texts: list[tuple[int, str]] = []

    def receive(self, message: Any, now_s: float) -> None:
        """Take any message of any vehicle that has come through its link's door."""
        readings = self._readings.get(message.get_srcSystem())
        if readings is None:
            return
        kind = message.get_type()
        if message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            readings.quality.count(message.get_seq(), now_s)
            self._autopilot_says(readings, kind, message)
            _note_health(readings, kind, message, now_s)
        if kind == "DISTANCE_SENSOR" and message.orientation == FORWARD:
            readings.sonar_m = sonar_range_m(message, math.inf)
            readings.sonar_at_s = now_s
        elif kind == "NAMED_VALUE_FLOAT":
            readings.named[message.name] = (now_s, message.value)

    def _autopilot_says(self, readings: _Readings, kind: str, message: Any) -> None:
        if kind == "HEARTBEAT":
            mode = mode_name(message.custom_mode)
            readings.mode = mode if is_flying(message) else f"{mode}, not flying"
        elif kind == "STATUSTEXT" and message.severity <= mavlink.MAV_SEVERITY_WARNING:
            self.texts.append((message.get_srcSystem(), message.text))

    def newest(self, system_id: int, name: str, now_s: float) -> float | None:
        """A vehicle's newest named float, None when there is no recent one."""
        return self._readings[system_id].newest(name, now_s)

    def link_percent(self, system_id: int) -> float | None:
        """The share of a vehicle's frames that arrive; also of the leader's."""
        return self._readings[system_id].quality.percent

    def rows(self, session: FollowSession, now_s: float) -> list[Row]:
        """A row per follower."""
        return [self._row(session, follower, now_s) for follower in session.followers.values()]

    def _row(self, session: FollowSession, follower: FollowerState, now_s: float) -> Row:
        readings = self._readings[follower.plan.system_id]
        fix = session.leader.fix
        separation_m = _separation_m(session, follower, now_s)
        radius_m = follower.slot.radius_m
        gimbal = readings.newest(GIMBAL_STATE, now_s)
        fresh = now_s - readings.sonar_at_s < SONAR_FRESH_S
        sonar_m = readings.sonar_m if fresh else None
        if sonar_m is not None and sonar_m >= follower.plan.sonar.reach_m:
            sonar_m = None
        estimate = follower.estimate
        shift_m = estimate.shift_m if estimate.offset.has_heard else (0.0, 0.0)
        watched_id = session.known.watched_id(follower)
        name = name_of(watched_id, session.leader_id)
        self._compare(follower.plan.system_id, name, sonar_m, separation_m, now_s)
        return Row(
            time_s=now_s,
            system_id=follower.plan.system_id,
            state=state_of(follower),
            separation_m=separation_m,
            error_m=None if separation_m is None or radius_m == 0.0 else separation_m - radius_m,
            slot_error_m=_slot_error_m(follower),
            sonar_m=sonar_m,
            gimbal=None if gimbal is None else GIMBAL.get(round(gimbal)),
            leader_age_s=None if fix is None else max(0.0, now_s - fix.time_s),
            age_s=_finite(now_s - follower.position_at_s),
            command_mps=readings.newest(SPEED_LIMIT, now_s),
            speed_mps=follower.ground_speed_mps,
            leader_speed_mps=None if fix is None else fix.speed_mps,
            link_percent=readings.quality.percent,
            north_offset_m=shift_m[0],
            east_offset_m=shift_m[1],
            own=self._health(session, follower.plan.system_id, follower.clock, now_s),
            leader=self._health(session, session.leader_id, session.leader.clock, now_s),
            watches=None if watched_id == session.leader_id else watched_id,
            **_heard(follower),
        )

    def _health(
        self, session: FollowSession, system_id: int, clock: VehicleClock, now_s: float
    ) -> VehicleHealth:
        readings = self._readings.get(system_id, _Readings())
        gps_at_s, gps = readings.gps
        battery_at_s, percent, volts = readings.battery
        beats = now_s - readings.beat_at_s < HEALTH_FRESH_S
        charged = now_s - battery_at_s < HEALTH_FRESH_S
        guard = session.guard
        return VehicleHealth(
            mode=readings.mode if beats else None,
            altitude_m=readings.altitude_m,
            gps=gps if now_s - gps_at_s < HEALTH_FRESH_S else None,
            battery_percent=percent if charged else None,
            battery_v=volts if charged else None,
            clock_s=clock.round_trip_s if clock.known else None,
            switch=None if guard is None else guard.switches.shown(system_id, now_s),
        )

    def _compare(
        self,
        system_id: int,
        watched: str,
        sonar_m: float | None,
        separation_m: float | None,
        now_s: float,
    ) -> None:
        """Report a sonar that detects something else than whom it watches, once each time."""
        readings = self._readings[system_id]
        agrees = sonar_m is None or separation_m is None
        if sonar_m is not None and separation_m is not None:
            agrees = abs(sonar_m - separation_m) < MISMATCH_M
        if agrees:
            readings.odd_since_s, readings.odd_told = None, False
        elif readings.odd_since_s is None:
            readings.odd_since_s = now_s
        elif now_s - readings.odd_since_s >= MISMATCH_S and not readings.odd_told:
            readings.odd_told = True
            self.texts.append(
                (
                    system_id,
                    f"the sonar detects something at {sonar_m:.1f} m, {watched} should be "
                    f"{separation_m:.1f} m away",
                )
            )


def state_of(follower: FollowerState) -> str:
    """What is being done with a follower, in a few words."""
    phase, why = follower.standing.phase, follower.standing.why
    if phase is Phase.LED:
        name = None if follower.allowed is None else follower.allowed.gives_way_to
        if name is not None:
            return f"gives way to {name}"
        return why if why == WAITS else ": ".join(filter(None, (FOLLOWING, why)))
    if phase is Phase.HELD:
        return f"holding: {why}"
    if phase is Phase.CHECKED and why:
        return f"not engaged: {why}"
    return why if phase in (Phase.WATCHED, Phase.LIFTED) else "no points sent"


def _heard(follower: FollowerState) -> dict[str, Any]:
    """What a follower's sonar has heard lately."""
    heard = follower.estimate.hearing.heard()
    return {
        "heard_percent": _percent(heard.share),
        "scatter_m": heard.scatter_m,
        "wrong_percent": _percent(heard.wrong_share),
        "worse": heard.worse,
    }


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _separation_m(session: FollowSession, follower: FollowerState, now_s: float) -> float | None:
    """Distance to whom its sonar watches, by this follower's receiver."""
    known = session.known
    watched = known.watched_now(follower, now_s)
    if follower.position is None or watched is None:
        return None
    if session.guard is None:
        return distance_m(follower.position, watched)
    watched_id = known.watched_id(follower)
    return math.hypot(*known.from_it_m(watched_id, watched, follower, follower.position))


def _slot_error_m(follower: FollowerState) -> float | None:
    """Horizontal distance to the slot, while it receives points."""
    if follower.position is None or follower.guided is None or follower.standing.held:
        return None
    north_m, east_m, _ = ned_between(follower.position, follower.guided.slot)
    return math.hypot(north_m, east_m)


def _note_health(readings: _Readings, kind: str, message: Any, now_s: float) -> None:
    if kind == "HEARTBEAT":
        readings.beat_at_s = now_s
    elif kind == "GLOBAL_POSITION_INT":
        readings.altitude_m = message.relative_alt / 1e3
    elif kind == "GPS_RAW_INT":
        readings.gps = now_s, f"{FIXES.get(message.fix_type, '3D')} {message.satellites_visible}"
    elif kind == "SYS_STATUS":
        # MAVLink's values for not known: -1 % and 65535 mV.
        percent = None if message.battery_remaining < 0 else float(message.battery_remaining)
        volts = None if message.voltage_battery == UNKNOWN_MV else message.voltage_battery / 1e3
        readings.battery = now_s, percent, volts


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def left_as(session: FollowSession, follower: FollowerState, now_s: float) -> tuple[str, bool]:
    """How a follower is left at the end; True: nobody has to take over."""
    height = "" if follower.altitude_m is None else f", {follower.altitude_m:.1f} m up"
    speed = f"{follower.ground_speed_mps:.1f} m/s"
    mode = "mode unknown" if follower.mode is None else mode_name(follower.mode)
    if not follower.in_guided:
        return f"left to its pilot ({mode}{height})", True
    if not follower.turn.flown:
        return f"was not moved ({mode}{height})", True
    silent_s = now_s - follower.position_at_s
    if silent_s > UNHEARD_S:
        return f"not confirmed stopped, no report for {silent_s:.0f} s: take over", False
    if session.guard is not None and session.guard.stands(follower.plan.system_id):
        return f"stopped, {mode}{height}, {speed}", True
    return f"not confirmed stopped, {mode}{height}, {speed}: take over", False
