"""`echowing analyze`: measure a flown formation from its logs."""

import argparse
import json
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.paths import SHIPPED_SONAR

if TYPE_CHECKING:
    from echowing.analysis.flight import Flight
    from echowing.analysis.logs import TruthComparison
    from echowing.analysis.metrics import Metrics
    from echowing.analysis.tables import Result
    from echowing.flight.guidance import Slot
    from echowing.sonar_file import FlownBy, SonarFile

EXAMPLES = """\
examples:
  echowing analyze leader.BIN follower.BIN
  echowing analyze out/flight-7 --out out/flight-7      what `echowing follow --log` has written
  echowing analyze leader.tlog follower.tlog --radius 4 --out out/flight-7
  echowing analyze out/flight-7 --sonar mine.toml       what its sonar hears, as a sonar file
  echowing analyze out/flight-7 follower.BIN --sonar mine.toml      and what the throttle takes
  echowing analyze --answer follower.BIN                how it answers a speed step
  echowing analyze out/mine/leader.tlog out/mine/follower-2.tlog --json
      with the truth.csv that `echowing sim --out` has written beside them
"""

LEAST_RADIUS_M = 0.1
# A sonar that detects the leader for less of the flight does not tell how all of it was flown.
SEEN_ENOUGH = 0.5
TRUTH, SONAR, ESTIMATE, GPS = "in truth", "by sonar", "by estimate", "by GPS"
WITNESSES = (
    "The first row of a flight is the most certain. in truth: from truth.csv. by sonar: its "
    "readings and the sonar's inset, from centre to centre, while it detects "
    "the leader. by estimate: positions, corrected by what the sonar has shown of the receivers. "
    "by GPS: positions by the vehicles' own receivers, which differ by a metre or more."
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
        help="the truth of a simulated flight (truth.csv beside the logs, where there is one)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write report.html into this folder"
    )
    parser.add_argument(
        "--answer",
        action="store_true",
        help="measure instead how each vehicle answers a speed step, from its own log (.BIN), and "
        "compare it with what the envelope counts with",
    )
    parser.add_argument(
        "--sonar",
        type=Path,
        metavar="FILE",
        help="write instead what the follower's sonar has heard in this flight, as a sonar file; "
        "what a flight does not tell is as in --base, and the file says so",
    )
    parser.add_argument(
        "--base",
        metavar="SONAR",
        help=f"the sonar file that was flown (as the log says, else {SHIPPED_SONAR})",
    )
    parser.add_argument(
        "--legs",
        choices=("foil", "stock"),
        help="what the leader had on (as the log says, else foil)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per follower")


def run(args: argparse.Namespace) -> int:
    """Read, measure, print."""
    if args.sonar is not None:
        return _sonar(args)
    if args.answer:
        return _answers(args.logs, as_json=args.json)
    from echowing.analysis.logs import read_flights  # noqa: PLC0415 (imported when it is used)

    _check_numbers(args)
    flights = read_flights(args.logs, leader=_leader(args.leader), slot=_slot(args))
    measured = [_measured_by_all(flight, args, alone=len(flights) == 1) for flight in flights]
    if args.json:
        for one in measured:
            print(json.dumps(one.summary()))
    else:
        _print(measured)
    if args.out is not None:
        _write(args.out, measured)
    return 0


def _sonar(args: argparse.Namespace) -> int:
    """Write the sonar file of a flight, and say what has changed in it."""
    from echowing.analysis.flown_sonar import sonar_from  # noqa: PLC0415 (imported when it is used)
    from echowing.errors import EchowingError  # noqa: PLC0415
    from echowing.sonar_file import fly_by, write_sonar  # noqa: PLC0415

    log, *autopilots = args.logs
    if len(autopilots) > 1:
        raise EchowingError(
            "--sonar: give one log of `echowing follow`, or its DIR, and the follower's .BIN"
        )
    flown, assumed = _flown_by(log, args)
    legs_told = args.legs is not None or not assumed
    measured = sonar_from(log, flown.file, flown.legs, *autopilots, legs_told=legs_told)
    write_sonar(args.sonar, measured.file)
    for line in assumed:
        print(line, file=sys.stderr)
    if args.json:
        print(json.dumps(measured.file.model_dump(mode="json")))
        return 0
    for at in measured.fit.at:
        low, high = at.share_between
        print(f"{at.range_m:.1f} m: hears {at.share:.0%} on the axis ({low:.0%} to {high:.0%})")
    for name, file in (("measured", measured.file), (flown.name, flown.file)):
        print(f"{name}: {_scatter_and_wrong(file)}")
    print("\n".join(measured.notes))
    print(fly_by(args.sonar, flown.legs))
    return 0


