"""Which vehicle is on which link: seats, and how the vehicles are found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.mavlink.connection import DEFAULT_BAUD
from echowing.mavlink.links import Address, Link, parse_address, wait
from echowing.mavlink.messages import (
    HEARTBEAT_PERIOD_S,
    TOOL_COMPONENT_ID,
    TOOL_SYSTEM_ID,
    tool_heartbeat,
)
from echowing.mavlink.plausible import Door

# Heartbeats come once per second: after this time every vehicle on a link has reported, even if
# three in a row were lost.
LISTEN_S = 4.0
WAITING_PERIOD_S = 5.0
POLL_S = 0.1

Say = Callable[[str], None]


@dataclass(slots=True)
class Seat:
    """A vehicle's place in the session: its link, and its system id once known."""

    role: str
    address: Address
    system_id: int | None = None


def parse_seat(role: str, text: str, baud: int = DEFAULT_BAUD) -> Seat:
    """`CONNECTION` or `CONNECTION@SYSTEM`. Raises EchowingError."""
    where, at, system = text.rpartition("@")
    if not at:
        return Seat(role, parse_address(text, baud))
    if not system.isdecimal() or not 1 <= int(system) <= 255:
        raise EchowingError(f"{role} {text!r}: after @ comes a system id from 1 to 255")
    return Seat(role, parse_address(where, baud), int(system))


class OpenLink:
    """A link, its door, and our identity on it: each link has sequence numbers of its own."""

    def __init__(self, link: Link, door: Door | None = None) -> None:
        self.link = link
        self.door = door or Door()
        self._packer = mavlink.MAVLink(
            None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID
        )
        if link.signing is not None:
            link.signing.apply(self._packer)

    def receive(self, now_s: float, say: Say) -> list[Any]:
        """The new messages that make sense; news of the link and of its door is reported."""
        messages = [one for one in self.link.receive(now_s) if self.door.admits(one)]
        for news in (*self.link.news, *self.door.news):
            say(news)
        self.link.news.clear()
        self.door.news.clear()
        return messages

    def send(self, message: Any, now_s: float) -> bytes:
        """Pack and send a message; returns the frame."""
        if self.link.signing is not None:
            self.link.signing.keep_time()
        frame = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        self.link.send(frame, now_s)
        return frame


class VehicleFinder:
    """Finds out which vehicle is on which link, from autopilots' heartbeats. Pure.

    A seat without a system id takes the only vehicle on its link; several there are refused.
    """

    def __init__(self, seats: Sequence[Seat]) -> None:
        self._seats = seats
        self._heard: dict[str, dict[int, float]] = {}
        self._check_asked()

    @property
    def complete(self) -> bool:
        """Whether every seat has its system id, and that system reports on its link."""
        return not self._missing()

    def waiting(self) -> str:
        """Who is still missing."""
        return "waiting for " + ", ".join(self._described(seat) for seat in self._missing())

    def heard(self, link: str, message: Any, now_s: float) -> None:
        """Take any message of a link."""
        if _is_vehicle(message):
            self._heard.setdefault(link, {}).setdefault(message.get_srcSystem(), now_s)

    def decide(self, now_s: float) -> None:
        """Fill the seats after listening long enough. Raises EchowingError if it is ambiguous."""
        for seat in self._open_seats():
            vehicles = self._heard.get(seat.address.text, {})
            if vehicles and now_s - min(vehicles.values()) >= LISTEN_S:
                seat.system_id = self._only(seat, list(vehicles))

    def _only(self, seat: Seat, vehicles: Sequence[int]) -> int:
        taken = {other.system_id: other for other in self._seats if other.system_id is not None}
        free = [system_id for system_id in vehicles if system_id not in taken]
        where = seat.address.text
        if not free:
            other = taken[vehicles[0]]
            raise EchowingError(
                f"{seat.role} on {where} is system {vehicles[0]}, as is the {other.role} on "
                f"{other.address.text}; give each vehicle a MAV_SYSID (SYSID_THISMAV) of its own"
            )
        if len(free) > 1:
            listed = ", ".join(str(system_id) for system_id in sorted(free))
            raise EchowingError(
                f"{where}: systems {listed} are on it; name the {seat.role}: {where}@{min(free)}"
            )
        return free[0]

    def _missing(self) -> list[Seat]:
        return [
            seat
            for seat in self._seats
            if seat.system_id not in self._heard.get(seat.address.text, {})
        ]

    def _described(self, seat: Seat) -> str:
        """A missing vehicle; if it was named, also the systems that report in its place."""
        if seat.system_id is None:
            return f"{seat.role} on {seat.address.where}"
        others = sorted(self._heard.get(seat.address.text, {}))
        heard = f" (on it: {', '.join(map(str, others))})" if others else ""
        return f"{seat.role}, system {seat.system_id}, on {seat.address.where}{heard}"

    def _open_seats(self) -> list[Seat]:
        return [seat for seat in self._seats if seat.system_id is None]

    def _check_asked(self) -> None:
        """Refuse an id given twice, and several vehicles without ids on one link."""
        asked = [seat.system_id for seat in self._seats if seat.system_id is not None]
        doubles = {system_id for system_id in asked if asked.count(system_id) > 1}
        if doubles:
            raise EchowingError(f"system {min(doubles)} is given twice; each vehicle has its own")
        unnamed = [seat.address.text for seat in self._open_seats()]
        for text in unnamed:
            if unnamed.count(text) > 1:
                raise EchowingError(
                    f"{text} is given for several vehicles: give the system id of each, for "
                    f"example {text}@1"
                )


