"""Where the leader is, as seen by one follower: receivers, sonar, and their times. Pure."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from echowing.flight.alignment import (
    STOPS_AFTER_S,
    AlignedReading,
    Alignment,
    History,
    Report,
    between_m,
)
from echowing.flight.axis import Axis, apart_rad
from echowing.flight.belief import SonarBelief
from echowing.flight.clocks import LOST_S
from echowing.flight.cloud import SURE_AFTER_S, Between, Bystander, Cloud, Off
from echowing.flight.envelope import SURE_SIGMAS, strays_m
from echowing.flight.guidance import Horizontal, LeaderFix, predicted
from echowing.flight.hearing import Hearing, Reading
from echowing.geo import GlobalPosition, displace

# Between two vehicles in flight a range in centimetres changes within this time: if not, the sensor
# is stuck.
STUCK_S = 3.0
# A sonar that hears anything at all, an engine or another sonar, gives ranges of which four in ten
# within reach are by chance like (`ALIKE_M`) one of the two before. A healthy one gives one wild
# reading in a hundred: two of ten are a fault.
WILD_SHARE, WILD_S = 0.2, 3.0
# From one reading to the next a vehicle's range changes by no more.
ALIKE_M = 0.5
# What is known is noted so often, to go back to.
NOTED_EVERY_S = 1.0
# Age of a range when it is sent: trigger, sound there and back at 343 m/s, reading and packing
# (firmware/README.md: reading to wire 5 ms, and half of the 20 ms and the flight before it).
SONAR_AGE_S = 0.03
# A follower that leans more may look past a leader that is straight ahead.
LEVEL_RAD = math.radians(8.0)
# A report is carried on (extrapolated) no longer than this: then the vehicle may do anything.
LONGEST_CARRY_S = 2.0
# The least delayed message within this time sets a sender's clock: two crystals that differ by
# 100 ppm drift by 2 ms in it.
CLOCK_WINDOW_S = 20.0
# A sender whose clock is this far behind its newest message has restarted.
RESTART_S = 5.0


class SenderClock:
    """The clock of a sender that answers no TIMESYNC: its least delayed message sets it."""

    def __init__(self) -> None:
        # Stamps, and how far our clock was ahead at their receipt, in rising order.
        self._least: deque[tuple[float, float]] = deque()
        self._newest_s = -math.inf

    def to_ours(self, stamp_s: float, received_s: float, way_s: float) -> float:
        """Our time of a stamp; `way_s`: how long the least delayed message takes."""
        if stamp_s < self._newest_s - RESTART_S:
            self.__init__()  # type: ignore[misc]
        self._newest_s = max(self._newest_s, stamp_s)
        ahead_s = received_s - stamp_s
        while self._least and self._least[-1][1] >= ahead_s:
            self._least.pop()
        self._least.append((stamp_s, ahead_s))
        while self._least[0][0] < self._newest_s - CLOCK_WINDOW_S:
            self._least.popleft()
        return stamp_s + self._least[0][1] - way_s


@dataclass(frozen=True, slots=True)
class Beside:
    """Another vehicle that the sonar may hear.

    history: its reports; off: what its history and that of whom the sonar looks at are known to
    disagree by, added to its place, so that a guess moves it as that one; where not `moves`: its
    and ours.
    """

    system_id: int
    history: History
    off: Off
    moves: bool = True


@dataclass(frozen=True, slots=True)
class Tie:
    """What sonars on the way from one vehicle to another tell of their receivers.

    off: what they disagree by, as `Cloud.off`; jumped_m: as `Estimate.jumped_m`; proven_m: as
    `FollowerState.proven_m`.
    """

    off: Off
    jumped_m: Horizontal
    proven_m: Horizontal


class Estimate:
    """One follower's view of its leader: the receivers' disagreement, learnt from the sonar."""

    def __init__(self, sonar: SonarBelief) -> None:
        self.sonar = sonar
        self.history = History()
        self._watched = History()
        self.offset = Cloud(sonar)
        self._noted: deque[tuple[float, Cloud]] = deque()
        """What was learnt, as it was before: when, and what."""
        self.hearing = Hearing(sonar)
        self.sonar_clock = SenderClock()
        self._alignment = Alignment()
        self._before = (-math.inf, math.nan)
        self._alike = 0
        self._alike_since_s = -math.inf
        self._ranges: deque[float] = deque(maxlen=2)
        """The last readings of something in reach."""
        self._scattered: deque[tuple[float, bool]] = deque(maxlen=round(WILD_S * sonar.rate_hz))
        """Whether a reading was like none of the two before it: when, and whether."""
        self.is_wild = False
        """Whether the sonar's ranges do not agree with each other."""
        self.jumped_m: Horizontal = (0.0, 0.0)
        """Receivers' jumps that are allowed for: the leader's, less the follower's."""
        self._elsewhere_m: list[Between] = []
        self._used_to_s = -math.inf
        self._pointed_at_s = -math.inf

    @property
    def is_stuck(self) -> bool:
        """Whether the sonar keeps giving the same range."""
        return self._alike >= round(STUCK_S * self.sonar.rate_hz)

    @property
    def is_believed(self) -> bool:
        """Whether what the sonar says counts."""
        return not self.is_stuck and not self.is_wild

    def hears(self, now_s: float) -> bool:
        """Whether its sonar has lately detected the leader."""
        return self.offset.unheard_s(now_s) <= LOST_S

    @property
    def missed_s(self) -> float:
        """How long the leader was not heard, up to the last reading that could be used."""
        known = math.isfinite(self._used_to_s)
        return self.offset.unheard_s(self._used_to_s) if known else math.inf

    @property
    def elsewhere_m(self) -> list[Between]:
        """By how much the leader is not where it is believed, if its echoes are another vehicle's.

        (north, east, up), of each that there is: so much further as it seems to be from that one.
        None where the sonar would not reach it or the beam has both, and none once it has been
        heard for long, up to the last reading that could be used.
        """
        known = math.isfinite(self._used_to_s)
        found_s = self.offset.found_s(self._used_to_s) if known else 0.0
        return self._elsewhere_m if found_s < SURE_AFTER_S else []

    def listens(self, now_s: float) -> bool:
        """Whether its sonar works: readings come, they change, and they agree."""
        return now_s - self._before[0] < LOST_S and self.is_believed

    def reported(self, report: Report) -> None:
        """Take a report of the follower itself."""
        self.history.add(report)

    def pointed(self, stamp_ms: int, axis: Axis, now_s: float) -> None:
        """Take where the sonar looked for the reading with this stamp."""
        self._pointed_at_s = now_s
        self._alignment.point(stamp_ms, axis)

    def points(self, now_s: float) -> bool:
        """Whether the sonar is on a gimbal, and says where it looks."""
        return not self.sonar.fixed and now_s - self._pointed_at_s < LOST_S

    def heard(self, time_s: float, range_m: float, stamp_ms: int | None = None) -> None:
        """Take a sonar reading; stamp_ms: by which `pointed` names it."""
        _, before_m = self._before
        was_believed = self.is_believed
        self._before = (time_s, range_m)
        if range_m != before_m or range_m >= self.sonar.reach_m:
            self._alike, self._alike_since_s = 0, time_s
        else:
            self._alike += 1
        self._compare(time_s, range_m)
        if range_m > 0.0:
            silent = range_m >= self.sonar.reach_m
            heard_m = None if silent else range_m + self.sonar.inset_m
            self._alignment.add(time_s - SONAR_AGE_S, heard_m, stamp_ms, counts=self.is_believed)
        if self.is_believed:
            self._note(time_s)
        elif was_believed:  # it was wrong before that showed
            self._go_back()

    def _compare(self, time_s: float, range_m: float) -> None:
        """Note whether a range is like one of the two before it."""
        in_reach, before_m = range_m < self.sonar.reach_m, self._ranges
        alike = len(before_m) < 2 or any(abs(one - range_m) < ALIKE_M for one in before_m)
        self._scattered.append((time_s, in_reach and not alike))
        most = round(WILD_SHARE * (self._scattered.maxlen or 0))
        self.is_wild = sum(scattered for _, scattered in self._scattered) >= most
        if in_reach:
            self._ranges.append(range_m)

    @property
    def _wrong_since_s(self) -> float:
        """When a fault of the sonar began, if there is one."""
        scattered_s = (at_s for at_s, scattered in self._scattered if scattered)
        return self._alike_since_s if self.is_stuck else next(scattered_s, math.inf)

    def _note(self, time_s: float) -> None:
        """Keep what is known now, and of what was known before what a fault may go back to."""
        if not self._noted or time_s - self._noted[-1][0] >= NOTED_EVERY_S:
            self._noted.append((time_s, self.offset.copy()))
        needed_s = min(self._alike_since_s, self._scattered[0][0])
        while len(self._noted) > 1 and self._noted[1][0] <= needed_s:
            self._noted.popleft()

    def _go_back(self) -> None:
        """Go back to what was known before the sonar's fault began; the note stays for the next."""
        since_s = self._wrong_since_s
        while self._noted and self._noted[-1][0] > since_s:
            self._noted.pop()
        if self._noted:
            self.offset = self._noted[-1][1].copy()
        else:
            self.offset = Cloud(self.sonar)

    def learn(self, leader: History, others: Sequence[Beside] = ()) -> None:
        """Use the readings for which later reports of both vehicles have come.

        leader: the vehicle that it looks at. A range that one of `others` explains better counts
        for nothing.
        """
        self._watched = leader
        self._used_to_s = min(leader.newest_s, self.history.newest_s)
        for one in self._alignment.due(leader, self.history):
            if one.told or not self.points(one.time_s):  # else what it said of its axis was lost
                self._learn_from(one, self._bystanders(others, one.time_s))
        if math.isfinite(self._used_to_s):
            self.offset.advance(self._used_to_s)

    def _learn_from(self, one: AlignedReading, others: Sequence[Bystander]) -> None:
        believed_m, heard_m = self._believed_m(one), one.distance_m
        self._elsewhere_m = list(self._elsewhere(believed_m, others))
        ahead = one.told or one.lean_rad < LEVEL_RAD
        if one.counts and heard_m is not None:
            self.offset.heard(one.time_s, heard_m, one.axis, believed_m, others)
        elif one.counts and ahead:
            self.offset.silent(one.time_s, one.axis, believed_m, others)
        if not ahead:
            return
        if heard_m is None or not self.offset.is_of_another(heard_m, one.axis, believed_m, others):
            self.hearing.take(self._beside_leader(one))

    def _elsewhere(self, believed_m: Between, others: Sequence[Bystander]) -> Iterator[Between]:
        to_it_m = [a - b for a, b in zip(believed_m, self.offset.off[:3], strict=True)]
        for other in others:
            north_m, east_m, up_m = (a - b for a, b in zip(believed_m, other.to_it_m, strict=True))
            there_m = to_it_m[0] + north_m, to_it_m[1] + east_m, to_it_m[2] + up_m
            far_m = math.hypot(*there_m)
            reached = self.sonar.shortest_m < far_m - self.sonar.inset_m < self.sonar.reach_m
            aside = reached and apart_rad(there_m, to_it_m) > self.sonar.widest_rad.at(far_m)
            if other.moves and aside:
                yield north_m, east_m, up_m

    def _believed_m(self, one: AlignedReading) -> tuple[float, float, float]:
        """From here to the leader at a reading, the receivers' jumps allowed for."""
        north_m, east_m = one.believed_m
        return north_m - self.jumped_m[0], east_m - self.jumped_m[1], one.above_m

    def _bystanders(self, others: Sequence[Beside], time_s: float) -> list[Bystander]:
        """Where the others were at a reading.

        A slow radio brings their reports after it: it is not waited for them, and who would be left
        out is taken for whom the sonar looks at (column, seed 6: a follower came to 0.04 m).
        """
        found = []
        for other in others:
            to_it_m = between_m(self.history, other.history, time_s)
            if to_it_m is None:
                continue
            jumped_m = self.jumped_m if other.moves else (0.0, 0.0)
            north_m = to_it_m[0] + other.off.north_m - jumped_m[0]
            east_m = to_it_m[1] + other.off.east_m - jumped_m[1]
            place = (north_m, east_m, to_it_m[2] + other.off.up_m)
            strayed_m = strays_m(min(STOPS_AFTER_S, max(0.0, time_s - other.history.newest_s)))
            strayed_sigma_m = strayed_m / SURE_SIGMAS
            sigma_m = math.hypot(other.off.level_sigma_m, strayed_sigma_m)
            up_sigma_m = math.hypot(other.off.up_sigma_m, strayed_sigma_m)
            found.append(Bystander(other.system_id, place, sigma_m, up_sigma_m, other.moves))
        return found

    def _to_leader_m(self, one: AlignedReading) -> Horizontal:
        """Where the leader was at a reading, the disagreement of the receivers allowed for."""
        north_m, east_m, _ = self._believed_m(one)
        return north_m - self.offset.north_m, east_m - self.offset.east_m

    def _beside_leader(self, one: AlignedReading) -> Reading:
        """A reading and where the leader was."""
        offset, (north_m, east_m) = self.offset, self._to_leader_m(one)
        to_it_m = north_m, east_m, offset.up_m - one.above_m
        far_m = math.hypot(*to_it_m)
        ahead = sum(a * b for a, b in zip(one.axis.unit_ned, to_it_m, strict=True))
        off_rad = math.acos(max(-1.0, min(1.0, ahead / max(far_m, self.sonar.shortest_m))))
        across_m = offset.sigma_m(math.atan2(east_m, north_m) + math.pi / 2.0)
        unsure_m = max(across_m, offset.up_sigma_m)
        return Reading(
            one.time_s,
            None if one.distance_m is None else one.distance_m - self.sonar.inset_m,
            far_m - self.sonar.inset_m,
            off_rad,
            math.atan2(unsure_m, max(far_m, self.sonar.shortest_m)),
        )

    def forget(self) -> None:
        """Drop what was learnt: a receiver has started anew."""
        self.offset = Cloud(self.sonar)
        self._begin_anew((0.0, 0.0))

    def turn_to(self, tie: Tie, watched: History) -> None:
        """Look at another vehicle, of which the others' sonars tell so much."""
        self._watched = watched
        self.offset.turn_to(tie.off)
        self._begin_anew(tie.jumped_m)

    def _begin_anew(self, jumped_m: Horizontal) -> None:
        self._noted.clear()
        self._alignment = Alignment()
        self.jumped_m = jumped_m

    def jumped(self, moved_m: tuple[float, float]) -> None:
        """The leader's receiver has jumped by (north, east), or the follower's by the opposite."""
        self.jumped_m = self.jumped_m[0] + moved_m[0], self.jumped_m[1] + moved_m[1]
        self._alignment = Alignment()

    def as_seen(self, leader: GlobalPosition) -> GlobalPosition:
        """The leader's place in the follower's receiver's frame."""
        north_m, east_m = self.shift_m
        return displace(leader, (-north_m, -east_m, 0.0))

    @property
    def shift_m(self) -> Horizontal:
        """How much further (north, east) the leader's receiver puts a place than the follower's."""
        off, (north_m, east_m) = self.off, self.drifted_m
        return off.north_m + north_m, off.east_m + east_m

    @property
    def drifted_m(self) -> Horizontal:
        """By how much the leader's receiver has lately drifted, less the follower's own."""
        (north_m, east_m), own_m = self._watched.drifted_m, self.history.drifted_m
        return north_m - own_m[0], east_m - own_m[1]

    @property
    def off(self) -> Off:
        """What both histories disagree by: less what receivers have lately drifted."""
        off, (north_m, east_m) = self.offset.off, self.jumped_m
        return off._replace(north_m=off.north_m + north_m, east_m=off.east_m + east_m)


def carried_on(leader: LeaderFix, to_s: float) -> LeaderFix:
    """The leader at a moment, from its newest report (see `guidance.predicted`)."""
    return predicted(leader, min(LONGEST_CARRY_S, max(0.0, to_s - leader.time_s)))
