"""What the flashed binary achieves on the emulated board: for `echowing bench`."""

import itertools
import math
import random
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from echowing.sim.boards import firmware
from echowing.sim.boards.by_name import emulated_board
from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, USB_PORT
from echowing.sim.world.sonar import MaxSonar

# SYS_ID and COMP_ID as the firmware comes: it has not learned yet whose it is.
DEVICE_SYSTEM, DEVICE_COMPONENT = 250, 191
STEP_US = 5_000
RANGE_M = 2.0
REPORT_PERIOD_US = 50_000
REQUEST_MESSAGE, AUTOPILOT_VERSION = 512, 148
# The vehicle whose board it then is, and what makes it look: how often it gets attitude and orders.
VEHICLE, LEARNED_S = 7, 6
ATTITUDE_S, ORDER_S, LOOK_STEP_S = 0.04, 0.1, 0.02
EARTH_FRAME = 4 | 8 | 16 | 64


class FirmwareFigure(NamedTuple):
    """One measured figure; goal: what it should be, in words."""

    what: str
    value: float
    unit: str
    goal: str


class _Sonar(MaxSonar):
    """Sees a target, or nothing; notes when it was read."""

    def __init__(self) -> None:
        super().__init__(lambda _: RANGE_M if self.target else None)
        self.target = True
        self.read_us: list[int] = []

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        answer = super().read(t_us, address, count)
        if answer is not None:
            self.read_us.append(t_us)
        return answer


class _Run:
    """A board at work: messages of the autopilot port, dated; pulses of the pan servo."""

    def __init__(self, board: str) -> None:
        self.sonar = _Sonar()
        self.board = emulated_board(self.sonar, board=board)
        self.messages: list[tuple[float, Any]] = []
        self.widths_us: list[float] = []
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._ground = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        self._autopilot = mavlink.MAVLink(None, srcSystem=VEHICLE, srcComponent=1)
        self._rise_us = 0.0
        self.board.pin(self.board.type.pan)

    def run(self, seconds: float) -> None:
        end_us = self.board.t_us + seconds * 1e6
        while self.board.t_us < end_us:
            self.board.run_until(self.board.t_us + STEP_US)
            self.board.take(USB_PORT)
            for t_us, byte in self.board.take_timed(AUTOPILOT_PORT):
                message = self._parser.parse_char(bytes([byte]))
                if message is not None:
                    self.messages.append((t_us, message))
            for t_us, up in self.board.edges(self.board.type.pan):
                if up:
                    self._rise_us = t_us
                else:
                    self.widths_us.append(t_us - self._rise_us)

    def send(self, message: Any, port: int = AUTOPILOT_PORT) -> None:
        self.board.feed(port, bytes(message.pack(self._ground)))

    def learn(self) -> None:
        """Let it learn its vehicle, which is armed."""
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, armed, 4, 4, 3
        )
        for _ in range(LEARNED_S):
            self.board.feed(AUTOPILOT_PORT, bytes(beat.pack(self._autopilot)))
            self.run(1.0)

    def look(self, seconds: float) -> None:
        """Lean and turn the vehicle for that long, and order it to look."""
        for k in range(round(seconds / LOOK_STEP_S)):
            lean = 0.3 * math.sin(k * LOOK_STEP_S)
            if k % round(ATTITUDE_S / LOOK_STEP_S) == 0:
                attitude = mavlink.MAVLink_attitude_message(0, lean, -lean, lean, 0.3, -0.3, 0.3)
                self.board.feed(AUTOPILOT_PORT, bytes(attitude.pack(self._autopilot)))
            if k % round(ORDER_S / LOOK_STEP_S) == 0:
                self.send(
                    mavlink.MAVLink_gimbal_device_set_attitude_message(
                        VEHICLE,
                        DEVICE_COMPONENT,
                        EARTH_FRAME,
                        [math.cos(0.05), 0.0, 0.0, math.sin(0.05)],
                        0.1,
                        0.0,
                        0.0,
                    )
                )
            self.run(LOOK_STEP_S)

    def times_us(self, kind: str, since_us: float = 0.0) -> list[float]:
        return [t for t, m in self.messages if m.get_type() == kind and t >= since_us]


