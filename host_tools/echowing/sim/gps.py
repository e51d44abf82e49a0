"""GPS drift: the slow wandering of an estimated position, and of an estimated height."""

import math
import random

from echowing.geo import Ned

# The autopilot's filter follows its receiver's wandering within about a second, so that the
# estimate glides where the receiver's position would jitter.
ESTIMATE_LAG_S = 1.0


class _Wander:
    """One axis: a first-order Gauss-Markov error and what the filter makes of it (metres)."""

    def __init__(self, sigma_m: float, tau_s: float, rng: random.Random) -> None:
        self._sigma_m = sigma_m
        self._tau_s = tau_s
        self._rng = rng
        self._error_m = self.estimate_m = rng.gauss(0.0, sigma_m)
        self._dt_s = -1.0
        self._keep = self._kick_m = self._blend = 0.0

    def step(self, dt_s: float) -> float:
        """The estimate's error after `dt_s` more seconds."""
        if dt_s != self._dt_s:
            self._prepare(dt_s)
        self._error_m = self._keep * self._error_m + self._rng.gauss(0.0, self._kick_m)
        self.estimate_m += self._blend * (self._error_m - self.estimate_m)
        return self.estimate_m

    def _prepare(self, dt_s: float) -> None:
        """What a step keeps of the error, adds to it, and lets the filter follow."""
        self._dt_s = dt_s
        self._keep = math.exp(-dt_s / self._tau_s)
        self._kick_m = self._sigma_m * math.sqrt(1.0 - self._keep * self._keep)
        self._blend = 1.0 - math.exp(-dt_s / ESTIMATE_LAG_S)


class GpsDrift:
    """First-order Gauss-Markov offset of an estimated position. Starts in the steady state.

    sigma_m: standard deviation of each horizontal axis; tau_s: correlation time;
    vertical_sigma_m: that of the height, with chance of its own (`vertical_rng`), so that it
    changes nothing else in a flight. 0: the height is right.
    """

    def __init__(
        self,
        sigma_m: float,
        tau_s: float,
        rng: random.Random,
        *,
        vertical_sigma_m: float = 0.0,
        vertical_rng: random.Random | None = None,
    ) -> None:
        self._north = _Wander(sigma_m, tau_s, rng)
        self._east = _Wander(sigma_m, tau_s, rng)
        self._down: _Wander | None = None
        if vertical_sigma_m > 0.0:
            self._down = _Wander(vertical_sigma_m, tau_s, vertical_rng or rng)
        self.jump_ned_m: Ned = (0.0, 0.0, 0.0)

    def step(self, dt_s: float) -> Ned:
        """Offset (estimated minus true, NED metres) after `dt_s` more seconds.

        A jump (`jump_ned_m`, a fault) is added at once: the filter resets to it.
        """
        north, east = self._north.step(dt_s), self._east.step(dt_s)
        down = self._down.step(dt_s) if self._down is not None else 0.0
        jump = self.jump_ned_m
        return north + jump[0], east + jump[1], down + jump[2]
