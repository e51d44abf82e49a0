"""Followers that range each other: each one's sonar watches the vehicle ahead of it."""

import time
from collections.abc import Sequence
from dataclasses import replace

import pytest

from echowing.analysis.metrics import Metrics
from echowing.flight.shapes import shape

from . import truth
from .fly_hostile import MANOEUVRES
from .fly_wire import LOST
from .formation import RADIUS_M, Formation, rectangle
from .plugin import Start
from .table import Entry, Figures
from .tools import Tool
from .worlds import WORLDS, World

SEED, SPEED_MPS = 1, 2.0
# As `fly_robust`: two legs and a corner on each side.
BEGIN_S, END_S = 25.0, 145.0
LEAST_M = 1.0
# Receivers alone are 1.6 m off: more than a third of that is no formation that sonars hold.
MOST_ERROR_M = 0.5
CALM = replace(WORLDS["as shipped"], sonar=())


@pytest.mark.parametrize(("name", "followers"), [("column", 2), ("column", 3), ("vee", 3)])
def test_shape(start: Start, table: list[Entry], name: str, followers: int) -> None:
    flown = _in_formation(start, name, followers)
    gaps = _lap(*flown, table, f"{name} of {followers}")
    assert max(gap.mean_abs_error_m for gap in gaps) <= MOST_ERROR_M


def test_radios_of_a_column_lose_packets(start: Start, table: list[Entry]) -> None:
    formation, tool = _in_formation(start, "column", 2)
    for link in (formation.leader_link, *formation.follower_links):
        link.lose(LOST)
    _lap(formation, tool, table, f"column, {LOST:.0%} of packets lost")


@pytest.mark.parametrize("name", ["narrow", "four of ten", "heights"])
def test_column_in_a_worse_world(start: Start, table: list[Entry], name: str) -> None:
    _lap(*_in_formation(start, "column", 2, WORLDS[name]), table, f"column, {name}")


@pytest.mark.parametrize(
    ("manoeuvre", "followers"), [("stops", 2), ("reverses-2mps", 2), ("reverses-2mps", 3)]
)
def test_leader_of_a_column(
    start: Start, table: list[Entry], manoeuvre: str, followers: int
) -> None:
    formation, tool = _in_formation(start, "column", followers)
    began_s = time.monotonic()
    MANOEUVRES[manoeuvre](formation)
    ended_s = time.monotonic()
    assert tool.running
    least_m = formation.least_m(began_s, ended_s)
    gaps = _gaps(formation, began_s, ended_s)
    table.extend(_entries(formation, f"column of {followers}, {manoeuvre}", gaps, least_m, began_s))
    assert least_m >= LEAST_M


def _in_formation(
    start: Start, name: str, followers: int, world: World = CALM
) -> tuple[Formation, Tool]:
    """In the air, each follower in its slot."""
    slots = shape(name, followers, RADIUS_M)
    formation = start(
        SEED,
        slots=slots,
        wandering=False,
        sonar=world.sonar,
        height_sigma_m=world.height_sigma_m,
    )
    formation.leader.upload(rectangle(formation), 10.0)
    formation.take_off()
    shaped = ("--formation", name, "--spacing", f"{RADIUS_M:g}", "--simulated")
    tool = formation.follow(*shaped, radius_m=None)
    formation.until_in_slot(within_s=120.0)
    return formation, tool


def _lap(formation: Formation, tool: Tool, table: list[Entry], case: str) -> list[Metrics]:
    """Two legs and a corner on each side: the figures of each gap. Nobody comes too near."""
    began_s = formation.fly_mission(tool, SPEED_MPS, END_S)
    gaps = _gaps(formation, began_s + BEGIN_S, began_s + END_S)
    least_m = formation.least_m(began_s, began_s + END_S)
    table.extend(_entries(formation, case, gaps, least_m, began_s))
    assert least_m >= LEAST_M
    return gaps


def _gaps(formation: Formation, from_s: float, to_s: float) -> list[Metrics]:
    return [
        truth.figures(ahead.heard.truth, vehicle.heard.truth, from_s, to_s, RADIUS_M)
        for ahead, vehicle in formation.watched()
    ]


def _entries(
    formation: Formation, case: str, gaps: Sequence[Metrics], least_m: float, began_s: float
) -> list[Entry]:
    """A row a gap; least_m: between any two."""
    version, note = formation.kit.version.line, formation.note(began_s)
    return [
        Entry(
            version,
            f"{case}, gap {number}",
            Figures(gap.mean_separation_m, gap.mean_abs_error_m, gap.rmsd_m, least_m),
            note=note,
        )
        for number, gap in enumerate(gaps, 1)
    ]
