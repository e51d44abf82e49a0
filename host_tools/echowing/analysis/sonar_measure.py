"""A sonar file out of counted readings: on the bench, or in flight."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

from echowing.analysis.sonar_fit import (
    Between,
    Fit,
    Tally,
    dependence,
    fitted,
    share_between,
)
from echowing.errors import EchowingError
from echowing.sonar_file import NINE_OF_TEN_SIGMAS, Legs, SonarFile

# Nearer to where the leader is than this a reading is of the leader.
GATE_M = 0.5
# Of two readings of something else in a row, these are of the same: an echo, and nothing wild.
ALIKE_M = 0.1
# As far as half of what is heard near by is heard, the leader counts as heard.
HALF_AS_MUCH = 0.5
# Readings come in whole centimetres. Two thirds of a normal distribution are within the second, in
# standard deviations.
LEAST_NOISE_M, SIXTH_SIGMAS = 0.003, 0.967
# Nothing is known more exactly of a place that a tape has measured.
TAPE_M = 0.02
# Further than the last distance this is not known.
BEYOND_SHARE = 1.05
# Nearer to the axis than this all of the beam hears.
NEAR_DEG = 4.0
# How well the scatter of ranges in flight is known, as a factor.
NOISE_UNSURE = 1.3
# More readings of the same other thing than these are worth a word.
STEADY_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Conditions:
    """What was measured: the leader's legs, the throttle of hover; and for which slot."""

    legs: Legs
    hover: float
    slot_m: float


@dataclass
class Readings:
    """Readings of a leader at one place and throttle; None: nothing was heard.

    separation_m: from centre to centre. inset_m: how much less it reads, as far as is known.
    """

    separation_m: float
    off_deg: float
    throttle: float
    runs: list[list[float | None]] = field(default_factory=list)
    inset_m: float = 0.2

    @property
    def all(self) -> list[float | None]:
        """Whatever came."""
        return [one for run in self.runs for one in run]

    @property
    def pings(self) -> int:
        """How many came."""
        return len(self.all)

    @property
    def of_leader_m(self) -> list[float]:
        """Readings of the leader."""
        return [one for one in self.all if one is not None and self._is_right(one)]

    @property
    def heard(self) -> int:
        """How many were of the leader."""
        return len(self.of_leader_m)

    @property
    def elsewhere(self) -> int:
        """How many were of anything else."""
        return sum(one is not None and not self._is_right(one) for one in self.all)

    @property
    def steady(self) -> int:
        """How many of those were as the one before."""
        return sum(
            a is not None and b is not None and not self._is_right(b) and abs(a - b) <= ALIKE_M
            for run in self.runs
            for a, b in pairwise(run)
        )

    def hits(self) -> list[list[bool]]:
        """Whether each was of the leader."""
        return [[one is not None and self._is_right(one) for one in run] for run in self.runs]

    def _is_right(self, reading_m: float) -> bool:
        return abs(reading_m - (self.separation_m - self.inset_m)) <= GATE_M

    def as_dict(self) -> dict[str, Any]:
        """For the JSON document."""
        return {
            "separation_m": self.separation_m,
            "angle_deg": self.off_deg,
            "throttle": self.throttle,
            "pings": self.pings,
            "heard": self.heard,
            "elsewhere": self.elsewhere,
            "raw_m": self.runs,
        }


@dataclass(frozen=True)
class Measured:
    """A sonar file that was measured, and how: the fit at one throttle, and what to know of it."""

    file: SonarFile
    fit: Fit
    throttle: float
    notes: tuple[str, ...]


def measured_sonar(
    readings: Sequence[Readings], base: SonarFile, conditions: Conditions
) -> Measured:
    """The sonar file of a bench; all that cannot be measured there is as in `base`.

    Raises EchowingError where too little was heard to say anything.
    """
    hovering = [one for one in readings if one.throttle == conditions.hover and one.pings]
    fit, alike = _fit(hovering)
    inset_m = _inset_m(hovering)
    middle_m = _middle(inset_m)
    values = {
        "inset_m": inset_m,
        "noise_m": _noise_m(hovering),
        **_wrong(hovering, alike),
        "heard": _heard(fit, middle_m),
        "beam": _beam(fit, middle_m),
        **_reaches(fit, base, conditions, middle_m),
        **_throttles(readings, conditions),
    }
    said = _said("bench", hovering, conditions.legs) + f", throttle {conditions.hover:g}"
    other = "stock_to_m" if conditions.legs == "foil" else "foil_to_m"
    source = {other: f"guess: in the proportion of thesis Table 5; {said}"}
    file = _changed(base, values, said, source)
    return Measured(file, fit, conditions.hover, _notes(hovering))