def _flown_by(log: Path, args: argparse.Namespace) -> "tuple[FlownBy, list[str]]":
    """By what it was flown: as the options say, else as the log does; what nobody says in words."""
    from echowing.analysis.flown_sonar import flown_by  # noqa: PLC0415 (imported when it is used)
    from echowing.sonar_file import FlownBy, load_sonar  # noqa: PLC0415

    told = flown_by(log)
    assumed = []
    if told is None:
        told = FlownBy(SHIPPED_SONAR, load_sonar(SHIPPED_SONAR), "foil")
        if args.base is None:
            assumed.append(f"{log} names no sonar file: taken to be flown by {told.name} (--base)")
        if args.legs is None:
            assumed.append(f"{log} tells nothing of legs: taken to be {told.legs} (--legs)")
    name, file = (told.name, told.file) if args.base is None else (args.base, load_sonar(args.base))
    return FlownBy(name, file, args.legs or told.legs), assumed


def _scatter_and_wrong(file: "SonarFile") -> str:
    """What ranges scatter by, and how many are wrong: from the least to the most."""
    low_cm, high_cm = (100.0 * one for one in file.noise_m)
    wild, late = (f"{low:.1%} to {high:.1%}" for low, high in (file.wild_share, file.late_share))
    return f"ranges scatter {low_cm:.1f} to {high_cm:.1f} cm, {wild} are wild, {late} late"


def _answers(logs: list[Path], *, as_json: bool) -> int:
    """How vehicles answer speed steps; 1: one of them later than the envelope counts with."""
    from echowing.analysis.answer import as_lines, read_answers  # noqa: PLC0415

    found = {path: read_answers(path) for path in logs}
    for path, answers in found.items():
        if as_json:
            steps = [one.to_json() for one in answers]
            print(json.dumps({"log": str(path), "steps": steps}))
        else:
            print("\n".join((f"{path}:", *as_lines(answers))))
    return int(any(one.slower for answers in found.values() for one in answers))


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
    by_estimate: "Metrics | None"
    in_truth: "Metrics | None"
    comparison: "TruthComparison | None"

    def ranked(self) -> "dict[str, Metrics]":
        """The figures of each witness that has some, the most certain one first."""
        sonar = self.by_sonar
        seen = sonar is not None and sonar.seen_share >= SEEN_ENOUGH
        rows = {
            TRUTH: self.in_truth,
            **({SONAR: sonar} if seen else {}),
            ESTIMATE: self.by_estimate,
            SONAR: sonar,
            GPS: self.by_gps,
        }
        return {how: one for how, one in rows.items() if one is not None}

    def results(self) -> "list[Result]":
        """A row for each witness."""
        from echowing.analysis.tables import Result  # noqa: PLC0415

        name = self.flight.name
        return [Result(f"{name}, {how}", one) for how, one in self.ranked().items()]

    def headline(self) -> str:
        """The figures of the most certain witness, and what they leave out."""
        how, best = next(iter(self.ranked().items()))
        seen = f", {best.seen_share:.0%} of the time" if how == SONAR else ""
        begin = f"{self.settle_s:.1f} s at the beginning" if self.settle_s > 0.0 else ""
        left_out = ", ".join(text for text in (begin, *self.flight.left_out) if text)
        return (
            f"mean error {best.mean_abs_error_m:.2f} m, RMSD {best.rmsd_m:.2f} m {how}{seen}; "
            f"left out: {left_out or 'nothing'}"
        )

    def summary(self) -> dict[str, object]:
        """JSON-ready; the figures at the top are those of the most certain witness, `source`."""
        how, best = next(iter(self.ranked().items()))
        parts = {"by_gps": self.by_gps, "by_sonar": self.by_sonar, "by_estimate": self.by_estimate}
        summary: dict[str, object] = {
            "flight": self.flight.name,
            "source": how,
            **best.to_json(),
            **{name: None if one is None else one.to_json() for name, one in parts.items()},
            "not_counted": list(self.flight.left_out),
            "warnings": list(self.flight.warnings),
        }
        if self.comparison is not None and self.in_truth is not None:
            summary["truth"] = asdict(self.comparison)
            summary["in_truth"] = self.in_truth.to_json()
        return summary


