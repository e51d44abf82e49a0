"""Where the sonar really looks: echoes of a target over which the gimbal sweeps.

The board tells where it has sent its servos. Where they are only an echo tells: heard around the
target, and lost on both sides of it.
"""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.rig.bench import Bench
from echowing.rig.orders import EARTH_FRAME, Direction, Orders, looked
from echowing.rig.range_test import TARGET_GATE_M
from echowing.rig.readings import heard_m, value_of
from echowing.rig.result import Check

# As far from the vehicle's nose as a tape and an eye put a target (5 cm at 2 m and two degrees of
# yaw are 3), and as far off as a horn stands that was put on the nearest tooth.
PLACED_DEG = 6.0
# So much of the way to a target aside the echoes may be off: the edges of a soft beam are known to
# some degrees, and which way a servo turns and by its scale or another's is a question of twice.
ASIDE_SHARE = 0.5
# How much later than the board tells the axis may be there: 6 degrees where a vehicle turns by 80
# degrees a second, half of a narrow beam.
LATE_LIMIT_MS = 75.0
# A sweep is this fast, or half of SERVO_RATE where that is less: it leaves the servos no time.
SWEEP_DPS = {"pan": 80.0, "tilt": 40.0}
# So many readings beyond an edge make it one.
LEAST_BEYOND = 4
# How much likelier a reading is within the edges than beyond them, as a logarithm: with 80 % heard
# there and 5 % beyond.
HEARD, LOST = math.log(0.8 / 0.05), math.log(0.2 / 0.95)
# How much more of the readings is of the target within the edges than beyond them: what hears half
# of its target shows no edge.
LEAST_CONTRAST = 0.5
# How late an axis is looked for, and in which steps, degrees at the sweep's speed.
MOST_LATE_DEG, LATE_STEP_DEG = 40.0, 0.5


@dataclass(frozen=True)
class Servo:
    """How one is swept. aside_deg: where the target is put afterwards, to `side`."""

    name: str
    reach_deg: float
    side: str
    other_side: str
    aside_deg: float

    def direction(self, ahead: Direction, angle_deg: float) -> Direction:
        """So far off straight ahead with this servo."""
        if self.name == "pan":
            return Direction(ahead.right_deg + angle_deg, ahead.up_deg)
        return Direction(ahead.right_deg, ahead.up_deg + angle_deg)

    def angle_deg(self, ahead: Direction, axis: Direction) -> float:
        """How far off straight ahead an axis is with this servo."""
        if self.name == "pan":
            return math.remainder(axis.right_deg - ahead.right_deg, 360.0)
        return axis.up_deg - ahead.up_deg

    @property
    def scale(self) -> str:
        """Its parameter, pulse per degree."""
        return f"{self.name.upper()}_US_DEG"

    def where(self, angle_deg: float) -> str:
        """An angle in words."""
        return f"{abs(angle_deg):.1f} degrees {self.side if angle_deg >= 0.0 else self.other_side}"


PAN = Servo("pan", 60.0, "right", "left", 20.0)
TILT = Servo("tilt", 30.0, "up", "down", 12.0)


@dataclass(frozen=True)
class Ping:
    """A reading: where the board says its axis was, which way that moved, and whether it was heard.

    way: 1 to the right or up, -1 back.
    """

    angle_deg: float
    way: int
    heard: bool


@dataclass(frozen=True)
class Span:
    """Where the target is heard: told angles, None where the sweep ends before it is lost.

    late_deg: so far the axis is behind what is told; taken out of the angles. within, beyond: share
    of the readings.
    """

    from_deg: float | None
    to_deg: float | None
    late_deg: float
    within: float
    beyond: float

    @property
    def middle_deg(self) -> float | None:
        """Halfway."""
        if self.from_deg is None or self.to_deg is None:
            return None
        return (self.from_deg + self.to_deg) / 2.0

    def moved_deg(self, before: "Span") -> float:
        """How far its edges have moved; NaN where it has not one that the other has."""
        edges = (before.from_deg, self.from_deg), (before.to_deg, self.to_deg)
        moves = [now - then for then, now in edges if then is not None and now is not None]
        return sum(moves) / len(moves) if moves else math.nan


