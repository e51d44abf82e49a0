"""Put the built firmware on a board: flash.py BOARD PORT.

AVR boards through Debian's avrdude, which needs nothing else; the others through arduino-cli and
the tools of their profile's core.
"""

import argparse
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

from build import ARDUINO_CLI, ARDUINO_HOME, SKETCH
from serial.tools import list_ports

from echowing import firmware
from echowing.errors import EchowingError

# The Mega's bootloader speaks STK500v2 at 115200 baud after a reset by DTR: avrdude's "wiring".
AVRDUDE_OPTIONS = {"mega": ("-p", "atmega2560", "-c", "wiring", "-b", "115200", "-D")}


def check_port(port: str | None) -> str:
    """The port if it can be opened; otherwise an error that says what to do."""
    if not port:
        raise EchowingError(f"which port? make flash BOARD=… PORT=… {_ports_there()}")
    path = Path(port)
    if not path.exists():
        raise EchowingError(f"no port {port}: is the board plugged in? {_ports_there()}")
    if not stat.S_ISCHR(path.stat().st_mode):
        raise EchowingError(f"{port} is not a serial port. {_ports_there()}")
    if not os.access(path, os.R_OK | os.W_OK):
        raise EchowingError(
            f"no permission for {port}: sudo usermod -aG {path.group()} $USER, then log in again"
        )
    return port


def _ports_there() -> str:
    ports = sorted(port.device for port in list_ports.comports())
    return f"Ports there now: {', '.join(ports) or 'none'}."


def avrdude_command(board: str, port: str, image: Path) -> list[str]:
    """The avrdude call for an AVR board."""
    avrdude = shutil.which("avrdude")
    if avrdude is None:
        raise EchowingError("avrdude is missing: sudo apt install avrdude")
    return [avrdude, "-q", *AVRDUDE_OPTIONS[board], "-P", port, "-U", f"flash:w:{image}:i"]


def arduino_command(board: str, port: str, folder: Path) -> list[str]:
    """The arduino-cli call for a board whose core brings its own upload tool."""
    return [
        str(ARDUINO_CLI),
        *("--config-file", str(ARDUINO_HOME / "arduino-cli.yaml")),
        "upload",
        *("--profile", firmware.board(board).profile),
        *("--port", port),
        *("--input-dir", str(folder / "work")),
        str(SKETCH),
    ]


def flash(board: str, port: str | None) -> None:
    """Flash one board."""
    firmware.board(board)
    elf = firmware.elf_path(board)
    firmware.check_elf(elf, board)
    port = check_port(port)
    if board in AVRDUDE_OPTIONS:
        command = avrdude_command(board, port, elf.with_suffix(".hex"))
    else:
        command = arduino_command(board, port, elf.parent)
    if subprocess.run(command, check=False).returncode != 0:
        raise EchowingError(
            f"the {board} on {port} was not flashed (see above). Is it a {board}, does another "
            "program hold the port, and is the cable one that carries data?"
        )


def main() -> int:
    """Flash; 2 when it cannot be done."""
    parser = argparse.ArgumentParser(description="put the built firmware on a board")
    parser.add_argument("board")
    parser.add_argument("port", nargs="?")
    arguments = parser.parse_args()
    try:
        flash(arguments.board, arguments.port)
    except EchowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
