"""`python -m tests.sitl PATH [PATH …] [-- PYTEST'S OPTIONS]`: fly the suite."""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from . import loopback

USAGE = """\
make test-sitl ARDUCOPTER="PATH [PATH …]" [CASES="NAME or NAME"]
PATH: an ArduCopter binary for SITL, build/sitl/bin/arducopter of an ArduPilot tree"""
BAD_USAGE = 2


def main(arguments: Sequence[str]) -> int:
    """Check what was given, leave the network, and let pytest fly the cases."""
    paths, options = _parted(list(arguments))
    complaint = _complaint(paths)
    if complaint:
        print(f"{complaint}\n{USAGE}", file=sys.stderr)
        return BAD_USAGE
    try:
        loopback.enter()
    except loopback.NotOnLoopbackError as error:
        print(error, file=sys.stderr)
        return BAD_USAGE
    # Asked to end from outside, it ends as by Ctrl-C: in good order, and with its table.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    import pytest  # noqa: PLC0415 (threads of what it imports would forbid the step above)

    named = [part for path in paths for part in ("--arducopter", str(path))]
    folder = Path(__file__).parent
    return int(
        pytest.main(
            [
                *(
                    "-p",
                    "tests.sitl.plugin",
                    "-o",
                    "python_files=fly_*.py",
                    "-p",
                    "no:cacheprovider",
                ),
                *("-v", "--tb=short", "--durations=0", "--durations-min=1"),
                *(*named, str(folder), *options),
            ]
        )
    )


def _parted(arguments: list[str]) -> tuple[list[Path], list[str]]:
    """Paths of binaries, and what comes after `--`."""
    if "--" in arguments:
        at = arguments.index("--")
        return [Path(text) for text in arguments[:at]], arguments[at + 1 :]
    return [Path(text) for text in arguments], []


def _complaint(paths: Sequence[Path]) -> str:
    if not paths:
        return "no ArduCopter binary was given"
    for path in paths:
        if not path.is_file() or not os.access(path, os.X_OK):
            return f"{path}: not a program that can be run"
    return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
