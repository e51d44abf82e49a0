"""`echowing demo`: what a newcomer sees first, and while it flies."""

import argparse
import time
from pathlib import Path

import pytest
from rich.console import Console

from echowing.commands import demo

SHORT = "duration_s=30"


def arguments(folder: Path) -> argparse.Namespace:
    return argparse.Namespace(out=folder, jobs=2, firmware="native")


def test_the_comparison_is_flown_first() -> None:
    """Two cores have the first two rows after one flight's time."""
    for seeds in (1, 10):
        tasks = demo.plan(seeds)
        assert [task.scenario for task in tasks[:3]] == ["gray", "echowing", "thesis"]
        assert {task.seed for task in tasks[:3]} == {1}
        assert len(set(tasks)) == len(tasks)
        plain = [task for task in tasks if task.scenario == "gray" and not task.changes]
        assert [task.seed for task in plain] == list(range(1, seeds + 1))


def test_without_a_terminal_lines_tell_of_the_compared_flights_and_of_the_end(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    compared, other = demo.Task("gray", 1, (SHORT,)), demo.Task("gray", 2, (SHORT,))
    monkeypatch.setattr(demo, "COMPARED", {compared: "GPS alone"})
    flown = demo._fly_all([compared, other], arguments(tmp_path))
    out, told = capfd.readouterr()
    assert out == ""  # the table's
    lines = told.splitlines()
    assert lines[0] == "flying 2 flights"
    figures = flown[0].metrics[0]
    (line,) = (line for line in lines if line.startswith("one flight by GPS alone: "))
    assert f"mean error {figures.mean_abs_error_m:.2f} m, RMSD {figures.rmsd_m:.2f} m" in line
    assert lines[-1].startswith("2 of 2 flown, ")


def test_a_line_comes_now_and_then(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    times_s = iter([0.0, 4.0, 11.0, 15.0, 20.0, 22.0, 30.0])
    monkeypatch.setattr(time, "monotonic", lambda: next(times_s))
    with demo._lines(Console(stderr=True), 6) as advance:
        for number in range(6):
            advance(demo.Task("gray", number))
    lines = capfd.readouterr().err.splitlines()[1:]
    assert lines == ["2 of 6 flown, 11 s", "5 of 6 flown, 22 s", "6 of 6 flown, 30 s"]
