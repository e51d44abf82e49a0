"""One vehicle at the other end of a link, for tools that send requests and wait for answers.

The clock is an argument; nothing here waits except for the link. If the vehicle stops reporting,
the work ends with an error that says so.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.mavlink.connection import DEFAULT_BAUD
from echowing.mavlink.links import Link, wait
from echowing.mavlink.messages import (
    HEARTBEAT_PERIOD_S,
    TOOL_COMPONENT_ID,
    TOOL_SYSTEM_ID,
    command_long,
    tool_heartbeat,
)
from echowing.mavlink.plausible import Door
from echowing.mavlink.seats import OpenLink, Say, find_vehicles, known_id, parse_seat
from echowing.mavlink.signing import SETUP_LINK_ID, LinkSigning, read_key

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
FIND_TIMEOUT_S = 15.0
# Heartbeats come once per second; five missing in a row are not a radio's chance losses.
SILENCE_S = 6.0
POLL_S = 0.05

# ArduPilot keeps so many parameter requests waiting (GCS_Param.cpp, param_requests 20).
ASKED_AT_ONCE = 10
CHUNK_S = 0.25
# After a round, wait for answers that a slow radio still carries.
SHORTEST_ROUND_S, LONGEST_ROUND_S = 0.3, 2.0
# So many rounds in which nothing more comes: what is missing then does not exist. The second where
# a later round has brought something, so that the link loses messages: of one that loses a fifth
# each way a parameter that exists is passed over with a chance of 0.36^8, three in ten thousand.
ROUNDS_IN_VAIN, ROUNDS_IN_VAIN_LOSSY = 3, 8

SET_TRIES, COMMAND_TRIES = 4, 4
ANSWER_S = 1.0

Name = str | tuple[str, ...]
"""A parameter, or its names in the different generations: the first that exists is it."""


@dataclass(slots=True)
class Heard:
    """Messages of the vehicle and of what is wired to it, with our time of their arrival."""

    time_s: float
    message: Any = field(repr=False)


class Vehicle:
    """A vehicle found on a link; `poll` keeps the link alive."""

    def __init__(
        self,
        link: OpenLink,
        system_id: int,
        *,
        clock: Callable[[], float] = time.monotonic,
        say: Say = print,
    ) -> None:
        self.system_id = system_id
        self.base_mode: int | None = None
        self.mode: int | None = None
        self.texts: list[str] = []
        self.signs = False
        self._text_id = 0
        self._link = link
        self._clock = clock
        self._say = say
        self._beat_s = -math.inf
        self._rounds_in_vain = ROUNDS_IN_VAIN
        self._heard_s = self._state_at_s = clock()

    @property
    def name(self) -> str:
        """For messages to the operator."""
        return f"vehicle {self.system_id} on {self._link.link.name}"

    @property
    def armed(self) -> bool:
        """Motors armed, by the newest heartbeat; True if there is no recent one, to be safe."""
        if self.base_mode is None or self._state_is_old():
            return True
        return bool(self.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _state_is_old(self) -> bool:
        return self._clock() - self._state_at_s > SILENCE_S

    def now_s(self) -> float:
        """The time on our clock."""
        return self._clock()

    def send(self, message: Any) -> None:
        """Send a message to the vehicle."""
        self._link.send(message, self._clock())

    def poll(self, timeout_s: float = POLL_S, silence_s: float = SILENCE_S) -> list[Heard]:
        """New messages of the vehicle's system; waits at most `timeout_s` for one.

        Raises EchowingError if its autopilot has not reported for `silence_s`.
        """
        if self._clock() - self._beat_s >= HEARTBEAT_PERIOD_S:
            self._beat_s = self._clock()
            self.send(tool_heartbeat())
        wait([self._link.link], timeout_s)
        now_s = self._clock()
        heard = [
            Heard(now_s, message)
            for message in self._link.receive(now_s, self._say)
            if message.get_srcSystem() == self.system_id
        ]
        for one in heard:
            self._notice(one)
        if now_s - self._heard_s > silence_s:
            raise EchowingError(
                f"{self.name} is silent: no message of its autopilot for {silence_s:g} s; "
                "check the link, then try again"
            )
        return heard

    def _notice(self, heard: Heard) -> None:
        message = heard.message
        if message.get_srcComponent() != AUTOPILOT:
            return
        self._heard_s = heard.time_s
        self.signs = _is_signed(message)
        if message.get_type() == "HEARTBEAT":
            self.base_mode, self.mode = message.base_mode, message.custom_mode
            self._state_at_s = heard.time_s
        elif message.get_type() == "STATUSTEXT":
            self._take_text(message)

    def _take_text(self, message: Any) -> None:
        """A long text comes in pieces under one number."""
        if message.chunk_seq > 0 and message.id == self._text_id and self.texts:
            self.texts[-1] += str(message.text)
        else:
            self.texts.append(str(message.text))
        self._text_id = message.id

    def until(self, fits: Callable[[Any], bool], timeout_s: float) -> Any | None:
        """The first message that fits, None if none comes in time."""
        until_s = self._clock() + timeout_s
        while (left_s := until_s - self._clock()) > 0.0:
            for heard in self.poll(min(POLL_S, left_s)):
                if fits(heard.message):
                    return heard.message
        return None

    def until_state_known(self) -> None:
        """Wait for a heartbeat of the autopilot, so that `armed` is right."""
        while self.base_mode is None:
            self.poll()
        # Messages sent while the link opened are lost, and an autopilot forwards nothing to a link
        # on which it has received nothing.
        self._beat_s = -math.inf

    def forget(self) -> None:
        """Forget the vehicle's state, because it restarts; `armed` until it reports."""
        self.base_mode = self.mode = None
        self.texts.clear()

    def look_again(self) -> None:
        """Wait for a new heartbeat, after a time without listening."""
        self.poll(0.0)
        self.base_mode = None
        self.until_state_known()

    def refuse_armed(self, what: str) -> None:
        """Raise EchowingError if the motors are armed, or may be."""
        if self._state_is_old():
            raise EchowingError(
                f"{self.name}: its heartbeats do not arrive, so it may be armed: {what} only while "
                "it is known to be disarmed"
            )
        if self.armed:
            raise EchowingError(
                f"{self.name} is armed: {what} only while it is disarmed, on the ground"
            )

    # ---- parameters -----------------------------------------------------------------------------

    def read(self, names: Sequence[Name], component: int = AUTOPILOT) -> dict[str, float]:
        """Values of parameters, without those that the vehicle does not have.

        They are requested by name, because the whole list takes half a minute over a radio. A name
        that is still unanswered after some rounds without any answer does not exist.
        """
        answers = _Answers(names, component)
        in_vain = -1
        while in_vain < self._rounds_in_vain and (missing := answers.missing()):
            for start in range(0, len(missing), ASKED_AT_ONCE):
                chunk = missing[start : start + ASKED_AT_ONCE]
                for name in chunk:
                    self._ask(name, component)
                    answers.asked_s[name] = self._clock()
                self._collect(answers, chunk, CHUNK_S)
            self._collect(answers, missing, answers.patience_s)
            in_vain += 1
            if in_vain > 0 and len(answers.missing()) < len(missing):
                in_vain, self._rounds_in_vain = 0, ROUNDS_IN_VAIN_LOSSY
        return answers.found

    def _ask(self, name: str, component: int) -> None:
        self.send(
            mavlink.MAVLink_param_request_read_message(self.system_id, component, name.encode(), -1)
        )

    def _collect(self, answers: "_Answers", wanted: Sequence[str], timeout_s: float) -> None:
        """Take answers until all `wanted` ones are there, or the time is over."""
        until_s = self._clock() + timeout_s
        while self._clock() < until_s and not set(wanted).isdisjoint(answers.missing()):
            for heard in self.poll():
                answers.take(heard)

    def write(self, name: str, value: float) -> float:
        """Set a parameter; returns its value, requested again.

        The confirmation alone may only repeat the request. Raises EchowingError if the vehicle does
        not report the parameter at all.
        """
        change = mavlink.MAVLink_param_set_message(
            self.system_id, AUTOPILOT, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
        )
        for _ in range(SET_TRIES):
            self.send(change)
            if self.until(lambda m: _is_value(m, name), ANSWER_S) is not None:
                break
        values = self.read([name])
        if name not in values:
            raise EchowingError(
                f"{self.name} does not confirm {name}; does it have this parameter?"
            )
        return values[name]

    # ---- commands -------------------------------------------------------------------------------

    def command(self, number: int, *params: float) -> int | None:
        """Send a COMMAND_LONG; returns the MAV_RESULT, None if no answer comes."""
        return self._commanded(number, command_long(self.system_id, number, *params))

    def command_int(self, number: int, *params: float) -> int | None:
        """The same as COMMAND_INT, which some commands need."""
        filled = [*params, *(0.0,) * (4 - len(params))]
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
        return self._commanded(
            number,
            mavlink.MAVLink_command_int_message(
                self.system_id, AUTOPILOT, frame, number, 0, 0, *filled, 0, 0, 0.0
            ),
        )

    def _commanded(self, number: int, message: Any) -> int | None:
        for _ in range(COMMAND_TRIES):
            self.send(message)
            answer = self.until(lambda m: _is_answer(m, number), ANSWER_S)
            if answer is not None:
                return int(answer.result)
        return None

    # ---- files ----------------------------------------------------------------------------------

    def send_file_request(self, payload: bytes) -> None:
        """Send a FILE_TRANSFER_PROTOCOL payload."""
        self.send(
            mavlink.MAVLink_file_transfer_protocol_message(0, self.system_id, AUTOPILOT, payload)
        )

    def file_answers(self, timeout_s: float) -> list[bytes]:
        """New payloads for us; waits at most `timeout_s` for the first."""
        return [
            bytes(heard.message.payload)
            for heard in self.poll(timeout_s)
            if heard.message.get_type() == "FILE_TRANSFER_PROTOCOL"
            and heard.message.target_system == TOOL_SYSTEM_ID
            and heard.message.target_component == TOOL_COMPONENT_ID
        ]


