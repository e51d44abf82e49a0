"""The co-processor as it is flashed on an STM32 board: the binary on unicorn, in lock step."""

import ctypes
from pathlib import Path
from typing import ClassVar

from echowing.sim.boards.coprocessor import SonarBus
from echowing.sim.boards.emulated import EMULATORS, EmulatedBoard

_COMPLAINT_BYTES = 256


class Stm32Board(EmulatedBoard):
    """A board with an STM32. Its `noise` is part of the chip's own number.

    `slowness` makes the processor so many times slower than the chip is, and nothing else: a run
    then takes less of this machine's time, and what the program does in time it does on the chip.
    """

    LIBRARY: ClassVar[Path] = EMULATORS / "libechowing_stm32.so"
    PACKAGE: ClassVar[str] = "libunicorn2"

    def __init__(
        self,
        bus: SonarBus,
        *,
        board: str,
        elf: Path | None = None,
        eeprom: bytes | None = None,
        offset_us: int = 0,
        noise: int = 0,
        slowness: int = 1,
    ) -> None:
        super().__init__(bus, board=board, elf=elf, eeprom=eeprom, offset_us=offset_us, noise=noise)
        self._library.board_set_slowness(ctypes.c_void_p(self._board), ctypes.c_uint32(slowness))
        self.hold_bus(0)  # tells it where the bus is

    def break_crystal(self) -> None:
        """The crystal starts no more."""
        self._library.board_break_crystal(ctypes.c_void_p(self._board))

    def watchdog_us(self) -> int:
        """The watchdog's time-out as it is set now; 0 while it does not run."""
        return int(self._library.board_watchdog_us(ctypes.c_void_p(self._board)))

    def set_erase_us(self, span_us: int) -> None:
        """How long erasing a block of flash takes; at first what is typical of the chip."""
        self._library.board_set_erase_us(ctypes.c_void_p(self._board), ctypes.c_uint32(span_us))

    def boot_loader(self) -> str | None:
        """Once the program has jumped into the boot loader in ROM: what is not as after a reset.

        None while the program runs; "" if all is well.
        """
        complaint = ctypes.create_string_buffer(_COMPLAINT_BYTES)
        entered = self._library.board_in_rom(
            ctypes.c_void_p(self._board), complaint, ctypes.c_size_t(len(complaint))
        )
        return complaint.value.decode() if entered else None
