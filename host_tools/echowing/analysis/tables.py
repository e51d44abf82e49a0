"""Results beside the thesis's figures: for the terminal (rich), for the README (Markdown).

Both are made from the same `Grid`s of text, so that they agree.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from echowing.analysis.metrics import APPROACHED_M, Metrics, Spread, aggregate
from echowing.analysis.thesis import BESIDE, FOOTNOTES, TABLE_11, ErrorFigures, ThesisFigures

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

NOTHING = "-"
# The scenarios that are compared, each with its law, as people call them.
CALLED = {
    ("gray", "none"): "GPS alone",
    ("echowing", "hold"): "Echowing",
    ("thesis", "thesis"): "GPS and the thesis's speed law",
}
_COMPARED = tuple(name for name, _ in CALLED)
SAME_RADIUS_M = 0.01


@dataclass(frozen=True)
class Result:
    """One follower of one flight. Results of one name are pooled into one row, in order.

    A name of `thesis.BESIDE` gets the thesis's figures printed under it. flight: which flight it
    is of, the seed say; the followers of one flight have the same. law: that it was flown with.
    """

    name: str
    metrics: Metrics
    dead_locked: bool = False
    flight: object = None
    law: str = ""


@dataclass(frozen=True)
class Row:
    """One line of text cells; `printed`: the thesis's figures, not ours."""

    cells: tuple[str, ...]
    printed: bool = False


@dataclass(frozen=True)
class Grid:
    """One table as text, the first column a label."""

    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]


def grids(results: Sequence[Result]) -> list[Grid]:
    """Separation; position error as in Table 10; the gain on `gray` as in Table 11."""
    pools = list(_pools(results))
    return [
        Grid(
            "Separation, m (mean ± deviation over the flights; min, max of all)",
            ("flight", "n", "mean", "mean |e|", "RMSD", "sigma", "min", "max", "seen"),
            _rows(pools, _separation_cells, _thesis_separation),
        ),
        Grid(
            "Position error, m: mean/sigma/DRMS (± deviation over the flights)",
            ("flight", "forward", "right", "to the slot"),
            _rows(pools, _position_cells, _thesis_position),
        ),
        *_gain(pools),
    ]


def called(name: str, law: str) -> str:
    """A scenario's name as people say it; with another law than its own it has none."""
    return CALLED.get((name, law), name)


def answer(results: Sequence[Result]) -> str:
    """What is compared, and who keeps the distance best, in one sentence; nothing: one alone."""
    parts, means = [], {}
    for (name, law), said in CALLED.items():
        runs = [result for result in results if (result.name, result.law) == (name, law)]
        free = [run.metrics.mean_abs_error_m for run in runs if not run.dead_locked]
        if not free:
            continue
        means[said] = sum(free) / len(free)
        lost = len(runs) - len(free)
        left_out = f" ({lost} of {len(runs)} lost the leader and are left out)" if lost else ""
        parts.append(f"{means[said]:.2f} m with {said}{left_out}")
    if len(means) < 2:
        return ""
    best = min(means, key=lambda said: means[said])
    return (
        f"Mean error of the distance behind one and the same leader: {', '.join(parts)}. "
        f"{best} keeps it best."
    )


def footnotes(results: Sequence[Result]) -> list[str]:
    """Footnotes on the figures of the thesis in these tables."""
    keys = {
        key for name in _names(results) for printed in BESIDE.get(name, ()) for key in printed.notes
    }
    ours = (
        "Ours: RMSD and DRMS are sqrt(mean(e^2)), e = separation - wanted; sigma is about the "
        "mean; seen is the share of time with a sonar reading. "
        "Rows named Table N are the thesis's, as printed."
    )
    notes = [ours, *_approach_note(results)]
    if any(_radii_differ(pool.runs) for pool in _pools(results)):
        notes.append(
            "Where followers have different radii a mean separation means nothing: the errors are "
            "each follower's own, and the slot error is in the next table."
        )
    return [*notes, *(f"[{key}] {FOOTNOTES[key]}" for key in sorted(keys))]