class _Answers:
    """Parameters requested by name, and their answers."""

    def __init__(self, names: Sequence[Name], component: int) -> None:
        self.found: dict[str, float] = {}
        self.asked_s: dict[str, float] = {}
        self._names = [(name,) if isinstance(name, str) else name for name in names]
        self._component = component
        self._absent: set[str] = set()
        self._slowest_s: float | None = None

    def missing(self) -> list[str]:
        """What must still be requested: all names of the parameters without an answer."""
        return [
            name
            for alternatives in self._names
            if not any(one in self.found for one in alternatives)
            for name in alternatives
            if name not in self._absent
        ]

    def take(self, heard: Heard) -> None:
        """Take any message; a newer autopilot reports a parameter that does not exist."""
        message = heard.message
        if message.get_srcComponent() != self._component:
            return
        if message.get_type() == "PARAM_ERROR":
            self._absent.add(message.param_id)
        elif message.get_type() == "PARAM_VALUE" and message.param_id in self.asked_s:
            name = message.param_id
            self.found[name] = float(message.param_value)
            took_s = heard.time_s - self.asked_s[name]
            self._slowest_s = max(took_s, self._slowest_s or 0.0)

    @property
    def patience_s(self) -> float:
        """How long to wait for the missing ones, by the time that the others took."""
        if self._slowest_s is None:
            return LONGEST_ROUND_S
        return min(max(3.0 * self._slowest_s, SHORTEST_ROUND_S), LONGEST_ROUND_S)


