"""`echowing leader`: passes the leader's telemetry on unchanged, as MAVLink datagrams."""

import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.flight.clocks import UNHEARD_S
from echowing.flight.engage import BATTERY_HZ, EKF_HZ, GPS_HZ
from echowing.flight.guard import SWITCH_HZ
from echowing.flight.requests import RATE_REQUEST_PERIOD_S, RateWatch
from echowing.mavlink.links import Address, Link, leads_back, wait
from echowing.mavlink.messages import HEARTBEAT_PERIOD_S, message_interval, tool_heartbeat
from echowing.mavlink.seats import POLL_S, OpenLink, Seat, find_vehicles, known_id
from echowing.mavlink.signing import LinkSigning
from echowing.stopping import StopRequest
from echowing.tool.background import BackgroundView
from echowing.tool.view import PlainView

# Not those of a `follow` that asks through us: two senders on one link id refuse each other.
VEHICLE_LINK_ID, PUBLISHED_LINK_ID = 101, 102


class LeaderTool:
    """Publishes one vehicle. Only requests for its clock go back to it.

    Frames are passed on unchanged, with the sender's signature.
    """

    def __init__(
        self,
        seat: Seat,
        publish: Address,
        rate_hz: float,
        stop: StopRequest,
        *,
        signing_key: bytes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        _refuse_loop(seat.address, publish)
        self._seat = seat
        self._vehicle = _open_link(seat.address, signing_key, VEHICLE_LINK_ID)
        self._follow = _open_link(publish, signing_key, PUBLISHED_LINK_ID)
        self._wanted_hz = {
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: rate_hz,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: SWITCH_HZ,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: EKF_HZ,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: GPS_HZ,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: BATTERY_HZ,
        }
        self._stop = stop
        self._clock = clock
        self._start_s = clock()
        self._heard_s = self._beat_s = self._rates_s = 0.0
        self._silent = False
        self._view = BackgroundView(PlainView())

    @property
    def stuck(self) -> bool:
        """Whether the terminal accepted nothing until the end, and still blocks."""
        return self._view.stuck

    def run(self, duration_s: float | None) -> int:
        """Run until asked to end; returns the exit code."""

        def over() -> bool:
            return (
                self._stop()
                or self._view.lost is not None
                or (duration_s is not None and self._now_s() >= duration_s)
            )

        links = {self._seat.address.text: self._vehicle}
        try:
            for link in (self._vehicle, self._follow):
                link.link.open()
            if find_vehicles([self._seat], links, self._now_s, over, self._say):
                self._begin()
                while not over():
                    self._turn()
            self._say("ended")
            return 0
        finally:
            self._vehicle.link.close()
            self._follow.link.close()
            self._view.close()

    def _now_s(self) -> float:
        return self._clock() - self._start_s

    def _say(self, text: str) -> None:
        self._view.event(self._now_s(), text)

    def _begin(self) -> None:
        self._system_id = known_id(self._seat)
        self._heard_s = self._now_s()
        wanted = [(self._system_id, kind, hz) for kind, hz in self._wanted_hz.items()]
        self._rates = RateWatch(wanted, self._view.event)
        self._say(f"leader is system {self._system_id}, published to {self._follow.link.name}")

    def _turn(self) -> None:
        """Pass on new messages, both ways; keep the vehicle sending."""
        now_s = self._now_s()
        for message in self._vehicle.receive(now_s, self._say):
            self._pass_on(message, now_s)
        for message in self._follow.receive(now_s, self._say):
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self._vehicle.link.send(bytes(message.get_msgbuf()), now_s)
        self._watch(now_s)
        self._ask(now_s)
        wait([self._vehicle.link, self._follow.link], POLL_S)

    def _pass_on(self, message: Any, now_s: float) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        if source != (self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return
        self._heard_s = now_s
        self._rates.received(self._system_id, message.get_msgId())
        self._follow.link.send(bytes(message.get_msgbuf()), now_s)

    def _watch(self, now_s: float) -> None:
        self._rates.check(now_s)
        silent = now_s - self._heard_s > UNHEARD_S
        if silent is not self._silent:
            self._silent = silent
            self._say(
                "no report from the leader; followers stop"
                if silent
                else "the leader reports again"
            )

    def _ask(self, now_s: float) -> None:
        if now_s - self._beat_s >= HEARTBEAT_PERIOD_S:
            self._beat_s = now_s
            self._vehicle.send(tool_heartbeat(), now_s)
        if self._rates_s == 0.0 or now_s - self._rates_s >= RATE_REQUEST_PERIOD_S:
            self._rates_s = now_s
            for kind, rate_hz in self._wanted_hz.items():
                period_us = round(1e6 / rate_hz)
                self._vehicle.send(message_interval(self._system_id, kind, period_us), now_s)


def _open_link(address: Address, key: bytes | None, link_id: int) -> OpenLink:
    return OpenLink(Link(address, None if key is None else LinkSigning(key, link_id)))


def _refuse_loop(vehicle: Address, publish: Address) -> None:
    """Published messages must not arrive again as the vehicle's."""
    if leads_back(vehicle, publish):
        raise EchowingError(
            f"--publish to {publish.host}:{publish.port} is where the vehicle's messages arrive "
            f"({vehicle.text}): messages would circulate for ever; give another port"
        )
