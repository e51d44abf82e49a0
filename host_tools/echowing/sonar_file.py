"""A sonar as a TOML file describes it: what is believed of it, and where each value comes from.

Of what is not known exactly the file gives two values, between which nine such sonars of ten are.
The product believes the worse one. The simulator draws its own sonars from between, and beyond.
"""

import math
import shlex
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from echowing.errors import EchowingError
from echowing.flight.belief import Curve, SonarBelief
from echowing.paths import SHIPPED_SONAR
from echowing.section import NotNegative, Positive, Section, Share, section_of

# Nine of ten of a normal distribution are within so many standard deviations of its mean.
NINE_OF_TEN_SIGMAS = 1.645
Legs = Literal["foil", "stock"]
MAVLINK_TYPE = 10  # RNGFNDn_TYPE: the co-processor's messages


def _least_first(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("the least first, then the most")
    return pair


def _check_rising(name: str, values: tuple[float, ...]) -> None:
    if any(one >= other for one, other in pairwise(values)):
        raise ValueError(f"{name}: the least first, and none twice")


def _check_columns(
    range_m: tuple[float, ...],
    least: tuple[str, tuple[float, ...]],
    most: tuple[str, tuple[float, ...]],
) -> None:
    """ValueError unless ranges rise, and each has its two values."""
    _check_rising("range_m", range_m)
    for name, values in (least, most):
        if len(values) != len(range_m):
            raise ValueError(f"{name}: as many values as range_m has")
    if any(low > high for low, high in zip(least[1], most[1], strict=True)):
        raise ValueError(f"{least[0]}: no more than {most[0]}")


HalfAngle = Annotated[float, Field(gt=0.0, le=180.0)]
Ranges = Annotated[tuple[NotNegative, ...], Field(min_length=1)]
BetweenShares = Annotated[tuple[Share, Share], AfterValidator(_least_first)]
BetweenPositive = Annotated[tuple[Positive, Positive], AfterValidator(_least_first)]
Between = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_least_first)]


class _Finite(Section):
    model_config = ConfigDict(allow_inf_nan=False)


class HeardSection(_Finite):
    """How many of its readings hear a leader with foil on its legs, on the axis, in hover."""

    range_m: Ranges
    """Distances. Nobody knows what is heard beyond the last one."""
    least: tuple[Share, ...]
    """Share there, at least."""
    most: tuple[Share, ...]
    """Share there, at most."""

    @model_validator(mode="after")
    def _complete(self) -> "HeardSection":
        _check_columns(self.range_m, ("least", self.least), ("most", self.most))
        return self


class BeamSection(_Finite):
    """How wide the beam is for a vehicle with foil on its legs, as half angles."""

    range_m: Ranges
    """Distances."""
    narrowest_deg: tuple[HalfAngle, ...]
    """Half angle there, at least."""
    widest_deg: tuple[HalfAngle, ...]
    """Half angle there, at most."""
    edge_deg: BetweenPositive
    """At the edge of the beam the share heard falls from three quarters to one quarter of that on
    the axis, within this angle."""

    @model_validator(mode="after")
    def _complete(self) -> "BeamSection":
        narrowest, widest = ("narrowest_deg", self.narrowest_deg), ("widest_deg", self.widest_deg)
        _check_columns(self.range_m, narrowest, widest)
        return self


class ThrottleSection(_Finite):
    """How the share heard changes with the throttle."""

    throttle: Annotated[tuple[Share, ...], Field(min_length=1)] = (0.0,)
    """Throttles, 0 to 1."""
    share: tuple[Share, ...] = (1.0,)
    """What it leaves of the share that is heard in hover."""

    @model_validator(mode="after")
    def _complete(self) -> "ThrottleSection":
        _check_rising("throttle", self.throttle)
        if len(self.share) != len(self.throttle):
            raise ValueError("share: as many values as throttle has")
        return self


