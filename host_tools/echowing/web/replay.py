"""A recorded flight for browsers; each browser has its own time line: time, speed, pause."""

import asyncio
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from aiohttp import WSMsgType

from echowing.errors import EchowingError
from echowing.geo import GlobalPosition
from echowing.sonar_file import shipped_sonar
from echowing.web.live import GLANCE_S, PAST_S, encoded, told
from echowing.web.recording import Recording, index_at
from echowing.web.server import Socket, either
from echowing.web.snapshot import Json, beam, glance, snapshot

FRAME_S = 0.1
LEAST_SPEED, MOST_SPEED = 0.01, 1000.0


@dataclass(slots=True)
class TimeLine:
    """Where in the flight a browser is. `now_s` is any monotonic clock in seconds."""

    from_s: float
    to_s: float
    speed: float = 1.0
    paused: bool = False
    _place_s: float = 0.0
    _since_s: float = 0.0

    def begin(self, now_s: float) -> None:
        """Start at the beginning."""
        self._place_s, self._since_s = self.from_s, now_s

    def place_s(self, now_s: float) -> float:
        """The time of the flight that is shown now; it stops at the end."""
        gone_s = 0.0 if self.paused else (now_s - self._since_s) * self.speed
        return min(self.to_s, self._place_s + gone_s)

    def wish(self, wish: Any, now_s: float) -> bool:
        """Take a request of the browser: speed, paused or seek; True: the time has jumped.

        Anything else is ignored.
        """
        if not isinstance(wish, dict):
            return False
        self._place_s, self._since_s = self.place_s(now_s), now_s
        speed, seek_s = _number(wish.get("speed")), _number(wish.get("seek"))
        if speed is not None:
            self.speed = min(MOST_SPEED, max(LEAST_SPEED, speed))
        if isinstance(wish.get("paused"), bool):
            self.paused = wish["paused"]
            if not self.paused and self._place_s >= self.to_s:  # played to the end: once more
                seek_s = self.from_s
        if seek_s is None:
            return False
        self._place_s = min(self.to_s, max(self.from_s, seek_s))
        return True


def _number(value: Any) -> float | None:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if plain and math.isfinite(value) else None


class ReplayFeed:
    """Serves browsers with a recording. `clock`: monotonic seconds."""

    def __init__(self, recording: Recording, clock: Callable[[], float] | None = None) -> None:
        self._recording = recording
        self._clock = clock
        self._origin = _origin(recording)
        self._damaged: dict[int, str] = {}
        times_s = recording.times_s
        self._span_s = times_s[0], times_s[-1]

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """As `Feed`."""
        self._clock = self._clock or loop.time

    def _now_s(self) -> float:
        assert self._clock is not None
        return self._clock()

    async def attend(self, browser: Socket) -> None:
        """As `Feed`."""
        line = TimeLine(*self._span_s)
        line.begin(self._now_s())
        moved = asyncio.Event()
        await either(self._serve(browser, line, moved), self._listen(browser, line, moved))

    async def _listen(self, browser: Socket, line: TimeLine, moved: asyncio.Event) -> None:
        async for message in browser:
            if message.type is not WSMsgType.TEXT:
                continue
            try:
                wish = json.loads(message.data)
            except ValueError:
                continue
            if line.wish(wish, self._now_s()):
                moved.set()

    async def _serve(self, browser: Socket, line: TimeLine, moved: asyncio.Event) -> None:
        from_s, to_s = self._span_s
        span = {"from_s": from_s, "to_s": to_s}
        hello = {"kind": "hello", "source": "replay", "run": "replay", **beam(shipped_sonar())}
        await browser.send_str(
            encoded({**hello, "title": self._recording.title, "replay": span, "past": []})
        )
        told_to_s, damaged = -math.inf, -1
        while not browser.closed:
            place_s = line.place_s(self._now_s())
            if moved.is_set():
                moved.clear()
                told_to_s = -math.inf
                past = self._past(place_s)
                await browser.send_str(encoded({"kind": "past", "past": past}))
            events = [one for one in self._recording.events if told_to_s < one[0] <= place_s]
            told_to_s = place_s
            if events:
                await browser.send_str(encoded(told(events)))
            clock = {"paused": line.paused, "speed": line.speed}
            index = index_at(self._recording.times_s, place_s)
            frame = self._frame(index)
            if frame is None and index != damaged:
                damaged = index
                await browser.send_str(encoded(told([(place_s, self._damaged[index])])))
            if frame is not None:
                await browser.send_str(encoded({"kind": "frame", **frame, "replay": clock}))
            await asyncio.sleep(FRAME_S)

    def _frame(self, index: int) -> Json | None:
        """None: the recording is damaged there."""
        try:
            return snapshot(self._recording.moment(index), self._origin)
        except EchowingError as error:
            self._damaged[index] = str(error)
            return None

    def _past(self, to_s: float) -> list[Json]:
        """The last minute, for plots and tracks."""
        times_s = self._recording.times_s
        from_s = max(times_s[0], to_s - PAST_S)
        steps = range(round((to_s - from_s) / GLANCE_S))
        indices = dict.fromkeys(index_at(times_s, from_s + step * GLANCE_S) for step in steps)
        frames = (self._frame(index) for index in indices)
        return [glance(frame) for frame in frames if frame is not None]


def _origin(recording: Recording) -> GlobalPosition:
    """The first known position. Raises EchowingError if there is none."""
    for index in range(len(recording.times_s)):
        origin = recording.moment(index).origin
        if origin is not None:
            return origin
    raise EchowingError("replay: no vehicle reported in this flight; there is nothing to show")
