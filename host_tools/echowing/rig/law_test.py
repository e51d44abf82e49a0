"""`echowing rig law-test`: the speed answers the range, the applet in the loop (Table 6)."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.analysis.thesis import FIGURE_28, TABLE_6
from echowing.errors import EchowingError
from echowing.rig.bench import Bench, add_bench_arguments, perform, positive
from echowing.rig.law_steps import BandRecord, Law, Sample, StepJudge
from echowing.rig.law_vehicles import AutopilotVehicle, BuiltInVehicle, LawVehicle
from echowing.rig.readings import TRACKING, average_m, named_value
from echowing.rig.result import Check, Result

EXAMPLES = """\
examples:
  echowing rig law-test
      the applet runs here, on a simulated vehicle; the board needs no autopilot
  echowing rig law-test --autopilot udpin:14550
      the applet runs on the autopilot the board is wired to: propellers off
"""

HOLD_S = 5.0
# A target that is not in its band after so many holds is not coming: as much to arrive as to stay.
ARRIVAL_HOLDS = 2.0
# Beyond the outer bands' edges by this: clear of the edge, and of the too-close guard (1.5 m).
BEYOND_M = 0.6
GIMBAL_MOVES = 3  # points of the figure 8 in one hold out of range: five seconds have sixteen
# The autopilot shows the board's own average: both in whole centimetres.
SAME_RANGE_M = 0.02
SECONDS_TO_ARM = 300.0
OUT_OF_RANGE = "out of range"


@dataclass
class Hold:
    """The target held in one band: how often the gimbal moved there, and while it tracked."""

    band: str
    gimbal_moves: int = 0
    moves_while_tracking: int = 0


@dataclass
class GimbalWatch:
    """Counts the gimbal's moves into the hold that is under way, if one is."""

    hold: Hold | None = None
    _pulses: dict[str, float] = field(default_factory=dict)
    _state: float | None = None
    _undecided: int = 0

    def hear(self, message: Any) -> None:
        """Take any message of the board's."""
        name, value = named_value(message) or ("", 0.0)
        if name == "SNR_STATE":
            self._hear_state(value)
        if name not in ("SNR_PAN", "SNR_TILT"):
            return
        moved = self._pulses.get(name, value) != value
        self._pulses[name] = value
        if self.hold is None or not moved:
            return
        self.hold.gimbal_moves += 1
        # In a search the pulses arrive before the state: the next state report decides.
        self._undecided += self._state == TRACKING

    def _hear_state(self, value: float) -> None:
        if self.hold is not None and value == TRACKING:
            self.hold.moves_while_tracking += self._undecided
        self._state, self._undecided = value, 0


def holds(law: Law) -> list[tuple[str, float | None]]:
    """Bands and where to hold the target, in an order that leaves every step room to be made.

    From the middle of the speeds: hold, all the way up, down, up, down. None: out of range.
    """
    far, small_far, monitor, small_near, near = law.bands()
    middle = {band.name: (band.from_m + band.to_m) / 2.0 for band in law.bands()}
    return [
        (monitor.name, middle[monitor.name]),
        (far.name, min(far.from_m + BEYOND_M, middle[far.name])),
        (small_near.name, middle[small_near.name]),
        (small_far.name, middle[small_far.name]),
        (near.name, near.to_m - BEYOND_M),
        (OUT_OF_RANGE, None),
    ]


