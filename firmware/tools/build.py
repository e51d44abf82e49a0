"""Compile the sketch for one board: build.py BOARD [--sketch DIR] [--output DIR] [--home DIR].

The AVR board is compiled with Debian's core, offline. An STM32 board is compiled with the installed
core that stm32_home.sh has laid out, if it has; otherwise through its profile of sketch.yaml, for
which arduino-cli fetches the pinned core (internet, once). The ELF and what is flashed land in the
output folder, by default build/firmware/BOARD.
"""

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from echowing.errors import EchowingError
from echowing.sim.boards import firmware

ARDUINO_CLI = firmware.REPOSITORY / "build" / "tools" / "arduino-cli"
ARDUINO_HOME = firmware.REPOSITORY / "build" / "arduino-home"
CONFIGURATION = "arduino-cli.yaml"
STM32_HOME = firmware.REPOSITORY / "build" / "arduino-home-stm32"
SKETCH = firmware.REPOSITORY / "firmware" / "echowing"

# What Debian's core needs; the flags are those of arduino_home.sh.
AVR_FLAGS = "-std=gnu++14 -DDECIMAL_DIG=__DECIMAL_DIG__"

# An offline home has no port discoveries, and compiling needs none.
HARMLESS = "discovery builtin:"


def git_hash() -> str:
    """First eight characters of the commit, or zeros outside a repository."""
    try:
        asked = subprocess.run(
            ["git", "rev-parse", "--short=8", "HEAD"],
            cwd=firmware.REPOSITORY,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "00000000"
    return asked.stdout.strip()


def installed_home(board: str) -> Path | None:
    """The arduino-cli home over an installed core for this board, if there is one."""
    home = ARDUINO_HOME if firmware.board(board).family == firmware.AVR else STM32_HOME
    return home if (home / CONFIGURATION).exists() else None


def is_fetched(board: str, home: Path | None) -> bool:
    """Whether the board's core comes from its maker's index rather than from this machine."""
    named = home is not None or installed_home(board) is None
    return firmware.board(board).family == firmware.STM32 and named


def command(board: str, sketch: Path, output: Path, home: Path | None) -> list[str]:
    """The arduino-cli call for a board; `home` is where its cores are, if not the usual place."""
    kind = firmware.board(board)
    fetched = is_fetched(board, home)
    flags = f"'-DECHOWING_GIT_HASH=\"{git_hash()}\"'"
    if kind.family == firmware.AVR:
        flags = f"{AVR_FLAGS} {flags}"
    return [
        str(ARDUINO_CLI),
        *("--config-file", str((home or installed_home(board) or ARDUINO_HOME) / CONFIGURATION)),
        "compile",
        *(("--profile", board) if fetched else ("--fqbn", kind.fqbn)),
        # Its options in build_opt.h change the whole core, and arduino-cli does not notice.
        *(("--clean",) if kind.family == firmware.STM32 else ()),
        *("--warnings", "all"),
        *("--build-property", f"compiler.cpp.extra_flags={flags}"),
        # The linker refuses a program that reaches into the parameters' flash.
        *("--build-property", f"upload.maximum_size={kind.flash}"),
        *("--build-path", str(output / "work")),
        str(sketch),
    ]


def compile_sketch(board: str, sketch: Path, output: Path, home: Path | None = None) -> None:
    """Compile; what the compiler says of the sketch goes to stderr, all of it on a failure."""
    output.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(
        command(board, sketch, output, home), capture_output=True, text=True, check=False
    )
    said = [line for line in done.stderr.splitlines() if HARMLESS not in line]
    failed = done.returncode != 0
    for line in said if failed else own_warnings(said, sketch):
        print(line, file=sys.stderr)
    if failed:
        raise EchowingError(_advice(board, home))


def own_warnings(said: Iterable[str], sketch: Path) -> Iterator[str]:
    """What the compiler says of the sketch's files, without what it says of the Arduino core's."""
    own = False
    for line in said:
        if re.match(r"(In file included from )?/", line):
            own = str(sketch) in line
        if own:
            yield line


def _advice(board: str, home: Path | None) -> str:
    if not is_fetched(board, home):
        return f"the sketch does not compile for {board}"
    return (
        f"the sketch was not compiled for {board}. Its Arduino core is fetched from the maker's "
        "index by arduino-cli, which needs internet the first time: if the lines above speak of "
        "an index, a platform or a host that cannot be reached, try again on line. Offline, "
        "BOARD=mega works."
    )


def collect(sketch: Path, output: Path) -> None:
    """Copy what was built under the one name the other tools know."""
    for kind in ("elf", "hex", "bin"):
        built = output / "work" / f"{sketch.name}.ino.{kind}"
        if built.exists():
            shutil.copyfile(built, output / f"echowing.{kind}")


def main() -> int:
    """Build one board; 2 when that fails."""
    parser = argparse.ArgumentParser(description="compile the co-processor's sketch")
    parser.add_argument("board")
    parser.add_argument("--sketch", type=Path, default=SKETCH)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--home", type=Path)
    arguments = parser.parse_args()
    try:
        firmware.board(arguments.board)
        output = arguments.output or firmware.elf_path(arguments.board).parent
        sketch = arguments.sketch.resolve()
        compile_sketch(arguments.board, sketch, output, arguments.home)
        collect(sketch, output)
    except EchowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
