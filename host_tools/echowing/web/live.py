"""A flight for browsers, while it is flown. The flying loop only leaves its newest moment here.

No browser, network or page thread can delay the caller: a moment replaces the one before, events
wait in a bounded list, and at most one call waits in the page's event loop.
"""

import asyncio
import json
import secrets
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from echowing.geo import GlobalPosition
from echowing.sonar_file import shipped_sonar
from echowing.tool.moment import Moment
from echowing.web.options import PageAddress
from echowing.web.server import PageServer, Socket, until_gone
from echowing.web.snapshot import Json, beam, glance, snapshot

# How much of the past a new browser receives: a minute, for plots and tracks.
PAST_S, GLANCE_S = 60.0, 0.5
MOST_EVENTS = 500


@dataclass(frozen=True, slots=True)
class _Event:
    number: int
    time_s: float
    text: str


class LiveFeed:
    """Takes moments and events from the flying thread; serves browsers in the server's thread.

    source: follow or sim. error: why nothing is shown any more.
    """

    def __init__(self, source: str) -> None:
        self._hello = {
            "kind": "hello",
            "source": source,
            "run": secrets.token_hex(8),
            **beam(shipped_sonar()),
        }
        self._loop: asyncio.AbstractEventLoop | None = None
        self._newest: Moment | None = None
        self._waking = False
        self._events: deque[_Event] = deque(maxlen=MOST_EVENTS)
        self._said = 0
        self.error: Exception | None = None
        # Used by the server's thread only:
        self._origin: GlobalPosition | None = None
        self._frame, self._frames, self._watched = "", 0, 0
        self._past: deque[Json] = deque(maxlen=round(PAST_S / GLANCE_S))
        self._news = asyncio.Event()

    # ---- in the thread that flies ---------------------------------------------------------------

    def event(self, time_s: float, text: str) -> None:
        """Something has happened."""
        self._said += 1
        self._events.append(_Event(self._said, time_s, text))
        self._wake()

    def show(self, moment: Moment) -> None:
        """The newest moment; only one is kept."""
        self._newest = moment
        self._wake()

    def _wake(self) -> None:
        if self._waking or self._loop is None:
            return
        self._waking = True
        try:
            self._loop.call_soon_threadsafe(self._publish)
        except RuntimeError:  # the server has ended
            self._loop = None

    # ---- in the server's ------------------------------------------------------------------------

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """As `Feed`."""
        self._loop = loop

    def _publish(self) -> None:
        self._waking = False
        moment, self._newest = self._newest, None
        if moment is not None and self.error is None:
            try:
                self._take(moment)
            except Exception as error:
                self.error = error
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _take(self, moment: Moment) -> None:
        self._origin = self._origin or moment.origin
        due = not self._past or moment.time_s - self._past[-1]["t"] >= GLANCE_S
        if not due and not self._watched:
            return
        frame = snapshot(moment, self._origin or GlobalPosition(0.0, 0.0, 0.0))
        if due:
            self._past.append(glance(frame))
        self._frame = encoded({"kind": "frame", **frame})
        self._frames += 1

    async def attend(self, browser: Socket) -> None:
        """As `Feed`."""
        self._watched += 1
        try:
            await until_gone(browser, self._serve(browser))
        finally:
            self._watched -= 1

    async def _serve(self, browser: Socket) -> None:
        await browser.send_str(encoded({**self._hello, "past": list(self._past)}))
        said = frames = 0
        while not browser.closed:
            news = self._news
            if self._said > said:
                events = [event for event in list(self._events) if event.number > said]
                said = events[-1].number if events else self._said
                await browser.send_str(encoded(told((one.time_s, one.text) for one in events)))
            if self._frames > frames:
                frames = self._frames
                await browser.send_str(self._frame)
            await news.wait()


class LivePage:
    """A live feed and its server, as the tools use them. Raises EchowingError (see PageServer)."""

    def __init__(self, address: PageAddress, source: str) -> None:
        self._feed = LiveFeed(source)
        self._server = PageServer(address, self._feed)
        self._lost_told = False
        self.event = self._feed.event
        self.show = self._feed.show
        self.said = self._server.address.said
        self.url, self.port = self._server.address.url, self._server.address.port

    def lost(self) -> str | None:
        """Why nothing is shown any more; returned once."""
        error = self._feed.error or self._server.error
        if error is None or self._lost_told:
            return None
        self._lost_told = True
        return f"the page has stopped ({error!r}); flying goes on"

    def close(self) -> bool:
        """End it; False: it is stuck, and is left behind."""
        return self._server.close()


def told(events: Any) -> Json:
    """Events for the browser: time and text."""
    return {"kind": "events", "events": [[round(time_s, 2), text] for time_s, text in events]}


def encoded(message: Json | Sequence[Any]) -> str:
    """As compact JSON."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)
