"""How well a follower kept its place: one definition for simulated flights and for real logs.

The *separation error* is separation minus wanted separation (thesis 4.3, Fig. 41: positive is too
far). The *position error* is the horizontal vector from the slot to the follower, split in the
leader's course frame into forward and right as in Gray's table (thesis Table 10). RMSD and DRMS
are sqrt(mean(e^2)) and sigma is the population standard deviation, so that
RMSD^2 = sigma^2 + mean^2 holds to the last digit; the thesis's own figures do not all obey that.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Flight, Floats
from echowing.errors import EchowingError

# A reading this near to the distance between the two positions is a sight of the leader. Generous:
# in real logs two receivers drift apart by metres (0.8 m an axis each in the simulator).
SIGHT_TOLERANCE_M = 2.0
# The approach ends where a follower has first come this near to its slot.
APPROACHED_M = 1.0
STEADY_S = 1.0
# A sonar that has its leader hears so much of a second: one that hears four pings of ten, mostly.
# One reading, or two, may be anything.
HEARD_SHARE, LEAST_READINGS = 0.3, 3
# A reading is up to 0.1 s old, and a leader that turns round is 0.4 m elsewhere by then.
FOUND_M = 0.5
# One sweep of the figure 8 takes 3.6 s (thesis Appendix A: 12 points, 0.3 s each): after more
# than five of them in vain the leader is gone.
DEAD_LOCK_WINDOW_S = 20.0
AT_END_S = 5.0  # several times as long as a guard backs off from one wild reading


@dataclass(frozen=True)
class Metrics:
    """One flight in numbers; metres unless named otherwise. NaN: the flight does not tell.

    mean_abs_error_m: mean of |separation - wanted|, the thesis's "average position error".
    slot_error_m: mean horizontal distance follower to slot, Table 10's position error mean.
    forward_*, right_*: position error in the leader's course frame, right positive.
    seen_share: share of the samples with a sonar reading, 0 to 1.
    samples, left_out: how many moments the figures are made from, and how many had no positions.
    settle_s: seconds left out at the beginning. wanted_m: the separation that was wanted.
    """

    mean_separation_m: float
    mean_abs_error_m: float
    rmsd_m: float
    std_m: float
    min_separation_m: float
    max_separation_m: float
    slot_error_m: float
    forward_mean_m: float
    forward_sigma_m: float
    forward_drms_m: float
    right_mean_m: float
    right_sigma_m: float
    right_drms_m: float
    position_sigma_m: float
    position_drms_m: float
    seen_share: float
    samples: int
    left_out: int
    settle_s: float = 0.0
    wanted_m: float = math.nan

    def to_json(self) -> dict[str, float | int | None]:
        """The same as plain values, rounded to a tenth of a millimetre; None: unknown."""
        return {name: _plain(value) for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Spread:
    """One figure over several flights: mean, standard deviation, extremes, how many had it."""

    mean: float
    std: float
    lowest: float
    highest: float
    count: int


def approach_s(flight: Flight) -> float:
    """Time until the follower was first near its slot; 0 if it never was.

    One rule for simulated and for real flights: the figures describe how well a place is kept, and
    the approach depends only on the start. Near is within `APPROACHED_M` of the slot by positions,
    or of the wanted separation by the sonar for a second: two receivers that disagree by metres may
    have the follower off its slot for the whole of a good flight.
    """
    if len(flight.time_s) == 0:
        return 0.0
    away_m = np.linalg.norm((flight.follower_ned_m - flight.slot_ned_m)[:, :2], axis=1)
    placed = flight.time_s[away_m <= APPROACHED_M][:1]
    near_s = [*placed.tolist(), *_ranged_s(flight)]
    return float(min(near_s) - flight.time_s[0]) if near_s else 0.0


def _ranged_s(flight: Flight) -> list[float]:
    """The first moment from which on the sonar has the leader near its place for a second.

    Longer than any single echo of something else; empty where there is none.
    """
    off_m = np.abs(flight.sonar_m - flight.wanted_separation_m)
    first_s = _first_ranged_s(flight, off_m <= APPROACHED_M)
    return [] if first_s is None else [first_s]


def found_s(flight: Flight, inset_m: float) -> float | None:
    """After how long the sonar has had the true leader for a second; None: never.

    inset_m: how much less than the separation it reads.
    """
    off_m = flight.sonar_m + inset_m - flight.separation_m
    first_s = _first_ranged_s(flight, np.abs(off_m) <= FOUND_M)
    return None if first_s is None else first_s - float(flight.time_s[0])


def within_s(flight: Flight, distance_m: float) -> float | None:
    """After how long the two have been so near for a second; None: never."""
    near = flight.separation_m <= distance_m
    first_s = _first_steady_s(flight, near, lambda second: bool(near[second].all()))
    return None if first_s is None else first_s - float(flight.time_s[0])


def _first_ranged_s(flight: Flight, right: NDArray[np.bool_]) -> float | None:
    """From when on all of a second's readings are right; it may hear only some of its pings."""
    heard = np.isfinite(flight.sonar_m)

    def has_it(second: slice) -> bool:
        readings = heard[second]
        enough = readings.sum() >= LEAST_READINGS and readings.mean() >= HEARD_SHARE
        return bool(enough and right[second][readings].all())

    return _first_steady_s(flight, right, has_it)


