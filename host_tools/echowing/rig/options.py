"""The options that `echowing rig` and all its verbs have: given before the verb, or after."""

import argparse
import json
from typing import Any

from echowing.mavlink.connection import CONN
from echowing.rig.ports import USB_BAUD


def add_common_options(parser: argparse.ArgumentParser) -> None:
    """`--port`, `--baud`, `--json`; not given, they leave what was given elsewhere."""
    parser.add_argument(
        "--port",
        metavar="CONN",
        default=argparse.SUPPRESS,
        help=f"the board's connection: {CONN} (the only serial port on USB)",
    )
    parser.add_argument(
        "--baud",
        type=int,
        metavar="N",
        default=argparse.SUPPRESS,
        help=f"baud rate of a serial device ({USB_BAUD})",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        default=argparse.SUPPRESS,
        help="print JSON, for scripts",
    )


def print_json(value: Any) -> None:
    """One object, on one line, at once."""
    print(json.dumps(value), flush=True)
