"""A sonar file out of counted readings: on the bench, or in flight."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import accumulate, pairwise
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
# Where so many would hear the leader, what a throttle leaves of them is known to a twentieth.
TELLS_A_THROTTLE = 300.0
# A share that is known no better than this is none: what is believed stays.
UNTOLD = 0.5
# In the file's sources: what was measured, and what a flight leaves as it was.
MEASURED, KEPT = "measured: ", "kept: "
WHY_NO_INSET = (
    "a flight does not tell it, as the receivers differ by a metre, and the place of the leader is "
    "known by the sonar itself"
)
WHY_NO_LIMIT = "a flight does not tell it, as a range from there on counts as none"
WHY_NO_NOISE = "too few ranges came in a row to tell it"
WHY_NO_WIDTH = "in flight the axis is known to some degrees only"
# Of these nobody expects a flight to tell them: they stand in the file, and not in the notes.
AS_EVER = {
    "boom_m": "a flight does not tell it, as inset_m",
    "shortest_m": "nobody flies so near",
    "rate_hz": "a flight does not tell it, as radios lose some",
}


@dataclass(frozen=True, slots=True)
class Conditions:
    """What was measured: the leader's legs, the throttle of hover; and for which slot."""

    legs: Legs
    hover: float
    slot_m: float


@dataclass(frozen=True, slots=True)
class Flown:
    """What is known of a flight: the leader's legs, why no throttle is, empty where it is.

    noise_m: standard deviation of a range, where it is known. legs_told: false where nobody has
    said which legs.
    """

    legs: Legs
    noise_m: float | None
    why_no_throttle: str = ""
    legs_told: bool = True


