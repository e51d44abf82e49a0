"""A board on the desk: the firmware's own core at the end of a fake cable, in its own time."""

from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.signing import Parser
from echowing.rig.board import Board, await_board
from echowing.rig.ports import PortLostError
from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, USB_PORT, NativeCoprocessor
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sim.world.sonar import MaxSonar

SLICE_S = 0.001
STEP_S = 0.02  # of the simulated autopilot


class Sonar(MaxSonar):
    """Hears `range_m`; answers nothing while unplugged."""

    def __init__(self, range_m: float | Callable[[float], float | None] | None) -> None:
        self.range_m = range_m
        self.plugged = True
        super().__init__(self._look)

    def _look(self, t_s: float) -> float | None:
        return self.range_m(t_s) if callable(self.range_m) else self.range_m

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        return self.plugged and super().write(t_us, address, data)

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        return super().read(t_us, address, count) if self.plugged else None


class CoreWire:
    """The core as a wire; time passes as it is read.

    drop: which of the board's frames get lost. armed: None, no autopilot is beside it. attitude:
    what that one tells 25 times a second: roll, pitch and yaw at a time, radians. scene: turns
    its servos by the board's pulses.
    """

    def __init__(self, range_m: float | None = 3.0) -> None:
        self.sonar = Sonar(range_m)
        self.autopilot_system = 1
        self.core = self._board()
        self.t_s = self.started_s = 0.0
        self.armed: bool | None = None
        self.drop: Callable[[Any], bool] = lambda message: False
        self.plugged = True
        self.others = b""
        self.sent: list[Any] = []
        self._parser = Parser()
        self._ears = mavlink.MAVLink(None)
        self._beat_at_s = self._attitude_at_s = 0.0
        self.attitude: Callable[[float], tuple[float, float, float]] | None = None
        self.scene: Callable[[float, float], None] | None = None

    def _board(self) -> NativeCoprocessor:
        return NativeCoprocessor(self.sonar, parameters={"SYS_ID": self.autopilot_system})

    def clock(self) -> float:
        return self.t_s

    def read(self, timeout_s: float) -> bytes:
        end_s = self.t_s + timeout_s
        while not (data := self._take()) and self.t_s < end_s:
            self.t_s += SLICE_S
            self._beat()
            self._lean()
            self.core.run_until(round((self.t_s - self.started_s) * 1e6))
            if self.scene is not None:
                self.scene(self.core.pan_us, self.core.tilt_us)
        return data

    def restart(self) -> None:
        """Power off and on."""
        self.core, self.started_s = self._board(), self.t_s

    def _take(self) -> bytes:
        if not self.plugged:
            raise PortLostError("desk: unplugged")
        others, self.others = self.others, b""
        said = self.core.take(USB_PORT)
        if not said:  # as in most milliseconds
            return others
        heard = self._parser.parse_buffer(said) or []
        whole = [message for message in heard if message.get_type() != "BAD_DATA"]
        kept = [bytes(message.get_msgbuf()) for message in whole if not self.drop(message)]
        return others + b"".join(kept)

    def _beat(self) -> None:
        if self.armed is None or self.t_s < self._beat_at_s:
            return
        self._beat_at_s = self.t_s + 1.0
        autopilot = mavlink.MAVLink(None, srcSystem=self.autopilot_system, srcComponent=1)
        self.core.feed(AUTOPILOT_PORT, autopilot_heartbeat(armed=self.armed).pack(autopilot))

    def _lean(self) -> None:
        if self.attitude is None or self.t_s < self._attitude_at_s:
            return
        self._attitude_at_s = self.t_s + 0.04
        now, soon = self.attitude(self.t_s), self.attitude(self.t_s + 0.001)
        rates = [(b - a) * 1000.0 for a, b in zip(now, soon, strict=True)]
        autopilot = mavlink.MAVLink(None, srcSystem=self.autopilot_system, srcComponent=1)
        told = mavlink.MAVLink_attitude_message(0, *now, *rates)
        self.core.feed(AUTOPILOT_PORT, told.pack(autopilot))

    def write(self, data: bytes) -> None:
        self.sent += self._ears.parse_buffer(data) or []
        self.core.feed(USB_PORT, data)

    def understood(self) -> None:
        pass

    def close(self) -> None:
        self.plugged = False

    def open(self) -> Board:
        return await_board(self, "desk", 115_200, self.clock)


class RoutingWire:
    """The telemetry port of a simulated autopilot, system 2; a board is on another of its ports."""

    def __init__(self) -> None:
        self._pilot = Autopilot(Copter((0.0, 0.0, 0.0)), system_id=2)
        for name in ("board", "telemetry"):
            self._pilot.add_link(name)
        self._board = Speaker(2, 191)
        self._beat_at_s = self._t_s = 0.0

    def clock(self) -> float:
        return self._t_s

    def read(self, timeout_s: float) -> bytes:
        end_s = self._t_s + timeout_s
        while not (data := self._pilot.transmit("telemetry")) and self._t_s < end_s:
            self._t_s += STEP_S
            if self._t_s >= self._beat_at_s:
                self._beat_at_s += 1.0
                beat = self._board.say(device_heartbeat(), value("SNR_STATE", 2.0))
                self._pilot.receive("board", beat)
            self._pilot.step(self._t_s)
        return data

    def write(self, data: bytes) -> None:
        self._pilot.receive("telemetry", data)

    def understood(self) -> None:
        pass

    def close(self) -> None:
        pass


class ScriptedWire:
    """Bytes that come at their times, seconds; what is written is kept."""

    def __init__(self, *script: tuple[float, bytes]) -> None:
        self._script: Iterator[tuple[float, bytes]] = iter(script)
        self._next = next(self._script, None)
        self.t_s = 0.0
        self.sent: list[Any] = []
        self._ears = mavlink.MAVLink(None)

    def clock(self) -> float:
        return self.t_s

    def read(self, timeout_s: float) -> bytes:
        end_s = self.t_s + timeout_s
        if self._next is None or self._next[0] > end_s:
            self.t_s = end_s
            return b""
        at_s, data = self._next
        self.t_s = max(self.t_s, at_s)
        self._next = next(self._script, None)
        return data

    def write(self, data: bytes) -> None:
        self.sent += self._ears.parse_buffer(data) or []

    def understood(self) -> None:
        pass

    def close(self) -> None:
        pass


def autopilot_heartbeat(*, armed: bool = False) -> Any:
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, 4, 3
    )


def device_heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
    )


def value(name: str, number: float, boot_ms: int = 1000) -> Any:
    return mavlink.MAVLink_named_value_float_message(boot_ms, name.encode(), number)


def report(distance_cm: int, *, quality: int = 100) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        0, 20, 765, distance_cm, 1, 0, 0, 255, signal_quality=quality
    )


def text(words: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> Any:
    return mavlink.MAVLink_statustext_message(severity, words.encode())


class Speaker:
    """Somebody on the wire: packs with his ids and his sequence numbers."""

    def __init__(self, system: int = 1, component: int = 191) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def say(self, *messages: Any) -> bytes:
        return b"".join(self._frame(message) for message in messages)

    def skip(self, count: int) -> None:
        """Frames that nobody gets."""
        self._mav.seq = (self._mav.seq + count) % 256

    def _frame(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._mav))
        self.skip(1)
        return frame
