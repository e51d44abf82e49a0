"""Worlds that are worse than believed: rows of `echowing bench --only robust`, and their goals."""

from collections.abc import Sequence
from dataclasses import dataclass

from echowing.bench import robust
from echowing.bench.accuracy import Goal, Row
from echowing.sim.scenario import load_scenario

# The bench's rows by the names of the cases here.
CASES = {
    "as shipped": "as shipped",
    "narrow": "beam of 20 degrees to 2 m, 6 at 4.6 m",
    "four of ten": "four pings of ten heard",
    "heights": "heights of 1.0 m",
    "receivers": "receivers of 1.5 m",
}
# A sonar that is drawn around what is believed, and nothing else.
DRAWN = "spread=1"


@dataclass(frozen=True, slots=True)
class World:
    """What differs: keys of a scenario's [sonar], and what barometers and receivers wander by.

    Barometers and receivers are not drawn around it, as each world is flown once.
    """

    sonar: Sequence[str]
    height_sigma_m: float
    sigma_m: float
    goal: Goal

    @classmethod
    def of(cls, row: Row) -> "World":
        """A row's world."""
        gps = load_scenario("echowing", row.changes).gps
        keys = [change.partition(".") for change in row.changes]
        sonar = [key for section, _, key in keys if section == "sonar"]
        return cls(sonar or [DRAWN], gps.vertical_sigma_m, gps.sigma_m, row.goal)


_ROWS = {row.name: row for row in robust.ROWS}
WORLDS = {case: World.of(_ROWS[name]) for case, name in CASES.items()}
