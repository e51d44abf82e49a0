"""The figures `echowing bench` prints of the binary, within the limits beside them."""

import re
from pathlib import Path

import pytest

from echowing.bench.firmware import FirmwareFigure, firmware_figures

from .bench import BOARD

SPEED = "emulated board, simulated per wall"  # this machine's business, not the firmware's


@pytest.fixture(scope="module")
def figures(elf: Path) -> dict[str, FirmwareFigure]:
    """All of them, by name."""
    assert elf.exists()
    return {figure.what: figure for figure in firmware_figures(BOARD.name)}


@pytest.mark.parametrize(
    "what",
    [
        f"{BOARD.name}: flash",
        f"{BOARD.name}: static RAM",
        "power-on to first report",
        "reading to last byte of its report",
        "jitter of the reports",
        "command to acknowledgement",
        "error of the servo pulses",
        "longest loop turn",
        "stack head-room",
        "bytes lost by the receivers",
    ],
)
def test_figure_is_within_its_limit(figures: dict[str, FirmwareFigure], what: str) -> None:
    figure = figures[what]
    found = re.search(r"(under|over)? ?(\d+)$", figure.goal)
    assert found is not None
    limit = float(found[2])
    if found[1] == "over":
        assert figure.value > limit
    elif found[1] == "under":
        assert figure.value < limit
        # An STM32 timer counts whole microseconds: its pulses are exact. All else takes time.
        assert figure.value > 0 or what == "error of the servo pulses"
    else:
        assert figure.value == limit


def test_speed_is_among_them(figures: dict[str, FirmwareFigure]) -> None:
    assert figures[SPEED].value > 0
