"""The ground station of a simulated flight: radios, the follow session, and the telemetry logs."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.session import FollowSession
from echowing.mavlink.messages import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID
from echowing.mavlink.plausible import Door
from echowing.mavlink.signing import Parser
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.links import decoded
from echowing.sim.vehicle.streams import START_UNIX_S
from echowing.sim.world.radio import Radio

TELEMETRY = "telemetry"

# What the follow session listens to; the rest is only logged, which saves the unpacking.
_HEARD = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
}
_V2_MAGIC, _V2_HEADER, _V2_CHECKSUM, _V2_SIGNATURE = 0xFD, 10, 2, 13

# An operator's tool that ends waits so long for its followers to stand (tool/run.py).
ENDING_S = 10.0


def frames(data: bytes) -> Iterator[bytes]:
    """Whole MAVLink 2 frames out of what an endpoint has sent (nothing but whole frames)."""
    start = 0
    while start < len(data):
        signed = data[start + 2] & mavlink.MAVLINK_IFLAG_SIGNED
        length = _V2_HEADER + data[start + 1] + _V2_CHECKSUM + (_V2_SIGNATURE if signed else 0)
        yield data[start : start + length]
        start += length


def message_id(frame: bytes) -> int:
    """The message id of a MAVLink 2 frame."""
    return int.from_bytes(frame[7:10], "little")


# What passes on a link ("sent" to the vehicle, "delivered" to it, "arrived" from it), when, and the
# frame.
Tap = Callable[[str, float, bytes], None]


class Telemetry:
    """One vehicle's radio link, both ways, and its .tlog. A `tap` is shown what passes."""

    def __init__(
        self, autopilot: Autopilot, down: Radio, up: Radio, log: BinaryIO | None = None
    ) -> None:
        self.autopilot = autopilot
        self.down = down
        self.up = up
        self.tap: Tap | None = None
        self._log = log
        self._parsers = {radio: Parser() for radio in (down, up)}
        autopilot.add_link(TELEMETRY)

    def collect(self, t_s: float) -> list[bytes]:
        """Move what the vehicle sends into the radio; return what comes out on the ground."""
        sent = self.autopilot.transmit(TELEMETRY)
        if sent:
            for frame in frames(sent):
                self.down.send(t_s, frame)
        arrived = self._whole(self.down, self.down.receive(t_s))
        for frame in arrived:
            self._record(t_s, frame)
            self._show("arrived", t_s, frame)
        return arrived

    def deliver(self, t_s: float) -> None:
        """Hand the vehicle what has reached it."""
        packets = self.up.receive(t_s)
        for packet in packets:
            self.autopilot.receive(TELEMETRY, packet)
        if self.tap is not None:
            for frame in self._whole(self.up, packets):
                self.tap("delivered", t_s, frame)

    def _whole(self, radio: Radio, packets: list[bytes]) -> list[bytes]:
        """The whole frames of what a radio has brought, as the ground tool's links find them."""
        if not radio.cutter.has_cut:
            return packets
        found = self._parsers[radio].parse_buffer(b"".join(packets)) or ()
        return [bytes(message.get_msgbuf()) for message in found if message.get_msgId() >= 0]

    def send(self, t_s: float, frame: bytes) -> None:
        """Send a frame from the ground."""
        self._record(t_s, frame)
        self._show("sent", t_s, frame)
        self.up.send(t_s, frame)

    def _show(self, what: str, t_s: float, frame: bytes) -> None:
        if self.tap is not None:
            self.tap(what, t_s, frame)

    def _record(self, t_s: float, frame: bytes) -> None:
        if self._log is not None:
            stamp_us = round((START_UNIX_S + t_s) * 1e6)
            self._log.write(struct.pack(">Q", stamp_us) + frame)

    def close(self) -> None:
        """Close the log."""
        if self._log is not None:
            self._log.close()


def open_log(folder: Path | None, name: str) -> BinaryIO | None:
    """A .tlog to be written, or None where nothing is kept."""
    return None if folder is None else (folder / f"{name}.tlog").open("wb")


class GroundStation:
    """Runs a follow session over simulated radios.

    running: the tool is; `distort` changes what it sends, a fault; `events`: what it has said, and
    what those before it have.
    """

    def __init__(self, session: FollowSession, links: dict[int, Telemetry], rate_hz: float) -> None:
        self.session = session
        self.running = True
        self.distort: Callable[[Any], Any] | None = None
        self._door = Door()
        self._ends_s: float | None = None
        self._former_events: list[tuple[float, str]] = []
        self.links = links
        self._period_s = 1.0 / rate_hz
        self._due_s = 0.0
        self._heard = set(_HEARD)
        if session.settings.feed_forward:
            self._heard.add(mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR)
        self._mav = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)

    @property
    def events(self) -> list[tuple[float, str]]:
        """All that was said on the ground, with its time."""
        return self._former_events + self.session.events

    def end(self, t_s: float) -> None:
        """The operator ends the tool: it stops the followers, and then itself."""
        self.session.stop("the tool ends")
        self._ends_s = t_s + ENDING_S

    def start(self, session: FollowSession) -> None:
        """The operator starts the tool anew."""
        self._former_events = self.events
        self.session, self.running, self._ends_s = session, True, None

    def step(self, t_s: float) -> None:
        """Receive what has come, and send when it is time."""
        for link in self.links.values():
            link.deliver(t_s)
            for frame in link.collect(t_s):
                if self.running and message_id(frame) in self._heard:
                    self._hear(decoded(frame), t_s)
        if t_s >= self._due_s - 1e-9:
            self._due_s += self._period_s
            if self.running:
                self._send(t_s)
                self._end_once_all_stand(t_s)

    def _hear(self, message: Any, t_s: float) -> None:
        if self._door.admits(message):
            self.session.receive(message, t_s)
        self.session.events.extend((t_s, text) for text in self._door.news)
        self._door.news.clear()

    def _end_once_all_stand(self, t_s: float) -> None:
        if self._ends_s is not None and (self.session.stopped() or t_s >= self._ends_s):
            self.running = False

    def _send(self, t_s: float) -> None:
        for system_id, message in self.session.tick(t_s):
            wanted = self.distort(message) if self.distort else message
            self.links[system_id].send(t_s, bytes(wanted.pack(self._mav)))
            self._mav.seq = (self._mav.seq + 1) % 256
