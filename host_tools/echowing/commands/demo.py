"""`echowing demo`: fly every scenario, print one table, write one report."""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.analysis.tables import CALLED
from echowing.errors import EchowingError
from echowing.extras import require

if TYPE_CHECKING:
    from rich.console import Console

    from echowing.sim.summary import FlownScenario

EXAMPLES = """\
examples:
  echowing demo
  echowing demo --seeds 50 --out out/fifty
"""


@dataclass(frozen=True)
class Task:
    """One flight of the demo.

    shown: plotted, with its logs kept. as_flashed: on the chosen firmware, not on the native one.
    """

    scenario: str
    seed: int = 1
    changes: tuple[str, ...] = ()
    shown: bool = False
    as_flashed: bool = False


# Each takes as long as five flights of a pair.
FORMATIONS = ("column",)
# The scenarios of the table, in its order; walls and walks get one sentence each.
TABLED = (
    "gray",
    "thesis",
    "echowing",
    *FORMATIONS,
    "thesis-4m",
    "thesis-initial",
    "hostile",
)
# Flown first, and each told as it ends: the comparison that README leads with.
COMPARED = {Task(name): said for (name, _), said in CALLED.items()}
# The last of the plotted flight: 200 m at 2 m/s.
LAP_S = 100.0
# Where nobody sees a bar.
LINE_PERIOD_S = 10.0
# The leader carried by hand, the slot commanded with and without prediction (thesis 4.2.3).
WALKS = {
    "as reported": Task("walked-leader", 1, ("guidance.predict=false",)),
    "predicted": Task("walked-leader", 1, ("guidance.predict=true",)),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/demo"),
        metavar="DIR",
        help="write report and tables here (out/demo)",
    )
    parser.add_argument(
        "--seeds", type=int, default=6, metavar="N", help="flights per scheme in the comparison (6)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes (one per core)",
    )
    parser.add_argument(
        "--firmware",
        choices=["native", "avr"],
        default="avr",
        help="the co-processor of the plotted flight of `echowing`: native is the firmware's core "
        "built for this machine, avr the mega's binary in an emulator",
    )


def run(args: argparse.Namespace) -> int:
    """Fly, print the table, write the report."""
    if args.seeds < 1 or args.jobs < 1:
        raise EchowingError("--seeds and --jobs: give 1 or more")
    require("sim")
    folder = _folder(args.out)
    tasks = plan(args.seeds)
    flown = _fly_all(tasks, args)
    _write_json(folder / "results.json", flown)
    with ProcessPoolExecutor(args.jobs) as pool:
        walls = [task for task in tasks if task.scenario == "wall"]
        stops_mps = dict(zip(walls, pool.map(_stops_up_to_mps, walls), strict=True))
    _present(folder, tasks, flown, stops_mps)
    return 0


def plan(seeds: int) -> list[Task]:
    """The flights of the demo: the comparison, then the longest so that the cores end together."""
    schemes = ("gray", "thesis", "echowing")
    return [
        *COMPARED,
        *(
            Task(name, 1, ("duration_s=130",), shown=True, as_flashed=name == "echowing")
            for name in schemes
        ),
        *(Task(name) for name in FORMATIONS),
        *(Task(name, seed) for name in schemes for seed in range(2, seeds + 1)),
        *(Task(name, seed) for name in ("thesis-4m", "thesis-initial") for seed in (1, 2, 3)),
        *(Task("hostile", seed, (), shown=seed == 1) for seed in (1, 2, 3, 4, 5)),
        Task("wall", shown=True),
        Task("wall", 1, ("law=thesis",), shown=True),
        *WALKS.values(),
    ]


def _fly_all(tasks: Sequence[Task], args: argparse.Namespace) -> "list[FlownScenario]":
    """Fly on all cores, and tell how far it is; in the order of the tasks."""
    with ProcessPoolExecutor(args.jobs) as pool, _progress(len(tasks)) as told:
        futures = {pool.submit(_fly, task, args.out, args.firmware): task for task in tasks}
        flown: dict[Task, FlownScenario] = {}
        for future in as_completed(futures):
            task = futures[future]
            flown[task] = future.result()
            told(task, flown[task])
    return [flown[task] for task in tasks]


Told = Callable[[Task, "FlownScenario"], None]


@contextmanager
def _progress(total: int) -> Iterator[Told]:
    """Takes each flight as it ends: shows the compared ones, and a bar, or a line now and then."""
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)

    console = Console(stderr=True)
    with _bar(console, total) if console.is_terminal else _lines(console, total) as advance:

        def told(task: Task, flown: "FlownScenario") -> None:
            if task in COMPARED:
                console.print(compared(COMPARED[task], flown), highlight=False, soft_wrap=True)
            advance(task)

        yield told


def compared(name: str, flown: "FlownScenario") -> str:
    """The figures of one of the compared flights."""
    (figures,) = flown.metrics
    lost = ", lost its leader for good" if flown.dead_locked else ""
    return (
        f"one flight by {name}: mean error {figures.mean_abs_error_m:.2f} m, "
        f"RMSD {figures.rmsd_m:.2f} m, least separation {figures.min_separation_m:.2f} m{lost}"
    )


