"""The co-processor at the other end of a connection, for the bench."""

import math
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import Any, Self

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.mavlink.messages import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID, command_long
from echowing.rig.messages import TELLING_PARAMETER, Frames, Roster, Source, is_telling, source_of
from echowing.rig.ports import USB_BAUD, Wire, find_port, open_wire
from echowing.rig.state import UNKNOWN, BoardState, Version

Clock = Callable[[], float]

# Opening the port resets a mega; its bootloader waits a second or two before it starts the sketch.
OPEN_TIMEOUT_S = 8.0
# Once a device has answered there is no start to wait for: the board would send a heartbeat
# every second.
TALKING_S = 4.0
ASK_PERIOD_S = 1.0
ANSWER_TIMEOUT_S = 1.0
STATE_TIMEOUT_S = 2.5  # the firmware reports its state once per second; one report may get lost
# A wire that loses 5 % of its packets each way loses one of seven commands or answers: one of
# 17,000 five times over.
TRIES = 5
# Parameters are listed as the wire is free between ranges: some 50 a second at 115200 baud.
LIST_QUIET_S = 0.5
# What the board writes into its memory it writes 2 s after the last change (firmware/README.md);
# a word of it that comes much sooner is about an earlier change.
STORE_DELAY_S = 2.0
STORED_TEXT = "Echowing: parameters stored"
IN_FLIGHT_TEXT = "Echowing: parameter not changed in flight"
# The board speaks as this system until it has learned whose it is (`kUnknownSystem` in the core).
UNKNOWN_SYSTEM_ID = 250
# The range of `set servo` (firmware/README.md, `kShortestPulse_us` in the core).
LEAST_PULSE_US, MOST_PULSE_US = 800, 2200

COMMAND_SCAN = mavlink.MAV_CMD_USER_1
COMMAND_SELF_TEST = mavlink.MAV_CMD_USER_3
_PAN_SERVO, _TILT_SERVO = 1, 2
_EVERYBODY: Source = (0, 0)  # broadcast

_INBOX_KEPT = 20_000  # messages nobody has polled; some minutes' worth


class ScanMode(IntEnum):
    """What `scan` orders; the numbers are the firmware's."""

    AUTO = 0  # as in flight: by what the autopilot does
    SCAN = 1
    CENTRE = 2  # stop, straight ahead


class CommandError(EchowingError):
    """The board has refused a command, or has not answered it."""