class LawTest:
    """The procedure: a target held in each band, the speed watched all the time."""

    def __init__(
        self, make_vehicle: Callable[[Bench], LawVehicle], hold_s: float, *, hand_armed: bool
    ) -> None:
        self._make_vehicle = make_vehicle
        self._hold_s = hold_s
        self._hand_armed = hand_armed
        self._vehicle: LawVehicle | None = None
        self._running = False
        self._name = ""
        self._bench: Bench | None = None
        self._gimbal = GimbalWatch()
        self._average_m: float | None = None
        self.judge: StepJudge | None = None
        self.holds: list[Hold] = []
        self.range_errors_m: list[float] = []

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        self._bench = bench
        vehicle = self._vehicle = self._make_vehicle(bench)
        try:
            self._name = vehicle.name
            law = vehicle.law()
            self.judge = StepJudge(law)
            if not self._hand_armed:
                bench.search()
            for band, distance_m in holds(law):
                self._hold(bench, vehicle, band, distance_m)
        finally:
            vehicle.close()

    def _hold(self, bench: Bench, vehicle: LawVehicle, band: str, distance_m: float | None) -> None:
        where = "Take the target away: nothing in range."
        if distance_m is not None:
            where = f"{band}: hold the target at {distance_m:.2f} m."
        bench.ask(where, self._hear)
        if not self._running:
            self._running = True
            self._await_control(bench, vehicle)
        hold = Hold(band)
        self.holds.append(hold)
        self._gimbal.hold = hold
        self._listen_while_held(bench, hold)
        self._gimbal.hold = None

    def _listen_while_held(self, bench: Bench, hold: Hold) -> None:
        """Time counts from when the range is in the band: a hand and a radio take a while."""
        end_s = None
        for message in bench.listen(f"holding, {hold.band}", ARRIVAL_HOLDS * self._hold_s):
            self._hear(message)
            if end_s is None and self.judge is not None and self.judge.band == self._law_band(hold):
                end_s = bench.clock() + self._hold_s
            if end_s is not None and bench.clock() >= end_s:
                return

    def _law_band(self, hold: Hold) -> str | None:
        return None if hold.band == OUT_OF_RANGE else hold.band

    def _await_control(self, bench: Bench, vehicle: LawVehicle) -> None:
        """A real autopilot is armed by hand."""
        if vehicle.in_control():
            return
        bench.operator.tell(
            "Propellers off? Arm the autopilot in Guided (ECHO_ENABLE 1), target held where it is."
        )
        for message in bench.listen("waiting for the applet to take control", SECONDS_TO_ARM):
            self._hear(message)
            if vehicle.in_control():
                return
        raise EchowingError(
            f"the applet has not taken control within {SECONDS_TO_ARM:g} s: it acts while armed in "
            "Guided with ECHO_ENABLE 1"
        )

    def _hear(self, message: Any) -> None:
        """A message of the board's: on to the vehicle, and see what that did."""
        self._gimbal.hear(message)
        if message.get_type() == "DISTANCE_SENSOR":
            self._average_m = average_m(message)
        vehicle, judge, bench = self._vehicle, self.judge, self._bench
        if vehicle is None or judge is None or bench is None:
            return
        if not self._running:
            vehicle.idle()
            return
        for sample in vehicle.advance(bench.clock()):
            judge.hear(self._in_range(judge.law, sample))
        vehicle.hear(message)

    def _in_range(self, law: Law, sample: Sample) -> Sample:
        """A range beyond the detection limit is none to the law."""
        if sample.range_m is not None and self._average_m is not None:
            self.range_errors_m.append(abs(sample.range_m - self._average_m))
        if sample.range_m is not None and sample.range_m >= law.detect_m:
            return Sample(sample.t_s, None, sample.speed_mps, sample.guarded)
        return sample

    def result(self) -> Result:
        """As `Procedure`."""
        result = Result("law-test", "Speed for each range")
        judge = self.judge
        if judge is None:
            result.checks = [Check("response", "nothing was measured", "six bands", passed=False)]
            return result
        result.checks = [*self._band_checks(judge), *self._other_checks(judge)]
        result.measured = {
            "vehicle": self._name,
            "law": vars(judge.law),
            "bands": {
                name: {"right_steps": r.right, "wrong_steps": r.wrong, "held_s": round(r.held_s, 2)}
                for name, r in judge.records.items()
            },
            "steps": [vars(step) for step in judge.steps],
            "holds": [vars(hold) for hold in self.holds],
        }
        result.grids = [_matrix(judge)]
        result.page_grids = [_steps_grid(judge), _figure_28()]
        result.figures = {"speed": _speed_figure(judge.samples), "range": _range_figure(judge)}
        result.notes = [
            f"Law 0 of the applet, run by {self._name} on the board's own DISTANCE_SENSOR. Every "
            "change of the speed is judged by the band in which the range was, on the way between "
            "two bands too; where the too-close guard has the speed nothing is. At 4.5 m exactly "
            "the thesis's table tracks and its script searches; the script wins."
        ]
        return result

    def _band_checks(self, judge: StepJudge) -> list[Check]:
        period_s = judge.law.period_s
        return [
            Check(
                name,
                _found(record),
                _asked(record, period_s),
                record.answers(period_s, judge.sampled_s),
            )
            for name, record in judge.records.items()
        ]

    def _other_checks(self, judge: StepJudge) -> list[Check]:
        law = judge.law
        free = [sample.speed_mps for sample in judge.samples if not sample.guarded]
        inside = bool(free) and law.least_mps <= min(free) and max(free) <= law.most_mps
        away = next((hold for hold in self.holds if hold.band == OUT_OF_RANGE), Hold(OUT_OF_RANGE))
        tracked = sum(hold.moves_while_tracking for hold in self.holds)
        agree_m = max(self.range_errors_m[-1:], default=None)
        worst_m = _typical(self.range_errors_m)
        return [
            Check(
                "speed within its limits",
                f"{min(free):.1f} to {max(free):.1f} m/s" if free else "no speed reported",
                f"{law.least_mps:g} to {law.most_mps:g} m/s: a step that would reach one is not "
                "made (Figures 28 and 29)",
                inside,
            ),
            Check(
                "gimbal in range",
                f"moved {tracked} times while tracking",
                "stationary while the target is in range (Table 6)",
                tracked == 0 and any(hold.band != OUT_OF_RANGE for hold in self.holds),
            ),
            Check(
                "gimbal out of range",
                f"moved {away.gimbal_moves} times, speed changed {judge.lost_changes} times",
                f"the figure 8: at least {GIMBAL_MOVES} points; the speed stays",
                away.gimbal_moves >= GIMBAL_MOVES and judge.lost_changes == 0,
            ),
            Check(
                "the autopilot's range",
                "none" if agree_m is None else f"mostly within {worst_m:.3f} m of the board's",
                f"the board's average, within {SAME_RANGE_M:g} m",
                agree_m is not None and worst_m <= SAME_RANGE_M,
            ),
        ]


