"""Wind at one vehicle: a steady part, and gusts that come and go.

Gusts are the Dryden model's at low altitude (MIL-F-8785C, 3.7.3): their lengths and the share of
the vertical ones follow from the height, and they pass with the mean wind. Each axis is a
first-order Gauss-Markov process, which is the model's own form along the wind. Vehicles have gusts
of their own: a formation is a few metres wide and would share most of them, so this is harsher.

ArduPilot's SITL is no measure for gusts: its turbulence (SIM_WIND_TURB, SIM_Aircraft.cpp) takes a
new direction in every physics step, so that a vehicle feels next to nothing of it.
"""

import math
import random

from echowing.geo import Ned

METRES_PER_FOOT = 0.3048
# The specification's low-altitude model ends here, feet.
LOWEST_FT, HIGHEST_FT = 10.0, 1000.0


class Wind:
    """Velocity of the air at one vehicle.

    `speed_mps` and `from_rad` (the bearing it comes from, 0 is north): the steady part;
    `turbulence`: standard deviation of the horizontal gusts, an axis, as a share of the speed;
    `height_m`: above the ground. Starts in the steady state.
    """

    def __init__(
        self,
        speed_mps: float,
        from_rad: float,
        turbulence: float,
        height_m: float,
        rng: random.Random,
    ) -> None:
        self._rng = rng
        self._steady = (-speed_mps * math.cos(from_rad), -speed_mps * math.sin(from_rad))
        height_ft = min(max(height_m / METRES_PER_FOOT, LOWEST_FT), HIGHEST_FT)
        shape = 0.177 + 0.000823 * height_ft
        level_m = METRES_PER_FOOT * height_ft / shape**1.2
        upright_m = METRES_PER_FOOT * height_ft
        passing_mps = speed_mps or 1.0  # without wind there are no gusts either
        self._taus_s = (level_m / passing_mps, level_m / passing_mps, upright_m / passing_mps)
        sigma_mps = turbulence * speed_mps
        self._sigmas_mps = (sigma_mps, sigma_mps, sigma_mps * shape**0.4)
        north, east, down = (rng.gauss(0.0, sigma) for sigma in self._sigmas_mps)
        self._gust: Ned = (north, east, down)
        self._dt_s = -1.0
        self._shares: tuple[tuple[float, float], ...] = ()

    @property
    def velocity_ned_mps(self) -> Ned:
        """The air's velocity now."""
        north, east, down = self._gust
        return self._steady[0] + north, self._steady[1] + east, down

    def step(self, dt_s: float) -> Ned:
        """The air's velocity after `dt_s` more seconds."""
        if dt_s != self._dt_s:
            self._prepare(dt_s)
        gauss = self._rng.gauss
        north, east, down = self._gust
        (keep_n, kick_n), (keep_e, kick_e), (keep_d, kick_d) = self._shares
        self._gust = (
            keep_n * north + gauss(0.0, kick_n),
            keep_e * east + gauss(0.0, kick_e),
            keep_d * down + gauss(0.0, kick_d),
        )
        return self.velocity_ned_mps

    def _prepare(self, dt_s: float) -> None:
        """What a step keeps of each axis's gust, and how much it adds."""
        self._dt_s = dt_s
        keeps = [math.exp(-dt_s / tau_s) for tau_s in self._taus_s]
        self._shares = tuple(
            (keep, sigma * math.sqrt(1.0 - keep * keep))
            for keep, sigma in zip(keeps, self._sigmas_mps, strict=True)
        )
