"""`echowing bench`: speeds, sizes, and how the speed laws compare, each beside its goal."""

import argparse
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.sim.law_table import LawRow

EXAMPLES = """\
examples:
  echowing bench
  echowing bench --only speed --json
  echowing bench --only field         the follow tool: latency, and 50 followers on one core
  echowing bench --only echoes        what late echoes do to the sonar's readings (half a minute)
  echowing bench --only laws          the speed laws, 20 seeds, about 5 minutes on two cores
  echowing bench --only laws --seeds 3
"""

SECTIONS = ("speed", "field", "firmware", "echoes", "laws")


@dataclass(frozen=True)
class Figure:
    """One measured figure; goal: what it should be, in words."""

    what: str
    value: float
    unit: str
    goal: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--only", choices=SECTIONS, help="measure one section only")
    parser.add_argument("--seeds", type=int, default=20, help="flights a law and path (20)")
    parser.add_argument("--json", action="store_true", help="print one JSON list")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.seeds < 1:
        raise EchowingError(f"--seeds {args.seeds}: give 1 or more")
    sections: dict[str, Callable[[], Iterator[Figure]]] = {
        "speed": _speed,
        "field": _field,
        "firmware": _firmware,
    }
    chosen = [args.only] if args.only else list(SECTIONS)
    figures = [figure for name in chosen if name in sections for figure in sections[name]()]
    if figures and not args.json:
        _print(figures)
        if "field" in chosen:
            _print_definition()
    if "echoes" in chosen:
        figures += _echoes(quiet=args.json)
    if "laws" in chosen:
        table = _fly_laws(args.seeds, quiet=args.json)
        figures += _law_figures(table)
        if not args.json:
            _print_laws(table)
    if args.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
    return 0


def _print(figures: list[Figure]) -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)
    from rich.table import Table  # noqa: PLC0415

    table = Table("measured", "value", "unit", "goal")
    for figure in figures:
        value = f"{figure.value:,.0f}" if figure.value >= 100 else f"{figure.value:.3g}"
        table.add_row(figure.what, value, figure.unit, figure.goal)
    Console().print(table)


def _print_definition() -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)

    from echowing.sim.field_figures import DEFINITION  # noqa: PLC0415

    Console().print(DEFINITION, highlight=False)


def _fly_laws(seeds: int, *, quiet: bool) -> "list[LawRow]":
    """Fly them on all cores, a bar on the terminal."""
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn  # noqa: PLC0415

    from echowing.sim.law_table import flight_count, fly_laws  # noqa: PLC0415

    columns = ("flying the laws", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True, quiet=quiet)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=flight_count(seeds))
        return fly_laws(seeds, lambda: bar.advance(task))


def _print_laws(table: "list[LawRow]") -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.table import Column, Table  # noqa: PLC0415

    from echowing.sim.law_table import DURATION_S, best_law  # noqa: PLC0415

    head = ("leader", "law", "n", "mean |e|", "RMSD", "least", "attacked", "changes/min")
    shown = Table(*(Column(one, no_wrap=True) for one in (*head, "dead-locked", "safe")))
    for row in table:
        errors = (f"{row.mean_error_m:.3f}", f"{row.rmsd_m:.3f}", f"{row.least_m:.2f}")
        attacked = f"{row.attacked_m:.2f}" if math.isfinite(row.attacked_m) else "-"
        counts = (f"{row.changes_per_min:.0f}", str(row.dead_locked), "yes" if row.safe else "no")
        shown.add_row(row.path, row.law, str(row.flights), *errors, attacked, *counts)
    console = Console() if sys.stdout.isatty() else Console(width=110)
    console.print(shown)
    console.print(
        f"Metres; {DURATION_S:g} s per flight, hostile 200 s. Safe: over 1.0 m in every run, 0.5 m "
        "from a leader that flies at its follower; for all: hostile too.\n"
        f"Lowest RMSD of the safe ones: {best_law(table) or 'none is safe'}.",
        highlight=False,
    )


