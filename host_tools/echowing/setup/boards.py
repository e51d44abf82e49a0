"""How much memory an autopilot gives to scripts.

`boards.csv` has each of ArduPilot's boards that may carry a Copter: the id that AUTOPILOT_VERSION
tells, one name of it, its processor (STM32…), and the memory of its data and of its program in KiB.
Read from ArduPilot 4.8-dev's hardware definitions (libraries/AP_HAL_ChibiOS/hwdef: APJ_BOARD_ID,
MCU, RAM_MAP, FLASH_SIZE_KB); of several boards with one id the one with the most room.
"""

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TABLE = Path(__file__).with_name("boards.csv")
# SCR_HEAP_SIZE's default by memory: AP_Scripting.cpp, HAL_MEM_CLASS in AP_HAL/board/chibios.h.
_HEAPS = ((1000, 200 * 1024), (500, 100 * 1024), (0, 43 * 1024))
# AP_Scripting_config.h: a program of this size at the most has no scripting in it.
_PROGRAM_WITHOUT_SCRIPTING_KIB = 1024
# SCR_HEAP_SIZE's parameter range ends there.
_LARGEST_HEAP_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Board:
    """An autopilot's board."""

    name: str
    processor: str
    ram_kib: int
    program_kib: int

    @property
    def heap_bytes(self) -> int:
        """What it gives to scripts unless told otherwise; 0: it has no scripting."""
        if self.program_kib <= _PROGRAM_WITHOUT_SCRIPTING_KIB:
            return 0
        return next(heap for ram_kib, heap in _HEAPS if self.ram_kib >= ram_kib)

    @property
    def most_heap_bytes(self) -> int:
        """More than this it cannot have free: half of its memory, as the flight code needs more."""
        return min(self.ram_kib * 1024 // 2, _LARGEST_HEAP_BYTES)


def board_of(board_id: int | None) -> Board | None:
    """The board with this id; None: it is not known."""
    return None if board_id is None else _boards().get(board_id)


@cache
def _boards() -> dict[int, Board]:
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {
            int(row["id"]): Board(
                row["board"], row["processor"], int(row["ram_kib"]), int(row["program_kib"])
            )
            for row in csv.DictReader(file)
        }
