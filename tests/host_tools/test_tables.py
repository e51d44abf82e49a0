"""The tables beside the thesis: what is printed, where, and that it fits a terminal."""

import io
from dataclasses import fields, replace

import pytest
from rich.console import Console

from echowing.analysis.metrics import Metrics
from echowing.analysis.tables import (
    Result,
    answer,
    footnotes,
    grids,
    markdown_tables,
    terminal_table,
)
from echowing.analysis.thesis import TABLE_8, TABLE_10, TABLE_11


def figures(mean_m: float = 3.2, rmsd_m: float = 1.0) -> Metrics:
    values = {item.name: 0.5 for item in fields(Metrics)}
    return Metrics(**{**values, "mean_separation_m": mean_m, "rmsd_m": rmsd_m})  # type: ignore[arg-type]


ALL = [
    Result("gray", figures(4.6, 2.0)),
    Result("thesis", figures(3.5)),
    Result("thesis", figures(40.0, 39.0), dead_locked=True),
    Result("echowing", figures(3.0, 0.5)),
    Result("echowing", figures(3.2, 0.7)),
    Result("thesis-4m", figures(7.0)),
    Result("thesis-initial", figures(6.0)),
    Result("hostile", figures(5.0)),
]


def rows(number: int) -> dict[str, tuple[str, ...]]:
    return {row.cells[0]: row.cells[1:] for row in grids(ALL)[number].rows}


def test_flights_of_one_name_are_pooled_with_their_spread() -> None:
    # 3.0 and 3.2: sample deviation 0.1414
    assert rows(0)["echowing"][:2] == ("2", "3.10±0.14")
    assert rows(0)["hostile"][:2] == ("1", "5.00")


def test_extremes_are_those_of_all_flights() -> None:
    near = replace(figures(), min_separation_m=1.2, max_separation_m=4.0)
    far = replace(figures(), min_separation_m=2.2, max_separation_m=9.0)
    (row,) = grids([Result("hostile", near), Result("hostile", far)])[0].rows
    assert row.cells[6:8] == ("1.20", "9.00")


def test_dead_locks_are_counted_and_the_others_stand_below() -> None:
    assert rows(0)["thesis (1 of 2 dead-locked)"][0] == "2"
    assert rows(0)["thesis, not dead-locked"][:2] == ("1", "3.50")


@pytest.mark.parametrize(
    ("label", "cells"),
    [
        ("  Table 7", ("7.67", "-", "4.76", "3.02")),
        ("  Table 8 [a]", ("6.51", "-", "2.55", "2.51")),
        ("  Table 9 [d]", ("3.08", "0.896", "1.11", "1.11")),
        ("  Table 11, Gray [c]", ("-", "3.08", "1.77", "-")),
    ],
)
def test_the_thesis_stands_beside_as_printed(label: str, cells: tuple[str, ...]) -> None:
    assert rows(0)[label][1:5] == cells


def test_grays_best_test_stands_in_the_position_table() -> None:
    printed = rows(1)["  Table 10, test 2 [b]"]
    assert printed == ("-1.80/1.18/1.21", "0.70/0.85/0.62", "3.08/0.63/1.77")


def test_the_gain_on_gray_is_in_per_cent() -> None:
    # RMSD 2.0 against 0.6
    assert rows(2)["echowing"][0] == "70.0"
    assert rows(2)["  Table 11 [c]"] == ("37.3", "70.9")


def test_no_gain_table_without_gray() -> None:
    assert len(grids([Result("echowing", figures())])) == 2


def test_who_is_compared_goes_by_the_name_that_people_know() -> None:
    """With another law than its own a scenario keeps its name."""
    named = [
        Result("gray", figures(), law="none"),
        Result("thesis", figures(), dead_locked=True, law="thesis"),
        Result("echowing", figures(), law="hold"),
    ]
    labels = [row.cells[0] for row in grids(named)[0].rows if not row.printed]
    assert labels == [
        "GPS alone",
        "GPS and the thesis's speed law (1 of 1 dead-locked)",
        "Echowing",
    ]
    (row, *_) = grids([Result("echowing", figures(), law="bands")])[0].rows
    assert row.cells[0] == "echowing"


