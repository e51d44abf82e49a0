"""The parameters of applet and co-processor that a sonar's file gives. Pure.

`follow` goes by it, `setup check` and `setup apply`, and the simulator.
"""

import math
from dataclasses import dataclass

from echowing.flight.belief import SonarBelief

DETECT, INSET = "ECHO_DETECT", "ECHO_INSET"
TRACK_RANGE, BEAM_WIDTH = "TRACK_RANGE", "BEAM_WIDTH"
TOLERANCE = 1e-4  # of what a 32-bit float makes of a decimal number
# The applets take these, at the least and at the most (their tables).
DETECTS_M, INSETS_M = (2.0, 7.6), (0.0, 1.0)
# Vehicle and file may differ by so much.
DIFFERS_M = 0.1
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
    return {
        DETECT: BySonar(
            _within(DETECTS_M, sonar.reach_m),
            DIFFERS_M,
            "gimbal, applet and tool must take the same readings for the leader",
        ),
        INSET: BySonar(
            _within(INSETS_M, sonar.inset_m),
            DIFFERS_M,
            "applet and tool must make the same distance of a reading",
        ),
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


def _within(span: tuple[float, float], value: float) -> float:
    return max(span[0], min(span[1], value))
