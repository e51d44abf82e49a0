"""Leader, follower and sonar reading, aligned to the same moment. Pure.

Reports reach the ground with different delays: a leader's report that is 0.5 s older than the
follower's and the reading is wrong by 1 m at 2 m/s. The receivers' disagreement changes over a
minute, so a reading can wait until both vehicles have sent a later report. Interpolation then gives
both positions at the moment of the reading, and nothing has to be predicted.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise

from echowing.flight.axis import Axis
from echowing.flight.guidance import Horizontal
from echowing.geo import GRAVITY_MPS2, GlobalPosition, displace, ned_between, wrap_angle_rad

# A reading that waits longer than this for later reports of both vehicles is dropped.
LONGEST_WAIT_S = 3.0
# No interpolation over a longer gap between reports: 5 reports of a 4 Hz stream are lost.
LONGEST_GAP_S = 1.5
# A follower whose link is lost flies on for ECHO_STREAM_T (1 s). Then it stops within a second, in
# which it flies half as far as at full speed.
STOPS_AFTER_S = 1.5


@dataclass(frozen=True, slots=True)
class Report:
    """Where a vehicle was at `time_s` (our clock), its velocity (north, east) and its heading.

    drifted_m: by how much its receiver has lately drifted (`drift`).
    """

    time_s: float
    position: GlobalPosition
    velocity_mps: Horizontal
    heading_rad: float
    drifted_m: Horizontal = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class AlignedReading:
    """A sonar reading with both vehicles' places at that moment.

    distance_m: between the vehicles' centres, None: nothing was heard; axis: where the sonar looked
    (`told`), or level along the follower's nose; believed_m: from follower to leader by their own
    receivers, (north, east); above_m: how much higher the leader was; lean_rad: of the follower,
    from its change of velocity; counts: the sonar was believed.
    """

    time_s: float
    distance_m: float | None
    axis: Axis
    told: bool
    believed_m: Horizontal
    above_m: float
    lean_rad: float
    counts: bool


class History:
    """A vehicle's reports of the last seconds, oldest first, less what its receiver has drifted.

    drifted_m: that, by now.
    """

    def __init__(self) -> None:
        self._reports: deque[Report] = deque()
        self.drifted_m: Horizontal = (0.0, 0.0)

    def add(self, report: Report) -> None:
        """Take a report; one that is not newer than the last is ignored."""
        self.drifted_m = north_m, east_m = report.drifted_m
        if self._reports and report.time_s <= self._reports[-1].time_s:
            return
        place = displace(report.position, (-north_m, -east_m, 0.0))
        self._reports.append(replace(report, position=place))
        while self._reports[0].time_s < report.time_s - LONGEST_WAIT_S:
            self._reports.popleft()

    def clear(self) -> None:
        """Drop all reports: the vehicle's clock has restarted, or its position has jumped."""
        self._reports.clear()

    @property
    def newest_s(self) -> float:
        """Time of the newest report."""
        return self._reports[-1].time_s if self._reports else -math.inf

    def around(self, time_s: float) -> tuple[Report, Report] | None:
        """The reports before and after a moment; None: there are none near enough."""
        for before, after in pairwise(self._reports):
            if before.time_s <= time_s <= after.time_s:
                near = after.time_s - before.time_s <= LONGEST_GAP_S
                return (before, after) if near else None
        return None

    def carried_on(self, time_s: float) -> tuple[Report, Report] | None:
        """The newest report and how it goes on, for a moment after it; None: there is none.

        One that has fallen silent stands: its applet stops it.
        """
        if not self._reports or time_s < self.newest_s:
            return None
        newest, flies_s = self._reports[-1], min(time_s - self.newest_s, STOPS_AFTER_S)
        north_mps, east_mps = newest.velocity_mps
        place = displace(newest.position, (north_mps * flies_s, east_mps * flies_s, 0.0))
        return newest, replace(newest, time_s=time_s, position=place)


@dataclass(slots=True)
class _Reading:
    """One that waits; stamp_ms: by which its axis names it, axis: where the sonar looked."""

    time_s: float
    distance_m: float | None
    stamp_ms: int | None
    counts: bool
    axis: Axis | None = None


