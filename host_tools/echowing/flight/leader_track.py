"""Where the leader is, from its reports: its clock against ours, late reports, jumps. Pure."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from echowing.flight.alignment import Report
from echowing.flight.clocks import LONGEST_GAP_S, REBOOT_S
from echowing.flight.drift import Drift
from echowing.flight.guidance import Horizontal, LeaderFix
from echowing.flight.jumps import AGREEING_REPORTS, BootClocks, beyond_movement_m, is_jump
from echowing.geo import GlobalPosition, Ned
from echowing.mavlink.messages import heading_of

# Accelerations beyond this are noise: a copter's default is 2.5 m/s2 (WP_ACC).
MOST_MPS2 = 3.0

# The oldest report of the last seconds counts: at 4 Hz its age decays by half in 3 s.
OLDEST_KEEPS = 0.95

# The round trip that is assumed until a TIMESYNC answer comes.
USUAL_ROUND_TRIP_S = 0.5
# A longer delay to the vehicle is not predicted: the leader may have turned by then.
LONGEST_WAY_S = 1.0
# So often it is asked for, as the quickest of several answers counts.
TIMESYNC_PERIOD_S = 1.0
# Requests that may still be answered: no radio holds one back for longer than half a minute.
ANSWERS_AWAITED = 30
# The quickest answer within this time sets the clock: crystals of 50 ppm drift 3 ms apart in it.
CLOCKS_AGREE_S = 60.0


class VehicleClock:
    """A vehicle's boot clock against ours, by TIMESYNC; the quickest answer is the most exact.

    Half the round trip is taken as the way back, so a link that is slower one way than the other
    causes an error of half the difference.
    """

    def __init__(self) -> None:
        self._best_round_trip_s = math.inf
        self._best_at_s = -math.inf
        self._boot_at_s: float | None = None
        self._asked_at_s = -math.inf
        self._asked_ns: deque[int] = deque(maxlen=ANSWERS_AWAITED)

    @property
    def known(self) -> bool:
        """Whether a TIMESYNC answer has come."""
        return self._boot_at_s is not None

    @property
    def round_trip_s(self) -> float:
        """To the vehicle and back."""
        return USUAL_ROUND_TRIP_S if self._boot_at_s is None else self._best_round_trip_s

    @property
    def way_s(self) -> float:
        """To the vehicle, or back."""
        return min(LONGEST_WAY_S, self.round_trip_s / 2.0)

    def due(self, now_s: float) -> bool:
        """Whether to ask again; asking is noted."""
        if now_s - self._asked_at_s < TIMESYNC_PERIOD_S:
            return False
        self._asked_at_s = now_s
        return True

    def asks(self, now_s: float) -> int:
        """The stamp of a request sent now, nanoseconds."""
        self._asked_ns.append(round(now_s * 1e9))
        return self._asked_ns[-1]

    def has_asked(self, stamp_ns: int) -> bool:
        """Whether an answer with this stamp is to us: other tools ask on the same link."""
        return stamp_ns in self._asked_ns

    def answered(self, asked_s: float, vehicle_boot_s: float, now_s: float) -> None:
        """Take one TIMESYNC answer: when it was asked, and the vehicle's clock in it."""
        round_trip_s = now_s - asked_s
        if now_s - self._best_at_s > CLOCKS_AGREE_S:
            self._best_round_trip_s = math.inf
        if not 0.0 <= round_trip_s <= self._best_round_trip_s:
            return
        self._best_at_s = now_s
        self._best_round_trip_s = round_trip_s
        self._boot_at_s = now_s - round_trip_s / 2.0 - vehicle_boot_s

    def to_ours(self, boot_s: float, received_s: float) -> float:
        """Our time of a vehicle's time stamp; the time of receipt while the clock is unknown."""
        if self._boot_at_s is None:
            return received_s
        return min(received_s, self._boot_at_s + boot_s)

    def restarted(self) -> None:
        """Forget everything: the vehicle has booted again; late answers are of its former clock."""
        self.__init__()  # type: ignore[misc]


