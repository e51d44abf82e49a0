"""The follow tool at work: links, clock and logs around the pure follow session."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.belief import SonarBelief
from echowing.flight.build_up import BuildUp
from echowing.flight.follower import FollowerPlan, Guide
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.health import Cohesion
from echowing.flight.orders import Orders
from echowing.flight.reshape import Named
from echowing.flight.session import FollowSession
from echowing.flight.standstill import Standstill
from echowing.flight.take_off import TakeOff
from echowing.geo import load_exact
from echowing.mavlink.links import Address, Link, wait
from echowing.mavlink.messages import guides, status_text
from echowing.mavlink.seats import OpenLink, Seat, StrangerWatch, find_vehicles, known_id
from echowing.mavlink.signing import LinkSigning
from echowing.sonar_file import FlownBy
from echowing.stopping import StopRequest
from echowing.tool.again import History
from echowing.tool.background import BackgroundLog, BackgroundView
from echowing.tool.keys import KeyDesk
from echowing.tool.log import FollowLog
from echowing.tool.moment import Moment, members, places
from echowing.tool.panel import Panel, left_as
from echowing.tool.track import Track, track
from echowing.tool.view import View

ROWS_PERIOD_S = 0.1
# Changes of the formation's health count after 2 s; judging fifty followers takes milliseconds.
HEALTH_PERIOD_S = 1.0
# A copter at 5 m/s stops within 5 s; its stop must show for a second, over a slow link.
STOPPING_S = 10.0
# Five requests for a parameter, a second apart, over a slow radio.
RESTORING_S = 6.0
# Used until the leader's height is known, before anything is engaged.
UNKNOWN_ALTITUDE_M = 10.0
# If the loop is this late, the missed points are not sent.
HOPELESS_S = 0.5
TAKE_OVER = "Echowing: not confirmed stopped, TAKE OVER"
FAULT = "Echowing: ground tool failed, holding"


@dataclass(slots=True)
class FollowOptions:
    """The operator's options; the first seat is the leader's.

    make_guide: what leads a follower, if not its slot; altitude_m: above the leader's
    home, None: as high as the leader is when a follower is engaged; shapes: see `Orders`.
    """

    seats: list[Seat]
    slots: list[Slot]
    settings: GuidanceSettings
    sonar: SonarBelief
    altitude_m: float | None = 10.0
    rate_hz: float = 8.0
    limits: Limits = field(default_factory=Limits)
    engage: bool = False
    take_off: TakeOff | None = None
    leader_rate_hz: float = 4.0
    duration_s: float | None = None
    log: Path | None = None
    flown_by: FlownBy | None = None
    signing_key: bytes | None = None
    make_guide: Callable[[], Guide] | None = None
    build_up: tuple[float, ...] = ()
    shapes: Sequence[Named] = ()


_TARGETS = {
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
}


def _is_no_target(addressed: tuple[int, Any]) -> bool:
    return addressed[1].get_msgId() not in _TARGETS


class Page(Protocol):
    """Where a flight is shown besides the terminal; no call here blocks."""

    said: str

    def event(self, time_s: float, text: str) -> None:
        """Something has happened."""

    def show(self, moment: Moment) -> None:
        """The newest moment; called at 10 Hz."""

    def lost(self) -> str | None:
        """Why it shows nothing any more; returned once."""


class FollowTool:
    """Finds the vehicles, flies the followers, and stops them at the end.

    `clock` gives monotonic seconds, `unix_clock` UTC. `make_link` opens a link. `keys` returns the
    keys pressed since the last call, at once; None: there is no keyboard. `page` shows the flight
    in a browser.
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
        keys: Callable[[], bytes] | None = None,
        page: Page | None = None,
    ) -> None:
        load_exact()  # half a second, which no tick may wait
        self._options = options
        self._keys = keys
        self._page = page
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
        self._history = History(self._start_unix_s)
        self._fault: Exception | None = None
        self._ticks = True
        self._next_tick_s = self._next_rows_s = self._next_health_s = 0.0
        self._events_told = self._alerts_told = 0

    def run(self) -> int:
        """Run until asked to end; 0: every follower that was moved is confirmed stopped.

        1: one is not, or the duration ended before all vehicles had reported.
        """
        options = self._options
        try:
            for link in self._links.values():
                link.link.open()
            if options.log is not None:
                self._log = BackgroundLog(
                    partial(FollowLog, options.log, self._start_unix_s, flown_by=options.flown_by)
                )
                self._say(f"log: {options.log}")
            if self._page is not None:
                self._say(self._page.said)
            if not find_vehicles(options.seats, self._links, self._now_s, self._over, self._say):
                self._say("ended before all vehicles had reported; nothing was moved")
                return self._unheard_code()
            self._make_session()
            self._fly()
            code = self._end()
            if self._fault is not None:
                raise self._fault
            return code
        finally:
            self._close()

    def _link_of(self, seat: Seat) -> OpenLink:
        key = self._options.signing_key
        signing = None if key is None else LinkSigning(key, 1 + len(self._links))
        return OpenLink(self._make_link(seat.address, signing))

    def _now_s(self) -> float:
        return self._clock() - self._start_s

    def _say(self, text: str) -> None:
        self._event(self._now_s(), text)

    def _event(self, time_s: float, text: str) -> None:
        self._view.event(time_s, text)
        if self._page is not None:
            self._page.event(time_s, text)
        if self._log is not None:
            self._log.event(self._start_unix_s + time_s, text)

    def _warn(self, text: str) -> None:
        """Report something that needs the operator's attention."""
        self._say(text)
        self._view.ring()

    # ---- before ---------------------------------------------------------------------------------

    def _make_session(self) -> None:
        options = self._options
        leader, *followers = options.seats
        altitude_m = options.altitude_m or UNKNOWN_ALTITUDE_M
        plans = [
            FollowerPlan(known_id(seat), slot, altitude_m, sonar=options.sonar)
            for seat, slot in zip(followers, options.slots, strict=True)
        ]
        self._session = FollowSession(
            known_id(leader),
            plans,
            options.settings,
            leader_rate_hz=options.leader_rate_hz,
            limits=options.limits,
            engaged=options.engage,
            take_off=options.take_off,
            leaders_height=options.altitude_m is None,
        )
        if options.make_guide is not None:
            for follower in self._session.followers.values():
                follower.guide = options.make_guide()
        build_up = BuildUp(options.build_up, options.slots) if options.build_up else None
        self._orders = Orders(self._session, build_up, options.shapes)
        self._standstill = Standstill(self._session.known, self._session.guard)
        self._desk = KeyDesk(self._orders, self._event)
        self._panel = Panel([known_id(seat) for seat in options.seats])
        self._cohesion = Cohesion(known_id(leader), options.sonar)
        self._ways = {known_id(seat): self._links[seat.address.text] for seat in options.seats}
        listed = ", ".join(f"{seat.role} is system {seat.system_id}" for seat in options.seats)
        self._say(listed)
        if not options.engage:
            only = "only watching" if options.take_off is None else "taking off, then only watching"
            how = "give --engage" if self._keys is None else "press e, or give --engage,"
            self._say(f"{only}; {how} to send points")

    # ---- in flight ------------------------------------------------------------------------------

    def _over(self) -> bool:
        duration_s = self._options.duration_s
        # Without a view the tool ends.
        ended = self._stop() or self._view.lost is not None or self._fault is not None
        return ended or (duration_s is not None and self._now_s() >= duration_s)

    def _unheard_code(self) -> int:
        """0 if the operator has ended it; 1 if the duration has ended."""
        return 0 if self._stop() or self._view.lost is not None else 1

    def _fly(self) -> None:
        self._next_tick_s = self._next_rows_s = self._now_s()
        while not self._over():
            self._turn()

    def _turn(self) -> None:
        """Take new messages; send and show when due; wait for what comes next."""
        for link in self._links.values():
            self._attempt(self._listen, link)
        now_s = self._now_s()
        self._attempt(self._heed_keys, now_s)
        if now_s >= self._next_tick_s:
            late = now_s - self._next_tick_s > HOPELESS_S
            self._next_tick_s = (now_s if late else self._next_tick_s) + 1.0 / self._options.rate_hz
            self._attempt(self._tick, now_s)
            if not self._ticks:
                self._attempt(self._stand, now_s)
        if now_s >= self._next_rows_s:
            self._next_rows_s = now_s + ROWS_PERIOD_S
            self._attempt(self._show, now_s)
        due_s = min(self._next_tick_s, self._next_rows_s)
        links = [link.link for link in self._links.values()]
        self._attempt(wait, links, due_s - self._now_s())

    def _listen(self, link: OpenLink) -> None:
        for message in link.receive(self._now_s(), self._say):
            self._attempt(self._take, link, message, self._now_s())

    def _tick(self, now_s: float) -> None:
        """Send what the session and the operator order."""
        if not self._ticks:
            return
        self._history.ticked(now_s)
        # Until it has come to its end: one that fails fails again, or hangs again.
        self._ticks = False
        ordered = self._orders.prepare(now_s)
        messages = self._session.tick(now_s) + ordered
        self._ticks = True
        # Points first, as they come: other messages can wait for them.
        self._send(sorted(messages, key=_is_no_target), now_s)

    def _stand(self, now_s: float) -> None:
        """Hold every follower that was moved, without the session's tick."""
        self._send(self._standstill.messages(now_s), now_s)
        self._standstill.verify(now_s)

    def _send(self, messages: Iterable[tuple[int, Any]], now_s: float) -> None:
        for system_id, message in messages:
            self._write(now_s, self._ways[system_id].send(message, now_s))

    def _heed_keys(self, now_s: float) -> None:
        if self._keys is not None:
            pressed = self._keys()
            self._history.pressed(pressed, now_s)
            self._desk.press(pressed, now_s)
            self._view.keys(self._desk.line(now_s))

    # ---- a fault of ours ------------------------------------------------------------------------

    def _attempt(self, work: Callable[..., None], *arguments: Any) -> None:
        """Do what may fail: in flight no fault of ours ends the way of stopping."""
        try:
            work(*arguments)
        except Exception as error:
            if self._fault is None:
                self._fault = error
                self._stop_by_fault(error)

    def _stop_by_fault(self, error: Exception) -> None:
        """Hold every follower, tell it to all, and leave a log that brings the fault again."""
        now_s = self._now_s()
        self._session.stop("fault of the ground tool")
        if self._log is not None:
            self._log.fault(self._history.text(error, now_s))
        self._warn(f"fault of this tool, all followers hold and the tool ends: {error!r}")
        told = status_text(mavlink.MAV_SEVERITY_CRITICAL, FAULT)
        self._send([(system_id, told) for system_id in self._ways], now_s)

    def _take(self, link: OpenLink, message: Any, now_s: float) -> None:
        """Pass on a message that one of our vehicles has sent on its own link."""
        doubt = self._strangers.heard(link.link.name, message)
        if doubt is not None and self._session.engagement is not None:
            self._session.engagement.doubt(*doubt, now_s)
        if self._ways.get(message.get_srcSystem()) is not link:
            return
        if not guides(message):
            return
        self._write(now_s, bytes(message.get_msgbuf()))
        self._session.receive(message, now_s)
        self._orders.receive(message)
        self._panel.receive(message, now_s)

    def _write(self, now_s: float, frame: bytes) -> None:
        if self._log is not None:
            self._log.frame(self._start_unix_s + now_s, frame)

    def _show(self, now_s: float) -> None:
        self._tell()
        rows = self._panel.rows(self._session, now_s)
        self._view.rows(now_s, rows)
        judge = now_s >= self._next_health_s
        if self._log is None and self._page is None and not judge:
            return
        moment = Moment(now_s, rows, self._tracks(now_s), self._cohesion.health)
        if self._log is not None:
            self._log.rows(self._start_unix_s + now_s, rows, moment.tracks)
            self._log_readings(self._log)
        if judge:
            self._next_health_s = now_s + HEALTH_PERIOD_S
            moment = self._judged(moment)
        if self._page is not None:
            self._page.show(moment)

    def _log_readings(self, log: BackgroundLog) -> None:
        """Write down what each sonar has read since the last time."""
        for system_id, follower in self._session.followers.items():
            fresh = follower.estimate.hearing.fresh
            if fresh:
                log.readings(self._start_unix_s, system_id, list(fresh))
                fresh.clear()

    def _judged(self, moment: Moment) -> Moment:
        """The moment with the formation's health; changes of it are reported."""
        origin = moment.origin
        if origin is None:
            return moment
        vehicles = members(moment, places(moment, origin), self._options.sonar)
        for text in self._cohesion.update(vehicles, moment.time_s):
            self._event(moment.time_s, text)
        return replace(moment, health=self._cohesion.health)

    def _tracks(self, now_s: float) -> list[Track]:
        followers = self._session.followers.values()
        return [track(self._session, follower, self._panel, now_s) for follower in followers]

    def _tell(self) -> None:
        if self._log is not None:
            self._log.tell(self._warn)
        events = self._session.events
        for time_s, text in events[self._events_told :]:
            self._event(time_s, text)
        if self._page is not None and (lost := self._page.lost()) is not None:
            self._view.event(self._now_s(), lost)
        self._events_told = len(events)
        if self._session.alerts > self._alerts_told:
            self._alerts_told = self._session.alerts
            self._view.ring()
        for system_id, text in self._panel.texts:
            self._warn(f"system {system_id} warns: {text}")
        self._panel.texts.clear()

    # ---- the end --------------------------------------------------------------------------------

    def _end(self) -> int:
        """Stop the followers, wait until they have stopped, and report how each was left."""
        session, asked = self._session, self._stop.count
        session.stop("the tool ends")
        until_s = self._now_s() + STOPPING_S
        self._next_tick_s = self._now_s()
        self._turn()
        while not self._stopped() and self._now_s() < until_s:
            if self._stop.count > asked:
                self._say("asked twice: not waiting for the followers to stop")
                break
            self._turn()
        safe = self._put_back(asked)
        now_s = self._now_s()
        self._attempt(self._show, now_s)
        for follower in session.followers.values():
            text, well = left_as(session, follower, now_s)
            safe = safe and well
            self._tell_how_left(follower.plan.system_id, text, well=well, now_s=now_s)
        for link in self._links.values():
            if link.door.refused:
                self._say(f"{link.link.name}: not believed: {link.door.summary}")
        self._view.settle()
        return 0 if safe and self._view.lost is None else 1

    def _stopped(self) -> bool:
        try:
            return self._session.stopped()
        except Exception:
            return False

    def _tell_how_left(self, system_id: int, text: str, *, well: bool, now_s: float) -> None:
        """Report how a follower was left; to its pilot's display too if the pilot must act."""
        tell = self._say if well else self._warn
        tell(f"follower {system_id}: {text}")
        if not well:
            take_over = status_text(mavlink.MAV_SEVERITY_CRITICAL, TAKE_OVER)
            self._write(now_s, self._ways[system_id].send(take_over, now_s))

    def _put_back(self, asked: int) -> bool:
        """Restore ECHO_DIST if keys have changed it; returns whether that is confirmed."""
        build_up = self._orders.build_up
        if build_up is None:
            return True
        build_up.restore()
        until_s = self._now_s() + RESTORING_S
        while not build_up.restored and self._now_s() < until_s and self._stop.count <= asked:
            self._turn()
        left = build_up.left()
        for text, well in left:
            tell = self._say if well else self._warn
            tell(text)
        return all(well for _, well in left)

    def _close(self) -> None:
        self._stop.be_patient()
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
        """Whether a view or a log accepted nothing until the end, and still blocks."""
        return self._view.stuck or (self._log is not None and self._log.stuck)
