"""What a sonar really hears in flight, beside what its file says. Pure.

Of each reading it is known afterwards where the leader was: both vehicles have reported, and the
estimate knows how far their receivers disagree. Readings of a leader that was in the beam for
certain tell the share that is heard; ranges in a row how they scatter; all of them how many are of
something else. A sonar that is worse than believed is told: nobody flies by a belief that is wrong
without knowing.
"""

import math
import statistics
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from echowing.flight.belief import SonarBelief
from echowing.flight.clocks import LOST_S

# What is told is of the readings of so long.
WINDOW_S = 60.0
# With fewer, nothing is told.
LEAST_READINGS = 60
# Further from where the leader was than this a reading is of something else. The leader is known to
# half a metre where it is heard.
GATE_M = 0.7
# Readings come and go in bursts: so many tell as much as one that depends on none before it.
DEPENDENCE = 4.0
# One-sided 95 %: beyond it a share is called another one.
SIGMAS = 1.645
# The second difference of three ranges in a row scatters so many times as one does; a change of
# speed by 1 m/s2 adds a centimetre.
SECOND_DIFFERENCE = math.sqrt(6.0)
IN_A_ROW_S, LEAST_IN_A_ROW = 0.16, 20
MEDIAN_SIGMAS = 0.6745
# The gimbal looks as far aside, in its search, as this (standard deviation).
GIMBAL_RAD = math.radians(5.0)
# It is worked out anew so often.
EVERY_S = 1.0
# A scatter is called worse only beyond this: the vehicles' own motion adds some.
SCATTER_SLACK = 1.5


class Reading(NamedTuple):
    """A reading, and where the leader was then.

    range_m: None: nothing was heard. expected_m: what it should have read; off_rad: off the axis.
    sure_rad: how well its direction was known (standard deviation).
    """

    time_s: float
    range_m: float | None
    expected_m: float
    off_rad: float
    sure_rad: float

    @property
    def is_right(self) -> bool:
        """Whether it is of the leader."""
        return self.range_m is not None and abs(self.range_m - self.expected_m) <= GATE_M


@dataclass(frozen=True, slots=True)
class Heard:
    """What a sonar has heard lately; None: that is not known.

    share: of its readings that hear a leader in the beam, and of_believed: as a share of the least
    that is believed; scatter_m: standard deviation of a range;
    wrong_share: of its readings that are of something else. worse: what is worse than believed;
    sonar: what to believe of it then.
    """

    share: float | None = None
    of_believed: float | None = None
    scatter_m: float | None = None
    wrong_share: float | None = None
    worse: str | None = None
    sonar: SonarBelief | None = None


class _Weighed(NamedTuple):
    """A reading of the last minute, with what it tells, worked out once.

    inside: how likely the leader was in the beam, taken for half way between narrowest and widest;
    least: how likely it is heard at the least; both 0 where that is not known. bend_m: the second
    difference of this range and the two before it, None: they do not come in a row.
    """

    time_s: float
    is_right: bool
    is_wrong: bool
    inside: float
    least: float
    bend_m: float | None