class StrangerWatch:
    """Watches links on which a vehicle was not named: another one may appear later. Pure.

    Made before the seats are filled.
    """

    def __init__(self, seats: Sequence[Seat]) -> None:
        self._seats = seats
        self._unnamed = {seat.address.text: seat for seat in seats if seat.system_id is None}

    def heard(self, link: str, message: Any) -> tuple[int, str] | None:
        """The seat for which another vehicle may have been meant, and what to do; None: no seat."""
        seat = self._unnamed.get(link)
        stranger = message.get_srcSystem()
        if seat is None or seat.system_id is None or not _is_vehicle(message):
            return None
        if stranger in {one.system_id for one in self._seats}:
            return None
        listed = ", ".join(map(str, sorted((seat.system_id, stranger))))
        return seat.system_id, (
            f"{link}: systems {listed} are on it, and you have not said which is the "
            f"{seat.role}: end the tool and give {link}@{seat.system_id}"
        )


def _is_vehicle(message: Any) -> bool:
    """Whether it is an autopilot's heartbeat."""
    if message.get_type() != "HEARTBEAT":
        return False
    autopilot = message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
    return bool(autopilot and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def find_vehicles(
    seats: Sequence[Seat],
    links: Mapping[str, OpenLink],
    clock: Callable[[], float],
    over: Callable[[], bool],
    say: Say,
) -> bool:
    """Wait until every seat has its system id; False: `over` was true before.

    links: by connection string. Raises EchowingError if it is ambiguous.
    """
    finder = VehicleFinder(seats)
    beat_s = told_s = 0.0
    while not finder.complete:
        if over():
            return False
        now_s = clock()
        if now_s >= beat_s:
            beat_s = now_s + HEARTBEAT_PERIOD_S
            for link in links.values():
                link.send(tool_heartbeat(), now_s)
        if now_s >= told_s:
            told_s = now_s + WAITING_PERIOD_S
            say(finder.waiting())
        wait([one.link for one in links.values()], POLL_S)
        for text, link in links.items():
            for message in link.receive(clock(), say):
                finder.heard(text, message, clock())
        finder.decide(clock())
    for text, link in links.items():
        link.link.keep(known_id(seat) for seat in seats if seat.address.text == text)
    return True


def known_id(seat: Seat) -> int:
    """The system id of a seat that has been found."""
    if seat.system_id is None:
        raise ValueError(f"{seat.role} has not been found")
    return seat.system_id
