"""A board of which every instruction is emulated: the flashed binary, in lock step.

Time is the emulated one: the same input gives the same bytes twice. What emulates the chip is a
library for each family (firmware/emulator); `sim.boards.by_name` finds the one for a board.
"""

import ctypes
from abc import ABC
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from echowing.errors import EchowingError
from echowing.flight.sonar import PAN_CENTRE_US, TILT_CENTRE_US
from echowing.sim.boards import firmware
from echowing.sim.boards.coprocessor import SonarBus

EMULATORS = firmware.REPOSITORY / "build" / "emulator"

_TAKE_BYTES = 65536
_TAKE_EDGES = 1024


@dataclass(frozen=True)
class Pin:
    """A pin of the chip: port letter and bit."""

    port: str
    bit: int


@dataclass(frozen=True)
class BoardType:
    """What the emulator has to know about a board: the chip's side of the firmware's `boards/`."""

    name: str
    chip: str
    clock_hz: int
    uarts: tuple[str, str | None]  # autopilot; USB, None where that is no UART
    pan: Pin
    tilt: Pin
    led: Pin
    sda: Pin
    scl: Pin
    ram_bytes: int


@dataclass(frozen=True)
class Meters:
    """What the board has measured since power-on or the last `clear_meters`."""

    turns: int  # turns of the main loop
    longest_turn_us: float
    restarts: int  # by the watchdog or the program, since power-on
    stack_headroom_bytes: int  # never yet used, between static memory and the stack
    static_bytes: int
    bus_clocks: int  # clock pulses made by hand on the two-wire bus
    bus_stops: int  # STOP conditions made by hand


@dataclass(frozen=True)
class PinState:
    """Newest pulse on a pin; on the AVR to 1/16 us, and up to 1/4 us late (4 cycles)."""

    level: bool
    width_us: float
    period_us: float
    pulses: int


class _Pin(ctypes.Structure):
    _fields_ = (
        ("rise_tick", ctypes.c_uint64),
        ("width_ticks", ctypes.c_uint64),
        ("period_ticks", ctypes.c_uint64),
        ("pulses", ctypes.c_uint64),
        ("level", ctypes.c_int),
    )


class _Edge(ctypes.Structure):
    _fields_ = (("tick", ctypes.c_uint64), ("level", ctypes.c_uint8))


class _Meters(ctypes.Structure):
    _fields_ = (
        ("turns", ctypes.c_uint64),
        ("longest_ticks", ctypes.c_uint64),
        ("restarts", ctypes.c_uint64),
        ("stack_headroom", ctypes.c_uint32),
        ("static_bytes", ctypes.c_uint32),
        ("bus_clocks", ctypes.c_uint32),
        ("bus_stops", ctypes.c_uint32),
    )


_Bytes = ctypes.POINTER(ctypes.c_uint8)
_Write = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint8, _Bytes, ctypes.c_int
)
_Read = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint8, _Bytes, ctypes.c_int
)


def _declare(library: ctypes.CDLL) -> ctypes.CDLL:
    """Argument and result types of firmware/emulator/board.h."""
    board, size, u64 = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64
    text, char, pin = ctypes.c_char_p, ctypes.c_char, ctypes.c_int
    functions: dict[str, tuple[Any, list[Any]]] = {
        "board_power_on": (board, [text, text, ctypes.c_uint32, text, size]),
        "board_power_off": (None, [board]),
        "board_run_until": (ctypes.c_int, [board, u64]),
        "board_tick": (u64, [board]),
        "board_ticks_per_us": (ctypes.c_uint32, [board]),
        "board_fault": (text, [board]),
        "board_set_bus": (None, [board, _Write, _Read, ctypes.c_void_p]),
        "board_hold_bus": (None, [board, char, pin, pin, ctypes.c_int]),
        "board_feed": (ctypes.c_int, [board, char, text, size]),
        "board_take": (size, [board, char, ctypes.c_void_p, ctypes.c_void_p, size]),
        "board_uart_overruns": (u64, [board, char]),
        "board_uart_byte_ticks": (ctypes.c_uint32, [board, char]),
        "board_watch_pin": (pin, [board, char, ctypes.c_int]),
        "board_read_pin": (None, [board, pin, ctypes.POINTER(_Pin)]),
        "board_take_edges": (size, [board, pin, ctypes.POINTER(_Edge), size]),
        "board_set_noise": (None, [board, ctypes.c_uint32]),
        "board_memory_size": (ctypes.c_uint32, [board]),
        "board_memory_set": (ctypes.c_int, [board, text, size]),
        "board_memory_get": (ctypes.c_int, [board, ctypes.c_void_p, size]),
        "board_read_meters": (None, [board, ctypes.POINTER(_Meters)]),
        "board_clear_meters": (None, [board]),
    }
    for name, (result, arguments) in functions.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def board_type(name: str) -> BoardType:
    """The emulated board of that name; an error names those there are."""
    board = firmware.board(name)
    pins = {role: Pin(place[0], int(place[1:])) for role, place in board.chip_pins.items()}
    return BoardType(
        name=name,
        chip=board.chip,
        clock_hz=board.clock_hz,
        uarts=(board.uarts["autopilot"], board.uarts.get("usb")),
        pan=pins["PAN"],
        tilt=pins["TILT"],
        led=pins["LED"],
        sda=pins["SDA"],
        scl=pins["SCL"],
        ram_bytes=board.ram,
    )


