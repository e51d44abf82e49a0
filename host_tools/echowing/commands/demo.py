"""`echowing demo`: fly every scenario, print one table, write one report."""

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.sim.summary import FlownScenario

EXAMPLES = """\
examples:
  echowing demo
  echowing demo --seeds 20 --out out/twenty
"""



@dataclass(frozen=True)
class Task:
    """One flight of the demo; `shown`: plotted, with its logs kept, on the chosen firmware."""

    scenario: str
    seed: int = 1
    changes: tuple[str, ...] = ()
    shown: bool = False
    label: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="DIR")
    parser.add_argument(
        "--seeds", type=int, default=10, metavar="N", help="flights a scheme in the comparison"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument(
        "--firmware",
        choices=["native", "avr"],
        default="native",
        help="the co-processor in the flights that are plotted",
    )


def run(args: argparse.Namespace) -> int:
    """Fly, print the table, write the report."""
    if args.seeds < 1 or args.jobs < 1:
        raise EchowingError("--seeds and --jobs: give 1 or more")
    folder = _folder(args.out)
    tasks = plan(args.seeds)
    flown = _fly_all(tasks, args)
    (folder / "results.json").write_text(_as_json(tasks, flown), encoding="utf-8")
    _present(folder, tasks, flown)
    return 0


def plan(seeds: int) -> list[Task]:
    """The flights of the demo, the longest first so that the cores end together."""
    schemes = ("gray", "thesis", "echowing")
    return [
        *(Task(name, 1, ("duration_s=130",), shown=True) for name in schemes),
        Task("many"),
        *(Task(name, seed) for name in schemes for seed in range(1, seeds + 1)),
        *(Task(name, seed) for name in ("thesis-4m", "thesis-initial") for seed in (1, 2, 3)),
        *(Task("hostile", seed, (), shown=seed == 1) for seed in (1, 2, 3, 4, 5)),
        Task("wall", 1, (), shown=True),
        Task("wall", 1, ("law=thesis",), shown=True),
        Task("walked-leader", 1, ("guidance.predict=false",), label="as reported"),
        Task("walked-leader", 1, ("guidance.predict=true",), label="predicted"),
    ]


def _fly_all(tasks: Sequence[Task], args: argparse.Namespace) -> "list[FlownScenario]":
    """Fly on all cores, a bar on the terminal; in the order of the tasks."""
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    columns = (
        TextColumn("flying {task.description:<16}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with (
        ProcessPoolExecutor(args.jobs) as pool,
        Progress(*columns, console=Console(stderr=True)) as bar,
    ):
        shown = bar.add_task("", total=len(tasks))
        futures = {pool.submit(_fly, task, args.out, args.firmware): task for task in tasks}
        flown: dict[Task, FlownScenario] = {}
        for future in as_completed(futures):
            task = futures[future]
            flown[task] = future.result()
            bar.update(shown, advance=1, description=task.scenario)
    return [flown[task] for task in tasks]


def _fly(task: Task, out: Path, firmware: str) -> "FlownScenario":
    """One task, in a process of its own."""
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415
    from echowing.sim.summary import fly  # noqa: PLC0415

    scenario = load_scenario(task.scenario, task.changes)
    if not task.shown:
        return fly(scenario, task.seed)
    folder = out / f"{scenario.name}-{scenario.law}"
    folder.mkdir(parents=True, exist_ok=True)
    return fly(scenario, task.seed, out=folder, firmware=firmware)


def _folder(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchowingError(f"--out {out}: cannot be written: {error}") from error
    return out
