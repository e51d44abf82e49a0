"""How `echowing rig watch` shows the board: a live picture, plain lines, or JSON lines."""

from collections import deque
from typing import Any, Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from echowing.rig.board import Board
from echowing.rig.figure import completed, direction, draw, points_at
from echowing.rig.options import print_json
from echowing.rig.state import STALE_S, BoardState
from echowing.terminal import draws_live

PLAIN_PERIOD_S = 1.0
TEXTS_SHOWN = 6
WIDTH = 80
BAR_WIDTH = 40
FULL_SCALE_M = 7.65  # the sonar's farthest
# Silence this long is told: the heartbeat comes every second.
SILENT_S = 2.0

_STATE_STYLES = {
    "tracking": "bold black on green",
    "searching": "bold black on cyan",
    "starting": "bold black on yellow",
    "sonar fault": "bold white on red",
}
_CRITICAL, _WARNING = 2, 4  # MAV_SEVERITY

_RATES = {"range": "DISTANCE_SENSOR", "readings": "SNR_RAW", "heartbeat": "HEARTBEAT"}


class View(Protocol):
    """Where the board is shown; times are seconds since the beginning."""

    def event(self, time_s: float, severity: int, text: str) -> None:
        """The board has said something."""

    def show(self, time_s: float, board: Board) -> None:
        """How it stands; called at 10 Hz."""

    def close(self) -> None:
        """The end."""


def open_view(*, as_json: bool) -> View:
    """JSON lines when asked for, a live picture on a terminal, plain lines elsewhere."""
    if as_json:
        return JsonView()
    return LiveView() if draws_live() else PlainView()


class JsonView:
    """One JSON object per line."""

    def event(self, time_s: float, severity: int, text: str) -> None:
        """As `View`."""
        print_json({"time_s": round(time_s, 3), "severity": severity, "text": text})

    def show(self, time_s: float, board: Board) -> None:
        """As `View`."""
        print_json({"time_s": round(time_s, 3), **snapshot(board)})

    def close(self) -> None:
        """As `View`."""