def _approach_note(results: Sequence[Result]) -> list[str]:
    """A note on the seconds left out of the flights."""
    times_s = sorted(result.metrics.settle_s for result in results)
    if not times_s or times_s[-1] == 0.0:
        return []
    span = (
        f"{times_s[0]:.1f} to {times_s[-1]:.1f}"
        if times_s[0] < times_s[-1]
        else f"{times_s[0]:.1f}"
    )
    return [
        f"Left out at the beginning of a flight: {span} s, the approach until first within "
        f"{APPROACHED_M:g} m of the slot, or as its scenario or --settle says."
    ]


def _radii_differ(runs: Sequence[Metrics]) -> bool:
    wanted_m = [run.wanted_m for run in runs]
    return max(wanted_m) - min(wanted_m) > SAME_RADIUS_M


def terminal_table(results: Sequence[Result]) -> "Group":
    """The tables and footnotes for rich's Console.print; at home in 100 columns."""
    from rich.console import Group  # noqa: PLC0415 (imported when a table is wanted)
    from rich.padding import Padding  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    notes = "\n".join(footnotes(results))
    parts = map(terminal_grid, grids(results))
    return Group(*parts, Padding(Text(notes, style="dim"), (0, 1)))


def terminal_grid(grid: Grid) -> "Table":
    """One table for rich."""
    from rich import box  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    table = Table(
        title=grid.title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        collapse_padding=True,
        pad_edge=False,
    )
    for number, heading in enumerate(grid.head):
        table.add_column(
            heading,
            justify="right" if number else "left",
            no_wrap=bool(number),
            overflow="fold",
        )
    for row in grid.rows:
        table.add_row(*map(Text, row.cells), style="dim" if row.printed else "")
    return table


def markdown_tables(results: Sequence[Result]) -> str:
    """The same for the README; the thesis's rows in italics."""
    parts = []
    for grid in grids(results):
        lines = [
            f"**{grid.title}**",
            "",
            _markdown_row(grid.head),
            _markdown_row(["---", *["---:"] * (len(grid.head) - 1)]),
            *(_markdown_row(_italic(row)) for row in grid.rows),
        ]
        parts.append("\n".join(lines))
    parts.append("\n".join(f"- {note}" for note in footnotes(results)))
    return "\n\n".join(parts) + "\n"


def _names(results: Sequence[Result]) -> list[str]:
    return list(dict.fromkeys(result.name for result in results))


@dataclass(frozen=True)
class _Pool:
    """The flights of one row, and what the thesis printed to stand under it."""

    name: str
    label: str
    runs: list[Metrics]
    flights: int
    printed: tuple[ThesisFigures, ...]


def _pools(results: Sequence[Result]) -> Iterable[_Pool]:
    """A row for each name; a name with dead-locks gets a second one over the other flights."""
    for name in _names(results):
        runs = [result for result in results if result.name == name]
        free = [run for run in runs if not run.dead_locked]
        locked = len(runs) - len(free)
        printed = BESIDE.get(name, ())
        said = called(name, runs[0].law)
        label = _label(said, runs, locked)
        yield _pool(name, label, runs, () if locked and free else printed)
        if locked and free:
            yield _pool(name, f"{said}, not dead-locked", free, printed)


def _pool(
    name: str, label: str, runs: Sequence[Result], printed: tuple[ThesisFigures, ...]
) -> _Pool:
    return _Pool(name, label, [run.metrics for run in runs], _flights(runs), printed)


def _flights(runs: Sequence[Result]) -> int:
    """How many flights these followers flew in; one each where it is not said."""
    said = {run.flight for run in runs if run.flight is not None}
    return len(said) + sum(run.flight is None for run in runs)


def _label(name: str, runs: Sequence[Result], locked: int) -> str:
    parts = []
    if len(runs) > _flights(runs):
        parts.append(f"{len(runs) // _flights(runs)} followers")
    if locked:
        parts.append(f"{locked} of {len(runs)} dead-locked")
    return f"{name} ({', '.join(parts)})" if parts else name


def _rows(
    pools: Sequence[_Pool],
    ours: Callable[[dict[str, Spread], _Pool], list[str]],
    theirs: Callable[[ThesisFigures], list[str]],
) -> tuple[Row, ...]:
    rows = []
    for pool in pools:
        cells = ours(aggregate(pool.runs), pool)
        if any(cell != NOTHING for cell in cells):
            rows.append(Row((pool.label, *cells)))
        for printed in pool.printed:
            cells = theirs(printed)
            if any(cell not in ("", NOTHING) for cell in cells):
                rows.append(Row((_marked(printed), *cells), printed=True))
    return tuple(rows)