class SonarFile(_Finite):
    """A sonar, its mount and its propellers.

    Where two values stand, `[least, most]`, nine such sonars of ten are between them.
    """

    title: str
    """What it describes."""
    shortest_m: NotNegative
    """The shortest range that it reads: who is nearer reads as this."""
    reach_m: Positive
    """A range of this or more counts as none."""
    foil_to_m: BetweenPositive
    """How far it hears a leader with foil on its legs."""
    stock_to_m: BetweenPositive
    """How far it hears one with stock legs."""
    inset_m: Between
    """The separation, from centre to centre, minus what it reads straight ahead."""
    boom_m: NotNegative = 0.0
    """How far ahead of the vehicle's centre its gimbal is. To the side the sonar reads more."""
    rate_hz: Positive
    """Readings per second, as the co-processor sends them."""
    noise_m: Between
    """Standard deviation of a range."""
    wild_share: BetweenShares
    """Share of the readings that are anything at all."""
    late_share: BetweenShares
    """Share of the readings that are an echo of an earlier ping."""
    rangefinder_type: Annotated[int, Field(ge=1, le=127)] = MAVLINK_TYPE
    """`RNGFNDn_TYPE`. 10: it is on the gimbal, and the co-processor reads it. Any other: it is
    fixed to the nose, and the autopilot's driver of that number reads it."""
    heard: HeardSection
    """What it hears."""
    beam: BeamSection
    """Its beam."""
    throttle: ThrottleSection = ThrottleSection()
    """What propellers leave of it."""
    source: dict[str, str] = Field(default={})
    """Where values come from, by key; a text that begins with `guess` says that nobody knows."""

    @field_validator("boom_m")
    @classmethod
    def _before_the_boom(cls, boom_m: float, info: ValidationInfo) -> float:
        least_m = info.data.get("inset_m", (math.inf, math.inf))[0]
        if boom_m > least_m:
            raise ValueError(f"no more than the least inset_m, {least_m:g}")
        return boom_m

    @field_validator("source")
    @classmethod
    def _of_values(cls, source: dict[str, str]) -> dict[str, str]:
        strange = sorted(source.keys() - set(value_keys(cls)))
        if strange:
            raise ValueError(f"there is no value {', '.join(strange)}")
        return source

    @property
    def guesses(self) -> list[str]:
        """The values that nobody has measured."""
        return [key for key, text in self.source.items() if text.startswith("guess")]

    @property
    def fixed(self) -> bool:
        """Whether the autopilot reads it itself, without co-processor and gimbal."""
        return self.rangefinder_type != MAVLINK_TYPE

    def belief(self, legs: Legs = "foil") -> SonarBelief:
        """What the flight core believes of it, before a leader with these legs."""
        beam, heard = self.beam, self.heard
        heard_to_m = self.foil_to_m[0] if legs == "foil" else self.stock_to_m[0]
        # A leader that is heard less far is heard as one with foil is further away.
        nearer = heard_to_m / self.foil_to_m[0]
        surely_to_m = heard_to_m * min(1.0, self.stock_to_m[0] / self.foil_to_m[0])
        left = min(self.throttle.share)
        return SonarBelief(
            heard=Curve(_times(heard.range_m, nearer), _times(heard.least, left)),
            widest_rad=_radians(beam.range_m, beam.widest_deg),
            narrowest_rad=_radians(_times(beam.range_m, nearer), beam.narrowest_deg),
            edge_rad=math.radians(_mean(beam.edge_deg)),
            noise_m=self.noise_m[1],
            wrong_share=self.wild_share[1] + self.late_share[1],
            shortest_m=self.shortest_m,
            reach_m=self.reach_m,
            # No further than anything counts.
            heard_to_m=min(heard_to_m, self.reach_m),
            # As much less as stock legs are heard less far than those with foil.
            surely_to_m=min(surely_to_m, self.reach_m),
            inset_m=_mean(self.inset_m),
            rate_hz=self.rate_hz,
            fixed=self.fixed,
        )


def _times(values: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(factor * value for value in values)


def _radians(range_m: tuple[float, ...], values_deg: tuple[float, ...]) -> Curve:
    return Curve(range_m, tuple(map(math.radians, values_deg)))


def _mean(pair: tuple[float, float]) -> float:
    return (pair[0] + pair[1]) / 2.0


def value_keys(model: type[Section], prefix: str = "") -> list[str]:
    """The keys of a sonar file that hold values, with their sections."""
    keys: list[str] = []
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, Section):
            keys += value_keys(kind, f"{prefix}{name}.")
        elif name not in ("title", "rangefinder_type", "source"):
            keys.append(prefix + name)
    return keys


def sonar_names() -> list[str]:
    """Names of the sonars that come with the package."""
    folder = resources.files("echowing") / "sonars"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_sonar(name_or_path: str | Path) -> SonarFile:
    """A sonar by name, or from a user's TOML file; EchowingError names the file and the key."""
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise EchowingError(f"{path}: cannot read the sonar: {error}") from error
        return sonar_of(_table(text, str(path)), str(path))
    if str(name_or_path) not in sonar_names():
        raise EchowingError(
            f"no sonar {str(name_or_path)!r}; there are {', '.join(sonar_names())}, "
            "or give a .toml file"
        )
    shipped = resources.files("echowing") / "sonars" / f"{name_or_path}.toml"
    source = f"sonar {name_or_path}"
    return sonar_of(_table(shipped.read_text(encoding="utf-8"), source), source)


def sonar_of(table: Mapping[str, Any], source: str) -> SonarFile:
    """A sonar from what its file says; EchowingError names the source and the key."""
    return section_of(SonarFile, table, source)


def _table(text: str, source: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise EchowingError(f"{source}: not valid TOML: {error}") from error


@cache
def shipped_sonar() -> SonarBelief:
    """What is believed of the sonar that the package ships."""
    return load_sonar(SHIPPED_SONAR).belief()


def write_sonar(path: Path, sonar: SonarFile) -> None:
    """Write a sonar file. Raises EchowingError where that cannot be done."""
    import tomli_w  # noqa: PLC0415 (only here)

    try:
        path.write_text(tomli_w.dumps(sonar.model_dump(mode="json")), encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{path}: cannot be written: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class FlownBy:
    """By what a flight is flown: a sonar file, under its name, and the leader's legs."""

    name: str
    file: SonarFile
    legs: Legs

    def as_dict(self) -> dict[str, Any]:
        """For the log: the whole file, which may be another one later."""
        return {"sonar": self.name, "legs": self.legs, "file": self.file.model_dump(mode="json")}

    @classmethod
    def of(cls, table: Mapping[str, Any], source: str) -> "FlownBy":
        """As a log tells it; EchowingError names the source."""
        legs: Any = table.get("legs")
        file = table.get("file")
        if legs not in get_args(Legs) or not isinstance(file, Mapping):
            raise EchowingError(f"{source}: does not say by which sonar file it was flown")
        return cls(str(table.get("sonar")), sonar_of(file, source), legs)


def fly_by(path: Path, legs: Legs) -> str:
    """How to fly by a file that was measured before a leader with these legs."""
    option = "" if legs == "foil" else f" --legs {legs}"
    return f"{path}: fly by it with `echowing follow --sonar {shlex.quote(str(path))}{option}`"
