"""How a receiver drifts, as the vehicle's own velocity tells. Pure.

An autopilot's place follows its receiver's, whose errors wander and step. Its velocity is surer: so
where its place moves otherwise than it says that it flies, the receiver has drifted. On ArduCopter
SITL that and how the error changes within 3 s correlate by 0.8 (tests/sitl/follows.py). So places
are smoothed by it before sonars and receivers are compared, as a receiver smooths its ranges by the
carrier (Hatch 1982).
"""

import math
from collections import deque

from echowing.flight.alignment import Report
from echowing.flight.clocks import LONGEST_GAP_S
from echowing.flight.guidance import Horizontal
from echowing.flight.jumps import DRIFTS_M, SLIDES_S, beyond_movement_m, is_jump
from echowing.flight.receivers import FORGETS_S


class Drift:
    """How far the place that a vehicle reports has lately drifted.

    lately_m: (north, east), `DRIFTS_M` at the most. It is forgotten as receivers forget what they
    are off: velocities are off themselves, by 0.05 m/s for seconds at a time (0.6 m in sum then).
    slid_m: how far the place has slid by the newest report, further than receivers drift; None: it
    has not. That is a jump (`jumps`), and counts as none of it.
    """

    def __init__(self) -> None:
        self.lately_m: Horizontal = (0.0, 0.0)
        self.slid_m: Horizontal | None = None
        self._before: Report | None = None
        self._steps: deque[tuple[float, Horizontal]] = deque()

    def reported(self, report: Report) -> None:
        """Take a report, its time by the vehicle's own clock."""
        before, self._before, self.slid_m = self._before, report, None
        if before is None:
            return
        elapsed_s = report.time_s - before.time_s
        kept = math.exp(-max(0.0, elapsed_s) / FORGETS_S)
        north_m, east_m = kept * self.lately_m[0], kept * self.lately_m[1]
        if 0.0 < elapsed_s <= LONGEST_GAP_S and not is_jump(before, report):
            new_north_m, new_east_m = self._step(before, report)
            north_m, east_m = north_m + new_north_m, east_m + new_east_m
        else:
            self._steps.clear()
        share = DRIFTS_M / max(DRIFTS_M, math.hypot(north_m, east_m))
        self.lately_m = share * north_m, share * east_m

    def _step(self, before: Report, report: Report) -> Horizontal:
        """What a report adds: how it moves beyond its velocity; once it has slid, that back."""
        step_m = beyond_movement_m(before, report)
        while self._steps and report.time_s - self._steps[0][0] > SLIDES_S:
            self._steps.popleft()
        slid = [*(one for _, one in self._steps), step_m]
        north_m, east_m = (math.fsum(axis_m) for axis_m in zip(*slid, strict=True))
        if math.hypot(north_m, east_m) <= DRIFTS_M:
            self._steps.append((before.time_s, step_m))
            return step_m
        self._steps.clear()
        self.slid_m = north_m, east_m
        return step_m[0] - north_m, step_m[1] - east_m

    def jumped(self) -> None:
        """Note that the next report may be of elsewhere: that does not count (`jumps`)."""
        self._before = None
