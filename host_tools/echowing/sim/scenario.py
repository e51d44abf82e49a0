"""Scenarios: what is flown, as TOML, checked before anything moves."""

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError, model_validator

from echowing.errors import EchowingError
from echowing.flight.formation import DEFAULT_SLOT_SEPARATION_M, check_formation
from echowing.flight.guidance import GRAY, GuidanceSettings, Slot
from echowing.sim.fault_section import LEADER_FAULTS, FaultSection, objection
from echowing.sim.parameters import Generation
from echowing.sim.radio import RadioSettings
from echowing.sim.section import NotNegative, Positive, Section, Share

# The names of the speed laws, and the applet's number for each (lua/echowing.md).
LAWS = {"thesis": 0, "bands": 1, "continuous": 2}
LeaderPath = Literal[
    "rectangle", "circle", "figure-eight", "stop-and-go", "script", "walk", "track"
]
LawName = Literal["none", "thesis", "bands", "continuous"]


class LeaderEvent(Section):
    """Something the leader does, from `at_s` on.

    auto: its mission; goto: Auto to `point_ned_m` at `speed_mps`, braking and turning as Auto does;
    fly: at `velocity_ned_mps` with heading `yaw_deg`, at once; at_follower: at `speed_mps`
    straight at where the first follower then is, and on; hold: stop; gps_jump: its position is
    off by `jump_ned_m`; silent: its radio is dead; heard: radio and GPS are well again.
    """

    at_s: NotNegative
    act: Literal["auto", "goto", "fly", "at_follower", "hold", "gps_jump", "silent", "heard"]
    label: str = ""
    velocity_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float | None = None
    point_ned_m: tuple[float, float, float] = (0.0, 0.0, -10.0)
    speed_mps: Positive = 1.0
    jump_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class LeaderSection(Section):
    """The leader's path: an Auto mission, a script, a walk, or a recorded track."""

    path: LeaderPath = "rectangle"
    north_m: Positive = 60.0
    east_m: Positive = 40.0
    radius_m: Positive = 20.0
    speed_mps: Positive = 2.0
    altitude_m: Positive = 10.0
    start_s: NotNegative = 5.0
    laps: Annotated[int, Field(ge=1)] = 3
    track: Path | None = None
    target: Literal["foil", "stock"] = "foil"
    script: tuple[LeaderEvent, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> "LeaderSection":
        if self.path == "track" and self.track is None:
            raise ValueError("path 'track' needs `track`, a CSV or .tlog file")
        if self.path == "script" and not self.script:
            raise ValueError("path 'script' needs at least one [[leader.script]] event")
        return self


class SlotSection(Section):
    """One follower's place: radius, angle off the tail (counter-clockwise), altitude step.

    echo_dist_m: its applet's ECHO_DIST, where it is not `[applet]`'s. starts_at: the number of the
    slot (from 1) that it starts behind, where that is not its own.
    """

    radius_m: Positive
    angle_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    altitude_step_m: float = 0.0
    echo_dist_m: Positive | None = None
    starts_at: Annotated[int, Field(ge=1)] | None = None

    def slot(self) -> Slot:
        """The slot in radians."""
        return Slot(self.radius_m, math.radians(self.angle_deg), self.altitude_step_m)


class FormationSection(Section):
    """Who flies where."""

    slots: Annotated[tuple[SlotSection, ...], Field(min_length=1)] = (SlotSection(radius_m=3.0),)
    slot_separation_m: Positive = DEFAULT_SLOT_SEPARATION_M


class GuidanceSection(Section):
    """How guided points are made; see `echowing.flight.guidance.GuidanceSettings`."""

    rate_hz: Annotated[float, Field(gt=0.0, le=20.0)] = 8.0
    telemetry_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 4.0
    lead_time_s: NotNegative = 1.0
    predict: bool = True
    keep_behind: bool = True
    clearance_m: NotNegative = 1.0
    face_leader: bool = True
    slot_rate_dps: Positive | None = 30.0
    learn_offset: bool = True
    standoff_sigmas: NotNegative = 2.5
    sonar_inset_m: NotNegative = 0.2
    feed_forward: bool = True
    fresh_age_s: Positive | None = 0.5
    stale_age_s: Positive | None = 1.0
    gray: bool = False  # guided points as the thesis made them: none of the protections

    def settings(self) -> GuidanceSettings:
        """The same for the guidance."""
        if self.gray:
            return replace(GRAY, lead_time_s=self.lead_time_s)
        return GuidanceSettings(
            lead_time_s=self.lead_time_s,
            predict=self.predict,
            keep_behind=self.keep_behind,
            clearance_m=self.clearance_m,
            face_leader=self.face_leader,
            slot_rate_rps=None if self.slot_rate_dps is None else math.radians(self.slot_rate_dps),
            learn_offset=self.learn_offset,
            standoff_sigmas=self.standoff_sigmas,
            sonar_inset_m=self.sonar_inset_m,
            feed_forward=self.feed_forward,
            fresh_age_s=self.fresh_age_s,
            stale_age_s=self.stale_age_s,
        )


class GpsSection(Section):
    """Drift of the estimated position, first-order Gauss-Markov.

    `sigma_m`: each horizontal axis. `vertical_sigma_m`: the height. It is 0 because ArduCopter
    takes its height from the barometer (EK3_SRC1_POSZ 1), whose drift is mostly the weather's and
    so common to a formation. With the receiver's height (EK3_SRC1_POSZ 3) it is about twice
    `sigma_m`: 13 m against 8 m at 95 % (GPS SPS Performance Standard, 2020), which are 6.6 m and
    3.3 m an axis.
    """

    sigma_m: NotNegative = 0.8
    tau_s: Positive = 60.0
    vertical_sigma_m: NotNegative = 0.0


class WindSection(Section):
    """Wind that copters fly in; see `echowing.sim.wind.Wind`.

    `direction_deg` is where it comes from, as SIM_WIND_DIR. The default turbulence is what
    MIL-F-8785C has at 10 m for the mean wind, whatever that is.
    """

    speed_mps: NotNegative = 0.0
    direction_deg: float = 0.0
    turbulence: Share = 0.19


class RadioSection(Section):
    """One link, both ways alike."""

    latency_s: NotNegative = 0.0
    jitter_s: NotNegative = 0.0
    loss: Share = 0.0
    bandwidth_bytes_ps: Positive | None = None
    reorder: Share = 0.0
    reorder_s: NotNegative = 0.3
    duplicate: Share = 0.0

    def settings(self) -> RadioSettings:
        """The same for the radio model."""
        return RadioSettings(**self.model_dump())


class RadiosSection(Section):
    """The leader's link carries its telemetry 0.46 s late (thesis 4.2.3, measured by Gray)."""

    leader: RadioSection = RadioSection(latency_s=0.46)
    follower: RadioSection = RadioSection(latency_s=0.05)


class FollowerSection(Section):
    """The followers' autopilots."""

    generation: Literal["4.5", "4.6", "4.7", "4.8"] = "4.8"
    speed_mps: Positive = 5.0
    parameters: dict[str, float] = Field(default_factory=dict)

    def autopilot_generation(self) -> Generation:
        """Which ArduCopter."""
        return Generation(self.generation)


class AirframeSection(Section):
    """How the vehicles differ from SITL's quad, as factors.

    mass and drag: of the airframe. lag: of the time from a wanted lean to the lean, and of the
    motors'. gain: of the velocity controller, PSC_NE_VEL_P, I and D.
    """

    mass: Positive = 1.0
    drag: Positive = 1.0
    lag: Positive = 1.0
    gain: Positive = 1.0


class WallSection(Section):
    """A wall across the follower's way (thesis 4.2.2)."""

    distance_m: Positive = 20.0
    target_behind_m: NotNegative = 5.0
    speed_mps: Positive = 2.0
    altitude_m: Positive = 2.0


class Scenario(Section):
    """One flight to be flown."""

    name: str = ""
    title: str
    kind: Literal["formation", "wall"] = "formation"
    duration_s: Positive = 240.0
    # Left out of the figures at the beginning; none: until first within 1 m of the slot.
    settle_s: NotNegative | None = None
    law: LawName = "continuous"
    leader: LeaderSection = LeaderSection()
    formation: FormationSection = FormationSection()
    guidance: GuidanceSection = GuidanceSection()
    follower: FollowerSection = FollowerSection()
    applet: dict[str, float] = Field(default_factory=dict)
    coprocessor: dict[str, float] = Field(default_factory=dict)
    gps: GpsSection = GpsSection()
    wind: WindSection = WindSection()
    radio: RadiosSection = RadiosSection()
    airframe: AirframeSection = AirframeSection()
    fault: tuple[FaultSection, ...] = ()
    wall: WallSection = WallSection()

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
        carried = self.leader.path in ("walk", "track")
        if carried and any(fault.kind in LEADER_FAULTS for fault in self.fault):
            raise ValueError(
                f"a leader on a {self.leader.path} does nothing else: remove its faults"
            )
        starts = [slot.starts_at or n for n, slot in enumerate(self.formation.slots, 1)]
        if sorted(starts) != list(range(1, len(starts) + 1)):
            raise ValueError("starts_at: two followers would start at one slot, or at none")
        return self

    def slots(self) -> list[Slot]:
        """The formation's slots."""
        return [section.slot() for section in self.formation.slots]


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
    try:
        scenario = Scenario.model_validate(table)
    except ValidationError as error:
        lines = [_explained(item) for item in error.errors()]
        raise EchowingError("\n".join(f"{source}: {line}" for line in lines)) from error
    try:
        check_formation(scenario.slots(), scenario.formation.slot_separation_m)
    except EchowingError as error:
        raise EchowingError(f"{source}: {error}") from error
    return scenario


def _explained(item: Any) -> str:
    """One validation error as `key: what is wrong; what is allowed`."""
    location = [str(part) for part in item["loc"]]
    key = ".".join(location) or "scenario"
    if item["type"] == "extra_forbidden":
        allowed = ", ".join(sorted(_keys_at(location[:-1])))
        return f"{key}: no such key; allowed here: {allowed}"
    if item["type"] == "missing":
        return f"{key}: missing"
    message = item["msg"].removeprefix("Value error, ")
    got = item["input"]
    shown = "" if isinstance(got, dict) else f" (got {got!r})"
    return f"{key}: {message}{shown}"


def _keys_at(location: Iterable[str]) -> list[str]:
    """The keys that a section may have."""
    model: type[BaseModel] = Scenario
    for part in location:
        if part.isdigit():
            continue
        field = model.model_fields.get(part)
        inner = _model_in(field.annotation if field else None)
        if inner is None:
            return []
        model = inner
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None
