"""The co-processor in a simulated flight: the firmware's own core, driven in lock step.

`NativeCoprocessor` runs the portable core as built for this machine (`make core`).
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

from echowing.errors import EchowingError, nearest

AUTOPILOT_PORT = 0
USB_PORT = 1

# The C library is built in the source tree; an installed package has none.
LIBRARY = Path(__file__).resolve().parents[4] / "build" / "host" / "libechowing_core.so"

# Far more than the core sends in one step of a simulation.
_TAKE_BYTES = 4096

_BusWrite = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_uint64, ctypes.c_uint8, ctypes.POINTER(ctypes.c_uint8), ctypes.c_uint8
)
_BusRead = _BusWrite


class SonarBus(Protocol):
    """The I2C device as the core sees it. Times in microseconds, addresses 7-bit."""

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        """Write to the device; True if it acknowledged."""

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        """Read `count` bytes; None if the device did not acknowledge."""


class Coprocessor(Protocol):
    """A co-processor at work, native or emulated. Ports: 0 autopilot, 1 USB."""

    @property
    def pan_us(self) -> float:
        """Pan servo pulse commanded now, microseconds."""

    @property
    def tilt_us(self) -> float:
        """Tilt servo pulse commanded now, microseconds."""

    @property
    def restarts(self) -> int:
        """How often it has restarted, or asked to be."""

    def feed(self, port: int, data: bytes) -> None:
        """Give bytes to a port's receiver."""

    def take(self, port: int) -> bytes:
        """Take what a port has sent since the last call."""

    def run_until(self, t_us: int) -> None:
        """Run the loop up to that time, microseconds."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A row of the firmware's parameter table."""

    name: str
    default: float
    least: float
    most: float
    whole: bool
    unit: str
    text: str


class _Row(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("normal", ctypes.c_float),
        ("least", ctypes.c_float),
        ("most", ctypes.c_float),
        ("whole", ctypes.c_int),
        ("unit", ctypes.c_char_p),
        ("text", ctypes.c_char_p),
    )


class NativeCoprocessor:
    """The core as a library of this machine.

    Args:
        bus: the sonar; called back while the core runs.
        seed: varies the jitter of the pings.
        parameters: firmware parameters to start with, by name.
        start_us: time of power-on, microseconds.

    Raises:
        EchowingError: the library is not built, or a parameter is unknown or out of range.

    """

    def __init__(
        self,
        bus: SonarBus,
        *,
        seed: int = 0,
        parameters: Mapping[str, float] | None = None,
        start_us: int = 0,
    ) -> None:
        self._handle: int | None = None
        self._library = _library()
        self._bus = bus
        self._fault: BaseException | None = None
        # C keeps only addresses: the callback objects have to live as long as the core.
        self._callbacks = _BusWrite(self._on_write), _BusRead(self._on_read)
        self._buffer = (ctypes.c_uint8 * _TAKE_BYTES)()
        self._handle = self._library.ew_create(*self._callbacks, seed & 0xFFFFFFFF, start_us)
        for name, value in (parameters or {}).items():
            self._set(name, value)

    def __del__(self) -> None:
        if self._handle is not None:
            self._library.ew_destroy(self._handle)

    @property
    def pan_us(self) -> float:
        """Pan servo pulse commanded now, microseconds."""
        return float(self._library.ew_pan_us(self._handle))

    @property
    def tilt_us(self) -> float:
        """Tilt servo pulse commanded now, microseconds."""
        return float(self._library.ew_tilt_us(self._handle))

    @property
    def led(self) -> bool:
        """Whether the status light is on."""
        return bool(self._library.ew_led(self._handle))

    @property
    def restarts(self) -> int:
        """How often the core has asked for a restart."""
        return int(self._library.ew_reboots(self._handle))

    def feed(self, port: int, data: bytes) -> None:
        """Give bytes to a port's receiver."""
        self._library.ew_feed(self._handle, port, data, len(data))

    def take(self, port: int) -> bytes:
        """Take what a port has sent since the last call."""
        taken = b""
        while count := self._library.ew_take(self._handle, port, self._buffer, _TAKE_BYTES):
            taken += ctypes.string_at(self._buffer, count)
        return taken

    def run_until(self, t_us: int) -> None:
        """Run the loop up to that time, microseconds, in turns of half a millisecond."""
        self._library.ew_run_until(self._handle, t_us)
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault

    def parameter(self, name: str) -> float:
        """Value in force of a firmware parameter."""
        return float(self._library.ew_get_parameter(self._handle, _parameter_index(name)))

    def _set(self, name: str, value: float) -> None:
        index = _parameter_index(name)
        if not self._library.ew_set_parameter(self._handle, index, value):
            row = parameter_table()[index]
            raise EchowingError(
                f"co-processor parameter {name}: {value:g} is not accepted; "
                f"it takes {'whole numbers from ' if row.whole else ''}"
                f"{row.least:g} to {row.most:g} {row.unit}".rstrip()
            )

    # An exception cannot pass through C: it is kept and raised when run_until returns.
    def _on_write(
        self, t_us: int, address: int, data: "ctypes._Pointer[ctypes.c_uint8]", n: int
    ) -> int:
        try:
            return self._bus.write(t_us, address, ctypes.string_at(data, n))
        except BaseException as error:
            self._fault = error
            return False

    def _on_read(
        self, t_us: int, address: int, data: "ctypes._Pointer[ctypes.c_uint8]", n: int
    ) -> int:
        try:
            answer = self._bus.read(t_us, address, n)
        except BaseException as error:
            self._fault = error
            return False
        if answer is None:
            return False
        ctypes.memmove(data, answer, n)
        return True


