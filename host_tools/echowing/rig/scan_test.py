"""`echowing rig scan-test`: the twelve points of the search, their dwell, and what they cover."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.analysis.thesis import THESIS_GAIN_PERCENT
from echowing.errors import EchowingError
from echowing.rig.bench import Bench, add_bench_arguments, perform, positive, whole
from echowing.rig.readings import TRACKING, named_value, spread
from echowing.rig.result import Check, Result
from echowing.rig.search import Aim, aims, covered, scan_pulses_us

EXAMPLES = """\
examples:
  echowing rig scan-test --rounds 3
"""

ROUNDS = 2
# A point is left only after a reading that was begun when the servos had arrived: at worst one full
# ranging later (100 ms between readings, datasheet PD11848).
LATEST_MS = 100.0
# A changed pulse is reported between two readings: at most one to the sonar's full range (65 ms)
# and a turn later. Over rounds that averages out, to this.
STAMP_MS = 70.0
MEAN_STAMP_MS = 5.0
LONGEST_STAND = 6  # dwells; a longer stay means that it has detected something
CURVE_STEP_DEG = 0.5  # good enough for a line
HALF_ANGLES_DEG = tuple(range(10, 46, 5))

Pulses = tuple[float, float]


@dataclass
class Visit:
    """The gimbal at one point: pulses in us, when they were commanded (board's clock, ms).

    disturbed: it detected something there, and stayed.
    """

    pulses_us: Pulses
    start_ms: float
    disturbed: bool = False


class Visits:
    """Follows the gimbal from point to point by what the board says of its pulses."""

    def __init__(self) -> None:
        self._now: dict[str, float] = {}
        self.visits: list[Visit] = []

    def hear(self, message: Any) -> None:
        """Take any message of the board's."""
        named = named_value(message)
        if named is None:
            return
        name, value = named
        if name == "SNR_STATE" and value == TRACKING and self.visits:
            self.visits[-1].disturbed = True
        if name not in ("SNR_PAN", "SNR_TILT") or self._now.get(name) == value:
            return
        known_before = len(self._now) == 2
        self._now[name] = value
        if known_before:
            pulses_us = (self._now["SNR_PAN"], self._now["SNR_TILT"])
            self.visits.append(Visit(pulses_us, float(message.time_boot_ms)))

    @property
    def whole(self) -> list[tuple[Visit, float]]:
        """Visits that have ended with nothing detected, each with its dwell in ms."""
        pairs = zip(self.visits, self.visits[1:], strict=False)
        return [(a, b.start_ms - a.start_ms) for a, b in pairs if not a.disturbed]


def first_point(visited: Sequence[Pulses], expected: Sequence[Pulses]) -> int:
    """Index of the expected point with which the visits begin, so that most of them fit."""

    def fitting(first: int) -> int:
        return sum(
            pulses == expected[(first + step) % len(expected)]
            for step, pulses in enumerate(visited)
        )

    return max(range(len(expected)), key=fitting)


@dataclass
class Seen:
    """What was seen of one point of the search."""

    expected_us: Pulses
    commanded_us: set[Pulses] = field(default_factory=set)
    dwell_ms: list[float] = field(default_factory=list)

    @property
    def right(self) -> bool:
        """Visited, and always with the pulses expected."""
        return self.commanded_us == {self.expected_us}


def by_point(visits: Visits, expected: Sequence[Pulses]) -> list[Seen]:
    """The visits laid beside the points expected."""
    first = first_point([visit.pulses_us for visit in visits.visits], expected)
    points = [Seen(pulses) for pulses in expected]
    dwell_ms = {id(visit): dwell for visit, dwell in visits.whole}
    for step, visit in enumerate(visits.visits):
        point = points[(first + step) % len(points)]
        point.commanded_us.add(visit.pulses_us)
        if id(visit) in dwell_ms:
            point.dwell_ms.append(dwell_ms[id(visit)])
    return points


class ScanTest:
    """The procedure: let it search, and watch."""

    def __init__(self, rounds: int, half_angle_deg: float | None, us_per_deg: float | None) -> None:
        self._rounds = rounds
        self._half_angle_deg = half_angle_deg
        self._us_per_deg = us_per_deg
        self._parameters: Mapping[str, float] | None = None
        self.visits = Visits()

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        self._parameters = parameters = bench.board.parameters()
        within_m = parameters["TRACK_RANGE"] / 100.0
        bench.ask(f"Point the sonar at open space: nothing within {within_m:g} m.")
        bench.centre()
        for message in bench.listen("gimbal centred", 1.2):  # standing values come once per second
            self.visits.hear(message)
        self.visits.visits.clear()
        bench.search()
        wanted = 12 * self._rounds + 1
        dwell_s = parameters["SCAN_DWELL"] / 1000.0
        begun_s = bench.clock()
        # A disturbed point takes longer.
        for message in bench.listen(f"searching, {self._rounds} rounds", 1.25 * wanted * dwell_s):
            self.visits.hear(message)
            visits = len(self.visits.visits)
            stands = not visits and bench.clock() - begun_s > LONGEST_STAND * dwell_s
            if stands or visits > wanted:
                break

    @property
    def _half_deg(self) -> float:
        assert self._parameters is not None
        return self._half_angle_deg or self._parameters["BEAM_WIDTH"] / 2.0

    def _looks(self, pulses_us: Sequence[Pulses]) -> list[Aim]:
        assert self._parameters is not None
        board = self._parameters
        centre_us = (board["PAN_MIDDLE"], board["TILT_MIDDLE"])
        own = (board["PAN_US_DEG"], board["TILT_US_DEG"])
        scales = (self._us_per_deg, self._us_per_deg) if self._us_per_deg else own
        if 0.0 in scales:
            raise EchowingError("PAN_US_DEG or TILT_US_DEG is 0: give --us-per-deg")
        return aims(pulses_us, centre_us, scales)

    def result(self) -> Result:
        """As `Procedure`."""
        result = Result("scan-test", "Gimbal scan test")
        if self._parameters is None or not self.visits.visits:
            result.checks = [_no_search()]
            return result
        points = by_point(self.visits, scan_pulses_us(self._parameters))
        seen_us = list(dict.fromkeys(p for point in points for p in point.commanded_us))
        looked = self._looks(seen_us)
        cover = covered(looked, self._half_deg)
        dwell_ms = [dwell for point in points for dwell in point.dwell_ms]
        result.checks = [
            _points_check(points),
            *_dwell_checks(dwell_ms, self._parameters["SCAN_DWELL"]),
            _coverage_check(cover.gain_percent, self._half_deg),
        ]
        result.measured = {
            "visits": [[*v.pulses_us, v.start_ms, v.disturbed] for v in self.visits.visits],
            "dwell_ms": dwell_ms,
            "half_angle_deg": self._half_deg,
            "fixed_sonar_sr": cover.one_sr,
            "searched_sr": cover.all_sr,
            "coverage_gain_percent": round(cover.gain_percent, 1),
            "thesis_gain_percent": THESIS_GAIN_PERCENT,
        }
        result.grids = [_grid(points), self._coverage_grid(cover.gain_percent)]
        result.figures = {
            "coverage": coverage_figure(looked, self._half_deg, cover.gain_percent),
            "dwell": _dwell_figure(points),
            "gain": _gain_figure(looked, self._half_deg),
        }
        result.notes = [
            "Coverage: solid angle of cones with this half-angle about the directions commanded, "
            "against that of one cone. The thesis gives its 43 % without the beam's width or the "
            "servos' degrees, so the gain is drawn over the half-angle. Pulses are those the board "
            "reports: measure one on the pin with an oscilloscope if in doubt."
        ]
        return result

    def _coverage_grid(self, gain_percent: float) -> Grid:
        assert self._parameters is not None
        scale = self._us_per_deg or self._parameters["PAN_US_DEG"]
        rows = (
            Row(("this board", f"{self._half_deg:g}", f"{scale:g}", f"+{gain_percent:.0f} %")),
            Row(("  thesis, 3.4.2", "-", "-", f"+{THESIS_GAIN_PERCENT:.0f} %"), printed=True),
        )
        head = ("area against a fixed sonar", "half-angle, deg", "pan, us/deg", "gain")
        return Grid("Coverage", head, rows)


def _no_search() -> Check:
    found = "the gimbal did not move: is something within TRACK_RANGE?"
    return Check("search", found, "twelve points in turn", passed=False)


def _points_check(points: Sequence[Seen]) -> Check:
    right = sum(point.right for point in points)
    wrong = [str(number) for number, point in enumerate(points, 1) if not point.right]
    found = f"{right} of {len(points)} right" + (f"; not {', '.join(wrong)}" if wrong else "")
    asked = "the firmware's scan table with this board's parameters, in order (Appendix A)"
    return Check("points", found, asked, not wrong)


def _dwell_checks(dwell_ms: Sequence[float], wanted_ms: float) -> list[Check]:
    if len(dwell_ms) < 12:
        found = f"only {len(dwell_ms)} undisturbed points: something within its range holds it"
        return [Check("dwell", found, "a round of twelve with nothing to detect", passed=False)]
    mean, least, most = spread(dwell_ms).mean, min(dwell_ms), max(dwell_ms)
    late_ms = wanted_ms + LATEST_MS
    on_the_whole = wanted_ms - MEAN_STAMP_MS <= mean <= late_ms + MEAN_STAMP_MS
    one_by_one = wanted_ms - STAMP_MS <= least and most <= late_ms + STAMP_MS
    return [
        Check(
            "dwell",
            f"mean {mean:.0f} ms, {least:.0f} to {most:.0f} ms",
            f"mean SCAN_DWELL {wanted_ms:g} ms, and at most {LATEST_MS:g} ms more for a reading to "
            f"end; a single one, as reported between readings, to {STAMP_MS:g} ms",
            on_the_whole and one_by_one,
        )
    ]


def _coverage_check(gain_percent: float, half_deg: float) -> Check:
    found = f"+{gain_percent:.0f} % with a half-angle of {half_deg:g} degrees"
    asked = f"at least the thesis's +{THESIS_GAIN_PERCENT:.0f} %"
    return Check("coverage area", found, asked, gain_percent >= THESIS_GAIN_PERCENT)


def _grid(points: Sequence[Seen]) -> Grid:
    head = ("point", "expected, us", "commanded, us", "dwells", "mean, ms", "least, ms", "most, ms")
    rows = [_row(number, point) for number, point in enumerate(points, 1)]
    return Grid("The twelve points (pan, tilt)", head, tuple(rows))


def _row(number: int, point: Seen) -> Row:
    commanded = "; ".join(_pair(pulses) for pulses in sorted(point.commanded_us)) or "-"
    dwell = point.dwell_ms
    times = (spread(dwell).mean, min(dwell), max(dwell)) if dwell else ()
    cells = tuple(f"{value:.0f}" for value in times) or ("-", "-", "-")
    return Row((str(number), _pair(point.expected_us), commanded, str(len(dwell)), *cells))


def _pair(pulses_us: Pulses) -> str:
    return f"{pulses_us[0]:g}, {pulses_us[1]:g}"


def coverage_figure(looked: Sequence[Aim], half_deg: float, gain_percent: float) -> plots.Figure:
    """What the search covers, as thesis Figure 17: the fixed beam green, the search orange."""
    stars = {
        "type": "scatter",
        "mode": "markers",
        "name": "points",
        "x": [aim.right_deg for aim in looked],
        "y": [aim.up_deg for aim in looked],
        "marker": {"symbol": "star", "size": 9, "color": "#253046"},
    }
    title = (
        f"Search, half-angle {half_deg:g}°: +{gain_percent:.0f} % "
        f"(thesis: +{THESIS_GAIN_PERCENT:.0f} %)"
    )
    figure = plots.chart(title, "right, degrees", "up, degrees", [stars])
    edges = [_circle(aim, half_deg, line="#c7741a", width=3) for aim in looked]
    insides = [_circle(aim, half_deg, fill="#fbd08a") for aim in looked]
    fixed = _circle(Aim(0.0, 0.0), half_deg, fill="#8fce92", line="#2e9e3f", width=1.5)
    # All edges first: only the outline of the whole stays visible.
    figure["layout"]["shapes"] = [*edges, *insides, fixed]
    reach = half_deg + 16.0
    figure["layout"]["xaxis"]["range"] = figure["layout"]["yaxis"]["range"] = [-reach, reach]
    figure["layout"]["yaxis"].update(scaleanchor="x", scaleratio=1)
    figure["layout"]["xaxis"]["constrain"] = "domain"
    figure["layout"]["height"] = 520
    return figure


def _circle(
    aim: Aim, radius: float, *, fill: str = "rgba(0,0,0,0)", line: str = "#000", width: float = 0
) -> dict[str, Any]:
    return {
        "type": "circle",
        "layer": "below",
        "fillcolor": fill,
        "line": {"color": line, "width": width},
        **{"x0": aim.right_deg - radius, "x1": aim.right_deg + radius},
        **{"y0": aim.up_deg - radius, "y1": aim.up_deg + radius},
    }


def _dwell_figure(points: Sequence[Seen]) -> plots.Figure:
    pairs = [(number, ms) for number, point in enumerate(points, 1) for ms in point.dwell_ms]
    trace = {
        "type": "scatter",
        "mode": "markers",
        "name": "dwell",
        "x": [number for number, _ in pairs],
        "y": [ms for _, ms in pairs],
        "marker": {"size": 8, "color": plots.FOLLOWER_COLOUR},
    }
    figure = plots.chart("Dwell at each point", "point", "ms", [trace])
    figure["layout"]["yaxis"]["rangemode"] = "tozero"
    figure["layout"]["xaxis"]["dtick"] = 1
    return figure


def _gain_figure(looked: Sequence[Aim], half_deg: float) -> plots.Figure:
    gains = [covered(looked, half, CURVE_STEP_DEG).gain_percent for half in HALF_ANGLES_DEG]
    curve = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "what the search adds",
        "x": list(HALF_ANGLES_DEG),
        "y": [round(gain, 1) for gain in gains],
        "line": {"color": plots.FOLLOWER_COLOUR, "width": 2},
    }
    here = {
        "type": "scatter",
        "mode": "markers",
        "name": f"here, {half_deg:g} degrees",
        "x": [half_deg],
        "y": [round(covered(looked, half_deg).gain_percent, 1)],
        "marker": {"size": 11, "color": plots.GOOD_COLOUR},
    }
    figure = plots.chart("Gain by the beam's width", "half-angle, degrees", "%", [curve, here])
    thesis = {
        "type": "line",
        "xref": "paper",
        **{"x0": 0, "x1": 1, "y0": THESIS_GAIN_PERCENT, "y1": THESIS_GAIN_PERCENT},
        "line": {"color": plots.QUIET_COLOUR, "width": 1, "dash": "dash"},
        "label": {
            "text": f"thesis {THESIS_GAIN_PERCENT:.0f} %",
            "textposition": "end",
            "font": {"size": 11},
        },
    }
    figure["layout"]["shapes"] = [thesis]
    figure["layout"]["yaxis"]["rangemode"] = "tozero"
    return figure


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument(
        "--rounds",
        type=whole,
        default=ROUNDS,
        metavar="N",
        help="rounds of the twelve points (2)",
    )
    parser.add_argument(
        "--half-angle",
        type=positive,
        metavar="DEG",
        help="half-angle of the sonar's beam (half of the board's BEAM_WIDTH)",
    )
    parser.add_argument(
        "--us-per-deg",
        type=positive,
        metavar="US",
        help="microseconds per degree of the servos (the board's PAN_US_DEG and TILT_US_DEG)",
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""
    return perform(ScanTest(args.rounds, args.half_angle, args.us_per_deg), args)
