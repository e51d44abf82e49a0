"""`echowing rig`: the bench. Its verbs are modules of `echowing.rig`, imported when used."""

import argparse
import importlib
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from echowing.rig import BOARD_VERBS, PROCEDURES

EXAMPLES = """\
examples:
  echowing rig watch
      finds the board on USB by itself
  echowing rig --port /dev/ttyACM0 self-test
  echowing rig params set TRACK_RANGE 400
  echowing rig --port tcp:192.168.1.30:5760 info --json
`echowing rig VERB --help` has more. Exit code: 0 fine, 1 a test has failed, 2 fix it first.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options; `--port` and its like are taken before and after the second verb."""
    from echowing.rig.options import add_common_options  # noqa: PLC0415
    from echowing.rig.ports import USB_BAUD  # noqa: PLC0415

    parser.epilog = EXAMPLES
    add_common_options(parser)
    parser.set_defaults(port=None, baud=USB_BAUD, json=False)
    verbs = parser.add_subparsers(
        dest="rig_verb", metavar="VERB", required=True, parser_class=_VerbParser
    )
    for verb, summary in {**BOARD_VERBS, **PROCEDURES}.items():
        child = verbs.add_parser(
            verb,
            verb=verb,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_common_options(child)


def run(args: argparse.Namespace) -> int:
    """Run the verb's verb."""
    return int(_module(args.rig_verb).run(args))


class _VerbParser(argparse.ArgumentParser):
    """Knows its options only when its verb is asked for: nothing else is imported."""

    def __init__(self, *, verb: str, **options: Any) -> None:
        super().__init__(**options)
        self._verb: str | None = verb

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """As argparse's."""
        verb, self._verb = self._verb, None
        if verb is not None:
            _module(verb).add_arguments(self)
        return super().parse_known_args(args, namespace)


def _module(verb: str) -> ModuleType:
    return importlib.import_module(f"echowing.rig.{verb.replace('-', '_')}")
