"""Figures of a swarm: whether it is in one piece, and how flights are pooled into a table."""

import math
from dataclasses import replace

import numpy as np
import pytest

from echowing.analysis.flock import in_one_piece, polarisation, rotation
from echowing.bench.swarm import (
    SCENARIOS,
    WAYS,
    Flock,
    SwarmRow,
    flight_count,
    flock,
    markdown,
    pooled,
)
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

pytestmark = pytest.mark.seconds(10)

ONE = Flock(1.0, 1.0, 0.9, 0.1, 3.5, 4.0, 1.8)


def test_in_one_piece_as_long_as_links_join_all() -> None:
    chain = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0)])
    assert in_one_piece(chain, 5.1)
    assert not in_one_piece(chain, 4.9)


def test_polarisation_and_rotation_of_a_group_by_hand() -> None:
    outwards = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    round_it = np.array([(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)])
    assert polarisation(round_it) == pytest.approx(0.0)
    assert rotation(round_it, outwards) == pytest.approx(1.0)
    assert polarisation(np.tile((2.0, 0.0), (4, 1))) == pytest.approx(1.0)


def test_flights_are_pooled_and_the_worst_is_kept() -> None:
    both = pooled([ONE, replace(ONE, whole=0.5, worst=0.5, least_m=1.2)])
    assert (both.whole, both.worst, both.least_m) == (0.75, 0.5, 1.2)
    row = markdown([SwarmRow("round", "as shipped", 2, both)]).splitlines()[-1]
    assert row.startswith("| round | as shipped | 2 | 75% (50%) | 0.90 |")
    assert row.endswith("| 1.20 m |")


def test_each_row_of_the_table_flies_a_shipped_swarm() -> None:
    assert flight_count(3) == 3 * len(SCENARIOS) * len(WAYS) == 24
    for scenario in SCENARIOS:
        for changes in WAYS.values():
            assert load_scenario(scenario, changes).swarm.followers == 6


def test_the_figures_of_a_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("echowing.bench.swarm.GATHERED_S", 2.0)
    scenario = load_scenario("swarm", ["duration_s=8", "swarm.followers=2", "leader.start_s=0"])
    flown = flock(FormationFlight(scenario, 1).run(), 5.6)
    assert 0.0 <= flown.whole <= 1.0
    assert flown.polarisation > 0.5
    assert 0.9 < flown.nearest_m / (2.0 * flown.extent_m) <= 1.0, "of two, about twice"
    assert flown.least_m > 1.0
    assert math.isfinite(flown.rotation)
