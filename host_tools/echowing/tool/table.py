"""The followers as a table that fits the terminal: a line per vehicle, or two on a narrow one.

Numbers are never cut. The reason of a state stands under the table.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from echowing.tool.panel import FOLLOWING, Row

# Least width of the terminal for each layout; below the second, two lines per vehicle.
ROOMY, TIGHT = 118, 80


@dataclass(frozen=True, slots=True)
class Number:
    """A column of numbers: which value of `Row`, and how many decimals at most."""

    value: str
    head: str
    short: str
    unit: str
    width: int
    decimals: int = 2
    signed: bool = False


SEPARATION = Number("separation_m", "separation", "apart", "m", 6)
ERROR = Number("error_m", "error", "error", "m", 6, signed=True)
SONAR = Number("sonar_m", "sonar", "sonar", "m", 5)
OTHERS = (
    Number("age_s", "age", "age", "s", 5),
    Number("speed_mps", "speed", "speed", "m/s", 5, decimals=1),
    Number("command_mps", "limit", "limit", "m/s", 5, decimals=1),
    Number("own.altitude_m", "height", "height", "m", 6, decimals=1),
    Number("link_percent", "link", "link", "%", 4, decimals=0),
)
NUMBERS = (SEPARATION, ERROR, SONAR, *OTHERS)
# Short words for a narrow column.
GIMBAL = {"starting": "start", "searching": "search", "tracking": "track", "sonar fault": "fault"}
STATE_WIDTH, MODE_WIDTH, GIMBAL_WIDTH, ID_WIDTH = 11, 6, 6, 3


@dataclass(frozen=True, slots=True)
class FollowerTable:
    """The rows, laid out for the width of the terminal."""

    rows: Sequence[Row]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Rich's protocol."""
        del console
        yield Text(_leader(self.rows[0]), style="bold")
        if options.max_width < TIGHT:
            yield from _two_lines(self.rows)
        else:
            yield _one_line(self.rows, roomy=options.max_width >= ROOMY)
        yield from _notes(self.rows)


def _leader(row: Row) -> str:
    """What the rows share: the leader's speed and the age of its report."""
    speed = "-" if row.leader_speed_mps is None else f"{row.leader_speed_mps:.1f} m/s"
    age = "no report" if row.leader_age_s is None else f"last report {row.leader_age_s:.2f} s ago"
    return f"leader: {speed}, {age}"


def _one_line(rows: Sequence[Row], *, roomy: bool) -> Table:
    shown = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1) if roomy else (0, 0),
        show_edge=False,
    )
    _add_words(shown, "", ID_WIDTH, roomy=roomy)
    _add_words(shown, "state", STATE_WIDTH, roomy=roomy)
    _add_words(shown, "mode", MODE_WIDTH, roomy=roomy)
    for number in (SEPARATION, ERROR, SONAR):
        _add(shown, number, roomy=roomy)
    _add_words(shown, "gimbal", GIMBAL_WIDTH, roomy=roomy)
    for number in OTHERS:
        _add(shown, number, roomy=roomy)
    for row in rows:
        gimbal = row.gimbal or "-"
        shown.add_row(
            str(row.system_id),
            _state(row),
            _mode(row),
            *(_cell(row, number) for number in (SEPARATION, ERROR, SONAR)),
            gimbal if roomy else GIMBAL.get(gimbal, gimbal),
            *(_cell(row, number) for number in OTHERS),
        )
    return shown


def _add_words(shown: Table, head: str, width: int, *, roomy: bool) -> None:
    """A column whose words wrap inside it."""
    shown.add_column(head, width=None if roomy else width, min_width=width, overflow="fold")


def _add(shown: Table, number: Number, *, roomy: bool) -> None:
    head = f"{number.head if roomy else number.short}\n{number.unit}"
    shown.add_column(head, justify="right", min_width=number.width, no_wrap=True)


def _two_lines(rows: Sequence[Row]) -> Iterator[Text]:
    """Per vehicle a line with its state, and under it the numbers, in columns."""
    yield Text(_columns(number.short for number in NUMBERS), style="bold")
    yield Text(_columns(number.unit for number in NUMBERS), style="bold")
    for row in rows:
        first = Text(f"{row.system_id:<{ID_WIDTH}} ")
        rest = (_mode(row), row.gimbal)
        first.append_text(_state(row)).append("".join(f", {text}" for text in rest if text))
        yield first
        yield Text(_columns(_cell(row, number) for number in NUMBERS))


def _columns(cells: Iterable[str]) -> str:
    padded = (f"{cell:>{number.width}}" for cell, number in zip(cells, NUMBERS, strict=True))
    return " " * (ID_WIDTH + 1) + " ".join(padded)


def _notes(rows: Sequence[Row]) -> Iterator[Text]:
    """Under the table: why a follower is not led, and whom it watches, if not the leader."""
    for row in rows:
        _, _, reason = row.state.partition(": ")
        _, _, flying = (row.own.mode or "").partition(", ")
        watched = "" if row.watches is None else f"separation from {row.watches}"
        said = ", ".join(text for text in (reason, flying, watched) if text)
        if said:
            yield Text(f"{row.system_id}: {said}", style=_style(row.state))


def _state(row: Row) -> Text:
    return Text(row.state.partition(": ")[0], style=_style(row.state))


def _mode(row: Row) -> str:
    return (row.own.mode or "-").partition(", ")[0]


def _style(state: str) -> str:
    """Green: following; yellow: stopped or on its way; red: receives no points."""
    if state.startswith(FOLLOWING):
        return "green"
    return "red" if state.startswith(("no points sent", "not engaged")) else "yellow"


def _cell(row: Row, number: Number) -> str:
    """The number, with as many decimals as fit into its column; "-": not known."""
    value: float | None = attrgetter(number.value)(row)
    if value is None:
        return "-"
    sign = "+" if number.signed else ""
    for decimals in range(number.decimals, -1, -1):
        text = f"{value:{sign}.{decimals}f}"
        if len(text) <= number.width:
            return text
    return f"{value:{sign}.0e}"
