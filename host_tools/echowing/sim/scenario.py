"""Scenarios: what is flown, as TOML, checked before anything moves."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from echowing.applets import FORMAT, HOLD, SPEED
from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.flight.build_up import LEAST_DIST_M, MOST_DIST_M
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import check_formation
from echowing.flight.guidance import GRAY, SMALLEST_RADIUS_M, GuidanceSettings, Slot
from echowing.flight.reshape import check_changes
from echowing.flight.swarm_rules import Weights
from echowing.paths import SHIPPED_SONAR
from echowing.section import NotNegative, Positive, Section, Share, section_of
from echowing.setup.applet import applet_path, parameters_in
from echowing.sim.fault_section import LEADER_FAULTS, FaultSection, objection
from echowing.sim.named_parameters import objections
from echowing.sim.own_plan import FUNCTION, OWN_PLAN, OwnPlan
from echowing.sim.vehicle.parameters import Generation
from echowing.sim.world.cutter import ByteLoss
from echowing.sim.world.radio import RadioSettings
from echowing.sonar_file import HalfAngle, SonarFile, load_sonar
from echowing.tool.formation_file import FormationSection

# What the applets do: the speed applet's laws with their numbers (lua/echowing_speed.md), and what
# the other one does (lua/echowing.md).
SPEED_LAWS = {"thesis": 0, "bands": 1}
LAWS = (*SPEED_LAWS, "hold")
MOST_OF_A_SWARM = 50
OWN_LAW = ".lua"  # how the name of a user's applet ends
LeaderPath = Literal[
    "rectangle", "circle", "figure-eight", "stop-and-go", "script", "walk", "track"
]


class LeaderEvent(Section):
    """Something the leader does, from `at_s` on.

    `auto`: its mission; `goto`: Auto to `point_ned_m` at `speed_mps`, braking and turning as Auto
    does; `fly`: at `velocity_ned_mps` with heading `yaw_deg`, at once; `at_follower`: at
    `speed_mps` straight at where the first follower then is, and on; `hold`: stop; `gps_jump`: its
    position is off by `jump_ned_m`; `silent`: its radio is dead; `heard`: radio and GPS work again.
    """

    at_s: NotNegative
    """When, seconds after the start."""
    act: Literal["auto", "goto", "fly", "at_follower", "hold", "gps_jump", "silent", "heard"]
    """What it does."""
    label: str = ""
    """Name of this part in the results; without one that of the act."""
    velocity_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of `fly`: north, east, down."""
    yaw_deg: float | None = None
    """Of `fly`: heading; none: as it is."""
    point_ned_m: tuple[float, float, float] = (0.0, 0.0, -10.0)
    """Of `goto`: north, east, down of the start."""
    speed_mps: Positive = 1.0
    """Of `goto` and `at_follower`."""
    jump_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of `gps_jump`: north, east, down."""


class LeaderSection(Section):
    """The leader's path: an Auto mission, a script, a walk, or a recorded track."""

    path: LeaderPath = "rectangle"
    """What it flies: a mission in Auto, a `script`, a `walk` in a hand, or a recorded `track`."""
    north_m: Positive = 60.0
    """Rectangle: length to the north."""
    east_m: Positive = 40.0
    """Rectangle: length to the east."""
    radius_m: Positive = 20.0
    """Circle and figure-eight."""
    speed_mps: Positive = 2.0
    """Its speed in Auto, or carried."""
    altitude_m: Positive = 10.0
    """Height above home."""
    start_s: NotNegative = 5.0
    """When it sets out."""
    laps: Annotated[int, Field(ge=1)] = 3
    """How often round."""
    track: Path | None = None
    """Of `track`: a CSV with time_s, north_m, east_m, down_m (and yaw_rad), or a .tlog."""
    target: Literal["foil", "stock"] = "foil"
    """What the sonar sees: legs with `foil`, or `stock` legs (thesis Table 5)."""
    script: tuple[LeaderEvent, ...] = ()
    """Of `script`: its events, `[[leader.script]]`."""

    @model_validator(mode="after")
    def _complete(self) -> "LeaderSection":
        if self.path == "track" and self.track is None:
            raise ValueError("path 'track' needs `track`, a CSV or .tlog file")
        if self.path == "script" and not self.script:
            raise ValueError("path 'script' needs at least one [[leader.script]] event")
        return self


