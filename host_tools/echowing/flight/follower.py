"""What is known and wanted of one follower, every value with its time. Pure."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.alignment import STOPS_AFTER_S, History, Report
from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.drift import Drift
from echowing.flight.estimate import LONGEST_CARRY_S, Estimate, Tie
from echowing.flight.guidance import GuidedPoint, Horizontal, LeaderFix, Slot
from echowing.flight.handling import Handling
from echowing.flight.jumps import OwnJump, RangeMemory
from echowing.flight.leader_track import VehicleClock, changes_mps2, is_late
from echowing.flight.own_motion import OwnMotion
from echowing.flight.readings import Readings
from echowing.flight.steps import Allowed, Command, Hold, Phase, Standing, Turn
from echowing.flight.wind import Wind
from echowing.geo import GlobalPosition, displace
from echowing.mavlink.messages import heading_of

# ArduCopter's mode number.
GUIDED_MODE = 4
NOT_SEEN = Standing(Phase.WATCHED, "no report yet")
# Two reports further apart do not tell how the velocity changes now.
LONGEST_CHANGE_S = 0.5


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

    standing, allowed, command: what the last tick made of it (see `steps`); turn: what lasts until
    its pilot has left Guided; hold: where it is held; guided: where it was led last; in_guided:
    flies in Guided; position_at_s: when it was there by TIMESYNC, else when the report came;
    proven_m: the part of `Known.unsettled_m` that its sonar settled; reversal_m: the nearest slot
    from which it gets away if the leader turns round now; on_way_m: how far its slot is on the way
    into another shape (`reshape`); opens: it was said that the slot opens for a reversal; unsure:
    its newest report may be another vehicle's, with its id; slews: its filter has reset its
    position since its last point; away_beats: heartbeats in a row that were not of one that flies
    in Guided; level_m, levelled_at_s: by how much it flies higher than planned, to be level with
    its leader, and when that was set; worse_since_s: since when its sonar is worse than believed,
    and in what; heard_as: its sonar as it is heard, while that carries no slot as near as its own,
    and by_ear_m: the nearest slot then.
    """

    plan: FollowerPlan
    guide: Guide
    estimate: Estimate
    clock: VehicleClock = field(default_factory=VehicleClock)
    drift: Drift = field(default_factory=Drift)
    readings: Readings = field(init=False)
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

    def __post_init__(self) -> None:
        self.readings = Readings(self.estimate, self.clock)

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
        return self.clock.way_s

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
        self.readings.ranges = RangeMemory()
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
        self.readings.leaned(message, now_s)
        self.wind.leans(attitude_rad, self.velocity_mps, now_s)
