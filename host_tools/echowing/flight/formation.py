"""A formation: a slot for every follower, checked before anybody flies it."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

from echowing.errors import EchowingError
from echowing.flight.axis import apart_rad
from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.guidance import SMALLEST_RADIUS_M, Slot, place_m

# Each of two followers may be this far off its slot and still be in it.
IN_SLOT_M = 0.5
# What one sonar leaves unsure of two receivers in flight (`Known.sigma_m`), root mean square:
# scenarios vee and column, two followers each, seeds 1 to 3, from 25 to 90 s.
LINK_SIGMA_M = 0.37
# Propellers of a copter like an X8 span a metre (a guess); their wash goes down under them.
WASH_M = 1.0 + 2.0 * IN_SLOT_M
# Two copters are not below each other within this height.
LEVEL_M = 0.5
# Its number here; that of a slot counts from 1.
LEADER = 0


def hung_on_leader(slots: Sequence[Slot]) -> list[Slot]:
    """The same places, all of them behind the leader, whom every sonar then watches."""
    hung = []
    for number, slot in enumerate(slots):
        north_m, east_m, _ = place_m(slots, number)
        radius_m, angle_rad = math.hypot(north_m, east_m), math.atan2(east_m, -north_m)
        hung.append(replace(slot, radius_m=radius_m, angle_rad=angle_rad, behind=None))
    return hung


def receivers_demand_m(least_m: float) -> float:
    """How far apart two slots have to be if no sonars tie their followers to each other.

    least_m: the distance that has to be certain. Nearer, each follower would give way to the other,
    and neither would ever be in its slot.
    """
    return _demand_m(least_m, UNRANGED_SIGMA_M)


def flown_up(slots: Sequence[Slot], least_m: float) -> list[Slot]:
    """The same shape, so large that receivers alone keep its followers apart, and show it.

    So it is flown up by its pilots: no sonar hears anybody yet.
    """
    demanded_m = receivers_demand_m(least_m) + SURE_SIGMAS * UNRANGED_SIGMA_M
    share = 1.0
    for a, b in combinations(range(len(slots)), 2):
        north_m, east_m, down_m = (
            its - mine for mine, its in zip(place_m(slots, a), place_m(slots, b), strict=True)
        )
        level_m = math.hypot(north_m, east_m)
        if level_m > 0.0 and math.hypot(level_m, down_m) < demanded_m:
            share = max(share, math.sqrt(demanded_m**2 - down_m**2) / level_m)
    return [replace(slot, radius_m=share * slot.radius_m) for slot in slots]


def sonars_demand_m(least_m: float, links: int) -> float:
    """The same for two followers that so many sonars tie to each other."""
    return min(receivers_demand_m(least_m), _demand_m(least_m, math.sqrt(links) * LINK_SIGMA_M))


def _demand_m(least_m: float, sigma_m: float) -> float:
    return least_m + SURE_SIGMAS * sigma_m + 2.0 * IN_SLOT_M


def check_formation(
    slots: Sequence[Slot],
    sonar: SonarBelief,
    least_m: float,
    separation_m: float | None = None,
    *,
    close_gaps: bool = False,
) -> list[str]:
    """Raise EchowingError unless every slot can be flown; returns what only costs accuracy.

    least_m: the distance that has to be certain between any two. separation_m: how far slots have
    to be apart whose followers do not range each other; None: as far as sonars and receivers
    demand. close_gaps: followers may take each other's slots (`check_gaps`).
    """
    if not slots:
        raise EchowingError("formation: no slots; give at least one (radius, angle, altitude step)")
    for number, slot in enumerate(slots, 1):
        _check_slot(number, slot)
    if close_gaps:
        check_gaps(slots)
    layout = _Layout(slots, sonar)
    for pair in combinations(range(len(slots) + 1), 2):
        layout.check_wash(*pair)
        layout.check_apart(*pair, least_m, separation_m)
        layout.check_tone(*pair)
    layout.check_beams()
    return layout.warnings()


def check_gaps(slots: Sequence[Slot]) -> None:
    """Raise EchowingError unless a follower may take any other slot of its line.

    Its applet holds it at `ECHO_DIST` from whom it ranges, which no one changes in flight; and
    nobody climbs or sinks past another one.
    """
    for number, slot in enumerate(slots, 1):
        ahead = None if slot.behind is None else slots[slot.behind]
        if ahead is None:
            continue
        if (slot.radius_m, slot.altitude_step_m) != (ahead.radius_m, ahead.altitude_step_m):
            raise EchowingError(
                f"gaps cannot close: slot {number} and slot {(slot.behind or 0) + 1}, behind which "
                "it is, differ in radius or altitude step; give both the same"
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


class _Layout:
    """Where all are in straight flight, and who hears whom. Number 0 is the leader, 1 a slot.

    A sonar is taken to hear whom it watches as far as its file says (`reach_m`).
    """

    def __init__(self, slots: Sequence[Slot], sonar: SonarBelief) -> None:
        self._sonar = sonar
        self._places_m = [(0.0, 0.0, 0.0), *(place_m(slots, n) for n in range(len(slots)))]
        self._watched = [LEADER if slot.behind is None else slot.behind + 1 for slot in slots]
        self._chain = cache(self._new_chain)

    def check_apart(self, a: int, b: int, least_m: float, separation_m: float | None) -> None:
        """`b` is the later one. Whoever hangs on the leader may be as near to it as it likes."""
        watches = self._watched[b - 1] == a
        if watches and (a == LEADER or self._hears(b)):
            return
        links = self._links(a, b)
        demanded_m = separation_m
        if demanded_m is None:
            demanded_m = (
                receivers_demand_m(least_m) if links is None else sonars_demand_m(least_m, links)
            )
        distance_m = self._distance_m(a, b)
        if distance_m < demanded_m:
            raise EchowingError(
                f"formation: {_names(a, b)} are {distance_m:.2f} m apart, less than "
                f"{demanded_m:.2f} m; move one of them, or allow it by slot_separation_m"
            )

    def check_wash(self, a: int, b: int) -> None:
        """Nobody flies in the air that another one's propellers throw down."""
        (north_m, east_m, down_m), (its_north_m, its_east_m, its_down_m) = (
            self._places_m[one] for one in (a, b)
        )
        beside_m = math.hypot(its_north_m - north_m, its_east_m - east_m)
        if beside_m < WASH_M and abs(its_down_m - down_m) > LEVEL_M:
            lower, upper = (a, b) if down_m > its_down_m else (b, a)
            raise EchowingError(
                f"formation: {_name(lower)} is {abs(its_down_m - down_m):.1f} m below "
                f"{_name(upper)}, in the wash of its propellers; move one of them {WASH_M:g} m to "
                "the side, or to the same height"
            )

    def check_tone(self, a: int, b: int) -> None:
        """No two sonars face each other: each would hear the other's ping, and not its echo.

        A ping is heard at least as far as its echo comes back from: there and back.
        """
        heard_m = 2.0 * self._sonar.reach_m
        if a == LEADER or self._distance_m(a, b) > heard_m:
            return
        if self._sees(a, b) and self._sees(b, a):
            raise EchowingError(
                f"formation: the sonars of {_names(a, b)} face each other within {heard_m:g} m and "
                "would hear each other's pings; move one of them back, or both to one side"
            )

    def check_beams(self) -> None:
        """Nobody stands between a sonar and the one that it watches, or hardly beyond."""
        for one, watched in enumerate(self._watched, 1):
            to_m = self._distance_m(one, watched) + IN_SLOT_M
            for other in range(len(self._places_m)):
                near = other not in (one, watched) and self._distance_m(one, other) < to_m
                if near and self._hears(one) and self._sees(one, other):
                    raise EchowingError(
                        f"formation: {_name(other)} is in the beam between slot {one} and "
                        f"{_name(watched)}, at which its sonar looks; let it look at "
                        f"{_name(other)} (`behind`), or move one of them"
                    )

    def warnings(self) -> list[str]:
        """What may be flown, and costs accuracy."""
        numbers = range(1, len(self._places_m))
        deaf = [one for one in numbers if not self._hears(one)]
        lines = []
        if deaf:
            reach_m = self._sonar.reach_m
            lines.append(f"{_slots(deaf)}: beyond the sonar's reach of {reach_m:g} m, by GPS alone")
        weak: dict[str, list[int]] = {}
        for one in numbers:
            objection = self._sonar.objection(self._distance_m(one, self._watched[one - 1]))
            if objection is not None and one not in deaf:
                weak.setdefault(objection, []).append(one)
        lines += [
            f"{_slots(of)}: the sonar's file does not carry it: {text}" for text, of in weak.items()
        ]
        together = [
            _slots(both)
            for watched in range(len(self._places_m))
            if len(both := [one for one in numbers if self._watches(one, watched)]) > 1
        ]
        if together:
            lines.append(
                f"{'; '.join(together)}: their sonars look at one vehicle, and may hear each "
                "other's echoes (not measured)"
            )
        return lines

    def _watches(self, one: int, watched: int) -> bool:
        return self._watched[one - 1] == watched and self._hears(one)

    def _hears(self, one: int) -> bool:
        """Whether its sonar reaches whom it watches."""
        range_m = self._distance_m(one, self._watched[one - 1]) - self._sonar.inset_m
        return range_m < self._sonar.reach_m

    def _sees(self, one: int, other: int) -> bool:
        """Whether another vehicle may be in its beam, which points at whom it watches."""
        here_m, distance_m = self._places_m[one], self._distance_m(one, other)
        axis_m = self._places_m[self._watched[one - 1]]
        off_rad = apart_rad(
            [there - here for there, here in zip(axis_m, here_m, strict=True)],
            [there - here for there, here in zip(self._places_m[other], here_m, strict=True)],
        )
        return off_rad < self._sonar.widest_rad.at(distance_m)

    def _links(self, a: int, b: int) -> int | None:
        """How many sonars tie two vehicles to each other; None: not all of them hear."""
        links = self._chain(a) ^ self._chain(b)
        return len(links) if all(map(self._hears, links)) else None

    def _new_chain(self, one: int) -> frozenset[int]:
        """A slot, the one that its sonar watches, and so on up to the leader, without that one."""
        return frozenset() if one == LEADER else self._chain(self._watched[one - 1]) | {one}

    def _distance_m(self, a: int, b: int) -> float:
        return math.dist(self._places_m[a], self._places_m[b])


def _name(number: int) -> str:
    return "the leader" if number == LEADER else f"slot {number}"


def _names(a: int, b: int) -> str:
    return f"the leader and slot {b}" if a == LEADER else f"slots {a} and {b}"


def _slots(numbers: Sequence[int]) -> str:
    if len(numbers) == 1:
        return f"slot {numbers[0]}"
    in_a_row = len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1
    told = f"{numbers[0]} to {numbers[-1]}" if in_a_row else ", ".join(map(str, numbers))
    return f"slots {told}"
