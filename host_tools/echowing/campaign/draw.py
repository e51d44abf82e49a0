"""Draws a flight's scenario from a description: a TOML file of distributions.

The head of the shipped one, `campaigns/field.toml`, explains the format. Every value has a random
stream of its own, made from the campaign's seed, the flight's number and the value's place: an
addition to a description does not change the other values.
"""

import math
import random
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from echowing.errors import EchowingError
from echowing.flight.formation import hung_on_leader
from echowing.flight.guidance import Slot
from echowing.flight.shapes import SHAPES, arranged
from echowing.sim.fault_section import LEADER
from echowing.sim.scenario import Scenario, scenario_of

SHIPPED = ("field", "many", "formations")
_SHAPES = (*SHAPES, "wedge")
# Without a word from the description; nearer than 4.83 m is refused (receivers_demand_m).
SPACING_M = 6.0
_FORMATION = {
    *("followers", "shape", "radius_m", "spacing_m", "altitude_step_m", "crossing"),
    *("ranged", "close_gaps", "slot_separation_m", "stagger_m"),
}
_ABSENT = object()


@dataclass(frozen=True)
class Description:
    """A campaign's description: where it came from, its text, and what it says."""

    source: str
    text: str
    table: Mapping[str, Any]

    @property
    def kinds(self) -> list[str]:
        """The kinds of fault that may be drawn, in the file's order."""
        return list(dict.fromkeys(str(one["kind"]) for one in self.table.get("fault", [])))


def load_description(name_or_path: str = SHIPPED[0]) -> Description:
    """A shipped description, or a user's file; EchowingError says what is wrong in it."""
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise EchowingError(f"{path}: cannot read the description: {error}") from error
    elif name_or_path in SHIPPED:
        text = _shipped(name_or_path)
    else:
        raise EchowingError(
            f"no description {name_or_path!r}: {' or '.join(SHIPPED)}, or a .toml file"
        )
    return parse_description(text, str(path))


def _shipped(name: str) -> str:
    return (resources.files("echowing") / "campaigns" / f"{name}.toml").read_text(encoding="utf-8")


def _with_sonars(table: dict[str, Any], source: str) -> dict[str, Any]:
    """The description; where a name stands for its sonars, they are those of that shipped one."""
    flight = table.get("flight", {})
    name = flight.get("sonar")
    if not isinstance(name, str):
        return table
    if name not in SHIPPED:
        raise EchowingError(f"{source}: flight.sonar: {' or '.join(SHIPPED)}, not {name!r}")
    sonar = tomllib.loads(_shipped(name))["flight"].get("sonar", {})
    return {**table, "flight": {**flight, "sonar": sonar}}


def parse_description(text: str, source: str) -> Description:
    """A description from its text; tried on some flights, so that errors show at once."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise EchowingError(f"{source}: not valid TOML: {error}") from error
    unknown = set(table) - {"title", "flight", "formation", "fault"}
    if unknown:
        raise EchowingError(
            f"{source}: {', '.join(sorted(unknown))}: no such key; allowed here: fault, flight, "
            "formation, title"
        )
    table = _with_sonars(table, source)
    description = Description(source, text, table)
    for entry in table.get("fault", []):
        if "kind" not in entry or not isinstance(entry.get("share"), int | float):
            raise EchowingError(f"{source}: a [[fault]] needs `kind` and `share`, a number")
    for index in range(20):
        draw(description, 0, index)
    # Every fault once on a flight of its own: rare ones too.
    for number, entry in enumerate(table.get("fault", [])):
        alone = {**table, "fault": [{**entry, "share": 1.0}]}
        draw(Description(f"{source}, fault {number + 1}", text, alone), 0, number)
    return description


def flight_seed(seed: int, index: int) -> int:
    """The seed of one flight of a campaign."""
    return random.Random(f"{seed} {index}").randrange(1, 2**31)


def draw(description: Description, seed: int, index: int) -> Scenario:
    """The scenario of flight number `index` (from 0) of a campaign."""
    chance = _Chance(description.source, f"{seed} {index}")
    table = description.table
    flight = chance.drawn(table.get("flight", {}), "flight")
    formation = chance.drawn(table.get("formation", {}), "formation")
    flight["name"] = f"flight-{index}"
    flight["title"] = f"Flight {index} of seed {seed}"
    flight["formation"] = _formation(formation, description.source)
    faults = []
    for number, entry in enumerate(table.get("fault", [])):
        if chance.stream(f"fault {number}").random() < entry["share"]:
            fault = {key: value for key, value in entry.items() if key != "share"}
            faults.append(chance.drawn(fault, f"fault.{number}"))
    followers = len(flight["formation"]["slots"])
    _place_faults(faults, followers, chance)
    return _with_faults(flight, faults, description.source)


def _with_faults(flight: dict[str, Any], faults: list[dict[str, Any]], source: str) -> Scenario:
    """The flight with the faults that go together; earlier ones take precedence.

    A fault that is invalid by itself is refused; one that clashes with an earlier one is left out.
    """
    scenario = scenario_of(flight, source)
    taken: list[dict[str, Any]] = []
    for fault in faults:
        try:
            scenario = scenario_of({**flight, "fault": [*taken, fault]}, source)
        except EchowingError:
            longest = {**flight, "duration_s": 1e6, "leader": {"path": "rectangle"}}
            scenario_of({**longest, "fault": [fault]}, source)
            continue
        taken.append(fault)
    return scenario


def _place_faults(faults: list[dict[str, Any]], followers: int, chance: "_Chance") -> None:
    """Give each its vehicle, by number."""
    for number, fault in enumerate(faults):
        vehicle = fault.get("vehicle")
        if vehicle == "leader":
            fault["vehicle"] = LEADER
        elif vehicle == "follower":
            one = chance.stream(f"vehicle {number}").randrange(followers)
            fault["vehicle"] = one + 1 + LEADER


def _formation(wish: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Slots of a formation: who is where, and where each starts.

    The first is `radius_m` behind the leader, the others are in the shape behind the first. All
    hang on the leader: only the sonar of who is near enough hears him. Where it is `ranged`, all
    are in the shape behind the leader, and each sonar looks at the one a step ahead. Every second
    row is `stagger_m` higher.
    """
    unknown = set(wish) - _FORMATION
    if unknown:
        raise EchowingError(f"{source}: formation.{min(unknown)}: no such key")
    shape = wish.get("shape", "column")
    if shape not in _SHAPES:
        raise EchowingError(f"{source}: formation.shape: one of {', '.join(_SHAPES)}, not {shape}")
    count = int(wish.get("followers", 1))
    spacing_m, radius_m = wish.get("spacing_m", SPACING_M), wish.get("radius_m", 3.0)
    ranged = wish.get("ranged", False)
    if ranged:
        places = arranged(shape, count, spacing_m)
    else:
        others = arranged(shape, count - 1, spacing_m)
        behind_first = [
            replace(one, behind=0 if one.behind is None else one.behind + 1) for one in others
        ]
        places = (Slot(radius_m), *behind_first)
    rows: list[int] = []
    for place in places:
        rows.append(1 if place.behind is None else rows[place.behind] + 1)
    if not ranged:
        places = tuple(hung_on_leader(places))
    slots = []
    for number, place in enumerate(places):
        higher_m = wish.get("stagger_m", 0.0) if rows[number] % 2 == 0 else 0.0
        slot: dict[str, Any] = {
            "radius_m": round(place.radius_m, 3),
            "angle_deg": round(math.degrees(place.angle_rad), 3),
            "altitude_step_m": round(number * wish.get("altitude_step_m", 0.0) + higher_m, 3),
        }
        if place.behind is not None:
            slot["behind"] = place.behind + 1
        if wish.get("crossing") and count > 1:
            slot["starts_at"] = count - number
        slots.append(slot)
    told = {key: wish[key] for key in ("close_gaps", "slot_separation_m") if key in wish}
    return {"slots": slots, **told}


