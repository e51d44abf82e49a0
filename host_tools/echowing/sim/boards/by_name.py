"""The emulator for a board, by the board's name."""

from pathlib import Path

from echowing.sim.boards import firmware
from echowing.sim.boards.avr import AvrBoard
from echowing.sim.boards.coprocessor import SonarBus
from echowing.sim.boards.emulated import EmulatedBoard
from echowing.sim.boards.stm32 import Stm32Board


def emulated_board(
    bus: SonarBus,
    *,
    board: str,
    elf: Path | None = None,
    eeprom: bytes | None = None,
    noise: int = 0,
    slowness: int = 1,
) -> EmulatedBoard:
    """A board under power; the arguments are those of `EmulatedBoard`.

    `slowness` is that of `Stm32Board`; the Mega is emulated at its own pace.

    Raises:
        EchowingError: no such board, no binary of it, or no emulator built.

    """
    if firmware.board(board).family == firmware.AVR:
        return AvrBoard(bus, board=board, elf=elf, eeprom=eeprom, noise=noise)
    return Stm32Board(bus, board=board, elf=elf, eeprom=eeprom, noise=noise, slowness=slowness)
