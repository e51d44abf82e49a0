"""`echowing rig axis-test`: orders where to look against the autopilot's IMU, and echoes."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.rig.axis_echoes import Echoes
from echowing.rig.bench import POLL_S, Bench, add_bench_arguments, ignore, perform, positive, whole
from echowing.rig.board import ScanMode
from echowing.rig.orders import EARTH_FRAME, Direction, Orders, looked
from echowing.rig.readings import percentile
from echowing.rig.result import Check, Result

EXAMPLES = """\
examples:
  echowing rig axis-test
  echowing rig axis-test --target 3
  echowing rig --port /dev/ttyUSB0 --baud 57600 axis-test --still --no-target --host-ms 300
      by radio, through the autopilot; alone, and the vehicle stays where it is
"""

ROUNDS = 3
SECONDS = 15.0
HOST_MS = 20.0  # as latency-test's
TARGET_M = 2.0
# Within the default reach of 60 and 30 degrees, from a vehicle that stands a little aslant.
SIDE_DEG, UP_DEG = 30.0, 15.0
MOVES = {
    "left": (-SIDE_DEG, 0.0),
    "right": (SIDE_DEG, 0.0),
    "up": (0.0, UP_DEG),
    "down": (0.0, -UP_DEG),
}
MOVE_S = 1.0
# How near the axis has to come to its order, and how near it has to stay: a servo's frame of 20 ms
# and its way of 15 ms, while a hand turns the vehicle by 60 degrees a second, are 2 degrees; a
# degree for pulses and clocks.
NEAR_DEG = 3.0
SHARE = 0.95
# So far a hand has to turn the vehicle each way; less would not show whether the axis stays.
LEAST_TURN_DEG = 10.0
# From an order to the first report of other pulses: 4 ms on the wire, a servo's frame of 20 ms, the
# step of a reading beside it, and a period of the reports.
DELAY_LIMIT_MS = 100.0
# From the pulses to the reading that tells of the arrival: a frame and the servo's way to move
# (35 ms), the ping before which it came too late, its reading (up to 100 ms), and its messages.
TOLD_MS = 35.0 + 100.0 + 20.0


@dataclass(frozen=True)
class Told:
    """A reading's axis: when it arrived (s), when it was read (board's clock, ms), in the earth."""

    at_s: float
    read_ms: float
    axis: Direction
    limited: bool


@dataclass
class Move:
    """One order: where to, and what was told of it. Times in ms since it was first sent."""

    name: str
    order: Direction
    begun_s: float
    delay_ms: float | None = None
    arrived_ms: float | None = None
    end: Direction | None = None

    @property
    def off_deg(self) -> float:
        """How far from the order it ended; without an end as far as can be."""
        return 180.0 if self.end is None else self.end.apart_deg(self.order)


@dataclass
class Ears:
    """What the board's messages say of its axis."""

    in_body: int = 0  # readings whose axis is not in the earth frame: no attitude
    axes: list[Told] = field(default_factory=list)
    pointed: list[tuple[float, Direction]] = field(default_factory=list)  # arrival; body frame

    def hear(self, message: Any) -> None:
        """Take any message of the board's."""
        at_s = float(message._timestamp)
        kind = message.get_type()
        if kind == "DISTANCE_SENSOR" and any(message.quaternion):
            self.pointed.append((at_s, looked(message.quaternion)))
        if kind != "GIMBAL_DEVICE_ATTITUDE_STATUS":
            return
        if message.flags != EARTH_FRAME:
            self.in_body += 1
            return
        axis, limited = looked(message.q), message.failure_flags != 0
        self.axes.append(Told(at_s, float(message.time_boot_ms), axis, limited))

    def turned_deg(self) -> tuple[float, float]:
        """How far the gimbal has panned and tilted in all: so far the vehicle was turned."""
        if not self.pointed:
            return 0.0, 0.0
        pans = [direction.right_deg for _, direction in self.pointed]
        tilts = [direction.up_deg for _, direction in self.pointed]
        return max(pans) - min(pans), max(tilts) - min(tilts)

    def fastest_dps(self) -> float:
        """The fastest way from one reading's axis to the next one's; 0 without two."""
        pairs = zip(self.axes, self.axes[1:], strict=False)
        return max(
            (
                1000.0 * a.axis.apart_deg(b.axis) / (b.read_ms - a.read_ms)
                for a, b in pairs
                if b.read_ms > a.read_ms
            ),
            default=0.0,
        )


