"""`echowing bench`: speeds, sizes, and how the speed laws compare, each beside its goal."""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

EXAMPLES = """\
examples:
  echowing bench
  echowing bench --only speed --json
"""

SECTIONS = ("speed",)


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
    parser.add_argument("--json", action="store_true", help="print one JSON list")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    sections: dict[str, Callable[[], Iterator[Figure]]] = {"speed": _speed}
    chosen = [args.only] if args.only else list(SECTIONS)
    figures = [figure for name in chosen for figure in sections[name]()]
    if args.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
        return 0
    _print(figures)
    return 0


def _print(figures: list[Figure]) -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)
    from rich.table import Table  # noqa: PLC0415

    table = Table("measured", "value", "unit", "goal")
    for figure in figures:
        table.add_row(figure.what, f"{figure.value:.3g}", figure.unit, figure.goal)
    Console().print(table)


def _speed() -> Iterator[Figure]:
    yield _flight_speed("echowing", 60, "one flight, simulated per wall", "at least 50")
    yield _flight_speed("many", 22, "50 followers, simulated per wall", "")
    yield _guidance_time()
    yield _help_time()


def _flight_speed(scenario: str, duration_s: int, what: str, goal: str) -> Figure:
    from echowing.sim.flight import FormationFlight  # noqa: PLC0415
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    flight = FormationFlight(load_scenario(scenario, [f"duration_s={duration_s}"]), seed=1)
    result = flight.run()
    return Figure(what, result.simulated_s / result.wall_s, "s/s", goal)


def _guidance_time(points: int = 5000) -> Figure:
    from echowing.geo import GlobalPosition, displace  # noqa: PLC0415
    from echowing.guidance import GuidanceSettings, LeaderFix, Slot, SlotGuide  # noqa: PLC0415

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
