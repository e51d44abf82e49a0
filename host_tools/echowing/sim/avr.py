"""The co-processor as it is flashed: the AVR binary on an emulated board, in lock step.

`AvrBoard` is the board with its ports, pins and memory; `AvrCoprocessor` wraps it in the interface
of the native core, so that the simulator flies either. Time is the AVR's own cycle count: the same
input gives the same bytes twice.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from echowing import firmware
from echowing.errors import EchowingError
from echowing.sim.coprocessor import USB_PORT, SonarBus
from echowing.sim.sonar import PAN_CENTRE_US, TILT_CENTRE_US, MaxSonar

LIBRARY = firmware.REPOSITORY / "build" / "emulator" / "libechowing_avr.so"

_SUPPLY_MV, _ANALOG_STEPS = 5000, 1024
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

    mcu: str
    clock_hz: int
    uarts: tuple[str, str]  # autopilot, USB
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
    restarts: int  # by the watchdog, since power-on
    stack_headroom_bytes: int  # never yet used, between static memory and the stack
    static_bytes: int
    bus_clocks: int  # clock pulses made by hand on the two-wire bus
    bus_stops: int  # STOP conditions made by hand


@dataclass(frozen=True)
class PinState:
    """Newest pulse on a pin, to 1/16 us at 16 MHz (simavr dates an edge up to 4 cycles late)."""

    level: bool
    width_us: float
    period_us: float
    pulses: int


class _Pin(ctypes.Structure):
    _fields_ = (
        ("rise_cycle", ctypes.c_uint64),
        ("width_cycles", ctypes.c_uint64),
        ("period_cycles", ctypes.c_uint64),
        ("pulses", ctypes.c_uint64),
        ("level", ctypes.c_int),
    )


class _Edge(ctypes.Structure):
    _fields_ = (("cycle", ctypes.c_uint64), ("level", ctypes.c_uint8))


class _Meters(ctypes.Structure):
    _fields_ = (
        ("turns", ctypes.c_uint64),
        ("longest_cycles", ctypes.c_uint64),
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
    """Argument and result types of avr_board.h."""
    board, size, u64 = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64
    text, char, pin = ctypes.c_char_p, ctypes.c_char, ctypes.c_int
    functions: dict[str, tuple[Any, list[Any]]] = {
        "board_power_on": (board, [text, text, ctypes.c_uint32, text, size]),
        "board_power_off": (None, [board]),
        "board_run_until": (ctypes.c_int, [board, u64]),
        "board_cycle": (u64, [board]),
        "board_fault": (text, [board]),
        "board_set_bus": (None, [board, _Write, _Read, ctypes.c_void_p]),
        "board_hold_bus": (None, [board, char, pin, pin, ctypes.c_int]),
        "board_feed": (ctypes.c_int, [board, char, text, size]),
        "board_take": (size, [board, char, ctypes.c_void_p, ctypes.c_void_p, size]),
        "board_uart_overruns": (u64, [board, char]),
        "board_uart_byte_cycles": (ctypes.c_uint32, [board, char]),
        "board_watch_pin": (pin, [board, char, ctypes.c_int]),
        "board_read_pin": (None, [board, pin, ctypes.POINTER(_Pin)]),
        "board_take_edges": (size, [board, pin, ctypes.POINTER(_Edge), size]),
        "board_set_analog": (None, [board, ctypes.c_int, ctypes.c_uint32]),
        "board_eeprom_size": (ctypes.c_uint32, [board]),
        "board_eeprom_set": (ctypes.c_int, [board, text, size]),
        "board_eeprom_get": (ctypes.c_int, [board, ctypes.c_void_p, size]),
        "board_read_meters": (None, [board, ctypes.POINTER(_Meters)]),
        "board_clear_meters": (None, [board]),
    }
    for name, (result, arguments) in functions.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _load_library() -> ctypes.CDLL:
    if not LIBRARY.exists():
        raise EchowingError(f"no emulator in {LIBRARY}: build it with `make emulator`")
    try:
        return _declare(ctypes.CDLL(str(LIBRARY)))
    except OSError as error:
        raise EchowingError(
            f"cannot load the emulator: {error}. Install libsimavr2, then `make emulator`"
        ) from error


def board_type(name: str) -> BoardType:
    """The emulated board of that name; an error names those there are."""
    known = [board.name for board in firmware.BOARDS.values() if board.family == firmware.AVR]
    if name not in known:
        raise EchowingError(
            f"no emulator for board {name!r}: only {', '.join(known)} can be emulated"
        )
    board = firmware.board(name)
    pins = {role: Pin(place[0], int(place[1:])) for role, place in board.chip_pins.items()}
    return BoardType(
        mcu=board.chip,
        clock_hz=board.clock_hz,
        uarts=(board.uarts["autopilot"], board.uarts["usb"]),
        pan=pins["PAN"],
        tilt=pins["TILT"],
        led=pins["LED"],
        sda=pins["SDA"],
        scl=pins["SCL"],
        ram_bytes=board.ram,
    )


class AvrBoard:
    """An emulated board under power, from power-on at microsecond 0.

    `bus` is the device on its I2C bus, asked in AVR microseconds plus `offset_us`; an error that
    it raises ends `run_until`. `eeprom` is what a former life left. `noise` (0 to 1023) is what
    the open analogue input A0 reads, with which random numbers begin.
    """

    def __init__(
        self,
        bus: SonarBus,
        *,
        board: str = "mega",
        elf: Path | None = None,
        eeprom: bytes | None = None,
        offset_us: int = 0,
        noise: int = 0,
    ) -> None:
        self.type = board_type(board)
        self._offset_us = offset_us
        self._cycles_per_us = self.type.clock_hz // 1_000_000
        elf = elf or firmware.elf_path(board)
        firmware.check_elf(elf, board)
        self._library = _load_library()
        self._board = self._power_on(elf)
        self._bus = bus
        self._bus_error: Exception | None = None
        self._callbacks = _Write(self._bus_write), _Read(self._bus_read)
        self._library.board_set_bus(self._board, *self._callbacks, None)
        self._pins: dict[Pin, int] = {}
        self._take = ctypes.create_string_buffer(_TAKE_BYTES)
        self._take_cycles = (ctypes.c_uint64 * _TAKE_BYTES)()
        # Half a step on, so that the converter's rounding gives the number asked for.
        millivolts = (2 * noise + 1) * _SUPPLY_MV // (2 * _ANALOG_STEPS)
        self._library.board_set_analog(self._board, 0, millivolts)
        if eeprom is not None:
            self._load_eeprom(eeprom)

    def _power_on(self, elf: Path) -> int:
        error = ctypes.create_string_buffer(256)
        handle = self._library.board_power_on(
            str(elf).encode(), self.type.mcu.encode(), self.type.clock_hz, error, len(error)
        )
        if not handle:
            raise EchowingError(error.value.decode())
        return int(handle)

    def power_off(self) -> bytes:
        """Cut the power now; returns what the EEPROM then holds (see `eeprom`)."""
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
        return self._to_us(self._library.board_cycle(self._board))

    def _to_us(self, cycle: int) -> float:
        return cycle / self._cycles_per_us + self._offset_us

    def run_until(self, t_us: float) -> None:
        """Run the program up to that time; it may end a few cycles later."""
        cycle = round((t_us - self._offset_us) * self._cycles_per_us)
        stopped = self._library.board_run_until(self._board, max(0, cycle))
        if self._bus_error is not None:
            error, self._bus_error = self._bus_error, None
            raise error
        if stopped:
            fault = self._library.board_fault(self._board).decode()
            raise EchowingError(f"the firmware stopped at {self.t_us / 1e6:.6f} s: {fault}")

    # ---- the bus

    def _bus_write(self, _: int, cycle: int, address: int, data: Any, count: int) -> int:
        sent = bytes(data[:count]) if count else b""
        try:
            return int(self._bus.write(int(self._to_us(cycle)), address, sent))
        except Exception as error:  # it cannot pass through C: run_until raises it
            self._bus_error = error
            return 0

    def _bus_read(self, _: int, cycle: int, address: int, data: Any, count: int) -> int:
        try:
            answer = self._bus.read(int(self._to_us(cycle)), address, count)
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
        self._library.board_feed(self._board, self._uart(port), data, len(data))

    def take(self, port: int) -> bytes:
        """Bytes the port has sent since the last call."""
        taken = b""
        while count := self._take_some(port):
            taken += self._take.raw[:count]
        return taken

    def take_timed(self, port: int) -> list[tuple[float, int]]:
        """Like `take`, each byte with the time at which its stop bit ended, us."""
        taken: list[tuple[float, int]] = []
        while count := self._take_some(port):
            times = map(self._to_us, self._take_cycles[:count])
            taken += zip(times, self._take.raw[:count], strict=True)
        return taken

    def _take_some(self, port: int) -> int:
        return int(
            self._library.board_take(
                self._board, self._uart(port), self._take, self._take_cycles, _TAKE_BYTES
            )
        )

    def _uart(self, port: int) -> bytes:
        return self.type.uarts[port].encode()

    def overruns(self, port: int) -> int:
        """Bytes the receiver lost because the program did not read it in time."""
        return int(self._library.board_uart_overruns(self._board, self._uart(port)))

    def baud(self, port: int) -> float:
        """The port's rate as the program has set it."""
        cycles = self._library.board_uart_byte_cycles(self._board, self._uart(port))
        return 10.0 * self.type.clock_hz / float(cycles)

    # ---- pins

    def _watch(self, pin: Pin) -> int:
        if pin not in self._pins:
            index = self._library.board_watch_pin(self._board, pin.port.encode(), pin.bit)
            if index < 0:
                raise EchowingError(f"cannot watch pin P{pin.port}{pin.bit} of {self.type.mcu}")
            self._pins[pin] = index
        return self._pins[pin]

    def pin(self, pin: Pin) -> PinState:
        """State of a pin; it is watched from the first call on."""
        state = _Pin()
        self._library.board_read_pin(self._board, self._watch(pin), ctypes.byref(state))
        return PinState(
            bool(state.level),
            state.width_cycles / self._cycles_per_us,
            state.period_cycles / self._cycles_per_us,
            state.pulses,
        )

    def edges(self, pin: Pin) -> list[tuple[float, bool]]:
        """Times (us) and levels of the edges since the last call, the newest 1024 at most."""
        edges = (_Edge * _TAKE_EDGES)()
        count = self._library.board_take_edges(self._board, self._watch(pin), edges, _TAKE_EDGES)
        return [(self._to_us(edge.cycle), bool(edge.level)) for edge in edges[:count]]

    # ---- memory and meters

    def eeprom(self) -> bytes:
        """The EEPROM as a power cut now would leave it: a byte being written reads as erased."""
        image = ctypes.create_string_buffer(self._library.board_eeprom_size(self._board))
        self._library.board_eeprom_get(self._board, image, len(image))
        return image.raw

    def _load_eeprom(self, image: bytes) -> None:
        if self._library.board_eeprom_set(self._board, image, len(image)):
            size = self._library.board_eeprom_size(self._board)
            raise EchowingError(f"EEPROM image of {len(image)} bytes; the chip has {size}")

    def meters(self) -> Meters:
        """Loop turns, stack, restarts and bus recovery so far."""
        raw = _Meters()
        self._library.board_read_meters(self._board, ctypes.byref(raw))
        return Meters(
            turns=raw.turns,
            longest_turn_us=raw.longest_cycles / self._cycles_per_us,
            restarts=raw.restarts,
            stack_headroom_bytes=raw.stack_headroom,
            static_bytes=raw.static_bytes,
            bus_clocks=raw.bus_clocks,
            bus_stops=raw.bus_stops,
        )

    def clear_meters(self) -> None:
        """Start measuring loop turns and bus recovery anew."""
        self._library.board_clear_meters(self._board)


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
        heartbeat = self._wait("HEARTBEAT", _BOOT_US)
        if heartbeat is None:
            raise EchowingError("the emulated firmware sends no heartbeat on its USB port")
        for name, value in parameters.items():
            self._set(heartbeat.get_srcSystem(), heartbeat.get_srcComponent(), name, value)
        self._board.run_until(self._t_us + _STORE_US)
        return self._board.power_off()

    def _set(self, system: int, component: int, name: str, value: float) -> None:
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


