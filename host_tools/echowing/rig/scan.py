"""`echowing rig scan`: let the gimbal search, look straight ahead, or decide for itself."""

import argparse

from echowing.rig.board import ScanMode, open_board
from echowing.rig.options import print_json

EXAMPLES = """\
examples:
  echowing rig scan start
  echowing rig scan stop
  echowing rig scan auto
"""

# What to call it on the command line, and what to say when it is done.
MODES = {
    "start": (ScanMode.SCAN, "searches, and stops on what it detects"),
    "stop": (ScanMode.CENTRE, "looks straight ahead"),
    "auto": (
        ScanMode.AUTO,
        "decides for itself: it searches when armed, or without an autopilot",
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("mode", choices=list(MODES), help="search; stop and centre; as in flight")


def run(args: argparse.Namespace) -> int:
    """Tell the board."""
    mode, says = MODES[args.mode]
    with open_board(args.port, args.baud) as board:
        board.scan(mode)
    if args.json:
        print_json({"scan": args.mode})
    else:
        print(f"the gimbal {says}")
    return 0
