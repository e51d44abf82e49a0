"""The rooms of the package: what may import what, and that each says what lives in it."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import echowing

PACKAGE = Path(echowing.__file__).parent
# Each room of the simulator uses those before it; the flights at its top use all of them.
SIMULATED = ("vehicle", "world", "boards")
# What nothing is built on: a verb, and what prints figures or draws pictures.
LAST = {"bench", "commands", "docs"}


def modules(room: str) -> list[Path]:
    return sorted((PACKAGE / room).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """The modules of this package that one imports, wherever in it, for its types too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("echowing."):
            assert node.module is not None
            yield node.module.removeprefix("echowing.")


@pytest.mark.parametrize("number", range(len(SIMULATED)), ids=SIMULATED)
def test_a_room_of_the_simulator_uses_those_before_it(number: int) -> None:
    """And the description of a flight, of which it is told its section."""
    mine = {f"sim.{room}" for room in SIMULATED[: number + 1]} | {"sim.scenario"}
    for path in modules(f"sim/{SIMULATED[number]}"):
        used = {".".join(name.split(".")[:2]) for name in imported(path)}
        assert {name for name in used if name.startswith("sim.")} <= mine, path.name


def test_nothing_is_built_on_figures_pictures_and_verbs() -> None:
    for path in modules("."):
        if path.relative_to(PACKAGE).parts[0] not in LAST:
            assert not {name.split(".")[0] for name in imported(path)} & LAST, path


@pytest.mark.parametrize(
    "room", ["bench", "docs", "planning", "sim", *(f"sim/{one}" for one in SIMULATED)]
)
def test_a_room_says_what_lives_in_it(room: str) -> None:
    source = (PACKAGE / room / "__init__.py").read_text(encoding="utf-8")
    said = ast.get_docstring(ast.parse(source)) or ""
    assert said.endswith(".")
    assert "\n" not in said


def test_places_are_planned_without_the_simulator_and_the_tool() -> None:
    for path in modules("planning"):
        rooms = {name.split(".")[0] for name in imported(path)}
        assert rooms <= {"errors", "flight", "planning"}, path.name
