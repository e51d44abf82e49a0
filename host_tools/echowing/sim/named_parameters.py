"""Parameters that a scenario gives by name: known, and within what the device takes.

A vehicle ignores a name that it does not know, and the applet a value out of its range: the flight
would be one with the defaults, and nobody would be told.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from echowing.errors import nearest
from echowing.setup.applet import parameters_in
from echowing.sim.vehicle.parameters import Generation, spans_of

Span = tuple[float, float]


def objections(
    generation: Generation,
    flown: Path | None,
    applet: Mapping[str, float],
    vehicle: Mapping[str, float],
) -> Iterator[str]:
    """What is wrong with `[applet]` and with `[follower.parameters]`, one line each.

    flown: the applet's file.
    """
    rows = [] if flown is None else parameters_in(flown)
    of_applet = {row.name: (row.low, row.high) for row in rows}
    name = "no applet, and it" if flown is None else flown.name
    yield from _wrong("applet", applet, of_applet, name)
    known = {**spans_of(generation), **of_applet}
    whose = f"the simulated ArduCopter {generation.value}"
    yield from _wrong("follower.parameters", vehicle, known, whose)


def _wrong(
    section: str, given: Mapping[str, float], spans: Mapping[str, Span], whose: str
) -> Iterator[str]:
    for name, value in given.items():
        if name not in spans:
            yield f"{section}.{name}: {whose} has no such parameter{nearest(name, spans)}"
            continue
        low, high = spans[name]
        if not (math.isfinite(value) and low <= value <= high):
            yield f"{section}.{name}: {value:g} is not accepted; give {low:g} to {high:g}"