def _first_steady_s(
    flight: Flight, begins: NDArray[np.bool_], holds: Callable[[slice], bool]
) -> float | None:
    """The first moment at which something begins and then holds for a second; None: never."""
    ends = np.searchsorted(flight.time_s, flight.time_s + STEADY_S, side="right")
    for first in np.flatnonzero(begins).tolist():
        last = int(ends[first])
        if last < len(begins) and holds(slice(first, last)):
            return float(flight.time_s[first])
    return None


def by_sonar(flight: Flight, settle_s: float = 0.0) -> Metrics | None:
    """The separation as the sonar measured it; None: no reading after `settle_s`.

    From centre to centre: its inset more than it reads. Only while it sees.
    """
    settled = _settled(flight, settle_s)
    known = settled & np.isfinite(flight.sonar_m)
    if not known.any():
        return None
    seen = float(known.sum() / settled.sum())
    separation_m = flight.sonar_m[known] + flight.sonar_inset_m
    return of_separation(separation_m, flight.wanted_separation_m, settle_s, seen)


def by_estimate(flight: Flight, settle_s: float = 0.0) -> Metrics | None:
    """The separation as the ground tool estimated it; None: it had learnt nothing of the receivers.

    By the vehicles' positions, corrected by the disagreement that the sonar has shown.
    """
    if flight.estimated_m is None:
        return None
    known = _settled(flight, settle_s) & np.isfinite(flight.estimated_m)
    if not known.any():
        return None
    return of_separation(flight.estimated_m[known], flight.wanted_separation_m, settle_s)


def of_separation(
    separation_m: Floats, wanted_m: float, settle_s: float, seen_share: float = math.nan
) -> Metrics:
    """Figures of separations alone, (n,) and all known; nothing is said of the place."""
    error_m = separation_m - wanted_m
    return Metrics(
        mean_separation_m=float(separation_m.mean()),
        mean_abs_error_m=float(np.abs(error_m).mean()),
        rmsd_m=_root_mean_square(error_m),
        std_m=float(separation_m.std()),
        min_separation_m=float(separation_m.min()),
        max_separation_m=float(separation_m.max()),
        **dict.fromkeys(_OF_PLACE, math.nan),
        seen_share=seen_share,
        samples=len(separation_m),
        left_out=0,
        settle_s=settle_s,
        wanted_m=wanted_m,
    )


_OF_PLACE = (
    "slot_error_m",
    *(f"{way}_{figure}_m" for way in ("forward", "right") for figure in ("mean", "sigma", "drms")),
    "position_sigma_m",
    "position_drms_m",
)


def metrics(flight: Flight, settle_s: float = 0.0) -> Metrics:
    """The figures of one flight, its first `settle_s` seconds left out.

    Raises EchowingError when nothing is left to measure.
    """
    settled = _settled(flight, settle_s)
    separation_m = flight.separation_m
    known = settled & np.isfinite(separation_m)
    if not known.any():
        raise EchowingError(_nothing_left(flight, settle_s))
    placed_m = position_error_m(flight)[known]
    placed_m = placed_m[np.isfinite(placed_m).all(axis=1)]
    forward, right = _statistics(placed_m[:, 0]), _statistics(placed_m[:, 1])
    position = _statistics(np.hypot(placed_m[:, 0], placed_m[:, 1]))
    wanted_m = flight.wanted_separation_m
    seen_share = _seen_share(flight, known)
    return replace(
        of_separation(separation_m[known], wanted_m, settle_s, seen_share),
        slot_error_m=position[0],
        forward_mean_m=forward[0],
        forward_sigma_m=forward[1],
        forward_drms_m=forward[2],
        right_mean_m=right[0],
        right_sigma_m=right[1],
        right_drms_m=right[2],
        position_sigma_m=position[1],
        position_drms_m=position[2],
        left_out=int(settled.sum() - known.sum()),
    )


