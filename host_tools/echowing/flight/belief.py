"""What a sonar is believed to hear. Pure: `echowing.sonar_file` reads it from a file.

The estimate, the plan and the envelope read it here and nowhere else. It is no more than a belief:
the simulator's sonar is drawn anew for each flight, and a real one is what it is.
"""

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

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
        return float(np.interp(range_m, self.at_m, self.values))


@dataclass(frozen=True, slots=True)
class SonarBelief:
    """A sonar, as far as it is known.

    heard: the least share of its readings that hear a leader on the axis, over the range; beyond
    its last range that is not known. widest_rad: half angle of the widest beam that it may have;
    nobody is heard outside. narrowest_rad: of the narrowest; silence from within is evidence.
    edge_rad: over this angle the beam begins. noise_m: standard deviation of a range, at most.
    wrong_share: most of its readings that are not the leader's. shortest_m: nearer reads as this.
    reach_m: a range from here on is no target. heard_to_m: so far the leader is heard in any case.
    inset_m: how much less than the separation it reads. rate_hz: readings per second.
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
    rate_hz: float

    @property
    def silent_to_m(self) -> float:
        """From a leader that is further, silence tells nothing."""
        return self.heard.at_m[-1]
