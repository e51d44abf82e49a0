"""The views of `echowing follow`: a live table, plain lines, or JSON lines."""

import json
import sys
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from textwrap import TextWrapper
from typing import Protocol

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.segment import Segment
from rich.text import Text

from echowing.terminal import draws_live
from echowing.tool.health import health, in_words, leaders_words
from echowing.tool.panel import Row
from echowing.tool.table import FollowerTable

PLAIN_PERIOD_S = 5.0
JSON_PERIOD_S = 1.0
# More than most screens have room for: the table before engaging takes several.
EVENTS_SHOWN = 24
# Width of an event's time, "   12.3 s  "; its text stays to the right of it.
TIME_WIDTH = 11
TABLE_HZ = 4.0
# Drawing a row takes about 0.6 ms; this many rows per second are enough.
ROWS_PER_S = 40.0


class View(Protocol):
    """Where events and rows are shown."""

    def event(self, time_s: float, text: str) -> None:
        """Something has happened."""

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """The newest rows; called at 10 Hz."""

    def keys(self, text: str) -> None:
        """What the keys do now."""

    def close(self) -> None:
        """The end."""


class LastingView:
    """A view whose failure does not end the flight: what cannot be shown is left out.

    lost: why nothing is shown, after the terminal or the reader of a pipe has gone.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self.lost: OSError | None = None

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        self._try(lambda: self._view.event(time_s, text))

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        self._try(lambda: self._view.rows(time_s, rows))

    def keys(self, text: str) -> None:
        """As `View`."""
        self._try(lambda: self._view.keys(text))

    def close(self) -> None:
        """As `View`."""
        self._try(self._view.close)

    def _try(self, show: Callable[[], None]) -> None:
        if self.lost is not None:
            return
        try:
            show()
        except OSError as error:
            self.lost = error


def open_view(*, as_json: bool) -> View:
    """JSON lines when asked for, a live table on a terminal, plain lines elsewhere."""
    if isinstance(sys.stdout, TextIOWrapper):
        # A vehicle's text may contain characters that the terminal does not have.
        sys.stdout.reconfigure(errors="backslashreplace")
    if as_json:
        return JsonView()
    return LiveView() if draws_live() else PlainView()


class PlainView:
    """A line per event, and a line per follower now and then."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        print(f"{time_s:7.1f} s  {text}", flush=True)

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        if time_s < self._next_s:
            return
        self._next_s = time_s + PLAIN_PERIOD_S
        if rows:
            self.event(time_s, plain_leader(rows[0]))
        for row in rows:
            self.event(time_s, plain_row(row))

    def keys(self, text: str) -> None:
        """As `View`; keys are not shown here."""

    def close(self) -> None:
        """As `View`."""


class JsonView:
    """One JSON object per line: events as they come, rows once per second."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        print(json.dumps({"time_s": round(time_s, 3), "event": text}), flush=True)

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        if time_s < self._next_s:
            return
        self._next_s = time_s + JSON_PERIOD_S
        for row in rows:
            print(json.dumps(row.as_dict()), flush=True)

    def keys(self, text: str) -> None:
        """As `View`; keys are not shown here."""

    def close(self) -> None:
        """As `View`."""


class LiveView:
    """A table with a row per follower, and the last events under it."""

    def __init__(self, console: Console | None = None) -> None:
        self._events: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._rows: Sequence[Row] = ()
        self._keys = ""
        self._next_s = 0.0
        # Drawn by the caller: Rich's own thread would delay the points.
        self._live = Live(console=console, auto_refresh=False, transient=False)
        self._live.start()

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        self._events.append(f"{time_s:7.1f} s  {text}")
        if not self._rows:  # else it is drawn with them
            self._update()

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        self._rows = rows
        if time_s >= self._next_s:
            self._next_s = time_s + max(1.0 / TABLE_HZ, len(rows) / ROWS_PER_S)
            self._update()

    def keys(self, text: str) -> None:
        """As `View`: in the first line, drawn at once, because a key was pressed."""
        self._keys = text
        self._update()

    def _update(self) -> None:
        self._live.update(Screenful(self._rows, list(self._events), self._keys), refresh=True)

    def close(self) -> None:
        """As `View`: the table stays on the terminal, with the last events under it."""
        self._keys = ""
        self._update()
        self._live.stop()


def scene(rows: Sequence[Row], events: Iterable[str]) -> RenderableType:
    """The whole view: the table, if there is one, and under it the events."""
    return Group(*_above(rows, ""), Events(list(events)))


@dataclass(frozen=True, slots=True)
class Events:
    """Lines of events; a long one wraps under its text."""

    lines: Sequence[str]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Rich's protocol."""
        del console
        wrapper = TextWrapper(
            max(options.max_width, 2 * TIME_WIDTH),
            subsequent_indent=" " * TIME_WIDTH,
            break_on_hyphens=False,
        )
        for line in self.lines:
            yield Text("\n".join(wrapper.wrap(line)))


@dataclass(frozen=True, slots=True)
class Screenful:
    """The same with the keys. If the screen is too low, only the newest events are shown."""

    rows: Sequence[Row]
    events: Sequence[str]
    keys: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Rich's protocol."""
        above = Group(*_above(self.rows, self.keys))
        room = console.size.height - len(console.render_lines(above, options, pad=False))
        yield above
        lines = console.render_lines(Events(self.events), options, pad=False)
        for line in lines[-max(1, room) :]:
            yield from line
            yield Segment.line()


def _above(rows: Sequence[Row], keys: str) -> list[RenderableType]:
    """What stands above the events; the keys first, as a high table leaves no room under it."""
    shown: list[RenderableType] = []
    if keys:
        shown.append(Text(keys, style="reverse" if "?" in keys else "dim"))
    if rows:
        shown += [FollowerTable(rows), health(rows)]
    return shown


def plain_row(row: Row) -> str:
    """The same in one line."""
    if row.own.mode is None and row.age_s is None:
        return f"follower {row.system_id}: no report yet"
    return (
        f"follower {row.system_id}: {row.state}, {row.own.mode or 'mode not known'}, "
        f"separation {_from(row)}{_shown(row.separation_m, 'm')} "
        f"({_shown(row.error_m, 'm', '+.2f')}), "
        f"sonar {_shown(row.sonar_m, 'm')}, {_shown(row.speed_mps, 'm/s', '.1f')} "
        f"of {_shown(row.command_mps, 'm/s', '.1f')}, {_shown(row.own.altitude_m, 'm', '.1f')} up, "
        f"leader {_shown(row.leader_age_s, 's')} old, link {_shown(row.link_percent, '%', '.0f')}"
        + "".join(f", {text}" for text, _ in in_words(row.own))
    )


def _from(row: Row) -> str:
    return "" if row.watches is None else f"from {row.watches} "


def plain_leader(row: Row) -> str:
    """The leader in one line."""
    return "leader: " + ", ".join(text for text, _ in leaders_words(row.leader))


def _shown(value: float | None, unit: str, form: str = ".2f") -> str:
    return "-" if value is None else f"{value:{form}} {unit}"
