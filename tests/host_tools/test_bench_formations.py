"""The table of formations: what a row is made from, and what it says."""

import json
from dataclasses import replace

import pytest

from echowing.bench import formations
from echowing.bench.formations import ROWS, Flown, FormationRow, fly_formations, markdown
from echowing.cli import main
from echowing.sim.scenario import load_scenario


def test_each_row_is_the_formation_that_it_names() -> None:
    sizes = {row.name: len(load_scenario(row.scenario, row.changes).slots()) for row in ROWS}
    assert sizes["column of 5"] == sizes["leader turns round, column of 5"] == 5
    assert (sizes["vee of 4"], sizes["diamond of 3"], sizes["column of 12"]) == (4, 3, 12)


def test_gaps_are_pooled_one_by_one_and_the_least_is_that_of_any_flight() -> None:
    flights = (
        Flown((0.1, 0.3), (0.2, 0.4), 2.0),
        Flown((0.3, 0.5), (0.4, 0.8), 0.9),
    )
    row = FormationRow(ROWS[0], flights)
    assert row.mean_errors_m == pytest.approx([0.2, 0.4])
    assert row.rmsds_m == pytest.approx([0.3, 0.6])
    assert (row.least_m, row.under) == (0.9, 1)
    assert markdown([row]).splitlines()[-1] == (
        "| column of 5 | 2 | 0.20 0.40 (0.15) | 0.30 0.60 (0.25) | 0.90 (1.2) | 1 |"
    )


def test_a_row_is_flown_and_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    row = replace(ROWS[0], changes=("duration_s=12", "formation.followers=2"), joined_s=8.0)
    (flown,) = fly_formations(1, lambda: None, [row])
    (flight,) = flown.flights
    assert len(flight.mean_errors_m) == 2
    assert 1.0 < flight.least_m < 6.0
    monkeypatch.setattr(formations, "ROWS", (row,))
    monkeypatch.setattr(formations, "fly_formations", lambda *_: [flown])
    assert main(["bench", "--only", "formations", "--seeds", "1", "--json"]) == 0
    said = {one["what"]: one["value"] for one in json.loads(capsys.readouterr().out)}
    assert said["column of 5: gap 2, RMSD"] == flight.rmsds_m[1]
    assert said["column of 5: least"] == flight.least_m
