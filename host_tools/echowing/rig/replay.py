"""`echowing rig replay`: show a recording as it was."""

import argparse
import time
from pathlib import Path

from echowing.errors import EchowingError
from echowing.rig.board import Board, await_board
from echowing.rig.ports import USB_BAUD
from echowing.rig.recording import RecordingEnd, ReplayWire, read_recording
from echowing.rig.view import open_view
from echowing.rig.watch import watch
from echowing.stopping import stop_on_signals

EXAMPLES = """\
examples:
  echowing rig replay bench.ewr
      at the speed of the recording
  echowing rig replay bench.ewr --fast --json | jq -c '[.time_s, .raw_m]'
"""


# Too short to be sure of a heartbeat, which comes every second.
SHORT_S = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("file", type=Path, metavar="FILE", help="the file of `echowing rig record`")
    parser.add_argument("--fast", action="store_true", help="show it as fast as possible")


def run(args: argparse.Namespace) -> int:
    """Show it to its end."""
    recording = read_recording(args.file)
    wire = ReplayWire(recording, str(args.file), None if args.fast else time.sleep)
    baud = int(recording.about.get("baud", USB_BAUD))
    board = _await_board(wire, args.file, baud, recording.duration_s)
    with stop_on_signals() as stop:
        try:
            watch(board, open_view(as_json=args.json), stop)
        except RecordingEnd as end:
            if not args.json:
                print(end)
    return 0


def _await_board(wire: ReplayWire, path: Path, baud: int, duration_s: float) -> Board:
    """The board in the recording, however late it was heard."""
    try:
        return await_board(wire, str(path), baud, wire.now_s, duration_s, duration_s)
    except EchowingError as error:
        if duration_s > SHORT_S:
            raise
        raise EchowingError(f"{error}; the recording lasts only {duration_s:.1f} s") from error
