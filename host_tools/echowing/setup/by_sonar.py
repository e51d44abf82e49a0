"""The parameters of applet and co-processor that a sonar's file gives.

`check` and `apply` go by it, and the simulator.
"""

import math
from dataclasses import dataclass

from echowing.applets import DETECT_DIFFERS_M, INSET_DIFFERS_M
from echowing.flight.belief import SonarBelief
from echowing.setup.applet import applet_parameters

DETECT, INSET = "ECHO_DETECT", "ECHO_INSET"
TRACK_RANGE, BEAM_WIDTH = "TRACK_RANGE", "BEAM_WIDTH"
TOLERANCE = 1e-4  # of what a 32-bit float makes of a decimal number
# The co-processor's table, BEAM_WIDTH.
MOST_WIDE_DEG = 120.0


@dataclass(frozen=True, slots=True)
class BySonar:
    """A value by the file, by how much a vehicle's may differ from it, and why by no more."""

    value: float
    differs: float
    why: str

    def fits(self, value: float) -> bool:
        """Whether a vehicle's value does."""
        return abs(value - self.value) <= self.differs + TOLERANCE


def applet_by_sonar(sonar: SonarBelief) -> dict[str, BySonar]:
    """An applet's parameters that describe its sonar, as near as it takes them: both the same."""
    wanted = {
        DETECT: BySonar(
            sonar.reach_m,
            DETECT_DIFFERS_M,
            "gimbal, applet and tool must take the same readings for the leader",
        ),
        INSET: BySonar(
            sonar.inset_m,
            INSET_DIFFERS_M,
            "applet and tool must make the same distance of a reading",
        ),
    }
    return {
        row.name: BySonar(max(row.low, min(row.high, one.value)), one.differs, one.why)
        for row in applet_parameters()
        if (one := wanted.get(row.name)) is not None
    }


def board_by_sonar(sonar: SonarBelief) -> dict[str, BySonar]:
    """The co-processor's: a range from where it is no target for the applet, and the beam."""
    detect = applet_by_sonar(sonar)[DETECT]
    wide_deg = float(round(math.degrees(2.0 * sonar.widest_rad.at(sonar.reach_m))))
    return {
        TRACK_RANGE: BySonar(
            float(round(100.0 * detect.value)), 100.0 * detect.differs, detect.why
        ),
        BEAM_WIDTH: BySonar(
            min(MOST_WIDE_DEG, wide_deg), 1.0, "the field of view that it reports is the beam's"
        ),
    }
