"""Makes a find small: removes from its scenario what it does not need in order to fail.

A scenario is a plain table here, as in its file. Each step is tried by flying it; it is kept if the
same property still breaks. The seed stays the same, so every result flies again as it did.
"""

import copy
from collections.abc import Callable, Iterator
from typing import Any

from echowing.campaign.fly import LOGS, fly_and_judge
from echowing.campaign.properties import Broken
from echowing.errors import EchowingError
from echowing.sim.fault_section import LEADER
from echowing.sim.scenario import Scenario, scenario_of

Table = dict[str, Any]
Fails = Callable[[Table], Broken | None]

# Flights for each find, at the most: then the smallest scenario so far is the result.
MOST_FLIGHTS = 60
# Left after the moment at which the property broke, so that the plot shows it.
AFTERWARDS_S = 5.0
# The sections that may be left to their defaults, the least important first.
_SECTIONS = (
    ("airframe",),
    ("wire",),
    ("radio", "follower"),
    ("wind",),
    ("radio", "leader"),
    ("sonar",),
    ("gps",),
    ("follower",),
    ("guidance",),
    ("leader",),
)


def table_of(scenario: Scenario) -> Table:
    """A scenario as its file has it, without values that were never set."""
    table: Table = scenario.model_dump(mode="json", exclude_unset=True)
    return table


def breaks(property_name: str, seed: int) -> Fails:
    """What a table's flight breaks of one property; None: it holds, or it is no scenario."""

    def fails(table: Table) -> Broken | None:
        try:
            scenario = scenario_of(table, "shrunk")
        except EchowingError:
            return None
        broken = fly_and_judge(scenario, seed, logs=property_name == LOGS).broken
        return next((one for one in broken if one.name == property_name), None)

    return fails


def shrink(table: Table, fails: Fails, most_flights: int = MOST_FLIGHTS) -> tuple[Table, Broken]:
    """The smallest failing table that `most_flights` flights can find, and how it fails."""
    broken = fails(table)
    if broken is None:
        raise ValueError("what does not fail cannot be shrunk")
    flights, smaller = 1, True
    while smaller and flights < most_flights:
        smaller = False
        for candidate in list(_candidates(table, broken)):
            if flights >= most_flights:
                break
            flights += 1
            still = fails(candidate)
            if still is not None:
                table, broken, smaller = candidate, still, True
                break
    return table, broken


def _candidates(table: Table, broken: Broken) -> Iterator[Table]:
    """Smaller tables, the greatest steps first."""
    yield from _shorter(table, broken)
    yield from _fewer_faults(table)
    yield from _fewer_followers(table)
    yield from _plainer(table)
    yield from _shorter_faults(table)


def _shorter(table: Table, broken: Broken) -> Iterator[Table]:
    end_s = round(broken.time_s + AFTERWARDS_S)
    if end_s < table.get("duration_s", 240.0):
        shorter = copy.deepcopy(table)
        shorter["duration_s"] = float(end_s)
        shorter["fault"] = [one for one in table.get("fault", []) if one.get("at_s", 0.0) < end_s]
        yield shorter


def _fewer_faults(table: Table) -> Iterator[Table]:
    faults = table.get("fault", [])
    for number in reversed(range(len(faults))):
        fewer = copy.deepcopy(table)
        del fewer["fault"][number]
        yield fewer


def _fewer_followers(table: Table) -> Iterator[Table]:
    slots = table.get("formation", {}).get("slots", [])
    if len(slots) < 2:
        return
    for number in reversed(range(len(slots))):
        yield _without_follower(table, number)


def _without_follower(table: Table, number: int) -> Table:
    """Without one follower (from 0), its faults with it; those behind it move up by one."""
    fewer = copy.deepcopy(table)
    del fewer["formation"]["slots"][number]
    for slot in fewer["formation"]["slots"]:
        slot.pop("starts_at", None)
    gone = number + 1 + LEADER
    faults = []
    for fault in fewer.get("fault", []):
        vehicle = fault.get("vehicle")
        if vehicle == gone:
            continue
        if vehicle is not None and vehicle > gone:
            fault["vehicle"] = vehicle - 1
        faults.append(fault)
    fewer["fault"] = faults
    return fewer


def _plainer(table: Table) -> Iterator[Table]:
    for path in _SECTIONS:
        plainer = copy.deepcopy(table)
        inside = plainer
        for part in path[:-1]:
            inside = inside.get(part, {})
        if inside.pop(path[-1], None):
            yield plainer


def _shorter_faults(table: Table) -> Iterator[Table]:
    """Each fault half as long, and at a rounder time."""
    for number, fault in enumerate(table.get("fault", [])):
        if fault.get("for_s") and fault["for_s"] > 1.0:
            half = copy.deepcopy(table)
            half["fault"][number]["for_s"] = float(max(1, round(fault["for_s"] / 2.0)))
            yield half
        if fault.get("at_s", 0.0) != round(fault.get("at_s", 0.0)):
            rounder = copy.deepcopy(table)
            rounder["fault"][number]["at_s"] = float(round(fault["at_s"]))
            yield rounder