def _typical(errors_m: Sequence[float]) -> float:
    """The median: while the target moves the two are a report apart."""
    return sorted(errors_m)[len(errors_m) // 2] if errors_m else 0.0


def _found(record: BandRecord) -> str:
    if record.band.step_mps == 0.0:
        return f"held {record.held_s:.1f} s, {record.wrong} steps"
    refused = ", then at the limit" if record.refused else ""
    return f"{record.right} steps as asked{refused}, {record.wrong} others"


def _asked(record: BandRecord, period_s: float) -> str:
    band = record.band
    where = f"{band.from_m:g} to {band.to_m:g} m"
    if band.step_mps == 0.0:
        return f"{where}: no change for three periods of {period_s:g} s"
    return f"{where}: {band.step_mps:+g} m/s every {period_s:g} s, and nothing else"


def _matrix(judge: StepJudge) -> Grid:
    head = ("band", "from, m", "to, m", "step, m/s", "right", "wrong", "longest still, s")
    rows = []
    for record, printed in zip(judge.records.values(), TABLE_6, strict=True):
        band = record.band
        counts = (str(record.right), str(record.wrong), f"{record.held_s:.1f}")
        edges = (f"{band.from_m:g}", f"{band.to_m:g}", f"{band.step_mps:+g}")
        rows.append(Row((band.name, *edges, *counts)))
        theirs = (f"{printed.from_m:g}", f"{printed.to_m:g}", f"{printed.step_mps:+g}")
        rows.append(Row(("  Table 6", *theirs, "", "", ""), printed=True))
    return Grid("Response matrix", head, tuple(rows))


def _steps_grid(judge: StepJudge) -> Grid:
    head = ("average, m", "step, m/s", "new speed, m/s", "band", "as the law says")
    rows = [
        Row(
            (
                f"{step.range_m:.2f}",
                f"{step.change_mps:+.1f}",
                f"{step.speed_mps:.1f}",
                " or ".join(step.bands),
                "yes" if step.right else "NO",
            )
        )
        for step in judge.steps
    ]
    return Grid("Every step", head, tuple(rows))


def _figure_28() -> Grid:
    rows = tuple(
        Row((f"{range_m:.3f}", f"{speed_mps:.1f}"), printed=True)
        for range_m, speed_mps in FIGURE_28
    )
    title = "Thesis, Figure 28 (6.08 m was fed by hand; at 3.636 m the speed was at its maximum)"
    return Grid(title, ("average, m", "new speed, m/s"), rows)


def _speed_figure(samples: Sequence[Sample]) -> plots.Figure:
    kept = _changes([(s.t_s, None if s.guarded else s.speed_mps) for s in samples])
    figure = _over_time("Speed commanded", "m/s", "law", kept, plots.LEADER_COLOUR)
    guarded = [s for s in samples if s.guarded]
    if guarded:
        trace = {
            "type": "scatter",
            "mode": "markers",
            "name": "too-close guard",
            "x": [round(s.t_s - samples[0].t_s, 2) for s in guarded],
            "y": [s.speed_mps for s in guarded],
            "marker": {"size": 4, "color": plots.QUIET_COLOUR},
        }
        figure["data"].append(trace)
    return figure


def _range_figure(judge: StepJudge) -> plots.Figure:
    kept = _changes([(s.t_s, s.range_m) for s in judge.samples])
    figure = _over_time("Average range", "m", "range", kept, plots.FOLLOWER_COLOUR)
    law = judge.law
    levels = [band.from_m for band in law.bands()[:-1]] + [law.detect_m]
    figure["layout"]["shapes"] = [
        {
            "type": "line",
            "xref": "paper",
            **{"x0": 0, "x1": 1, "y0": level, "y1": level},
            "line": {"color": plots.QUIET_COLOUR, "width": 1, "dash": "dot"},
        }
        for level in levels
    ]
    return figure


def _changes(pairs: Sequence[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
    """Only where the value changes, and the last: it is drawn in steps."""
    kept = [p for i, p in enumerate(pairs) if i == 0 or p[1] != pairs[i - 1][1]]
    return [*kept, *pairs[-1:]]


def _over_time(
    title: str, unit: str, name: str, pairs: Sequence[tuple[float, float | None]], colour: str
) -> plots.Figure:
    start_s = pairs[0][0] if pairs else 0.0
    trace = {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": [round(t_s - start_s, 2) for t_s, _ in pairs],
        "y": [value for _, value in pairs],
        "line": {"color": colour, "width": 1.8, "shape": "hv"},
    }
    return plots.chart(title, "time, s", unit, [trace])


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument(
        "--autopilot",
        metavar="CONN",
        help="the autopilot (or SITL) that runs the applet, with the board on one of its ports",
    )
    parser.add_argument(
        "--hold", type=positive, default=HOLD_S, metavar="S", help="seconds in each band (5)"
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""

    def vehicle(bench: Bench) -> LawVehicle:
        if args.autopilot:
            return AutopilotVehicle(args.autopilot, args.baud)
        return BuiltInVehicle(bench.board.system_id)

    return perform(LawTest(vehicle, args.hold, hand_armed=bool(args.autopilot)), args)