@cache
def _load_library(path: Path, package: str) -> ctypes.CDLL:
    if not path.exists():
        raise EchowingError(f"no emulator in {path}: build it with `make emulator`")
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise EchowingError(
            f"cannot load the emulator: {error}. Install {package}, then `make emulator`"
        ) from error


class EmulatedBoard(ABC):
    """An emulated board under power, from power-on at microsecond 0.

    `bus` is the device on its I2C bus, asked in the board's microseconds plus `offset_us`; an error
    that it raises ends `run_until`. `memory` is what a former life left where parameters are kept.
    `noise` (0 to 1023) is what random numbers begin with.
    """

    LIBRARY: ClassVar[Path]
    PACKAGE: ClassVar[str]  # without which the library cannot be loaded

    def __init__(
        self,
        bus: SonarBus,
        *,
        board: str,
        elf: Path | None = None,
        eeprom: bytes | None = None,
        offset_us: int = 0,
        noise: int = 0,
    ) -> None:
        self.type = board_type(board)
        self._offset_us = offset_us
        elf = elf or firmware.elf_path(board)
        firmware.check_elf(elf, board)
        self._library = _declare(_load_library(self.LIBRARY, self.PACKAGE))
        self._board = self._power_on(elf)
        self._ticks_per_us = int(self._library.board_ticks_per_us(self._board))
        self._bus = bus
        self._bus_error: Exception | None = None
        self._callbacks = _Write(self._bus_write), _Read(self._bus_read)
        self._library.board_set_bus(self._board, *self._callbacks, None)
        self._pins: dict[Pin, int] = {}
        self._take = ctypes.create_string_buffer(_TAKE_BYTES)
        self._take_ticks = (ctypes.c_uint64 * _TAKE_BYTES)()
        self._library.board_set_noise(self._board, noise)
        if eeprom is not None:
            self._load_memory(eeprom)

    def _power_on(self, elf: Path) -> int:
        error = ctypes.create_string_buffer(256)
        handle = self._library.board_power_on(
            str(elf).encode(), self.type.chip.encode(), self.type.clock_hz, error, len(error)
        )
        if not handle:
            raise EchowingError(error.value.decode())
        return int(handle)

    def power_off(self) -> bytes:
        """Cut the power now; returns what the memory then holds (see `eeprom`)."""
        image = self.eeprom()
        self._library.board_power_off(self._board)
        self._board = 0
        return image

    def __del__(self) -> None:
        if getattr(self, "_board", 0):
            self._library.board_power_off(self._board)
            self._board = 0

    # ---- time

    @property
    def t_us(self) -> float:
        """Now, in microseconds with the offset."""
        return self._to_us(self._library.board_tick(self._board))

    def _to_us(self, tick: int) -> float:
        return tick / self._ticks_per_us + self._offset_us

    def run_until(self, t_us: float) -> None:
        """Run the program up to that time; it may end a few instructions later."""
        tick = round((t_us - self._offset_us) * self._ticks_per_us)
        stopped = self._library.board_run_until(self._board, max(0, tick))
        if self._bus_error is not None:
            error, self._bus_error = self._bus_error, None
            raise error
        if stopped:
            fault = self._library.board_fault(self._board).decode()
            raise EchowingError(f"the firmware stopped at {self.t_us / 1e6:.6f} s: {fault}")

    # ---- the bus

    def _bus_write(self, _: int, tick: int, address: int, data: Any, count: int) -> int:
        sent = bytes(data[:count]) if count else b""
        try:
            return int(self._bus.write(int(self._to_us(tick)), address, sent))
        except Exception as error:  # it cannot pass through C: run_until raises it
            self._bus_error = error
            return 0

    def _bus_read(self, _: int, tick: int, address: int, data: Any, count: int) -> int:
        try:
            answer = self._bus.read(int(self._to_us(tick)), address, count)
        except Exception as error:  # as above
            self._bus_error = error
            return -1
        if answer is None:
            return -1
        for index, value in enumerate(answer[:count]):
            data[index] = value
        return min(count, len(answer))

    def hold_bus(self, clocks: int) -> None:
        """Hold the data line low until the firmware has made `clocks` clock pulses by hand."""
        self._library.board_hold_bus(
            self._board,
            self.type.sda.port.encode(),
            self.type.sda.bit,
            self.type.scl.bit,
            clocks,
        )

    # ---- serial ports

    def feed(self, port: int, data: bytes) -> None:
        """Send bytes to a port (0 autopilot, 1 USB): they arrive one by one at its rate."""
        if self.has_port(port):
            self._library.board_feed(self._board, self._uart(port), data, len(data))

    def has_port(self, port: int) -> bool:
        """Whether the emulator has that port: the USB socket of some boards it has not."""
        return self.type.uarts[port] is not None

    def take(self, port: int) -> bytes:
        """Bytes the port has sent since the last call; none from a port that is not there."""
        taken = b""
        while count := self._take_some(port):
            taken += self._take.raw[:count]
        return taken

    def take_timed(self, port: int) -> list[tuple[float, int]]:
        """Like `take`, each byte with the time at which its stop bit ended, us."""
        taken: list[tuple[float, int]] = []
        while count := self._take_some(port):
            times = map(self._to_us, self._take_ticks[:count])
            taken += zip(times, self._take.raw[:count], strict=True)
        return taken

    def _take_some(self, port: int) -> int:
        return int(
            self._library.board_take(
                self._board, self._uart(port), self._take, self._take_ticks, _TAKE_BYTES
            )
        )

    def _uart(self, port: int) -> bytes:
        return (self.type.uarts[port] or "-").encode()  # no chip has a port of that name

    def overruns(self, port: int) -> int:
        """Bytes the receiver lost because the program did not read it in time."""
        return int(self._library.board_uart_overruns(self._board, self._uart(port)))

    def baud(self, port: int) -> float:
        """The port's rate as the program has set it."""
        ticks = self._library.board_uart_byte_ticks(self._board, self._uart(port))
        return 10e6 * self._ticks_per_us / float(ticks)

    # ---- pins

    @property
    def pan_us(self) -> float:
        """Pan pulse; straight ahead until the first one, as the servo stands where it was put."""
        return self.pin(self.type.pan).width_us or PAN_CENTRE_US

    @property
    def tilt_us(self) -> float:
        """Tilt pulse, likewise."""
        return self.pin(self.type.tilt).width_us or TILT_CENTRE_US

    def _watch(self, pin: Pin) -> int:
        if pin not in self._pins:
            index = self._library.board_watch_pin(self._board, pin.port.encode(), pin.bit)
            if index < 0:
                raise EchowingError(f"cannot watch pin P{pin.port}{pin.bit} of {self.type.chip}")
            self._pins[pin] = index
        return self._pins[pin]

    def pin(self, pin: Pin) -> PinState:
        """State of a pin; it is watched from the first call on."""
        state = _Pin()
        self._library.board_read_pin(self._board, self._watch(pin), ctypes.byref(state))
        return PinState(
            bool(state.level),
            state.width_ticks / self._ticks_per_us,
            state.period_ticks / self._ticks_per_us,
            state.pulses,
        )

    def edges(self, pin: Pin) -> list[tuple[float, bool]]:
        """Times (us) and levels of the edges since the last call, the newest 1024 at most."""
        edges = (_Edge * _TAKE_EDGES)()
        count = self._library.board_take_edges(self._board, self._watch(pin), edges, _TAKE_EDGES)
        return [(self._to_us(edge.tick), bool(edge.level)) for edge in edges[:count]]

    # ---- memory and meters

    @property
    def restarts(self) -> int:
        """How often it has restarted."""
        return self.meters().restarts

    def eeprom(self) -> bytes:
        """The parameters' memory, as a power cut now would leave it: what is being written is lost.

        The AVR's EEPROM; on the STM32 the two flash blocks at the end.
        """
        image = ctypes.create_string_buffer(self._library.board_memory_size(self._board))
        self._library.board_memory_get(self._board, image, len(image))
        return image.raw

    def _load_memory(self, image: bytes) -> None:
        if self._library.board_memory_set(self._board, image, len(image)):
            size = self._library.board_memory_size(self._board)
            raise EchowingError(f"memory image of {len(image)} bytes; the chip has {size}")

    def meters(self) -> Meters:
        """Loop turns, stack, restarts and bus recovery so far."""
        raw = _Meters()
        self._library.board_read_meters(self._board, ctypes.byref(raw))
        return Meters(
            turns=raw.turns,
            longest_turn_us=raw.longest_ticks / self._ticks_per_us,
            restarts=raw.restarts,
            stack_headroom_bytes=raw.stack_headroom,
            static_bytes=raw.static_bytes,
            bus_clocks=raw.bus_clocks,
            bus_stops=raw.bus_stops,
        )

    def clear_meters(self) -> None:
        """Start measuring loop turns and bus recovery anew."""
        self._library.board_clear_meters(self._board)
