"""`echowing bench`: speeds, sizes, and how the speed laws compare, each beside its goal."""

import argparse
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.bench.accuracy import Kept
    from echowing.bench.formations import FormationRow
    from echowing.bench.laws import LawRow
    from echowing.bench.robust import Robust
    from echowing.bench.swarm import SwarmRow

EXAMPLES = """\
examples:
  echowing bench
  echowing bench --only speed --json
  echowing bench --only field         the follow tool: latency, and 50 followers on one core
  echowing bench --only echoes        what late echoes do to the sonar's readings (half a minute)
  echowing bench --only laws          the speed laws, 20 seeds, about 5 minutes on two cores
  echowing bench --only laws --seeds 3 --law my_law.lua --plan my_plan.py
  echowing bench --only accuracy      how well the distance is kept, 20 seeds, about 16 minutes
  echowing bench --only robust        the same with other sonars, receivers and heights than
                                      believed, and any two at once: 20 seeds, about an hour
  echowing bench --only formations --seeds 4   columns, vees and others, about 15 minutes
  echowing bench --only swarm --seeds 4   what holds a swarm together, about 11 minutes
"""

SECTIONS = (
    "speed",
    "field",
    "firmware",
    "echoes",
    "laws",
    "accuracy",
    "robust",
    "swarm",
    "formations",
)


@dataclass(frozen=True)
class Figure:
    """One measured figure; goal: what it should be, in words; met: whether it is, where judged."""

    what: str
    value: float
    unit: str
    goal: str = ""
    met: bool | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--only", choices=SECTIONS, help="measure one section only")
    parser.add_argument(
        "--seeds", type=int, default=20, help="flights per law and path, or per row (20)"
    )
    parser.add_argument(
        "--law",
        action="append",
        default=[],
        metavar="FILE",
        help="with the laws: an applet of your own beside them, a .lua file (may be repeated)",
    )
    parser.add_argument(
        "--plan",
        action="append",
        default=[],
        metavar="FILE",
        help="with the laws: hold with a plan of your own beside them, a .py file (may be "
        "repeated)",
    )
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
    tables: dict[str, Callable[[], list[Figure]]] = {
        "echoes": partial(_echoes, quiet=args.json),
        "laws": partial(_laws, args.seeds, [*args.law, *args.plan], quiet=args.json),
        "accuracy": partial(_accuracy, args.seeds, quiet=args.json),
        "robust": partial(_robust, args.seeds, quiet=args.json),
        "swarm": partial(_swarm, args.seeds, quiet=args.json),
        "formations": partial(_formations, args.seeds, quiet=args.json),
    }
    figures += [figure for name in chosen if name in tables for figure in tables[name]()]
    if args.json:
        print(json.dumps([_plain(figure) for figure in figures], indent=2))
    return 0


def _plain(figure: Figure) -> dict[str, Any]:
    """A figure as JSON takes it: null for one that is none, as when a leader is never found."""
    return {**asdict(figure), "value": figure.value if math.isfinite(figure.value) else None}


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

    from echowing.bench.field import DEFINITION  # noqa: PLC0415

    Console().print(DEFINITION, highlight=False)


def _laws(seeds: int, own: list[str], *, quiet: bool) -> list[Figure]:
    """Fly them on all cores, and beside them the user's own."""
    from echowing.bench.laws import flight_count, flown_as, fly_laws  # noqa: PLC0415
    from echowing.sim.scenario import LAWS, load_scenario  # noqa: PLC0415

    laws = (*LAWS, *own)
    for law in own:
        load_scenario("echowing", [flown_as(law)])  # what is wrong with it shows at once
    with _bar("flying the laws", flight_count(seeds, laws), quiet=quiet) as advance:
        table = fly_laws(seeds, advance, laws=laws)
    if not quiet:
        _print_laws(table)
    return list(_law_figures(table))


def _accuracy(seeds: int, *, quiet: bool) -> list[Figure]:
    """Fly them on all cores."""
    from echowing.bench.accuracy import flight_count, fly_accuracy  # noqa: PLC0415

    with _bar("flying for accuracy", flight_count(seeds), quiet=quiet) as advance:
        kept = fly_accuracy(seeds, advance)
    if not quiet:
        _print_accuracy(kept)
    return list(_accuracy_figures(kept))


