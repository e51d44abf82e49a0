"""`echowing sim`: fly a simulated formation."""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.sim.scenario import Scenario
    from echowing.sim.summary import FlownScenario

EXAMPLES = """\
examples:
  echowing sim --list
  echowing sim echowing --seed 3 --out out/mine
  echowing sim gray --seed 1-10 --json
  echowing sim vee --set formation.followers=6 --set formation.spacing_m=3.5
  echowing sim my-flight.toml --law hold --set gps.sigma_m=1.2
  echowing sim echowing --plan my_plan.py --seed 1-3     your own plan (host_tools/LAWS.md)
  echowing sim swarm        followers without slots: simulated flights only, not with --serve
  echowing sim --serve 5760 --web                        watch them in a browser
  echowing sim --serve 5760 --parked --card out/cards    vehicles to try `echowing setup` on
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    from echowing.sim.scenario import LAWS  # noqa: PLC0415 (imported when the verb is used)
    from echowing.web.options import add_web_arguments  # noqa: PLC0415

    parser.epilog = EXAMPLES
    parser.add_argument(
        "scenario", nargs="?", default="echowing", help="a name from --list, or a TOML file"
    )
    parser.add_argument("--list", action="store_true", help="list the scenarios and stop")
    parser.add_argument(
        "--seed", default="1", metavar="N", help="seed of the random numbers, or a range: 1-10"
    )
    law = parser.add_argument(
        "--law",
        metavar="LAW",
        help=f"what the applet does: none, {', '.join(LAWS)}, or a .lua file of your own",
    )
    law.completer = lambda **_: ("none", *LAWS)  # type: ignore[attr-defined]
    parser.add_argument(
        "--plan",
        metavar="FILE",
        help="where a follower is to be, and how fast: a .py file of your own in place of the "
        "ground tool's plan (places of `echowing plan` are given as the scenario)",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="simulated seconds to fly")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="changes",
        help="change a key of the scenario, for example gps.sigma_m=0.5 (may be repeated)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write logs, truth and report here")
    parser.add_argument(
        "--firmware",
        choices=["native", "avr"],
        default="native",
        help="the co-processor: native is the firmware's core built for this machine, avr the "
        "mega's binary in an emulator",
    )
    parser.add_argument(
        "--serve",
        type=int,
        metavar="PORT",
        help="fly in real time, and let `echowing follow` and other tools connect: the leader on "
        "TCP PORT, followers on PORT+10, PORT+20 …; the tools guide the followers",
    )
    parser.add_argument(
        "--signing-key-file",
        type=Path,
        metavar="FILE",
        help="with --serve: sign the telemetry, and accept only signed messages",
    )
    parser.add_argument(
        "--parked",
        action="store_true",
        help="with --serve: the vehicles stand on the ground, disarmed and not set up",
    )
    parser.add_argument(
        "--card",
        type=Path,
        metavar="DIR",
        help="with --serve: the followers' SD cards are folders of DIR, named by system id; the "
        "applet in them is the one that runs",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per flight")
    add_web_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Fly, print, write."""
    if args.list:
        return _list(as_json=args.json)
    seeds = _seeds(args.seed)
    scenario = _scenario(args)
    for line in scenario.check_formation():
        print(f"echowing: {line}", file=sys.stderr)
    if args.serve is not None:
        from echowing.mavlink.signing import read_key  # noqa: PLC0415
        from echowing.sim.serve_flight import serve  # noqa: PLC0415
        from echowing.web.open import page_of  # noqa: PLC0415

        key = read_key(args.signing_key_file)
        where = {"parked": args.parked, "cards": args.card}
        with page_of(args, "sim") as page:
            return serve(scenario, seeds[0], args.serve, key, **where, page=page)
    if args.web is not None:
        raise EchowingError(
            "--web needs --serve PORT; `echowing replay DIR` shows a flight that was written with "
            "--out DIR"
        )
    if args.parked or args.card is not None:
        raise EchowingError("--parked and --card need --serve PORT")
    flown = list(_fly_all(scenario, seeds, args))
    if not args.json:
        _print_table(flown)
        if args.out is not None:
            _write_report(args.out, flown)
    return 0


def _list(*, as_json: bool) -> int:
    from echowing.sim.scenario import load_scenario, scenario_names  # noqa: PLC0415

    titles = {name: load_scenario(name).title for name in scenario_names()}
    if as_json:
        print(json.dumps(titles, indent=2))
        return 0
    width = max(map(len, titles))
    for name, title in titles.items():
        print(f"{name:<{width}}  {title}")
    return 0


def _scenario(args: argparse.Namespace) -> "Scenario":
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    changes = list(args.changes)
    if args.law is not None:
        changes.append(f'law="{args.law}"')
    if args.plan is not None:
        changes.append(f'plan="{args.plan}"')
    if args.duration is not None:
        changes.append(f"duration_s={args.duration}")
    return load_scenario(args.scenario, changes)


def _seeds(text: str) -> list[int]:
    first, dash, last = text.partition("-")
    try:
        low, high = int(first), int(last) if dash else int(first)
    except ValueError:
        raise EchowingError(f"--seed {text!r}: give a whole number, or a range: 1-10") from None
    if high < low:
        raise EchowingError(f"--seed {text!r}: the range is empty")
    return list(range(low, high + 1))


def _fly_all(
    scenario: "Scenario", seeds: list[int], args: argparse.Namespace
) -> Iterator["FlownScenario"]:
    from echowing.sim.progress import flight_progress  # noqa: PLC0415
    from echowing.sim.summary import fly  # noqa: PLC0415

    with flight_progress(len(seeds) * scenario.duration_s, quiet=args.json) as progress:
        for seed in seeds:
            out = _flight_folder(args.out, scenario, seed, alone=len(seeds) == 1)
            flown = fly(scenario, seed, out=out, firmware=args.firmware, progress=progress)
            progress.next_flight()
            for summary in flown.summaries:
                if args.json:
                    print(json.dumps(summary), flush=True)
            yield flown


def _flight_folder(
    out: Path | None, scenario: "Scenario", seed: int, *, alone: bool
) -> Path | None:
    if out is None:
        return None
    folder = out if alone else out / f"{scenario.name}-{seed}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    return folder


def _print_table(flown: "list[FlownScenario]") -> None:
    from rich.console import Console  # noqa: PLC0415

    from echowing.analysis.tables import terminal_table  # noqa: PLC0415

    Console().print(terminal_table([result for one in flown for result in one.results()]))


def _write_report(out: Path, flown: "list[FlownScenario]") -> None:
    from echowing.analysis.page import told  # noqa: PLC0415
    from echowing.analysis.report import write_report  # noqa: PLC0415

    path = out / "report.html"
    results = [result for one in flown for result in one.results()]
    flights = [flight for one in flown for flight in one.flights]
    left_out = [one_metrics.settle_s for one in flown for one_metrics in one.metrics]
    write_report(path, flights, results, settle_s=left_out)
    print(f"report: {told(path)}")