class Board:
    """The co-processor at the other end of a connection, for the bench.

    Every call that waits updates `state` meanwhile, and keeps the messages for `poll`.
    All of them raise PortLostError when the cable is pulled.
    """

    def __init__(
        self, wire: Wire, source: Source, *, name: str = "", clock: Clock = time.monotonic
    ) -> None:
        self.system_id, self.component_id = source
        self.name = name
        self.state = BoardState()
        self.frames = Frames()
        # Set to be handed the bytes as they come, with their time, before they are understood.
        self.tap: Callable[[float, bytes], None] | None = None
        self._wire = wire
        self._clock = clock
        self._mav = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)
        self._inbox: deque[Any] = deque(maxlen=_INBOX_KEPT)
        self._changed_at_s: float | None = None

    @property
    def texts(self) -> list[tuple[float, int, str]]:
        """STATUSTEXTs of the board: time_s, severity, text."""
        return list(self.state.texts)

    def now_s(self) -> float:
        """The clock of the messages' `_timestamp`."""
        return self._clock()

    def poll(self, timeout_s: float) -> list[Any]:
        """Wait at most `timeout_s` for a message; returns all messages since the last call.

        In order, from the board and all others on the wire; `_timestamp` is the time of arrival.
        """
        self._pump(0.0 if self._inbox else timeout_s)
        messages = list(self._inbox)
        self._inbox.clear()
        return messages

    def send(self, message: Any) -> None:
        """Send a MAVLink message."""
        self._wire.write(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def command(self, command: int, *params: float, timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        """Give a command (COMMAND_LONG) and wait for its acknowledgement.

        Sent again after `timeout_s` without one, TRIES times. Raises CommandError when the board
        refuses it, with the reason, or does not answer.
        """

        def ask(attempt: int) -> None:
            self.send(self._command(command, *params, confirmation=attempt))

        def is_answer(message: Any) -> bool:
            return (
                message.get_type() == "COMMAND_ACK"
                and message.command == command
                and self.is_from_board(message)
            )

        answer = self._ask(ask, is_answer, timeout_s)
        if answer is None:
            raise CommandError(f"{self._label()} has not answered command {command}; is it busy?")
        if answer.result != mavlink.MAV_RESULT_ACCEPTED:
            raise CommandError(f"{self._label()} {_refusal(command, answer.result)}")

    def _command(self, command: int, *params: float, confirmation: int = 0) -> Any:
        return command_long(
            self.system_id,
            command,
            *params,
            component_id=self.component_id,
            confirmation=confirmation,
        )

    def version(self) -> Version:
        """The version of its firmware."""

        def is_answer(message: Any) -> bool:
            return message.get_type() == "AUTOPILOT_VERSION" and self.is_from_board(message)

        answer = self._ask(lambda attempt: self.ask_version(), is_answer, ANSWER_TIMEOUT_S)
        if answer is None:
            raise CommandError(f"{self._label()} has not reported its version")
        return Version.of(answer)

    def wait_state(self, timeout_s: float = STATE_TIMEOUT_S) -> None:
        """Wait until the board has reported its state, or the time is over."""
        deadline_s = self._clock() + timeout_s
        while self.state.state == UNKNOWN and self._clock() < deadline_s:
            self._pump(deadline_s - self._clock())

    def ask_version(self) -> None:
        """Request the version without waiting: `state.version` is filled when it arrives."""
        wanted = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        self.send(self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, wanted))

    def parameters(self) -> dict[str, float]:
        """The whole list, in the board's order; missing ones are requested again."""
        heard: dict[int, Any] = {}
        count = None
        self.ask_parameters()
        for _ in range(2 * TRIES):
            count = self._collect(heard, count)
            if count is not None and len(heard) >= count:
                return {str(heard[i].param_id): float(heard[i].param_value) for i in range(count)}
            self._request_missing(heard, count)
        missing = "any" if count is None else f"{count - len(heard)} of {count}"
        raise EchowingError(
            f"{self._label()} has not reported {missing} of its parameters; try again"
        )

    def ask_parameters(self) -> None:
        """Request the whole list without waiting: `state.parameters` is filled as they arrive."""
        self.send(mavlink.MAVLink_param_request_list_message(self.system_id, self.component_id))

    def _request_missing(self, heard: dict[int, Any], count: int | None) -> None:
        if count is None:
            return self.ask_parameters()
        for index in sorted(set(range(count)) - set(heard)):
            self.send(self._parameter_request("", index))
        return None

    def _parameter_request(self, name: str, index: int = -1) -> Any:
        return mavlink.MAVLink_param_request_read_message(
            self.system_id, self.component_id, name.encode(), index
        )

    def _collect(self, heard: dict[int, Any], count: int | None) -> int | None:
        """Take parameters until no more come; returns how many the board has."""
        quiet_at_s = self._clock() + LIST_QUIET_S
        while self._clock() < quiet_at_s and (count is None or len(heard) < count):
            for message in self._pump(quiet_at_s - self._clock()):
                if message.get_type() != "PARAM_VALUE" or not self.is_from_board(message):
                    continue
                quiet_at_s = self._clock() + LIST_QUIET_S
                count = int(message.param_count)
                if message.param_index < count:
                    heard[message.param_index] = message
        return count

    def parameter(self, name: str) -> float:
        """One parameter; EchowingError if the board has none of that name."""
        answer = self._ask(
            lambda attempt: self.send(self._parameter_request(name)),
            lambda message: self._is_parameter(message, name),
            ANSWER_TIMEOUT_S / 2,
        )
        if answer is None:
            raise self._no_such_parameter(name)
        return float(answer.param_value)

    def set_parameter(self, name: str, value: float) -> float:
        """Set one; returns the value in use. Stored later: see `wait_stored`.

        Raises EchowingError when the board has no such parameter or refuses the value.
        """
        before = self.state.parameters.get(name)
        if before is None:
            before = self.parameter(name)
        message = mavlink.MAVLink_param_set_message(
            self.system_id,
            self.component_id,
            name.encode(),
            as_float32(value),
            mavlink.MAV_PARAM_TYPE_REAL32,
        )
        answer = self._ask(
            lambda attempt: self.send(message),
            lambda heard: self._is_parameter(heard, name),
            ANSWER_TIMEOUT_S,
        )
        if answer is None:
            raise CommandError(f"{self._label()} has not answered {name} = {value:g}")
        in_force = float(answer.param_value)
        if in_force != as_float32(value):
            why = ": not while the autopilot is armed" if self._in_flight() else _allowed(name)
            raise EchowingError(f"{name} = {value:g} is refused; it stays {in_force:g}{why}")
        self._adopt(answer)
        if in_force != before:
            self._changed_at_s = self._clock()
        return in_force

    def _in_flight(self) -> bool:
        """Whether the board has just refused a change because the autopilot is armed."""
        since_s = self._clock() - ANSWER_TIMEOUT_S
        return any(text == IN_FLIGHT_TEXT and at_s >= since_s for at_s, _, text in self.state.texts)

    def _is_parameter(self, message: Any, name: str) -> bool:
        if message.get_type() != "PARAM_VALUE" or message.param_id != name:
            return False
        # With a new id the answer already comes under it; SYS_ID 0 is nobody's yet.
        system_id = message.get_srcSystem()
        new_id = {
            "SYS_ID": 0 if system_id == UNKNOWN_SYSTEM_ID else system_id,
            "COMP_ID": message.get_srcComponent(),
        }
        return self.is_from_board(message) or message.param_value == new_id.get(name)

    def _no_such_parameter(self, name: str) -> EchowingError:
        names = list(self.state.parameters)
        if len(names) < 2:
            names = list(self.parameters())
        if name in names:
            return CommandError(f"{self._label()} has not reported its parameter {name}; try again")
        return EchowingError(
            f"{self._label()} has no parameter {name!r}; it has {', '.join(names)}"
        )

    def wait_stored(self, timeout_s: float = 5.0) -> bool:
        """Wait until the changes are in the board's memory; False: not yet.

        While the autopilot is armed the board does not store.
        """
        deadline_s = self._clock() + timeout_s
        while not self._is_stored():
            if self._clock() >= deadline_s:
                return False
            self._pump(deadline_s - self._clock())
        self._changed_at_s = None
        return True

    def _is_stored(self) -> bool:
        if self._changed_at_s is None:
            return True
        earliest_s = self._changed_at_s + 0.75 * STORE_DELAY_S
        return any(text == STORED_TEXT and at_s >= earliest_s for at_s, _, text in self.state.texts)

    def aim(self, pan_us: float, tilt_us: float) -> None:
        """Point the gimbal and hold it there; pulses in us. EchowingError when out of range."""
        for what, pulse_us in (("pan", pan_us), ("tilt", tilt_us)):
            if not LEAST_PULSE_US <= pulse_us <= MOST_PULSE_US:
                raise EchowingError(
                    f"{what} pulse {pulse_us:g} us: servos take {LEAST_PULSE_US} to {MOST_PULSE_US}"
                )
        self.command(mavlink.MAV_CMD_DO_SET_SERVO, _PAN_SERVO, pan_us)
        self.command(mavlink.MAV_CMD_DO_SET_SERVO, _TILT_SERVO, tilt_us)

    def scan(self, mode: ScanMode) -> None:
        """Make it scan, point straight ahead, or do as in flight."""
        self.command(COMMAND_SCAN, float(mode))

    def close(self) -> None:
        """Close the port."""
        self._wire.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def is_from_board(self, message: Any) -> bool:
        """Whether the board has sent it, not another device on the wire."""
        return source_of(message) == (self.system_id, self.component_id)

    def _take(self, data: bytes) -> list[Any]:
        """Take received bytes."""
        now_s = self._clock()
        messages = self.frames.parse(data, now_s)
        for message in messages:
            self._follow_identity(message)
            if self.is_from_board(message):
                self.state.update(message, now_s)
        self.state.tick(now_s)
        self._inbox.extend(messages)
        return messages

    def recognise(self, source: Source, heard: Iterable[Any]) -> None:
        """Take this sender for the board; `heard` are its messages until now."""
        self.system_id, self.component_id = source
        for message in filter(self.is_from_board, heard):
            self.state.update(message, message._timestamp)

    def _pump(self, timeout_s: float) -> list[Any]:
        data = self._wire.read(max(0.0, timeout_s))
        if data and self.tap is not None:
            self.tap(self._clock(), data)
        messages = self._take(data)
        if messages:
            self._wire.understood()
        return messages

    def _ask(
        self, ask: Callable[[int], None], is_answer: Callable[[Any], bool], timeout_s: float
    ) -> Any:
        """Request until there is an answer, TRIES times; None: no answer."""
        for attempt in range(TRIES):
            ask(attempt)
            deadline_s = self._clock() + timeout_s
            while self._clock() < deadline_s:
                for message in self._pump(deadline_s - self._clock()):
                    if is_answer(message):
                        return message
        return None

    def _follow_identity(self, message: Any) -> None:
        """The board takes the autopilot's system id when it detects it: follow."""
        if self.is_from_board(message) or not is_telling(message):
            return
        silent_s = self.state.silent_s
        if silent_s is not None and silent_s > ASK_PERIOD_S:
            self._adopt(message)

    def _adopt(self, message: Any) -> None:
        self.system_id, self.component_id = source_of(message)

    def _label(self) -> str:
        return f"the board on {self.name}" if self.name else "the board"


def open_board(port: str | None, baud: int = USB_BAUD, clock: Clock = time.monotonic) -> Board:
    """Find the board (with no `port`), open its port and wait until it reports.

    Raises EchowingError that says what is wrong: no such port, busy, forbidden, silent, at another
    baud rate, another device.
    """
    name = find_port() if port is None else port
    wire = open_wire(name, baud)
    try:
        return await_board(wire, name, baud, clock)
    except BaseException:
        wire.close()
        raise


def await_board(
    wire: Wire,
    name: str,
    baud: int,
    clock: Clock,
    timeout_s: float = OPEN_TIMEOUT_S,
    talking_s: float = TALKING_S,
) -> Board:
    """Wait until a board reports on an open wire. Raises EchowingError: none is.

    timeout_s: for the first byte; talking_s: after it, for the board.
    """
    board = Board(wire, (0, 0), name=name, clock=clock)
    questions = _Questions(board)
    start_s = clock()
    deadline_s = start_s + timeout_s
    heard: list[Any] = []
    talking = False
    while (now_s := clock()) < deadline_s:
        messages = board.poll(min(0.1, deadline_s - now_s))
        heard += messages
        questions.roster.note(messages)
        if found := questions.roster.boards():
            board.recognise(found[0], heard)
            return board
        if board.frames.counts.bytes and not talking:
            talking, deadline_s = True, min(deadline_s, now_s + talking_s)
        questions.ask(now_s)
    reason = _why_no_board(board, questions.roster, clock() - start_s, baud)
    raise EchowingError(f"{name}: {reason}")


class _Questions:
    """Asks each possible board whether it is one: at once, and again every second."""

    def __init__(self, board: Board) -> None:
        self.roster = Roster()
        self._board = board
        self._ask_at_s: dict[Source, float] = {}

    def ask(self, now_s: float) -> None:
        # An autopilot forwards nothing to a port on which it has received nothing.
        if self.roster.autopilot_heard() and self._is_due(_EVERYBODY, now_s):
            self._board.send(_heartbeat())
        for source in self.roster.candidates():
            if self._is_due(source, now_s):
                name = TELLING_PARAMETER.encode()
                self._board.send(mavlink.MAVLink_param_request_read_message(*source, name, -1))
        for source in self.roster.unbeaten():
            if self._is_due(source, now_s):
                system_id, component_id = source
                request, heartbeat = (
                    mavlink.MAV_CMD_REQUEST_MESSAGE,
                    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
                )
                self._board.send(
                    command_long(system_id, request, heartbeat, component_id=component_id)
                )

    def _is_due(self, source: Source, now_s: float) -> bool:
        due = now_s >= self._ask_at_s.get(source, now_s)
        if due:
            self._ask_at_s[source] = now_s + ASK_PERIOD_S
        return due


def _heartbeat() -> Any:
    kind, autopilot = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)


