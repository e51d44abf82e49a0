"""The slow disagreement between two vehicles' own positions, learnt from the sonar. Pure.

Leader and follower each report a place a metre or so from the true one, and the errors wander over
a minute: the receivers' north and east, the barometers' up. Only their difference matters to a
formation, and the sonar shows it: a reading says that the leader is on an arc, at that range and
somewhere in the beam; silence says that it is not in the beam. An arc is no ellipse, and silence no
measurement, so this is no Kalman filter but a map of how likely each difference (north, east, up)
is. The mean of the map is where to look; where the sonar looks and hears nothing, the map grows
thin and the mean moves on: that is the search.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echowing.flight.axis import Axis
from echowing.flight.guidance import Horizontal

# The map: four standard deviations of the difference to each side, in cells as wide as the beam is
# blurred at 1 m.
HALF_WIDTH_M, CELL_M = 4.6, 0.2
# Its layers: more than two standard deviations up and down. A layer is lower than a third of the
# beam at 3 m.
HALF_HEIGHT_M, LAYER_M = 1.6, 0.4
# Both vehicles are known at the reading's moment to a decimetre, and a cell is as wide.
RANGE_SIGMA_M = 0.15
# The beam (sim/sonar.py), and the angle over which lean, heading and the echo's own strength blur
# its edge.
BEAM_HALF_RAD, EDGE_RAD = math.radians(20.0), math.radians(3.0)
# Silence says only that the leader is not where every beam would reach: sonars and targets differ,
# and with the beam's own half angle a follower came to 0.6 m of a leader that it looked past.
SILENT_HALF_RAD = math.radians(14.0)
# A reading is of something else (wild, another vehicle, the ground) this often.
WRONG_SHARE = 0.03
# A leader in the beam and no further than this is heard this often, as long as nobody leans.
SILENCE_TO_M, HEARD_SHARE = 4.0, 0.5
# Readings nearer in time share their errors, and must not count twice.
UPDATE_PERIOD_S = 0.25
# The map changes by 0.2 m in a second: so it is blurred this often.
BLUR_PERIOD_S = 0.5
LEAST_LIKELIHOOD = 1e-12

# The map is 32 bits wide: it tells no more than a few digits, and is twice as quick.
Map = NDArray[np.float32]
# From follower to leader, by their own positions: (north, east, up).
Between = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Wandering:
    """How far each vehicle's position wanders: standard deviation per axis, correlation time.

    height_sigma_m: that of its height.
    """

    sigma_m: float = 0.8
    tau_s: float = 60.0
    height_sigma_m: float = 0.5


class OffsetGrid:
    """Leader's minus follower's position error, (north, east, up) metres, with its uncertainty."""

    def __init__(self, wandering: Wandering | None = None) -> None:
        wandering = wandering or Wandering()
        self._tau_s = wandering.tau_s
        self._prior_m2 = 2.0 * wandering.sigma_m**2
        self._height_prior_m2 = 2.0 * wandering.height_sigma_m**2
        self._level_axis = _axis(HALF_WIDTH_M, CELL_M)
        self._up_axis = _axis(HALF_HEIGHT_M, LAYER_M)
        # Each difference for every cell of the map: [north, east, up].
        self._north = self._level_axis[:, np.newaxis, np.newaxis]
        self._east = self._level_axis[:, np.newaxis]
        self._up = self._up_axis
        self._pull = (self._north**2 + self._east**2) / self._prior_m2
        self._pull = self._pull + self._up**2 / self._height_prior_m2
        self._map: Map = np.exp(-0.5 * self._pull)
        self._advanced_s: float | None = None
        self._heard_at_s = -math.inf
        self._silent_at_s = -math.inf
        self._summarise()

    def unheard_s(self, now_s: float) -> float:
        """Time since the last reading that was the leader's; infinite at first."""
        return now_s - self._heard_at_s

    def sigma_m(self, direction_rad: float) -> float:
        """Standard deviation of the estimate along a bearing."""
        cos, sin = math.cos(direction_rad), math.sin(direction_rad)
        p_nn, p_ne, p_ee = self._covariance
        return math.sqrt(p_nn * cos * cos + 2.0 * p_ne * cos * sin + p_ee * sin * sin)

    def unproven_sigma_m(self, direction_rad: float, now_s: float) -> float:
        """As `sigma_m`, but no less than receivers may have wandered since the last reading.

        Silence makes the map narrower where the leader is not. It does not prove where it is: a
        sonar that is deaf is silent too.
        """
        wandered_m = math.sqrt(self._prior_m2 * (1.0 - self._kept(now_s) ** 2))
        return max(self.sigma_m(direction_rad), wandered_m)

    def unproven_shift_m(self, direction_rad: float, now_s: float) -> float:
        """How much further off along a bearing silence alone has moved the leader.

        That is the part of the mean that no reading supports any more; never negative.
        """
        further_m = -self.north_m * math.cos(direction_rad) - self.east_m * math.sin(direction_rad)
        return max(0.0, (1.0 - self._kept(now_s)) * further_m)

    def _kept(self, now_s: float) -> float:
        """The share of the last reading's information that is left; 0 before the first."""
        return math.exp(-max(0.0, self.unheard_s(now_s)) / self._tau_s)

    def advance(self, now_s: float) -> None:
        """Let the map blur until `now_s`, and fade back to the prior."""
        if self._advanced_s is None:
            self._advanced_s = now_s
        elapsed_s = now_s - self._advanced_s
        if elapsed_s < BLUR_PERIOD_S:
            return
        self._advanced_s = now_s
        passed = elapsed_s / self._tau_s
        self._map = _blurred(
            self._map,
            (
                _moved_share(2.0 * self._prior_m2 * passed, CELL_M),
                _moved_share(2.0 * self._prior_m2 * passed, CELL_M),
                _moved_share(2.0 * self._height_prior_m2 * passed, LAYER_M),
            ),
        )
        # The information that balances this blur where the map is as wide as the prior.
        self._map *= np.exp(-self._pull * np.float32(passed))
        self._summarise()

    def heard(self, time_s: float, distance_m: float, axis: Axis, believed: Between) -> None:
        """Take a sonar reading.

        Args:
            time_s: when it was taken.
            distance_m: between the two vehicles' centres, by the sonar.
            axis: the sonar looked along it.
            believed: from follower to leader by their own positions, (north, east, up) metres.

        """
        if time_s - self._heard_at_s < UPDATE_PERIOD_S:
            return
        self.advance(time_s)
        far_m, in_beam = self._seen_from(axis, believed, BEAM_HALF_RAD)
        fits = np.exp(-0.5 * ((far_m - distance_m) / RANGE_SIGMA_M) ** 2) * in_beam
        weight = float((self._map * fits).sum() / self._map.sum())
        if weight > WRONG_SHARE * _ring_share(distance_m):
            self._heard_at_s = time_s
        self._update(fits + np.float32(WRONG_SHARE * _ring_share(distance_m)))

    def silent(self, time_s: float, axis: Axis, believed: Between) -> None:
        """Take a reading without an echo; arguments as for `heard`."""
        if time_s - max(self._silent_at_s, self._heard_at_s) < UPDATE_PERIOD_S:
            return
        self._silent_at_s = time_s
        self.advance(time_s)
        far_m, in_beam = self._seen_from(axis, believed, SILENT_HALF_RAD)
        self._update(1.0 - HEARD_SHARE * in_beam * (far_m < SILENCE_TO_M))

    def _seen_from(self, axis: Axis, believed: Between, half_rad: float) -> tuple[Map, Map]:
        """How far the leader is for each difference, and how surely it is in a beam (0 to 1)."""
        north, east = believed[0] - self._north, believed[1] - self._east
        up = believed[2] - self._up
        far_m = np.sqrt(north * north + east * east + up * up)
        to_north, to_east, to_down = axis.unit_ned
        ahead = (north * to_north + east * to_east - up * to_down) / np.maximum(far_m, CELL_M)
        off_rad = np.arccos(np.minimum(np.maximum(ahead, -1.0), 1.0))
        # As far beyond the edge as 32 bits can tell, it is outside.
        beyond = np.minimum((off_rad - half_rad) / (0.5 * EDGE_RAD), 80.0)
        return far_m, 1.0 / (1.0 + np.exp(beyond))

    def _update(self, likelihood: Map) -> None:
        self._map *= likelihood
        self._summarise()

    def _summarise(self) -> None:
        """Mean and covariance of the map, and its sum back to one."""
        self._map = np.maximum(self._map / self._map.sum(), LEAST_LIKELIHOOD)
        self._map /= self._map.sum()
        level, axis = self._map.sum(axis=2, dtype=float), self._level_axis
        of_north, of_east = level.sum(axis=1), level.sum(axis=0)
        of_up = self._map.sum(axis=(0, 1), dtype=float)
        self.north_m, self.east_m = float(of_north @ axis), float(of_east @ axis)
        self.up_m = float(of_up @ self._up_axis)
        row, column = divmod(int(level.argmax()), len(axis))
        self.most_likely_m = (float(axis[row]), float(axis[column]))
        off_n, off_e = axis - self.north_m, axis - self.east_m
        self._covariance = (
            float(of_north @ (off_n * off_n)),
            float(off_n @ level @ off_e),
            float(of_east @ (off_e * off_e)),
        )
        self.up_sigma_m = math.sqrt(float(of_up @ (self._up_axis - self.up_m) ** 2))


def _axis(half_m: float, cell_m: float) -> Map:
    """The middles of the cells to both sides of none."""
    cells = round(half_m / cell_m)
    return (np.arange(-cells, cells + 1) * cell_m).astype(np.float32)


def _ring_share(distance_m: float) -> float:
    """The share of an even spread over the sonar's reach that would fit a reading by chance."""
    return RANGE_SIGMA_M / max(distance_m, RANGE_SIGMA_M)


def _moved_share(variance_m2: float, cell_m: float) -> float:
    """What a random walk with this variance moves from a cell to either of those beside it."""
    return min(1.0 / 3.0, 0.5 * variance_m2 / (cell_m * cell_m))


def _blurred(values: Map, shares: tuple[float, float, float]) -> Map:
    """The map after a random walk along each of its axes, by a three point kernel."""
    for share in shares:  # along the first axis, which then becomes the last
        beside = np.empty_like(values)
        beside[1:-1] = values[:-2] + values[2:]
        beside[0], beside[-1] = values[0] + values[1], values[-2] + values[-1]
        values = ((1.0 - 2.0 * share) * values + share * beside).transpose(1, 2, 0)
    return values
