"""The wheel in a fresh environment, with what it demands and no extra: the field needs no more."""

import json
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.system.field import World, in_slot

import make_release
from echowing.cli import VERBS
from echowing.extras import LIBRARIES
from echowing.paths import repository_root

pytestmark = pytest.mark.seconds(30)
DATA = repository_root() / "tests" / "host_tools" / "data"
FLIGHT = (str(DATA / "leader.BIN"), str(DATA / "follower.BIN"))


class Installed:
    """The wheel in an environment of its own, beside links to the libraries that it demands."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        self._folder = folder
        self._bin = folder / "venv" / "bin"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
        pip = [sys.executable, "-m", "pip", "--python", str(self._bin / "python")]
        command = [*pip, "install", "-q", "--no-index", "--no-deps", str(wheel)]
        subprocess.run(command, check=True)
        (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
        (ours,) = site.glob("echowing-*.dist-info")
        for library in demanded(metadata.Distribution.at(ours)):
            link(library, site)

    @property
    def program(self) -> tuple[str, ...]:
        """`echowing` of this environment, and nothing of the checkout's."""
        return "env", "-u", "PYTHONPATH", str(self._bin / "echowing")

    def python(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return self._call("python", *arguments)

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return self._call("echowing", *arguments)

    def _call(self, name: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [str(self._bin / name), *arguments],
            capture_output=True,
            text=True,
            cwd=self._folder,
            env={"COLUMNS": "200"},
            check=False,
        )


def demanded(distribution: metadata.Distribution) -> Iterator[metadata.Distribution]:
    """What it demands without an extra, and what that demands, from this environment."""
    ahead, found = [distribution], {"echowing"}
    while ahead:
        for requirement in map(Requirement, ahead.pop().requires or ()):
            here = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
            name = canonicalize_name(requirement.name)
            if here and name not in found:
                found.add(name)
                ahead.append(metadata.distribution(name))
                yield ahead[-1]


def link(library: metadata.Distribution, site: Path) -> None:
    tops = {file.parts[0] for file in library.files or ()} - {"..", "__pycache__"}
    for top in tops:
        (site / top).symlink_to(Path(str(library.locate_file(top))))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("wheel")
    made = Installed(folder, make_release.build_wheel(folder))
    where = made.python("-c", "import echowing; print(echowing.__file__)").stdout
    assert where.startswith(str(folder))  # and not the checkout's
    return made


def test_every_verb_is_there(installed: Installed) -> None:
    code = "from echowing.cli import VERBS, main\n" + "\n".join(
        f"try: main(['{verb}', '--help'])\nexcept SystemExit as end: assert end.code == 0"
        for verb in VERBS
    )
    done = installed.python("-c", code)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_applet_goes_onto_a_card(installed: Installed, tmp_path: Path) -> None:
    (tmp_path / "APM").mkdir()
    done = installed.run("setup", "lua", "--mount", str(tmp_path))
    assert done.returncode == 0, done.stderr
    ours = repository_root() / "lua" / "echowing.lua"
    assert (tmp_path / "APM" / "scripts" / "echowing.lua").read_bytes() == ours.read_bytes()


def test_help_and_follow_need_no_extra(installed: Installed) -> None:
    done = installed.run("--help")
    assert done.returncode == 0 and all(verb in done.stdout for verb in VERBS)
    done = installed.run("follow", "--help")
    assert done.returncode == 0 and "--leader" in done.stdout


def test_no_extra_is_there(installed: Installed) -> None:
    libraries = [name for names in LIBRARIES.values() for name in names]
    code = f"import importlib.util as u; print([n for n in {libraries} if u.find_spec(n)])"
    assert installed.python("-c", code).stdout.strip() == "[]"


def test_a_formation_is_flown_and_analysed(installed: Installed, tmp_path: Path) -> None:
    """As in the field: the vehicles are another environment's."""
    world = World()
    log = tmp_path / "flight-1"
    try:
        tool = world.follow("--log", str(log), program=installed.program)
        first = tool.row(in_slot)
        tool.row(lambda row: in_slot(row) and row["time_s"] > 10.0, since=first)
        assert tool.end(signal.SIGINT) == 0
    finally:
        world.end_tools()
        world.pilot.close()
        assert world.process.end() == 0
    done = installed.run("analyze", str(log), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    # a busy machine loses readings: whether the sonar leads is for tests that fly simulated time
    assert found["wanted_m"] == 3.0
    assert abs(found["by_sonar"]["mean_separation_m"] - 3.0) < 1.0
    assert abs(found["by_estimate"]["mean_separation_m"] - 3.0) < 1.0


def test_a_flight_is_analysed(installed: Installed) -> None:
    done = installed.run("analyze", *FLIGHT)
    assert done.returncode == 0, done.stderr
    assert "by GPS" in done.stdout


def test_a_report_says_that_its_plots_need_an_extra(installed: Installed, tmp_path: Path) -> None:
    done = installed.run("analyze", *FLIGHT, "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith("report: ") and "pip install 'echowing[plots]'" in last
    page = (tmp_path / "report.html").read_text()
    assert page.count("echowing[plots]") == 1 and "RMSD" in page
    assert len(page) < 1_000_000  # the code that draws is not in it


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["sim"], "sim"),
        (["sim", "--serve", "5760"], "sim"),
        (["demo"], "sim"),
        (["bench", "--only", "accuracy"], "sim"),
        (["campaign"], "campaign"),
        (["plan", "2"], "plan"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_a_verb_names_the_extra_that_it_needs(
    installed: Installed, arguments: list[str], extra: str
) -> None:
    done = installed.run(*arguments)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"echowing {arguments[0]}: this needs the extra [{extra}]: ")


@pytest.mark.parametrize(
    "arguments", [["emulator"], ["bench", "--only", "firmware"]], ids=lambda a: a[0]
)
def test_what_needs_a_clone_says_so(installed: Installed, arguments: list[str]) -> None:
    done = installed.run(*arguments)
    assert done.returncode == 2
    assert "clone" in done.stderr and "make" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_extras_are_those_that_errors_name() -> None:
    project = tomllib.loads((repository_root() / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for extra, libraries in LIBRARIES.items():
        brought = {Requirement(text).name for text in extras[extra]}
        assert brought - {"echowing"} == set(libraries)
    (every,) = map(Requirement, extras["all"])
    assert every.extras == LIBRARIES.keys()


def test_the_benchs_search_knows_the_firmwares_figure(installed: Installed) -> None:
    code = (
        "from echowing.rig import search\n"
        "assert len(search.scan_pulses_us()) == len(search.point_parameters()) > 4"
    )
    done = installed.python("-c", code)
    assert done.returncode == 0, done.stderr