class LeaderTrack:
    """The newest believable report of the leader."""

    def __init__(self) -> None:
        self.clock = VehicleClock()
        self.drift = Drift()
        self.clocks = BootClocks()
        self.fix: LeaderFix | None = None
        self.rejected = 0
        self._newest_boot_ms = -1
        self._candidate: LeaderFix | None = None
        self.agreeing = 0
        """How many reports in a row agree with the first of a new place."""
        self.jump_m: Horizontal = (0.0, 0.0)
        """How far (north, east) the place that is looked at now, or the last one, is away."""
        self.jump_since_s: float | None = None
        """The last report before it; None: no place is looked at."""
        self.oldest_s = 0.0
        """How old a report has lately been when the next came."""
        self.total_m: Horizontal = (0.0, 0.0)
        """All jumps that were believed, (north, east); back again in this sum too."""
        self.jumps = 0
        """How often the leader has turned up somewhere else and been believed there."""

    def receive(self, message: Any, now_s: float) -> None:
        """Take a GLOBAL_POSITION_INT; late duplicates and reordered ones are dropped."""
        boot_ms = message.time_boot_ms
        if is_late(boot_ms, self._newest_boot_ms):
            return
        if not self.clocks.is_believed(boot_ms / 1e3, now_s):
            return
        restarted = boot_ms < self._newest_boot_ms
        if restarted:
            self.clock.restarted()
            self.drift = Drift()
        self._newest_boot_ms = boot_ms
        boot_s = boot_ms / 1000.0
        velocity = (message.vx / 100.0, message.vy / 100.0, message.vz / 100.0)
        time_s = self.clock.to_ours(boot_s, now_s)
        if self.fix is not None and not restarted:
            # A quicker TIMESYNC answer moves the clock; a newer report must not become older.
            time_s = max(time_s, self.fix.time_s)
        fix = LeaderFix(
            time_s=time_s,
            position=GlobalPosition(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3),
            velocity_ned_mps=velocity,
            heading_rad=heading_of(message, 0.0 if self.fix is None else self.fix.heading_rad),
            acceleration_ned_mps2=self._acceleration(time_s, velocity),
        )
        if self._believable(fix):
            self.drift.reported(replace(report_of(fix), time_s=boot_s))
            age_s = 0.0 if self.fix is None else now_s - self.fix.time_s
            self.oldest_s = max(age_s, OLDEST_KEEPS * self.oldest_s)
            self.fix = fix

    def _acceleration(self, time_s: float, velocity: Ned) -> Ned:
        """Between the last report and this one, limited to what copters do; 0 after a gap."""
        if self.fix is None:
            return (0.0, 0.0, 0.0)
        elapsed_s = time_s - self.fix.time_s
        change = changes_mps2(self.fix.velocity_ned_mps, velocity, elapsed_s, LONGEST_GAP_S)
        north, east, down = (max(-MOST_MPS2, min(MOST_MPS2, one)) for one in change)
        return north, east, down

    def _believable(self, fix: LeaderFix) -> bool:
        agrees = self._agrees(fix)
        if self.fix is None or (not agrees and not _jumps(self.fix, fix)):
            self.agreeing, self._candidate, self.jump_since_s = 0, None, None
            return True
        self.rejected += 1
        self.drift.jumped()
        self.agreeing = self.agreeing + 1 if agrees else 0
        if not agrees:
            self.jump_m = beyond_movement_m(report_of(self.fix), report_of(fix))
            self.jump_since_s = self.fix.time_s
        self._candidate = fix
        if self.agreeing < AGREEING_REPORTS:
            return False
        self.jumps += 1
        self._believed()
        return True

    def _agrees(self, fix: LeaderFix) -> bool:
        """Whether a report belongs to the new place that is looked at.

        It does if it is nearer to the new place than to where the last believed report leads. The
        time since then must not count: a vehicle can fly 6 m in two seconds, and a jump of 6 m
        would pass for a movement.
        """
        if self.fix is None or self._candidate is None or _jumps(self._candidate, fix):
            return False
        return _off_m(self._candidate, fix) < _off_m(self.fix, fix)

    def believe_jump(self) -> Horizontal:
        """Believe the new place now: it is known to be the receiver's. Returns the jump."""
        self.fix, self.agreeing = self._candidate, 0
        self._believed()
        return self.jump_m

    def _believed(self) -> None:
        self.jump_since_s = None
        self.total_m = self.total_m[0] + self.jump_m[0], self.total_m[1] + self.jump_m[1]


def changes_mps2(
    before_mps: Sequence[float], after_mps: Sequence[float], elapsed_s: float, longest_s: float
) -> tuple[float, ...]:
    """How a velocity changes between two reports, axis by axis; not at all after a longer gap."""
    if not 0.0 < elapsed_s < longest_s:
        return (0.0,) * len(before_mps)
    return tuple((b - a) / elapsed_s for a, b in zip(before_mps, after_mps, strict=True))


def is_late(boot_ms: int, newest_boot_ms: int) -> bool:
    """Whether a report is a duplicate of the newest, or older: delayed, not after a reboot."""
    return 0 <= newest_boot_ms - boot_ms <= 1000.0 * REBOOT_S


def report_of(fix: LeaderFix) -> Report:
    """A fix of the leader as what alignment keeps of any vehicle."""
    return Report(fix.time_s, fix.position, fix.velocity_ned_mps[:2], fix.heading_rad)


def _off_m(before: LeaderFix, after: LeaderFix) -> float:
    return math.hypot(*beyond_movement_m(report_of(before), report_of(after)))


def _jumps(before: LeaderFix, after: LeaderFix) -> bool:
    return is_jump(report_of(before), report_of(after))
