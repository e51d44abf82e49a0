"""A formation: a slot for every follower, checked before anybody flies it."""

import math
from collections.abc import Sequence
from itertools import combinations

from echowing.errors import EchowingError
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.guidance import Slot, slot_offset_m
from echowing.flight.state import UNRANGED_SIGMA_M
from echowing.geo import Ned

# Each of two followers may be this far off its slot and still be in it.
IN_SLOT_M = 0.5
# The guided point is never nearer to the leader than this; a slot inside could not be flown.
SMALLEST_RADIUS_M = 1.0


def place_m(slots: Sequence[Slot], number: int, course_rad: float = 0.0) -> Ned:
    """Where a slot is, NED from the leader, while the formation flies straight on."""
    slot = slots[number]
    north_m, east_m = slot_offset_m(slot, course_rad)
    if slot.behind is not None:
        ahead_north_m, ahead_east_m, _ = place_m(slots, slot.behind, course_rad)
        north_m, east_m = north_m + ahead_north_m, east_m + ahead_east_m
    return north_m, east_m, -slot.altitude_step_m


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
    places_m = [place_m(slots, number) for number in range(len(slots))]
    for a, b in combinations(range(len(slots)), 2):
        distance_m = math.dist(places_m[a], places_m[b])
        ranged = slots[b].behind == a
        if distance_m < separation_m and not ranged:
            raise EchowingError(
                f"formation: slots {a + 1} and {b + 1} are {distance_m:.2f} m apart, "
                f"less than {separation_m:.2f} m; move one of them, or allow it by "
                "slot_separation_m"
            )


def _check_slot(number: int, slot: Slot) -> None:
    if not slot.radius_m >= SMALLEST_RADIUS_M:
        raise EchowingError(
            f"formation: slot {number} has a radius of {slot.radius_m:g} m; "
            f"the smallest is {SMALLEST_RADIUS_M:g} m"
        )
    if slot.behind is not None and not 0 <= slot.behind < number - 1:
        raise EchowingError(
            f"formation: slot {number} is behind slot {slot.behind + 1}; it has to be one before it"
        )
    if not abs(slot.angle_rad) <= math.pi / 2.0:
        raise EchowingError(
            f"formation: slot {number} is {math.degrees(slot.angle_rad):g} deg off the tail, "
            "ahead of the leader; stay within -90 to 90 deg"
        )
