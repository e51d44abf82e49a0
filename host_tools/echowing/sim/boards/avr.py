"""The co-processor as it is flashed on an AVR board: the binary on simavr, in lock step.

The simulator flies it in place of the native core (`avr_coprocessor`).
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common as mavlink

from echowing.errors import EchowingError
from echowing.sim.boards import firmware
from echowing.sim.boards.coprocessor import USB_PORT, SonarBus
from echowing.sim.boards.emulated import EMULATORS, EmulatedBoard
from echowing.sim.world.sonar import MaxSonar

_NOISE_STEPS = 1024


class AvrBoard(EmulatedBoard):
    """A Mega. Its `noise` is what the open analogue input A0 reads."""

    LIBRARY: ClassVar[Path] = EMULATORS / "libechowing_avr.so"
    PACKAGE: ClassVar[str] = "libsimavr2"


# Setting a parameter before take-off: answers take milliseconds; a lost one is asked again.
_BOOT_US, _ANSWER_US, _ATTEMPTS = 3_000_000, 100_000, 5
# Parameters are stored 2 s after the last change (issue of the firmware: see parameter_store.h),
# one byte of 3.3 ms at a time.
_STORE_US = 4_000_000


class _Bench:
    """A board on the bench, spoken to over USB, to store parameters in it."""

    def __init__(self, elf: Path, board: str) -> None:
        self._board = AvrBoard(MaxSonar(lambda _: None), board=board, elf=elf)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._t_us = 0

    def _wait(self, kind: str, span_us: int) -> Any:
        """The next message of that kind within the span, or None."""
        end_us = self._t_us + span_us
        while self._t_us < end_us:
            self._t_us += 10_000
            self._board.run_until(self._t_us)
            for message in self._parser.parse_buffer(self._board.take(USB_PORT)) or []:
                if message.get_type() == kind:
                    return message
        return None

    def store(self, parameters: Mapping[str, float]) -> bytes:
        """Set and store parameters; returns the EEPROM."""
        board = self._wait("HEARTBEAT", _BOOT_US)
        if board is None:
            raise EchowingError("the emulated firmware sends no heartbeat on its USB port")
        for name, value in parameters.items():
            # It answers with the ids it has by then: the next is for those.
            board = self._set(board.get_srcSystem(), board.get_srcComponent(), name, value)
        self._board.run_until(self._t_us + _STORE_US)
        return self._board.power_off()

    def _set(self, system: int, component: int, name: str, value: float) -> Any:
        sender = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        request = mavlink.MAVLink_param_set_message(
            system, component, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
        )
        answer = None
        for _ in range(_ATTEMPTS):
            self._board.feed(USB_PORT, request.pack(sender))
            answer = self._wait("PARAM_VALUE", _ANSWER_US)
            if answer is not None and answer.param_id == name:
                break
        if answer is None or answer.param_id != name:
            raise EchowingError(f"the co-processor has no parameter {name!r}")
        if abs(answer.param_value - value) > 1e-6 * abs(value):
            raise EchowingError(f"co-processor parameter {name}: {value:g} is not accepted")
        return answer


@lru_cache(maxsize=64)
def _stored(
    elf: Path, board: str, built_ns: int, parameters: tuple[tuple[str, float], ...]
) -> bytes:
    """EEPROM of a board with these parameters stored; `built_ns` tells one build from the next."""
    del built_ns
    return _Bench(elf, board).store(dict(parameters))


def avr_coprocessor(
    bus: SonarBus,
    *,
    elf: Path | None = None,
    board: str = "mega",
    seed: int = 0,
    parameters: Mapping[str, float] | None = None,
    start_us: int = 0,
) -> AvrBoard:
    """The flashed co-processor, as the simulator takes the native one.

    Power comes on at `start_us`. `parameters` are set over MAVLink beforehand, so that the board
    boots with them stored. `seed` sets the voltage that the board's random numbers begin with:
    it counts modulo 1024.
    """
    elf = elf or firmware.elf_path(board)
    firmware.check_elf(elf, board)
    wanted = tuple((parameters or {}).items())
    eeprom = _stored(elf, board, elf.stat().st_mtime_ns, wanted) if wanted else None
    noise = seed % _NOISE_STEPS
    return AvrBoard(bus, board=board, elf=elf, eeprom=eeprom, offset_us=start_us, noise=noise)
