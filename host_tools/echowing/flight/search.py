"""The plan: a leader that the sonar does not hear is looked for from both sides. Pure.

A leader that is not heard is kept as far off as the error of two receivers demands. If they
disagree along the line between the vehicles, it is then out of the sonar's reach for a minute. From
the side another part of the disagreement counts. So a follower that hears nothing in its slot
swings round the leader, at the same distance, to one side and to the other.
"""

import math
from dataclasses import dataclass, replace

from echowing.flight.guidance import GuidedPoint, Horizontal, carried_round
from echowing.geo import displace, ned_between


@dataclass(frozen=True, slots=True)
class Swing:
    """How a leader is looked for: after a time in the slot, so far aside, there and back."""

    patience_s: float
    aside_rad: float
    period_s: float


# A leader that was heard before is near the tail. In 4 s the nose has swayed to both sides, and has
# searched from the tail; the swing, which begins slowly, may begin before. There and back in 20 s
# is 1.4 m/s at most, 4.4 m away.
LOST = Swing(3.0, math.radians(60.0), 20.0)
# Where one that was never heard is, nobody knows. From 70 degrees aside only a third of what the
# receivers disagree by along the tail matters; from abeam nothing of it, but there a leader that
# turned a corner flew at the follower (0.82 m). 1.5 m/s at most.
NEW = Swing(2.0, math.radians(70.0), 22.0)
# Before, the nose looks once to both sides: with receivers that disagree by 3 m a leader 2 m away
# may be beside the beam, and the swing would fly at it (0.66 m in the demo's seed 26).
LOOK_RAD, LOOK_S = math.radians(30.0), 4.0
# A swing gains its speed, and loses it, in this time. If the point sets out at 1 m/s at once,
# ArduCopter 4.8 answers with 2.5 m/s.
GATHERS_S = 2.0
# After so many rounds without an echo it waits in its slot until the receivers' errors change.
ROUNDS = 2
# The rate back to the tail once the leader is heard again: 0.6 m/s at 3 m.
BACK_RPS = 0.2
# Points come at 8 Hz; after a longer pause it goes on from where it is.
LONGEST_STEP_S = 1.0


@dataclass(slots=True)
class Search:
    """One follower's search; `aside_rad`: how far its slot is swung now, clockwise from above."""

    aside_rad: float = 0.0
    _swing: Swing = NEW
    _begins_s: float | None = None
    _at_s: float = -math.inf

    def is_under_way(self, now_s: float) -> bool:
        """Whether the slot is swung to look for the leader."""
        lasts_s = ROUNDS * self._swing.period_s + GATHERS_S
        return self._begins_s is not None and 0.0 <= now_s - self._begins_s < lasts_s

    def look_rad(self, now_s: float) -> float:
        """How far aside the nose looks for one that was never heard, clockwise from above."""
        if self._begins_s is None or self._swing is not NEW:
            return 0.0
        since_s = now_s - (self._begins_s - NEW.patience_s)
        looks = 0.0 <= since_s < LOOK_S
        return LOOK_RAD * math.sin(2.0 * math.pi * since_s / LOOK_S) if looks else 0.0

    def update(self, now_s: float, *, misses: bool, in_slot: bool, new: bool) -> float:
        """Swing on; returns the rate at which the slot swings now, rad/s.

        misses: a leader that its sonar could hear is not heard; in_slot: it is where it should be;
        new: the leader was never heard.
        """
        if not misses:
            self._begins_s = None
        elif self._begins_s is None and in_slot:
            self._swing = NEW if new else LOST
            self._begins_s = now_s + self._swing.patience_s
        elapsed_s = min(LONGEST_STEP_S, now_s - self._at_s)
        self._at_s = now_s
        before_rad = self.aside_rad
        self.aside_rad = self._wanted_rad(now_s, elapsed_s)
        return (self.aside_rad - before_rad) / elapsed_s if elapsed_s > 0.0 else 0.0

    def _wanted_rad(self, now_s: float, elapsed_s: float) -> float:
        if self._begins_s is None or not self.is_under_way(now_s):
            left_rad = max(0.0, abs(self.aside_rad) - BACK_RPS * elapsed_s)
            return math.copysign(left_rad, self.aside_rad)
        swing = self._swing
        swung_s = _smoothly(now_s - self._begins_s, ROUNDS * swing.period_s)
        return swing.aside_rad * math.sin(2.0 * math.pi * swung_s / swing.period_s)


def _smoothly(since_s: float, whole_s: float) -> float:
    """How far on it is in a motion of `whole_s` that starts and ends at rest."""
    if since_s < GATHERS_S:
        return since_s * since_s / (2.0 * GATHERS_S)
    left_s = whole_s + GATHERS_S - since_s
    if left_s < GATHERS_S:
        return whole_s - left_s * left_s / (2.0 * GATHERS_S)
    return since_s - 0.5 * GATHERS_S


def swung(guided: GuidedPoint, aside_rad: float, rate_rps: float) -> GuidedPoint:
    """A slot swung round its leader by an angle that changes at a rate, clockwise from above."""
    if aside_rad == 0.0 and rate_rps == 0.0:
        return guided
    offset_m = _turned(guided.offset_m, aside_rad)
    place = displace(guided.leader, (*offset_m, ned_between(guided.leader, guided.slot)[2]))
    velocity_mps = carried_round(guided.velocity_mps, rate_rps, offset_m)
    return replace(guided, point=place, slot=place, offset_m=offset_m, velocity_mps=velocity_mps)


def _turned(vector: Horizontal, by_rad: float) -> Horizontal:
    cos, sin = math.cos(by_rad), math.sin(by_rad)
    return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos
