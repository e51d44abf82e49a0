"""`echowing <verb>`: the command line. Each verb is a module, imported only when it is used."""
# PYTHON_ARGCOMPLETE_OK

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from echowing import __version__
from echowing.errors import EchowingError
from echowing.extras import needed_for
from echowing.stopping import ignore_signals

# Verb, and what it does in a line. Its module in `echowing.commands` has
# `add_arguments(parser)` and `run(args) -> exit code`.
VERBS = {
    "sim": "fly a simulated formation",
    "campaign": "fly thousands of drawn flights with faults",
    "demo": "fly every scenario and write the report",
    "leader": "send a real leader's telemetry to `follow` on another computer",
    "follow": "guide real followers behind a real leader",
    "relay": "keep a vehicle midway to a remote vehicle",
    "plan": "place a formation that has no name",
    "replay": "show a recorded flight in the browser",
    "analyze": "measure a flown formation from its logs",
    "calibrate": "replay recorded flights through the copter model",
    "setup": "make a vehicle ready: applet, parameters, check before flight",
    "rig": "watch, set up and test the co-processor on the bench",
    "bench": "print speeds and sizes",
    "emulator": "run the co-processor's binary on this machine",
}

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; returns the exit code. Errors that the user can fix have no traceback."""
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    arguments = list(sys.argv[1:] if argv is None else argv)
    verb = _asked_verb(arguments) or ""
    try:
        args = _parser(arguments).parse_args(arguments)
        code = int(_module(args.verb).run(args))
        if argv is None:  # this process is ours, and only its end is left
            ignore_signals()
        return code
    except EchowingError as error:
        print(f"echowing {verb}: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except ModuleNotFoundError as error:
        needed = needed_for((error.name or "").partition(".")[0])
        if needed is None:
            raise
        print(f"echowing {verb}: {needed}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        print(f"echowing {verb}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # the reader, `head` say, has seen enough
        return 0


def _complete() -> None:
    """Answer the shell, which asks what may come next on its command line; does not return."""
    import argcomplete  # noqa: PLC0415 (only when the shell asks)

    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0"))]
    words = line.split()[1:]
    argcomplete.autocomplete(_parser(words))


def _asked_verb(arguments: Sequence[str]) -> str | None:
    return next((word for word in arguments if not word.startswith("-")), None)


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="echowing",
        description="Formation flight for small ArduPilot copters, held together by a cheap sonar.",
        epilog="example: echowing sim echowing --seed 3\n`echowing VERB --help` has examples.\n"
        'Your shell completes verbs and options: eval "$(register-python-argcomplete echowing)"',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"echowing {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    asked = _asked_verb(arguments)
    for verb, summary in VERBS.items():
        child = verbs.add_parser(
            verb,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if verb == asked:
            _module(verb).add_arguments(child)
    return parser


def _module(verb: str) -> ModuleType:
    return importlib.import_module(f"echowing.commands.{verb}")


if __name__ == "__main__":
    sys.exit(main())
