"""The slow disagreement between two GPS receivers, learned from the sonar. Pure.

Leader and follower each believe to be a metre or so from where they are, and the errors wander
over a minute. Only their difference matters to a formation, and the sonar sees it: what the two
receivers say the leader's place is, less where the sonar hears it. A Kalman filter of two states
(north, east) follows that difference; where the sonar has not looked, its uncertainty grows back
to what receivers do, and the follower stands off accordingly.
"""

import math
from dataclasses import dataclass

from echowing.guidance import Horizontal

# A sonar reading a whole beam wide says little across the beam: uniform over +-20 degrees is
# 0.2 rad. The same error lasts for seconds, so that at two readings a second about ten are worth
# one: 0.2 x sqrt(10).
ACROSS_PER_METRE = 0.63
# Along the beam the reading is good to centimetres, the predicted leader to some 0.3 m while it
# turns; that error lasts a second or two: 0.3 x sqrt(3).
ALONG_SIGMA_M = 0.5
# One reading every half second: the noise above is meant for that.
UPDATE_PERIOD_S = 0.5
# Another vehicle, the ground or a wild reading: further from what is believed than this many
# standard deviations (one leader in 3000 is really further off).
GATE_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class Wandering:
    """How far receivers wander: standard deviation an axis and correlation time, each one's."""

    sigma_m: float = 0.8
    tau_s: float = 60.0


class RelativeOffset:
    """Leader's minus follower's position error, (north, east) metres, with its uncertainty."""

    def __init__(self, wandering: Wandering | None = None) -> None:
        self._wandering = wandering or Wandering()
        self._prior_m2 = 2.0 * self._wandering.sigma_m**2
        self.north_m = 0.0
        self.east_m = 0.0
        self._p_nn, self._p_ne, self._p_ee = self._prior_m2, 0.0, self._prior_m2
        self._at_s: float | None = None
        self._heard_at_s = -math.inf

    def unheard_s(self, now_s: float) -> float:
        """For how long no reading has been taken for the leader; infinite at first."""
        return now_s - self._heard_at_s

    def sigma_m(self, direction_rad: float) -> float:
        """Standard deviation of the estimate along a bearing."""
        cos, sin = math.cos(direction_rad), math.sin(direction_rad)
        variance = self._p_nn * cos * cos + 2.0 * self._p_ne * cos * sin + self._p_ee * sin * sin
        return math.sqrt(max(0.0, variance))

    def advance(self, now_s: float) -> None:
        """Let the estimate fade and its uncertainty grow until `now_s`."""
        elapsed_s = 0.0 if self._at_s is None else max(0.0, now_s - self._at_s)
        self._at_s = now_s
        keep = math.exp(-elapsed_s / self._wandering.tau_s)
        self.north_m *= keep
        self.east_m *= keep
        grown = self._prior_m2 * (1.0 - keep * keep)
        self._p_nn = self._p_nn * keep * keep + grown
        self._p_ne *= keep * keep
        self._p_ee = self._p_ee * keep * keep + grown

    def heard(self, now_s: float, distance_m: float, axis_rad: float, believed: Horizontal) -> bool:
        """Take a sonar reading.

        Args:
            now_s: when it was taken.
            distance_m: between the two vehicles' centres, by the sonar.
            axis_rad: bearing the sonar looked along.
            believed: from follower to leader by their receivers, (north, east) metres.

        Returns:
            False when it was left out: too soon after the last, or not the leader.

        """
        if now_s - self._heard_at_s < UPDATE_PERIOD_S:
            return False
        self.advance(now_s)
        cos, sin = math.cos(axis_rad), math.sin(axis_rad)
        miss_n = believed[0] - distance_m * cos - self.north_m
        miss_e = believed[1] - distance_m * sin - self.east_m
        along2, across2 = ALONG_SIGMA_M**2, (ACROSS_PER_METRE * distance_m) ** 2
        s_nn = self._p_nn + along2 * cos * cos + across2 * sin * sin
        s_ne = self._p_ne + (along2 - across2) * cos * sin
        s_ee = self._p_ee + along2 * sin * sin + across2 * cos * cos
        determinant = s_nn * s_ee - s_ne * s_ne
        i_nn, i_ne, i_ee = s_ee / determinant, -s_ne / determinant, s_nn / determinant
        unlikely = miss_n * (i_nn * miss_n + i_ne * miss_e) + miss_e * (
            i_ne * miss_n + i_ee * miss_e
        )
        if unlikely > GATE_SIGMAS**2:
            return False
        self._heard_at_s = now_s
        self._correct(i_nn, i_ne, i_ee, miss_n, miss_e)
        return True

    def _correct(self, i_nn: float, i_ne: float, i_ee: float, miss_n: float, miss_e: float) -> None:
        p_nn, p_ne, p_ee = self._p_nn, self._p_ne, self._p_ee
        k_nn, k_ne = p_nn * i_nn + p_ne * i_ne, p_nn * i_ne + p_ne * i_ee
        k_en, k_ee = p_ne * i_nn + p_ee * i_ne, p_ne * i_ne + p_ee * i_ee
        self.north_m += k_nn * miss_n + k_ne * miss_e
        self.east_m += k_en * miss_n + k_ee * miss_e
        self._p_nn = p_nn - k_nn * p_nn - k_ne * p_ne
        self._p_ne = p_ne - k_nn * p_ne - k_ne * p_ee
        self._p_ee = p_ee - k_en * p_ne - k_ee * p_ee
