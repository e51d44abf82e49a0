"""The autopilot's MAVLink ports: parsing, packing, and routing between them.

Routing follows ArduPilot's libraries/GCS_MAVLink/MAVLink_routing.cpp.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from echowing.mavlink.signing import NEEDS_NO_SIGNATURE, SIGNING_EPOCH_UNIX_S, SIGNING_TICKS_PER_S
from echowing.sim.vehicle.framing import Framer

_NOT_FORWARDED = {
    mavlink.MAVLINK_MSG_ID_RADIO,
    mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
    mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
}
_BROADCAST = 0
# What waits for a serial port at the most (AP_SERIALMANAGER_MAVLINK_BUFSIZE_TX), and what a frame
# of MAVLink 2 has beside its payload: header and checksum.
_BUFFER_BYTES, _FRAME_BYTES = 256, 12
# pymavlink's word for a wrong checksum.
_BAD_CHECKSUM = "invalid MAVLink CRC"
_DECODER = mavlink.MAVLink(None)


def decoded(frame: bytes) -> Any:
    """The message of a frame, whoever may have signed it. Raises MAVError.

    A frame passes an autopilot and a ground station, and is decoded once. Each gets a message of
    its own: to send one on writes the sender into it.
    """
    message = _decoded(frame)
    own = object.__new__(type(message))  # `copy.copy` takes five times as long
    own.__dict__ = message.__dict__.copy()
    return own


@lru_cache(maxsize=1024)
def _decoded(frame: bytes) -> Any:
    return _DECODER.decode(bytearray(frame))


class SerialLink:
    """One MAVLink port: its own parser, sequence numbers, routes and outgoing bytes."""

    def __init__(self, name: str, number: int, system_id: int) -> None:
        self.name = name
        self.number = number
        self.routes: set[tuple[int, int]] = set()
        self._incoming = bytearray()
        self._outgoing = bytearray()
        self._mav = mavlink.MAVLink(None, system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._framer = Framer()

    @property
    def active(self) -> bool:
        """Whether anybody has been heard here."""
        return bool(self.routes)

    @property
    def waiting(self) -> bool:
        """Whether bytes have come that nobody has looked at."""
        return bool(self._incoming)

    def set_system_id(self, system_id: int) -> None:
        """Send as this system from now on."""
        self._mav.srcSystem = system_id

    def sign(self, key: bytes, unix_s: float, *, accept_unsigned: bool = False) -> None:
        """Sign what is sent with a 32-byte key, and accept only what is signed with it."""
        signing = self._mav.signing
        signing.secret_key = key
        signing.sign_outgoing = True
        signing.link_id = self.number
        signing.timestamp = round((unix_s - SIGNING_EPOCH_UNIX_S) * SIGNING_TICKS_PER_S)
        signing.allow_unsigned_callback = lambda mav, message_id: (
            accept_unsigned or message_id in NEEDS_NO_SIGNATURE
        )

    def unsign(self) -> None:
        """Send unsigned, and accept everything."""
        self._mav.signing = mavlink.MAVLinkSigning()

    def feed(self, data: bytes) -> None:
        """Bytes off the wire, to be parsed at the next `received`."""
        self._incoming += data

    def received(self) -> Iterator[tuple[bytes, Any]]:
        """The frames of what has come, each with its message.

        The message is None where the checksum is wrong, and so where the message is unknown, as its
        checksum cannot be known. What signing refuses is dropped.
        """
        data, self._incoming = bytes(self._incoming), bytearray()
        signed = self._mav.signing.secret_key is not None
        for frame in map(bytes, self._framer.cut(data)):
            try:
                message = self._mav.decode(bytearray(frame)) if signed else decoded(frame)
            except mavlink.MAVError as error:
                if str(error).startswith(_BAD_CHECKSUM):
                    yield frame, None
                continue
            yield frame, message if message.get_msgId() >= 0 else None  # unknown: below 0

    def send(self, message: Any) -> None:
        """Pack a message and queue its bytes."""
        mav = self._mav
        self._outgoing += message.pack(mav)
        mav.seq = (mav.seq + 1) & 0xFF

    def send_packed(self, message_id: int, payload: bytes) -> bool:
        """Send a message by its payload; False: there is no room for the longest of its kind."""
        kind = mavlink.mavlink_map[message_id]
        signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if self._mav.signing.sign_outgoing else 0
        longest = _FRAME_BYTES + signature + kind.unpacker.size
        if len(self._outgoing) + longest > _BUFFER_BYTES:
            return False
        self.send(_unpacked(kind, payload))
        return True

    def forward(self, message: Any) -> None:
        """Queue a message of somebody else unchanged."""
        self._outgoing += message.get_msgbuf()

    def drain(self) -> bytes:
        """What is to go on the wire."""
        if not self._outgoing:
            return b""
        data = bytes(self._outgoing)
        self._outgoing.clear()
        return data


def _unpacked(kind: Any, payload: bytes) -> Any:
    """A message by its payload as on the wire."""
    head = bytes([len(payload), 0, 0, 0, 0, 0]) + kind.id.to_bytes(3, "little")
    checksum: int = x25crc(head + payload + bytes([kind.crc_extra])).crc
    frame = b"\xfd" + head + payload + checksum.to_bytes(2, "little")
    return mavlink.MAVLink(None).decode(bytearray(frame))


class Router:
    """Learns who is behind which link, and forwards between links."""

    def __init__(self, links: dict[str, SerialLink], own_id: Callable[[], int]) -> None:
        self._links = links
        self._own_id = own_id

    def accept(self, link: SerialLink, message: Any) -> bool:
        """Forward `message` where it belongs; True: the autopilot itself handles it too."""
        own_id = self._own_id()
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source == (own_id, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return True
        if source[0] != _BROADCAST:
            link.routes.add(source)
        message_id = message.get_msgId()
        if message_id in _NOT_FORWARDED:
            return True
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._spread_heartbeat(link, message, source)
            return True
        return self._forward(link, message, own_id)

    def _spread_heartbeat(self, link: SerialLink, message: Any, source: tuple[int, int]) -> None:
        for other in self._links.values():
            if other is not link and other.active and source not in other.routes:
                other.forward(message)

    def _forward(self, link: SerialLink, message: Any, own_id: int) -> bool:
        system = getattr(message, "target_system", _BROADCAST)
        component = getattr(message, "target_component", _BROADCAST)
        for_me = system in (_BROADCAST, own_id)
        local = for_me and component in (_BROADCAST, mavlink.MAV_COMP_ID_AUTOPILOT1)
        if local and _BROADCAST not in (system, component):
            return True
        forwarded = False
        for other in self._links.values():
            if other is not link and _leads_to(other, system, component, for_me=for_me):
                other.forward(message)
                forwarded = True
        return local or (for_me and not forwarded)


def _leads_to(link: SerialLink, system: int, component: int, *, for_me: bool) -> bool:
    if system == _BROADCAST:
        return link.active
    any_component = component == _BROADCAST or not for_me
    return any(
        known_system == system and (any_component or known_component == component)
        for known_system, known_component in link.routes
    )