def snapshot(board: Board) -> dict[str, Any]:
    """The board's state as numbers; None: not told, or nothing there."""
    state, counts = board.state, board.frames.counts
    points = None
    if state.pan_us is not None and state.tilt_us is not None:
        points = points_at(state.parameters, state.pan_us, state.tilt_us)
    return {
        "state": state.state,
        "range_m": state.range_m,
        "raw_m": state.raw_m,
        "signal_quality": state.signal_quality,
        "pan_us": state.pan_us,
        "tilt_us": state.tilt_us,
        "points": points,
        "report_age_s": _rounded(state.report_age_s),
        "rates_hz": {name: round(state.rate_hz(kind), 2) for name, kind in _RATES.items()},
        "warnings": state.errors,
        "restarts": state.restarts,
        "wire": {
            "bytes": counts.bytes,
            "frames": counts.frames,
            "damaged": counts.damaged,
            "garbage_bytes": counts.garbage_bytes,
            "lost": counts.lost,
            "refused": counts.refused,
        },
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


class PlainView:
    """A line a second, and one for everything the board says."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def event(self, time_s: float, severity: int, text: str) -> None:
        """As `View`."""
        print(f"{time_s:7.1f} s  {text}", flush=True)

    def show(self, time_s: float, board: Board) -> None:
        """As `View`."""
        if time_s >= self._next_s:
            self._next_s = time_s + PLAIN_PERIOD_S
            print(f"{time_s:7.1f} s  {plain_line(board)}", flush=True)

    def close(self) -> None:
        """As `View`."""


def plain_line(board: Board) -> str:
    """The state in one line."""
    state = board.state
    return (
        f"{state.state}, range {_range(state)}, reading {_reading(state)}, "
        f"pan {_pulse(state.pan_us)}, tilt {_pulse(state.tilt_us)}, "
        f"{state.rate_hz('DISTANCE_SENSOR'):.1f} ranges/s, {wire_of(board)}"
    )


class LiveView:
    """A picture of the board, and what it has said last under it."""

    def __init__(self, console: Console | None = None) -> None:
        self._texts: deque[Text] = deque(maxlen=TEXTS_SHOWN)
        self._live = Live(console=console, auto_refresh=False)
        self._live.start()

    def event(self, time_s: float, severity: int, text: str) -> None:
        """As `View`."""
        self._texts.append(_told(time_s, severity, text))

    def show(self, time_s: float, board: Board) -> None:
        """As `View`."""
        self._live.update(picture(board, time_s, list(self._texts)), refresh=True)

    def close(self) -> None:
        """As `View`: the last picture stays."""
        self._live.stop()


def _told(time_s: float, severity: int, text: str) -> Text:
    style = "bold red" if severity <= _CRITICAL else "yellow" if severity <= _WARNING else ""
    return Text(f"{time_s:7.1f} s  {text}", style)


def picture(board: Board, time_s: float, texts: list[Text]) -> Panel:
    """All of it, WIDTH columns wide."""
    state = board.state
    parts: list[RenderableType] = [
        _head(state, time_s),
        _ranges(state),
        _gimbal(state),
        _books(board),
        Group(*texts),
    ]
    spaced = [Padding(part, (0, 0, 1, 0)) for part in parts[:-1]]
    return Panel(Group(*spaced, parts[-1]), title=_title(board), title_align="left", width=WIDTH)


def _title(board: Board) -> str:
    version = board.state.version
    firmware = f", firmware {version.firmware} ({version.git_hash})" if version else ""
    return f"Echowing on {board.name}{firmware}"


def _head(state: BoardState, time_s: float) -> Table:
    head = Table.grid(expand=True)
    head.add_column()
    head.add_column(justify="right")
    head.add_row(_condition(state), f"{time_s:.0f} s")
    return head


def _condition(state: BoardState) -> Text:
    """The state, or what is worse."""
    silent_s, age_s = state.silent_s, state.report_age_s
    shown = Text(f" {state.state} ", _STATE_STYLES.get(state.state, "reverse"))
    if silent_s is not None and silent_s > SILENT_S:
        return Text(f" nothing from the board for {silent_s:.0f} s ", "bold white on red")
    if age_s is not None and age_s > STALE_S:
        shown.append(f"  no range for {age_s:.1f} s", "bold red")
    return shown


def _ranges(state: BoardState) -> Table:
    rows = Table.grid(padding=(0, 2))
    rows.add_column(width=7)
    rows.add_column(width=9)
    threshold_m = completed(state.parameters)["TRACK_RANGE"] / 100.0
    rows.add_row("range", _range(state), bar(state.range_m, threshold_m, "green"))
    rows.add_row("reading", _reading(state), bar(state.raw_m, threshold_m, "cyan"))
    quality = "-" if state.signal_quality is None else f"{state.signal_quality} %"
    scale = f"{'0':<{round(threshold_m / FULL_SCALE_M * BAR_WIDTH) - 2}}{threshold_m:.2f} m"
    rows.add_row("quality", quality, Text(scale.ljust(BAR_WIDTH - 4) + "7.65 m", "dim"))
    return rows


def bar(range_m: float | None, threshold_m: float, style: str) -> Text:
    """A range as a bar over the sonar's whole span, a mark where tracking ends."""
    length = 0 if range_m is None else round(min(range_m / FULL_SCALE_M, 1.0) * BAR_WIDTH)
    mark = min(round(threshold_m / FULL_SCALE_M * BAR_WIDTH), BAR_WIDTH - 1)
    shown = Text("█" * length, style)
    shown.append("·" * (BAR_WIDTH - length), "dim")
    return Text.assemble(shown[:mark], ("│", "yellow"), shown[mark + 1 :])


def _range(state: BoardState) -> str:
    if state.range_m is not None:
        return f"{state.range_m:5.2f} m"
    age_s = state.report_age_s
    return "no report" if age_s is None or age_s > STALE_S else "no target"


def _reading(state: BoardState) -> str:
    return "no echo" if state.raw_m is None else f"{state.raw_m:5.2f} m"


def _pulse(pulse_us: float | None) -> str:
    return "-" if pulse_us is None else f"{pulse_us:.0f} us"


def _gimbal(state: BoardState) -> Table:
    words = Table.grid(padding=(0, 2))
    words.add_row("pan", _pulse(state.pan_us))
    words.add_row("tilt", _pulse(state.tilt_us))
    if state.pan_us is not None and state.tilt_us is not None:
        aim = direction(state.parameters, state.pan_us, state.tilt_us)
        points = points_at(state.parameters, state.pan_us, state.tilt_us)
        words.add_row("looks", _sided(aim.right_deg, "right", "left"))
        words.add_row("", _sided(aim.up_deg, "up", "down"))
        words.add_row("point", " = ".join(map(str, points)) if points else "none of the search's")
    both = Table.grid(padding=(0, 4))
    both.add_column(width=36)
    both.add_row(words, draw(state.parameters, state.pan_us, state.tilt_us))
    return both


def _sided(angle_deg: float, positive: str, negative: str) -> str:
    return f"{abs(angle_deg):.1f} deg {positive if angle_deg >= 0.0 else negative}"


def _books(board: Board) -> Table:
    state = board.state
    rates = ", ".join(f"{name} {state.rate_hz(kind):.1f} Hz" for name, kind in _RATES.items())
    rows = Table.grid(padding=(0, 2))
    rows.add_row("rates", rates)
    rows.add_row("wire", wire_of(board))
    if state.restarts or state.errors:
        rows.add_row("board", Text(f"restarts {state.restarts}, warnings {state.errors}", "yellow"))
    return rows


def wire_of(board: Board) -> str:
    """What has come in from a board, counted."""
    counts, refused = board.frames.counts, board.frames.door.news
    text = (
        f"{counts.frames} frames, {counts.lost} lost, {counts.damaged} damaged, "
        f"{counts.garbage_bytes} stray bytes"
    )
    return f"{text}, {counts.refused} refused: {refused[-1]}" if refused else text