def firmware_figures(board: str = "mega") -> Iterator[FirmwareFigure]:
    """Measure the binary that `make firmware` has built; EchowingError if there is none."""
    used = firmware.size(firmware.elf_path(board), board)
    kind = firmware.board(board)
    flash, ram = kind.flash_limit or kind.flash, kind.ram_limit or kind.ram
    yield FirmwareFigure(f"{board}: flash", used.flash, "bytes", f"under {flash}")
    yield FirmwareFigure(f"{board}: static RAM", used.ram, "bytes", f"under {ram}")
    run = _Run(board)
    started_s = time.perf_counter()
    yield from _reports(run)
    yield from _commands(run)
    yield from _pulses(run)
    yield from _load(run)
    speed = run.board.t_us / 1e6 / (time.perf_counter() - started_s)
    yield FirmwareFigure("emulated board, simulated per wall", speed, "s/s", "at least 3")


def _reports(run: _Run) -> Iterator[FirmwareFigure]:
    run.run(11.0)
    reports = run.times_us("DISTANCE_SENSOR")
    yield FirmwareFigure("power-on to first report", reports[0] / 1e3, "ms", "under 1000")
    steady = [t_us for t_us in reports if t_us > 1e6]
    read_us = [t_us for t_us in run.sonar.read_us if 1e6 < t_us < steady[-1]]
    late_us = max(min(t_us for t_us in steady if t_us > r) - r for r in read_us)
    yield FirmwareFigure("reading to last byte of its report", late_us / 1e3, "ms", "under 10")
    off_us = max(abs(b - a - REPORT_PERIOD_US) for a, b in itertools.pairwise(steady))
    yield FirmwareFigure("jitter of the reports", off_us / 1e3, "ms", "under 2")


def _commands(run: _Run) -> Iterator[FirmwareFigure]:
    waits_us = []
    for _ in range(20):
        asked_us = run.board.t_us
        values = (REQUEST_MESSAGE, 0, AUTOPILOT_VERSION, 0, 0, 0, 0, 0, 0)
        run.send(mavlink.MAVLink_command_long_message(DEVICE_SYSTEM, DEVICE_COMPONENT, *values))
        run.run(0.107)
        waits_us.append(run.times_us("COMMAND_ACK", asked_us)[0] - asked_us)
    yield FirmwareFigure("command to acknowledgement", max(waits_us) / 1e3, "ms", "under 20")


def _pulses(run: _Run) -> Iterator[FirmwareFigure]:
    run.sonar.target = False
    first = len(run.widths_us)
    run.run(5.0)
    run.sonar.target = True
    off_us = max(abs(width - round(width)) for width in run.widths_us[first:])
    yield FirmwareFigure("error of the servo pulses", off_us, "us", "under 1")


def _load(run: _Run) -> Iterator[FirmwareFigure]:
    """Everything at once: noise and requests on both ports while it looks, searches and tracks."""
    noise = random.Random(1)
    run.learn()
    run.board.clear_meters()
    for turn in range(8):
        run.sonar.target = turn % 4 != 0
        for port in (AUTOPILOT_PORT, USB_PORT):
            run.send(mavlink.MAVLink_param_request_list_message(0, 0), port)
            run.board.feed(port, noise.randbytes(2_000))
        run.look(1.0)
    meters = run.board.meters()
    lost = run.board.overruns(AUTOPILOT_PORT) + run.board.overruns(USB_PORT)
    yield FirmwareFigure("longest loop turn", meters.longest_turn_us / 1e3, "ms", "under 2")
    yield FirmwareFigure("stack head-room", meters.stack_headroom_bytes, "bytes", "over 1024")
    yield FirmwareFigure("bytes lost by the receivers", lost, "", "0")
