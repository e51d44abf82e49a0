"""`echowing setup`: put what Echowing needs onto the vehicle."""

import argparse
from pathlib import Path

EXAMPLES = """\
examples:
  echowing setup lua --mount /media/$USER/PIXHAWK    the autopilot's SD card in this computer
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    lua = parts.add_parser("lua", help="the applet, onto the autopilot's SD card")
    lua.add_argument(
        "--mount",
        type=Path,
        metavar="DIR",
        required=True,
        help="where the autopilot's SD card is mounted",
    )


def run(args: argparse.Namespace) -> int:
    """Copy, verify, and say what is left to do."""
    from echowing.applet import applet_path, checksum, install_on_card  # noqa: PLC0415

    target = install_on_card(args.mount)
    print(f"{target}: written and verified, checksum {checksum(applet_path().read_bytes()):08x}")
    print("Unmount the card; on the vehicle set SCR_ENABLE 1, restart, then ECHO_ENABLE 1.")
    return 0
