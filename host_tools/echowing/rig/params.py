"""`echowing rig params`: the board's parameters, one by one or as a file."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from rich.console import Console

from echowing.errors import EchowingError
from echowing.rig.board import Board, open_board
from echowing.rig.info import parameter_table
from echowing.rig.options import add_common_options, print_json
from echowing.rig.parameter_file import read_parameters, write_parameters
from echowing.rig.search import parameter_defaults

EXAMPLES = """\
examples:
  echowing rig params get
  echowing rig params get TRACK_RANGE --json
  echowing rig params set TRACK_RANGE 400
  echowing rig params save board.params
  echowing rig params load board.params
  echowing rig params diff
      against the firmware's defaults; exit code 1 when something differs
  echowing rig params diff board.params
"""

STORE_TIMEOUT_S = 8.0  # 2 s of calm, and up to 2 s of erasing on the larger boards
NOT_STORED = (
    "in use, but not stored: the autopilot is armed, and the board stores after disarming; "
    "`echowing rig watch` shows when"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's verbs."""
    parser.epilog = EXAMPLES
    verbs = parser.add_subparsers(
        dest="params_verb",
        metavar="WHAT",
        required=True,
        parser_class=argparse.ArgumentParser,
    )
    for verb, (summary, _) in _VERBS.items():
        child = verbs.add_parser(
            verb,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            epilog=_example(verb),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_common_options(child)
        if verb == "get":
            child.add_argument("names", nargs="*", metavar="NAME", help="(all of them)")
        elif verb == "set":
            child.add_argument("name", metavar="NAME")
            child.add_argument("value", type=float, metavar="VALUE")
        elif verb == "diff":
            child.add_argument("file", type=Path, nargs="?", metavar="FILE", help="(defaults)")
        else:
            child.add_argument("file", type=Path, metavar="FILE")


def _example(verb: str) -> str:
    lines = [line for line in EXAMPLES.splitlines() if f" params {verb}" in line]
    return "\n".join(["examples:", *lines])


def run(args: argparse.Namespace) -> int:
    """Run the verb's verb."""
    return _VERBS[args.params_verb][1](args)


def _get(args: argparse.Namespace) -> int:
    with open_board(args.port, args.baud) as board:
        values = board.parameters()
    wanted = args.names or list(values)
    _check_known(wanted, values)
    shown = {name: values[name] for name in wanted}
    if args.json:
        print_json(shown)
    else:
        Console().print(parameter_table(shown))
    return 0


def _set(args: argparse.Namespace) -> int:
    with open_board(args.port, args.baud) as board:
        before = board.parameter(args.name)
        value = board.set_parameter(args.name, args.value)
        stored = board.wait_stored(STORE_TIMEOUT_S)
    if args.json:
        print_json({"name": args.name, "before": before, "value": value, "stored": stored})
    else:
        print(f"{args.name} {value:g} (was {before:g}), {'stored' if stored else NOT_STORED}")
    return 0 if stored else 1


def _save(args: argparse.Namespace) -> int:
    with open_board(args.port, args.baud) as board:
        values, version = board.parameters(), board.version()
    head = f"Echowing co-processor, firmware {version.firmware} (git {version.git_hash})"
    write_parameters(args.file, values, head)
    if args.json:
        print_json({"file": str(args.file), "parameters": values})
    else:
        print(f"{len(values)} parameters in {args.file}")
    return 0


def _load(args: argparse.Namespace) -> int:
    wanted = read_parameters(args.file)
    with open_board(args.port, args.baud) as board:
        changed = load(board, wanted, str(args.file))
        stored = board.wait_stored(STORE_TIMEOUT_S)
    if args.json:
        print_json({"changed": changed, "stored": stored})
        return 0 if stored else 1
    for name, value in changed.items():
        print(f"{name} {value:g}")
    same = len(wanted) - len(changed)
    print(f"{len(changed)} changed, {same} the same; {'stored' if stored else NOT_STORED}")
    return 0 if stored else 1


def load(board: Board, wanted: Mapping[str, float], name: str) -> dict[str, float]:
    """Set the values that differ, and read all back. Returns the changes.

    Raises EchowingError: nothing is set when the board lacks a parameter; one that is refused is
    reported after the others are set.
    """
    before = board.parameters()
    _check_known(wanted, before, name)
    refused: list[str] = []
    for parameter, value in wanted.items():
        if before[parameter] == value:
            continue
        try:
            board.set_parameter(parameter, value)
        except EchowingError as error:
            refused.append(str(error))
    if refused:
        raise EchowingError(f"{name}: the others are set, but {'; '.join(refused)}")
    after = board.parameters()
    wrong = [parameter for parameter, value in wanted.items() if after[parameter] != value]
    if wrong:
        raise EchowingError(
            f"{name}: set, but the board returns other values: {', '.join(wrong)}; try again"
        )
    return {name: value for name, value in after.items() if value != before[name]}


def _diff(args: argparse.Namespace) -> int:
    other = read_parameters(args.file) if args.file else parameter_defaults()
    with open_board(args.port, args.baud) as board:
        values = board.parameters()
    differing = {
        name: (values.get(name), other.get(name))
        for name in dict.fromkeys([*values, *other])
        if values.get(name) != other.get(name)
    }
    against = str(args.file or "default")
    if args.json:
        print_json({name: {"board": a, "other": b} for name, (a, b) in differing.items()})
    else:
        for name, (here, there) in differing.items():
            print(f"{name}: board {_shown(here)}, {against} {_shown(there)}")
        print(f"{len(differing)} of {len(values)} differ")
    return 1 if differing else 0


def _shown(value: float | None) -> str:
    return "has none" if value is None else f"{value:g}"


def _check_known(names: Iterable[str], values: Mapping[str, float], where: str = "") -> None:
    unknown = [name for name in names if name not in values]
    if unknown:
        raise EchowingError(
            f"{where + ': ' if where else ''}the board has no {', '.join(unknown)}; "
            f"it has {', '.join(values)}"
        )


_VERBS: dict[str, tuple[str, Callable[[argparse.Namespace], int]]] = {
    "get": ("print parameters beside their defaults", _get),
    "set": ("set a parameter and wait until it is stored", _set),
    "save": ("write all parameters to a file", _save),
    "load": ("set the parameters in a file, and read them back", _load),
    "diff": ("compare with a file, or with the firmware's defaults", _diff),
}
