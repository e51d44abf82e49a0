"""`echowing analyze`: measure a flown formation from its logs."""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from echowing.analysis.flight import Flight
    from echowing.analysis.logs import TruthComparison
    from echowing.analysis.metrics import Metrics
    from echowing.analysis.tables import Result
    from echowing.flight.guidance import Slot

EXAMPLES = """\
examples:
  echowing analyze leader.BIN follower.BIN
  echowing analyze out/flight-7 --out out/flight-7      what `echowing follow --log` has written
  echowing analyze leader.tlog follower.tlog --radius 4 --out out/flight-7
  echowing analyze out/mine/leader.tlog out/mine/follower-2.tlog --truth out/mine/truth.csv --json
"""

LEAST_RADIUS_M = 0.1
WITNESSES = (
    "by GPS: from the positions of the vehicles' own receivers, which differ by a metre or more. "
    "by sonar: while it sees the leader, from its face to what echoes. in truth: --truth."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "logs",
        nargs="+",
        type=Path,
        metavar="LOG",
        help=".tlog or .BIN, one or more per vehicle; the CSV "
        "of `echowing follow --log`, or its DIR",
    )
    parser.add_argument("--leader", metavar="LOG|ID", help="the leader's log or system id")
    parser.add_argument(
        "--radius",
        type=float,
        metavar="M",
        help="wanted separation (as in the CSV of follow, else 3)",
    )
    parser.add_argument(
        "--angle",
        type=float,
        metavar="DEG",
        help="wanted angle off the leader's tail, counter-clockwise",
    )
    parser.add_argument(
        "--settle",
        type=float,
        metavar="S",
        help="leave out the first S seconds (the time until first within 1 m of the slot)",
    )
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="CSV",
        help="compare with the truth.csv of `echowing sim --out`",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write report.html into this folder"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per follower")


def run(args: argparse.Namespace) -> int:
    """Read, measure, print."""
    from echowing.analysis.logs import read_flights  # noqa: PLC0415 (imported when it is used)

    _check_numbers(args)
    flights = read_flights(args.logs, leader=_leader(args.leader), slot=_slot(args))
    measured = [_measured(flight, args) for flight in flights]
    if args.json:
        for one in measured:
            print(json.dumps(one.summary()))
    else:
        _print(measured)
    if args.out is not None:
        _write(args.out, measured)
    return 0


def _check_numbers(args: argparse.Namespace) -> None:
    """Refuse what no flight can have. Each: option, value, least and greatest."""
    from echowing.errors import EchowingError  # noqa: PLC0415

    spans = {
        "--radius": (args.radius, LEAST_RADIUS_M, 1_000.0),
        "--angle": (args.angle, -360.0, 360.0),
        "--settle": (args.settle, 0.0, 86_400.0),
    }
    for option, (value, least, most) in spans.items():
        if value is not None and not least <= value <= most:
            raise EchowingError(f"{option} {value:g}: give {least:g} to {most:g}")


@dataclass(frozen=True)
class Measured:
    """One flight with its figures by each witness; None: it has nothing to say."""

    flight: "Flight"
    settle_s: float
    by_gps: "Metrics"
    by_sonar: "Metrics | None"
    in_truth: "Metrics | None"
    comparison: "TruthComparison | None"

    def results(self) -> "list[Result]":
        """A row for each witness."""
        from echowing.analysis.tables import Result  # noqa: PLC0415

        name = self.flight.name
        rows = {"by GPS": self.by_gps, "by sonar": self.by_sonar, "in truth": self.in_truth}
        return [Result(f"{name}, {how}", one) for how, one in rows.items() if one is not None]

    def summary(self) -> dict[str, object]:
        """JSON-ready; the figures at the top are by GPS."""
        summary: dict[str, object] = {
            "flight": self.flight.name,
            **self.by_gps.to_json(),
            "by_sonar": None if self.by_sonar is None else self.by_sonar.to_json(),
            "warnings": list(self.flight.warnings),
        }
        if self.comparison is not None and self.in_truth is not None:
            summary["truth"] = asdict(self.comparison)
            summary["in_truth"] = self.in_truth.to_json()
        return summary


def _measured(flight: "Flight", args: argparse.Namespace) -> Measured:
    from echowing.analysis.logs import (  # noqa: PLC0415
        compare_with_truth,
        truth_approach_s,
        truth_separation,
    )
    from echowing.analysis.metrics import (  # noqa: PLC0415
        approach_s,
        by_sonar,
        metrics,
        of_separation,
    )

    settle_s = approach_s(flight) if args.settle is None else args.settle
    in_truth = comparison = None
    if args.truth is not None:
        comparison = compare_with_truth(flight, args.truth, match_clocks=True)
        known_s = truth_approach_s(flight, args.truth, comparison.clock_shift_s)
        if args.settle is None and known_s is not None:
            settle_s = known_s
        known_m = truth_separation(flight, args.truth, comparison.clock_shift_s, settle_s)
        if len(known_m):
            in_truth = of_separation(known_m, flight.wanted_separation_m, settle_s)
    figures = metrics(flight, settle_s)
    return Measured(flight, settle_s, figures, by_sonar(flight, settle_s), in_truth, comparison)


def _slot(args: argparse.Namespace) -> "Slot | None":
    """What was said of the slot; None: nothing."""
    import math  # noqa: PLC0415 (imported when it is used)

    from echowing.analysis.logs import DEFAULT_SLOT  # noqa: PLC0415
    from echowing.flight.guidance import Slot  # noqa: PLC0415

    if args.radius is None and args.angle is None:
        return None
    radius_m = DEFAULT_SLOT.radius_m if args.radius is None else args.radius
    return Slot(radius_m, math.radians(args.angle or 0.0))


def _leader(text: str | None) -> Path | int | None:
    if text is None:
        return None
    return int(text) if text.isdecimal() else Path(text)


def _print(measured: list[Measured]) -> None:
    from rich.console import Console  # noqa: PLC0415

    from echowing.analysis.tables import terminal_table  # noqa: PLC0415

    console = Console()
    for one in measured:
        for warning in one.flight.warnings:
            console.print(f"{one.flight.name}: {warning}", style="yellow", highlight=False)
        console.print(f"{one.flight.name}: {_left_out(one)}", highlight=False)
    console.print(terminal_table([result for one in measured for result in one.results()]))
    console.print(WITNESSES, style="dim", highlight=False)
    for one in measured:
        if one.comparison is not None:
            console.print(
                f"{one.flight.name}: separation by logs {one.comparison.log_mean_m:.2f} m, in "
                f"truth {one.comparison.truth_mean_m:.2f} m; off by {one.comparison.bias_m:+.2f} m "
                f"on average, RMS {one.comparison.rms_m:.2f} m, over the whole flight",
                highlight=False,
            )


def _left_out(one: Measured) -> str:
    if one.settle_s == 0.0:
        return "nothing is left out at the beginning"
    return f"the first {one.settle_s:.1f} s are left out"


def _write(out: Path, measured: list[Measured]) -> None:
    from echowing.analysis.report import write_report  # noqa: PLC0415
    from echowing.errors import EchowingError  # noqa: PLC0415

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    flights = [one.flight for one in measured]
    results = [result for one in measured for result in one.results()]
    settled_s = [one.settle_s for one in measured]
    write_report(out / "report.html", flights, results, [WITNESSES], settle_s=settled_s)
    print(f"report: {out / 'report.html'}")
