"""Write a release: `make_release.py DIST`, as `make release` calls it.

`DIST/VERSION` then holds the wheel, the firmware of every board, both applets, the notes and the
checksums by which `make flash RELEASE=DIR` and `echowing setup --release DIR` take them. The folder
comes into being whole, or not at all.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from echowing import __version__
from echowing.applets import APPLETS
from echowing.errors import EchowingError
from echowing.paths import repository_root
from echowing.release import IMAGE_KINDS, SUMS, firmware_file, sum_of
from echowing.setup.applet import applet_path
from echowing.sim.boards.firmware import BOARDS, STM32, board, elf_path

ROOT = repository_root()
NOTES = "NOTES.md"
# What the wheel is made from.
SOURCES = ("host_tools", "pyproject.toml", "README.md", "LICENSE")
BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"


def write_release(dist: Path) -> Path:
    """Build everything and write the folder. Raises EchowingError where something is missing."""
    notes = notes_of((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), __version__)
    images = firmware_images()
    dist.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=dist) as scratch:
        folder = Path(scratch) / __version__
        folder.mkdir()
        build_wheel(folder)
        for name, built in images.items():
            shutil.copyfile(built, folder / name)
        for applet in APPLETS:
            shutil.copyfile(applet_path(applet), folder / applet.file)
        (folder / NOTES).write_text(f"{notes}\n\nBuilt from {commit()}.\n", encoding="utf-8")
        write_sums(folder)
        target = dist / __version__
        shutil.rmtree(target, ignore_errors=True)
        return folder.rename(target)


def notes_of(changelog: str, version: str) -> str:
    """The part of a changelog about a version, with its heading."""
    parts = re.split(r"^(?=## )", changelog, flags=re.MULTILINE)
    found = next((part for part in parts if part.split("\n")[0] == f"## {version}"), None)
    if found is None:
        raise EchowingError(f"CHANGELOG.md has no part `## {version}`: a release needs its notes")
    return found.replace(f"## {version}", f"# Echowing {version}", 1).rstrip()


def commit() -> str:
    """The commit, and whether something in it was changed."""
    hash_of = _git("rev-parse", "--short=8", "HEAD")
    return f"{hash_of}, with changes" if _git("status", "--porcelain") else hash_of


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def build_wheel(folder: Path) -> Path:
    """The wheel of what git knows; from a copy, so that building leaves nothing in the checkout."""
    with tempfile.TemporaryDirectory() as scratch:
        for name in filter(None, _git("ls-files", "-z", *SOURCES).split("\0")):
            target = Path(scratch) / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target)
        build = [sys.executable, "-c", BUILD, str(folder.resolve())]
        subprocess.run(build, cwd=scratch, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def firmware_images() -> dict[str, Path]:
    """The image of each board, built now where need be; an error names the boards without one."""
    failed = [name for name in BOARDS if not _made(name)]
    if failed:
        raise EchowingError(f"no release: no firmware for {', '.join(failed)}{_advice(failed)}")
    kinds = {name: IMAGE_KINDS[board(name).family] for name in BOARDS}
    return {
        firmware_file(name, kind): elf_path(name).with_suffix(f".{kind}")
        for name, kind in kinds.items()
    }


def _made(name: str) -> bool:
    command = ["make", "-s", "firmware", f"BOARD={name}"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def _advice(failed: Sequence[str]) -> str:
    if all(board(name).family != STM32 for name in failed):
        return ""
    return (
        ". The STM32 boards need the STM32 core: it is fetched on line, or give one that is "
        "installed, ECHOWING_STM32_CORE=… ECHOWING_STM32_CMSIS=… (firmware/README.md)"
    )


def write_sums(folder: Path) -> None:
    """The checksum of every file in the folder."""
    lines = [f"{sum_of(path)}  {path.name}\n" for path in sorted(folder.iterdir())]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8")


def main(arguments: Sequence[str]) -> int:
    """Write it; 2 when that cannot be done."""
    try:
        folder = write_release(Path(arguments[0]))
    except EchowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for path in sorted(folder.iterdir()):
        print(f"{path.stat().st_size:>9,}  {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
