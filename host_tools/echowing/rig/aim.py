"""`echowing rig aim`: point the gimbal and hold it there."""

import argparse

from echowing.rig.board import Board, CommandError, open_board
from echowing.rig.options import print_json

EXAMPLES = """\
examples:
  echowing rig aim 1380 1400
  echowing rig aim 1500 1300 --json
Pulses in microseconds, 800 to 2200. It holds until `echowing rig scan auto`, or until arming.
"""


# The board reports the pulses once per second, and when they change.
TOLD_TIMEOUT_S = 3.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("pan_us", type=int, metavar="PAN_US", help="pulse of the pan servo")
    parser.add_argument("tilt_us", type=int, metavar="TILT_US", help="pulse of the tilt servo")


def run(args: argparse.Namespace) -> int:
    """Aim, and check the board's report."""
    with open_board(args.port, args.baud) as board:
        board.aim(args.pan_us, args.tilt_us)
        await_aim(board, args.pan_us, args.tilt_us)
    if args.json:
        print_json({"pan_us": args.pan_us, "tilt_us": args.tilt_us})
    else:
        print(
            f"holds at pan {args.pan_us} us, tilt {args.tilt_us} us, until `echowing rig scan auto`"
        )
    return 0


def await_aim(board: Board, pan_us: float, tilt_us: float) -> None:
    """Wait until the board reports that it points there. Raises CommandError when it does not."""
    deadline_s = board.now_s() + TOLD_TIMEOUT_S
    while (board.state.pan_us, board.state.tilt_us) != (pan_us, tilt_us):
        if board.now_s() > deadline_s:
            raise CommandError(
                f"the board points to {board.state.pan_us}, {board.state.tilt_us} us instead: "
                "does another tool move it?"
            )
        board.poll(0.1)
