"""A wheel of the package, unpacked outside the checkout: what is in it works, the rest says why."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from echowing.cli import VERBS
from echowing.paths import repository_root

BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"


class Installed:
    """The package as a wheel brings it; its dependencies are those of this environment."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "COLUMNS": "200"}

    def python(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            cwd=self._folder,
            env=self._environment,
            check=False,
        )

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return self.python("-m", "echowing", *arguments)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("wheel")
    # From a copy, so that building leaves nothing in the checkout.
    source = folder / "source"
    root = repository_root()
    listed = subprocess.run(
        ["git", "ls-files", "-z", "host_tools", "pyproject.toml", "README.md", "LICENSE"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((root / name).read_bytes())
    build = [sys.executable, "-c", BUILD, str(folder)]
    subprocess.run(build, cwd=source, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    made = Installed(folder)
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


def test_a_flight_is_analysed(installed: Installed) -> None:
    data = repository_root() / "tests" / "host_tools" / "data"
    done = installed.run("analyze", str(data / "leader.BIN"), str(data / "follower.BIN"))
    assert done.returncode == 0, done.stderr
    assert "by GPS" in done.stdout


@pytest.mark.parametrize(
    "arguments", [["sim"], ["emulator"], ["bench", "--only", "firmware"]], ids=lambda a: a[0]
)
def test_what_needs_a_clone_says_so(installed: Installed, arguments: list[str]) -> None:
    done = installed.run(*arguments)
    assert done.returncode == 2
    assert "clone" in done.stderr and "make" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_benchs_search_knows_the_firmwares_figure(installed: Installed) -> None:
    code = (
        "from echowing.rig import search\n"
        "assert len(search.scan_pulses_us()) == len(search.point_parameters()) > 4"
    )
    done = installed.python("-c", code)
    assert done.returncode == 0, done.stderr
