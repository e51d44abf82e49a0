"""The flight core is one pipeline: each module reads only from those before it."""

import ast

import pytest

from echowing.paths import repository_root

FLIGHT = repository_root() / "host_tools" / "echowing" / "flight"
MODULES = sorted(path.stem for path in FLIGHT.glob("*.py") if path.stem != "__init__")
# Rooms that the core may read from: pure, and below it.
BELOW = {"applets", "errors", "geo", "mavlink"}
# What drives the session, and so may know it.
DRIVERS = {"orders"}


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
    """Known, estimate, plan, envelope: none of them imports a later one."""
    order = ["cloud", "estimate", "state", "look", "plan", "spacing", "session"]
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