def between_m(here: History, there: History, time_s: float) -> tuple[float, float, float] | None:
    """From one vehicle to another at a moment, by their own positions, (north, east, up).

    The other's newest report is carried on where it is older. None: it is not known.
    """
    own, its = here.around(time_s), there.around(time_s) or there.carried_on(time_s)
    if own is None or its is None:
        return None
    origin = own[0].position
    (own_north, own_east), (north, east) = (_place_m(origin, one, time_s) for one in (own, its))
    return north - own_north, east - own_east, _altitude_m(its, time_s) - _altitude_m(own, time_s)


class Alignment:
    """The readings of one follower's sonar that wait for the reports around them."""

    def __init__(self) -> None:
        self._waiting: deque[_Reading] = deque()

    def add(
        self,
        time_s: float,
        distance_m: float | None,
        stamp_ms: int | None = None,
        *,
        counts: bool = True,
    ) -> None:
        """Take a reading: when it was taken, the distance between the centres (None: nothing).

        stamp_ms: of the message that brought it, None: it names none. counts: the sonar is
        believed; if not, nor are those that wait.
        """
        self._waiting.append(_Reading(time_s, distance_m, stamp_ms, counts))
        if not counts:
            for reading in self._waiting:
                reading.counts = False

    def point(self, stamp_ms: int, axis: Axis) -> None:
        """Take where the sonar looked for the newest reading, if that has this stamp."""
        if self._waiting and self._waiting[-1].stamp_ms == stamp_ms:
            self._waiting[-1].axis = axis

    def due(self, leader: History, follower: History) -> list[AlignedReading]:
        """The readings with later reports of both vehicles; each is returned once."""
        aligned = []
        ready_s = min(leader.newest_s, follower.newest_s)
        while self._waiting and self._waiting[0].time_s <= ready_s:
            reading = self._waiting.popleft()
            of_leader = leader.around(reading.time_s)
            of_follower = follower.around(reading.time_s)
            if of_leader is not None and of_follower is not None:
                aligned.append(_aligned(reading, of_leader, of_follower))
        while self._waiting and self._waiting[0].time_s < self._waiting[-1].time_s - LONGEST_WAIT_S:
            self._waiting.popleft()
        return aligned


def _aligned(
    reading: _Reading, leader: tuple[Report, Report], follower: tuple[Report, Report]
) -> AlignedReading:
    time_s, origin = reading.time_s, follower[0].position
    leader_m, follower_m = _place_m(origin, leader, time_s), _place_m(origin, follower, time_s)
    before, after = follower
    share = _share(before, after, time_s)
    turn_rad = wrap_angle_rad(after.heading_rad - before.heading_rad)
    return AlignedReading(
        time_s=time_s,
        distance_m=reading.distance_m,
        axis=reading.axis or Axis(wrap_angle_rad(before.heading_rad + share * turn_rad)),
        told=reading.axis is not None,
        believed_m=(leader_m[0] - follower_m[0], leader_m[1] - follower_m[1]),
        above_m=_altitude_m(leader, time_s) - _altitude_m(follower, time_s),
        lean_rad=_lean_rad(before, after),
        counts=reading.counts,
    )


def _lean_rad(before: Report, after: Report) -> float:
    """A copter leans as it accelerates."""
    span_s = max(1e-3, after.time_s - before.time_s)
    gained_mps = math.dist(before.velocity_mps, after.velocity_mps)
    return math.atan2(gained_mps / span_s, GRAVITY_MPS2)


def _share(before: Report, after: Report, time_s: float) -> float:
    span_s = after.time_s - before.time_s
    return 0.0 if span_s <= 0.0 else (time_s - before.time_s) / span_s


def _altitude_m(around: tuple[Report, Report], time_s: float) -> float:
    before, after = around
    risen_m = after.position.alt_m - before.position.alt_m
    return before.position.alt_m + _share(before, after, time_s) * risen_m


def _place_m(origin: GlobalPosition, around: tuple[Report, Report], time_s: float) -> Horizontal:
    """Where a vehicle was, (north, east) of `origin`: the cubic through both reports."""
    before, after = around
    span_s, share = after.time_s - before.time_s, _share(before, after, time_s)
    start, end = ned_between(origin, before.position), ned_between(origin, after.position)
    # Cubic Hermite interpolation: places and velocities at both ends.
    h01 = share * share * (3.0 - 2.0 * share)
    h10, h11 = share * (1.0 - share) ** 2, share * share * (share - 1.0)
    north_m, east_m = (
        (1.0 - h01) * start[axis]
        + h01 * end[axis]
        + span_s * (h10 * before.velocity_mps[axis] + h11 * after.velocity_mps[axis])
        for axis in (0, 1)
    )
    return north_m, east_m