def _gain(pools: Sequence[_Pool]) -> list[Grid]:
    """How much smaller than Gray's the errors are, where both were flown."""
    figures = [(pool, aggregate(pool.runs)) for pool in pools if pool.name in _COMPARED]
    gray = next((theirs for pool, theirs in figures if pool.name == "gray"), None)
    others = [(pool.label, ours) for pool, ours in figures if pool.name != "gray"]
    if gray is None or not others:
        return []
    rows = [
        Row((label, *(_reduced(gray[key].mean, ours[key].mean) for key in _GAIN_FIGURES)))
        for label, ours in others
    ]
    printed = tuple(f"{line.reduced_percent:.1f}" for line in TABLE_11)
    rows.append(Row(("  Table 11 [c]", *printed), printed=True))
    return [Grid("Error reduced against GPS alone, %", ("flight", "RMSD", "mean |e|"), tuple(rows))]


_GAIN_FIGURES = ("rmsd_m", "mean_abs_error_m")  # in the order of TABLE_11


def _reduced(gray_m: float, ours_m: float) -> str:
    return f"{100.0 * (1.0 - ours_m / gray_m):.1f}"


def _marked(printed: ThesisFigures) -> str:
    marks = f" [{','.join(printed.notes)}]" if printed.notes else ""
    return f"  {printed.title}{marks}"


def _separation_cells(spread: dict[str, Spread], pool: _Pool) -> list[str]:
    differ = _radii_differ(pool.runs)
    return [
        str(pool.flights),
        NOTHING if differ else _cell(spread["mean_separation_m"]),
        *(_cell(spread[f]) for f in ("mean_abs_error_m", "rmsd_m", "std_m")),
        _number(spread["min_separation_m"].lowest),
        NOTHING if differ else _number(spread["max_separation_m"].highest),
        _percent(spread["seen_share"].mean),
    ]


def _thesis_separation(printed: ThesisFigures) -> list[str]:
    values = (printed.mean_separation_m, printed.mean_abs_error_m, printed.rmsd_m, printed.std_m)
    return ["", *map(_printed, values), NOTHING, NOTHING, NOTHING]


def _position_cells(spread: dict[str, Spread], _pool: _Pool) -> list[str]:
    return [
        _triple(spread["forward_mean_m"], spread["forward_sigma_m"], spread["forward_drms_m"]),
        _triple(spread["right_mean_m"], spread["right_sigma_m"], spread["right_drms_m"]),
        _to_the_slot(spread),
    ]


def _to_the_slot(spread: dict[str, Spread]) -> str:
    mean, rest = spread["slot_error_m"], ("position_sigma_m", "position_drms_m")
    if mean.count == 0:
        return NOTHING
    return "/".join([_cell(mean), *(_number(spread[name].mean) for name in rest)])


def _triple(mean: Spread, sigma: Spread, drms: Spread) -> str:
    if mean.count == 0:
        return NOTHING
    return "/".join(_number(figure.mean) for figure in (mean, sigma, drms))


def _thesis_position(printed: ThesisFigures) -> list[str]:
    return [_figures(group) for group in (printed.forward, printed.right, printed.position)]


def _figures(figures: ErrorFigures | None) -> str:
    if figures is None:
        return NOTHING
    values = (figures.mean_m, figures.sigma_m, figures.drms_m)
    return "/".join(_printed(value) for value in values)


def _cell(spread: Spread) -> str:
    """Mean and, over several flights, the deviation."""
    if spread.count == 0:
        return NOTHING
    if spread.count == 1:
        return _number(spread.mean)
    return f"{_number(spread.mean)}±{_number(spread.std)}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return NOTHING
    return f"{value:.2f}" if abs(value) < 99.995 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{share:.0%}" if math.isfinite(share) else NOTHING


def _printed(value: float | None) -> str:
    """As the thesis has it, to its own number of places."""
    if value is None:
        return NOTHING
    return f"{value:.3f}" if round(value, 2) != value else f"{value:.2f}"


def _markdown_row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _italic(row: Row) -> list[str]:
    cells = [cell.strip() for cell in row.cells]
    return [f"*{cell}*" if row.printed and cell else cell for cell in cells]
