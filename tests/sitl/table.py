"""The table at the end: what was measured, beside what the built-in simulator says."""

from collections.abc import Iterable
from dataclasses import dataclass

from echowing.analysis.metrics import Metrics


@dataclass(frozen=True, slots=True)
class Figures:
    """Separation of a flight, metres; None: not asked for."""

    mean_m: float | None = None
    error_m: float | None = None
    rmsd_m: float | None = None
    least_m: float | None = None

    @classmethod
    def of(cls, flown: Metrics) -> "Figures":
        """All four, of one pair."""
        return cls(
            flown.mean_separation_m, flown.mean_abs_error_m, flown.rmsd_m, flown.min_separation_m
        )


@dataclass(frozen=True, slots=True)
class Entry:
    """One flight. note: what else is to be known of it, a machine that was too slow above all."""

    version: str
    case: str
    flown: Figures
    simulated: Figures | None = None
    note: str = ""


HEAD = (
    *("version", "case", "mean", "error", "RMSD", "least"),
    *("sim mean", "sim error", "sim RMSD", "sim least", "remark"),
)
UNITS = 4  # columns of metres in each half


def lines(entries: Iterable[Entry]) -> list[str]:
    """A Markdown table, the entries as they were flown."""
    rows = [HEAD, *map(_row, entries)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
    rule = ["-" * width for width in widths]
    return [_line(row, widths) for row in (rows[0], rule, *rows[1:])]


def _line(cells: Iterable[str], widths: Iterable[int]) -> str:
    padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
    return f"| {' | '.join(padded)} |"


def _row(entry: Entry) -> tuple[str, ...]:
    return (
        entry.version,
        entry.case,
        *_cells(entry.flown),
        *_cells(entry.simulated or Figures()),
        entry.note,
    )


def _cells(figures: Figures) -> tuple[str, ...]:
    values = (figures.mean_m, figures.error_m, figures.rmsd_m, figures.least_m)
    return tuple("" if value is None else f"{value:.2f}" for value in values)


def agrees(flown: float, simulated: float, *, within_m: float, within_share: float) -> bool:
    """Whether a figure is that of the simulator within a distance or a share, whichever is more."""
    return abs(flown - simulated) <= max(within_m, within_share * abs(simulated))