def _robust(seeds: int, *, quiet: bool) -> list[Figure]:
    """Fly them on all cores."""
    from echowing.bench.robust import flight_count, fly_robust  # noqa: PLC0415

    with _bar("flying in other worlds", flight_count(seeds), quiet=quiet) as advance:
        robust = fly_robust(seeds, advance)
    if not quiet:
        _print_robust(robust)
    return list(_robust_figures(robust))


@contextmanager
def _bar(text: str, total: int, *, quiet: bool) -> Iterator[Callable[[], None]]:
    """A bar on the terminal; what it gives is called after each flight."""
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn  # noqa: PLC0415

    columns = (text, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True, quiet=quiet), transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda: bar.advance(task)


def _print_accuracy(kept: "list[Kept]") -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.table import Column, Table  # noqa: PLC0415

    head = ("mean |e|", "RMSD", "least", "found, s", "in reach", "known", "bound", "")
    shown = Table("flown", *(Column(one, no_wrap=True) for one in ("n", *head)))
    for one in kept:
        known = f"{one.known_error_m:.2f}", f"{one.bound_rmsd_m:.2f}"
        shown.add_row(*_judged(one), f"{one.reached_s:.0f}", *known, _verdict(one))
    console = Console() if sys.stdout.isatty() else Console(width=150)
    console.print(shown)
    console.print(
        "Metres; in brackets the goal. Echowing with its defaults in each row, wanted distance "
        "3 m, leader at 2 m/s where not said otherwise. Found: the longest until the sonar has "
        "the leader, from a start 3 m outside the slot; in reach: until it is near enough to be "
        "heard at all. Known: mean error with the receivers' disagreement known; bound: RMSD with "
        "it known, and with the estimate's own standard deviation.",
        highlight=False,
    )


def _judged(one: "Kept") -> tuple[str, ...]:
    """A row's figures, each with its goal where it has one."""
    goal = one.row.goal
    return (
        one.row.name,
        str(len(one.flights)),
        f"{one.mean_error_m:.2f}{_in_brackets(goal.mean_error_m, 2)}",
        f"{one.rmsd_m:.2f}{_in_brackets(goal.rmsd_m, 2)}",
        f"{one.least_m:.2f}{_in_brackets(goal.least_m, 1)}",
        f"{one.found_s:.0f}{_in_brackets(goal.found_s, 0)}",
    )


def _in_brackets(goal: float, digits: int) -> str:
    return f" ({goal:.{digits}f})" if math.isfinite(goal) else ""


def _verdict(one: "Kept") -> str:
    return f"FAIL: {', '.join(one.missed)}" if one.missed else "PASS"


def _print_robust(robust: "Robust") -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.table import Column, Table  # noqa: PLC0415

    head = ("n", "mean |e|", "RMSD", "least", "found, s", "under 1 m", "beyond", "")
    shown, two = (
        Table(what, *(Column(one, no_wrap=True) for one in head))
        for what in ("different", "any two of them")
    )
    for table, rows in ((shown, (*robust.rows, robust.together)), (two, robust.pairs)):
        for one in rows:
            counted = str(one.under), f"{one.beyond_share:.1%}"
            table.add_row(*_judged(one), *counted, _verdict(one))
    console = Console() if sys.stdout.isatty() else Console(width=150)
    console.print(shown, two)
    console.print(
        "Metres; in brackets the goal. Echowing with its defaults, wanted distance 3 m, leader at "
        "2 m/s; sonars and receivers drawn around what is believed, heights that wander by 0.5 m, "
        "and in each row what it says. Found: the longest until the sonar has the leader. Under "
        "1 m: flights that came nearer. Beyond: share of time in which the estimate is off along "
        "the line to the leader by more than 2.5 of its own standard deviations; of an honest one "
        "that is 1 %.",
        highlight=False,
    )


def _accuracy_figures(kept: "list[Kept]") -> Iterator[Figure]:
    for one in kept:
        yield from _kept_figures(one)
        name = one.row.name
        yield Figure(f"{name}: in reach", one.reached_s, "s")
        yield Figure(f"{name}: mean error, disagreement known", one.known_error_m, "m")
        yield Figure(f"{name}: bound of RMSD", one.bound_rmsd_m, "m")


