"""A position or a clock that jumps: whether it is believed. Pure.

A receiver that jumps does not move its vehicle. If the sonar's range did not change meanwhile, the
jump is the receiver's and goes into the estimate; else the follower holds until its pilot has left
Guided and come back.
"""

import math
import statistics
from collections import deque

from echowing.flight.alignment import Report
from echowing.flight.clocks import REBOOT_S
from echowing.flight.guidance import Horizontal
from echowing.geo import ned_between

# A new place, or a new clock, is believed once this many reports in a row agree (2 s at 4 Hz).
AGREEING_REPORTS = 8
# A report further than this from where the one before leads is a jump, not a movement. Receivers,
# rounded to a decimetre, wander less between two reports; a quicker answer to TIMESYNC moves a
# clock by 0.3 s; and a vehicle that accelerates at 5 m/s2 and brakes within t is 5/4 t^2 off.
JUMP_M, CLOCK_MOVES_S, UNSEEN_MPS2 = 1.5, 0.3, 1.25

# The range did not change if its median differs by less than this. That takes so many readings,
# over so long, after the jump, and so many in the last second before it.
SAME_RANGE_M = 1.0
LEAST_AFTER, LEAST_AFTER_S = 3, 0.5
LEAST_BEFORE, BEFORE_S = 2, 1.0
REMEMBERED_S = 6.0
# If the sonar has not denied a jump by this time, the follower is held.
UNCONFIRMED_S = 2.0


class BootClocks:
    """Which boot clock a vehicle's reports carry."""

    def __init__(self) -> None:
        self._begun_s: float | None = None
        self._other_s = math.nan
        self._others = 0

    def is_believed(self, boot_s: float, now_s: float) -> bool:
        """Whether a report's clock is the believed one; a new one is after many in a row."""
        begun_s = now_s - boot_s
        if self._begun_s is None or abs(begun_s - self._begun_s) <= REBOOT_S:
            self._begun_s = begun_s if self._begun_s is None else min(begun_s, self._begun_s)
            self._others = 0
            return True
        same = abs(begun_s - self._other_s) <= REBOOT_S
        self._others = self._others + 1 if same else 1
        self._other_s = min(begun_s, self._other_s) if same else begun_s
        if self._others <= AGREEING_REPORTS:
            return False
        self._begun_s, self._others = begun_s, 0
        return True


class RangeMemory:
    """The sonar's ranges of the last seconds."""

    def __init__(self) -> None:
        self._ranges: deque[tuple[float, float]] = deque()

    def add(self, time_s: float, range_m: float) -> None:
        """Take a range of a moment."""
        self._ranges.append((time_s, range_m))
        while self._ranges[0][0] < time_s - REMEMBERED_S:
            self._ranges.popleft()

    def unchanged(self, since_s: float) -> bool:
        """Whether the range is what it was before a moment; False: there are too few ranges."""
        before = [m for t, m in self._ranges if since_s - BEFORE_S <= t <= since_s]
        after = [(t, m) for t, m in self._ranges if t > since_s]
        if len(before) < LEAST_BEFORE or len(after) < LEAST_AFTER:
            return False
        if after[-1][0] - since_s < LEAST_AFTER_S:
            return False
        now_m = statistics.median(m for _, m in after)
        return abs(now_m - statistics.median(before)) < SAME_RANGE_M


class OwnJump:
    """The jumps of a follower's own receiver.

    since_s: when a jump began that is not settled yet, None: there is none; moved_m: by how much,
    (north, east); total_m: the sum of all jumps, those back again included; last_s: when the last
    was.
    """

    def __init__(self) -> None:
        self.since_s: float | None = None
        self.moved_m: Horizontal = (0.0, 0.0)
        self.total_m: Horizontal = (0.0, 0.0)
        self.last_s = -math.inf
        self._before: Report | None = None

    def reported(self, report: Report) -> Horizontal | None:
        """Take a report; returns by how much it has jumped, None: it has not."""
        before, self._before = self._before, report
        if before is None or report.time_s <= before.time_s:
            return None
        if not is_jump(before, report):
            return None
        off_m = beyond_movement_m(before, report)
        self.last_s = report.time_s
        self.since_s = before.time_s if self.since_s is None else self.since_s
        self.moved_m = self.moved_m[0] + off_m[0], self.moved_m[1] + off_m[1]
        self.total_m = self.total_m[0] + off_m[0], self.total_m[1] + off_m[1]
        return off_m

    def settled(self) -> None:
        """Note that the jump is settled."""
        self.since_s, self.moved_m = None, (0.0, 0.0)


def is_jump(before: Report, after: Report, unseen_s: float = math.inf) -> bool:
    """Whether no movement can explain the way from one report to the next.

    unseen_s: no longer than this it may have changed its speed meanwhile.
    """
    changing_s = min(after.time_s - before.time_s, unseen_s)
    speed_mps = max(math.hypot(*before.velocity_mps), math.hypot(*after.velocity_mps))
    most_m = JUMP_M + CLOCK_MOVES_S * speed_mps + UNSEEN_MPS2 * changing_s * changing_s
    return math.hypot(*beyond_movement_m(before, after)) > most_m


def beyond_movement_m(before: Report, after: Report) -> Horizontal:
    """How far a report is from where the one before leads, (north, east)."""
    elapsed_s = after.time_s - before.time_s
    north_m, east_m, _ = ned_between(before.position, after.position)
    (before_n, before_e), (after_n, after_e) = before.velocity_mps, after.velocity_mps
    mean_n, mean_e = (before_n + after_n) / 2.0, (before_e + after_e) / 2.0
    return north_m - mean_n * elapsed_s, east_m - mean_e * elapsed_s
