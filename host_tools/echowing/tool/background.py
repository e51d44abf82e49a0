"""A thread for work that may block: a stopped terminal, an unread pipe, a slow disk.

The flying loop only puts work into a bounded queue. What does not fit is dropped and counted, and
reported when there is room again.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence

from echowing.flight.hearing import Reading
from echowing.terminal import ring
from echowing.tool.log import FollowLog
from echowing.tool.panel import Row
from echowing.tool.track import Track
from echowing.tool.view import LastingView, View

# Queue of a view, in lines: an hour of a quiet flight, half a minute of fifty reporting vehicles.
MOST_SHOWN = 500
# Queue of a log, in frames and rows: 20 s of fifty followers, 5 MB.
MOST_LOGGED = 20_000
# Rows come at 10 Hz, and only the newest is shown. This many dropped rows (2 s) are reported.
ROWS_WORTH_A_WORD = 20
# At the end the tool waits this long for a terminal or a disk that accepts nothing.
LAST_WORDS_S = 2.0


class Worker:
    """Does its work in order, in a daemon thread; the caller never waits.

    error: the first exception of its work; the work after it is still done.
    """

    def __init__(self, most: int) -> None:
        self.error: Exception | None = None
        self._most = most
        self._work: deque[Callable[[], None]] = deque()
        self._news = threading.Condition()
        self._busy = self._ending = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def do(self, work: Callable[[], None]) -> bool:
        """Queue the work; False: the queue is full and the work is dropped."""
        with self._news:
            if len(self._work) >= self._most or self._ending:
                return False
            self._work.append(work)
            self._news.notify_all()
        return True

    @property
    def has_room(self) -> bool:
        """Whether the queue is less than half full."""
        return 2 * len(self._work) < self._most

    def settle(self, timeout_s: float) -> bool:
        """Wait until all work is done; False: it is not, after `timeout_s`."""
        with self._news:
            return self._news.wait_for(lambda: not self._work and not self._busy, timeout_s)

    def end(self, last: Callable[[], None], timeout_s: float) -> bool:
        """End the thread after all work and `last`; False: it is stuck, and is left behind."""
        with self._news:
            self._work.append(last)
            self._ending = True
            self._news.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (work := self._next()) is not None:
            try:
                work()
            except Exception as error:
                self.error = self.error or error

    def _next(self) -> Callable[[], None] | None:
        with self._news:
            self._busy = False
            self._news.notify_all()
            self._news.wait_for(lambda: self._work or self._ending)
            self._busy = bool(self._work)
            return self._work.popleft() if self._work else None


class BackgroundView:
    """A view that a thread draws. Only the newest rows wait; events wait in order.

    lost: why nothing is shown any more; stuck: the output accepted nothing until the end.
    """

    def __init__(self, view: View, most: int = MOST_SHOWN) -> None:
        self._view = LastingView(view)
        self._worker = Worker(most)
        self._rows: tuple[float, Sequence[Row]] | None = None
        self._dropped_events = self._dropped_rows = 0
        self._keys = ""
        self.stuck = False

    @property
    def lost(self) -> Exception | None:
        """The error that ended the view; None: it works."""
        return self._view.lost or self._worker.error

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        self._say_what_was_dropped(time_s)
        if not self._worker.do(lambda: self._view.event(time_s, text)):
            self._dropped_events += 1

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        self._say_what_was_dropped(time_s)
        waiting, self._rows = self._rows is not None, (time_s, rows)
        self._dropped_rows += waiting
        if not waiting and not self._worker.do(self._show_newest):
            self._rows = None
            self._dropped_rows += 1

    def keys(self, text: str) -> None:
        """As `View`; only what is new is shown."""
        if text != self._keys and self._worker.do(lambda: self._view.keys(text)):
            self._keys = text

    def ring(self) -> None:
        """Ring the terminal's bell."""
        self._worker.do(ring)

    def settle(self, timeout_s: float = LAST_WORDS_S) -> None:
        """Give it time to show the queue."""
        self._worker.settle(timeout_s)

    def close(self) -> None:
        """As `View`."""
        self.stuck = not self._worker.end(self._view.close, LAST_WORDS_S)

    def _show_newest(self) -> None:
        newest, self._rows = self._rows, None
        if newest is not None:
            self._view.rows(*newest)

    def _say_what_was_dropped(self, time_s: float) -> None:
        if self._rows is not None or not self._worker.has_room:
            return
        events, rows = self._dropped_events, self._dropped_rows
        self._dropped_rows = 0
        if not events and rows < ROWS_WORTH_A_WORD:
            return
        self._dropped_events = 0
        text = (
            "nothing could be shown for a while (stopped terminal, or pipe that nobody reads?): "
            f"{events} events and {rows} updates of the table were left out; flying went on"
        )
        self._worker.do(lambda: self._view.event(time_s, text))


class BackgroundLog:
    """A log written by a thread. `say` is called by the caller of `tell`, never by the thread."""

    def __init__(self, open_log: Callable[[Callable[[str], None]], FollowLog]) -> None:
        self._said: deque[str] = deque()
        self._log = open_log(self._said.append)
        self._worker = Worker(MOST_LOGGED)
        self._dropped = 0
        self.stuck = False

    def frame(self, unix_s: float, frame: bytes) -> None:
        """As `FollowLog`."""
        self._do(lambda: self._log.frame(unix_s, frame))

    def rows(self, unix_s: float, rows: Sequence[Row], tracks: Sequence[Track]) -> None:
        """As `FollowLog`."""
        self._do(lambda: self._log.rows(unix_s, rows, tracks))

    def readings(self, start_unix_s: float, system_id: int, readings: Sequence[Reading]) -> None:
        """As `FollowLog`."""
        self._do(lambda: self._log.readings(start_unix_s, system_id, readings))

    def event(self, unix_s: float, text: str) -> None:
        """As `FollowLog`."""
        self._do(lambda: self._log.event(unix_s, text))

    def fault(self, text: str) -> None:
        """As `FollowLog`."""
        self._do(lambda: self._log.fault(text))

    def tell(self, say: Callable[[str], None]) -> None:
        """Report what the log has reported since the last call."""
        while self._said:
            say(self._said.popleft())
        if self._dropped and self._worker.has_room:
            say(f"log: {self._dropped} frames and rows are missing: the disk was too slow")
            self._dropped = 0

    def close(self) -> None:
        """As `FollowLog`."""
        self.stuck = not self._worker.end(self._log.close, LAST_WORDS_S)
        if self._worker.error is not None:
            raise self._worker.error

    def _do(self, write: Callable[[], None]) -> None:
        self._dropped += not self._worker.do(write)
