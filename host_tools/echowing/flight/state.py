"""What is known of the vehicles, every value with its time. Pure.

The first step of a tick: messages come in here, and every later step reads from here.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.alignment import STOPS_AFTER_S, History, Report
from echowing.flight.axis import Axis, axis_of
from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import Off, Wandering
from echowing.flight.drift import Drift
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.estimate import LONGEST_CARRY_S, Beside, Estimate, Tie, carried_on
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    Horizontal,
    LeaderFix,
    Slot,
    bearing_rad,
    is_stale,
    place_m,
    predicted,
)
from echowing.flight.handling import Handling, leader_brakes_mps2
from echowing.flight.homes import Homes
from echowing.flight.jumps import OwnJump, RangeMemory
from echowing.flight.leader_track import (
    LeaderTrack,
    VehicleClock,
    changes_mps2,
    is_late,
    report_of,
)
from echowing.flight.own_motion import OwnMotion
from echowing.flight.steps import Allowed, Command, Hold, Phase, Standing, Turn
from echowing.flight.tail import TailSlot
from echowing.flight.ties import Link, errors
from echowing.flight.tow_bar import TowBar
from echowing.flight.wind import Wind
from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.mavlink.messages import (
    FORWARD,
    gimbal_attitude,
    heading_of,
    is_forward_rangefinder,
    sonar_range_m,
)

# ArduCopter's mode number.
GUIDED_MODE = 4
# Two receivers, and two barometers, between which no sonar measures.
UNRANGED_SIGMA_M = math.sqrt(2.0) * Wandering().sigma_m
UNRANGED_UP_SIGMA_M = math.sqrt(2.0) * Wandering().height_sigma_m
# By their reports two vehicles may be so much further apart than in truth: 2.8 m by what receivers
# may be off (`SURE_SIGMAS`), 1.5 m by what they fly in a second, until the next report
# (`plan.JOIN_MPS`).
REPORTS_M = 4.3
NOT_SEEN = Standing(Phase.WATCHED, "no report yet")

# The co-processor's newest single reading (firmware/README.md). If none has come for so long (a
# signed link refuses it, as no autopilot signs it), DISTANCE_SENSOR is used.
SONAR_READING = "SNR_RAW"
RAW_FRESH_S = 1.0
# The co-processor averages over 0.45 s: its middle.
AVERAGE_AGE_S = 0.225
# What the autopilot has read itself is so old as it sends it, with the time of sending. A lidar's
# is up to 0.1 s old; a MaxBotix is read 0.1 s after its ping, and handed out up to 0.1 s later.
FIXED_AGE_S = 0.1
# Without a newer ATTITUDE its reading was taken along the heading, level.
NOSE_FRESH_S = 0.3
# Two reports further apart do not tell how the velocity changes now.
LONGEST_CHANGE_S = 0.5
# Of how far the one ahead is off its slot, so much counts for the next slot: 0.4 after four.
FLOWN_SHARE = 0.8
# A longer delay to the vehicle is not predicted: the leader may have turned by then.
LONGEST_WAY_S = 1.0

Say = Callable[[float, str], None]


@dataclass(slots=True)
class FollowerPlan:
    """One follower: its system id, its slot, its altitude above its home, and its sonar."""

    system_id: int
    slot: Slot
    altitude_m: float = 10.0
    sonar: SonarBelief = field(kw_only=True)

    @property
    def wanted_m(self) -> float:
        """Its altitude above its home, the slot's step included."""
        return self.altitude_m + self.slot.altitude_step_m


class Guide(Protocol):
    """Where a follower is to be: a `TowBar`, or anything that answers like one."""

    def update(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
        formation_mps: Horizontal | None = None,
    ) -> GuidedPoint:
        """See `TowBar.update`."""

    def place(self, slot: Slot, bar_m: float) -> None:
        """See `TowBar.place`."""


