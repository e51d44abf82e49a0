"""What pytest has to know for the suite: the binaries, their vehicles, and the table at the end."""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from . import loopback
from .formation import Formation, Kit, Preparation, prepare
from .names import Version
from .table import Entry, lines
from .vehicle import Vehicle

BINARIES = pytest.StashKey[dict[str, Path]]()
TABLE = pytest.StashKey[list[Entry]]()
FOLDER = pytest.StashKey[Path]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("sitl")
    group.addoption("--arducopter", action="append", type=Path, default=[], metavar="PATH")
    group.addoption("--sitl-out", type=Path, default=Path("out/sitl"), metavar="DIR")


def pytest_configure(config: pytest.Config) -> None:
    """Ask each binary for its version, so that a case is named by it."""
    if loopback.reachable_interfaces():
        raise pytest.UsageError("start the suite by `make test-sitl` or `python -m tests.sitl`")
    out = Path(config.getoption("--sitl-out")).resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    config.stash[FOLDER], config.stash[TABLE] = out, []
    config.stash[BINARIES] = {}
    for number, path in enumerate(config.getoption("--arducopter")):
        version = version_of(path.resolve(), out / f"version-{number}")
        name = f"{version.line}"
        if name in config.stash[BINARIES]:
            name = f"{name}-{number}"
        config.stash[BINARIES][name] = path.resolve()


def version_of(binary: Path, folder: Path) -> Version:
    """What a binary says of itself, started."""
    vehicle = Vehicle(binary, 1, folder)
    try:
        vehicle.until_heard()
        return vehicle.version()
    except pytest.fail.Exception as failure:
        raise pytest.UsageError(f"{binary}: {failure}") from failure
    finally:
        vehicle.close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "binary" in metafunc.fixturenames:
        binaries = metafunc.config.stash[BINARIES]
        metafunc.parametrize("binary", binaries, scope="session")


@pytest.fixture(scope="session")
def preparation(binary: str, request: pytest.FixtureRequest) -> Preparation:
    """A follower that README's two commands have made ready."""
    path = request.config.stash[BINARIES][binary]
    return prepare(path, request.config.stash[FOLDER] / binary / "prepared")


@pytest.fixture(scope="session")
def kit(binary: str, preparation: Preparation, request: pytest.FixtureRequest) -> Kit:
    major, minor = binary.partition("-")[0].split(".")
    path = request.config.stash[BINARIES][binary]
    return Kit(path, Version(int(major), int(minor), 0), preparation.folder)


Start = Callable[..., Formation]


@pytest.fixture
def case_folder(binary: str, request: pytest.FixtureRequest) -> Path:
    """Where a case leaves what its vehicles and tools have written."""
    name = request.node.name.replace("/", "-")
    folder: Path = request.config.stash[FOLDER] / binary / name
    folder.mkdir(parents=True)
    return folder


@pytest.fixture
def start(kit: Kit, case_folder: Path) -> Iterator[Start]:
    """Start a formation; what it has started ends with the case."""
    started: list[Formation] = []

    def begin(*arguments: Any, prepared: Path | None = None, **options: Any) -> Formation:
        one = replace(kit, prepared=prepared or kit.prepared)
        formation = Formation(one, case_folder, *arguments, **options)
        started.append(formation)
        return formation

    yield begin
    for formation in started:
        formation.close()


@pytest.fixture
def table(request: pytest.FixtureRequest) -> list[Entry]:
    """The rows of the table at the end."""
    return request.config.stash[TABLE]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A suite that takes an hour says at once why a case has failed."""
    crash = getattr(report.longrepr, "reprcrash", None)
    if report.failed and crash is not None:
        print(f"\n{report.nodeid}: {crash.message}", flush=True)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    entries = config.stash[TABLE]
    if not entries:
        return
    shown = "\n".join(lines(entries))
    terminalreporter.section("separation in truth, m")
    terminalreporter.write_line(shown)
    path = config.stash[FOLDER] / "table.md"
    path.write_text(shown + os.linesep)
    terminalreporter.write_line(f"\nalso in {path}")
