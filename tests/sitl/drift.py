"""How a GPS receiver wanders: a first-order Gauss-Markov offset on each horizontal axis.

With the same seed it is the offset of the built-in simulator's receiver
(echowing/sim/world/gps.py), so that both fly the same flight. The autopilot's own filter smooths
it: here it has no lag.
"""

import math
import random

# Of a degree of latitude, and of one of longitude at the equator, mean of WGS-84.
METRES_PER_DEGREE = 111_195.0
STEP_S = 0.02  # the simulator's: another one would draw other numbers


class Drift:
    """The offset of one receiver, metres north and east; it starts in the steady state."""

    def __init__(self, sigma_m: float, tau_s: float, rng: random.Random) -> None:
        self._rng = rng
        self._keep = math.exp(-STEP_S / tau_s)
        self._kick_m = sigma_m * math.sqrt(1.0 - self._keep * self._keep)
        self.north_m = rng.gauss(0.0, sigma_m)
        self.east_m = rng.gauss(0.0, sigma_m)
        # The simulator asks for the offset at its start, which takes a number for each axis.
        rng.gauss(0.0, 0.0)
        rng.gauss(0.0, 0.0)

    @classmethod
    def of_receiver(cls, sigma_m: float, tau_s: float, seed: int, name: str) -> "Drift":
        """That of the simulator's receiver, "leader" or "follower 0"."""
        return cls(sigma_m, tau_s, random.Random(f"{seed} gps {name}"))

    def step(self, dt_s: float) -> None:
        """Wander for `dt_s`, a multiple of the simulator's step."""
        for _ in range(round(dt_s / STEP_S)):
            self.north_m = self._keep * self.north_m + self._rng.gauss(0.0, self._kick_m)
            self.east_m = self._keep * self.east_m + self._rng.gauss(0.0, self._kick_m)

    def degrees(self, lat_deg: float) -> tuple[float, float]:
        """The same in degrees of latitude and longitude, as SIM_GPS*_GL*TCH_X and _Y take it."""
        east = METRES_PER_DEGREE * math.cos(math.radians(lat_deg))
        return self.north_m / METRES_PER_DEGREE, self.east_m / east