_OURS = GuidanceSettings()


class GuidanceSection(Section):
    """How guided points are made; see `echowing.flight.guidance.GuidanceSettings`."""

    rate_hz: Annotated[float, Field(gt=0.0, le=20.0)] = 8.0
    """Points per second."""
    telemetry_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 4.0
    """Positions of the leader per second."""
    lead_time_s: NotNegative | None = None
    """Of points without a velocity: they run ahead of the slot by so much of the leader's speed;
    none: 1.4, with `gray` 1."""
    predict: bool = _OURS.predict
    """Carry the leader on over the age of its report."""
    clearance_m: NotNegative = _OURS.clearance_m
    """No slot and no point is nearer to the leader."""
    face_leader: bool = _OURS.face_leader
    """The follower's nose points at the leader."""
    learn_offset: bool = _OURS.learn_offset
    """Learn from the sonar how far the receivers disagree."""
    feed_forward: bool = _OURS.feed_forward
    """Points carry the slot's velocity, and no lead."""
    fresh_age_s: Positive | None = _OURS.fresh_age_s
    """Of points without a velocity: age of the leader's report from which the lead shrinks."""
    stale_age_s: Positive | None = _OURS.stale_age_s
    """Age beyond which the follower stops."""
    gray: bool = False
    """Points as the thesis made them (Gray's scheme), without any of these protections."""

    def settings(self) -> GuidanceSettings:
        """The same for the guidance."""
        if self.gray:
            return GRAY if self.lead_time_s is None else replace(GRAY, lead_time_s=self.lead_time_s)
        return GuidanceSettings(
            lead_time_s=_OURS.lead_time_s if self.lead_time_s is None else self.lead_time_s,
            predict=self.predict,
            clearance_m=self.clearance_m,
            face_leader=self.face_leader,
            learn_offset=self.learn_offset,
            feed_forward=self.feed_forward,
            fresh_age_s=self.fresh_age_s,
            stale_age_s=self.stale_age_s,
        )


class SonarSection(Section):
    """The sonars: what the product believes of them, and what they are.

    Each follower's is drawn anew for each seed around what the sonar file says. The keys that have
    a default of none set a value for all of them instead.
    """

    file: str = SHIPPED_SONAR
    """What the product believes of them: a sonar by name, or a sonar file (.toml)."""
    spread: NotNegative = 1.0
    """How far they are drawn around the file: 1: as far as it says; 0: all are the middle of it."""
    heard_share: Share | None = None
    """Share of the pings that hear a leader within the beam."""
    deaf_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of the time in which nothing at all is heard, in bursts."""
    deaf_s: Positive = 1.0
    """How long such a burst lasts on average."""
    beam_near_deg: HalfAngle | None = None
    """Half angle of the beam up to 2 m."""
    beam_far_deg: HalfAngle | None = None
    """Half angle of it at 4.6 m and beyond; none, with `beam_near_deg`: the same."""
    noise_m: NotNegative | None = None
    """Standard deviation of a range."""
    wild_share: Share | None = None
    """Share of the readings that are anything at all."""
    late_share: Share | None = None
    """Share of the readings that are an echo of the ping before, off something far away; none: as
    drawn, and among the wild ones."""
    tone_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of the time in which a stranger's sonar is heard: then a range is anything at all."""
    heard_to_m: Positive | None = None
    """How far a leader is heard, whatever its legs."""
    inset_m: Annotated[float, Field(ge=0.1)] | None = None
    """How much less than the separation they read."""


