"""`echowing leader`: publish a leader's telemetry to a `follow` on another computer."""

import argparse
from pathlib import Path

from echowing.errors import EchowingError

EXAMPLES = """\
examples:
  echowing leader --vehicle /dev/ttyUSB0 --publish udp:192.168.1.20:14600
      and on 192.168.1.20:
  echowing follow --leader-from udp:14600 --follower /dev/ttyUSB0 --engage
Only requests for the leader's clock come back: nothing on the other computer can move the leader.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    from echowing.mavlink.connection import CONN, DEFAULT_BAUD  # noqa: PLC0415 (imported when the verb is used)

    parser.epilog = EXAMPLES
    parser.add_argument(
        "--vehicle",
        required=True,
        metavar="CONN",
        help=f"{CONN}; CONN@ID where several vehicles share the link",
    )
    parser.add_argument(
        "--publish",
        required=True,
        metavar="udp:HOST:PORT",
        help="the computer on which `echowing follow` runs",
    )
    parser.add_argument(
        "--baud", type=int, default=DEFAULT_BAUD, help="baud rate of a serial device"
    )
    parser.add_argument(
        "--rate", type=float, default=4.0, metavar="HZ", help="positions per second, up to 20 (4)"
    )
    parser.add_argument(
        "--signing-key-file", type=Path, metavar="FILE", help="as for `echowing follow`"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Publish until asked to end."""
    from echowing.mavlink.links import parse_address  # noqa: PLC0415
    from echowing.mavlink.seats import parse_seat  # noqa: PLC0415
    from echowing.mavlink.signing import read_key  # noqa: PLC0415
    from echowing.stopping import stop_on_signals  # noqa: PLC0415
    from echowing.terminal import run_in_flight  # noqa: PLC0415
    from echowing.tool.leader import LeaderTool  # noqa: PLC0415

    if not 1.0 <= args.rate <= 20.0:
        raise EchowingError(f"--rate {args.rate:g}: give 1 to 20")
    kind, _, where = args.publish.partition(":")
    if kind != "udp":
        raise EchowingError(f"--publish {args.publish!r}: write udp:HOST:PORT")
    seat = parse_seat("leader", args.vehicle, args.baud)
    key = read_key(args.signing_key_file)
    with stop_on_signals() as stop:
        tool = LeaderTool(seat, parse_address(f"udpout:{where}"), args.rate, stop, signing_key=key)
        return run_in_flight(lambda: tool.run(args.duration), lambda: tool.stuck)
