"""MAVLink from the board's bytes, with counts of complete, damaged and lost frames.

`links.Link` drops damaged frames silently; on the bench their number is a measurement.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.plausible import Door
from echowing.mavlink.signing import GARBAGE, Parser

# Sender of a message: system id and component id.
Source = tuple[int, int]

# Names of values and a parameter that only the co-processor's firmware has.
VALUE_PREFIX = "SNR_"
TELLING_PARAMETER = "SONAR_PERIOD"

_AUTOPILOTS = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot",
    mavlink.MAV_AUTOPILOT_PX4: "PX4",
    mavlink.MAV_AUTOPILOT_GENERIC: "a generic autopilot",
}


@dataclass(slots=True)
class Counts:
    """Counts of what has arrived so far."""

    bytes: int = 0
    frames: int = 0  # whole and undamaged
    refused: int = 0  # of these, that cannot be
    damaged: int = 0  # frames that failed their checksum, after the first good one
    garbage_bytes: int = 0  # bytes between frames, after the first
    lost: int = 0  # by the gaps in the sequence numbers


class Frames:
    """Bytes in, messages out."""

    def __init__(self) -> None:
        self.counts = Counts()
        self.door = Door(parameters={})
        self._parser = Parser()
        self._sequences: dict[Source, int] = {}

    def parse(self, data: bytes, now_s: float) -> list[Any]:
        """Complete, known messages in their order; each gets `_timestamp` = now_s."""
        self.counts.bytes += len(data)
        parsed = self._parser.parse_buffer(data) or ()
        return [message for message in parsed if self._is_good(message, now_s)]

    def _is_good(self, message: Any, now_s: float) -> bool:
        """Count it; returns whether it is a message with a right checksum that makes sense."""
        message._timestamp = now_s
        if message.get_type() == "BAD_DATA":
            self._count_bad(message)
            return False
        if message.get_msgId() < 0:  # unknown to us, so that nobody has checked it
            return False
        self.counts.frames += 1
        source, sequence = source_of(message), message.get_seq()
        if source in self._sequences:
            self.counts.lost += (sequence - self._sequences[source] - 1) % 256
        self._sequences[source] = sequence
        admitted = self.door.admits(message)
        self.counts.refused += not admitted
        return admitted

    def _count_bad(self, message: Any) -> None:
        if self.counts.frames == 0:  # we came in the middle of a frame, or there are none
            return
        if message.reason == GARBAGE:
            self.counts.garbage_bytes += len(message.data)
        else:
            self.counts.damaged += 1


@dataclass(slots=True)
class _Seen:
    heartbeat: Any = None
    telling: bool = False


@dataclass(slots=True)
class Roster:
    """Who reports, and which of them is an Echowing co-processor."""

    _seen: dict[Source, _Seen] = field(default_factory=dict)

    def note(self, messages: Iterable[Any]) -> None:
        """Take messages."""
        for message in messages:
            seen = self._seen.setdefault(source_of(message), _Seen())
            if message.get_type() == "HEARTBEAT":
                seen.heartbeat = message
            seen.telling = seen.telling or is_telling(message)

    def boards(self) -> list[Source]:
        """The co-processors, in the order of their first messages."""
        return [
            source
            for source, seen in self._seen.items()
            if seen.telling and _is_device(seen.heartbeat)
        ]

    def candidates(self) -> list[Source]:
        """Devices that are not identified yet."""
        return [
            source
            for source, seen in self._seen.items()
            if not seen.telling and _is_device(seen.heartbeat)
        ]

    def unbeaten(self) -> list[Source]:
        """Senders like a co-processor, without a heartbeat yet."""
        return [
            source for source, seen in self._seen.items() if seen.telling and not seen.heartbeat
        ]

    def autopilot_heard(self) -> bool:
        """Whether an autopilot sends heartbeats here: devices behind it may report through it."""
        beats = [seen.heartbeat for seen in self._seen.values() if seen.heartbeat is not None]
        return any(beat.autopilot != mavlink.MAV_AUTOPILOT_INVALID for beat in beats)

    def others(self) -> list[str]:
        """Other senders of heartbeats on the wire, in words."""
        return [
            describe(source, seen.heartbeat)
            for source, seen in self._seen.items()
            if seen.heartbeat is not None and source not in self.boards()
        ]


def source_of(message: Any) -> Source:
    """Who sent it."""
    return message.get_srcSystem(), message.get_srcComponent()


def is_telling(message: Any) -> bool:
    """Whether only the co-processor's firmware sends such a message."""
    kind = message.get_type()
    if kind == "NAMED_VALUE_FLOAT":
        return str(message.name).startswith(VALUE_PREFIX)
    return bool(kind == "PARAM_VALUE" and message.param_id == TELLING_PARAMETER)


def _is_device(heartbeat: Any) -> bool:
    """Whether its heartbeat is the firmware's; the applet on an autopilot sends similar names."""
    return (
        heartbeat is not None
        and heartbeat.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        and heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID
    )


def describe(source: Source, heartbeat: Any) -> str:
    """A sender in words, by its heartbeat."""
    system, component = source
    kind = _enum_name("MAV_TYPE", heartbeat.type)
    if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
        article = "an" if kind[0] in "aeiou" else "a"
        return f"{article} {kind} (system {system}, component {component})"
    autopilot = _AUTOPILOTS.get(heartbeat.autopilot) or _enum_name(
        "MAV_AUTOPILOT", heartbeat.autopilot
    )
    return f"an autopilot ({autopilot}, {kind}, system {system}, component {component})"


def _enum_name(enum: str, value: int) -> str:
    entry = mavlink.enums[enum].get(value)
    name = entry.name.removeprefix(f"{enum}_") if entry else f"{enum} {value}"
    return str(name.lower().replace("_", " "))