def flown_sonar(
    readings: Sequence[Readings], base: SonarFile, legs: Legs, noise_m: float | None
) -> Measured:
    """The sonar file of a flight: where the leader was is known from the estimate.

    So reach and inset are as in `base`, and so is how wide the beam may be. noise_m: of a range,
    where it is known.
    """
    flown = [one for one in readings if one.pings]
    fit, alike = _fit(flown)
    inset_m = _middle(base.inset_m)
    values: dict[str, Any] = {
        **_wrong(flown, alike),
        "heard": _with_far(_heard(fit, inset_m), base),
        "beam": _as_narrow(_beam(fit, inset_m), base),
    }
    if noise_m is not None:
        values["noise_m"] = (round(noise_m / NOISE_UNSURE, 4), round(noise_m * NOISE_UNSURE, 4))
    file = _changed(base, values, _said("flight", flown, legs), {})
    return Measured(file, fit, flown[0].throttle, ())


def _fit(readings: Sequence[Readings]) -> tuple[Fit, float]:
    """The fit, and how alike the readings are."""
    alike = dependence(run for one in readings for run in one.hits())
    fit = fitted(
        (Tally(one.separation_m, one.off_deg, one.pings, one.heard) for one in readings), alike
    )
    if not any(at.half_deg is not None for at in fit.at):
        raise EchowingError("the leader was hardly heard at any distance: nothing can be fitted")
    return fit, alike


def _said(how: str, readings: Sequence[Readings], legs: Legs) -> str:
    pings = sum(one.pings for one in readings)
    return f"measured: {how}, {datetime.now(UTC):%d %B %Y}, {pings} pings at {legs} legs"


def _changed(
    base: SonarFile, values: dict[str, Any], said: str, source: dict[str, str]
) -> SonarFile:
    """The base with these values, and where they come from."""
    sources = {**base.source, **dict.fromkeys(_keys(values), said), **source}
    how = said.partition(": ")[2].partition(",")[0]
    title = f"{base.title.partition(' (')[0]} ({how})"
    return SonarFile.model_validate(
        {**base.model_dump(), **values, "source": sources, "title": title}
    )


def _with_far(heard: dict[str, tuple[float, ...]], base: SonarFile) -> dict[str, tuple[float, ...]]:
    """What was flown, and beyond it what is believed."""
    far = [n for n, range_m in enumerate(base.heard.range_m) if range_m > heard["range_m"][-1]]
    believed = {name: getattr(base.heard, name) for name in heard}
    return {name: (*values, *(believed[name][n] for n in far)) for name, values in heard.items()}


def _as_narrow(beam: dict[str, Any], base: SonarFile) -> dict[str, Any]:
    """A beam as narrow as it was flown, and as wide as is believed.

    In flight the axis is known only to some degrees, which narrows what is fitted.
    """
    widest = base.belief().widest_rad
    wide_deg = [math.degrees(widest.at(range_m)) for range_m in beam["range_m"]]
    narrow_deg = beam["narrowest_deg"]
    pairs = zip(narrow_deg, wide_deg, strict=True)
    return {**beam, "widest_deg": tuple(round(max(pair), 1) for pair in pairs)}


def _keys(values: dict[str, Any]) -> list[str]:
    return [
        f"{key}.{inner}" if isinstance(value, dict) else key
        for key, value in values.items()
        for inner in (value if isinstance(value, dict) else (key,))
    ]


def _inset_m(readings: Iterable[Readings]) -> Between:
    """How much less it reads than the distance between the centres."""
    mean_m = statistics.fmean(one.separation_m - m for one in readings for m in one.of_leader_m)
    return round(max(0.0, mean_m - TAPE_M), 3), round(max(0.0, mean_m + TAPE_M), 3)