class GpsSection(Section):
    """What receivers and barometers err by: errors that wander (first-order Gauss-Markov).

    ArduCopter reports its height, and flies by it, as its barometer has it (EK3_SRC1_POSZ 1); the
    receiver's own height is in GPS_RAW_INT. With EK3_SRC1_POSZ 3 a follower flies by that. Each
    vehicle's errors are drawn anew for each seed around what stands here. A part of how a place
    wanders shows in the velocity that the vehicle reports and flies by, as EKF3's does. What public
    recordings say of like receivers: RESULTS.md, "Like receivers side by side".
    """

    sigma_m: NotNegative = 0.8
    """Standard deviation of the position, per horizontal axis."""
    tau_s: Positive = 60.0
    """Correlation time of it."""
    vertical_sigma_m: NotNegative = 0.5
    """Standard deviation of the height that the vehicle reports and flies by."""
    vertical_tau_s: Positive = 60.0
    """Correlation time of it."""
    receiver_vertical_sigma_m: NotNegative = 1.6
    """Standard deviation of the receiver's own height: about twice a horizontal axis (13 m against
    8 m at 95 %, GPS SPS Performance Standard, 2020)."""
    velocity_sigma_mps: NotNegative = 0.05
    """Standard deviation of the velocity that the receiver tells, per horizontal axis."""
    follows_s: Positive = 1.5
    """How much later the position that it reports and flies by follows its receiver: EKF3's, on
    ArduCopter SITL."""
    height_follows_s: Positive = 2.8
    """How much later the height that it reports and flies by follows its barometer: likewise."""
    spread: NotNegative = 0.25
    """Standard deviation, as a share, of how far these eight are off in each vehicle; 0: not."""
    step_m: NotNegative = 0.0
    """Standard deviation of a step per horizontal axis, as another satellite counts."""
    step_every_s: Positive = 30.0
    """How often such a step comes, on average; it fades with `tau_s`."""
    multipath_m: NotNegative = 0.0
    """Standard deviation per horizontal axis of what comes and goes beside the slow drift."""
    multipath_s: Positive = 10.0
    """Correlation time of that."""


class WindSection(Section):
    """Wind that copters fly in; see `echowing.sim.world.wind.Wind`.

    `direction_deg` is where it comes from, as SIM_WIND_DIR. The default turbulence is what
    MIL-F-8785C has at 10 m for the mean wind, whatever that is.
    """

    speed_mps: NotNegative = 0.0
    """Mean wind; 0: none, and no gusts."""
    direction_deg: float = 0.0
    """Where it comes from."""
    turbulence: Share = 0.19
    """Standard deviation of the gusts, as a share of the mean wind."""


PacketBytes = Annotated[int, Field(ge=1, le=1000)]


class LossySection(Section):
    """What a link does to the bytes on it, both ways alike (see `echowing.sim.world.cutter`)."""

    byte_loss: Share = 0.0
    """Share of the packets lost, which are cut from the bytes anywhere; with `--serve`, too."""
    packet_bytes: tuple[PacketBytes, PacketBytes] = (20, 80)
    """Of `byte_loss` and `flip`: least and most bytes of a packet."""
    flip: Share = 0.0
    """Share of those packets that arrive with one wrong bit."""

    @field_validator("packet_bytes")
    @classmethod
    def _rises(cls, least_most: tuple[int, int]) -> tuple[int, int]:
        if least_most[0] > least_most[1]:
            raise ValueError("the least first, then the most")
        return least_most

    def byte_settings(self) -> ByteLoss:
        """The same for the model of the bytes."""
        return ByteLoss(self.byte_loss, self.packet_bytes, self.flip)


class WireSection(LossySection):
    """The wire between a follower's autopilot and its co-processor."""


