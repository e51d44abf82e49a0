"""`echowing campaign`: fly thousands of drawn flights with faults, and keep what any found."""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from echowing.errors import EchowingError
from echowing.extras import require

if TYPE_CHECKING:
    from echowing.campaign.fly import Row
    from echowing.campaign.run import Order

EXAMPLES = """\
examples:
  echowing campaign --flights 10000 --seed 1 --out out/campaign
  echowing campaign --flights 10000 --seed 1 --out out/campaign --resume
  echowing campaign --flights 200 --workers 1 --json
  echowing campaign --scheduler tcp://10.0.0.7:8786 --flights 100000 --out out/large
  echowing campaign my-field.toml --flights 500
  echowing campaign many --flights 16 --no-shrink --out out/many
The exit code is 1 where a flight broke a property, 130 where it was interrupted.
"""
EXIT_FOUND, EXIT_INTERRUPTED = 1, 130
# Where nobody watches a bar a line says how far it is.
LINE_PERIOD_S = 60.0
DEFAULT_OUT = Path("out") / "campaign"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "description",
        nargs="?",
        default="field",
        help="what flights are drawn from: field (default), many, formations, or a TOML file",
    )
    parser.add_argument("--flights", type=int, default=1000, metavar="N", help="how many (1000)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of all chance (1)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=int, metavar="N", help="processes on this machine (one per core)"
    )
    where.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="a Dask scheduler with workers of its own"
    )
    parser.add_argument(
        "--out", type=Path, default=DEFAULT_OUT, metavar="DIR", help=f"folder ({DEFAULT_OUT})"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the campaign in --out")
    parser.add_argument(
        "--no-shrink", action="store_true", help="keep the finds as they are, without files"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as a JSON object")


def run(args: argparse.Namespace) -> int:
    """Fly, shrink, report."""
    require("campaign")
    from echowing.campaign.draw import load_description  # noqa: PLC0415 (imported when used)
    from echowing.campaign.run import Order  # noqa: PLC0415

    _check(args)
    workers = args.workers or os.cpu_count() or 1
    order = Order(
        load_description(args.description), args.seed, args.flights, workers, args.scheduler
    )
    return _campaign(order, args)


def _check(args: argparse.Namespace) -> None:
    for name in ("flights", "workers"):
        value = getattr(args, name)
        if value is not None and value < 1:
            raise EchowingError(f"--{name} {value}: give 1 or more")


def _campaign(order: "Order", args: argparse.Namespace) -> int:
    from echowing.campaign.files import Folder  # noqa: PLC0415
    from echowing.campaign.report import write_report  # noqa: PLC0415
    from echowing.campaign.run import fly_all, shrink_all  # noqa: PLC0415
    from echowing.campaign.workers import connected  # noqa: PLC0415
    from echowing.stopping import stop_on_signals  # noqa: PLC0415

    folder = Folder(args.out)
    done = folder.begin(order.description, order.seed, resume=args.resume)
    done = {index: row for index, row in done.items() if index < order.flights}
    with stop_on_signals() as stop:
        with connected(order.workers, order.scheduler) as client:
            with _progress(len(done), order.flights, quiet=args.json) as shown:

                def keep(row: "Row") -> None:
                    folder.add(row)
                    shown(bool(row["broken"]))

                rows = fly_all(order, done, keep, stop, client)
            whole = len(rows) == order.flights
            if whole and not args.no_shrink:
                shrink_all(order, rows.values(), folder.path, stop, client)
        interrupted = stop()
    if whole:
        folder.sort(rows.values())
    folder.write_parquet(rows.values())
    report = write_report(folder.path, list(rows.values()), order.seed, order.description.kinds)
    summary = _summary(order, list(rows.values()), report)
    print(json.dumps(summary) if args.json else _told(summary, whole=whole, out=args.out))
    if interrupted:
        return EXIT_INTERRUPTED
    return EXIT_FOUND if summary["broken"] else 0


def _summary(order: "Order", rows: "list[Row]", report: Path) -> dict[str, Any]:
    from echowing.campaign.run import finds_of  # noqa: PLC0415

    closest = [row["closest_m"] for row in rows if "closest_m" in row]
    return {
        "flights": len(rows),
        "of": order.flights,
        "seed": order.seed,
        "hours": round(sum(row.get("duration_s", 0.0) for row in rows) / 3600.0, 3),
        "closest_m": min(closest, default=None),
        "broken": {name: len(entries) for name, entries in finds_of(rows).items()},
        "report": str(report),
    }


def _told(summary: dict[str, Any], *, whole: bool, out: Path) -> str:
    lines = [
        f"{summary['flights']} flights, {summary['hours']:.1f} hours in the air, seed "
        f"{summary['seed']}: least distance {summary['closest_m']} m"
    ]
    lines += [f"  {name}: broken in {count}" for name, count in summary["broken"].items()]
    if not summary["broken"]:
        lines.append("  every property held")
    lines.append(f"report: {summary['report']}")
    if not whole:
        left = summary["of"] - summary["flights"]
        lines.append(f"{left} flights are left: go on with --resume --out {out}")
    return "\n".join(lines)


@contextmanager
def _progress(done: int, total: int, *, quiet: bool) -> Iterator[Callable[[bool], None]]:
    """Takes each flight with whether it found something; a bar, or a line a minute."""
    started_s = told_s = time.monotonic()
    flown = finds = 0

    def count(found: bool) -> None:
        nonlocal flown, finds
        flown += 1
        finds += found

    def line() -> str:
        spent_s = max(1e-9, time.monotonic() - started_s)
        per_hour = flown / spent_s * 3600.0
        left_s = (total - done - flown) / max(per_hour, 1e-9) * 3600.0
        return (
            f"{done + flown}/{total} flights, {per_hour:,.0f} an hour, "
            f"{_duration(left_s)} left, {finds} with a find"
        )

    if quiet or not sys.stderr.isatty():

        def by_line(found: bool) -> None:
            nonlocal told_s
            count(found)
            if not quiet and time.monotonic() - told_s >= LINE_PERIOD_S:
                told_s = time.monotonic()
                print(line(), file=sys.stderr, flush=True)

        yield by_line
        return
    from rich.console import Console  # noqa: PLC0415 (slow import, seldom needed)
    from rich.progress import BarColumn, Progress, TextColumn  # noqa: PLC0415

    columns = (BarColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(line(), total=total, completed=done)

        def by_bar(found: bool) -> None:
            count(found)
            bar.update(task, completed=done + flown, description=line())

        yield by_bar


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"
