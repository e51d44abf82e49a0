"""Where a flight's slot was, worked out after it as the guidance did in it."""

import math

import numpy as np

from echowing.analysis.flight import Floats
from echowing.flight.guidance import Course, LeaderFix, Slot, slot_offset_m
from echowing.geo import GlobalPosition


def slot_offsets(slot: Slot, velocity: Floats, yaw: Floats) -> Floats:
    """Leader to slot in NED at each moment, on the course that guidance would have used."""
    course = Course()
    nowhere = GlobalPosition(0.0, 0.0, 0.0)
    offsets = np.full((len(velocity), 3), math.nan)
    for row, (ned_mps, heading_rad) in enumerate(zip(velocity.tolist(), yaw.tolist(), strict=True)):
        bearing_rad = course.update(LeaderFix(0.0, nowhere, tuple(ned_mps), heading_rad))
        offsets[row] = (*slot_offset_m(slot, bearing_rad), -slot.altitude_step_m)
    return offsets