class RadioSection(LossySection):
    """One link, both ways alike."""

    latency_s: NotNegative = 0.0
    """Delay."""
    jitter_s: NotNegative = 0.0
    """Random delay on top, up to this."""
    loss: Share = 0.0
    """Share of the MAVLink frames lost, whole ones."""
    bandwidth_bytes_ps: Positive | None = None
    """Bytes per second; none: no limit."""
    reorder: Share = 0.0
    """Share of the frames that arrive late."""
    reorder_s: NotNegative = 0.3
    """How much later."""
    duplicate: Share = 0.0
    """Share of the frames that arrive twice."""

    @property
    def frames_lost(self) -> float:
        """Share of the frames that do not arrive: most lie in two of the packets that are cut."""
        return 1.0 - (1.0 - self.loss) * ((1.0 - self.byte_loss) * (1.0 - self.flip)) ** 2

    def settings(self) -> RadioSettings:
        """The same for the radio model."""
        return RadioSettings(**self.model_dump(exclude=set(LossySection.model_fields)))


class LeaderRadioSection(RadioSection):
    """The leader's link, both ways alike. Its telemetry comes late (thesis 4.2.3, Gray)."""

    latency_s: NotNegative = 0.46
    """Delay."""


class FollowerRadioSection(RadioSection):
    """Each follower's link, both ways alike."""

    latency_s: NotNegative = 0.05
    """Delay."""


class RadiosSection(Section):
    """The radio links."""

    leader: LeaderRadioSection = LeaderRadioSection()
    """The leader's link."""
    follower: FollowerRadioSection = FollowerRadioSection()
    """Each follower's link."""


class FollowerSection(Section):
    """The followers' autopilots."""

    generation: Literal["4.5", "4.6", "4.7", "4.8"] = "4.8"
    """Which ArduCopter flies them."""
    speed_mps: Positive = 5.0
    """`WP_SPD` (before 4.7 `WPNAV_SPEED`)."""
    target: Literal["foil", "stock"] = "stock"
    """What another follower's sonar sees: as `leader.target`."""
    parameters: dict[str, float] = Field(default={})
    """Parameters of the autopilots by name."""

    def autopilot_generation(self) -> Generation:
        """Which ArduCopter."""
        return Generation(self.generation)


class AirframeSection(Section):
    """How the vehicles differ from SITL's quad, as factors."""

    mass: Positive = 1.0
    """Of the airframe."""
    drag: Positive = 1.0
    """Of the airframe."""
    lag: Positive = 1.0
    """Of the time from a wanted lean to the lean, and of the motors'."""
    gain: Positive = 1.0
    """Of the velocity controller: PSC_NE_VEL_P, I and D."""


class WallSection(Section):
    """A wall across the follower's way (thesis 4.2.2)."""

    distance_m: Positive = 20.0
    """From the start to the wall."""
    target_behind_m: NotNegative = 5.0
    """From the wall to the commanded point."""
    speed_mps: Positive = 2.0
    """`WP_SPD` of the follower."""
    altitude_m: Positive = 2.0
    """Height above home."""


_RULES = Weights()
_NUMBERS = tuple(one.name for one in fields(Weights))


class SwarmSection(Section):
    """Followers without slots, led by weighted rules, not a formation ([page](SWARM.md))."""

    followers: Annotated[int, Field(ge=0, le=MOST_OF_A_SWARM)] = 0
    """How many; 0: there is a formation, and no swarm."""
    scatter_m: Positive = 6.0
    """At the start neighbours are so far apart and more, anywhere behind the leader."""

    align: Share = _RULES.align
    """Share of the towed centre's velocity in a follower's own; the rest is its neighbours'."""
    towards_per_s: NotNegative = _RULES.towards_per_s
    """Weight of `cluster towards`: to the middle of the neighbours."""
    away_per_s: NotNegative = _RULES.away_per_s
    """Weight of `cluster away`: from who is, or may be, too near."""
    attract_per_s: NotNegative = _RULES.attract_per_s
    """Weight of `attract`: to the swarm's place behind the leader."""
    repel_per_s: NotNegative = _RULES.repel_per_s
    """Weight of `repel`: from a leader nearer than `near_m`."""
    evade_per_s: NotNegative = _RULES.evade_per_s
    """Weight of `evade`: aside from who comes too near within `evade_s`."""
    switch: Annotated[float, Field(ge=1.0)] = _RULES.switch
    """By so much more `towards_per_s` counts while the swarm may split; 1: it does not change."""
    near_m: Annotated[float, Field(ge=SMALLEST_RADIUS_M)] = _RULES.near_m
    """Nobody wants to be nearer to anybody; the applets' `ECHO_DIST`."""
    apart_m: Positive = _RULES.apart_m
    """Nor for certain nearer than this."""
    room_m: Positive = _RULES.room_m
    """Between neighbours, about: from it follows how far behind the leader the centre is."""
    sees_m: Positive = _RULES.sees_m
    """Who is further away is no neighbour."""
    evade_s: NotNegative = _RULES.evade_s
    """How far ahead a meeting is foreseen."""
    most_mps: Positive = _RULES.most_mps
    """All rules but `align` together, at most."""
    draws_mps: Positive = _RULES.draws_mps
    """What draws together, `cluster towards` and `attract`, at most."""
    eases_mps2: Positive = _RULES.eases_mps2
    """How fast what the rules add may change."""

    def weights(self) -> Weights:
        """The same for the rules."""
        return Weights(**{name: getattr(self, name) for name in _NUMBERS})

    def slot(self) -> Slot:
        """What stands for the slot of each follower: how near to the leader it comes."""
        return Slot(self.near_m)


