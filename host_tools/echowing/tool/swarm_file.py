"""A swarm as a TOML file has it, for `follow --swarm` and for scenarios alike."""

import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import Field

from echowing.errors import EchowingError
from echowing.flight.formation import SMALLEST_RADIUS_M
from echowing.flight.guidance import Slot
from echowing.flight.swarm_rules import Weights
from echowing.section import NotNegative, Positive, Section, Share, section_of

_OURS = Weights()


class WeightsSection(Section):
    """How a swarm moves; see `echowing.flight.swarm_rules.Weights`."""

    align: Share = _OURS.align
    """Share of the towed centre's velocity in a follower's own; the rest is its neighbours'."""
    towards_per_s: NotNegative = _OURS.towards_per_s
    """Weight of `cluster towards`: to the middle of the neighbours."""
    away_per_s: NotNegative = _OURS.away_per_s
    """Weight of `cluster away`: from who is nearer than `near_m`, or may be nearer than `apart_m`."""
    attract_per_s: NotNegative = _OURS.attract_per_s
    """Weight of `attract`: to the swarm's place behind the leader."""
    repel_per_s: NotNegative = _OURS.repel_per_s
    """Weight of `repel`: from a leader nearer than `near_m`."""
    evade_per_s: NotNegative = _OURS.evade_per_s
    """Weight of `evade`: aside from who comes too near within `evade_s`."""
    switch: Annotated[float, Field(ge=1.0)] = _OURS.switch
    """By so much more `towards_per_s` counts while the swarm may split; 1: it does not change."""
    near_m: Annotated[float, Field(ge=SMALLEST_RADIUS_M)] = _OURS.near_m
    """Nobody wants to be nearer to anybody; the applets' `ECHO_DIST`."""
    apart_m: Positive = _OURS.apart_m
    """Nor for certain nearer than this."""
    room_m: Positive = _OURS.room_m
    """Between neighbours, about: from it follows how far behind the leader the centre is."""
    sees_m: Positive = _OURS.sees_m
    """Who is further away is no neighbour."""
    evade_s: NotNegative = _OURS.evade_s
    """How far ahead a meeting is foreseen."""
    most_mps: Positive = _OURS.most_mps
    """All rules but `align` together, at most."""
    draws_mps: Positive = _OURS.draws_mps
    """What draws together, `cluster towards` and `attract`, at most."""
    eases_mps2: Positive = _OURS.eases_mps2
    """How fast what the rules add may change."""

    def weights(self) -> Weights:
        """The same for the rules."""
        return Weights(**{name: getattr(self, name) for name in WeightsSection.model_fields})

    def slot(self) -> Slot:
        """What stands for the slot of each follower: how near to the leader it comes."""
        return Slot(self.near_m)


def load_swarm(path: Path) -> WeightsSection:
    """The weights of a TOML file: the keys of a scenario's `[swarm]`, without `followers`."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EchowingError(f"--swarm {path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise EchowingError(f"--swarm {path}: cannot be read: {error}") from error
    return section_of(WeightsSection, table, f"--swarm {path}")
