"""A sonar as a TOML file describes it: what is believed of it, and where each value comes from."""

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, field_validator, model_validator

from echowing.errors import EchowingError
from echowing.flight.belief import Curve, SonarBelief
from echowing.section import NotNegative, Positive, Section, Share, section_of

SHIPPED = "mb1202"
HalfAngle = Annotated[float, Field(gt=0.0, le=180.0)]
Ranges = Annotated[tuple[NotNegative, ...], Field(min_length=1)]


def _rising(range_m: tuple[float, ...], *columns: tuple[float, ...]) -> None:
    """ValueError unless ranges rise, and each has its values."""
    if any(near >= far for near, far in pairwise(range_m)):
        raise ValueError("range_m: the nearest first, and none twice")
    if any(len(column) != len(range_m) for column in columns):
        raise ValueError("as many values as range_m has")


class _Finite(Section):
    model_config = ConfigDict(allow_inf_nan=False)


class HeardSection(_Finite):
    """How much of a leader on the axis is heard."""

    range_m: Ranges
    """Distances; beyond the last nothing is known."""
    share: tuple[Share, ...]
    """Share of the readings there that hear it."""

    @model_validator(mode="after")
    def _complete(self) -> "HeardSection":
        _rising(self.range_m, self.share)
        return self


class BeamSection(_Finite):
    """How wide the beam is, as half angles."""

    range_m: Ranges
    """Distances."""
    widest_deg: tuple[HalfAngle, ...]
    """There: nobody is heard further off the axis."""
    narrowest_deg: tuple[HalfAngle, ...]
    """There: whoever is nearer to the axis is heard as on it."""
    edge_deg: Positive
    """Over this angle the beam begins."""

    @model_validator(mode="after")
    def _complete(self) -> "BeamSection":
        _rising(self.range_m, self.widest_deg, self.narrowest_deg)
        if any(a > b for a, b in zip(self.narrowest_deg, self.widest_deg, strict=True)):
            raise ValueError("narrowest_deg: no more than widest_deg")
        return self


class SonarFile(_Finite):
    """A sonar file."""

    title: str
    """Which sonar, mount and leader it is."""
    shortest_m: NotNegative
    """Nearer reads as this."""
    reach_m: Positive
    """A range from here on is no target."""
    stock_to_m: Positive
    """A leader with stock legs is heard so far."""
    foil_to_m: Positive
    """One with foil on its legs is heard so far."""
    inset_m: NotNegative
    """How much less than the separation it reads."""
    rate_hz: Positive
    """Readings per second."""
    noise_m: NotNegative
    """Standard deviation of a range."""
    wild_share: Share
    """Share of the readings that are anything at all."""
    late_share: Share
    """Share of the readings that are an echo of an earlier ping."""
    heard: HeardSection
    """Share heard."""
    beam: BeamSection
    """The beam."""
    source: dict[str, str] = Field(default={})
    """Where values come from, by key; one that begins with `guess` is one."""

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

    def belief(self) -> SonarBelief:
        """The same for the flight core."""
        beam = self.beam
        return SonarBelief(
            heard=Curve(self.heard.range_m, self.heard.share),
            widest_rad=_radians(beam.range_m, beam.widest_deg),
            narrowest_rad=_radians(beam.range_m, beam.narrowest_deg),
            edge_rad=math.radians(beam.edge_deg),
            noise_m=self.noise_m,
            wild_share=self.wild_share,
            late_share=self.late_share,
            shortest_m=self.shortest_m,
            reach_m=self.reach_m,
            inset_m=self.inset_m,
            stock_to_m=self.stock_to_m,
            foil_to_m=self.foil_to_m,
            rate_hz=self.rate_hz,
        )


def _radians(range_m: tuple[float, ...], values_deg: tuple[float, ...]) -> Curve:
    return Curve(range_m, tuple(map(math.radians, values_deg)))


def value_keys(model: type[Section], prefix: str = "") -> list[str]:
    """The keys of a sonar file that hold values, with their sections."""
    keys: list[str] = []
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, Section):
            keys += value_keys(kind, f"{prefix}{name}.")
        elif name not in ("title", "source"):
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
    return load_sonar(SHIPPED).belief()