@dataclass(slots=True)
class FollowerState:
    """What is known and wanted of one follower.

    standing, allowed, command: what the last tick made of it (see `steps`); turn: what
    lasts until its pilot has left Guided; hold: where it is held; guided: where it was led last;
    in_guided: flies in Guided; position_at_s: when it was there by TIMESYNC, else when the report
    came; proven_m: the part of `Known.doubted_m` that the sonar has settled; reversal_m: the
    nearest slot from which it gets away if the leader turns round now; on_way_m: how far its slot
    is on the way into another shape (`reshape`); opens: it was said that the
    slot opens for a reversal; unsure: its newest report may be another vehicle's, with its id;
    slews: its filter has reset its position since its last point;
    away_beats: heartbeats in a row that were not of one that flies in Guided; level_m,
    levelled_at_s: by how much it flies higher than planned, to be level with its leader, and when
    that was set; nose: when it pointed where; sonar_id: the component that sends its sonar's
    readings; worse_since_s: since when its sonar is worse than believed, and in what; heard_as:
    its sonar as it is heard, while that carries no slot as near as its own, and by_ear_m: the
    nearest slot then.
    """

    plan: FollowerPlan
    guide: Guide
    estimate: Estimate
    clock: VehicleClock = field(default_factory=VehicleClock)
    drift: Drift = field(default_factory=Drift)
    ranges: RangeMemory = field(default_factory=RangeMemory)
    own_jump: OwnJump = field(default_factory=OwnJump)
    handling: Handling = field(default_factory=Handling)
    motion: OwnMotion = field(default_factory=OwnMotion)
    wind: Wind = field(default_factory=Wind)
    turn: Turn = field(default_factory=Turn)
    standing: Standing = NOT_SEEN
    allowed: Allowed | None = None
    command: Command | None = None
    hold: Hold | None = None
    unsure: bool = False
    slews: bool = False
    proven_m: Horizontal = (0.0, 0.0)
    reversal_m: float = 0.0
    on_way_m: float = 0.0
    opens: bool = False
    level_m: float = 0.0
    levelled_at_s: float = -math.inf
    raw_at_s: float = -math.inf
    nose: tuple[float, Axis] = (-math.inf, Axis(0.0))
    sonar_id: int | None = None
    position: GlobalPosition | None = None
    newest_boot_ms: int = -1
    position_at_s: float = -math.inf
    altitude_m: float | None = None
    velocity_mps: Horizontal = (0.0, 0.0)
    acceleration_mps2: Horizontal = (0.0, 0.0)
    ground_speed_mps: float = 0.0
    climb_mps: float = 0.0
    heading_rad: float = 0.0
    mode: int | None = None
    mode_at_s: float = -math.inf
    armed: bool = False
    flying: bool = False
    in_guided: bool = False
    away_beats: int = 2
    worse_since_s: dict[str, float] = field(default_factory=dict)
    heard_as: SonarBelief | None = None
    by_ear_m: float = 0.0
    guided: GuidedPoint | None = None
    _motions: dict[float, tuple[GlobalPosition, Horizontal]] = field(default_factory=dict)

    @property
    def opens_m(self) -> float:
        """The distance its slot has opened to; 0: it has not."""
        return self.least_m if self.least_m > self.plan.slot.radius_m else 0.0

    @property
    def least_m(self) -> float:
        """The least distance of its slot.

        For a leader that may turn round, on the way to it, or by a sonar that hears too little.
        """
        return max(self.reversal_m, self.on_way_m, self.by_ear_m)

    @property
    def slot(self) -> Slot:
        """Its slot as it is now, also on the way into another shape."""
        slot = self.plan.slot
        return slot if slot.radius_m >= self.on_way_m else replace(slot, radius_m=self.on_way_m)

    @property
    def doubted(self) -> bool:
        """Whether nobody may follow it, as it is held for good or its position jumps."""
        return self.turn.latched is not None or self.own_jump.since_s is not None

    @property
    def guided_mode(self) -> bool:
        """Whether it is in Guided, in the air or not."""
        return self.mode == GUIDED_MODE

    @property
    def way_s(self) -> float:
        """How long a point takes to its vehicle."""
        return min(LONGEST_WAY_S, self.clock.round_trip_s / 2.0)

    def then(self, at_s: float) -> GlobalPosition | None:
        """Where it is at a moment; None: not known."""
        if self.position is None or at_s - self.position_at_s > LONGEST_CARRY_S:
            return None
        return self._motion_at(at_s)[0]

    def straight_on(self, at_s: float) -> GlobalPosition | None:
        """As `then`, for one that its applet flies, whatever it is ordered."""
        if self.position is None or at_s - self.position_at_s > LONGEST_CARRY_S:
            return None
        since_s = max(0.0, at_s - self.position_at_s)
        north, east = self.velocity_mps
        return displace(self.position, (north * since_s, east * since_s, -self.climb_mps * since_s))

    @property
    def left_at(self) -> GlobalPosition | None:
        """Where one that has fallen silent in the air stands; None: not known, or it does not fly.

        Its applet stops it, as it gets no points either.
        """
        if self.position is None or not self.flying:
            return None
        north, east = self.velocity_mps
        return displace(self.position, (STOPS_AFTER_S * north, STOPS_AFTER_S * east, 0.0))

    def velocity_then(self, at_s: float) -> Horizontal:
        """How it flies at a moment, (north, east)."""
        return self.velocity_mps if self.position is None else self._motion_at(at_s)[1]

    def _motion_at(self, at_s: float) -> tuple[GlobalPosition, Horizontal]:
        """Place and velocity; cached, as each step of a tick asks for the same moments."""
        known = self._motions.get(at_s)
        if known is None:
            known = self._motions[at_s] = self._carried_on(at_s)
        return known

    def _carried_on(self, at_s: float) -> tuple[GlobalPosition, Horizontal]:
        assert self.position is not None
        since_s = at_s - self.position_at_s
        if since_s <= 0.0:
            return self.position, self.velocity_mps
        (north_m, east_m), velocity_mps = self.motion.carried_on(
            self.position, self.velocity_mps, self.position_at_s, at_s
        )
        place = displace(self.position, (north_m, east_m, -self.climb_mps * since_s))
        return place, velocity_mps

    def slewed(self) -> bool:
        """Whether its filter has reset its position since this was asked."""
        slews, self.slews = self.slews, False
        return slews

    def turn_to(self, tie: Tie, watched: History) -> None:
        """Let its sonar look at another vehicle."""
        self.estimate.turn_to(tie, watched)
        self.ranges = RangeMemory()
        self.proven_m = tie.proven_m
        if tie.off.level_sigma_m >= UNRANGED_SIGMA_M:
            self.turn.joined, self.turn.joins_at_s = False, math.inf

    def beat(self, heartbeat: Any, now_s: float, *, flying: bool) -> None:
        """Take a HEARTBEAT of its autopilot."""
        self.mode, self.mode_at_s, self.flying = heartbeat.custom_mode, now_s, flying
        self.armed = bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def ordered(self, allowed: Allowed, now_s: float) -> None:
        """Note that it is sent to a place now, at a velocity."""
        velocity_mps, arrives_s = allowed.velocity_mps or (0.0, 0.0), now_s + self.way_s
        self.motion.ordered(arrives_s, allowed.place, velocity_mps, self.handling.closing)
        self._motions.clear()

    def not_ordered(self) -> None:
        """Note that nothing goes to it now: it is flown by somebody else."""
        self.motion.forget()
        self._motions.clear()

    def on_arrival(self, now_s: float) -> GlobalPosition | None:
        """Where it is when what is sent now reaches it."""
        return self.then(now_s + self.way_s)

    def reported(self, message: Any, now_s: float) -> Report | None:
        """Take its GLOBAL_POSITION_INT; None: an older one has overtaken it."""
        if is_late(message.time_boot_ms, self.newest_boot_ms):
            return None
        if message.time_boot_ms < self.newest_boot_ms:
            self.clock.restarted()
            self.drift = Drift()
            self.estimate.history.clear()
            self.motion.forget()
        velocity_mps = message.vx / 100.0, message.vy / 100.0
        elapsed_s = (message.time_boot_ms - self.newest_boot_ms) / 1e3
        north_mps2, east_mps2 = changes_mps2(
            self.velocity_mps, velocity_mps, elapsed_s, LONGEST_CHANGE_S
        )
        self.acceleration_mps2 = north_mps2, east_mps2
        self.newest_boot_ms = message.time_boot_ms
        self._motions.clear()
        self.position = GlobalPosition(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3)
        self.position_at_s = self.clock.to_ours(message.time_boot_ms / 1e3, now_s)
        self.altitude_m = message.relative_alt / 1e3
        self.velocity_mps = velocity_mps
        self.ground_speed_mps = math.hypot(message.vx, message.vy) / 100.0
        self.climb_mps = -message.vz / 100.0
        self.heading_rad = heading_of(message, self.heading_rad)
        return Report(self.position_at_s, self.position, self.velocity_mps, self.heading_rad)

    def drifted(self, report: Report) -> Report:
        """The same report, with how far its receiver has drifted."""
        self.drift.reported(replace(report, time_s=self.newest_boot_ms / 1e3))
        return replace(report, drifted_m=self.drift.lately_m)

    def leaned(self, message: Any, now_s: float) -> None:
        """Take its ATTITUDE."""
        attitude_rad = message.roll, message.pitch, message.yaw
        self.nose = now_s, Axis(message.yaw, message.pitch)
        self.wind.leans(attitude_rad, self.velocity_mps, now_s)

    def ranged(self, kind: str, message: Any, now_s: float) -> None:
        """Take a message that may be its sonar's; single readings count before averages."""
        is_raw = kind == "NAMED_VALUE_FLOAT" and message.name == SONAR_READING
        if is_raw:
            self.raw_at_s = now_s
        if self.plan.sonar.fixed:
            self._ranged_by_autopilot(kind, message, now_s)
        elif is_raw:
            stamp_s = message.time_boot_ms / 1e3
            time_s = self.estimate.sonar_clock.to_ours(stamp_s, now_s, self.way_s)
            self.sonar_id = message.get_srcComponent()
            self._take_range(time_s, message.value, message.time_boot_ms)
        elif kind == "GIMBAL_DEVICE_ATTITUDE_STATUS":
            quaternion = gimbal_attitude(message)
            axis = None if quaternion is None else axis_of(quaternion)
            if axis is not None and message.get_srcComponent() == self.sonar_id:
                self.estimate.pointed(message.time_boot_ms, axis, now_s)
        elif (
            kind == "DISTANCE_SENSOR" and message.orientation == FORWARD and not self.is_read(now_s)
        ):
            self._take_range(now_s - self.way_s - AVERAGE_AGE_S, self._read_m(message))

    def _read_m(self, message: Any) -> float:
        """The range in a DISTANCE_SENSOR; the sonar's reach: it detects nothing."""
        reach_m = self.plan.sonar.reach_m
        range_m = sonar_range_m(message, reach_m)
        return reach_m if range_m is None else range_m

    def _ranged_by_autopilot(self, kind: str, message: Any, now_s: float) -> None:
        """Take a reading of the autopilot's own; one that is too near for its sensor is none."""
        own = message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
        if kind != "DISTANCE_SENSOR" or not own or not is_forward_rangefinder(message):
            return
        if message.current_distance >= message.min_distance:
            time_s = self.clock.to_ours(message.time_boot_ms / 1e3, now_s)
            stamp_ms, (seen_s, nose) = message.time_boot_ms, self.nose
            self._take_range(time_s - FIXED_AGE_S, self._read_m(message), stamp_ms)
            if now_s - seen_s < NOSE_FRESH_S:
                self.estimate.pointed(stamp_ms, nose, now_s)

    def is_read(self, now_s: float) -> bool:
        """Whether the co-processor's single readings come."""
        return now_s - self.raw_at_s <= RAW_FRESH_S

    def _take_range(self, time_s: float, range_m: float, stamp_ms: int | None = None) -> None:
        self.estimate.heard(time_s, range_m, stamp_ms)
        if 0.0 < range_m < self.plan.sonar.reach_m and self.estimate.is_believed:
            self.ranges.add(time_s, range_m)