def _noise_m(readings: Iterable[Readings]) -> Between:
    """Standard deviation of a range about the middle of its own place.

    By the middle two thirds: a wild reading that happens to be near the leader does not count.
    """
    off_m = [m - statistics.median(one.of_leader_m) for one in readings for m in one.of_leader_m]
    sixths = statistics.quantiles(off_m, n=6) if len(off_m) > 1 else [0.0] * 5
    sigma_m = max(LEAST_NOISE_M, (sixths[-1] - sixths[0]) / (2.0 * SIXTH_SIGMAS))
    unsure = NINE_OF_TEN_SIGMAS / math.sqrt(max(1, len(off_m)))
    return round(sigma_m / (1.0 + unsure), 4), round(sigma_m * (1.0 + unsure), 4)


def _wrong(readings: Sequence[Readings], alike: float) -> dict[str, Between]:
    pings = sum(one.pings for one in readings)
    steady = sum(one.steady for one in readings)
    wild = sum(one.elsewhere for one in readings) - steady
    return {
        "wild_share": _rounded(share_between(wild, pings)),
        "late_share": _rounded(share_between(steady, pings, alike)),
    }


def _heard(fit: Fit, inset_m: float) -> dict[str, tuple[float, ...]]:
    return {
        "range_m": tuple(round(at.range_m - inset_m, 3) for at in fit.at),
        "least": tuple(round(at.share_between[0], 3) for at in fit.at),
        "most": tuple(round(at.share_between[1], 3) for at in fit.at),
    }


def _beam(fit: Fit, inset_m: float) -> dict[str, tuple[float, ...]]:
    told = [at for at in fit.at if at.half_deg is not None]
    return {
        "range_m": tuple(round(at.range_m - inset_m, 3) for at in told),
        "narrowest_deg": tuple(at.half_between_deg[0] for at in told),
        "widest_deg": tuple(at.half_between_deg[1] for at in told),
        "edge_deg": fit.edge_between_deg,
    }


def _reaches(
    fit: Fit, base: SonarFile, conditions: Conditions, inset_m: float
) -> dict[str, Between]:
    """How far a leader with these legs is heard, and one with others in proportion."""
    needed = HALF_AS_MUCH * max(at.share for at in fit.at)
    good = [at.range_m for at in fit.at if at.share >= needed]
    farthest_m = max(good) - inset_m
    beyond = [at.range_m - inset_m for at in fit.at if at.range_m > max(good)]
    most_m = beyond[0] if beyond else BEYOND_SHARE * farthest_m
    mine = (round(farthest_m, 3), round(most_m, 3))
    is_foil = conditions.legs == "foil"
    ratio = sum(base.stock_to_m) / sum(base.foil_to_m)
    others = tuple(round((ratio if is_foil else 1.0 / ratio) * one, 3) for one in mine)
    names = ("foil_to_m", "stock_to_m") if is_foil else ("stock_to_m", "foil_to_m")
    return {names[0]: mine, names[1]: (others[0], others[1])}


def _throttles(readings: Sequence[Readings], conditions: Conditions) -> dict[str, Any]:
    """What each throttle leaves of the share heard in hover, near the axis."""
    shares = {}
    for throttle in sorted({one.throttle for one in readings}):
        near = [one for one in readings if one.throttle == throttle and one.off_deg <= NEAR_DEG]
        shares[throttle] = sum(one.heard for one in near) / max(1, sum(one.pings for one in near))
    hover = shares[conditions.hover]
    left = tuple(round(min(1.0, share / hover), 3) for share in shares.values())
    return {"throttle": {"throttle": tuple(shares), "share": left}}


def _notes(readings: Sequence[Readings]) -> tuple[str, ...]:
    steady = [one for one in readings if one.steady > STEADY_SHARE * one.pings]
    return tuple(
        f"At {one.separation_m:g} m, {one.off_deg:g} degrees off, something else echoes steadily: "
        "clear the place, and measure again."
        for one in steady[:3]
    )


def _middle(pair: Between) -> float:
    return (pair[0] + pair[1]) / 2.0


def _rounded(pair: Between) -> Between:
    return round(pair[0], 4), round(pair[1], 4)
