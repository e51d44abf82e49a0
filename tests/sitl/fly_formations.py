"""Followers that range each other: each one's sonar watches the vehicle ahead of it."""

import pytest

from echowing.flight.shapes import shape

from . import truth
from .formation import RADIUS_M, rectangle
from .plugin import Start
from .table import Entry, Figures

SEED, SPEED_MPS = 1, 2.0
# As `fly_robust`: two legs and a corner on each side.
BEGIN_S, END_S = 25.0, 145.0
LEAST_M = 1.0
# A gap is one of a formation, not of two that fly each on its own: receivers alone are 1.6 m off.
MOST_ERROR_M = 0.5


@pytest.mark.parametrize(("name", "followers"), [("column", 2), ("column", 3), ("vee", 3)])
def test_shape(start: Start, table: list[Entry], name: str, followers: int) -> None:
    slots = shape(name, followers, RADIUS_M)
    formation = start(SEED, slots=slots, wandering=False, height_sigma_m=0.5)
    formation.leader.upload(rectangle(formation), 10.0)
    formation.take_off()
    shaped = ("--formation", name, "--spacing", f"{RADIUS_M:g}", "--simulated")
    tool = formation.follow(*shaped, radius_m=None)
    formation.until_in_slot(within_s=120.0)
    began_s = formation.fly_mission(tool, SPEED_MPS, END_S)
    from_s, to_s = began_s + BEGIN_S, began_s + END_S
    note = formation.note(began_s)
    gaps = [
        truth.figures(ahead.heard.truth, vehicle.heard.truth, from_s, to_s, RADIUS_M)
        for ahead, vehicle in formation.watched()
    ]
    least_m = formation.least_m(began_s, to_s)
    for number, gap in enumerate(gaps):
        case = f"{name} of {followers}, gap {number + 1}"
        flown = Figures(gap.mean_separation_m, gap.mean_abs_error_m, gap.rmsd_m, least_m)
        table.append(Entry(formation.kit.version.line, case, flown, note=note))
    assert least_m >= LEAST_M
    assert max(gap.mean_abs_error_m for gap in gaps) <= MOST_ERROR_M