def _measured_by_all(flight: "Flight", args: argparse.Namespace, *, alone: bool) -> Measured:
    """With the truth that was named, or that lies beside the logs and is of this flight."""
    from dataclasses import replace  # noqa: PLC0415

    from echowing.errors import EchowingError  # noqa: PLC0415

    found = args.truth or _truth_beside(flight.name, args.logs, alone=alone)
    try:
        return _measured(flight, found, args.settle)
    except EchowingError as error:
        if found is None or args.truth is not None:
            raise
        unused = replace(flight, warnings=(*flight.warnings, f"{found} is not used: {error}"))
        return _measured(unused, None, args.settle)


def _truth_beside(name: str, logs: list[Path], *, alone: bool) -> Path | None:
    """The truth of a flight as `echowing sim --out` names it, in a folder of the logs."""
    number = re.search(r"(?:follower-|system )(\d+)", name)
    names = [f"truth-{number.group(1)}.csv"] if number else []
    names += ["truth.csv"] if alone else []
    folders = dict.fromkeys(path if path.is_dir() else path.parent for path in logs)
    places = (folder / one for folder in folders for one in names)
    return next((place for place in places if place.is_file()), None)


def _measured(flight: "Flight", truth: Path | None, told_settle_s: float | None) -> Measured:
    from echowing.analysis.logs import (  # noqa: PLC0415
        compare_with_truth,
        truth_approach_s,
        truth_separation,
    )
    from echowing.analysis.metrics import (  # noqa: PLC0415
        approach_s,
        by_estimate,
        by_sonar,
        metrics,
        of_separation,
    )

    settle_s = approach_s(flight) if told_settle_s is None else told_settle_s
    in_truth = comparison = None
    if truth is not None:
        comparison = compare_with_truth(flight, truth, match_clocks=True)
        known_s = truth_approach_s(flight, truth, comparison.clock_shift_s)
        if told_settle_s is None and known_s is not None:
            settle_s = known_s
        known_m = truth_separation(flight, truth, comparison.clock_shift_s, settle_s)
        if len(known_m):
            in_truth = of_separation(known_m, flight.wanted_separation_m, settle_s)
    return Measured(
        flight=flight,
        settle_s=settle_s,
        by_gps=metrics(flight, settle_s),
        by_sonar=by_sonar(flight, settle_s),
        by_estimate=by_estimate(flight, settle_s),
        in_truth=in_truth,
        comparison=comparison,
    )


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
        console.print(f"{one.flight.name}: {one.headline()}", highlight=False)
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


def _write(out: Path, measured: list[Measured]) -> None:
    from echowing.analysis.page import told  # noqa: PLC0415
    from echowing.analysis.report import write_report  # noqa: PLC0415
    from echowing.errors import EchowingError  # noqa: PLC0415

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    flights = [one.flight for one in measured]
    results = [result for one in measured for result in one.results()]
    settled_s = [one.settle_s for one in measured]
    notes = [*(f"{one.flight.name}: {one.headline()}" for one in measured), WITNESSES]
    write_report(out / "report.html", flights, results, notes, settle_s=settled_s)
    print(f"report: {told(out / 'report.html')}")
