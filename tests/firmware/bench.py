"""A bench for the board's binary: a sonar to command, ports to listen to, an autopilot.

The board is the Mega, or what ECHOWING_BOARD says (`make test-stm32`).
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from echowing.sim.boards import firmware
from echowing.sim.boards.by_name import emulated_board
from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, USB_PORT
from echowing.sim.boards.emulated import Pin
from echowing.sim.world.sonar import MaxSonar

STEP_US = 5_000
VEHICLE_ID = 7
# SYS_ID and COMP_ID as the firmware comes: it has not learned yet whose it is.
OUR_ID, OUR_COMPONENT = 250, 191
BOARD = firmware.board(os.environ.get("ECHOWING_BOARD", "mega"))
IS_STM32 = BOARD.family == firmware.STM32
HAS_USB = "usb" in BOARD.uarts  # in the emulator
# Where a ground station on the bench is plugged in.
CONSOLE_PORT = USB_PORT if HAS_USB else AUTOPILOT_PORT
PORTS = (AUTOPILOT_PORT, USB_PORT) if HAS_USB else (AUTOPILOT_PORT,)
# An STM32 is emulated at a quarter of its pace: what holds then holds on the chip, and sooner.
SLOWNESS = 4


class BenchSonar(MaxSonar):
    """A sonar whose target, answers and health the test decides, and which notes what it did."""

    def __init__(self, range_m: Callable[[float], float | None] | float | None = None) -> None:
        super().__init__(self._look)
        self.range_m = range_m
        self.raw_cm: int | None = None  # what is read whatever was measured
        self.part_information: int | None = None  # what is read before the first command
        self.read_before_ranging = False
        self.triggers_us: list[int] = []
        self.readings: list[tuple[int, int]] = []  # time, centimetres

    def _look(self, t_s: float) -> float | None:
        return self.range_m(t_s) if callable(self.range_m) else self.range_m

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        """As `SonarBus.write`."""
        acknowledged = super().write(t_us, address, data)
        if acknowledged and data == b"\x51":
            self.triggers_us.append(t_us)
        return acknowledged

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        """As `SonarBus.read`."""
        answer = super().read(t_us, address, count)
        if answer is not None and self.raw_cm is not None:
            answer = self.raw_cm.to_bytes(2, "big")
        if answer is not None and not self.triggers_us:
            self.read_before_ranging = True
            if self.part_information is not None:
                answer = self.part_information.to_bytes(2, "big")
        if answer is not None and self.triggers_us:
            self.readings.append((t_us, int.from_bytes(answer[:2], "big")))
        return answer


@dataclass(frozen=True)
class Heard:
    """A message, the time its last byte left the board, and the port."""

    t_us: float
    port: int
    message: Any


@dataclass
class Bench:
    """The board under power, its time in microseconds from power-on."""

    elf: Path
    sonar: BenchSonar = field(default_factory=BenchSonar)
    eeprom: bytes | None = None
    noise: int = 0
    heard: list[Heard] = field(default_factory=list)
    pulses: list[tuple[float, Pin, float]] = field(default_factory=list)  # end, pin, width us
    armed: bool | None = None  # the autopilot: None is silent
    raw: bytearray = field(default_factory=bytearray)  # everything the autopilot port sent

    def __post_init__(self) -> None:
        self.board = emulated_board(
            self.sonar,
            board=BOARD.name,
            elf=self.elf,
            eeprom=self.eeprom,
            noise=self.noise,
            slowness=SLOWNESS,
        )
        self._parsers = [mavlink.MAVLink(None) for _ in PORTS]
        for parser in self._parsers:
            parser.robust_parsing = True
        self._rises: dict[Pin, float] = {}
        self._next_beat_us = 0.0
        self._station = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        for pin in (self.board.type.pan, self.board.type.tilt, self.board.type.led):
            self.board.pin(pin)

    @property
    def t_us(self) -> float:
        """Now."""
        return self.board.t_us

    # ---- running

    def run(self, seconds: float) -> None:
        """Let time pass, listening."""
        end_us = self.t_us + seconds * 1e6
        while self.t_us < end_us:
            self._beat()
            self.board.run_until(min(end_us, self.t_us + STEP_US))
            self._listen()

    def run_until_heard(self, kind: str, seconds: float, port: int | None = None) -> Any:
        """The next message of a kind, or an assertion that it never came."""
        end_us = self.t_us + seconds * 1e6
        first = len(self.heard)
        while self.t_us < end_us:
            self.run(STEP_US / 1e6)
            for heard in self.heard[first:]:
                if heard.message.get_type() == kind and port in (None, heard.port):
                    return heard.message
            first = len(self.heard)
        raise AssertionError(f"no {kind} within {seconds} s")

    def _beat(self) -> None:
        if self.armed is None or self.t_us < self._next_beat_us:
            return
        self._next_beat_us = self.t_us + 1e6
        self.send_heartbeat(VEHICLE_ID, 1, armed=self.armed)

    def _listen(self) -> None:
        for port in PORTS:
            for t_us, byte in self.board.take_timed(port):
                if port == AUTOPILOT_PORT:
                    self.raw.append(byte)
                message = self._parsers[port].parse_char(bytes([byte]))
                if message is not None:
                    self.heard.append(Heard(t_us, port, message))
        for pin in (self.board.type.pan, self.board.type.tilt):
            for t_us, level in self.board.edges(pin):
                if level:
                    self._rises[pin] = t_us
                elif pin in self._rises:
                    self.pulses.append((t_us, pin, t_us - self._rises[pin]))

    # ---- speaking

    def send_heartbeat(self, system: int, component: int, *, armed: bool = False) -> None:
        """A heartbeat of some vehicle's component on the autopilot port."""
        autopilot = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 4, 4, 3
        )
        self.board.feed(AUTOPILOT_PORT, bytes(beat.pack(autopilot)))

    def send(self, message: Any, port: int = CONSOLE_PORT) -> None:
        """A message from a ground station."""
        self.board.feed(port, bytes(message.pack(self._station)))

    def command(self, command: int, *values: float, port: int = CONSOLE_PORT) -> Any:
        """COMMAND_LONG to the board; returns its acknowledgement."""
        padded = (*values, *([0.0] * (7 - len(values))))
        self.send(
            mavlink.MAVLink_command_long_message(self.system, OUR_COMPONENT, command, 0, *padded),
            port,
        )
        return self.run_until_heard("COMMAND_ACK", 0.2, port)

    def set_parameter(self, name: str, value: float, port: int = CONSOLE_PORT) -> Any:
        """PARAM_SET; returns the PARAM_VALUE that answers it."""
        self.send(
            mavlink.MAVLink_param_set_message(
                self.system, OUR_COMPONENT, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
            ),
            port,
        )
        return self.run_until_heard("PARAM_VALUE", 0.2, port)

    @property
    def system(self) -> int:
        """The system id the board speaks as by now."""
        newest = self.heard[-1].message if self.heard else None
        return int(newest.get_srcSystem()) if newest else OUR_ID

    # ---- what was heard

    def messages(self, kind: str, port: int = AUTOPILOT_PORT, since_us: float = 0.0) -> list[Heard]:
        """Messages of a kind on a port, in order."""
        return [
            heard
            for heard in self.heard
            if heard.port == port and heard.t_us >= since_us and heard.message.get_type() == kind
        ]

    def texts(self, port: int = AUTOPILOT_PORT, since_us: float = 0.0) -> list[str]:
        """Status texts on a port."""
        return [heard.message.text for heard in self.messages("STATUSTEXT", port, since_us)]

    def ranges_cm(self, since_us: float = 0.0) -> list[int]:
        """Ranges reported to the autopilot."""
        reports = self.messages("DISTANCE_SENSOR", since_us=since_us)
        return [heard.message.current_distance for heard in reports]

    def named(self, name: str, since_us: float = 0.0, port: int = AUTOPILOT_PORT) -> list[float]:
        """Values of a NAMED_VALUE_FLOAT on a port."""
        values = self.messages("NAMED_VALUE_FLOAT", port, since_us)
        return [heard.message.value for heard in values if heard.message.name == name]

    def aims(self, since_us: float = 0.0) -> Iterator[tuple[float, float, float]]:
        """Every frame of both servos: end of the longer pulse, pan and tilt width, us."""
        pan = [(t, w) for t, pin, w in self.pulses if pin == self.board.type.pan]
        tilt = [(t, w) for t, pin, w in self.pulses if pin == self.board.type.tilt]
        for (pan_end, pan_us), (tilt_end, tilt_us) in zip(pan, tilt, strict=False):
            if pan_end >= since_us:
                yield max(pan_end, tilt_end), pan_us, tilt_us