@dataclass
class Sweep:
    """Pings of a servo that goes to and fro, the target so far aside."""

    servo: Servo
    aside_deg: float
    speed_dps: float
    late_deg: float | None = None  # known from the sweep before
    pings: list[Ping] = field(default_factory=list)

    @property
    def heard_share(self) -> float:
        """Of all pings."""
        return sum(ping.heard for ping in self.pings) / max(1, len(self.pings))

    @cached_property
    def span(self) -> Span | None:
        """Where the target is heard, once the sweep has ended; None where nothing parts that."""
        late_deg = likely_late_deg(self.pings) if self.late_deg is None else self.late_deg
        return found_span(self.pings, late_deg)

    @property
    def late_ms(self) -> float | None:
        """How much later than told the axis is there."""
        span = self.span
        return None if span is None else 1000.0 * span.late_deg / self.speed_dps

    def as_dict(self) -> dict[str, Any]:
        """For the JSON document."""
        span = self.span
        return {
            "servo": self.servo.name,
            "target_deg": self.aside_deg,
            "late_ms": self.late_ms,
            "from_deg": None if span is None else span.from_deg,
            "to_deg": None if span is None else span.to_deg,
            "pings": [(round(p.angle_deg, 2), p.way, p.heard) for p in self.pings],
        }