@dataclass
class Readings:
    """Readings of a leader at one place and throttle; None: nothing was heard.

    throttle: NaN where it is not known. separation_m: from centre to centre. inset_m: how much less
    it reads, as far as is known.
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
    farthest_m, far_m = _half_heard(fit)
    reaches = _reaches(farthest_m, far_m, base, conditions.legs, middle_m)
    further = _further(base, reaches, conditions.legs)
    values = {
        "inset_m": inset_m,
        "noise_m": _noise_m(hovering),
        **_wrong(hovering, alike),
        "heard": _heard(fit, middle_m, further),
        "beam": _beam(fit, middle_m, further),
        **reaches,
        **_throttles(readings, conditions),
    }
    said = _said("bench", hovering, conditions.legs) + f", throttle {conditions.hover:g}"
    file = _changed(base, values, said, _in_proportion(reaches, conditions.legs, said))
    notes = (*_notes(hovering), *_of_its_end(farthest_m, far_m, base.reach_m + middle_m))
    return Measured(file, fit, conditions.hover, notes)


def flown_sonar(readings: Sequence[Readings], base: SonarFile, how: Flown) -> Measured:
    """The sonar file of a flight: where the leader was is known from the estimate.

    So how wide the beam may be is as in `base`, and so is all that the flight does not tell: the
    file's sources and the notes say what, and why.
    """
    flown = [one for one in readings if one.pings]
    fit, alike = _fit(flown)
    inset_m = _middle(base.inset_m)
    reaches, why_no_reach = _flown_reaches(fit, base, how.legs, inset_m)
    throttles, why_no_throttle = _flown_throttles(flown, fit, base, how)
    further = _further(base, reaches, how.legs)
    ends_m = reaches.get("foil_to_m", base.foil_to_m)[1] if reaches else math.inf
    told = _told(fit)
    heard = _heard(told, inset_m, further)
    with_far = _with_far(heard, base, ends_m)
    values: dict[str, Any] = {
        **_wrong(flown, alike),
        "heard": with_far,
        "beam": _as_narrow(_beam(told, inset_m, further), base),
        **reaches,
        **throttles,
    }
    if how.noise_m is not None:
        least_m, most_m = how.noise_m / NOISE_UNSURE, how.noise_m * NOISE_UNSURE
        values["noise_m"] = (round(least_m, 4), round(most_m, 4))
    kept = {"inset_m": WHY_NO_INSET, "reach_m": WHY_NO_LIMIT, "beam.widest_deg": WHY_NO_WIDTH}
    kept |= {} if reaches else dict.fromkeys(("foil_to_m", "stock_to_m"), why_no_reach)
    kept |= {"noise_m": WHY_NO_NOISE} if how.noise_m is None else {}
    # What of a table was flown, and what of it is as it was.
    in_part = dict.fromkeys(("throttle.throttle", "throttle.share"), why_no_throttle)
    if not throttles:
        kept, in_part = kept | in_part, {}
    beyond_m = with_far["range_m"][len(heard["range_m"]) :]
    if beyond_m:
        in_part |= dict.fromkeys(("heard.least", "heard.most"), f"from {beyond_m[0]:g} m on")
    said = _said("flight", flown, how.legs) + ("" if how.legs_told else " (assumed)")
    reasons = {**kept, **AS_EVER}
    sources = {key: _kept(base.source.get(key, ""), why) for key, why in reasons.items()}
    sources |= {key: f"{said}; {KEPT}{where}" for key, where in in_part.items()}
    sources |= _in_proportion(reaches, how.legs, said)
    notes = tuple(f"{key} is as it was: {why}" for key, why in kept.items() if "share" not in key)
    return Measured(_changed(base, values, said, sources), told, flown[0].throttle, notes)


def _told(fit: Fit) -> Fit:
    """The fit where readings enough tell it: a flight has few far from its slot."""
    told = [at for at in fit.at if at.share_between[1] - at.share_between[0] <= UNTOLD]
    if not any(at.half_deg is not None for at in told):
        raise EchowingError("too few readings at any distance to tell how many hear: fly longer")
    return replace(fit, at=tuple(told))


def _kept(source: str, why: str) -> str:
    """Where a value comes from that a flight has left as it was."""
    before = source.partition(KEPT)[0].rstrip("; ")
    return f"{before}; {KEPT}{why}" if before else f"{KEPT}{why}"


def _flown_reaches(
    fit: Fit, base: SonarFile, legs: Legs, inset_m: float
) -> tuple[dict[str, Between], str]:
    """How far a leader is heard, where the flight went that far; else nothing, and why.

    As on the bench; but a share that few readings tell is none, and one that is heard as far as
    anybody flew tells no end.
    """
    needed = HALF_AS_MUCH * max(at.share_between[0] for at in fit.at)
    farthest_m = max(at.range_m for at in fit.at if at.share_between[0] >= needed)
    far = [at.range_m for at in fit.at if at.share_between[1] < needed and at.range_m > farthest_m]
    if far:
        return _reaches(farthest_m, far[0], base, legs, inset_m), ""
    return {}, f"no end of it was flown to; heard at ranges of {farthest_m - inset_m:.1f} m"


def _flown_throttles(
    readings: Sequence[Readings], fit: Fit, base: SonarFile, how: Flown
) -> tuple[dict[str, Any], str]:
    """What each throttle that was flown leaves of the share heard at the usual one.

    Beside what is heard on average at the same places; and which throttles are as they were.
    Nothing, and why, where only one was flown.
    """
    if how.why_no_throttle:
        return {}, how.why_no_throttle
    foretold: dict[float, float] = {}
    for one in (one for one in readings if math.isfinite(one.throttle)):
        share = one.pings * fit.share(one.separation_m, one.off_deg)
        foretold[one.throttle] = foretold.get(one.throttle, 0.0) + share
    enough = sorted(throttle for throttle, count in foretold.items() if count >= TELLS_A_THROTTLE)
    if len(enough) < 2:
        at = " and ".join(f"{one:.0%}" for one in enough) or "no one throttle"
        return {}, f"too little was heard at other throttles than {at}"
    heard = {
        throttle: sum(one.heard for one in readings if one.throttle == throttle)
        / foretold[throttle]
        for throttle in enough
    }
    hover = heard[max(enough, key=lambda throttle: foretold[throttle])]
    left = {throttle: round(min(1.0, share / hover), 3) for throttle, share in heard.items()}
    believed = zip(base.throttle.throttle, base.throttle.share, strict=True)
    left |= {one: share for one, share in believed if not enough[0] <= one <= enough[-1]}
    told = {"throttle": tuple(sorted(left)), "share": tuple(left[one] for one in sorted(left))}
    return {"throttle": told}, f"under {enough[0]:.0%} and over {enough[-1]:.0%}"


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
    return f"{MEASURED}{how}, {datetime.now(UTC):%d %B %Y}, {pings} pings at {legs} legs"


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


def _with_far(
    heard: dict[str, tuple[float, ...]], base: SonarFile, ends_m: float
) -> dict[str, tuple[float, ...]]:
    """What was flown, and beyond it what is believed, up to where the leader is heard no more."""
    last_m = heard["range_m"][-1]
    far = [n for n, range_m in enumerate(base.heard.range_m) if last_m < range_m < ends_m]
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


def _heard(fit: Fit, inset_m: float, further: float) -> dict[str, tuple[float, ...]]:
    return {
        "range_m": tuple(round(further * (at.range_m - inset_m), 3) for at in fit.at),
        "least": tuple(round(at.share_between[0], 3) for at in fit.at),
        "most": tuple(round(at.share_between[1], 3) for at in fit.at),
    }


def _beam(fit: Fit, inset_m: float, further: float) -> dict[str, tuple[float, ...]]:
    told = [at for at in fit.at if at.half_deg is not None]
    widest_deg = [at.half_between_deg[1] for at in told]
    if further != 1.0:  # the belief does not take the widest beam back: nowhere wider further out
        widest_deg = list(accumulate(widest_deg[::-1], max))[::-1]
    return {
        "range_m": tuple(round(further * (at.range_m - inset_m), 3) for at in told),
        "narrowest_deg": tuple(at.half_between_deg[0] for at in told),
        "widest_deg": tuple(widest_deg),
        "edge_deg": fit.edge_between_deg,
    }


def _further(base: SonarFile, reaches: dict[str, Between], legs: Legs) -> float:
    """How many times as far a leader with foil is heard as one with these legs.

    A file's distances are those of foil; `SonarFile.belief` takes them back by the same factor.
    """
    if legs == "foil":
        return 1.0
    to_m = {"foil_to_m": base.foil_to_m, "stock_to_m": base.stock_to_m} | reaches
    return to_m["foil_to_m"][0] / to_m["stock_to_m"][0]


def _in_proportion(reaches: dict[str, Between], legs: Legs, said: str) -> dict[str, str]:
    """The sources of what these legs tell of others."""
    other = _other(legs)
    sources = {other: f"guess: in the proportion of --base; {said}"} if other in reaches else {}
    if legs == "stock":
        moved = f"{said}, further for foil, as foil_to_m is to stock_to_m"
        sources |= dict.fromkeys(("heard.range_m", "beam.range_m"), moved)
    return sources


def _other(legs: Legs) -> str:
    return "stock_to_m" if legs == "foil" else "foil_to_m"


def _half_heard(fit: Fit) -> tuple[float, float | None]:
    """The farthest range where half of the best is heard, and the next one; None: there is none."""
    needed = HALF_AS_MUCH * max(at.share for at in fit.at)
    farthest_m = max(at.range_m for at in fit.at if at.share >= needed)
    return farthest_m, next((at.range_m for at in fit.at if at.range_m > farthest_m), None)


def _reaches(
    farthest_m: float, far_m: float | None, base: SonarFile, legs: Legs, inset_m: float
) -> dict[str, Between]:
    """How far a leader with these legs is heard, and one with others in proportion.

    One with others as well as it was measured before. farthest_m: from centre to centre, there it
    is heard; far_m: there no more.
    """
    least_m = farthest_m - inset_m
    most_m = BEYOND_SHARE * least_m if far_m is None else far_m - inset_m
    mine = (round(least_m, 3), round(most_m, 3))
    other = _other(legs)
    reaches = {f"{legs}_to_m": mine}
    if not base.source.get(other, "").startswith(MEASURED):
        ratio = sum(getattr(base, other)) / sum(getattr(base, f"{legs}_to_m"))
        reaches[other] = (round(ratio * mine[0], 3), round(ratio * mine[1], 3))
    return reaches


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


def _of_its_end(farthest_m: float, far_m: float | None, counts_to_m: float) -> tuple[str, ...]:
    """What to know of how far it hears; all from centre to centre."""
    hears = f"it hears the leader at {farthest_m:g} m"
    if farthest_m >= counts_to_m:
        return (
            f"Although {hears}, no range counts from {counts_to_m:.1f} m on: raise the file's "
            "reach_m, if the slot is to be further.",
        )
    if far_m is not None:
        return ()
    return (
        f"As {hears}, the farthest distance, nobody knows how far it hears: measure further, if "
        "the slot is to be further.",
    )


def _middle(pair: Between) -> float:
    return (pair[0] + pair[1]) / 2.0


def _rounded(pair: Between) -> Between:
    return round(pair[0], 4), round(pair[1], 4)
