"""How `echowing follow` shows itself: a live table, plain lines, or JSON lines."""

import json
import sys
from collections import deque
from collections.abc import Sequence
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from echowing.panel import Row

PLAIN_PERIOD_S = 5.0
JSON_PERIOD_S = 1.0
EVENTS_SHOWN = 8
TABLE_HZ = 4.0


class View(Protocol):
    """Where events and rows are shown."""

    def event(self, time_s: float, text: str) -> None:
        """Something has happened."""

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """How it stands; called at 10 Hz."""

    def close(self) -> None:
        """The end."""


def open_view(*, as_json: bool) -> View:
    """JSON lines when asked for, a live table on a terminal, plain lines elsewhere."""
    if as_json:
        return JsonView()
    return LiveView() if sys.stdout.isatty() else PlainView()


class PlainView:
    """A line an event, and a line a follower now and then."""

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
        for row in rows:
            self.event(time_s, plain_row(row))

    def close(self) -> None:
        """As `View`."""


class JsonView:
    """One JSON object a line: events as they come, rows once a second."""

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

    def close(self) -> None:
        """As `View`."""


class LiveView:
    """A table with a row a follower, and the last events under it."""

    def __init__(self, console: Console | None = None) -> None:
        self._events: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._rows: Sequence[Row] = ()
        self._live = Live(console=console, refresh_per_second=TABLE_HZ, transient=False)
        self._live.start()

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        self._events.append(f"{time_s:7.1f} s  {text}")
        self._update()

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        self._rows = rows
        self._update()

    def _update(self) -> None:
        events = Text("\n".join(self._events))
        self._live.update(Group(table(self._rows), events) if self._rows else events)

    def close(self) -> None:
        """As `View`: the table stays, the last events under it."""
        self._live.stop()


def table(rows: Sequence[Row]) -> Table:
    """The rows as a table."""
    shown = Table(
        *("follower", "state", "mode", "separation", "error", "sonar", "gimbal"),
        *("leader's age", "age", "limit", "speed", "height", "link"),
    )
    for row in rows:
        shown.add_row(
            str(row.system_id),
            row.state,
            row.mode,
            _shown(row.separation_m, "m"),
            _shown(row.error_m, "m", "+.2f"),
            _shown(row.sonar_m, "m"),
            row.gimbal or "-",
            _shown(row.leader_age_s, "s"),
            _shown(row.age_s, "s"),
            _shown(row.command_mps, "m/s", ".1f"),
            _shown(row.speed_mps, "m/s", ".1f"),
            _shown(row.altitude_m, "m", ".1f"),
            _shown(row.link_percent, "%", ".0f"),
        )
    return shown


def plain_row(row: Row) -> str:
    """The same in one line."""
    return (
        f"follower {row.system_id}: {row.state}, {row.mode}, "
        f"separation {_shown(row.separation_m, 'm')} ({_shown(row.error_m, 'm', '+.2f')}), "
        f"sonar {_shown(row.sonar_m, 'm')}, {_shown(row.speed_mps, 'm/s', '.1f')} "
        f"of {_shown(row.command_mps, 'm/s', '.1f')}, {_shown(row.altitude_m, 'm', '.1f')} up, "
        f"leader {_shown(row.leader_age_s, 's')} old, link {_shown(row.link_percent, '%', '.0f')}"
    )


def _shown(value: float | None, unit: str, form: str = ".2f") -> str:
    return "-" if value is None else f"{value:{form}} {unit}"
