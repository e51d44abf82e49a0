"""The pages of keys, made from the models: `python -m echowing.docs.keys host_tools`."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from echowing.section import Section
from echowing.sim.scenario import Scenario
from echowing.sonar_file import SonarFile

SCENARIOS = """\
# Scenarios

A scenario is a TOML file that `echowing sim FILE.toml` flies. Only `title` must be in it: all \
else is as by default, and that is how `echowing sim echowing` flies. `--set gps.sigma_m=1.2` \
changes a key for one flight. The scenarios of the package are in \
[`host_tools/echowing/scenarios/`](echowing/scenarios).

```
title = "Two followers, windy"
duration_s = 120

[wind]
speed_mps = 6

[[formation.slots]]
radius_m = 3.0

[[formation.slots]]
radius_m = 5.0
angle_deg = 50.0
```

The units are in the names: `_m` metres, `_s` seconds, `_mps` metres per second, `_deg` degrees, \
`_dps` degrees per second, `_hz` per second. This page is made by `make pages` from the model \
(`host_tools/echowing/sim/scenario.py`).
"""
SONAR = """\
# Sonar files

A sonar file (TOML) says what is known of a follower's sonar on its mount, among its propellers, \
and how well it hears a leader. `echowing follow --sonar FILE` flies by it. Without `--sonar` it \
takes `mb1202`, which comes with the package \
([`host_tools/echowing/sonars/mb1202.toml`](echowing/sonars/mb1202.toml)); most of its values are \
cautious guesses. Measure your own: on the bench \
([`RIG.md`](RIG.md#response-matrix)), or in a flight ([`SENSORS.md`](SENSORS.md#measure-it)).

A sonar *carries* a slot if a follower can keep that distance by it. Before anybody flies, the \
tool names the slots that the file does not carry. In flight it compares what the sonar hears with \
the file, tells the pilots of a worse one, and opens a slot that it does not carry \
([`GUIDANCE.md`](GUIDANCE.md#what-the-receivers-disagree-by)).

Many keys take two values, `[least, most]`: nine of ten such sonars lie between them. The product \
believes the worse one: as few readings as `least` are heard, as many as `most` are wrong. Nobody \
is heard outside the widest beam; silence tells something only within the narrowest. The simulator \
draws a sonar for each follower and each seed; of each value nine draws of ten lie between the \
two, and one of twenty is worse than believed ([`SCENARIOS.md`](SCENARIOS.md), `[sonar]`).

The units are in the names: `_m` metres, `_deg` degrees, `_hz` per second; shares are 0 to 1. This \
page is made by `make pages` from the model (`host_tools/echowing/sonar_file.py`).
"""

_SIGNS = {
    "minimum": "≥",
    "exclusiveMinimum": ">",
    "maximum": "≤",
    "exclusiveMaximum": "<",
}
_TYPES = {"number": "number", "integer": "whole number", "boolean": "true, false", "string": "text"}


PAGES: dict[str, tuple[type[Section], str]] = {
    "SCENARIOS.md": (Scenario, SCENARIOS),
    "SONAR.md": (SonarFile, SONAR),
}


def page(name: str) -> str:
    """A page as Markdown."""
    model, head = PAGES[name]
    schema = model.model_json_schema()
    sections = [_table("", schema)]
    sections += [_table(section, part) for section, part in _parts(schema, schema, "")]
    return head + "".join(sections)


def _parts(schema: Any, part: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """The sections below a section, each with its dotted name, depth first."""
    for key, value in part["properties"].items():
        inner, many = _section(schema, value)
        if inner is not None:
            name = f"{prefix}{key}"
            yield (f"[{name}]" if many else name), inner
            yield from _parts(schema, inner, f"{name}.")


def _section(schema: Any, value: Any) -> tuple[Any, bool]:
    """The section that a key holds, and whether there may be several of it."""
    many = "items" in value
    link = (value["items"] if many else value).get("$ref")
    return (None if link is None else schema["$defs"][link.rpartition("/")[2]]), many


def _table(name: str, part: Any) -> str:
    title = f"## `[{name}]`\n\n" if name else "## At the top\n\n"
    required = part.get("required", [])
    rows = [
        f"| `{key}` | {_allowed(value)} | {_default(value, needed=key in required)} "
        f"| {' '.join(value['description'].split())} |"
        for key, value in part["properties"].items()
        if not _is_section(value)
    ]
    if not rows:
        return ""
    head = "| key | takes | default | what it is |\n|---|---|---|---|\n"
    return f"\n{title}{_about(part) if name else ''}{head}" + "\n".join(rows) + "\n"


def _is_section(value: Any) -> bool:
    return "$ref" in value or "$ref" in value.get("items", {})


def _about(part: Any) -> str:
    return f"{' '.join(part['description'].split())}\n\n"


def _allowed(value: Any) -> str:
    if "anyOf" in value:
        return " or ".join(_allowed(one) for one in value["anyOf"])
    if "enum" in value:
        return ", ".join(f"`{one}`" for one in value["enum"])
    kind = value["type"]
    if kind == "null":
        return "nothing"
    if kind == "object":
        return f"table of {_TYPES[value['additionalProperties']['type']]}s"
    if kind == "array":
        return f"{len(value['prefixItems'])} numbers" if "prefixItems" in value else "numbers"
    limits = [f"{sign} {value[key]:g}" for key, sign in _SIGNS.items() if key in value]
    return " ".join([_TYPES[kind], *limits])


def _default(value: Any, *, needed: bool) -> str:
    if needed:
        return "must be given"
    default = value["default"]
    if default is None or default in ("", {}):
        return "none"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, list):
        return ", ".join(f"{one:g}" for one in default)
    return f"{default:g}" if isinstance(default, float) else str(default)


if __name__ == "__main__":
    for each in PAGES:
        (Path(sys.argv[1]) / each).write_text(page(each), encoding="utf-8")