class Scenario(Section):
    """One flight to be flown."""

    name: str = ""
    """Its name in the results; without one that of the file."""
    title: str
    """One line about it."""
    kind: Literal["formation", "wall"] = "formation"
    """A `formation` behind a leader, or a follower that flies at a `wall`."""
    duration_s: Positive = 240.0
    """Simulated seconds."""
    settle_s: NotNegative | None = None
    """Left out of the figures at the beginning; none: until first within 1 m of the slot."""
    law: str = "hold"
    """Of the applet: `hold` (`echowing.lua`); `thesis`, `bands` (`echowing_speed.lua`); `none`; or
    your own file, `my_law.lua` ([`LAWS.md`](LAWS.md))."""
    plan: str | None = None
    """Your own plan in Python, `my_plan.py`, in place of the ground tool's
    ([`LAWS.md`](LAWS.md#in-python-on-the-ground)); none: ours."""
    leader: LeaderSection = LeaderSection()
    """The leader."""
    formation: FormationSection = FormationSection()
    """Who flies where."""
    swarm: SwarmSection = SwarmSection()
    """Who flies without a slot."""
    guidance: GuidanceSection = GuidanceSection()
    """How points are made."""
    follower: FollowerSection = FollowerSection()
    """The followers' autopilots."""
    applet: dict[str, float] = Field(default={})
    """Parameters of the applet by name, `ECHO_…`."""
    coprocessor: dict[str, float] = Field(default={})
    """Parameters of the co-processor by name."""
    sonar: SonarSection = SonarSection()
    """The sonars."""
    gps: GpsSection = GpsSection()
    """The receivers."""
    wind: WindSection = WindSection()
    """The wind."""
    radio: RadiosSection = RadiosSection()
    """The radio links."""
    wire: WireSection = WireSection()
    """The wires between autopilots and co-processors."""
    airframe: AirframeSection = AirframeSection()
    """How the vehicles differ from SITL's quad."""
    fault: tuple[FaultSection, ...] = ()
    """Faults, each with its time: `[[fault]]`."""
    wall: WallSection = WallSection()
    """Of kind `wall`."""

    @field_validator("law")
    @classmethod
    def _is_a_law(cls, law: str) -> str:
        if law in ("none", *LAWS) or law.endswith(OWN_LAW):
            return law
        names = ", ".join(map(repr, ("none", *LAWS)))
        raise ValueError(f"give {names} or a {OWN_LAW} file")

    @field_validator("plan")
    @classmethod
    def _is_a_plan(cls, plan: str | None) -> str | None:
        if plan is None or plan.endswith(OWN_PLAN):
            return plan
        raise ValueError(f"give a {OWN_PLAN} file with a function {FUNCTION}")

    @model_validator(mode="after")
    def _may_be_planned(self) -> "Scenario":
        if self.plan is None:
            return self
        if self.kind == "wall" or self.swarm.followers:
            raise ValueError("plan: only for a formation behind a leader: remove it")
        if not self.takes_velocity or not self.guidance.settings().feed_forward:
            raise ValueError(
                "plan: needs points with a velocity: law hold or none, without guidance.gray"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _with_places(cls, table: Any) -> Any:
        """Give each follower of a swarm what stands for its slot, where that can be read."""
        swarm = table.get("swarm") if isinstance(table, dict) else None
        if not isinstance(swarm, dict) or "formation" in table:
            return table
        number, near_m = swarm.get("followers"), swarm.get("near_m", _RULES.near_m)
        if not isinstance(number, int) or not 0 < number <= MOST_OF_A_SWARM:
            return table
        return {**table, "formation": {"slots": [{"radius_m": near_m}] * number}}

    @model_validator(mode="after")
    def _is_swarm_alone(self) -> "Scenario":
        if not self.swarm.followers:
            return self
        places = [self.swarm.slot()] * self.swarm.followers
        if self.slots() != places:
            raise ValueError("a swarm has no slots: remove the formation, or the swarm")
        if not self.takes_velocity or not self.guidance.settings().feed_forward:
            raise ValueError("a swarm needs points with a velocity: law hold or none, without gray")
        return self

    @model_validator(mode="after")
    def _flyable(self) -> "Scenario":
        if self.settle_s is not None and self.settle_s >= self.duration_s:
            raise ValueError(
                f"duration_s ({self.duration_s:g}) must be more than settle_s ({self.settle_s:g}), "
                "the seconds left out of the figures"
            )
        wrong = objection(self.fault, len(self.formation.slots), self.duration_s)
        if wrong is not None:
            raise ValueError(wrong)
        if self.fault and self.kind == "wall":
            raise ValueError("a flight at a wall takes no faults")
        without_velocity = self.kind == "wall" or not self.guidance.settings().feed_forward
        if self.applet_file is not None and self.takes_velocity and without_velocity:
            raise ValueError(
                f"law: the {self.law_name} needs points with a velocity, and here they have none: "
                "give thesis, bands or none"
            )
        carried = self.leader.path in ("walk", "track")
        if carried and any(fault.kind in LEADER_FAULTS for fault in self.fault):
            raise ValueError(
                f"a leader on a {self.leader.path} does nothing else: remove its faults"
            )
        starts = [slot.starts_at or n for n, slot in enumerate(self.formation.slots, 1)]
        if sorted(starts) != list(range(1, len(starts) + 1)):
            raise ValueError("starts_at: two followers would start at one slot, or at none")
        return self

    @property
    def law_name(self) -> str:
        """What flew, as results name it: of the user's own files without the folders."""
        return " + ".join(Path(one).name for one in (self.law, self.plan) if one is not None)

    @property
    def applet_file(self) -> Path | None:
        """The applet that flies this law."""
        if self.law == "none":
            return None
        if self.law.endswith(OWN_LAW):
            return Path(self.law)
        return applet_path(SPEED if self.law in SPEED_LAWS else HOLD)

    @cached_property
    def takes_velocity(self) -> bool:
        """Whether points carry a velocity: not those of an applet that knows no format of them."""
        file = self.applet_file
        return file is None or any(row.name == FORMAT for row in parameters_in(file))

    def guidance_settings(self) -> GuidanceSettings:
        """How points are made; those of a speed law have no velocity."""
        settings = replace(self.guidance.settings(), close_gaps=self.formation.close_gaps)
        if self.swarm.followers:
            settings = replace(settings, swarm=self.swarm.weights())
        return settings if self.takes_velocity else replace(settings, feed_forward=False)

    @cached_property
    def sonar_file(self) -> SonarFile:
        """What is known of the sonars."""
        return load_sonar(self.sonar.file)

    @cached_property
    def sonar_belief(self) -> SonarBelief:
        """What the product believes of the sonars: its operator knows the leader's legs."""
        return self.sonar_file.belief(self.leader.target)

    def slots(self) -> list[Slot]:
        """The formation's slots."""
        return [section.slot() for section in self.formation.slots]

    def all_slots(self) -> list[Sequence[Slot]]:
        """The formation's slots, and those of each shape that it takes later."""
        return [self.slots(), *(slots for _, slots in self.formation.shapes()[1:])]

    def check_formation(self) -> list[str]:
        """As the flight core's `check_formation`."""
        formation = self.formation
        said = [
            check_formation(
                slots,
                self.sonar_belief,
                LEAST_M,
                formation.slot_separation_m,
                close_gaps=formation.close_gaps,
            )
            for slots in self.all_slots()
        ]
        check_changes(formation.shapes())
        return list(dict.fromkeys(line for lines in said for line in lines))

    def echo_dist_m(self, index: int) -> float | None:
        """`ECHO_DIST` of follower `index` (from 0): its slot's radius unless told otherwise.

        So a pilot sets it before the flight: `follow` does not engage where the two differ. None:
        as under `[applet]`, or the applet's own where it does not take the radius.
        """
        slot = self.formation.slots[index]
        if slot.echo_dist_m is not None:
            return slot.echo_dist_m
        taken = LEAST_DIST_M <= slot.radius_m <= MOST_DIST_M
        return slot.radius_m if taken and "ECHO_DIST" not in self.applet else None


def scenario_names() -> list[str]:
    """Names of the scenarios that come with the package, in the order of the demo."""
    folder = resources.files("echowing") / "scenarios"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_scenario(name_or_path: str, changes: Iterable[str] = ()) -> Scenario:
    """A scenario by name, or from a user's TOML file, with `key=value` changes applied.

    Raises EchowingError naming the file, the key and what is allowed there.
    """
    text, source, name = _read(name_or_path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise EchowingError(f"{source}: not valid TOML: {error}") from error
    for change in changes:
        _apply(table, change)
    table.setdefault("name", name)
    return scenario_of(table, source)


def _read(name_or_path: str) -> tuple[str, str, str]:
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            return path.read_text(encoding="utf-8"), str(path), path.stem
        except (OSError, UnicodeDecodeError) as error:
            raise EchowingError(f"{path}: cannot read the scenario: {error}") from error
    if name_or_path not in scenario_names():
        raise EchowingError(
            f"no scenario {name_or_path!r}; there are {', '.join(scenario_names())}, "
            "or give a .toml file"
        )
    shipped = resources.files("echowing") / "scenarios" / f"{name_or_path}.toml"
    return shipped.read_text(encoding="utf-8"), f"scenario {name_or_path}", name_or_path


def _apply(table: dict[str, Any], change: str) -> None:
    """Set one dotted key; the value is TOML, or else taken as a string."""
    key, equals, text = change.partition("=")
    if not equals or not key:
        raise EchowingError(f"--set {change!r}: write key=value, for instance gps.sigma_m=0.5")
    try:
        value = tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        value = text
    *parents, last = key.strip().split(".")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise EchowingError(f"--set {change!r}: {parent!r} is a value, not a section")
    table[last] = value


def scenario_of(table: Mapping[str, Any], source: str) -> Scenario:
    """A scenario from what its file says; EchowingError names the source and the key."""
    scenario = section_of(Scenario, table, source)
    generation = scenario.follower.autopilot_generation()
    wrong = list(
        objections(generation, scenario.applet_file, scenario.applet, scenario.follower.parameters)
    )
    if wrong:
        raise EchowingError("\n".join(f"{source}: {line}" for line in wrong))
    if scenario.plan is not None:
        OwnPlan(Path(scenario.plan))  # what is wrong with the file shows before anything flies
    try:
        _ = scenario.sonar_belief  # a file of the user's
        if not scenario.swarm.followers:
            scenario.check_formation()
    except EchowingError as error:
        raise EchowingError(f"{source}: {error}") from error
    return scenario
