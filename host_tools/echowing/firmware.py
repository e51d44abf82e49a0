"""The built firmware: what boards there are, how big a binary is, and how big it may be."""

import struct
import sys
from dataclasses import dataclass
from pathlib import Path

from echowing.errors import EchowingError
from echowing.paths import repository_root

REPOSITORY = repository_root()

ELF_MACHINE_AVR = 83  # e_machine in the ELF specification
ELF_MACHINE_ARM = 40

_SECTION_NOBITS, _FLAG_WRITE, _FLAG_ALLOC = 8, 1, 2
# avr-gcc keeps flash, RAM and EEPROM in one address space: EEPROM and fuses lie from here on.
_AVR_NOT_MEMORY = 0x810000


@dataclass(frozen=True)
class Board:
    """A board the firmware is built for.

    `flash_limit` and `ram_limit` are what we allow ourselves, bytes; `flash` and `ram` what a
    sketch may use at most.
    """

    profile: str  # in sketch.yaml
    machine: int
    flash: int
    ram: int
    flash_limit: int | None = None
    ram_limit: int | None = None


BOARDS = {
    "mega": Board("mega", ELF_MACHINE_AVR, 253952, 8192, 32 * 1024, 4 * 1024),
    "blackpill_f411": Board("blackpill_f411", ELF_MACHINE_ARM, 512 * 1024, 128 * 1024),
    "bluepill_f103": Board("bluepill_f103", ELF_MACHINE_ARM, 64 * 1024, 20 * 1024, 48 * 1024),
    "nucleo_f446": Board("nucleo_f446", ELF_MACHINE_ARM, 512 * 1024, 128 * 1024),
}


@dataclass(frozen=True)
class Size:
    """Memory a binary takes before it runs, bytes."""

    flash: int  # code, constants and the initial values of variables
    ram: int  # variables


def board(name: str) -> Board:
    """The board of that name; an error lists those there are."""
    if name not in BOARDS:
        raise EchowingError(f"no board {name!r}: BOARD is one of {', '.join(BOARDS)}")
    return BOARDS[name]


def elf_path(name: str) -> Path:
    """Where `make firmware` leaves the binary of a board."""
    return REPOSITORY / "build" / "firmware" / name / "echowing.elf"


def check_elf(path: Path, name: str) -> bytes:
    """The bytes of a board's ELF; an error if it is missing or made for another machine."""
    if not path.is_file():
        raise EchowingError(f"no firmware in {path}: build it with `make firmware BOARD={name}`")
    image = path.read_bytes()
    if image[:4] != b"\x7fELF" or len(image) < 52:
        raise EchowingError(
            f"{path} is not an ELF file: build it with `make firmware BOARD={name}`"
        )
    if struct.unpack_from("<H", image, 18)[0] != board(name).machine:
        raise EchowingError(f"{path} was not built for a {name}")
    return image


def size(path: Path, name: str) -> Size:
    """Flash and RAM of a board's ELF, from its section table (32-bit, little endian)."""
    image = check_elf(path, name)
    table, entry, count = _section_table(image)
    flash = ram = 0
    for index in range(count):
        _, kind, flags, address, _, length = struct.unpack_from("<6I", image, table + index * entry)
        if not flags & _FLAG_ALLOC:
            continue
        if board(name).machine == ELF_MACHINE_AVR and address >= _AVR_NOT_MEMORY:
            continue
        flash += 0 if kind == _SECTION_NOBITS else length
        ram += length if flags & _FLAG_WRITE else 0
    return Size(flash, ram)


def _section_table(image: bytes) -> tuple[int, int, int]:
    """Offset, entry size and number of entries."""
    (table,) = struct.unpack_from("<I", image, 32)
    entry, count = struct.unpack_from("<2H", image, 46)
    if table + entry * count > len(image):
        raise EchowingError("the ELF file is cut short: build it again with `make firmware`")
    return table, entry, count


def size_lines(path: Path, name: str) -> list[str]:
    """Flash and RAM of a binary against what the board has and what we allow."""
    kind, used = board(name), size(path, name)
    return [
        f"{name}: {what:5} {bytes_used:6} bytes of {there}{_verdict(bytes_used, limit)}"
        for what, bytes_used, there, limit in (
            ("flash", used.flash, kind.flash, kind.flash_limit),
            ("RAM", used.ram, kind.ram, kind.ram_limit),
        )
    ]


def _verdict(used: int, limit: int | None) -> str:
    if limit is None:
        return ""
    return f", limit {limit}: {'ok' if used < limit else 'TOO BIG'}"


def fits(path: Path, name: str) -> bool:
    """Whether a binary keeps our limits."""
    kind, used = board(name), size(path, name)
    return used.flash < (kind.flash_limit or kind.flash) and used.ram < (kind.ram_limit or kind.ram)


def main(names: list[str]) -> int:
    """Print the sizes of the boards named; 1 when a limit is broken, 2 when there is no binary."""
    try:
        for name in names:
            print("\n".join(size_lines(elf_path(name), name)))
        return 0 if all(fits(elf_path(name), name) for name in names) else 1
    except EchowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