def _law_figures(table: "list[LawRow]") -> Iterator[Figure]:
    for row in table:
        name = f"{row.law}, {row.path}"
        yield Figure(f"{name}: mean error", row.mean_error_m, "m")
        yield Figure(f"{name}: RMSD", row.rmsd_m, "m")
        yield Figure(f"{name}: minimum separation", row.least_m, "m", "over 1.0")
        if math.isfinite(row.attacked_m):
            yield Figure(f"{name}: the same, attacked", row.attacked_m, "m", "over 0.5")
        yield Figure(f"{name}: speed changes", row.changes_per_min, "1/min")


def _echoes(*, quiet: bool) -> list[Figure]:
    """The table in Markdown, as firmware/README.md has it."""
    from echowing.sim.late_echoes import late_echoes, markdown  # noqa: PLC0415

    rows = list(late_echoes())
    if not quiet:
        print(markdown(rows))
    return [
        Figure(f"{row.period_ms} ms +- {row.jitter_ms}, {row.scene}: {what}", share, "")
        for row in rows
        for what, share in (("false", row.false), ("missed", row.missed))
    ]


def _field() -> Iterator[Figure]:
    from echowing.sim.field_figures import field_figures  # noqa: PLC0415

    return (Figure(*figure) for figure in field_figures())


def _firmware() -> Iterator[Figure]:
    from echowing.sim.firmware_figures import firmware_figures  # noqa: PLC0415

    return (Figure(*figure) for figure in firmware_figures())


def _speed() -> Iterator[Figure]:
    yield _flight_speed("echowing", 60, "one flight, simulated per wall", "at least 50")
    yield _campaign_speed()
    yield _flight_speed("many", 22, "50 followers, simulated per wall", "")
    yield _guidance_time()
    yield _help_time()


def _flight_speed(scenario: str, duration_s: int, what: str, goal: str) -> Figure:
    from echowing.sim.flight import FormationFlight  # noqa: PLC0415
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    flight = FormationFlight(load_scenario(scenario, [f"duration_s={duration_s}"]), seed=1)
    result = flight.run()
    return Figure(what, result.simulated_s / result.wall_s, "s/s", goal)


def _campaign_speed(flights: int = 6) -> Figure:
    """Of the shipped campaign, worked out for two workers from the processor's time of one."""
    from echowing.campaign.draw import load_description  # noqa: PLC0415
    from echowing.campaign.fly import fly_one  # noqa: PLC0415

    description = load_description()
    started_s = time.process_time()
    for index in range(1, flights + 1):  # the first has its logs read
        fly_one(description, 1, index)
    per_hour = 2.0 * flights / (time.process_time() - started_s) * 3600.0
    return Figure("campaign on two cores, flights an hour", per_hour, "1/h", "")


def _guidance_time(points: int = 5000) -> Figure:
    from echowing.flight.guidance import GuidanceSettings, LeaderFix, Slot, SlotGuide  # noqa: PLC0415
    from echowing.geo import GlobalPosition, displace  # noqa: PLC0415

    here = GlobalPosition(39.34, -86.03, 260.0)
    follower = displace(here, (-3.0, 0.5, 0.0))
    fix = LeaderFix(0.0, here, (2.0, 0.1, 0.0), 0.0)
    guide = SlotGuide(Slot(3.0), GuidanceSettings())
    started_s = time.perf_counter()
    for _ in range(points):
        guide.update(fix, 0.46, follower)
    per_point_us = (time.perf_counter() - started_s) / points * 1e6
    return Figure("guidance, one point", per_point_us, "us", "under 50")


def _help_time(runs: int = 5) -> Figure:
    def once() -> float:
        started_s = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "echowing", "--help"], check=True, stdout=subprocess.DEVNULL
        )
        return time.perf_counter() - started_s

    once()
    return Figure(
        "echowing --help", statistics.median(once() for _ in range(runs)), "s", "under 0.3"
    )
