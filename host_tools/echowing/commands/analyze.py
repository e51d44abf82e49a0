"""`echowing analyze`: measure a flown formation from its logs."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from echowing.analysis.flight import Flight
    from echowing.guidance import Slot

EXAMPLES = """\
examples:
  echowing analyze leader.BIN follower.BIN
  echowing analyze out/flight-7 --out out/flight-7      what `echowing follow --log` has written
  echowing analyze leader.tlog follower.tlog --radius 4 --out out/flight-7
  echowing analyze out/mine/leader.tlog out/mine/follower-2.tlog --truth out/mine/truth.csv --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "logs",
        nargs="+",
        type=Path,
        metavar="LOG",
        help=".tlog or .BIN, one a vehicle or more; the CSV of `echowing follow --log`, or its DIR",
    )
    parser.add_argument("--leader", metavar="LOG|ID", help="the leader's log or system id")
    parser.add_argument(
        "--radius",
        type=float,
        metavar="M",
        help="wanted separation; without, as follow's CSV says, else 3",
    )
    parser.add_argument(
        "--angle", type=float, metavar="DEG", help="off the tail, counter-clockwise"
    )
    parser.add_argument("--settle", type=float, default=0.0, metavar="S", help="seconds left out")
    parser.add_argument("--truth", type=Path, metavar="CSV", help="compare with a truth.csv")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write report.html here")
    parser.add_argument("--json", action="store_true", help="print one JSON object a follower")


def run(args: argparse.Namespace) -> int:
    """Read, measure, print."""
    from echowing.analysis.logs import read_flights  # noqa: PLC0415 (imported when it is used)

    flights = read_flights(args.logs, leader=_leader(args.leader), slot=_slot(args))
    if args.json:
        for flight in flights:
            print(json.dumps(_summary(flight, args)))
    else:
        _print(flights, args)
    if args.out is not None:
        _write(args.out, flights)
    return 0


def _slot(args: argparse.Namespace) -> "Slot | None":
    """What was said of the slot; None: nothing."""
    import math  # noqa: PLC0415 (imported when it is used)

    from echowing.analysis.logs import DEFAULT_SLOT  # noqa: PLC0415
    from echowing.guidance import Slot  # noqa: PLC0415

    if args.radius is None and args.angle is None:
        return None
    radius_m = DEFAULT_SLOT.radius_m if args.radius is None else args.radius
    return Slot(radius_m, math.radians(args.angle or 0.0))


def _leader(text: str | None) -> Path | int | None:
    if text is None:
        return None
    return int(text) if text.isdecimal() else Path(text)


def _summary(flight: "Flight", args: argparse.Namespace) -> dict[str, object]:
    from dataclasses import asdict  # noqa: PLC0415

    from echowing.analysis.logs import compare_with_truth  # noqa: PLC0415
    from echowing.analysis.metrics import metrics  # noqa: PLC0415

    summary: dict[str, object] = {
        "flight": flight.name,
        **metrics(flight, args.settle).to_json(),
        "warnings": list(flight.warnings),
    }
    if args.truth is not None:
        summary["truth"] = asdict(compare_with_truth(flight, args.truth, match_clocks=True))
    return summary


def _print(flights: "list[Flight]", args: argparse.Namespace) -> None:
    from rich.console import Console  # noqa: PLC0415

    from echowing.analysis.logs import compare_with_truth  # noqa: PLC0415
    from echowing.analysis.metrics import metrics  # noqa: PLC0415
    from echowing.analysis.tables import Result, terminal_table  # noqa: PLC0415

    console = Console()
    for flight in flights:
        for warning in flight.warnings:
            console.print(f"{flight.name}: {warning}", style="yellow", highlight=False)
    results = [Result(flight.name, metrics(flight, args.settle)) for flight in flights]
    console.print(terminal_table(results))
    if args.truth is None:
        return
    for flight in flights:
        truth = compare_with_truth(flight, args.truth, match_clocks=True)
        console.print(
            f"{flight.name}: separation by logs {truth.log_mean_m:.2f} m, in truth "
            f"{truth.truth_mean_m:.2f} m; off by {truth.bias_m:+.2f} m on average, RMS "
            f"{truth.rms_m:.2f} m",
            highlight=False,
        )


def _write(out: Path, flights: "list[Flight]") -> None:
    from echowing.analysis.report import write_report  # noqa: PLC0415
    from echowing.errors import EchowingError  # noqa: PLC0415

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    write_report(out / "report.html", flights)
    print(f"report: {out / 'report.html'}")