class _Chance:
    """Draws values, each from a stream of its own."""

    def __init__(self, source: str, seed: str) -> None:
        self._source = source
        self._seed = seed

    def stream(self, place: str) -> random.Random:
        """The stream of one value."""
        return random.Random(f"{self._seed} {place}")

    def drawn(self, value: Any, place: str) -> Any:
        """A value, with each distribution in it drawn; a key that draws nothing is left out."""
        if isinstance(value, Mapping):
            if set(value) & {*_DISTRIBUTIONS, "share"}:
                return self._distribution(value, place)
            inner = {key: self.drawn(one, f"{place}.{key}") for key, one in value.items()}
            return {key: one for key, one in inner.items() if one is not _ABSENT}
        if isinstance(value, list):
            return [self.drawn(one, f"{place}.{n}") for n, one in enumerate(value)]
        return value

    def _distribution(self, table: Mapping[str, Any], place: str) -> Any:
        kind = next(name for name in (*_DISTRIBUTIONS, "share") if name in table)
        allowed = {"share", "then", "else"} if kind == "share" else {kind}
        if set(table) - allowed:
            extra = ", ".join(sorted(set(table) - allowed))
            raise EchowingError(f"{self._source}: {place}: {extra} beside {kind}: remove it")
        try:
            if kind == "share":
                return self._share(table, place)
            return _DISTRIBUTIONS[kind](table[kind], self.stream(place))
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise EchowingError(
                f"{self._source}: {place}: {kind} = {table[kind]!r} is no such distribution"
            ) from error

    def _share(self, table: Mapping[str, Any], place: str) -> Any:
        if not 0.0 <= table["share"] <= 1.0:
            raise ValueError(table["share"])
        taken = self.stream(place).random() < table["share"]
        branch = "then" if taken else "else"
        if not taken and "else" not in table:
            return _ABSENT
        return self.drawn(table[branch], f"{place}.{branch}")


def _pair(values: Any) -> tuple[float, float]:
    low, high = (float(one) for one in values)
    return low, high


def _uniform(values: Any, stream: random.Random) -> float:
    low, high = _pair(values)
    if high < low:
        raise ValueError(values)
    return round(stream.uniform(low, high), 3)


def _log_uniform(values: Any, stream: random.Random) -> float:
    low, high = _pair(values)
    return round(math.exp(stream.uniform(math.log(low), math.log(high))), 3)


def _normal(values: Any, stream: random.Random) -> float:
    return round(stream.gauss(*_pair(values)), 3)


def _one_of(values: Any, stream: random.Random) -> Any:
    return stream.choice(list(values))


def _weighted(values: Any, stream: random.Random) -> Any:
    return stream.choices(list(values), weights=[float(one) for one in values.values()])[0]


_DISTRIBUTIONS: dict[str, Callable[[Any, random.Random], Any]] = {
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "normal": _normal,
    "one_of": _one_of,
    "weighted": _weighted,
}
