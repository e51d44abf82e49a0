"""How a GPS receiver wanders: a first-order Gauss-Markov offset on each horizontal axis.

The autopilot's own filter smooths it, so unlike the simulator's model it has no lag of its own.
"""

import math
import random

# Of a degree of latitude, and of one of longitude at the equator, mean of WGS-84.
METRES_PER_DEGREE = 111_195.0


class Drift:
    """The offset of one receiver, metres north and east; it starts in the steady state."""

    def __init__(self, sigma_m: float, tau_s: float, rng: random.Random) -> None:
        self._sigma_m, self._tau_s, self._rng = sigma_m, tau_s, rng
        self.north_m = rng.gauss(0.0, sigma_m)
        self.east_m = rng.gauss(0.0, sigma_m)

    def step(self, dt_s: float) -> None:
        """Wander for `dt_s`."""
        keep = math.exp(-dt_s / self._tau_s)
        kick_m = self._sigma_m * math.sqrt(1.0 - keep * keep)
        self.north_m = keep * self.north_m + self._rng.gauss(0.0, kick_m)
        self.east_m = keep * self.east_m + self._rng.gauss(0.0, kick_m)

    def degrees(self, lat_deg: float) -> tuple[float, float]:
        """The same in degrees of latitude and longitude, as SIM_GPS*_GL*TCH_X and _Y take it."""
        east = METRES_PER_DEGREE * math.cos(math.radians(lat_deg))
        return self.north_m / METRES_PER_DEGREE, self.east_m / east
