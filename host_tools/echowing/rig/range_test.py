"""`echowing rig range-test`: how far, surely and exactly the sonar detects (thesis Table 5)."""

import math
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.analysis.thesis import TABLE_5, TABLE_6
from echowing.rig.bench import Bench, add_bench_arguments, perform, positive
from echowing.rig.readings import heard_m, spread, value_of
from echowing.rig.result import Check, Result
from echowing.rig.state import NOTHING_HEARD_M

EXAMPLES = """\
examples:
  echowing rig range-test --distances 1,2,3,3.5,4,4.5,5
"""

# Both of Table 5's ranges for the MB1202, and what lies before, between and after them.
DISTANCES_M = (0.5, 1.0, 2.0, 3.0, 3.2, 4.0, 4.4, 4.6, 5.0)
SECONDS = 5.0
# Nearer to the distance set is the target, whose legs and foil are spread over some decimetres.
TARGET_GATE_M = 0.5
# The thesis does not say when a target counts as detected. Two misses in a row (MISS_LIMIT) end the
# tracking: detected nine times in ten, that happens by chance once in 110 readings, five seconds.
LEAST_RATE = 0.9
RATE_REASON = "a leader detected less often is lost by chance more than once in 5 s"
# The outer edge of Table 6's bands: nearer than this the law has to see a leader it wants to reach.
NEEDED_M = TABLE_6[0].from_m
# A bias as wide as Table 6's monitor band puts a leader in the wrong band.
MONITOR = next(band for band in TABLE_6 if band.step_mps == 0.0)
MOST_BIAS_M = round(MONITOR.to_m - MONITOR.from_m, 6)
# Half of that band: the average of ten then moves by a third of it.
MOST_SPREAD_M = MOST_BIAS_M / 2.0


@dataclass
class Point:
    """Single readings with the target at one distance, metres; None: nothing was detected.

    gate_m: readings further than this from the distance come from something else.
    """

    distance_m: float
    gate_m: float
    readings: list[float | None] = field(default_factory=list)

    @property
    def of_target_m(self) -> list[float]:
        """Readings of the target."""
        return [
            reading
            for reading in self.readings
            if reading is not None and abs(reading - self.distance_m) <= self.gate_m
        ]

    @property
    def rate(self) -> float:
        """Share of readings from the target; 0 without readings."""
        return len(self.of_target_m) / len(self.readings) if self.readings else 0.0

    @property
    def elsewhere_rate(self) -> float:
        """Share of readings from something else."""
        heard = sum(reading is not None for reading in self.readings)
        return (heard - len(self.of_target_m)) / len(self.readings) if self.readings else 0.0

    def as_dict(self) -> dict[str, Any]:
        """For the JSON document."""
        found = spread(self.of_target_m)
        return {
            "distance_m": self.distance_m,
            "readings": len(self.readings),
            "detection_rate": round(self.rate, 4),
            "elsewhere_rate": round(self.elsewhere_rate, 4),
            "mean_m": round(found.mean, 4),
            "bias_m": round(found.mean - self.distance_m, 4),
            "spread_m": round(found.std, 4),
            "raw_m": self.readings,
        }


def effective_range_m(points: Sequence[Point], least_rate: float) -> float | None:
    """The farthest distance that was detected often enough, as was every nearer one."""
    farthest = None
    for point in sorted(points, key=lambda point: point.distance_m):
        if point.rate < least_rate:
            break
        farthest = point.distance_m
    return farthest


