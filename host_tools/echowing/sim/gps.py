"""GPS drift: the slow wandering of a receiver's position."""

import math
import random

from echowing.geo import Ned

# The autopilot's filter follows its receiver's wandering within about a second, so that the
# estimate glides where the receiver's position would jitter.
ESTIMATE_LAG_S = 1.0


class GpsDrift:
    """First-order Gauss-Markov offset of an estimated position, horizontal axes alike.

    sigma_m: standard deviation an axis; tau_s: correlation time. Starts in the steady state.
    """

    def __init__(self, sigma_m: float, tau_s: float, rng: random.Random) -> None:
        self._sigma_m = sigma_m
        self._tau_s = tau_s
        self._rng = rng
        self._north_m = rng.gauss(0.0, sigma_m)
        self._east_m = rng.gauss(0.0, sigma_m)
        self.jump_ned_m: Ned = (0.0, 0.0, 0.0)
        self._estimate = (self._north_m, self._east_m)

    def step(self, dt_s: float) -> Ned:
        """Offset (estimated minus true, NED metres) after `dt_s` more seconds.

        A jump (`jump_ned_m`, a fault) is added at once: the filter resets to it.
        """
        keep = math.exp(-dt_s / self._tau_s)
        kick_m = self._sigma_m * math.sqrt(1.0 - keep * keep)
        self._north_m = keep * self._north_m + self._rng.gauss(0.0, kick_m)
        self._east_m = keep * self._east_m + self._rng.gauss(0.0, kick_m)
        blend = 1.0 - math.exp(-dt_s / ESTIMATE_LAG_S)
        north, east = self._estimate
        north += blend * (self._north_m - north)
        east += blend * (self._east_m - east)
        self._estimate = (north, east)
        jump = self.jump_ned_m
        return north + jump[0], east + jump[1], jump[2]
