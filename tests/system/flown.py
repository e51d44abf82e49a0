"""Flights that several tests look at."""

from functools import cache

from echowing.sim.scenario import load_scenario
from echowing.sim.summary import FlownScenario, fly


@cache
def flown(scenario: str, seed: int, *changes: str, firmware: str = "native") -> FlownScenario:
    """Each flight is flown once for all the tests of a file that look at it."""
    return fly(load_scenario(scenario, changes), seed, firmware=firmware)