# The followers of a way down from another, and of the way on up.
_Way = tuple[list[FollowerState], list[FollowerState]]


class Known:
    """The leader and its followers as they are known now."""

    def __init__(
        self,
        leader_id: int,
        plans: Iterable[FollowerPlan],
        settings: GuidanceSettings,
        homes: Homes | None = None,
    ) -> None:
        plans = list(plans)
        self.leader_id = leader_id
        self.settings = settings
        self.leader = LeaderTrack()
        self.leader_history = History()
        self.leader_mode: int | None = None
        self.homes = homes or Homes(leader_id)
        self.in_height = self.homes.in_height
        self.followers = {
            plan.system_id: FollowerState(
                plan,
                TowBar(plan.slot) if settings.tow_bar else TailSlot(plan.slot),
                Estimate(plan.sonar),
            )
            for plan in plans
        }
        place_guides(self.followers.values())
        self._ahead = {
            plan.system_id: self.followers[plans[plan.slot.behind].system_id]
            for plan in plans
            if plan.slot.behind is not None
        }
        self._ways: dict[tuple[int, int], _Way] = {}

    def clock(self, system_id: int) -> VehicleClock | None:
        """The clock of one of these vehicles; None: of a stranger."""
        if system_id == self.leader_id:
            return self.leader.clock
        follower = self.followers.get(system_id)
        return follower.clock if follower else None

    @property
    def leader_brakes_mps2(self) -> float:
        """How hard the leader may brake and turn round in its mode."""
        return leader_brakes_mps2(self.leader_mode)

    def leader_age_s(self, at_s: float) -> float:
        """How old the newest report of the leader is at a moment."""
        return math.inf if self.leader.fix is None else max(0.0, at_s - self.leader.fix.time_s)

    def leader_is_stale(self, now_s: float) -> bool:
        """Whether it is so old that nobody may be led by it."""
        return is_stale(self.leader_age_s(now_s), self.settings)

    def ahead_of(self, follower: FollowerState) -> FollowerState | None:
        """The follower that one's sonar looks at; None: it looks at the leader."""
        return self._ahead.get(follower.plan.system_id)

    def is_watched(self, follower: FollowerState) -> bool:
        """Whether another follower's sonar looks at it."""
        return bool(self.behind(follower))

    def behind(self, ahead: FollowerState | None) -> list[FollowerState]:
        """Those whose sonars look at a follower; None: at the leader."""
        return [one for one in self.followers.values() if self.ahead_of(one) is ahead]

    def watch(self, ahead: Mapping[int, FollowerState | None]) -> None:
        """Let followers' sonars look at these vehicles, by follower; None: the leader.

        What the sonars between a follower and that vehicle have told of the receivers stays known.
        """
        changed = {
            system_id: one
            for system_id, one in ahead.items()
            if one is not self.ahead_of(self.followers[system_id])
        }
        ties = {
            system_id: self._tie(self.followers[system_id], one)
            for system_id, one in changed.items()
        }
        for system_id, one in changed.items():
            self._ahead.pop(system_id, None)
            if one is not None:
                self._ahead[system_id] = one
            self.followers[system_id].turn_to(ties[system_id], self._history_of(one))
        if changed:
            self._ways.clear()

    def _tie(self, follower: FollowerState, other: FollowerState | None) -> Tie:
        """What is known of a follower's and another one's receivers; other None: the leader's."""
        mine, its = list(self.chain(follower)), list[FollowerState]()
        if other is not None:
            mine, its = self._way_between(follower, other)
        of_mine, of_its = ([one.estimate.offset.off for one in way] for way in (mine, its))
        off = _off(of_mine, of_its)
        if off.level_sigma_m >= UNRANGED_SIGMA_M:
            off = off._replace(north_m=0.0, east_m=0.0, level_sigma_m=UNRANGED_SIGMA_M)
        off = off._replace(up_sigma_m=min(UNRANGED_UP_SIGMA_M, off.up_sigma_m))
        jumped = _summed(*([one.estimate.jumped_m for one in way] for way in (mine, its)))
        proven = _summed(*([one.proven_m for one in way] for way in (mine, its)))
        return Tie(off, (jumped[0], jumped[1]), (proven[0], proven[1]))

    def expect(self, follower: FollowerState) -> None:
        """Begin the search for whom its sonar looks at with what the others' sonars tell."""
        offset, links = follower.estimate.offset, self._links()
        if not links:
            return
        found = errors([self.leader_id, *self.followers], links, Wandering().sigma_m)
        own_id, its_id = follower.plan.system_id, self.watched_id(follower)
        north_m, east_m, sigma_m = found.between(its_id, own_id)
        offset.turn_to(Off(north_m, east_m, offset.up_m, sigma_m, offset.up_sigma_m))

    def _links(self) -> list[Link]:
        """What each sonar tells that has heard whom it looks at."""
        offsets = [(one, one.estimate.offset) for one in self.followers.values()]
        return [
            Link(
                one.plan.system_id,
                self.watched_id(one),
                offset.north_m,
                offset.east_m,
                offset.level_sigma_m,
            )
            for one, offset in offsets
            if offset.has_heard
        ]

    def take(self, slots: Mapping[int, Slot]) -> None:
        """Give followers these slots, by system id; a slot is `behind` a follower's number.

        A slot on its way into another shape has its radius there (see `FollowerState.slot`).
        """
        everybody = list(self.followers.values())
        for system_id, slot in slots.items():
            self.followers[system_id].plan.slot = slot
        self.watch(
            {
                system_id: None if slot.behind is None else everybody[slot.behind]
                for system_id, slot in slots.items()
            }
        )
        place_guides(everybody)

    def move_up(self, line: Sequence[FollowerState]) -> None:
        """Give each of a line the slot of the one before it, and the first one the last one's.

        A slot is behind the same other slot as before, whoever flies there.
        """
        takes = {
            had.plan.system_id: has for had, has in zip(line, (*line[1:], line[0]), strict=True)
        }
        numbers = {system_id: number for number, system_id in enumerate(self.followers)}
        slots = {}
        for system_id, had in self.followers.items():
            one = takes.get(system_id, had)
            ahead = self.ahead_of(had)
            ahead = ahead and takes.get(ahead.plan.system_id, ahead)
            behind = None if ahead is None else numbers[ahead.plan.system_id]
            slots[one.plan.system_id] = replace(had.plan.slot, behind=behind)
        self.take(slots)

    def chain(self, follower: FollowerState) -> Iterator[FollowerState]:
        """A follower, the one its sonar looks at, and so on up to the one behind the leader."""
        one: FollowerState | None = follower
        while one is not None:
            yield one
            one = self.ahead_of(one)

    def as_seen_by(self, follower: FollowerState, place: GlobalPosition) -> GlobalPosition:
        """A place by the leader's receiver in a follower's frame."""
        if not self.settings.learn_offset:
            return place
        for one in self.chain(follower):
            place = one.estimate.as_seen(place)
        return place

    def seen_by(self, follower: FollowerState, fix: LeaderFix) -> LeaderFix:
        """A report of the leader in this follower's frame."""
        return replace(fix, position=self.as_seen_by(follower, fix.position))

    def watched_then(self, follower: FollowerState, at_s: float) -> LeaderFix | None:
        """The vehicle its sonar looks at, at a moment, in its frame; None: nothing is known."""
        ahead = self.ahead_of(follower)
        if ahead is None:
            return self.leader_then(follower, at_s)
        there = ahead.then(at_s)
        if there is None:
            return None
        if self.settings.learn_offset:
            there = follower.estimate.as_seen(there)
        velocity = (*ahead.velocity_then(at_s), -ahead.climb_mps)
        return LeaderFix(ahead.position_at_s, there, velocity, ahead.heading_rad)

    def followed_then(self, follower: FollowerState, fix: LeaderFix, at_s: float) -> LeaderFix:
        """What its slot is behind, at a moment, in its frame: the leader, or another slot.

        That slot's velocity, so that nobody amplifies another's; nearly the place of who flies in
        it, as its sonar sees that one: a step from one to the other, where the sonar loses him, is
        flown with full lean.
        """
        ahead = self.ahead_of(follower)
        if ahead is None:
            then = self.leader_then(follower, at_s) if self.settings.predict else None
            return then or self.seen_by(follower, fix)
        place, velocity_mps, heading_rad = _slot_then(ahead, at_s)
        if place is None:
            return self.watched_then(follower, at_s) or self.seen_by(follower, fix)
        place = _towards(place, ahead.then(at_s))
        place = place._replace(alt_m=place.alt_m - ahead.plan.slot.altitude_step_m)
        if self.settings.learn_offset:
            place = follower.estimate.as_seen(place)
        return LeaderFix(fix.time_s, place, (*velocity_mps, 0.0), heading_rad)

    def formation_mps(self, fix: LeaderFix, at_s: float) -> Horizontal | None:
        """The leader's velocity at a moment, (north, east); None: it has one follower only."""
        if len(self.followers) == 1:
            return None
        return carried_on(fix, at_s).velocity_ned_mps[:2]

    def apart(
        self, follower: FollowerState, other: FollowerState, there: GlobalPosition
    ) -> tuple[GlobalPosition, float]:
        """Where another follower's own report `there` is in this one's frame.

        And the standard deviation of that. What sonars know of the receivers on the way from one to
        the other, over those that they look at, is used where it is more than is known without.
        """
        if not self.settings.learn_offset:
            return there, UNRANGED_SIGMA_M
        mine, its = self._way_between(follower, other)
        sigma_m = self.sigma_m((*mine, *its))
        if sigma_m >= UNRANGED_SIGMA_M:
            return there, UNRANGED_SIGMA_M
        north_m, east_m = _summed(*([one.estimate.shift_m for one in way] for way in (its, mine)))
        return displace(there, (north_m, east_m, 0.0)), sigma_m

    def _way_between(self, follower: FollowerState, other: FollowerState) -> _Way:
        """Over whose sonars it goes: up to what both chains share, this one's and the other's."""
        ends = follower.plan.system_id, other.plan.system_id
        if ends not in self._ways:
            mine, its = (
                {one.plan.system_id: one for one in self.chain(end)} for end in (follower, other)
            )
            self._ways[ends] = (
                [one for system_id, one in mine.items() if system_id not in its],
                [one for system_id, one in its.items() if system_id not in mine],
            )
        return self._ways[ends]

    def _beside(self, follower: FollowerState) -> Iterator[Beside]:
        """The vehicles near a follower that its sonar may hear instead of whom it looks at."""
        ahead, fix = self.ahead_of(follower), self.leader.fix
        if fix is None:
            return
        if ahead is not None and _may_hear(follower, fix.position):
            off = _off((), [one.estimate.off for one in self.chain(ahead)])
            yield Beside(self.leader_id, self.leader_history, off)
        for other in self.followers.values():
            there = other.position
            if other is follower or other is ahead or there is None:
                continue
            if not _may_hear(follower, there):
                continue
            mine, its = self._way_between(follower, other)
            # Of one behind this follower its own sonar tells, not this one's.
            links = [one for one in mine if one is not follower]
            yield Beside(
                other.plan.system_id,
                other.estimate.history,
                _off(*([one.estimate.off for one in way] for way in (its, links))),
                moves=len(links) < len(mine),
            )

    def sigma_m(self, links: Iterable[FollowerState]) -> float:
        """Standard deviation of what is known over the sonars of these followers."""
        return math.sqrt(sum(one.estimate.offset.level_sigma_m**2 for one in links))

    def leader_sigma_m(self, follower: FollowerState) -> float:
        """The same of where it sees the leader: no more than receivers alone leave."""
        return min(UNRANGED_SIGMA_M, self.sigma_m(self.chain(follower)))

    def leader_then(self, follower: FollowerState, at_s: float) -> LeaderFix | None:
        """The leader at a moment, in this follower's frame; None: nothing is known of it."""
        fix = self.leader.fix
        if fix is None or self.leader_age_s(at_s) > LONGEST_CARRY_S:
            return None
        return carried_on(self.seen_by(follower, fix), at_s)

    def leader_for(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GlobalPosition:
        """Where the leader is now, in the frame of this follower's receiver."""
        now = predicted(fix, max(0.0, now_s - fix.time_s)).position
        return self.as_seen_by(follower, now)

    def watched_id(self, follower: FollowerState) -> int:
        """The system that its sonar looks at."""
        ahead = self.ahead_of(follower)
        return self.leader_id if ahead is None else ahead.plan.system_id

    def watched_now(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        """Where whom its sonar looks at is, in its frame; None: not known, or no more."""
        fix = self.leader.fix
        if self.ahead_of(follower) is not None:
            watched = self.watched_then(follower, now_s)
            return None if watched is None else watched.position
        if fix is None or self.leader_is_stale(now_s):
            return None
        return self.leader_for(follower, fix, now_s)

    def bearing_of_watched(self, follower: FollowerState, now_s: float) -> float | None:
        """Bearing from a follower to whom its sonar looks at; None: one of them is not known."""
        watched, here = self.watched_then(follower, now_s), follower.then(now_s)
        return None if watched is None or here is None else bearing_rad(here, watched.position)

    def watched_above_m(self, follower: FollowerState) -> float:
        """How much higher than a follower the one its sonar looks at is; 0: that is not known."""
        ahead, here = self.ahead_of(follower), follower.position
        fix = self.leader.fix
        there = ahead.position if ahead is not None else None if fix is None else fix.position
        if there is None or here is None:
            return 0.0
        above = self.in_height(self.watched_id(follower), there)
        return above.alt_m - self.in_height(follower.plan.system_id, here).alt_m

    def nearest_m(self, follower: FollowerState, to_it_m: Horizontal, clear_m: float) -> float:
        """How near a follower may come to whom its sonar looks at (`Cloud.nearest_m`).

        to_it_m: (north, east) from the follower.
        """
        above_m = self.watched_above_m(follower)
        return follower.estimate.offset.nearest_m(to_it_m, above_m, clear_m)

    def nearer_m(self, follower: FollowerState, to_it_m: Horizontal, clear_m: float) -> float:
        """By how much whom its sonar looks at may be nearer than it is believed."""
        return max(0.0, self.nearest_m(follower, to_it_m, clear_m) - clear_m)

    def seen(
        self,
        follower: FollowerState,
        here: GlobalPosition,
        other: FollowerState,
        there: GlobalPosition,
        clear_m: float,
    ) -> tuple[GlobalPosition, float]:
        """Where another follower is in this one's frame; by how much it may be nearer than that."""
        seen, sigma_m = self.apart(follower, other, there)
        unsure_m = SURE_SIGMAS * sigma_m
        north_m, east_m, _ = ned_between(here, seen)
        if self.ahead_of(follower) is other:
            unsure_m = min(unsure_m, self.nearer_m(follower, (north_m, east_m), clear_m))
        elif self.ahead_of(other) is follower:
            unsure_m = min(unsure_m, self.nearer_m(other, (-north_m, -east_m), clear_m))
        return seen, unsure_m

    def from_it_m(
        self, system_id: int, there: GlobalPosition, follower: FollowerState, here: GlobalPosition
    ) -> Ned:
        """From another vehicle to a follower that is here, heights by what is known of homes."""
        mine = self.in_height(follower.plan.system_id, here)
        return ned_between(self.in_height(system_id, there), mine)

    def least_room_m(
        self, follower: FollowerState, clear_m: float, now_s: float
    ) -> tuple[FollowerState, float, float] | None:
        """The other follower that is least certain to leave room, of those whose place is known.

        How far away it is, heights included, and by how much it may be nearer. None: there is none.
        """
        here = follower.then(now_s)
        found: list[tuple[FollowerState, float, float]] = []
        for other in self.followers.values():
            there = other.then(now_s) or other.left_at
            if other is follower or here is None or there is None:
                continue
            seen, unsure_m = self.seen(follower, here, other, there, clear_m)
            from_it_m = self.from_it_m(other.plan.system_id, seen, follower, here)
            found.append((other, math.hypot(*from_it_m), unsure_m))
        return min(found, key=lambda one: one[1] - one[2], default=None)

    def doubted_m(self, follower: FollowerState) -> Horizontal:
        """How far off a follower sees its leader, (north, east), if all jumps were errors.

        The jumps of both receivers, less those that the sonar has settled.
        """
        north, east = (-axis_m for axis_m in self.leader.total_m)
        north, east = north + follower.own_jump.total_m[0], east + follower.own_jump.total_m[1]
        for one in self.chain(follower):
            (known_north, known_east), (north_m, east_m) = one.estimate.jumped_m, one.proven_m
            north, east = north + known_north - north_m, east + known_east - east_m
        return north, east

    def feel_wind(self, follower: FollowerState, now_s: float) -> None:
        """How hard a follower can brake in this wind, on its way to the leader."""
        bearing = self.bearing_of_watched(follower, now_s)
        if bearing is not None:
            handling = follower.handling
            leaves_mps2 = follower.wind.leaves_mps2(bearing, handling.lean_max_rad)
            handling.wind_leaves_mps2 = leaves_mps2

    def note_leader(self, fix: LeaderFix) -> None:
        """Keep a new report of the leader, and let every estimate learn from it."""
        place = self.in_height(self.leader_id, fix.position)
        drifted_m = self.leader.drift.lately_m
        self.leader_history.add(replace(report_of(fix), position=place, drifted_m=drifted_m))
        if self.settings.learn_offset:
            for follower in self.followers.values():
                watched = self._history_of(self.ahead_of(follower))
                follower.estimate.learn(watched, list(self._beside(follower)))

    def _history_of(self, follower: FollowerState | None) -> History:
        """A follower's reports; None: the leader's."""
        return self.leader_history if follower is None else follower.estimate.history


def place_guides(followers: Iterable[FollowerState]) -> None:
    """Hang each follower's slot, as it is now, on its bar.

    In a line each bar turns as its slot comes to the corner. Side by side they turn as one body, as
    long as the whole formation: on shorter ones those on the inside of a corner would fly back.
    """
    followers = list(followers)
    slots = [one.plan.slot for one in followers]
    in_line = all(one.angle_rad == 0.0 for one in slots)
    body_m = max(math.hypot(*place_m(slots, number)[:2]) for number in range(len(slots)))
    for one, slot in zip(followers, slots, strict=True):
        beside_m = (other.radius_m for other in slots if other.behind == slot.behind)
        one.guide.place(slot, max(beside_m) if in_line else body_m)


def _may_hear(follower: FollowerState, there: GlobalPosition) -> bool:
    """Whether its sonar may reach a vehicle that reports to be there."""
    here, sonar = follower.position, follower.plan.sonar
    if here is None:
        return False
    return math.hypot(*ned_between(here, there)[:2]) < sonar.reach_m + sonar.inset_m + REPORTS_M


def _off(over: Sequence[Off], back_over: Sequence[Off]) -> Off:
    """What the ends of a way over sonars disagree by: up over some, down again over others."""
    north_m, east_m, up_m, _, _ = _summed(over, back_over)
    offs = (*over, *back_over)
    level_sigma_m = math.hypot(*(off.level_sigma_m for off in offs))
    return Off(north_m, east_m, up_m, level_sigma_m, math.hypot(*(off.up_sigma_m for off in offs)))


def _summed(over: Iterable[Sequence[float]], back_over: Iterable[Sequence[float]]) -> list[float]:
    """What sonars tell on the way up, less what they tell on the way down, value by value."""
    told = [*over, *([-value for value in one] for one in back_over)]
    return [math.fsum(one) for one in zip(*told, strict=True)]


def _towards(slot: GlobalPosition, there: GlobalPosition | None) -> GlobalPosition:
    """A slot moved most of the way to who flies in it: not all, or the last of a line swings."""
    if there is None:
        return slot
    north_m, east_m, _ = ned_between(slot, there)
    return displace(slot, (FLOWN_SHARE * north_m, FLOWN_SHARE * east_m, 0.0))


def _slot_then(
    follower: FollowerState, at_s: float
) -> tuple[GlobalPosition | None, Horizontal, float]:
    """Where a follower's slot is at a moment, its velocity, and the bearing of its bar."""
    if follower.hold is not None:
        return follower.hold.place, (0.0, 0.0), follower.heading_rad
    guided = follower.guided
    if guided is None:
        return None, (0.0, 0.0), 0.0
    since_s = at_s - guided.at_s
    north, east = guided.slot_mps
    place = displace(guided.slot, (north * since_s, east * since_s, 0.0))
    return place, guided.slot_mps, guided.course_rad
