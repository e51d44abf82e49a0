"""The values that one tick hands from step to step, for one follower. Frozen: no step writes back.

standing   may it be flown now, and why not (`supervisor`)
plan       where it is to be, as if it flew alone (`plan`)
allowed    the same with room for everybody (`spacing`)
command    what is sent (`session`)
"""

import math
from dataclasses import dataclass
from enum import StrEnum, auto

from echowing.flight.guidance import Horizontal
from echowing.geo import GlobalPosition
from echowing.mavlink.messages import ForApplet


def name_of(system_id: int, leader_id: int) -> str:
    """What messages call a vehicle."""
    return "the leader" if system_id == leader_id else f"follower {system_id}"


class Phase(StrEnum):
    """What is done with a follower.

    WATCHED: its pilot flies it, or nobody is engaged; LIFTED: the tool makes it take off, or is
    about to; CHECKED: in Guided, and not yet fit to be led; LEFT: in Guided, and nothing may be
    sent, as it does not report or its pilot has stopped it; HELD: told to stay at one place; LED.
    """

    WATCHED = auto()
    LIFTED = auto()
    CHECKED = auto()
    LEFT = auto()
    HELD = auto()
    LED = auto()


# What may follow what from one tick to the next. Who has passed the checks is not checked again,
# and who flies does not take off: both only after its pilot has left Guided, which is WATCHED.
_FLOWN = frozenset({Phase.WATCHED, Phase.LEFT, Phase.HELD, Phase.LED})
NEXT: dict[Phase, frozenset[Phase]] = {
    Phase.WATCHED: frozenset(Phase),
    Phase.LIFTED: frozenset(Phase),
    Phase.CHECKED: _FLOWN | {Phase.CHECKED},
    Phase.LEFT: _FLOWN,
    Phase.HELD: _FLOWN,
    Phase.LED: _FLOWN,
}


@dataclass(frozen=True, slots=True)
class Standing:
    """What is done with a follower, and why, in words that can be shown."""

    phase: Phase
    why: str = ""

    @property
    def sent_to(self) -> bool:
        """Whether points go to it."""
        return self.phase in (Phase.HELD, Phase.LED)

    @property
    def held(self) -> bool:
        """Whether it is told to stay at one place."""
        return self.phase is Phase.HELD


@dataclass(frozen=True, slots=True)
class Plan:
    """A place, and the velocity that the follower flies with it, (north, east); None: no velocity.

    yaw_rad: bearing to look at, None: its autopilot's choice; opens_m: the distance its slot has
    opened to, 0: it has not.
    """

    place: GlobalPosition
    velocity_mps: Horizontal | None
    yaw_rad: float | None = None
    opens_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Allowed:
    """As `Plan`, with the name of the vehicle for which it differs from that; None: it does not.

    makes_way: that vehicle is not the one that its sonar looks at, so its applet does not know it.
    """

    place: GlobalPosition
    velocity_mps: Horizontal | None
    gives_way_to: str | None = None
    makes_way: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """What is sent to a follower; altitude_m: above its home."""

    place: GlobalPosition
    velocity_mps: Horizontal | None
    altitude_m: float
    yaw_rad: float | None
    for_applet: ForApplet


@dataclass(frozen=True, slots=True)
class Hold:
    """Where a follower is told to stay; altitude_m: above its home."""

    place: GlobalPosition
    altitude_m: float


@dataclass(slots=True)
class Turn:
    """What lasts until its pilot has left Guided and come back: then all of it is new.

    cleared: it has passed the checks before its first point; flown: the tool has moved it;
    latched: why it is held; refused: its autopilot did not take points; released: its stop switch
    has stopped it, and it stands; waits: it stays as far off as receivers alone allow, as another
    one has to be in his slot before it comes into its own, or because its sonar has not found whom
    it looks at (gave_up); joins_at_s: since when it may come in; seeks_at_s: since when it does, in
    this try; joined: it has.
    """

    cleared: bool = False
    flown: bool = False
    latched: str | None = None
    refused: bool = False
    released: bool = False
    waits: bool = False
    joins_at_s: float = math.inf
    seeks_at_s: float = math.inf
    joined: bool = False
    gave_up: bool = False
