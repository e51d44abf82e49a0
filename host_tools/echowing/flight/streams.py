"""Whether the reports under one system id come from one vehicle. Pure.

A report goes on where an earlier one of the same vehicle leads, by its clock and by its place. One
that does not begins a stream of its own: a receiver has jumped, a vehicle has booted again, or
there is another vehicle with this id. In the first two cases the old stream ends. Streams that come
in turn are two vehicles.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from echowing.flight.alignment import Report
from echowing.flight.jumps import is_jump
from echowing.geo import GlobalPosition

# So often back to a stream that another had taken turns with, within this time. One receiver that
# jumps to and fro does not do that as fast.
SWAPS, SWAPS_S = 3, 10.0
# A stream that is not the first counts once so many reports in a row go on with it.
IN_A_ROW = 3
# After a radio's delay has ended, a vehicle's clock shows more time between two reports than passed
# between their receipts. At most so much more counts as time in which it changed its speed. In all
# that its clock shows, five seconds perhaps, it could be anywhere, and so could another vehicle.
AHEAD_S = 0.5
# Reports that come late are compared with the others of their time; radios hold none for longer.
KEPT_S = 10.0
MOST_STREAMS = 3


@dataclass(slots=True)
class _Stream:
    """Reports that go on with each other, by the vehicle's clock, and when the last one came."""

    at_s: float
    reports: deque[Report] = field(default_factory=deque)

    def add(self, report: Report, now_s: float) -> None:
        self.at_s = now_s
        if not self.reports or report.time_s > self.reports[-1].time_s:
            self.reports.append(report)
        while self.reports[0].time_s < self.reports[-1].time_s - KEPT_S:
            self.reports.popleft()

    def leads_to(self, report: Report, now_s: float) -> bool:
        """Whether one vehicle can have sent this report and those of the stream."""
        newest = self.reports[-1]
        elapsed_s = report.time_s - newest.time_s
        if elapsed_s > 0.0:
            passed_s = now_s - self.at_s
            in_time = elapsed_s - passed_s <= KEPT_S
            return in_time and not is_jump(newest, report, passed_s + AHEAD_S)
        before = next((one for one in reversed(self.reports) if one.time_s <= report.time_s), None)
        after = next(one for one in self.reports if one.time_s >= report.time_s)
        between = before is not None and not is_jump(before, report)
        return between and not is_jump(report, after)


class Streams:
    """The streams under one system id."""

    def __init__(self) -> None:
        self._streams: list[_Stream] = []
        self._in_a_row = 0
        self._swaps: deque[float] = deque(maxlen=SWAPS)
        self.two = False
        """Whether two vehicles have this id; for good."""

    def is_sure(self, message: Any, now_s: float) -> bool:
        """Take a GLOBAL_POSITION_INT; whether it is the vehicle's that reported before."""
        report = Report(
            message.time_boot_ms / 1e3,
            GlobalPosition(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3),
            (message.vx / 100.0, message.vy / 100.0),
            0.0,
        )
        # The newest first: the one whose turn it is.
        self._streams = [one for one in self._streams if now_s - one.at_s <= KEPT_S]
        first = not self._streams
        stream = next((one for one in self._streams if one.leads_to(report, now_s)), None)
        if first or (stream is not None and stream is self._streams[0]):
            self._in_a_row = IN_A_ROW if first else self._in_a_row + 1
        else:
            self._in_a_row = 1
            self._note_swap(stream, now_s)
        self._go_on(stream or _Stream(now_s), report, now_s)
        return self._in_a_row >= IN_A_ROW and not self.two

    def _note_swap(self, stream: _Stream | None, now_s: float) -> None:
        if stream is None:
            return
        self._swaps.append(now_s)
        if len(self._swaps) == SWAPS and now_s - self._swaps[0] <= SWAPS_S:
            self.two = True

    def _go_on(self, stream: _Stream, report: Report, now_s: float) -> None:
        stream.add(report, now_s)
        others = [one for one in self._streams if one is not stream]
        self._streams = [stream, *others][:MOST_STREAMS]