@contextmanager
def _bar(console: "Console", total: int) -> Iterator[Callable[[Task], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    text = TextColumn("flying {task.description:<16}")
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        shown = bar.add_task("", total=total)
        yield lambda task: bar.update(shown, advance=1, description=task.scenario)


@contextmanager
def _lines(console: "Console", total: int) -> Iterator[Callable[[Task], None]]:
    console.print(f"flying {total} flights")
    started_s = told_s = time.monotonic()
    flown = 0

    def advance(task: Task) -> None:
        nonlocal flown, told_s
        flown += 1
        now_s = time.monotonic()
        if flown == total or now_s - told_s >= LINE_PERIOD_S:
            told_s = now_s
            console.print(f"{flown} of {total} flown, {now_s - started_s:.0f} s", highlight=False)

    yield advance


def _fly(task: Task, out: Path, firmware: str) -> "FlownScenario":
    """One task, in a process of its own."""
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415
    from echowing.sim.summary import fly  # noqa: PLC0415

    scenario = load_scenario(task.scenario, task.changes)
    if not task.shown:
        return fly(scenario, task.seed)
    folder = out / f"{scenario.name}-{scenario.law}"
    folder.mkdir(parents=True, exist_ok=True)
    return fly(scenario, task.seed, out=folder, firmware=firmware if task.as_flashed else "native")


def _stops_up_to_mps(task: Task) -> float:
    """Up to which speed the law of a wall's flight stops, in a process of its own."""
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415
    from echowing.sim.wall import highest_stopping_speed_mps  # noqa: PLC0415

    return highest_stopping_speed_mps(load_scenario(task.scenario, task.changes), task.seed)


def _write_json(path: Path, flown: "Sequence[FlownScenario]") -> None:
    rows = [summary for one in flown for summary in one.summaries]
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _present(
    folder: Path,
    tasks: Sequence[Task],
    flown: "Sequence[FlownScenario]",
    stops_mps: dict[Task, float],
) -> None:
    """The tables on the terminal and as Markdown, the report, and where they are."""
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)

    from echowing.analysis.picture import write_formation_svg  # noqa: PLC0415
    from echowing.analysis.report import write_report  # noqa: PLC0415
    from echowing.analysis.tables import markdown_tables, terminal_table  # noqa: PLC0415

    by_task = dict(zip(tasks, flown, strict=True))
    results = [
        result
        for name in TABLED
        for task, one in by_task.items()
        if task.scenario == name and not task.changes
        for result in one.results()
    ]
    notes = [*_apart(by_task), *_walked(by_task), *_walls(by_task, stops_mps), *_hostile(flown)]
    console = Console() if sys.stdout.isatty() else Console(width=100)
    console.print(terminal_table(results))
    for note in notes:
        console.print(note, highlight=False)
    shown = [flight for task, one in by_task.items() if task.shown for flight in one.flights]
    left_out = [
        figures.settle_s for task, one in by_task.items() if task.shown for figures in one.metrics
    ]
    (folder / "table.md").write_text(
        markdown_tables(results) + "".join(f"\n{note}\n" for note in notes), encoding="utf-8"
    )
    ours = next(flight for flight in shown if flight.name == "echowing")
    lap = ours, (float(ours.time_s[-1]) - LAP_S, math.inf)
    write_report(folder / "report.html", shown, results, notes, settle_s=left_out, pictured=lap)
    write_formation_svg(folder / "formation.svg", ours)
    console.print(f"report: {folder / 'report.html'}", highlight=False)


def _apart(flown: "dict[Task, FlownScenario]") -> list[str]:
    """How near any two vehicles of a formation came, not only those of one gap."""
    parts = [
        f"{task.scenario} {one.closest_m:.2f}"
        for task, one in flown.items()
        if task.scenario in FORMATIONS
    ]
    return [f"Formation, least separation between any two, m: {', '.join(parts)}."]


def _walked(flown: "dict[Task, FlownScenario]") -> list[str]:
    """The commanded slot behind a walked leader, beside what thesis 4.2.3 says of its own."""
    parts = []
    for label, task in WALKS.items():
        slot = flown[task].commanded_slot
        parts.append(
            f"{label} {slot['mean_m']:.3f} m, sigma {slot['std_m']:.3f} m, "
            f"largest error {slot['max_error_m']:.2f} m"
        )
    return [
        "Commanded slot behind a leader carried by hand (before the lead is added): "
        + "; ".join(parts)
        + ". Thesis 4.2.3: 3.005 m, sigma 0.279 m, largest 0.9 m."
    ]


def _walls(flown: "dict[Task, FlownScenario]", stops_mps: dict[Task, float]) -> list[str]:
    """How near each law came to the wall, and up to which speed it stops."""
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    parts = []
    for task, limit_mps in stops_mps.items():
        one, wall = flown[task], load_scenario(task.scenario, task.changes).wall
        parts.append(
            f"{one.law} law nearest {one.closest_m:.2f} m at {wall.speed_mps:g} m/s, "
            f"stops up to {limit_mps:g} m/s"
        )
    return [
        "Wall, target 5 m behind it: " + "; ".join(parts) + ". The applet's too-close guard is on "
        "under every law."
    ]


def _hostile(flown: "Sequence[FlownScenario]") -> list[str]:
    """The least separation in each part of the hostile script, over its seeds."""
    runs = [one.phases for one in flown if one.scenario == "hostile"]
    least = {label: min(run[label] for run in runs) for label in runs[0]}
    parts = ", ".join(f"{label} {metres:.2f}" for label, metres in least.items())
    return [f"Hostile leader, least separation over {len(runs)} flights, m: {parts}."]


def _folder(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    return out
