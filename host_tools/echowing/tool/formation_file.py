"""A formation as a TOML file has it, for `follow --formation` and for scenarios alike."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.flight.formation import check_formation
from echowing.flight.guidance import SMALLEST_RADIUS_M, Slot
from echowing.flight.reshape import Named
from echowing.flight.shapes import MOST_FOLLOWERS, Shape, shape
from echowing.section import Positive, Section, section_of

# A few flights come under 1.0 m (RESULTS.md, "Formations"; host_tools/CAMPAIGN.md).
ONLY_SIMULATED = (
    "a slot has `behind`, which is for simulated flights (--simulated): such formations are not "
    "kept 1 m apart in each flight yet"
)
SHAPE_KEYS = ("shape", "followers", "spacing_m")


class SlotSection(Section):
    """One follower's place: radius, angle off the tail (counter-clockwise), altitude step."""

    radius_m: Positive
    """Distance from the leader."""
    angle_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    """Off the leader's tail, counter-clockwise."""
    altitude_step_m: float = 0.0
    """Above the leader."""
    behind: Annotated[int, Field(ge=1)] | None = None
    """Number of the slot (from 1) behind which it is, and at whose follower its sonar looks; none:
    the leader. Radius and angle are from there."""
    echo_dist_m: Positive | None = None
    """Its applet's `ECHO_DIST`; none: as under `[applet]`, else the radius where the applet takes
    it (1.5 to 6 m)."""
    starts_at: Annotated[int, Field(ge=1)] | None = None
    """Number of the slot (from 1) that its follower starts behind; none: its own."""

    def slot(self) -> Slot:
        """The slot in radians."""
        behind = None if self.behind is None else self.behind - 1
        return Slot(self.radius_m, math.radians(self.angle_deg), self.altitude_step_m, behind)


def _slots_of(formation: Mapping[str, Any]) -> tuple[SlotSection, ...]:
    """The slots of a formation that has none written down: by its shape, or one slot 3 m behind."""
    name, followers, spacing_m = (formation.get(key) for key in SHAPE_KEYS)
    if name is None or followers is None or spacing_m is None:
        return (SlotSection(radius_m=3.0),)
    return tuple(map(_section, shape(name, followers, spacing_m)))


def _section(slot: Slot) -> SlotSection:
    """As `SlotSection.slot`, the other way."""
    behind = None if slot.behind is None else slot.behind + 1
    angle_deg = math.degrees(slot.angle_rad)
    return SlotSection(radius_m=slot.radius_m, angle_deg=angle_deg, behind=behind)


class ChangeSection(Section):
    """A shape that the formation takes later, with as many followers and the same spacing."""

    shape: Shape
    """The shape."""
    at_s: Positive
    """From when on, as soon as all are led. `follow` waits for the key `f` instead."""


class FormationSection(Section):
    """Who flies where: a shape by name, or each slot in `[[formation.slots]]`."""

    shape: Shape | None = None
    """A shape ([pictures](GUIDANCE.md#formations)); none: by the slots."""
    followers: Annotated[int, Field(ge=1, le=MOST_FOLLOWERS)] | None = None
    """Of a shape: how many."""
    spacing_m: Annotated[float, Field(ge=SMALLEST_RADIUS_M)] | None = None
    """Of a shape: from each to the one that its sonar looks at."""
    slots: tuple[SlotSection, ...] = Field(min_length=1, default_factory=_slots_of)
    """One follower each, `[[formation.slots]]`; without any one slot 3 m behind."""
    changes: tuple[ChangeSection, ...] = ()
    """The shapes that it takes one after the other, `[[formation.changes]]`."""
    slot_separation_m: Positive | None = None
    """Slots whose followers do not range each other are refused if they are nearer than this; none:
    than what sonars between them leave certain, and without sonars the receivers (4.83 m)."""
    close_gaps: bool = False
    """Who flies behind a follower that has left takes its slot (`--close-gaps`); else it holds."""

    @model_validator(mode="after")
    def _by_shape_or_by_slots(self) -> "FormationSection":
        told = [key for key in SHAPE_KEYS if getattr(self, key) is not None]
        if told and len(told) < len(SHAPE_KEYS):
            raise ValueError(f"a shape needs {', '.join(SHAPE_KEYS)}; here: {', '.join(told)}")
        if told and "slots" in self.model_fields_set:
            raise ValueError("give a shape or slots, not both")
        if self.changes and not told:
            raise ValueError("changes are from a shape: give shape, followers and spacing_m")
        times_s = [change.at_s for change in self.changes]
        if times_s != sorted(times_s):
            raise ValueError(f"changes: at_s has to rise, not {', '.join(map(str, times_s))}")
        return self

    def shapes(self) -> list[Named]:
        """The first one, and those that it takes later."""
        if self.shape is None or self.followers is None or self.spacing_m is None:
            return []
        names = (self.shape, *(change.shape for change in self.changes))
        return [(name, shape(name, self.followers, self.spacing_m)) for name in names]


def check_to_be_led(
    slots: Sequence[Slot],
    sonar: SonarBelief,
    least_m: float,
    separation_m: float | None = None,
    *,
    simulated: bool = False,
    close_gaps: bool = False,
) -> list[str]:
    """As `check_formation`, for real vehicles, unless they are `simulated`."""
    if not simulated and any(slot.behind is not None for slot in slots):
        raise EchowingError(ONLY_SIMULATED)
    return check_formation(slots, sonar, least_m, separation_m, close_gaps=close_gaps)


def load_formation(path: Path) -> FormationSection:
    """A TOML file with [[slots]] or a shape: the same keys as in a scenario's formation."""
    source = f"--formation {path}"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EchowingError(f"{source}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise EchowingError(f"{source}: cannot be read: {error}") from error
    return section_of(FormationSection, table, source)
