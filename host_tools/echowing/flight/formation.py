"""A formation: a slot for every follower, checked before anybody flies it."""

import math
from collections.abc import Sequence
from itertools import combinations

from echowing.errors import EchowingError
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.guidance import Slot, slot_offset_m
from echowing.flight.spacing import UNRANGED_SIGMA_M

# Each of two followers may be this far off its slot and still be in it.
IN_SLOT_M = 0.5
# The guided point is never nearer to the leader than this; a slot inside could not be flown.
SMALLEST_RADIUS_M = 1.0


def slot_distance_m(a: Slot, b: Slot) -> float:
    """Distance between two slots, altitude steps included."""
    (north_a, east_a), (north_b, east_b) = slot_offset_m(a, 0.0), slot_offset_m(b, 0.0)
    return math.dist((north_a, east_a, a.altitude_step_m), (north_b, east_b, b.altitude_step_m))


def receivers_demand_m(least_m: float) -> float:
    """How far apart two slots have to be if their followers do not range each other.

    least_m: the distance that has to be certain. Nearer, each follower would give way to the other,
    and neither would ever be in its slot.
    """
    return least_m + SURE_SIGMAS * UNRANGED_SIGMA_M + 2.0 * IN_SLOT_M


def check_formation(slots: Sequence[Slot], separation_m: float) -> None:
    """Raise EchowingError unless every slot can be flown and all are apart from each other."""
    if not slots:
        raise EchowingError("formation: no slots; give at least one (radius, angle, altitude step)")
    for number, slot in enumerate(slots, 1):
        _check_slot(number, slot)
    numbered = enumerate(slots, 1)
    for (number_a, a), (number_b, b) in combinations(numbered, 2):
        distance_m = slot_distance_m(a, b)
        if distance_m < separation_m:
            raise EchowingError(
                f"formation: slots {number_a} and {number_b} are {distance_m:.2f} m apart, "
                f"less than {separation_m:.2f} m; move one of them, or allow it by "
                "slot_separation_m"
            )


def _check_slot(number: int, slot: Slot) -> None:
    if not slot.radius_m >= SMALLEST_RADIUS_M:
        raise EchowingError(
            f"formation: slot {number} has a radius of {slot.radius_m:g} m; "
            f"the smallest is {SMALLEST_RADIUS_M:g} m"
        )
    if not abs(slot.angle_rad) <= math.pi / 2.0:
        raise EchowingError(
            f"formation: slot {number} is {math.degrees(slot.angle_rad):g} deg off the tail, "
            "ahead of the leader; stay within -90 to 90 deg"
        )