@lru_cache(maxsize=64)
def _stored(
    elf: Path, board: str, built_ns: int, parameters: tuple[tuple[str, float], ...]
) -> bytes:
    """EEPROM of a board with these parameters stored; `built_ns` tells one build from the next."""
    del built_ns
    return _Bench(elf, board).store(dict(parameters))


class AvrCoprocessor:
    """The flashed co-processor in the simulator's clothes: the interface of `NativeCoprocessor`.

    Power comes on at `start_us`. `parameters` are set over MAVLink beforehand, so that the board
    boots with them stored. `seed` sets the voltage that the board's random numbers begin with:
    it counts modulo 1024.
    """

    def __init__(
        self,
        bus: SonarBus,
        *,
        elf: Path | None = None,
        board: str = "mega",
        seed: int = 0,
        parameters: Mapping[str, float] | None = None,
        start_us: int = 0,
    ) -> None:
        elf = elf or firmware.elf_path(board)
        firmware.check_elf(elf, board)
        wanted = tuple((parameters or {}).items())
        eeprom = _stored(elf, board, elf.stat().st_mtime_ns, wanted) if wanted else None
        self.board = AvrBoard(
            bus, board=board, elf=elf, eeprom=eeprom, offset_us=start_us, noise=seed % _ANALOG_STEPS
        )
        self._pan, self._tilt = self.board.type.pan, self.board.type.tilt
        self.board.pin(self._pan)
        self.board.pin(self._tilt)

    @property
    def pan_us(self) -> float:
        """Pan pulse; straight ahead until the first one, as the servo stands where it was put."""
        return self.board.pin(self._pan).width_us or PAN_CENTRE_US

    @property
    def tilt_us(self) -> float:
        """Tilt pulse, likewise."""
        return self.board.pin(self._tilt).width_us or TILT_CENTRE_US

    def feed(self, port: int, data: bytes) -> None:
        """UART in: 0 autopilot, 1 USB."""
        self.board.feed(port, data)

    def take(self, port: int) -> bytes:
        """UART out."""
        return self.board.take(port)

    def run_until(self, t_us: int) -> None:
        """Run the program up to that time."""
        self.board.run_until(t_us)