def position_error_m(flight: Flight) -> Floats:
    """From the slot to the follower in the leader's course frame, (n, 2): forward, right.

    The course is the one the slot was built on: the slot lies behind it, turned by the wanted
    angle (guidance.slot_offset_m). NaN where the slot is unknown or on the leader itself.
    """
    arm_m = (flight.slot_ned_m - flight.leader_ned_m)[:, :2]
    bearing_rad = np.arctan2(arm_m[:, 1], arm_m[:, 0])
    course_rad = bearing_rad - math.pi + flight.wanted_angle_rad
    course_rad = np.where((arm_m == 0.0).all(axis=1), math.nan, course_rad)
    error_m = (flight.follower_ned_m - flight.slot_ned_m)[:, :2]
    cos, sin = np.cos(course_rad), np.sin(course_rad)
    forward_m = error_m[:, 0] * cos + error_m[:, 1] * sin
    right_m = error_m[:, 1] * cos - error_m[:, 0] * sin
    return np.column_stack([forward_m, right_m])


def aggregate(runs: Iterable[Metrics]) -> dict[str, Spread]:
    """Each figure over several flights, by field name; the deviation is a sample's (n - 1)."""
    collected = list(runs)
    if not collected:
        raise EchowingError("no flights to summarise: fly or read at least one")
    return {
        item.name: _spread([float(getattr(run, item.name)) for run in collected])
        for item in fields(Metrics)
    }


def dead_locked(flight: Flight, window_s: float = DEAD_LOCK_WINDOW_S) -> bool:
    """Whether the speed law has lost its leader for good while its own speed is held low.

    Appendix A's law changes the speed only on a reading. Lose the leader just after "too close,
    slow down" and the follower is left slower than its leader: it never comes back into sonar
    range, so the law never speeds it up again. True when, from the last sight of the leader to
    the end of the flight,

    - at least `window_s` pass (a sight: a reading within 2 m of the separation);
    - the speed command is under the leader's median speed, at the end too (medians: a guard that
      backs off from a wild reading raises it for a moment);
    - the separation has grown: in the last `window_s` its mean is above that at the last sight.
    """
    if len(flight.time_s) == 0:
        return False
    separation_m = flight.separation_m
    sights = np.flatnonzero(np.abs(flight.sonar_m - separation_m) <= SIGHT_TOLERANCE_M)
    last = int(sights[-1]) if len(sights) else 0
    end_s = float(flight.time_s[-1])
    if end_s - float(flight.time_s[last]) < window_s:
        return False
    command_mps = flight.speed_command_mps[last + 1 :]
    leader_mps = np.hypot(*flight.leader_velocity_mps[last + 1 :, :2].T)
    told = np.isfinite(command_mps)
    at_end = told & (flight.time_s[last + 1 :] >= end_s - AT_END_S)
    if not (at_end.any() and np.isfinite(leader_mps).any()):
        return False
    held_mps = max(np.median(command_mps[told]), np.median(command_mps[at_end]))
    held_low = held_mps < np.nanmedian(leader_mps)
    late_m = separation_m[flight.time_s >= end_s - window_s]
    grown = np.isfinite(late_m).any() and np.nanmean(late_m) > separation_m[last]
    return bool(held_low and grown)


def _settled(flight: Flight, settle_s: float) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    if len(flight.time_s) == 0:
        raise EchowingError(f"flight {flight.name!r} is empty: no samples to measure")
    settled = np.asarray(flight.time_s >= flight.time_s[0] + settle_s)
    return settled if flight.counted is None else settled & flight.counted


def _nothing_left(flight: Flight, settle_s: float) -> str:
    length_s = float(flight.time_s[-1] - flight.time_s[0])
    return (
        f"flight {flight.name!r}: no sample with both positions after the first {settle_s:g} s "
        f"of {length_s:.1f} s; fly longer, skip less, or give logs that overlap"
    )


def _seen_share(flight: Flight, known: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> float:
    if not flight.sonar_known:
        return math.nan
    return float(np.isfinite(flight.sonar_m[known]).mean())


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _statistics(values: Floats) -> tuple[float, float, float]:
    """Mean, sigma and DRMS; NaN of nothing."""
    if len(values) == 0:
        return math.nan, math.nan, math.nan
    return float(values.mean()), float(values.std()), _root_mean_square(values)


def _spread(values: Sequence[float]) -> Spread:
    known = np.array([value for value in values if math.isfinite(value)])
    if len(known) == 0:
        return Spread(math.nan, math.nan, math.nan, math.nan, 0)
    std = float(known.std(ddof=1)) if len(known) > 1 else 0.0
    return Spread(float(known.mean()), std, float(known.min()), float(known.max()), len(known))


def _plain(value: float) -> float | int | None:
    if isinstance(value, int):
        return value
    return round(value, 4) if math.isfinite(value) else None
