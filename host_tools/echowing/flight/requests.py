"""What a session asks of its vehicles beside flying: clocks, heartbeats, rates. Pure."""

import math
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.known import Known
from echowing.flight.said import Say
from echowing.mavlink.messages import HEARTBEAT_PERIOD_S, message_interval, tool_heartbeat

# Points are sent at 8 Hz, and each wants a position of its own. An autopilot that has restarted has
# forgotten its rates, so they are asked for again and again.
FOLLOWER_POSITION_HZ = 10.0
RATE_REQUEST_PERIOD_S = 5.0
# Rates are judged over this time; this share of the requested rate is enough.
RATE_WINDOW_S = 8.0
RATE_SHARE = 0.6

Rate = tuple[int, int, float]
"""System id, message id, rate in Hz."""


def positions(known: Known, leader_hz: float) -> list[Rate]:
    """The positions that every vehicle is asked for."""
    kind = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
    followers = [(system_id, kind, FOLLOWER_POSITION_HZ) for system_id in known.followers]
    return [(known.leader_id, kind, leader_hz), *followers]


class Requests:
    """Sends the requests that are due.

    wanted: what has to come; watched: say where it does not. at_times() is what comes only in some
    states of a vehicle: requested, but never reported as missing.
    """

    def __init__(
        self,
        known: Known,
        wanted: Iterable[Rate],
        at_times: Callable[[], list[Rate]],
        say: Say,
        *,
        watched: bool,
    ) -> None:
        self._known = known
        self._wanted, self._at_times = list(wanted), at_times
        self._rates = RateWatch(self._wanted, say) if watched else None
        self._heard: set[int] = set()
        self._beat_at_s = self._rates_at_s = -math.inf

    def receive(self, message: Any) -> None:
        """Take any message of these vehicles."""
        system_id = message.get_srcSystem()
        if system_id not in self._heard and self._known.clock(system_id) is not None:
            # Earlier requests may not have reached it: a listening port knew no address.
            self._heard.add(system_id)
            self._rates_at_s = -math.inf
        if self._rates is not None:
            self._rates.received(system_id, message.get_msgId())

    def answered(self, message: Any, now_s: float) -> None:
        """Take an answer to TIMESYNC."""
        clock = self._known.clock(message.get_srcSystem())
        if clock is not None and message.tc1 != 0 and clock.has_asked(message.ts1):
            clock.answered(message.ts1 / 1e9, message.tc1 / 1e9, now_s)

    def messages(self, now_s: float) -> list[tuple[int, Any]]:
        """The requests to send now."""
        messages: list[tuple[int, Any]] = []
        vehicles = [self._known.leader_id, *self._known.followers]
        for system_id in vehicles:
            clock = self._known.clock(system_id)
            if clock is not None and clock.due(now_s):
                stamp_ns = clock.asks(now_s)
                messages.append((system_id, mavlink.MAVLink_timesync_message(0, stamp_ns)))
        if now_s - self._beat_at_s >= HEARTBEAT_PERIOD_S:
            self._beat_at_s = now_s
            messages.extend((system_id, tool_heartbeat()) for system_id in vehicles)
        if now_s - self._rates_at_s >= RATE_REQUEST_PERIOD_S:
            self._rates_at_s = now_s
            messages.extend(
                (system_id, message_interval(system_id, message_id, round(1e6 / rate_hz)))
                for system_id, message_id, rate_hz in (*self._wanted, *self._at_times())
            )
        if self._rates is not None:
            self._rates.check(now_s)
        return messages


class RateWatch:
    """Whether the messages that were asked for come as often as asked."""

    def __init__(self, wanted: Iterable[tuple[int, int, float]], say: Say) -> None:
        self._wanted_hz = {(system_id, kind): rate_hz for system_id, kind, rate_hz in wanted}
        self._counts = dict.fromkeys(self._wanted_hz, 0)
        self._short: set[tuple[int, int]] = set()
        self._since_s: float | None = None
        self._say = say

    def received(self, system_id: int, message_id: int) -> None:
        """Count a message."""
        key = (system_id, message_id)
        if key in self._counts:
            self._counts[key] += 1

    def check(self, now_s: float) -> None:
        """Say which messages have begun to come too seldom, and which are well again."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if elapsed_s < RATE_WINDOW_S:
            return
        for key, count in self._counts.items():
            self._judge(key, count / elapsed_s, now_s)
            self._counts[key] = 0
        self._since_s = now_s

    def _judge(self, key: tuple[int, int], rate_hz: float, now_s: float) -> None:
        short = rate_hz < RATE_SHARE * self._wanted_hz[key]
        if short is (key in self._short):
            return
        self._short.symmetric_difference_update({key})
        name = mavlink.mavlink_map[key[1]].msgname
        wish = f"{self._wanted_hz[key]:g} Hz asked for"
        advice = ": check the radio and the stream rates" if short else ": well again"
        self._say(now_s, f"system {key[0]}: {name} comes at {rate_hz:.1f} Hz, {wish}{advice}")
