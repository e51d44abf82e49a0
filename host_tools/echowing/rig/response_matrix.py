"""`echowing rig response-matrix`: what the sonar hears by range, angle and throttle."""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from echowing.analysis import plots
from echowing.analysis.sonar_measure import Conditions, Measured, Readings, measured_sonar
from echowing.analysis.tables import Grid, Row
from echowing.errors import EchowingError
from echowing.flight.build_up import LEAST_DIST_M, MOST_DIST_M
from echowing.paths import SHIPPED_SONAR
from echowing.rig.bench import Bench, add_bench_arguments, perform, positive
from echowing.rig.readings import heard_m, value_of
from echowing.rig.result import Check, Result, prepare_folder
from echowing.sonar_file import SonarFile, fly_by, load_sonar, write_sonar

EXAMPLES = """\
examples:
  echowing rig response-matrix --distances 1,2,3,4,4.5 --throttles 0,0.4
      on a tied-down vehicle: host_tools/RIG.md says how, safely
  echowing rig response-matrix --legs stock --slot 2 --write my-sonar.toml
  echowing follow --sonar my-sonar.toml --legs stock ...
"""

DISTANCES_M = (1.0, 2.0, 3.0, 3.7, 4.4)
ANGLES_DEG = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 26.0)
THROTTLES = (0.0, 0.4)
# To each side of the axis half of it.
SECONDS = 5.0
SLOT_M = 3.0


@dataclass(frozen=True)
class Plan:
    """What is measured: separations, angles off the axis, throttles; and what for."""

    distances_m: Sequence[float]
    angles_deg: Sequence[float]
    throttles: Sequence[float]
    seconds: float
    conditions: Conditions


@dataclass
class ResponseMatrix:
    """The procedure: at each distance and throttle the gimbal turns off a leader that hangs still.

    The leader is moved while the propellers stand.
    """

    plan: Plan
    base: SonarFile
    readings: list[Readings] = field(default_factory=list)
    measured: Measured | None = None

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        parameters = bench.board.parameters()
        middle = parameters["PAN_MIDDLE"], parameters["TILT_MIDDLE"]
        per_deg = parameters["PAN_US_DEG"]
        if per_deg == 0.0:
            raise EchowingError("PAN_US_DEG is 0, a fixed mount: nothing turns the sonar")
        bench.operator.tell(
            "Follower tied down, board deaf to its autopilot, leader hung still and level with the "
            "sonar, straight ahead of it. Read host_tools/RIG.md first."
        )
        for distance_m in self.plan.distances_m:
            bench.ask(f"Propellers stand. Put the leader {distance_m:g} m away, centre to centre.")
            for throttle in self.plan.throttles:
                bench.ask(_throttled(throttle))
                for angle_deg in self.plan.angles_deg:
                    aims = [middle[0] + side * angle_deg * per_deg for side in _sides(angle_deg)]
                    one = Readings(distance_m, angle_deg, throttle)
                    self.readings.append(one)
                    for pan_us in aims:
                        bench.aim(pan_us, middle[1])
                        self._listen(bench, one, self.plan.seconds / len(aims))
            if any(self.plan.throttles):
                bench.ask("Stop the propellers.")
        self.measured = measured_sonar(self.readings, self.base, self.plan.conditions)

    def _listen(self, bench: Bench, into: Readings, seconds: float) -> None:
        where = f"{into.separation_m:g} m, {into.off_deg:g} degrees off, throttle {into.throttle:g}"
        run: list[float | None] = []
        into.runs.append(run)
        for message in bench.listen(where, seconds):
            raw_m = value_of(message, "SNR_RAW")
            if raw_m is not None:
                run.append(heard_m(raw_m))

    def result(self) -> Result:
        """As `Procedure`."""
        result = Result("response-matrix", "What the sonar hears")
        measured = self.measured
        if measured is None:
            result.checks = [Check("sonar", "nothing was measured", "all distances", passed=False)]
            result.measured = {"readings": [one.as_dict() for one in self.readings]}
            return result
        result.checks = [_carries(measured.file, self.plan.conditions)]
        result.measured = {
            "sonar": measured.file.model_dump(exclude_none=True),
            "readings": [one.as_dict() for one in self.readings],
        }
        result.grids = [_grid(self.readings, measured)]
        result.figures = {
            "angle": _by_angle(self.readings, measured),
            "range": _by_range(self.readings, measured),
        }
        result.notes = [*measured.notes, _WHAT_IS_SHOWN]
        if not any(self.plan.throttles):
            result.incomplete = "the propellers stood: measure with --throttles before a flight"
        return result


