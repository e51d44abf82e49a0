"""`echowing replay`: a recorded flight in the browser."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.paths import SHIPPED_SONAR

if TYPE_CHECKING:
    from echowing.flight.belief import SonarBelief

EXAMPLES = """\
examples:
  echowing replay out/flights/20261121-140000      what `follow` has logged
  echowing replay leader.BIN follower.BIN          vehicles' own logs, .BIN or .tlog
  echowing sim echowing --out out/mine && echowing replay out/mine
  echowing replay out/flights/20261121-140000 --web 8100 --web-address 0.0.0.0
The page has a time line, and plays at 1/4 to 100 times the speed of the flight. Ctrl-C ends it.
"""
POLL_S = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    from echowing.web.options import add_web_arguments  # noqa: PLC0415

    parser.epilog = EXAMPLES
    parser.add_argument(
        "logs", type=Path, nargs="+", metavar="DIR", help="a folder of logs, or log files"
    )
    parser.add_argument(
        "--sonar", help=f"the sonar file that was flown (as the log says, else {SHIPPED_SONAR})"
    )
    add_web_arguments(parser, always=True)


def run(args: argparse.Namespace) -> int:
    """Serve the flight until asked to end."""
    from echowing.stopping import stop_on_signals  # noqa: PLC0415 (imported when the verb is used)
    from echowing.web.options import PageAddress, page_address  # noqa: PLC0415
    from echowing.web.recording import open_recording  # noqa: PLC0415
    from echowing.web.replay import ReplayFeed  # noqa: PLC0415
    from echowing.web.server import PageServer  # noqa: PLC0415

    address = page_address(args) or PageAddress()
    recording = open_recording(args.logs, _sonar(args))
    with stop_on_signals() as stop:
        server = PageServer(address, ReplayFeed(recording))
        print(recording.title, flush=True)
        print(server.address.said, flush=True)
        while not stop() and server.error is None:
            time.sleep(POLL_S)
        server.close()
    if server.error is not None:
        raise server.error
    return 0


def _sonar(args: argparse.Namespace) -> "SonarBelief":
    """What was believed of the sonar: as the option says, else the logs, else of ours."""
    from echowing.analysis.flown_sonar import flown_by  # noqa: PLC0415
    from echowing.sonar_file import load_sonar  # noqa: PLC0415

    told = None if args.sonar else next(filter(None, map(flown_by, args.logs)), None)
    if told is not None:
        return told.file.belief(told.legs)
    return load_sonar(args.sonar or SHIPPED_SONAR).belief()