@cache
def parameter_table() -> tuple[Parameter, ...]:
    """The firmware's parameters, in the order of their index.

    Raises:
        EchowingError: the library is not built.

    """
    library = _library()
    rows = (library.ew_parameter_row(index) for index in range(library.ew_parameter_count()))
    return tuple(
        Parameter(
            row.name.decode(),
            row.normal,
            row.least,
            row.most,
            bool(row.whole),
            row.unit.decode(),
            row.text.decode(),
        )
        for row in rows
    )


def _parameter_index(name: str) -> int:
    names = [row.name for row in parameter_table()]
    if name not in names:
        raise EchowingError(
            f"the co-processor has no parameter {name!r}; it has {', '.join(names)}"
            f"{nearest(name, names)}"
        )
    return names.index(name)


@cache
def _library() -> ctypes.CDLL:
    if not LIBRARY.exists():
        raise EchowingError(
            f"the co-processor's core is not built ({LIBRARY}): run `make core` in a clone of the "
            "repository; an installed package has none"
        )
    library = ctypes.CDLL(str(LIBRARY))
    core, size = ctypes.c_void_p, ctypes.c_size_t
    library.ew_create.restype = core
    library.ew_create.argtypes = [_BusWrite, _BusRead, ctypes.c_uint32, ctypes.c_uint64]
    library.ew_destroy.argtypes = [core]
    library.ew_run_until.argtypes = [core, ctypes.c_uint64]
    library.ew_feed.argtypes = [core, ctypes.c_int, ctypes.c_char_p, size]
    library.ew_take.argtypes = [core, ctypes.c_int, ctypes.POINTER(ctypes.c_uint8), size]
    library.ew_take.restype = size
    for pulse in (library.ew_pan_us, library.ew_tilt_us):
        pulse.argtypes, pulse.restype = [core], ctypes.c_double
    library.ew_led.argtypes = [core]
    library.ew_reboots.argtypes, library.ew_reboots.restype = [core], ctypes.c_uint
    library.ew_parameter_row.argtypes, library.ew_parameter_row.restype = [ctypes.c_int], _Row
    library.ew_get_parameter.argtypes = [core, ctypes.c_int]
    library.ew_get_parameter.restype = ctypes.c_float
    library.ew_set_parameter.argtypes = [core, ctypes.c_int, ctypes.c_float]
    return library