class AxisTest:
    """The procedure: order it to each side, over a target, and to stay while the vehicle is turned.

    target_m: how far the target hangs; None: there is none. still: nobody turns the vehicle.
    """

    def __init__(
        self, rounds: int, seconds: float, host_ms: float, *, target_m: float | None, still: bool
    ) -> None:
        self._rounds = rounds
        self._seconds = seconds
        self._host_ms = host_ms
        self._still = still
        self._parameters: Mapping[str, float] = {}
        self.at_rest = Ears()
        self.moving = Ears()
        self.steady = Ears()
        self.moves: list[Move] = []
        self.echoes = None if target_m is None else Echoes(target_m, 2 * rounds)
        self.ahead: Direction | None = None

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        self._parameters = bench.board.parameters()
        bench.ask(
            "Propellers off, disarmed, the autopilot on. Stand the vehicle level, the gimbal free."
        )
        bench.board.scan(ScanMode.AUTO)  # refused in flight: nothing here is for the air
        for message in bench.listen("looking straight ahead", 2.0):
            self.at_rest.hear(message)
        if not self.at_rest.axes:
            return
        self.ahead = Direction(self.at_rest.axes[-1].axis.right_deg, 0.0)
        orders = Orders(bench)
        try:
            for number in range(self._rounds):
                self._move_round(bench, orders, self.ahead, number)
            if self.echoes is not None:
                self.echoes.run(bench, orders, self._parameters, self.ahead)
            if not self._still:
                self._turn(bench, orders, self.ahead)
        finally:
            orders.end(self.ahead)

    def _move_round(self, bench: Bench, orders: Orders, ahead: Direction, number: int) -> None:
        text = f"left, right, up, down: {number + 1} of {self._rounds}"
        total_s = 2.0 * MOVE_S * len(MOVES)
        with bench.operator.progress(text, total_s) as show:
            for step, (name, (right_deg, up_deg)) in enumerate(MOVES.items()):
                show(2.0 * MOVE_S * step, name)
                _hear(orders.hold(ahead, MOVE_S), self.moving.hear)
                order = Direction(ahead.right_deg + right_deg, up_deg)
                self._move(orders, Move(name, order, bench.clock()))

    def _move(self, orders: Orders, move: Move) -> None:
        """Order it, and note the first sign of other pulses, and the arrival."""
        before = self.moving.pointed[-1][1] if self.moving.pointed else None
        self.moves.append(move)
        orders.at_once()

        def hear(message: Any) -> None:
            self.moving.hear(message)
            since_ms = 1000.0 * (message._timestamp - move.begun_s)
            _note_pulses(self.moving, move, before, since_ms)
            if message.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS" and self.moving.axes:
                move.end = self.moving.axes[-1].axis
                if move.arrived_ms is None and move.off_deg <= NEAR_DEG:
                    move.arrived_ms = since_ms

        _hear(orders.hold(move.order, MOVE_S), hear)

    def _turn(self, bench: Bench, orders: Orders, ahead: Direction) -> None:
        bench.ask(
            f"For {self._seconds:g} s turn the vehicle by hand: nose up and down, left and right, "
            "by some 20 degrees each. The sonar should go on looking at the same place."
        )
        with bench.operator.progress("turn it by hand", self._seconds) as show:
            begun_s = bench.clock()
            _hear(orders.hold(ahead, 1.0), ignore)
            while (done_s := bench.clock() - begun_s) < self._seconds:
                pan_deg, tilt_deg = self.steady.turned_deg()
                show(done_s, f"turned {pan_deg:.0f} and {tilt_deg:.0f} degrees")
                _hear(orders.hold(ahead, POLL_S), self.steady.hear)

    # ---- judging

    def result(self) -> Result:
        """As `Procedure`."""
        result = Result("axis-test", "Axis test", [self._attitude_check()])
        if self.moves:
            result.checks = [
                *result.checks,
                *(self._move_check(name) for name in MOVES),
                self._delay_check(),
                self._arrival_check(),
                self._speed_check(),
            ]
        echoes = self.echoes
        if echoes is not None:
            result.checks = [*result.checks, *echoes.checks()]
        if self.steady.axes:
            result.checks = [*result.checks, *self._steady_checks()]
        result.measured = {
            "moves": [
                {
                    "name": move.name,
                    "delay_ms": _rounded(move.delay_ms),
                    "arrived_ms": _rounded(move.arrived_ms),
                    "off_deg": _rounded(move.off_deg),
                }
                for move in self.moves
            ],
            "fastest_dps": _rounded(self.moving.fastest_dps()),
            "turned_deg": [_rounded(angle) for angle in self.steady.turned_deg()],
            "off_deg": [_rounded(off) for off in self._offs_deg()],
            "echoes": [sweep.as_dict() for sweep in echoes.sweeps] if echoes is not None else [],
        }
        result.grids = [self._grid()] if self.moves else []
        if echoes is not None and echoes.sweeps:
            result.grids = [*result.grids, echoes.grid()]
            result.figures = {"echoes": echoes.figure()}
        if self.steady.axes:
            result.figures = {**result.figures, "steady": self._steady_figure()}
        result.notes = [_TOLD + (_UNSEEN if echoes is None else _SEEN)]
        return result

    def _attitude_check(self) -> Check:
        """Of the moves and the turning: at first attitude still has to be asked for."""
        ears = (self.moving, self.steady) if self.moves else (self.at_rest,)
        told = sum(len(part.axes) for part in ears)
        readings = told + sum(part.in_body for part in ears)
        found = f"with {told} of {readings} readings"
        if not readings:
            found = "no reading came with an axis: is the firmware from before?"
        elif not told:
            found += ": does the autopilot's TX reach the board, and is SYS_ID right?"
        asked = f"{SHARE:.0%}: the autopilot tells its attitude 25 times a second"
        return Check("attitude", found, asked, readings > 0 and told >= SHARE * readings)

    def _move_check(self, name: str) -> Check:
        moves = [move for move in self.moves if move.name == name]
        worst = max(moves, key=lambda move: move.off_deg)
        right, up = MOVES[name]
        found = f"{worst.off_deg:.1f} degrees off at worst"
        if worst.off_deg > NEAR_DEG:
            found += "; does the vehicle stand aslant?"
        asked = f"within {NEAR_DEG:g} degrees of {abs(right or up):g} to that side"
        return Check(name, found, asked, worst.off_deg <= NEAR_DEG)

    def _delay_check(self) -> Check:
        limit_ms = DELAY_LIMIT_MS + self._host_ms
        delays_ms = [move.delay_ms for move in self.moves if move.delay_ms is not None]
        asked = (
            f"each under {limit_ms:g} ms: {DELAY_LIMIT_MS:g} ms for wire, frame and report, "
            f"{self._host_ms:g} ms for the USB serial chip and this computer"
        )
        return _times_check("delay, order to pulses", delays_ms, len(self.moves), limit_ms, asked)

    def _arrival_check(self) -> Check:
        way_ms = max(
            1000.0 * angle_deg * abs(self._parameters[scale]) / self._parameters["SERVO_RATE"]
            for angle_deg, scale in ((SIDE_DEG, "PAN_US_DEG"), (UP_DEG, "TILT_US_DEG"))
        )
        period_ms = self._parameters["SONAR_PERIOD"] + self._parameters["SONAR_JITTER"]
        limit_ms = DELAY_LIMIT_MS + way_ms + TOLD_MS + period_ms + self._host_ms
        arrived_ms = [move.arrived_ms for move in self.moves if move.arrived_ms is not None]
        asked = (
            f"each under {limit_ms:g} ms: the delay, {way_ms:g} ms at SERVO_RATE, and the reading "
            "that tells of it"
        )
        return _times_check("order to arrival", arrived_ms, len(self.moves), limit_ms, asked)

    def _speed_check(self) -> Check:
        """Between two readings 100 ms apart half of the way may be over: half of the speed."""
        rate = self._parameters["SERVO_RATE"]
        said_dps = rate / max(abs(self._parameters["PAN_US_DEG"]), 1e-3)
        # A way that is made within one period cannot show more than itself in that time.
        shown_dps = min(said_dps, 1000.0 * SIDE_DEG / self._parameters["SONAR_PERIOD"]) / 2.0
        found_dps = self.moving.fastest_dps()
        found = f"at least {found_dps:.0f} degrees a second"
        asked = (
            f"at least {shown_dps:.0f}, as two readings show them of SERVO_RATE's {said_dps:.0f}"
        )
        return Check("speed", found, asked, found_dps >= shown_dps)

    def _offs_deg(self) -> list[float]:
        """How far off the order, within the servos' reach."""
        if self.ahead is None:
            return []
        return [told.axis.apart_deg(self.ahead) for told in self.steady.axes if not told.limited]

    def _steady_checks(self) -> list[Check]:
        pan_deg, tilt_deg = self.steady.turned_deg()
        turned = Check(
            "turned by hand",
            f"{pan_deg:.0f} degrees left and right, {tilt_deg:.0f} up and down",
            f"at least {LEAST_TURN_DEG:g} each",
            min(pan_deg, tilt_deg) >= LEAST_TURN_DEG,
        )
        offs_deg = self._offs_deg()
        beyond = len(self.steady.axes) - len(offs_deg)
        most_deg = percentile(offs_deg, SHARE)
        found = f"{SHARE:.0%} of {len(offs_deg)} readings within {most_deg:.1f} degrees"
        if beyond:
            found += f"; {beyond} with the order beyond the servos' reach are left out"
        if not offs_deg:
            found = "every reading had the order beyond the servos' reach: turn it less"
        stays = Check(
            "axis stays",
            found,
            f"within {NEAR_DEG:g} degrees of the order",
            bool(offs_deg) and most_deg <= NEAR_DEG,
        )
        return [turned, stays]

    def _grid(self) -> Grid:
        head = ("order", "times", "delay, ms", "arrived, ms", "off, deg")
        rows = []
        for name in MOVES:
            moves = [move for move in self.moves if move.name == name]
            delays = [move.delay_ms for move in moves if move.delay_ms is not None]
            arrived = [move.arrived_ms for move in moves if move.arrived_ms is not None]
            off = max(move.off_deg for move in moves)
            cells = (_most(delays), _most(arrived), f"{off:.1f}")
            rows.append(Row((name, str(len(moves)), *cells)))
        return Grid("Orders, the worst of each", head, tuple(rows))

    def _steady_figure(self) -> plots.Figure:
        assert self.ahead is not None
        begun_s = self.steady.pointed[0][0] if self.steady.pointed else 0.0
        pulses = [(at_s - begun_s, way) for at_s, way in self.steady.pointed]
        axes = [(told.at_s - begun_s, told.axis.apart_deg(self.ahead)) for told in self.steady.axes]
        traces = [
            _line("gimbal, right", [(t, way.right_deg) for t, way in pulses], plots.QUIET_COLOUR),
            _line("gimbal, up", [(t, way.up_deg) for t, way in pulses], "#c7741a"),
            _line("axis off its order", axes, plots.FOLLOWER_COLOUR),
        ]
        return plots.chart("Turned by hand", "s", "degrees", traces)