class Hearing:
    """One follower's sonar over the last minute. `fresh` keeps the readings for who writes them."""

    def __init__(self, sonar: SonarBelief) -> None:
        self._sonar = sonar
        self._weighed: deque[_Weighed] = deque()
        self._last: deque[Reading] = deque(maxlen=3)
        self._right_at_s = self._told_at_s = -math.inf
        self._told = Heard()
        self.fresh: deque[Reading] = deque(maxlen=1000)

    @property
    def counts_to_m(self) -> float:
        """So far away a leader may be for readings to tell how many of them hear it."""
        sonar = self._sonar
        return min(sonar.heard_to_m, sonar.silent_to_m) - GATE_M + sonar.inset_m

    def take(self, reading: Reading) -> None:
        """Take a reading; times rise."""
        if reading.is_right:
            self._right_at_s = reading.time_s
        elif reading.time_s - self._right_at_s > LOST_S:
            return
        self.fresh.append(reading)
        self._last.append(reading)
        self._weighed.append(self._weigh(reading))
        while self._weighed[0].time_s < reading.time_s - WINDOW_S:
            self._weighed.popleft()

    def _weigh(self, one: Reading) -> _Weighed:
        sonar, range_m = self._sonar, one.expected_m
        inside = least = 0.0
        narrow_rad = sonar.narrowest_rad.at(range_m)
        near = range_m <= self.counts_to_m - sonar.inset_m
        if near and one.off_rad <= narrow_rad:
            inside = _inside(one, (narrow_rad + sonar.widest_rad.at(range_m)) / 2.0)
            least = sonar.heard.at(range_m) * _inside(one, narrow_rad)
        is_wrong = one.range_m is not None and not one.is_right
        return _Weighed(one.time_s, one.is_right, is_wrong, inside, least, _bend_m(self._last))

    def heard(self) -> Heard:
        """What it has heard lately; nothing is known of one that has not heard its leader."""
        newest_s = self._weighed[-1].time_s if self._weighed else -math.inf
        if newest_s >= self._told_at_s + EVERY_S:
            self._told, self._told_at_s = self._work_out(), newest_s
        return self._told

    def _work_out(self) -> Heard:
        near = [one for one in self._weighed if one.inside > 0.0]
        share, wrong_share = _share(near), self._wrong_share()
        scatters_m = _scatter_m(one.bend_m for one in self._weighed)
        right, unsure, believed = counted = _counted(near)
        worse = _hears_less(counted, share) or self._is_worse(scatters_m, wrong_share)
        of_believed, hears = None, 1.0
        if share is not None and believed > 0.0:
            of_believed, hears = right / believed, min(1.0, (right + unsure) / believed)
        heard = Heard(share, of_believed, scatters_m, wrong_share, worse)
        return heard if worse is None else replace(heard, sonar=self._as_heard(heard, hears))

    def _as_heard(self, heard: Heard, hears: float) -> SonarBelief:
        """What is believed, and worse where it is surely worse; hears: so much of its shares."""
        sonar = self._sonar
        shares = tuple(hears * one for one in sonar.heard.values)
        return replace(
            sonar,
            heard=replace(sonar.heard, values=shares),
            noise_m=max(sonar.noise_m, (heard.scatter_m or 0.0) / SCATTER_SLACK),
            wrong_share=max(sonar.wrong_share, heard.wrong_share or 0.0),
        )

    def _wrong_share(self) -> float | None:
        if len(self._weighed) < LEAST_READINGS:
            return None
        return sum(one.is_wrong for one in self._weighed) / len(self._weighed)

    def _is_worse(self, scatters_m: float | None, wrong_share: float | None) -> str | None:
        """Whether more is wrong, or ranges scatter more, than is believed."""
        sonar = self._sonar
        if wrong_share is not None:
            unsure = _unsure(wrong_share, len(self._weighed))
            if wrong_share - unsure > sonar.wrong_share:
                believed = sonar.wrong_share
                return f"{wrong_share:.0%} of ranges wrong, {believed:.0%} is believed"
        if scatters_m is not None and scatters_m > SCATTER_SLACK * max(0.01, sonar.noise_m):
            noise_cm = 100.0 * sonar.noise_m
            return f"ranges scatter {100.0 * scatters_m:.0f} cm, {noise_cm:.0f} cm is believed"
        return None


def _share(near: list[_Weighed]) -> float | None:
    """The share heard within the beam."""
    inside = sum(one.inside for one in near)
    return None if inside < LEAST_READINGS else min(1.0, sum(o.is_right for o in near) / inside)


def _hears_less(counted: tuple[int, float, float], share: float | None) -> str | None:
    """Whether less is heard than the least that is believed, by the narrowest beam."""
    if share is None:
        return None
    right, unsure, believed = counted
    if right + unsure >= believed:
        return None
    # In the words of the share that is shown.
    told = share * believed / max(1, right)
    return f"sonar hears {share:.0%}, {min(1.0, told):.0%} is believed"


def _counted(near: list[_Weighed]) -> tuple[int, float, float]:
    """How many hear the leader, how unsure that is, and how many do at the least by the belief."""
    unsure = SIGMAS * math.sqrt(DEPENDENCE * sum(o.least * (1.0 - o.least) for o in near))
    return sum(one.is_right for one in near), unsure, sum(one.least for one in near)


def scatter_m(readings: Iterable[Reading]) -> float | None:
    """Standard deviation of a range; None: too few came in a row."""
    last: deque[Reading] = deque(maxlen=3)
    bends_m = []
    for one in readings:
        last.append(one)
        bends_m.append(_bend_m(last))
    return _scatter_m(bends_m)


def _bend_m(last: deque[Reading]) -> float | None:
    """The second difference of three ranges; None: they are not right, or not in a row."""
    if len(last) < 3 or last[2].time_s - last[0].time_s > 2.0 * IN_A_ROW_S:
        return None
    if not all(one.is_right for one in last):
        return None
    before_m, here_m, after_m = (one.range_m or 0.0 for one in last)
    return abs(before_m - 2.0 * here_m + after_m)


def _scatter_m(bends_m: Iterable[float | None]) -> float | None:
    """By the median, as single ones may be anything."""
    known_m = [one for one in bends_m if one is not None]
    if len(known_m) < LEAST_IN_A_ROW:
        return None
    return statistics.median(known_m) / MEDIAN_SIGMAS / SECOND_DIFFERENCE


def _inside(one: Reading, half_rad: float) -> float:
    """How likely the leader was in a beam, its direction being known so well."""
    unsure_rad = math.hypot(one.sure_rad, GIMBAL_RAD)
    return 0.5 * (1.0 + math.erf((half_rad - one.off_rad) / (unsure_rad * math.sqrt(2.0))))


def _unsure(share: float, count: int) -> float:
    """How far off the share of so many readings may be."""
    kept = max(share * (1.0 - share), 0.01)
    return SIGMAS * math.sqrt(kept * DEPENDENCE / count)
