"""The flight core is one pipeline: each module reads only from those before it.

And each room of the package imports from the rooms below it alone.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

from echowing.paths import repository_root

PACKAGE = repository_root() / "host_tools" / "echowing"
FLIGHT = PACKAGE / "flight"
MODULES = sorted(path.stem for path in FLIGHT.glob("*.py") if path.stem != "__init__")
# What flies with real vehicles, or reads their logs: installed without the simulator.
IN_THE_FIELD = ("analyze", "follow", "leader", "relay", "replay", "setup")
# Rooms that the core may read from: pure, and below it.
BELOW = {"applets", "errors", "geo", "mavlink"}
# What drives the session, and so may know it.
DRIVERS = {"orders"}


@cache
def imports(module: str) -> list[str]:
    """The modules of this package that one imports, for its types too."""
    tree = ast.parse((FLIGHT / f"{module}.py").read_text(encoding="utf-8"))
    nodes = ast.walk(tree)
    named = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    assert not any(
        alias.name.startswith("echowing")
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    ), "import what is needed by `from`"
    return [name for name in named if name.startswith("echowing.")]


def within(module: str) -> set[str]:
    """The modules of the core that one imports."""
    prefix = "echowing.flight."
    return {name.removeprefix(prefix) for name in imports(module) if name.startswith(prefix)}


@pytest.mark.parametrize("module", MODULES)
def test_the_core_imports_from_the_rooms_below_it_alone(module: str) -> None:
    rooms = {name.split(".")[1] for name in imports(module)}
    assert rooms <= BELOW | {"flight"}


def test_imports_go_one_way() -> None:
    """Not even for its types does a module import one that imports it, over however many others."""
    left = {module: within(module) for module in MODULES}
    while left:
        first = {module for module, needs in left.items() if not needs & left.keys()}
        assert first, f"in a circle, or behind one: {sorted(left)}"
        left = {module: needs for module, needs in left.items() if module not in first}


@pytest.mark.parametrize("module", [one for one in MODULES if one != "session"])
def test_no_step_reaches_back_to_the_session(module: str) -> None:
    """A step is given what it needs; who drives the session is no step."""
    assert ("session" in within(module)) is (module in DRIVERS)
    if module not in DRIVERS:
        assert "FollowSession" not in (FLIGHT / f"{module}.py").read_text(encoding="utf-8")


def test_the_steps_are_in_the_order_of_the_tick() -> None:
    """Known, standing, plan, allowed, command: none of them imports a later one."""
    order = [
        "cloud",
        "estimate",
        "readings",
        "follower",
        "known",
        "look",
        "supervisor",
        "plan",
        "spacing",
        "session",
    ]
    for number, module in enumerate(order):
        later = set(order[number + 1 :])
        assert not _all_within(module) & later


def _all_within(module: str) -> set[str]:
    found: set[str] = set()
    ahead = {module}
    while ahead:
        ahead = {name for one in ahead for name in within(one)} - found
        found |= ahead
    return found


# ---- the rooms -----------------------------------------------------------------------------------


@cache
def imported(file: Path) -> set[str]:
    """All that a file imports of this package, in functions and for its types too."""
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    found = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            # What is named may be a module itself.
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in found if name.startswith("echowing.")}


def rooms_of(room: str) -> set[str]:
    """The rooms that the modules of one import from."""
    files = (PACKAGE / room).rglob("*.py")
    return {name.split(".")[1] for file in files for name in imported(file)}


def reached_from(module: str) -> set[str]:
    """The modules that one imports, over however many others."""
    found: set[str] = set()
    ahead = {module}
    while ahead:
        found |= ahead
        ahead = {name for one in ahead for file in files_of(one) for name in imported(file)} - found
    return found


def files_of(module: str) -> list[Path]:
    """None where a name that is imported is no module."""
    place = PACKAGE.parent / Path(*module.split("."))
    return [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()]


def test_mavlink_knows_no_flight() -> None:
    """Messages and links are below the core, which reads them."""
    assert rooms_of("mavlink") <= {"errors", "geo", "mavlink"}


def test_the_tool_knows_no_command() -> None:
    """A verb drives the tool, and the tool knows of none."""
    assert "commands" not in rooms_of("tool")


@pytest.mark.parametrize("verb", IN_THE_FIELD)
def test_no_verb_of_the_field_reaches_the_simulator(verb: str) -> None:
    reached = reached_from(f"echowing.commands.{verb}")
    assert "echowing.errors" in reached  # it was followed
    assert not {name for name in reached if name.split(".")[1] in ("sim", "campaign")}