_WHAT_IS_SHOWN = (
    "heard: readings within 0.5 m of the leader; elsewhere: of anything else. fit: what the fitted "
    "beam gives there. Least and most are 90 % intervals; readings that are alike count for less."
)


def _sides(angle_deg: float) -> tuple[float, ...]:
    return (1.0, -1.0) if angle_deg else (1.0,)


def _throttled(throttle: float) -> str:
    if throttle == 0.0:
        return "Propellers stand, everybody clear."
    return f"Everybody clear: run the propellers at {throttle:.0%} throttle."


def _carries(file: SonarFile, conditions: Conditions) -> Check:
    """Whether it carries the slot that is asked for, or which one instead."""
    belief = file.belief(conditions.legs)
    objection = belief.objection(conditions.slot_m)
    asked = f"a slot of {conditions.slot_m:g} m"
    if objection is None:
        return Check("carries", asked, "as `echowing follow` will fly it", passed=True)
    nearest_m = belief.nearest_carried_m(conditions.slot_m, (LEAST_DIST_M, MOST_DIST_M))
    instead = "no slot at all" if nearest_m is None else f"the nearest is {nearest_m:.1f} m"
    return Check("carries", f"{instead}: {objection}", asked, passed=False)


def _grid(readings: Sequence[Readings], measured: Measured) -> Grid:
    head = ("separation, m", "angle, deg", "throttle", "pings", "heard", "fit", "elsewhere")
    rows = [
        Row(
            (
                f"{one.separation_m:g}",
                f"{one.off_deg:g}",
                f"{one.throttle:g}",
                str(one.pings),
                f"{one.heard / max(1, one.pings):.0%}",
                _fit_there(one, measured),
                f"{one.elsewhere / max(1, one.pings):.0%}",
            )
        )
        for one in readings
    ]
    return Grid("Counted", head, tuple(rows))


def _fit_there(one: Readings, measured: Measured) -> str:
    if one.throttle != measured.throttle:
        return ""
    return f"{measured.fit.share(one.separation_m, one.off_deg):.0%}"


def _by_angle(readings: Sequence[Readings], measured: Measured) -> plots.Figure:
    """A line for each distance: counted, and as fitted."""
    data: list[plots.Figure] = []
    for number, at in enumerate(measured.fit.at):
        colour = _COLOURS[number % len(_COLOURS)]
        counted = sorted(
            (one.off_deg, 100.0 * one.heard / max(1, one.pings))
            for one in readings
            if (one.separation_m, one.throttle) == (at.range_m, measured.throttle)
        )
        name = f"{at.range_m:g} m"
        data.append(_trace(name, counted, colour, mode="markers"))
        line = [(0.5 * n, 100.0 * measured.fit.share(at.range_m, 0.5 * n)) for n in range(81)]
        data.append(_trace(f"{name}, fitted", line, colour, mode="lines"))
    title = f"Heard off the axis, throttle {measured.throttle:g}"
    return plots.chart(title, "angle, degrees", "%", data)


def _by_range(readings: Sequence[Readings], measured: Measured) -> plots.Figure:
    """On the axis: a line for each throttle, and what is believed of it."""
    data: list[plots.Figure] = []
    throttles = sorted({one.throttle for one in readings})
    for number, throttle in enumerate(throttles):
        counted = sorted(
            (one.separation_m, 100.0 * one.heard / max(1, one.pings))
            for one in readings
            if (one.off_deg, one.throttle) == (0.0, throttle)
        )
        colour = _COLOURS[number % len(_COLOURS)]
        data.append(_trace(f"throttle {throttle:g}", counted, colour, mode="lines+markers"))
    for number, name in enumerate(("at least", "at most")):
        believed = [(at.range_m, 100.0 * at.share_between[number]) for at in measured.fit.at]
        data.append(_trace(name, believed, plots.QUIET_COLOUR, mode="lines"))
    return plots.chart("Heard on the axis", "separation, m", "%", data)