def likely_late_deg(pings: Sequence[Ping]) -> float:
    """How far the axis is behind what is told.

    An axis that is late is heard later on the way out and on the way back: moved back by as much,
    both ways agree.
    """
    steps = round(MOST_LATE_DEG / LATE_STEP_DEG)
    shifts = [LATE_STEP_DEG * step for step in range(-steps // 4, steps + 1)]
    scores = [_stretch(_shifted(pings, shift))[0] for shift in shifts]
    likely = [math.exp(score - max(scores)) for score in scores]
    return sum(map(float.__mul__, shifts, likely)) / sum(likely)


def found_span(pings: Sequence[Ping], late_deg: float) -> Span | None:
    """The stretch that parts heard from lost best.

    None: not heard, heard everywhere, or here and there.
    """
    ordered = _shifted(pings, late_deg)
    best, start, end = _stretch(ordered)
    from_deg = _edge_deg(ordered, start, beyond=start)
    to_deg = _edge_deg(ordered, end, beyond=len(ordered) - end)
    if best == 0.0 or (from_deg is None and to_deg is None):
        return None
    within, beyond = map(_share, (ordered[start:end], ordered[:start] + ordered[end:]))
    if within - beyond < LEAST_CONTRAST:
        return None
    return Span(from_deg, to_deg, late_deg, within, beyond)


def _edge_deg(ordered: Sequence[tuple[float, bool]], at: int, *, beyond: int) -> float | None:
    """Between the readings before and after; too few beyond it are no edge."""
    return (ordered[at - 1][0] + ordered[at][0]) / 2.0 if beyond >= LEAST_BEYOND else None


def _share(ordered: Sequence[tuple[float, bool]]) -> float:
    return sum(heard for _, heard in ordered) / len(ordered)


def _shifted(pings: Sequence[Ping], late_deg: float) -> list[tuple[float, bool]]:
    return sorted((ping.angle_deg - ping.way * late_deg, ping.heard) for ping in pings)


def _stretch(ordered: Sequence[tuple[float, bool]]) -> tuple[float, int, int]:
    """The likeliest stretch: its weight, from which, and up to before which."""
    best, total, begun = (0.0, 0, 0), 0.0, 0
    for index, (_, heard) in enumerate(ordered):
        total += HEARD if heard else LOST
        if total > best[0]:
            best = (total, begun, index + 1)
        if total < 0.0:
            total, begun = 0.0, index + 1
    return best


@dataclass
class _Ears:
    """Joins each reading with the axis that comes after it, of the same time."""

    sweep: Sweep
    ahead: Direction
    distance_m: float
    raw: tuple[int, float] | None = None
    before_deg: float | None = None

    def hear(self, message: Any) -> None:
        """Take any message of the board's."""
        raw_m = value_of(message, "SNR_RAW")
        if raw_m is not None:
            self.raw = (message.time_boot_ms, raw_m)
        if message.get_type() != "GIMBAL_DEVICE_ATTITUDE_STATUS" or self.raw is None:
            return
        if message.flags == EARTH_FRAME and message.time_boot_ms == self.raw[0]:
            self._take(self.sweep.servo.angle_deg(self.ahead, looked(message.q)), self.raw[1])

    def _take(self, angle_deg: float, raw_m: float) -> None:
        before_deg, self.before_deg = self.before_deg, angle_deg
        if before_deg is None:
            return
        reading_m = heard_m(raw_m)
        heard = reading_m is not None and abs(reading_m - self.distance_m) <= TARGET_GATE_M
        self.sweep.pings.append(Ping(angle_deg, 1 if angle_deg >= before_deg else -1, heard))


class Echoes:
    """The procedure: sweep over a target straight ahead, then over one to the right, one above."""

    def __init__(self, distance_m: float, turns: int) -> None:
        self._distance_m = distance_m
        self._turns = turns
        self.sweeps: list[Sweep] = []

    def run(
        self, bench: Bench, orders: Orders, parameters: Mapping[str, float], ahead: Direction
    ) -> None:
        """Have the target put, and sweep."""
        distance = f"{self._distance_m:g} m"
        bench.ask(
            f"Hang the target {distance} from the sonar: straight ahead of the nose, as high as "
            "the sonar, nothing else near it, and step aside."
        )
        straight = [Sweep(servo, 0.0, _speed_dps(servo, parameters)) for servo in (PAN, TILT)]
        for sweep in straight:
            self._sweep(bench, orders, parameters, ahead, sweep)
        for sweep in straight:
            servo, span = sweep.servo, sweep.span
            if span is None or span.middle_deg is None:
                continue
            away_m = self._distance_m * math.sin(math.radians(servo.aside_deg))
            way = "to the right" if servo is PAN else "up from straight ahead"
            bench.ask(f"Now the target {away_m:.2f} m {way}, again {distance} from the sonar.")
            aside = replace(sweep, aside_deg=servo.aside_deg, late_deg=span.late_deg, pings=[])
            self._sweep(bench, orders, parameters, ahead, aside)

    def _sweep(
        self,
        bench: Bench,
        orders: Orders,
        parameters: Mapping[str, float],
        ahead: Direction,
        sweep: Sweep,
    ) -> None:
        servo, speed_dps = sweep.servo, sweep.speed_dps
        reach_deg = min(servo.reach_deg, parameters[f"{servo.name.upper()}_REACH"])
        self.sweeps.append(sweep)
        ears = _Ears(sweep, ahead, self._distance_m)
        for message in orders.hold(servo.direction(ahead, -reach_deg), 1.0):
            ears.hear(message)
        # Without odd waits at its ends each pass would be read at the same angles.
        chance = random.Random(1)
        pass_s = 2.0 * reach_deg / speed_dps
        text = f"{servo.name} to and fro, the target {servo.where(sweep.aside_deg)}"
        with bench.operator.progress(text, 2.0 * self._turns * pass_s) as show:
            for number in range(2 * self._turns):
                show(number * pass_s, f"heard {sweep.heard_share:.0%}")
                way = 1.0 if number % 2 == 0 else -1.0
                path = _path(servo, ahead, -way * reach_deg, way * speed_dps)
                rate_dps = {"right_dps" if servo is PAN else "up_dps": way * speed_dps}
                end = servo.direction(ahead, way * reach_deg)
                waits_s = chance.uniform(0.0, parameters["SONAR_PERIOD"] / 1000.0)
                for message in chain(
                    orders.follow(path, pass_s, **rate_dps), orders.hold(end, waits_s)
                ):
                    ears.hear(message)

    # ---- judging

    def checks(self) -> list[Check]:
        """What the echoes say of each servo."""
        return [check for servo in (PAN, TILT) for check in self._servo_checks(servo)]

    def _servo_checks(self, servo: Servo) -> list[Check]:
        straight = self._of(servo, 0.0)
        if straight is None:
            return []
        span = straight.span
        middle_deg = None if span is None else span.middle_deg
        moves = Check(
            f"{servo.name} really moves",
            _heard_words(straight),
            "heard around the target, and lost on both sides of it",
            middle_deg is not None,
        )
        if span is None or middle_deg is None:
            return [moves]
        middle = Check(
            f"{servo.name} really looks ahead",
            f"heard around {servo.where(middle_deg)}",
            f"within {PLACED_DEG:g} degrees of the target",
            abs(middle_deg) <= PLACED_DEG,
        )
        return [moves, middle, _late_check(straight), *self._aside_checks(servo, span)]

    def _aside_checks(self, servo: Servo, straight: Span) -> list[Check]:
        aside = self._of(servo, servo.aside_deg)
        if aside is None:
            return []
        span = aside.span
        found, passed = _heard_words(aside), False
        if span is not None:
            moved_deg = span.moved_deg(straight)
            found = f"heard {servo.where(moved_deg)} of where it was"
            passed = abs(moved_deg - servo.aside_deg) <= ASIDE_SHARE * servo.aside_deg
            if moved_deg < -ASIDE_SHARE * servo.aside_deg:
                found += f": the servo turns the other way, {servo.scale} needs the other sign"
        asked = f"{servo.where(servo.aside_deg)} as the target, within {ASIDE_SHARE:.0%} of it"
        return [Check(f"{servo.name} really turns {servo.side}", found, asked, passed)]

    def _of(self, servo: Servo, aside_deg: float) -> Sweep | None:
        for sweep in self.sweeps:
            if sweep.servo is servo and sweep.aside_deg == aside_deg and sweep.pings:
                return sweep
        return None

    def grid(self) -> Grid:
        """What was heard in each sweep."""
        head = ("servo", "target, deg", "pings", "heard from, deg", "to, deg", "late, ms")
        return Grid("Echoes of the target", head, tuple(Row(_cells(one)) for one in self.sweeps))

    def figure(self) -> plots.Figure:
        """Each ping that heard the target, over where the board said that it looked."""
        traces = [
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"{sweep.servo.name}, target {sweep.servo.where(sweep.aside_deg)}, {word}",
                "x": [round(ping.angle_deg, 1) for ping in sweep.pings if ping.heard == heard],
                "y": [level + (0.15 if heard else -0.15)] * _count(sweep, heard=heard),
                "marker": {
                    "size": 6,
                    "color": plots.FOLLOWER_COLOUR if heard else plots.QUIET_COLOUR,
                },
            }
            for level, sweep in enumerate(self.sweeps, 1)
            for heard, word in ((True, "heard"), (False, "lost"))
        ]
        return plots.chart("Heard, over the angle told", "degrees", "sweep", traces)


def _speed_dps(servo: Servo, parameters: Mapping[str, float]) -> float:
    fastest_dps = parameters["SERVO_RATE"] / max(1e-3, abs(parameters[servo.scale]))
    return min(SWEEP_DPS[servo.name], fastest_dps / 2.0)


def _path(
    servo: Servo, ahead: Direction, from_deg: float, speed_dps: float
) -> Callable[[float], Direction]:
    return lambda t_s: servo.direction(ahead, from_deg + speed_dps * t_s)


def _late_check(sweep: Sweep) -> Check:
    late_ms = sweep.late_ms or 0.0
    return Check(
        f"{sweep.servo.name} really in time",
        f"{late_ms:.0f} ms later than the board tells",
        f"at most {LATE_LIMIT_MS:g} ms: the axis with each reading is as wrong as it is late",
        late_ms <= LATE_LIMIT_MS,
    )


def _heard_words(sweep: Sweep) -> str:
    """Where the target was heard, or what that it was not may mean."""
    name, share, span = sweep.servo.name, sweep.heard_share, sweep.span
    if span is not None:
        begin, end = (_edge_words(sweep.servo, at) for at in (span.from_deg, span.to_deg))
        shares = f"{span.within:.0%} of the readings there, {span.beyond:.0%} beyond"
        return f"heard from {begin} to {end}: {shares}"
    if share >= 0.5:
        return (
            f"heard wherever it was sent ({share:.0%}): the {name} servo does not turn, or the "
            "target is too wide or too near"
        )
    return (
        f"not heard around one place ({share:.0%} of the readings): the {name} servo does not turn "
        "as it is sent, or the target is not there"
    )


def _edge_words(servo: Servo, edge_deg: float | None) -> str:
    return "where the sweep ends" if edge_deg is None else servo.where(edge_deg)


def _cells(sweep: Sweep) -> tuple[str, ...]:
    span, late_ms = sweep.span, sweep.late_ms
    edges = (None, None) if span is None else (span.from_deg, span.to_deg)
    words = ["-" if edge is None else f"{edge:.1f}" for edge in edges]
    late = "-" if late_ms is None else f"{late_ms:.0f}"
    return sweep.servo.name, f"{sweep.aside_deg:g}", str(len(sweep.pings)), *words, late


def _count(sweep: Sweep, *, heard: bool) -> int:
    return sum(ping.heard == heard for ping in sweep.pings)
