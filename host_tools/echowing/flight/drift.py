"""How a receiver drifts, as the vehicle's own velocity tells. Pure.

An autopilot's place follows its receiver's, whose errors wander and step. Its velocity is surer: so
where its place moves otherwise than it says that it flies, the receiver has drifted. On ArduCopter
SITL that and how the error changes within 3 s correlate by 0.8 (tests/sitl/follows.py). So places
are smoothed by it before sonars and receivers are compared, as a receiver smooths its ranges by the
carrier (Hatch 1982).
"""

import math

from echowing.flight.alignment import Report
from echowing.flight.clocks import LONGEST_GAP_S
from echowing.flight.guidance import Horizontal
from echowing.flight.jumps import DRIFTS_M, beyond_movement_m, is_jump
from echowing.flight.receivers import FORGETS_S


class Drift:
    """How far the place that a vehicle reports has lately drifted.

    lately_m: (north, east), `DRIFTS_M` at the most. It is forgotten as receivers forget what they
    are off: velocities are off themselves, by 0.05 m/s for seconds at a time (0.6 m in sum then).
    """

    def __init__(self) -> None:
        self.lately_m: Horizontal = (0.0, 0.0)
        self._before: Report | None = None

    def reported(self, report: Report) -> None:
        """Take a report, its time by the vehicle's own clock."""
        before, self._before = self._before, report
        if before is None:
            return
        elapsed_s = report.time_s - before.time_s
        kept = math.exp(-max(0.0, elapsed_s) / FORGETS_S)
        north_m, east_m = kept * self.lately_m[0], kept * self.lately_m[1]
        if 0.0 < elapsed_s <= LONGEST_GAP_S and not is_jump(before, report):
            new_north_m, new_east_m = beyond_movement_m(before, report)
            north_m, east_m = north_m + new_north_m, east_m + new_east_m
        share = DRIFTS_M / max(DRIFTS_M, math.hypot(north_m, east_m))
        self.lately_m = share * north_m, share * east_m

    def jumped(self, slid_m: Horizontal = (0.0, 0.0)) -> None:
        """Note that the next report may be of elsewhere: that does not count (`jumps`).

        slid_m: nor does what has counted as drift and was the beginning of it.
        """
        self._before = None
        self.lately_m = self.lately_m[0] - slid_m[0], self.lately_m[1] - slid_m[1]