_TOLD = (
    "The axis is what the board tells with each reading: its pulses, the way that servos of "
    "SERVO_RATE make in the time, and the attitude at the ping. "
)
_SEEN = "Where the sonar really looks its echoes tell: the checks with `really`."
_UNSEEN = "Without a target nothing tells where the sonar really looks: watch it."


def _hear(messages: Iterable[Any], hear: Callable[[Any], None]) -> None:
    for message in messages:
        hear(message)


def _note_pulses(ears: Ears, move: Move, before: Direction | None, since_ms: float) -> None:
    """The first report in which the gimbal points elsewhere than before the order."""
    if move.delay_ms is not None or before is None or not ears.pointed:
        return
    if ears.pointed[-1][1].apart_deg(before) > NEAR_DEG:
        move.delay_ms = since_ms


def _times_check(
    what: str, times_ms: Sequence[float], wanted: int, limit_ms: float, asked: str
) -> Check:
    missing = wanted - len(times_ms)
    found = f"{len(times_ms)} of {wanted} seen"
    if times_ms:
        found = f"{min(times_ms):.0f} to {max(times_ms):.0f} ms" + (f", {found}" * bool(missing))
    return Check(what, found, asked, not missing and max(times_ms) < limit_ms)


def _most(values: Sequence[float]) -> str:
    return f"{max(values):.0f}" if values else "-"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def _line(name: str, points: Sequence[tuple[float, float]], colour: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": [round(x, 3) for x, _ in points],
        "y": [round(y, 2) for _, y in points],
        "line": {"color": colour, "width": 2},
    }


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument(
        "--rounds", type=whole, default=ROUNDS, metavar="N", help="rounds of the four orders (3)"
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        default=SECONDS,
        metavar="S",
        help="seconds to turn the vehicle by hand (15)",
    )
    target = parser.add_mutually_exclusive_group()
    target.add_argument(
        "--target",
        type=positive,
        default=TARGET_M,
        metavar="M",
        help=f"how far from the sonar the target is put, metres ({TARGET_M:g})",
    )
    target.add_argument(
        "--no-target", action="store_true", help="no echoes: nothing tells where the servos are"
    )
    parser.add_argument(
        "--still", action="store_true", help="the orders only: nobody turns the vehicle"
    )
    parser.add_argument(
        "--host-ms",
        type=positive,
        default=HOST_MS,
        metavar="MS",
        help=f"what USB and this computer may add to the board's own limits ({HOST_MS:g})",
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""
    target_m = None if args.no_target else args.target
    procedure = AxisTest(
        args.rounds, args.seconds, args.host_ms, target_m=target_m, still=args.still
    )
    return perform(procedure, args)
