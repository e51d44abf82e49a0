"""`echowing rig watch`: the board, live."""

import argparse
import itertools
from collections.abc import Callable

from echowing.rig.board import Board, open_board
from echowing.rig.view import View, open_view
from echowing.stopping import stop_on_signals

EXAMPLES = """\
examples:
  echowing rig watch
  echowing rig watch --port /dev/ttyACM0 --duration 60
  echowing rig watch --json | jq -c '[.time_s, .raw_m]'
      ten objects a second: range_m the running average, raw_m the newest single reading (null:
      nothing detected), points the numbers of the search's point looked at; and one for every
      status text
"""

PERIOD_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Watch until asked to end."""
    with open_board(args.port, args.baud) as board, stop_on_signals() as stop:
        board.ask_parameters()
        board.ask_version()
        watch(board, open_view(as_json=args.json), stop, args.duration)
    return 0


def watch(
    board: Board,
    view: View,
    stop: Callable[[], bool] = lambda: False,
    duration_s: float | None = None,
) -> None:
    """Show the board until `stop`, or for `duration_s`. Raises PortLostError."""
    start_s = board.now_s()
    show_at_s, told = start_s, 0
    try:
        while not stop() and (duration_s is None or board.now_s() - start_s < duration_s):
            board.poll(PERIOD_S)
            now_s = board.now_s()
            told = _tell_texts(board, view, start_s, told)
            if now_s >= show_at_s:
                show_at_s = max(show_at_s + PERIOD_S, now_s)
                view.show(now_s - start_s, board)
    finally:
        view.close()


def _tell_texts(board: Board, view: View, start_s: float, told: int) -> int:
    """Print the texts since the first `told`; returns how many there are now."""
    texts, count = board.state.texts, board.state.counts["STATUSTEXT"]
    new = min(count - told, len(texts))
    for at_s, severity, text in itertools.islice(texts, len(texts) - new, None):
        view.event(max(0.0, at_s - start_s), severity, text)
    return count