def test_the_answer_says_who_keeps_the_distance_best() -> None:
    def result(name: str, law: str, error_m: float, *, lost: bool = False) -> Result:
        return Result(name, replace(figures(), mean_abs_error_m=error_m), lost, law=law)

    ours = [result("echowing", "hold", 0.1), result("echowing", "hold", 0.3)]
    thesis = [result("thesis", "thesis", 0.1, lost=True), result("thesis", "thesis", 2.0)]
    told = answer([result("gray", "none", 1.5), *thesis, *ours])
    assert told == (
        "Mean error of the distance behind one and the same leader: 1.50 m with GPS alone, "
        "0.20 m with Echowing, 2.00 m with GPS and the thesis's speed law "
        "(1 of 2 lost the leader and are left out). Echowing keeps it best."
    )
    assert answer(ours) == ""


def test_every_mark_has_its_footnote_and_no_other_is_printed() -> None:
    marks = {key for row in grids(ALL)[0].rows for key in "abcd" if f"[{key}]" in row.cells[0]}
    noted = {note[1] for note in footnotes(ALL) if note.startswith("[")}
    assert marks <= noted == {"a", "b", "c", "d"}
    assert {note[1] for note in footnotes(ALL[3:4]) if note.startswith("[")} == {"d"}


def test_the_oddities_named_in_the_footnotes_are_in_the_printed_figures() -> None:
    right = TABLE_10[1].right
    assert right is not None and right.drms_m < right.sigma_m
    assert TABLE_8.mean_separation_m is not None and TABLE_8.std_m is not None
    by_definition = ((TABLE_8.mean_separation_m - 3.0) ** 2 + TABLE_8.std_m**2) ** 0.5
    assert by_definition == pytest.approx(4.31, abs=0.01)
    for line in TABLE_11:
        reduced = 100.0 * (1.0 - line.sonar_m / line.gray_m)
        assert reduced == pytest.approx(line.reduced_percent, abs=0.05)


@pytest.mark.parametrize("width", [80, 100, 120])
def test_the_terminal_table_fits_and_loses_no_figure(width: int) -> None:
    console = Console(file=io.StringIO(), width=width)
    console.print(terminal_table(ALL))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    for cell in ("3.10±0.14", "0.896", "3.08/0.63/1.77", "70.9"):
        assert cell in text


def test_markdown_has_a_cell_for_every_column() -> None:
    lines = [line for line in markdown_tables(ALL).splitlines() if line.startswith("|")]
    widths = {line.replace("\\|", "").count("|") for line in lines[:10]}
    assert len(widths) == 1
    assert "| *3.08* | *0.896* |" in markdown_tables(ALL)


def test_an_unknown_figure_is_a_dash() -> None:
    unseen = Result("hostile", replace(figures(), seen_share=float("nan")))
    assert grids([unseen])[0].rows[0].cells[-1] == "-"


def test_n_counts_flights_and_not_followers() -> None:
    swarm = [Result("many", figures(), flight=seed) for seed in (1, 2) for _ in range(3)]
    (row,) = grids(swarm)[0].rows
    assert row.cells[:2] == ("many (3 followers)", "2")


def test_a_mean_over_different_radii_is_not_given() -> None:
    near, far = replace(figures(5.0), wanted_m=5.0), replace(figures(30.0), wanted_m=30.0)
    apart = [Result("many", near, flight=1), Result("many", far, flight=1)]
    (row,) = grids(apart)[0].rows
    n, mean, error, *_, least, most, _seen = row.cells[1:]
    assert (n, mean, most) == ("1", "-", "-")
    assert error != "-"  # each follower's own
    assert least != "-"
    assert any("different radii" in note for note in footnotes(apart))
    assert not any("different radii" in note for note in footnotes(ALL))


def test_what_is_left_out_is_printed() -> None:
    runs = [Result("x", replace(figures(), settle_s=s)) for s in (2.4, 7.25)]
    assert any("2.4 to 7.2 s, the approach" in note for note in footnotes(runs))
    assert not any(
        "approach" in note for note in footnotes([Result("x", replace(figures(), settle_s=0.0))])
    )


def test_a_witness_of_separation_alone_has_no_row_of_places() -> None:
    nan = float("nan")
    nowhere = replace(figures(), slot_error_m=nan, forward_mean_m=nan, right_mean_m=nan)
    sonar = Result("by sonar", nowhere)
    gps = Result("by GPS", figures())
    places = grids([gps, sonar])[1]
    assert [row.cells[0] for row in places.rows] == ["by GPS"]
