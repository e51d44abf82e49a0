"""The follow tool at work: links, clock and logs around the pure follow session."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.formation import turning_together
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowerPlan, FollowSession, Guide
from echowing.flight.take_off import TakeOff
from echowing.mavlink.links import Address, Link, wait
from echowing.mavlink.seats import OpenLink, Seat, StrangerWatch, find_vehicles, known_id
from echowing.mavlink.signing import LinkSigning
from echowing.stopping import StopRequest
from echowing.tool.background import BackgroundLog, BackgroundView
from echowing.tool.log import FollowLog
from echowing.tool.panel import Panel, left_as
from echowing.tool.track import Track, track
from echowing.tool.view import View

ROWS_PERIOD_S = 0.1
# A copter at 5 m/s stands within 5 s; the stop has to be seen for a second, over a slow link.
STOPPING_S = 10.0
# Until the leader's height is known, which is before anything is engaged.
UNKNOWN_ALTITUDE_M = 10.0
# This far behind, the points that were missed are not sent late.
HOPELESS_S = 0.5
# What another component of a vehicle, the co-processor, may say; all else is its autopilot's.
_COMPONENTS_SAY = {"DISTANCE_SENSOR", "NAMED_VALUE_FLOAT"}


@dataclass(slots=True)
class FollowOptions:
    """What the operator has asked for; the first seat is the leader's.

    make_guide: what leads a follower, where it is not its slot; altitude_m: above the leader's
    home, None: as high as the leader is when a follower is engaged.
    """

    seats: list[Seat]
    slots: list[Slot]
    settings: GuidanceSettings
    altitude_m: float | None = 10.0
    rate_hz: float = 8.0
    limits: Limits = field(default_factory=Limits)
    engage: bool = False
    take_off: TakeOff | None = None
    leader_rate_hz: float = 4.0
    duration_s: float | None = None
    log: Path | None = None
    signing_key: bytes | None = None
    make_guide: Callable[[], Guide] | None = None


def _is_no_point(addressed: tuple[int, Any]) -> bool:
    return bool(addressed[1].get_msgId() != mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)


class FollowTool:
    """Finds the vehicles, flies the followers, and leaves them standing.

    `clock` is monotonic seconds and `unix_clock` UTC; `make_link` opens what points go through.
    """

    def __init__(
        self,
        options: FollowOptions,
        view: View,
        stop: StopRequest,
        *,
        clock: Callable[[], float] = time.monotonic,
        unix_clock: Callable[[], float] = time.time,
        make_link: Callable[[Address, LinkSigning | None], Link] = Link,
    ) -> None:
        self._options = options
        self._view = BackgroundView(view)
        self._stop = stop
        self._clock = clock
        self._make_link = make_link
        self._start_s = clock()
        self._start_unix_s = unix_clock()
        self._strangers = StrangerWatch(options.seats)
        self._links: dict[str, OpenLink] = {}
        for seat in options.seats:
            if seat.address.text not in self._links:
                self._links[seat.address.text] = self._link_of(seat)
        self._log: BackgroundLog | None = None
        self._next_tick_s = self._next_rows_s = 0.0
        self._events_told = self._alerts_told = 0

    def run(self) -> int:
        """Until the end is asked for; 0: every follower that was moved is known to stand.

        1: one is not, or the duration was over before all vehicles were heard.
        """
        options = self._options
        try:
            for link in self._links.values():
                link.link.open()
            if options.log is not None:
                self._log = BackgroundLog(partial(FollowLog, options.log, self._start_unix_s))
                self._say(f"log: {options.log}")
            if not find_vehicles(options.seats, self._links, self._now_s, self._over, self._say):
                self._say("ended before all vehicles had reported; nothing was moved")
                return self._unheard_code()
            self._make_session()
            try:
                self._fly()
            except Exception as error:
                # A fault of ours is no reason to leave them flying.
                self._say(f"fault of this tool, stopping: {error!r}")
                self._end()
                raise
            return self._end()
        finally:
            self._close()

    def _link_of(self, seat: Seat) -> OpenLink:
        key = self._options.signing_key
        signing = None if key is None else LinkSigning(key, 1 + len(self._links))
        return OpenLink(self._make_link(seat.address, signing))

    def _now_s(self) -> float:
        return self._clock() - self._start_s

    def _say(self, text: str) -> None:
        self._view.event(self._now_s(), text)

    # ---- before ---------------------------------------------------------------------------------

    def _make_session(self) -> None:
        options = self._options
        leader, *followers = options.seats
        plans = [
            FollowerPlan(known_id(seat), slot, options.altitude_m or UNKNOWN_ALTITUDE_M)
            for seat, slot in zip(followers, options.slots, strict=True)
        ]
        self._session = FollowSession(
            known_id(leader),
            plans,
            turning_together(options.slots, options.settings),
            leader_rate_hz=options.leader_rate_hz,
            limits=options.limits,
            engaged=options.engage,
            take_off=options.take_off,
            leaders_height=options.altitude_m is None,
        )
        if options.make_guide is not None:
            for follower in self._session.followers.values():
                follower.guide = options.make_guide()
        self._panel = Panel([known_id(seat) for seat in options.seats])
        self._ways = {known_id(seat): self._links[seat.address.text] for seat in options.seats}
        listed = ", ".join(f"{seat.role} is system {seat.system_id}" for seat in options.seats)
        self._say(listed)
        if not options.engage:
            only = "only watching" if options.take_off is None else "taking off, then only watching"
            self._say(f"{only}; give --engage to send points")

    # ---- in flight ------------------------------------------------------------------------------

    def _over(self) -> bool:
        duration_s = self._options.duration_s
        # Where nobody sees what is done nothing is done.
        ended = self._stop() or self._view.lost is not None
        return ended or (duration_s is not None and self._now_s() >= duration_s)

    def _unheard_code(self) -> int:
        """0 where the operator has ended it; a time that ran out in vain is no success."""
        return 0 if self._stop() or self._view.lost is not None else 1

    def _fly(self) -> None:
        self._next_tick_s = self._next_rows_s = self._now_s()
        while not self._over():
            self._turn()

    def _turn(self) -> None:
        """Take what has come; send and show when it is time; wait for what comes next."""
        for link in self._links.values():
            for message in link.receive(self._now_s(), self._say):
                self._take(link, message, self._now_s())
        now_s = self._now_s()
        if now_s >= self._next_tick_s:
            late = now_s - self._next_tick_s > HOPELESS_S
            self._next_tick_s = (now_s if late else self._next_tick_s) + 1.0 / self._options.rate_hz
            # Points first: what else is to be asked or told can wait for them.
            for system_id, message in sorted(self._session.tick(now_s), key=_is_no_point):
                self._write(now_s, self._ways[system_id].send(message, now_s))
        if now_s >= self._next_rows_s:
            self._next_rows_s = now_s + ROWS_PERIOD_S
            self._show(now_s)
        due_s = min(self._next_tick_s, self._next_rows_s)
        wait([link.link for link in self._links.values()], due_s - self._now_s())

    def _take(self, link: OpenLink, message: Any, now_s: float) -> None:
        """Hand on what a vehicle of ours has said on its own link."""
        doubt = self._strangers.heard(link.link.name, message)
        if doubt is not None and self._session.engagement is not None:
            self._session.engagement.doubt(*doubt, now_s)
        if self._ways.get(message.get_srcSystem()) is not link:
            return
        own = message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
        if not own and message.get_type() not in _COMPONENTS_SAY:
            return
        self._write(now_s, bytes(message.get_msgbuf()))
        self._session.receive(message, now_s)
        self._panel.receive(message, now_s)

    def _write(self, now_s: float, frame: bytes) -> None:
        if self._log is not None:
            self._log.frame(self._start_unix_s + now_s, frame)

    def _show(self, now_s: float) -> None:
        self._tell()
        rows = self._panel.rows(self._session, now_s)
        self._view.rows(now_s, rows)
        if self._log is not None:
            self._log.rows(self._start_unix_s + now_s, rows, self._tracks(now_s))

    def _tracks(self, now_s: float) -> list[Track]:
        followers = self._session.followers.values()
        return [track(self._session, follower, self._panel, now_s) for follower in followers]

    def _tell(self) -> None:
        if self._log is not None:
            self._log.tell(self._say)
        events = self._session.events
        for time_s, text in events[self._events_told :]:
            self._view.event(time_s, text)
        self._events_told = len(events)
        if self._session.alerts > self._alerts_told:
            self._alerts_told = self._session.alerts
            self._view.ring()
        for system_id, text in self._panel.texts:
            self._say(f"system {system_id} warns: {text}")
        self._panel.texts.clear()

    # ---- the end --------------------------------------------------------------------------------

    def _end(self) -> int:
        """Stop what was moved, see that it stands, and say how each follower was left."""
        session, asked = self._session, self._stop.count
        session.stop("the tool ends")
        until_s = self._now_s() + STOPPING_S
        self._next_tick_s = self._now_s()
        self._turn()
        while not session.stopped(self._now_s()) and self._now_s() < until_s:
            if self._stop.count > asked:
                self._say("asked twice: not waiting for the followers to stand")
                break
            self._turn()
        now_s = self._now_s()
        self._show(now_s)
        safe = True
        for follower in session.followers.values():
            text, well = left_as(session, follower, now_s)
            safe = safe and well
            self._say(f"follower {follower.plan.system_id}: {text}")
        self._view.settle()
        return 0 if safe and self._view.lost is None else 1

    def _close(self) -> None:
        for link in self._links.values():
            link.link.close()
        try:
            if self._log is not None:
                self._log.close()
                self._log.tell(self._say)
        finally:
            self._view.close()

    @property
    def stuck(self) -> bool:
        """Whether something that shows or logs took nothing until the end, and still blocks."""
        return self._view.stuck or (self._log is not None and self._log.stuck)