def _is_signed(message: Any) -> bool:
    """Whether a message carries a signature, with or without our having the key."""
    flags = message.get_header().incompat_flags
    return bool(flags & mavlink.MAVLINK_IFLAG_SIGNED)


def _is_value(message: Any, name: str) -> bool:
    from_autopilot = message.get_srcComponent() == AUTOPILOT
    return bool(from_autopilot and message.get_type() == "PARAM_VALUE" and message.param_id == name)


def _is_answer(message: Any, number: int) -> bool:
    from_autopilot = message.get_srcComponent() == AUTOPILOT
    return bool(
        from_autopilot and message.get_type() == "COMMAND_ACK" and message.command == number
    )


@contextmanager
def open_vehicle(
    where: str,
    *,
    baud: int = DEFAULT_BAUD,
    signing_key_file: Path | None = None,
    say: Say = print,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Vehicle]:
    """The vehicle at `CONNECTION` or `CONNECTION@SYSTEM`, found and waiting.

    Raises EchowingError if no vehicle reports, or several do and none is named.
    """
    seat = parse_seat("vehicle", where, baud)
    key = read_key(signing_key_file)
    signing = None if key is None else LinkSigning(key, SETUP_LINK_ID)
    # What a parameter is has to be seen here to be set right.
    link = OpenLink(Link(seat.address, signing), Door(parameters={}))
    link.link.open()
    try:
        until_s = clock() + FIND_TIMEOUT_S
        links = {seat.address.text: link}
        if not find_vehicles([seat], links, clock, lambda: clock() > until_s, say):
            who = "autopilot" if seat.system_id is None else f"system {seat.system_id}"
            raise EchowingError(
                f"{seat.address.text}: no {who} has reported for {FIND_TIMEOUT_S:g} s; is it "
                "powered, is the connection string right, does another tool use the port?"
            )
        vehicle = Vehicle(link, known_id(seat), clock=clock, say=say)
        vehicle.until_state_known()
        yield vehicle
    finally:
        link.link.close()
