"""`echowing rig record`: write every byte from the board to a file, with its time."""

import argparse
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from echowing.rig.board import Board
from echowing.rig.messages import Roster
from echowing.rig.options import print_json
from echowing.rig.ports import PortLostError, find_port, open_wire
from echowing.rig.recording import Recorder
from echowing.stopping import stop_on_signals

EXAMPLES = """\
examples:
  echowing rig record bench.ewr
      until Ctrl-C; then
  echowing rig replay bench.ewr
  echowing rig record bench.ewr --duration 60 --json
Every byte is kept, also bytes that are not MAVLink. If the computer stops, the file keeps what has
arrived.
"""

PERIOD_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("file", type=Path, metavar="FILE", help="a new file")
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Record until asked to end."""
    name = args.port or find_port()
    wire = open_wire(name, args.baud)
    with Board(wire, (0, 0), name=name) as board, stop_on_signals() as stop:
        started = datetime.now(UTC).isoformat(timespec="seconds")
        recorder = Recorder(args.file, {"port": name, "baud": args.baud, "started": started})
        try:
            record(board, recorder, Console(stderr=True), stop, args.duration)
        except PortLostError as error:
            raise PortLostError(f"{error}. {summary(board, recorder)}") from error
        finally:
            recorder.close()
    counts = board.frames.counts
    if args.json:
        print_json({"file": str(args.file), "bytes": counts.bytes, "frames": counts.frames})
    else:
        print(summary(board, recorder))
    return 0


def record(
    board: Board,
    recorder: Recorder,
    console: Console,
    stop: Callable[[], bool],
    duration_s: float | None = None,
) -> None:
    """Record until `stop`, or for `duration_s`. Raises PortLostError."""
    start_s = board.now_s()
    board.tap = lambda now_s, data: recorder.add(now_s - start_s, data)
    roster = Roster()
    with console.status("waiting for the first byte") as status:
        while not stop() and (duration_s is None or board.now_s() - start_s < duration_s):
            roster.note(board.poll(PERIOD_S))
            _ask_once(board, roster)
            status.update(f"{board.now_s() - start_s:.0f} s, {_books(board)}")


def _ask_once(board: Board, roster: Roster) -> None:
    """The parameters and the version must be in the recording: a replay needs them for drawing."""
    boards = roster.boards()
    if boards and board.system_id == 0:
        board.recognise(boards[0], ())
        board.ask_parameters()
        board.ask_version()


def summary(board: Board, recorder: Recorder) -> str:
    """What is in the file."""
    return f"{recorder.path}: {_books(board)}"


def _books(board: Board) -> str:
    counts = board.frames.counts
    return f"{counts.bytes} bytes, {counts.frames} frames, {counts.damaged} damaged"
