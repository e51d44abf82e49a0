"""The slow disagreement between two GPS receivers, learnt from the sonar. Pure.

Leader and follower each report a place a metre or so from the true one, and the errors wander over
a minute. Only their difference matters to a formation, and the sonar shows it: a reading says that
the leader is on an arc, at that range and somewhere in the beam; silence says that it is not in the
beam. An arc is no ellipse, and silence no measurement, so this is no Kalman filter but a map of how
likely each difference (north, east) is. The mean of the map is where to look; where the sonar looks
and hears nothing, the map grows thin and the mean moves on: that is the search.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echowing.flight.belief import Curve, SonarBelief
from echowing.flight.guidance import Horizontal

# The map: four standard deviations of the difference to each side, in cells as wide as the beam is
# blurred at 1 m.
HALF_WIDTH_M, CELL_M = 4.6, 0.2
# Both vehicles are known at the reading's moment to a decimetre, and a cell is as wide.
PLACED_SIGMA_M = 0.15
# Readings nearer in time share their errors, and must not count twice.
UPDATE_PERIOD_S = 0.25
# The map changes by 0.2 m in a second: so it is blurred this often.
BLUR_PERIOD_S = 0.5
LEAST_LIKELIHOOD = 1e-12

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Wandering:
    """How far each receiver wanders: standard deviation per axis, and correlation time."""

    sigma_m: float = 0.8
    tau_s: float = 60.0


class OffsetGrid:
    """Leader's minus follower's position error, (north, east) metres, with its uncertainty."""

    def __init__(self, sonar: SonarBelief, wandering: Wandering | None = None) -> None:
        wandering = wandering or Wandering()
        self._sonar = sonar
        self._range_sigma_m = math.hypot(PLACED_SIGMA_M, sonar.noise_m)
        self._tau_s = wandering.tau_s
        self._prior_m2 = 2.0 * wandering.sigma_m**2
        cells = round(HALF_WIDTH_M / CELL_M)
        # Both axes of the map: a row is one difference to the north, a column one to the east.
        self._axis = np.arange(-cells, cells + 1) * CELL_M
        self._square = self._axis[:, np.newaxis] ** 2 + self._axis**2
        self._map: Map = np.exp(-0.5 * self._square / self._prior_m2)
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
        self._map = _blurred(self._map, 2.0 * self._prior_m2 / self._tau_s * elapsed_s)
        # The information that balances this blur where the map is as wide as the prior.
        self._map *= np.exp(-self._square * (elapsed_s / (self._tau_s * self._prior_m2)))
        self._summarise()

    def heard(
        self, time_s: float, distance_m: float, axis_rad: float, believed: Horizontal
    ) -> None:
        """Take a sonar reading.

        Args:
            time_s: when it was taken.
            distance_m: between the two vehicles' centres, by the sonar.
            axis_rad: bearing the sonar looked along.
            believed: from follower to leader by their receivers, (north, east) metres.

        """
        if time_s - self._heard_at_s < UPDATE_PERIOD_S:
            return
        self.advance(time_s)
        far_m, in_beam = self._seen_from(axis_rad, believed, self._sonar.widest_rad)
        fits = np.exp(-0.5 * ((far_m - distance_m) / self._range_sigma_m) ** 2) * in_beam
        weight = float((self._map * fits).sum() / self._map.sum())
        # The share of an even spread over the sonar's reach that would fit a reading by chance.
        ring_share = self._range_sigma_m / max(distance_m, self._range_sigma_m)
        by_chance = self._sonar.wrong_share * ring_share
        if weight > by_chance:
            self._heard_at_s = time_s
        self._update(fits + by_chance)

    def silent(
        self, time_s: float, axis_rad: float, believed: Horizontal, above_m: float = 0.0
    ) -> None:
        """Take a reading without an echo; arguments as for `heard`.

        It says only that the leader is not where every beam would reach: with the beam's own half
        angle a follower came to 0.6 m of a leader that it looked past.
        above_m: how much higher the leader is. From below or above the beam misses it wherever it
        is near, and its silence tells nothing.
        """
        if time_s - max(self._silent_at_s, self._heard_at_s) < UPDATE_PERIOD_S:
            return
        self._silent_at_s = time_s
        self.advance(time_s)
        sonar = self._sonar
        far_m, in_beam = self._seen_from(axis_rad, believed, sonar.narrowest_rad, above_m)
        self._update(1.0 - sonar.heard.at(far_m) * in_beam * (far_m < sonar.silent_to_m))

    def _seen_from(
        self, axis_rad: float, believed: Horizontal, half_rad: Curve, above_m: float = 0.0
    ) -> tuple[Map, Map]:
        """How far the leader is for each difference, and how surely it is in a beam (0 to 1)."""
        north, east = believed[0] - self._axis[:, np.newaxis], believed[1] - self._axis
        far_m = np.sqrt(north * north + east * east + above_m * above_m)
        ahead = (north * math.cos(axis_rad) + east * math.sin(axis_rad)) / np.maximum(far_m, CELL_M)
        off_rad = np.arccos(np.minimum(np.maximum(ahead, -1.0), 1.0))
        off_edge = (off_rad - half_rad.at(far_m)) / (0.5 * self._sonar.edge_rad)
        return far_m, 1.0 / (1.0 + np.exp(off_edge))

    def _update(self, likelihood: Map) -> None:
        self._map *= likelihood
        self._summarise()

    def _summarise(self) -> None:
        """Mean and covariance of the map, and its sum back to one."""
        self._map = np.maximum(self._map / self._map.sum(), LEAST_LIKELIHOOD)
        weights, axis = self._map / self._map.sum(), self._axis
        of_north, of_east = weights.sum(axis=1), weights.sum(axis=0)
        self.north_m, self.east_m = float(of_north @ axis), float(of_east @ axis)
        row, column = divmod(int(weights.argmax()), len(axis))
        self.most_likely_m = (float(axis[row]), float(axis[column]))
        off_n, off_e = axis - self.north_m, axis - self.east_m
        self._covariance = (
            float(of_north @ (off_n * off_n)),
            float(off_n @ weights @ off_e),
            float(of_east @ (off_e * off_e)),
        )


def _blurred(values: Map, variance_m2: float) -> Map:
    """The map after a random walk with this variance per axis, by a three point kernel."""
    share = min(1.0 / 3.0, 0.5 * variance_m2 / (CELL_M * CELL_M))
    for _ in range(2):  # down the columns, then, transposed, along the rows
        beside = np.empty_like(values)
        beside[1:-1] = values[:-2] + values[2:]
        beside[0], beside[-1] = values[0] + values[1], values[-2] + values[-1]
        values = ((1.0 - 2.0 * share) * values + share * beside).T
    return values
