"""Put the firmware on a board: flash.py BOARD [--method METHOD] [--port PORT] [--release DIR].

It is the one that was built here, or of a release that `make release` has written.

A method is a tool and a way to the chip; the board's file says which it has, the usual one first:

avrdude  the boot loader of an AVR board, on its serial port
dfu      dfu-util and the STM32's boot loader in ROM, over USB
serial   stm32flash and the same boot loader, over a serial adapter on USART1
stlink   st-flash and an ST-LINK, on the board or beside it
"""

import argparse
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from echowing.errors import EchowingError
from echowing.release import IMAGE_KINDS, Release, firmware_file
from echowing.sim.boards import firmware

FLASH_START = 0x08000000  # of every STM32

# The Mega's bootloader speaks STK500v2 at 115200 baud after a reset by DTR: avrdude's "wiring".
AVRDUDE_OPTIONS = ("-c", "wiring", "-b", "115200", "-D")


def avrdude(board: firmware.Board, image: Path, port: str) -> list[str]:
    """The avrdude call."""
    write = f"flash:w:{image}:i"
    return ["avrdude", "-q", "-p", board.chip, *AVRDUDE_OPTIONS, "-P", port, "-U", write]


def dfu(board: firmware.Board, image: Path, port: str) -> list[str]:
    """The dfu-util call: 0483:df11 is ST's boot loader. It erases only the sectors it writes."""
    del board, port
    place = f"{FLASH_START:#010x}:leave"
    return ["dfu-util", "-d", "0483:df11", "-a", "0", "-s", place, "-D", str(image)]


def serial(board: firmware.Board, image: Path, port: str) -> list[str]:
    """The stm32flash call: without a length it would erase the parameters too."""
    del board
    place = f"{FLASH_START:#010x}:{image.stat().st_size}"
    start = f"{FLASH_START:#010x}"
    return ["stm32flash", "-b", "115200", "-S", place, "-v", "-w", str(image), "-g", start, port]


def stlink(board: firmware.Board, image: Path, port: str) -> list[str]:
    """The st-flash call: it erases only the sectors it writes."""
    del board, port
    return ["st-flash", "--reset", "write", str(image), f"{FLASH_START:#010x}"]


def image_of(board: firmware.Board, release: Path | None) -> Path:
    """What its tool writes: as it was built here, or of a release, by its checksum."""
    kind = IMAGE_KINDS[board.family]
    if release is not None:
        return Release(release).verified(firmware_file(board.name, kind))
    elf = firmware.elf_path(board.name)
    firmware.check_elf(elf, board.name)
    image = elf.with_suffix(f".{kind}")
    if not image.is_file():
        raise EchowingError(f"{image} is missing: build it again with `make firmware`")
    return image


@dataclass(frozen=True)
class Method:
    """A way to flash a board."""

    command: Callable[[firmware.Board, Path, str], list[str]]
    package: str
    needs_port: bool
    advice: str  # when the tool fails
    # A line of the tool that says that everything is in the flash: what follows it is no failure.
    done: str | None = None
    # Lines that the tool always says, and that sound like trouble.
    harmless: tuple[str, ...] = ()


METHODS = {
    "avrdude": Method(
        avrdude,
        "avrdude",
        True,
        "Does another program hold the port, and is the cable one that carries data?",
    ),
    "dfu": Method(
        dfu,
        "dfu-util",
        False,
        "Is the board in its boot loader (hold BOOT0, press and let go of NRST), does "
        "`dfu-util -l` list it, and may you use it (sudo, or a udev rule for 0483:df11)?",
        # After the order to leave, the chip is gone before dfu-util has asked it how it is.
        done="File downloaded successfully",
        harmless=("Invalid DFU suffix signature", "A valid DFU suffix will be required"),
    ),
    "serial": Method(
        serial,
        "stm32flash",
        True,
        "Is the adapter on USART1 (its TX to RX), BOOT0 high, and was the board reset then?",
    ),
    "stlink": Method(
        stlink,
        "stlink-tools",
        False,
        "Is the ST-LINK plugged in and wired (SWDIO, SWCLK, GND, 3V3), and does "
        "`st-info --probe` list the chip?",
    ),
}


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


def method_of(board: firmware.Board, name: str | None) -> Method:
    """The method of that name, or the board's usual one."""
    if name is None:
        name = board.uploads[0]
    if name not in board.uploads:
        known = ", ".join(board.uploads)
        raise EchowingError(f"a {board.name} is not flashed by {name!r}: METHOD is one of {known}")
    return METHODS[name]


def flash(
    board: str, port: str | None, method: str | None = None, release: Path | None = None
) -> None:
    """Flash one board."""
    kind = firmware.board(board)
    how = method_of(kind, method)
    image = image_of(kind, release)
    command = how.command(kind, image, check_port(port) if how.needs_port else "")
    tool = shutil.which(command[0])
    if tool is None:
        raise EchowingError(f"{command[0]} is missing: sudo apt install {how.package}")
    if not run_tool([tool, *command[1:]], how):
        raise EchowingError(f"the {board} was not flashed (see above). {how.advice}")


def run_tool(command: list[str], how: Method) -> bool:
    """Run a tool, show what it says, and tell whether the board is flashed."""
    done = False
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as tool:
        assert tool.stdout is not None
        for line in tool.stdout:
            done = done or (how.done is not None and how.done in line)
            if is_worth_showing(line, how, done=done):
                print(line, end="", flush=True)
    return done or tool.returncode == 0


def is_worth_showing(line: str, how: Method, *, done: bool) -> bool:
    """Whether a tool's line is more than something that only sounds like trouble."""
    return not (done and "rror" in line) and not any(words in line for words in how.harmless)


def main() -> int:
    """Flash; 2 when it cannot be done."""
    parser = argparse.ArgumentParser(description="put the firmware on a board")
    parser.add_argument("board")
    parser.add_argument("--port")
    parser.add_argument("--method")
    parser.add_argument("--release", type=Path, metavar="DIR")
    arguments = parser.parse_args()
    try:
        flash(arguments.board, arguments.port, arguments.method, arguments.release)
    except EchowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