def _robust_figures(robust: "Robust") -> Iterator[Figure]:
    for one in (*robust.rows, *robust.pairs):
        yield from _kept_figures(one)
        yield Figure(f"{one.row.name}: under 1 m", one.under, "flights")
        yield Figure(f"{one.row.name}: beyond 2.5 sigma", 100.0 * one.beyond_share, "%")


def _kept_figures(one: "Kept") -> Iterator[Figure]:
    """What a row is judged by."""
    goal = one.row.goal
    for what, value, unit, wanted, limit in (
        ("mean error", one.mean_error_m, "m", "at most {:.2f}", goal.mean_error_m),
        ("RMSD", one.rmsd_m, "m", "at most {:.2f}", goal.rmsd_m),
        ("least", one.least_m, "m", "at least {:.1f}", goal.least_m),
        ("found", one.found_s, "s", "within {:g}", goal.found_s),
    ):
        if math.isfinite(limit):
            met = what not in one.missed
            yield Figure(f"{one.row.name}: {what}", value, unit, wanted.format(limit), met)
        else:
            yield Figure(f"{one.row.name}: {what}", value, unit)


def _print_laws(table: "list[LawRow]") -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when it is used)
    from rich.table import Column, Table  # noqa: PLC0415

    from echowing.bench.laws import DURATION_S, best_law  # noqa: PLC0415

    head = ("leader", "law", "n", "mean |e|", "RMSD", "least", "attacked", "changes/min")
    shown = Table(*(Column(one, no_wrap=True) for one in (*head, "dead-locked", "safe")))
    for row in table:
        errors = (f"{row.mean_error_m:.3f}", f"{row.rmsd_m:.3f}", f"{row.least_m:.2f}")
        attacked = f"{row.attacked_m:.2f}" if math.isfinite(row.attacked_m) else "-"
        counts = (f"{row.changes_per_min:.0f}", str(row.dead_locked), "yes" if row.safe else "no")
        shown.add_row(row.path, row.law, str(row.flights), *errors, attacked, *counts)
    console = Console() if sys.stdout.isatty() else Console(width=120)
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


def _swarm(seeds: int, *, quiet: bool) -> list[Figure]:
    """Fly them on all cores; the table in Markdown, as RESULTS.md has it."""
    from echowing.bench.swarm import flight_count, fly_swarm, markdown  # noqa: PLC0415

    with _bar("flying swarms", flight_count(seeds), quiet=quiet) as advance:
        rows = fly_swarm(seeds, advance)
    if not quiet:
        print(markdown(rows))
    return list(_swarm_figures(rows))


def _swarm_figures(rows: "list[SwarmRow]") -> Iterator[Figure]:
    for row in rows:
        name, flock = f"{row.flown}, {row.way}", row.flock
        yield Figure(f"{name}: in one piece", flock.whole, "")
        yield Figure(f"{name}: in one piece, worst", flock.worst, "")
        yield Figure(f"{name}: polarisation", flock.polarisation, "")
        yield Figure(f"{name}: rotation", flock.rotation, "")
        yield Figure(f"{name}: nearest neighbour", flock.nearest_m, "m")
        yield Figure(f"{name}: from the centre", flock.extent_m, "m")
        yield Figure(f"{name}: least", flock.least_m, "m", "at least 1.0", flock.least_m >= 1.0)


def _formations(seeds: int, *, quiet: bool) -> list[Figure]:
    """Fly them on all cores; the table in Markdown, as RESULTS.md has it."""
    from echowing.bench.formations import flight_count, fly_formations, markdown  # noqa: PLC0415

    with _bar("flying formations", flight_count(seeds), quiet=quiet) as advance:
        rows = fly_formations(seeds, advance)
    if not quiet:
        print(markdown(rows))
    return list(_formation_figures(rows))


def _formation_figures(rows: "list[FormationRow]") -> Iterator[Figure]:
    for row in rows:
        name, goal = row.row.name, row.row.goal
        for number, (error_m, rmsd_m) in enumerate(
            zip(row.mean_errors_m, row.rmsds_m, strict=True), 1
        ):
            yield Figure(f"{name}: gap {number}, mean error", error_m, "m")
            yield Figure(f"{name}: gap {number}, RMSD", rmsd_m, "m")
        met = row.least_m >= goal.least_m
        yield Figure(f"{name}: least", row.least_m, "m", f"at least {goal.least_m:.1f}", met)


