"""The built firmware: what boards there are, how big a binary is, and how big it may be."""

import re
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
# The STM32 core's linker script keeps a place for heap and stack: no variables.
_RESERVED_SECTION = "._user_heap_stack"
# avr-gcc keeps flash, RAM and EEPROM in one address space: EEPROM and fuses lie from here on.
_AVR_NOT_MEMORY = 0x810000


BOARD_FILES = REPOSITORY / "firmware" / "echowing" / "src" / "board" / "boards"
AVR, STM32 = "avr", "stm32"  # a board's family is the second word of its FQBN
MACHINES = {AVR: ELF_MACHINE_AVR, STM32: ELF_MACHINE_ARM}
PINS = ("PAN", "TILT", "SDA", "SCL", "RX", "TX", "LED")


@dataclass(frozen=True)
class Board:
    """A board the firmware is built for, as its file in `boards/` has it.

    `flash` and `ram` are what a program may use at most, bytes; `flash_limit` and `ram_limit` what
    we allow ourselves of it. `slot` is the size of each of the two flash blocks behind the program
    that hold the parameters (0: they are elsewhere). `pins` are the board's own names, by role;
    `chip_pins` are port and bit of those the emulator watches; `uarts` the chip's serial ports, by
    use. `uploads` are the ways to flash it, the usual one first.
    """

    name: str
    title: str
    fqbn: str
    uploads: tuple[str, ...]
    flash: int
    ram: int
    flash_limit: int | None
    ram_limit: int | None
    slot: int
    pins: dict[str, str]
    led_on: str
    chip: str
    clock_hz: int
    chip_pins: dict[str, str]
    uarts: dict[str, str]

    @property
    def family(self) -> str:
        """AVR or STM32."""
        return self.fqbn.split(":")[1]

    @property
    def machine(self) -> int:
        """The ELF specification's number of its processor."""
        return MACHINES[self.family]


def read_board(path: Path) -> Board:
    """A board's file: lines `#define ECHOWING_NAME value`.

    Raises:
        EchowingError: a line that every board needs is missing, or a number is none.

    """
    lines = re.findall(r"^#define ECHOWING_(\w+) (.+?)\s*$", path.read_text(), re.MULTILINE)
    told = {name: value.strip('"') for name, value in lines}
    try:
        return _board_of(path.stem, told)
    except (KeyError, ValueError) as error:
        raise EchowingError(f"{path}: {error} is missing, or is no number") from error


def _board_of(name: str, told: dict[str, str]) -> Board:
    pins = {role: told[f"PIN_{role}"] for role in PINS}
    return Board(
        name=name,
        title=told["TITLE"],
        fqbn=told["FQBN"],
        uploads=tuple(told["UPLOADS"].split()),
        flash=int(told["PROGRAM_BYTES"]),
        ram=int(told["RAM_BYTES"]),
        flash_limit=int(told["PROGRAM_LIMIT"]) if "PROGRAM_LIMIT" in told else None,
        ram_limit=int(told["RAM_LIMIT"]) if "RAM_LIMIT" in told else None,
        slot=int(told.get("SLOT_BYTES", "0")),
        pins=pins,
        led_on=told["LED_ON"],
        chip=told["CHIP"],
        clock_hz=int(told.get("CLOCK_HZ", "0")),
        # An STM32 names its pins by port and bit, PA6; of others the file says where they are.
        chip_pins=_pairs(told.get("CHIP_PINS", "")) or {r: pin[1:] for r, pin in pins.items()},
        uarts=_pairs(told["UARTS"]),
    )


def _pairs(words: str) -> dict[str, str]:
    return dict(word.split("=") for word in words.split())


# The usual board first, then by name.
BOARDS = {
    path.stem: read_board(path)
    for path in sorted(BOARD_FILES.glob("*.h"), key=lambda path: (path.stem != "mega", path.stem))
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
        row = struct.unpack_from("<6I", image, table + index * entry)
        place, kind, flags, address, _, length = row
        if not flags & _FLAG_ALLOC or _section_name(image, place) == _RESERVED_SECTION:
            continue
        if board(name).machine == ELF_MACHINE_AVR and address >= _AVR_NOT_MEMORY:
            continue
        flash += 0 if kind == _SECTION_NOBITS else length
        ram += length if flags & _FLAG_WRITE else 0
    return Size(flash, ram)


def _section_name(image: bytes, offset: int) -> str:
    """A section's name, by its place in the table of names."""
    table, entry, _ = _section_table(image)
    (index,) = struct.unpack_from("<H", image, 50)
    (names,) = struct.unpack_from("<I", image, table + index * entry + 16)
    return image[names + offset : image.index(b"\0", names + offset)].decode()


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
