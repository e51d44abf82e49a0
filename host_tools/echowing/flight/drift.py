"""How a receiver drifts, as the vehicle's own velocity tells. Pure.

An autopilot's place follows its receiver's, whose errors wander and step. Its velocity is surer: so
where its place moves otherwise than it says that it flies, the receiver has drifted. The velocity
is drawn along, which shows only half of a step; by how much follows from the half that shows. On
ArduCopter SITL what shows and how the error changes within 3 s correlate by 0.8
(tests/sitl/follows.py). So places are smoothed by it before sonars and receivers are compared, as a
receiver smooths its ranges by the carrier (Hatch 1982).
"""

import math

from echowing.flight.alignment import Report
from echowing.flight.clocks import LONGEST_GAP_S
from echowing.flight.guidance import Horizontal
from echowing.flight.jumps import beyond_movement_m, is_jump
from echowing.flight.receivers import FORGETS_S

# The autopilot's velocity is drawn along by 0.55 m/s for each metre that its place is, and is right
# again in 1.7 s: so EKF3 follows steps of 0.5 to 3 m of its receiver (ArduCopter SITL 4.6 and 4.8).
DRAWN_PER_S, RIGHTS_S = 0.55, 1.7
# No receiver drifts further: two like ones got 14 m apart at the most (RESULTS.md).
DRIFTS_M = 10.0
# Slower it may be a velocity that errs by itself: three times 0.05 m/s.
ERRS_MPS = 0.15


class Drift:
    """How far the place that a vehicle reports has lately drifted.

    lately_m: (north, east), `DRIFTS_M` at the most. It is forgotten as receivers forget what they
    are off: velocities are off themselves, by 0.05 m/s for seconds at a time (0.6 m in sum then).
    """

    def __init__(self) -> None:
        self.lately_m: Horizontal = (0.0, 0.0)
        self._before: Report | None = None
        self._drawn_mps: Horizontal = (0.0, 0.0)

    def reported(self, report: Report) -> None:
        """Take a report, its time by the vehicle's own clock."""
        before, self._before = self._before, report
        if before is None:
            return
        elapsed_s = report.time_s - before.time_s
        kept = math.exp(-max(0.0, elapsed_s) / FORGETS_S)
        north_m, east_m = kept * self.lately_m[0], kept * self.lately_m[1]
        if 0.0 < elapsed_s <= LONGEST_GAP_S and not is_jump(before, report):
            new_north_m, new_east_m = step_m = beyond_movement_m(before, report)
            drawn_north_m, drawn_east_m = self._drawn_along_m(step_m, elapsed_s)
            north_m += new_north_m + drawn_north_m
            east_m += new_east_m + drawn_east_m
        else:
            self._drawn_mps = (0.0, 0.0)
        share = DRIFTS_M / max(DRIFTS_M, math.hypot(north_m, east_m))
        self.lately_m = share * north_m, share * east_m

    def _drawn_along_m(self, step_m: Horizontal, elapsed_s: float) -> Horizontal:
        """How far the place was drawn together with the velocity, which hides it."""
        kept = math.exp(-elapsed_s / RIGHTS_S)
        north_mps, east_mps = self._drawn_mps = (
            kept * self._drawn_mps[0] + DRAWN_PER_S * step_m[0],
            kept * self._drawn_mps[1] + DRAWN_PER_S * step_m[1],
        )
        certain_s = elapsed_s if math.hypot(north_mps, east_mps) > ERRS_MPS else 0.0
        return certain_s * north_mps, certain_s * east_mps

    def jumped(self) -> None:
        """Note that the next report may be of elsewhere, which does not count: see `jumps`."""
        self._before = None
        self._drawn_mps = (0.0, 0.0)
