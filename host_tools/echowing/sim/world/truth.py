"""Draws what is true in one flight: each follower's sonar, each vehicle's receiver and barometer.

The product believes what the sonar file says, and what `flight` takes for granted of receivers. The
truth lies around that, anew for each seed and each vehicle, and a scenario's keys can set it.
"""

import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from echowing.flight.belief import Curve
from echowing.sim.world.gps import Errors
from echowing.sim.world.sonar import LEVER_ARM_M, TrueSonar
from echowing.sonar_file import NINE_OF_TEN_SIGMAS, SonarFile

if TYPE_CHECKING:
    from echowing.sim.scenario import GpsSection, SonarSection

# Of a beam whose two ends a scenario gives: from here on it narrows, and here it is at its far end.
NEAR_M, FAR_M = 2.0, 4.6
# No beam, and no edge of one, is narrower.
LEAST_DEG = 1.0

Stream = Callable[[str], random.Random]


class _Draw:
    """Draws each value from a stream of its own."""

    def __init__(self, chance: Stream, spread: float) -> None:
        self._chance, self._spread = chance, spread

    def place(self, name: str) -> float:
        """Where between the two values that a file gives: 0 the least, 1 the most."""
        off = self._chance(name).gauss(0.0, 1.0)
        return 0.5 + 0.5 * self._spread * off / NINE_OF_TEN_SIGMAS

    def between(self, name: str, pair: tuple[float, float], least: float = 0.0) -> float:
        """A value from between the two that a file gives, or beyond; never less than `least`."""
        return max(least, pair[0] + self.place(name) * (pair[1] - pair[0]))

    def around(self, name: str, value: float) -> float:
        """A value whose logarithm is off by the spread."""
        return value * math.exp(self._spread * self._chance(name).gauss(0.0, 1.0))


def true_sonar(file: SonarFile, given: "SonarSection", chance: Stream) -> TrueSonar:
    """A follower's sonar: drawn around what the file says, as far as nothing else is given."""
    draw = _Draw(chance, given.spread)
    wild, late = draw.between("wild share", file.wild_share), draw.between("late", file.late_share)
    heard = draw.place("share")
    drawn = TrueSonar(
        heard=Curve(
            file.heard.range_m,
            tuple(
                min(1.0, max(0.0, least + heard * (most - least)))
                for least, most in zip(file.heard.least, file.heard.most, strict=True)
            ),
        ),
        half_rad=_beam(file, given, draw),
        edge_rad=math.radians(draw.between("edge", file.beam.edge_deg, LEAST_DEG)),
        noise_m=draw.between("noise m", file.noise_m),
        wild_share=min(1.0, wild + late) if given.late_share is None else wild,
        late_share=given.late_share or 0.0,
        stock_m=draw.between("stock", file.stock_to_m, file.shortest_m),
        foil_m=draw.between("foil", file.foil_to_m, file.shortest_m),
        inset_m=draw.between("inset", file.inset_m, file.boom_m + LEVER_ARM_M),
        boom_m=file.boom_m,
        deaf_share=given.deaf_share,
        deaf_s=given.deaf_s,
        tone_share=given.tone_share,
        left=Curve(file.throttle.throttle, file.throttle.share),
    )
    told = {
        "heard": None if given.heard_share is None else Curve((0.0,), (given.heard_share,)),
        "noise_m": given.noise_m,
        "wild_share": given.wild_share,
        "stock_m": given.heard_to_m,
        "foil_m": given.heard_to_m,
        "inset_m": given.inset_m,
    }
    return replace(drawn, **{key: value for key, value in told.items() if value is not None})  # type: ignore[arg-type]


def _beam(file: SonarFile, given: "SonarSection", draw: _Draw) -> Curve:
    place = draw.place("beam")
    columns = zip(file.beam.narrowest_deg, file.beam.widest_deg, strict=True)
    half_deg = [max(LEAST_DEG, low + place * (high - low)) for low, high in columns]
    drawn = Curve(file.beam.range_m, tuple(math.radians(one) for one in half_deg))
    near_deg, far_deg = given.beam_near_deg, given.beam_far_deg
    if near_deg is None and far_deg is None:
        return drawn
    near_rad = drawn.at(NEAR_M) if near_deg is None else math.radians(near_deg)
    far_rad = near_rad if far_deg is None else math.radians(far_deg)
    return Curve((NEAR_M, FAR_M), (near_rad, far_rad))


def true_errors(given: "GpsSection", chance: Stream) -> Errors:
    """How a vehicle's receiver and barometer err: drawn around what is given."""
    draw = _Draw(chance, given.spread)
    return Errors(
        sigma_m=draw.around("sigma", given.sigma_m),
        tau_s=draw.around("tau", given.tau_s),
        height_sigma_m=draw.around("height sigma", given.vertical_sigma_m),
        height_tau_s=draw.around("height tau", given.vertical_tau_s),
        receiver_height_sigma_m=draw.around(
            "receiver height sigma", given.receiver_vertical_sigma_m
        ),
        velocity_sigma_mps=draw.around("velocity sigma", given.velocity_sigma_mps),
        follows_s=draw.around("follows", given.follows_s),
        height_follows_s=draw.around("height follows", given.height_follows_s),
        step_m=given.step_m,
        step_every_s=given.step_every_s if given.step_m > 0.0 else math.inf,
        multipath_m=given.multipath_m,
        multipath_s=given.multipath_s,
    )