def _why_no_board(board: Board, roster: Roster, waited_s: float, baud: int) -> str:
    counts = board.frames.counts
    if counts.bytes == 0:
        cure = (
            "Is it the co-processor's port, and is the board flashed (`make flash`)? Its LED "
            "blinks when the firmware runs"
        )
        if ":" in board.name:  # a socket
            cure = "Does the other end send there, and has the board power?"
        return f"nothing has come in {waited_s:.0f} s. {cure}"
    if counts.frames == 0:
        return (
            f"{counts.bytes} bytes have come in {waited_s:.0f} s, and no MAVLink in them: the "
            f"baud rate may be wrong ({baud}; the board's USB port has {USB_BAUD}: --baud "
            f"{USB_BAUD}), or another program runs on the board"
        )
    others = roster.others() or ["MAVLink without a heartbeat"]
    return (
        f"this is not the co-processor but {', '.join(others)}. Choose the co-processor's own "
        "port with --port; behind an autopilot it reports once it is wired and has power"
    )


def as_float32(value: float) -> float:
    """The value as MAVLink carries it; infinite if it is too large."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def _allowed(name: str) -> str:
    """The values that the firmware accepts, if its table is available."""
    from echowing.sim.boards.coprocessor import parameter_table  # noqa: PLC0415 (needs the built core)

    try:
        row = next((row for row in parameter_table() if row.name == name), None)
    except EchowingError:
        return ""
    if row is None:
        return ""
    whole = "whole numbers from " if row.whole else ""
    return f"; it takes {whole}{row.least:g} to {row.most:g} {row.unit}".rstrip()


def _refusal(command: int, result: int) -> str:
    match result:
        case mavlink.MAV_RESULT_TEMPORARILY_REJECTED:
            return (
                f"refuses command {command} now: the autopilot beside it is armed, or a self test "
                "runs"
            )
        case mavlink.MAV_RESULT_DENIED:
            return f"refuses command {command}: a value is out of its range"
        case mavlink.MAV_RESULT_UNSUPPORTED:
            return f"does not know command {command}: is its firmware older than this tool?"
        case _:
            name = mavlink.enums["MAV_RESULT"].get(result)
            return f"refuses command {command}: {name.name if name else result}"