class RangeTest:
    """The procedure: gimbal straight ahead, a target at each distance in turn."""

    def __init__(
        self, distances_m: Sequence[float], seconds: float, needed_m: float, least_rate: float
    ) -> None:
        self._distances_m = distances_m
        self._seconds = seconds
        self._needed_m = needed_m
        self._least_rate = least_rate
        self.points: list[Point] = []

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        bench.centre()
        bench.operator.tell(
            "The gimbal looks straight ahead. Hang the target free, 1.5 m from the ground and from "
            "walls (thesis: a quadrotor from a tree), and measure from the sonar's face."
        )
        for number, distance_m in enumerate(self._distances_m, 1):
            of = f"{number} of {len(self._distances_m)}"
            bench.ask(f"{of}: put the target at {distance_m:.2f} m.")
            self._measure(bench, distance_m)

    def _measure(self, bench: Bench, distance_m: float) -> None:
        point = Point(distance_m, TARGET_GATE_M)
        self.points.append(point)
        for message in bench.listen(f"measuring at {distance_m:.2f} m", self._seconds):
            raw_m = value_of(message, "SNR_RAW")
            if raw_m is not None:
                point.readings.append(heard_m(raw_m))

    def result(self) -> Result:
        """As `Procedure`."""
        farthest_m = effective_range_m(self.points, self._least_rate)
        checks = self._checks(farthest_m)
        exact = all(check.passed for check in checks)
        return Result(
            "range-test",
            "Sonar range test",
            checks=checks,
            measured={
                "maximum_effective_range_m": farthest_m,
                "least_detection_rate": self._least_rate,
                "points": [point.as_dict() for point in self.points],
            },
            grids=[self._grid(), self._table_5(farthest_m)],
            figures={"rate": rate_figure(self.points, self._least_rate), "bias": self._bias()},
            incomplete=self._untested(farthest_m) if exact else None,
            notes=[
                f"Detected: within {TARGET_GATE_M:g} m of the distance set; elsewhere: an echo "
                "farther off. Mean, bias and spread are those of the detected single readings. "
                f"Maximum effective range: the farthest distance with {self._least_rate:.0%} "
                "detected, there and at every nearer distance set. The thesis does not give its "
                f"own criterion; ours: {RATE_REASON}."
            ],
        )

    def _untested(self, farthest_m: float | None) -> str | None:
        """Why the range is not known: the target was detected at the farthest tested distance."""
        tried_m = max((point.distance_m for point in self.points), default=0.0)
        if farthest_m is None or farthest_m < tried_m or tried_m >= self._needed_m:
            return None
        return (
            f"not tested beyond {tried_m:g} m, and {self._needed_m:g} m are needed: add farther "
            "distances"
        )

    def _checks(self, farthest_m: float | None) -> list[Check]:
        """Range, and exactness at the distances with detection."""
        within = [p for p in self.points if farthest_m is not None and p.distance_m <= farthest_m]
        if self._untested(farthest_m):
            return _exactness(within)
        found = (
            "not detected at the nearest distance" if farthest_m is None else f"{farthest_m:g} m"
        )
        enough = farthest_m is not None and farthest_m >= self._needed_m
        asked = f"at least {self._needed_m:g} m: the speed law must detect the leader up to there"
        checks = [Check("maximum effective range", found, asked, enough)]
        return [*checks, *_exactness(within)] if within else checks

    def _grid(self) -> Grid:
        head = (
            "distance, m",
            "readings",
            "detected",
            "elsewhere",
            "mean, m",
            "bias, m",
            "spread, m",
        )
        return Grid("Measured", head, tuple(Row(_cells(point)) for point in self.points))

    def _table_5(self, farthest_m: float | None) -> Grid:
        rows = [Row(("this board", "as hung", "-" if farthest_m is None else f"{farthest_m:g}"))]
        for sonar, seen in TABLE_5.items():
            rows.append(Row((f"  thesis, {sonar}", "stock X8", f"{seen.stock_m:g}"), printed=True))
            rows.append(Row((f"  thesis, {sonar}", "with foil", f"{seen.foil_m:g}"), printed=True))
        return Grid("Beside Table 5", ("sonar", "target", "effective to, m"), tuple(rows))

    def _bias(self) -> plots.Figure:
        data = [_readings_trace(self.points), _truth_trace(self.points)]
        return plots.chart("Single readings", "distance set, m", "reading, m", data)


def _exactness(points: Sequence[Point]) -> list[Check]:
    """The worst bias and the worst spread at the distances with detection."""
    found = {point.distance_m: spread(point.of_target_m) for point in points}
    bias_at_m = max(found, key=lambda at_m: abs(found[at_m].mean - at_m))
    spread_at_m = max(found, key=lambda at_m: found[at_m].std)
    bias_m, spread_m = found[bias_at_m].mean - bias_at_m, found[spread_at_m].std
    return [
        Check(
            "bias",
            f"worst {bias_m:+.3f} m, at {bias_at_m:g} m",
            f"at most {MOST_BIAS_M:g} m either way: the width of Table 6's monitor band",
            abs(bias_m) <= MOST_BIAS_M,
        ),
        Check(
            "spread",
            f"worst {spread_m:.3f} m, at {spread_at_m:g} m",
            f"at most {MOST_SPREAD_M:g} m: half of that band",
            spread_m <= MOST_SPREAD_M,
        ),
    ]


