"""What a sonar is believed to hear. Pure: `echowing.sonar_file` reads it from a file.

The estimate, the plan and the envelope read it here and nowhere else. It is no more than a belief:
the simulator's sonar is drawn anew for each flight, and a real one is what it is.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

# What a slot takes, at the least; `echowing bench --only robust` has a row for each: four pings of
# ten heard, a beam of 6 degrees to each side, 5 cm of noise. With twice as many wrong readings the
# estimate drops its sonar.
LEAST_SHARE, LEAST_HALF_RAD = 0.4, math.radians(6.0)
MOST_NOISE_M, MOST_WRONG = 0.05, 0.1
# So long a leader brakes until its range differs: 0.1 s at 2.5 m/s2 is 0.01 m, a sonar's step; 0.15
# s are 0.03 m.
DIFFERS_S = 0.1
# The co-processor reports ten times a second, and `follow` asks for no more of an autopilot's own.
MOST_HZ = 10.0
# A follower is mostly within this of its slot.
ROOM_M = 0.7

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    """A value over the range: straight between its points, level before and after them."""

    at_m: tuple[float, ...]
    values: tuple[float, ...]

    @overload
    def at(self, range_m: float) -> float: ...
    @overload
    def at(self, range_m: Values) -> Values: ...
    def at(self, range_m: float | Values) -> float | Values:
        """The value at a range, or at each of many."""
        if isinstance(range_m, np.ndarray):
            found: Values = np.interp(range_m, self.at_m, self.values)
            return found
        # As np.interp, to the last digit, which takes six times as long for one value.
        after = bisect_right(self.at_m, range_m)
        if after in (0, len(self.at_m)):
            return self.values[max(0, after - 1)]
        before_m, before = self.at_m[after - 1], self.values[after - 1]
        slope = (self.values[after] - before) / (self.at_m[after] - before_m)
        return slope * (range_m - before_m) + before


@dataclass(frozen=True, slots=True)
class SonarBelief:
    """A sonar, as far as it is known.

    heard: the least share of its readings that hear a leader on the axis, over the range; beyond
    its last range that is not known. widest_rad: half angle of the widest beam that it may have;
    nobody is heard outside. narrowest_rad: of the narrowest; silence from within is evidence.
    edge_rad: over this angle the beam begins. noise_m: standard deviation of a range, at most.
    wrong_share: most of its readings that are not the leader's. shortest_m: nearer reads as this.
    reach_m: a range from here on is no target. heard_to_m: so far the leader is heard in any case;
    surely_to_m: so far even one with worse legs than it is said to have. inset_m: how much less
    than the separation it reads. rate_hz: readings per second. fixed: the autopilot reads it
    itself, and it looks where the nose does; else the co-processor does both.
    """

    heard: Curve
    widest_rad: Curve
    narrowest_rad: Curve
    edge_rad: float
    noise_m: float
    wrong_share: float
    shortest_m: float
    reach_m: float
    inset_m: float
    heard_to_m: float
    surely_to_m: float
    rate_hz: float
    fixed: bool = False

    def objection(self, radius_m: float) -> str | None:
        """Why it does not carry a slot of this radius; None: it does."""
        return next(iter(self.objections(radius_m).values()), None)

    def objections(self, radius_m: float) -> dict[str, str]:
        """All that it has against a slot of this radius: what kind, and in words."""
        range_m, reaches_m = radius_m - self.inset_m, self.heard_to_m + self.inset_m
        share, half_rad = self.heard.at(range_m), self.narrowest_rad.at(range_m)
        found = {
            "noise": self.noise_m > MOST_NOISE_M
            and f"its ranges may scatter by {self.noise_m:.2f} m, at most {MOST_NOISE_M:g} m do",
            "wrong": self.wrong_share > MOST_WRONG
            and f"{self.wrong_share:.0%} of its readings may be wrong, at most {MOST_WRONG:.0%} do",
            "near": range_m < self.shortest_m + ROOM_M
            and f"nearer than {self.shortest_m:g} m it does not measure",
            "far": range_m + ROOM_M > self.heard_to_m
            and f"a leader is certain to be heard up to {reaches_m:.1f} m, and no further",
            "share": share < LEAST_SHARE
            and f"as few as {share:.0%} of its readings may hear the leader there",
            "beam": half_rad < LEAST_HALF_RAD
            and f"its beam may be as narrow as {math.degrees(half_rad):.0f} degrees to each side "
            "there",
        }
        return {kind: text for kind, text in found.items() if text}

    def nearest_carried_m(self, radius_m: float, slots_m: tuple[float, float]) -> float | None:
        """The radius nearest to this one, of the least to the most, that it carries; None: none."""
        tenths = range(round(10.0 * slots_m[0]), round(10.0 * slots_m[1]) + 1)
        carried = [0.1 * tenth for tenth in tenths if self.objection(0.1 * tenth) is None]
        return min(carried, key=lambda slot_m: abs(slot_m - radius_m), default=None)

    @property
    def noticed_s(self) -> float:
        """From a leader's first braking until a second reading has confirmed it.

        No sensor is read more often than ten times a second.
        """
        return round(2.0 / min(MOST_HZ, self.rate_hz) + DIFFERS_S, 3)

    @property
    def silent_to_m(self) -> float:
        """From a leader that is further, silence tells nothing."""
        return self.heard.at_m[-1]