def _echoes(*, quiet: bool) -> list[Figure]:
    """The table in Markdown, as firmware/README.md has it."""
    from echowing.bench.late_echoes import late_echoes, markdown  # noqa: PLC0415

    rows = list(late_echoes())
    if not quiet:
        print(markdown(rows))
    return [
        Figure(f"{row.period_ms} ms +- {row.jitter_ms}, {row.scene}: {what}", share, "")
        for row in rows
        for what, share in (("false", row.false), ("missed", row.missed))
    ]


def _field() -> Iterator[Figure]:
    from echowing.bench.field import field_figures  # noqa: PLC0415

    return (Figure(*figure) for figure in field_figures())


def _firmware() -> Iterator[Figure]:
    from echowing.bench.firmware import firmware_figures  # noqa: PLC0415

    return (Figure(*figure) for figure in firmware_figures())


def _speed() -> Iterator[Figure]:
    yield _flight_speed("echowing", 60, "one flight, times real time on a core", "at least 50")
    yield _campaign_speed()
    yield _flight_speed("many", 22, "50 followers, times real time on a core", "")
    yield from _guidance_times()
    yield _help_time("under 0.3")
    yield _help_time("under 0.4", "follow")


def _flight_speed(scenario: str, duration_s: int, what: str, goal: str) -> Figure:
    from echowing.sim.flight import FormationFlight  # noqa: PLC0415
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    flight = FormationFlight(load_scenario(scenario, [f"duration_s={duration_s}"]), seed=1)
    started_s = time.process_time()  # others on this machine do not count
    flight.run()
    return Figure(what, duration_s / (time.process_time() - started_s), "s/s", goal)


def _campaign_speed(flights: int = 6) -> Figure:
    """Of the shipped campaign, worked out for two workers from the processor's time of one."""
    from echowing.campaign.draw import load_description  # noqa: PLC0415
    from echowing.campaign.fly import fly_one  # noqa: PLC0415

    description = load_description()
    started_s = time.process_time()
    for index in range(1, flights + 1):  # the first has its logs read
        fly_one(description, 1, index)
    per_hour = 2.0 * flights / (time.process_time() - started_s) * 3600.0
    return Figure("campaign on two cores, flights per hour", per_hour, "1/h", "")


def _guidance_times(duration_s: float = 60.0) -> Iterator[Figure]:
    """What a session does for one follower of a simulated flight, on a machine that is idle."""
    from echowing.sim.flight import FormationFlight  # noqa: PLC0415
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415

    flight = FormationFlight(load_scenario("echowing", [f"duration_s={duration_s}"]), seed=1)
    session = flight.ground.session
    ticks_s: list[float] = []
    received_s: list[float] = []

    def timed(deed: Callable[..., Any], spent_s: list[float]) -> Callable[..., Any]:
        def run(*args: object) -> Any:
            started_s = time.perf_counter()
            done = deed(*args)
            spent_s.append(time.perf_counter() - started_s)
            return done

        return run

    session.tick = timed(session.tick, ticks_s)  # type: ignore[method-assign]
    session.receive = timed(session.receive, received_s)  # type: ignore[method-assign]
    flight.run()
    tick_ms = 1e3 * statistics.mean(ticks_s)
    yield Figure("guidance, a follower and tick", tick_ms, "ms", "under 0.2")
    came_ms = 1e3 * sum(received_s) / len(ticks_s)
    yield Figure("what has come between two ticks, taken in", came_ms, "ms", "")


def _help_time(goal: str, *verb: str, runs: int = 5) -> Figure:
    """From the start of the process to its end: mostly what is imported."""
    arguments = (*verb, "--help")

    def once() -> float:
        started_s = time.perf_counter()
        command = [sys.executable, "-m", "echowing", *arguments]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - started_s

    once()
    taken_s = statistics.median(once() for _ in range(runs))
    return Figure(f"echowing {' '.join(arguments)}", taken_s, "s", goal)