_COLOURS = (
    plots.LEADER_COLOUR,
    plots.FOLLOWER_COLOUR,
    plots.GOOD_COLOUR,
    "#a855f7",
    "#f59e0b",
    "#14b8a6",
    "#ec4899",
)


def _trace(
    name: str, points: Sequence[tuple[float, float]], colour: str, *, mode: str
) -> plots.Figure:
    return {
        "type": "scatter",
        "mode": mode,
        "name": name,
        "x": [round(x, 3) for x, _ in points],
        "y": [round(y, 1) for _, y in points],
        "line": {"color": colour, "width": 1.8},
        "marker": {"size": 7, "color": colour},
    }


def numbers(text: str, what: str, least: float, most: float) -> list[float]:
    """Numbers that rise, separated by commas; ArgumentTypeError for what is none."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise ArgumentTypeError(f"{text!r}: {what}, separated by commas") from error
    if not all(least <= one <= most for one in found) or sorted(set(found)) != found:
        raise ArgumentTypeError(f"{text!r}: {what} from {least:g} to {most:g}, the least first")
    return found


def _separations(text: str) -> list[float]:
    return numbers(text, "metres", 0.5, 8.0)


def _angles(text: str) -> list[float]:
    found = numbers(text, "degrees", 0.0, 45.0)
    if found[0] != 0.0 or len(found) < 3:
        raise ArgumentTypeError(f"{text!r}: begin with 0, and give three or more")
    return found


def _throttles(text: str) -> list[float]:
    return numbers(text, "throttles", 0.0, 1.0)


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument(
        "--distances",
        type=_separations,
        default=list(DISTANCES_M),
        metavar="M,M,…",
        help="separations, from centre to centre (1,2,3,3.7,4.4)",
    )
    parser.add_argument(
        "--angles",
        type=_angles,
        default=list(ANGLES_DEG),
        metavar="DEG,DEG,…",
        help="angles to which the gimbal turns, to both sides (0,4,8,12,16,20,26)",
    )
    parser.add_argument(
        "--throttles",
        type=_throttles,
        default=list(THROTTLES),
        metavar="T,T,…",
        help="throttles of the follower's propellers, 0 to 1, its hover's among them (0,0.4)",
    )
    parser.add_argument(
        "--hover",
        type=positive,
        metavar="T",
        help="the throttle at which it hovers, one of --throttles (the highest)",
    )
    parser.add_argument(
        "--seconds", type=positive, default=SECONDS, metavar="S", help="at each angle (5)"
    )
    parser.add_argument(
        "--legs", choices=("foil", "stock"), default="foil", help="what the leader hangs out (foil)"
    )
    parser.add_argument(
        "--slot", type=positive, default=SLOT_M, metavar="M", help="the slot it is to carry (3)"
    )
    parser.add_argument(
        "--base",
        default=SHIPPED_SONAR,
        metavar="SONAR",
        help="the sonar, or sonar file, from which all that is not measured is taken (mb1202)",
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="FILE",
        help="the sonar file to write (OUT/sonar.toml)",
    )


def _base(name: str) -> SonarFile:
    """The file to begin with; EchowingError where it is of a sensor that no gimbal turns."""
    base = load_sonar(name)
    if base.fixed:
        raise EchowingError(
            f"--base {name}: its sensor is fixed to the nose (rangefinder_type "
            f"{base.rangefinder_type}), and nothing here turns it: measure it in a flight, with "
            "`echowing analyze --sonar`"
        )
    return base


def run(args: Namespace) -> int:
    """Measure, judge, write the result and the sonar file."""
    hover = args.throttles[-1] if args.hover is None else args.hover
    if hover not in args.throttles:
        raise EchowingError(f"--hover {hover:g}: one of --throttles")
    conditions = Conditions(args.legs, hover, args.slot)
    plan = Plan(args.distances, args.angles, args.throttles, args.seconds, conditions)
    path = args.write or args.out / "sonar.toml"
    if args.write is not None:
        prepare_folder(path.parent, "--write")
    procedure = ResponseMatrix(plan, _base(args.base))
    code = perform(procedure, args)
    if procedure.measured is not None:
        write_sonar(path, procedure.measured.file)
        if not args.json:
            print(fly_by(path, args.legs))
    return code
