"""The page of the flight core's constants: `python -m echowing.docs.constants host_tools`.

A module of `echowing.flight` names its numbers at its top, each with a comment beside or above it
that says where it comes from or what it is for; numbers without an empty line between them share
the one above.
"""

import ast
import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import echowing.flight
from echowing.errors import EchowingError

NAME = "CONSTANTS.md"
HEAD = """\
# Constants of the flight core

Every number that the flight core (`echowing/flight/`) names, where it comes from and what it is \
for. The unit is in the name: `_M` metres, `_S` seconds, `_MPS` metres per second, `_MPS2` metres \
per second squared, `_RAD` radians, `_HZ` per second, `_PER_S` for each second. What a pilot or \
an engineer sets is not here: the applet's parameters are in \
[`lua/echowing.md`](../lua/echowing.md), the options in `echowing follow --help`. This page is \
made by `make pages` from the comments beside the numbers.
"""
FOLDER = Path(echowing.flight.__file__).parent


@dataclass(frozen=True)
class Constants:
    """Numbers that share a reason: their names and values, and the reason."""

    numbers: dict[str, str]
    reason: str


def page() -> str:
    """The page as Markdown."""
    parts = ((file.stem, list(constants_of(file))) for file in sorted(FOLDER.glob("*.py")))
    return HEAD + "".join(_section(module, rows) for module, rows in parts if rows)


def constants_of(file: Path) -> Iterator[Constants]:
    """Of a module of `echowing.flight`; raises EchowingError for a number without a reason."""
    source = file.read_text(encoding="utf-8")
    lines, module = source.splitlines(), importlib.import_module(f"echowing.flight.{file.stem}")
    found: dict[int, Constants] = {}
    for statement in ast.parse(source).body:
        values = {name: getattr(module, name) for name in _named(statement)}
        numbers = {name: _told(value) for name, value in values.items() if _holds(value)}
        if not numbers:
            continue
        reason = lines[(statement.end_lineno or statement.lineno) - 1].partition("  # ")[2]
        first = statement.lineno - 1
        if not reason:
            first = _first_line(lines, first)
            reason = " ".join(lines[one].lstrip("# ") for one in _comment(lines, first))
        if not reason:
            raise EchowingError(
                f"{file.name}:{statement.lineno}: {', '.join(numbers)} has no comment above it; "
                "say where it comes from and what it is for"
            )
        group = found.setdefault(first, Constants({}, reason))
        group.numbers.update(numbers)
    yield from found.values()


def _section(module: str, rows: list[Constants]) -> str:
    table = "\n".join(
        f"| {'<br>'.join(f'`{name}`' for name in one.numbers)} "
        f"| {'<br>'.join(one.numbers.values())} | {one.reason.replace('|', '/')} |"
        for one in rows
    )
    return f"\n## `{module}.py`\n\n| constant | value | why |\n|---|---|---|\n{table}\n"


def _named(statement: ast.stmt) -> Iterator[str]:
    """The names to which a statement gives numbers."""
    if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
        return
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
    if not any(
        isinstance(one, ast.Constant) and _is_number(one.value) for one in ast.walk(statement.value)
    ):
        return
    for target in targets:
        for one in target.elts if isinstance(target, ast.Tuple) else [target]:
            if isinstance(one, ast.Name) and one.id.isupper():
                yield one.id


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _holds(value: object) -> bool:
    """Whether it is a number, or a tuple or table of them."""
    return _is_number(value) or isinstance(value, tuple | dict)


def _told(value: object) -> str:
    if _is_number(value):
        return f"{value:.4g}" if isinstance(value, float) else str(value)
    if isinstance(value, tuple) and all(map(_is_number, value)):
        return ", ".join(map(_told, value))
    if isinstance(value, dict):
        return ", ".join(f"{key} {_told(one)}" for key, one in value.items())
    return "see the code"


def _first_line(lines: list[str], number: int) -> int:
    """Of the statements above, without an empty line or a comment between them."""
    while number > 0 and lines[number - 1] and not lines[number - 1].startswith("#"):
        number -= 1
    return number


def _comment(lines: list[str], below: int) -> range:
    first = below
    while first > 0 and lines[first - 1].startswith("#"):
        first -= 1
    return range(first, below)


if __name__ == "__main__":
    (Path(sys.argv[1]) / NAME).write_text(page(), encoding="utf-8")