def _cells(point: Point) -> tuple[str, ...]:
    found = spread(point.of_target_m)
    known = math.isfinite(found.mean)
    return (
        f"{point.distance_m:.2f}",
        str(len(point.readings)),
        f"{point.rate:.0%}",
        f"{point.elsewhere_rate:.0%}",
        f"{found.mean:.3f}" if known else "-",
        f"{found.mean - point.distance_m:+.3f}" if known else "-",
        f"{found.std:.3f}" if math.isfinite(found.std) else "-",
    )


def rate_figure(points: Sequence[Point], least_rate: float) -> plots.Figure:
    """Detection rate over distance, Table 5's ranges as upright lines."""
    ordered = sorted(points, key=lambda point: point.distance_m)
    trace = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "detected",
        "x": [point.distance_m for point in ordered],
        "y": [round(100.0 * point.rate, 1) for point in ordered],
        "line": {"color": plots.FOLLOWER_COLOUR, "width": 2},
        "marker": {"size": 8},
    }
    figure = plots.chart("Detection rate", "distance set, m", "%", [trace])
    figure["layout"]["yaxis"]["range"] = [-3, 103]
    figure["layout"]["xaxis"]["range"] = [0, max([5.0, *(p.distance_m for p in points)]) + 0.3]
    seen = TABLE_5["MB1202"]
    figure["layout"]["shapes"] = [
        {
            "type": "line",
            "xref": "paper",
            **{"x0": 0, "x1": 1, "y0": 100.0 * least_rate, "y1": 100.0 * least_rate},
            "line": {"color": plots.GOOD_COLOUR, "width": 1, "dash": "dot"},
        }
    ]
    for label, at_m in (("stock X8", seen.stock_m), ("with foil", seen.foil_m)):
        words = f"thesis, {label}: {at_m:g} m"
        plots.with_upright(figure, at_m, words, plots.QUIET_COLOUR)
    return figure


def _readings_trace(points: Sequence[Point]) -> plots.Figure:
    pairs = [
        (p.distance_m, NOTHING_HEARD_M if r is None else r) for p in points for r in p.readings
    ]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": f"readings (at {NOTHING_HEARD_M:g} m: nothing detected)",
        "x": [distance_m for distance_m, _ in pairs],
        "y": [round(reading_m, 3) for _, reading_m in pairs],
        "marker": {"size": 5, "color": plots.FOLLOWER_COLOUR, "opacity": 0.4},
    }


def _truth_trace(points: Sequence[Point]) -> plots.Figure:
    ends = [0.0, max([NOTHING_HEARD_M, *(point.distance_m for point in points)])]
    line = {"color": plots.QUIET_COLOUR, "width": 1, "dash": "dash"}
    return {"type": "scatter", "mode": "lines", "name": "exact", "x": ends, "y": ends, "line": line}


def share(text: str) -> float:
    """A share over 0 and up to 1; ArgumentTypeError for what is none."""
    value = positive(text)
    if value > 1.0:
        raise ArgumentTypeError(f"{text!r}: a share, up to 1")
    return value


def distances(text: str) -> list[float]:
    """Metres, separated by commas; ArgumentTypeError for what is none."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise ArgumentTypeError(f"{text!r}: metres, separated by commas: 1,2,3.5") from error
    if not all(0.0 < value <= 10.0 for value in found):
        raise ArgumentTypeError(f"{text!r}: distances over 0 and up to 10 m")
    return found


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument(
        "--distances",
        type=distances,
        default=list(DISTANCES_M),
        metavar="M,M,…",
        help=f"metres ({','.join(f'{distance_m:g}' for distance_m in DISTANCES_M)})",
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        default=SECONDS,
        metavar="S",
        help="seconds at each distance (5)",
    )
    parser.add_argument(
        "--need",
        type=positive,
        default=NEEDED_M,
        metavar="M",
        help=f"least maximum effective range to pass ({NEEDED_M:g}: Table 6's outer edge)",
    )
    parser.add_argument(
        "--rate",
        type=share,
        default=LEAST_RATE,
        metavar="SHARE",
        help=f"a target counts as detected with this share of echoes ({LEAST_RATE:g})",
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""
    return perform(RangeTest(args.distances, args.seconds, args.need, args.rate), args)
