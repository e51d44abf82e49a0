"""A formation as a TOML file has it, for `follow --formation` and for scenarios alike."""

import math
import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from echowing.errors import EchowingError
from echowing.flight.formation import check_formation, receivers_demand_m
from echowing.flight.guidance import Slot
from echowing.section import Positive, Section

# A column of three came to 0.81 m of each other without any fault (RESULTS.md, "Two followers").
ONLY_SIMULATED = (
    "a slot has `behind`, which is for simulated flights: longer columns are not kept 1 m apart yet"
)


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


class FormationSection(Section):
    """Who flies where."""

    slots: Annotated[tuple[SlotSection, ...], Field(min_length=1)] = (SlotSection(radius_m=3.0),)
    """One follower each, `[[formation.slots]]`; without any one slot 3 m behind."""
    slot_separation_m: Positive | None = None
    """Slots nearer to each other than this are refused; none: than the followers' receivers demand
    (4.83 m)."""

    def apart_m(self, least_m: float) -> float:
        """How far apart the slots have to be; `least_m` is what must remain of it for certain."""
        told_m = self.slot_separation_m
        return receivers_demand_m(least_m) if told_m is None else told_m


def load_formation(path: Path, least_m: float) -> tuple[list[Slot], float]:
    """Slots of a TOML file with [[slots]], and how far apart they have to be.

    The same keys as in a scenario's formation; where it does not say how far apart, so far as the
    followers' receivers demand for `least_m`.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        formation = FormationSection.model_validate(table)
    except OSError as error:
        raise EchowingError(f"--formation {path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise EchowingError(f"--formation {path}: cannot be read: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise EchowingError(f"--formation {path}: {key}: {first['msg']}") from error
    slots = [section.slot() for section in formation.slots]
    apart_m = formation.apart_m(least_m)
    if any(slot.behind is not None for slot in slots):
        raise EchowingError(f"--formation {path}: {ONLY_SIMULATED}")
    try:
        check_formation(slots, apart_m)
    except EchowingError as error:
        raise EchowingError(f"--formation {path}: {error}") from error
    return slots, apart_m
