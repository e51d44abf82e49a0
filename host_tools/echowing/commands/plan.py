"""`echowing plan`: places for a formation that has no name."""

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from echowing.errors import EchowingError
from echowing.paths import SHIPPED_SONAR

if TYPE_CHECKING:
    from echowing.planning.cost import Formation, Limits
    from echowing.planning.optimise import Row

EXAMPLES = """\
examples:
  echowing plan 5 --out five.toml --plot five.svg      for `echowing follow --formation five.toml`
  echowing plan 5 --scenario fly-five.toml && echowing sim fly-five.toml
  echowing plan 4 --spacing 3-3.4 --angle 35 --heights 0,0.5,1 --seed 7 --json
  echowing plan 3 --leader-only --keep-out 100         every sonar watches the leader
  echowing plan --compare --evaluations 10000          the optimisers, three minutes
"""
COMPARED = (3, 5, 8, 12)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("followers", nargs="?", type=int, default=3, help="1 to 12 (3)")
    limits = parser.add_argument_group("limits")
    limits.add_argument(
        "--spacing",
        default="3-3.5",
        metavar="M-M",
        help="the least distance between any two, and the greatest to whom a sonar watches (3-3.5)",
    )
    limits.add_argument(
        "--angle",
        type=float,
        default=50.0,
        metavar="DEG",
        help="how far off the tail of whom it watches a slot may be (50)",
    )
    limits.add_argument(
        "--view",
        type=float,
        default=60.0,
        metavar="DEG",
        help="how far it looks to each side of the course after a loss (60, as PAN_REACH)",
    )
    limits.add_argument(
        "--tilt",
        type=float,
        default=30.0,
        metavar="DEG",
        help="and how far up and down (30, as TILT_REACH)",
    )
    limits.add_argument(
        "--keep-out",
        type=float,
        default=90.0,
        metavar="DEG",
        help="nobody within this of the leader's nose (90)",
    )
    limits.add_argument(
        "--heights", default="0", metavar="M,M", help="altitude steps that slots may have (0)"
    )
    limits.add_argument("--leader-only", action="store_true", help="every sonar watches the leader")
    limits.add_argument(
        "--sonar",
        default=SHIPPED_SONAR,
        metavar="FILE",
        help="a sonar file (.toml), as with `follow`",
    )
    limits.add_argument(
        "--legs", choices=("foil", "stock"), default="foil", help="of all vehicles (foil)"
    )
    search = parser.add_argument_group("search")
    search.add_argument("--seed", type=int, default=1, help="of the random numbers (1)")
    search.add_argument(
        "--method", metavar="NAME", help="evolution (the default), annealing or pigeons"
    )
    search.add_argument("--evaluations", type=int, metavar="N", help="of the cost (20000)")
    search.add_argument(
        "--compare", action="store_true", help="print how the methods compare, and plan nothing"
    )
    search.add_argument("--seeds", type=int, default=3, help="with --compare: runs of each (3)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write slots (TOML)")
    parser.add_argument("--scenario", type=Path, metavar="FILE", help="write a scenario (TOML)")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="write a picture (SVG)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Plan, print, write."""
    from echowing.extras import require  # noqa: PLC0415 (imported when the verb is used)

    require("plan")
    from echowing.planning import optimise  # noqa: PLC0415

    limits = _limits(args)
    evaluations = optimise.EVALUATIONS if args.evaluations is None else args.evaluations
    method = args.method or optimise.DEFAULT
    if method not in optimise.METHODS:
        raise EchowingError(f"--method {method}: there are {', '.join(optimise.METHODS)}")
    for name, value in (("evaluations", evaluations), ("seeds", args.seeds)):
        if value < 1:
            raise EchowingError(f"--{name} {value}: give 1 or more")
    if args.seed < 0:
        raise EchowingError(f"--seed {args.seed}: give 0 or more")
    if args.compare:
        return _compare(limits, args, evaluations)
    formation = optimise.best_of(limits, method, evaluations, args.seed)
    _refuse_off_limits(formation)
    said = f"`echowing plan {args.followers} --seed {args.seed}`, {method}, {evaluations} costs"
    _write(formation, args, said)
    if args.json:
        print(json.dumps(_plain(formation), indent=2))
    else:
        _print(formation)
    return 0


def _limits(args: argparse.Namespace) -> "Limits":
    from echowing.planning.cost import Limits  # noqa: PLC0415 (imported when the verb is used)
    from echowing.sonar_file import load_sonar  # noqa: PLC0415

    least_m, dash, most_m = args.spacing.partition("-")
    limits = Limits(
        args.followers,
        load_sonar(args.sonar).belief(args.legs),
        (_number("--spacing", least_m), _number("--spacing", most_m if dash else least_m)),
        math.radians(args.angle),
        math.radians(args.view),
        math.radians(args.tilt),
        math.radians(args.keep_out),
        tuple(_number("--heights", text) for text in args.heights.split(",")),
        args.leader_only,
    )
    limits.check()
    return limits


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise EchowingError(f"{option}: {text!r} is no number of metres")
    return value


def _refuse_off_limits(formation: "Formation") -> None:
    if formation.is_within_limits:
        return
    off = [f"{name} by {off_m:.2f} m" for name, off_m in formation.off_limits_m.items() if off_m]
    raise EchowingError(
        f"no formation of {formation.limits.followers} keeps the limits; the best one misses "
        f"{', '.join(off)}. Allow more spacing, view or heights, or try more --evaluations or "
        "another --seed"
    )


def _write(formation: "Formation", args: argparse.Namespace, said: str) -> None:
    from echowing.planning import files  # noqa: PLC0415

    # What nobody flies may be looked at, whatever `follow` would say of it.
    flown = args.out is not None or args.scenario is not None
    table = files.formation_table(files.file_slots(formation)) if flown else {}
    if args.out is not None:
        files.write(args.out, files.toml_text(table, said))
    if args.scenario is not None:
        legs = {"target": args.legs}
        sonar = {} if args.sonar == "mb1202" else {"sonar": {"file": args.sonar}}
        title = f"A planned formation of {args.followers}"
        flight = {"title": title, "leader": legs, "follower": legs, **sonar, "formation": table}
        files.write(args.scenario, files.toml_text(flight, said))
    if args.plot is not None:
        worst_m = float(formation.sigma_m.max())
        files.write(args.plot, files.svg_text(formation, f"worst pair unsure by {worst_m:.2f} m"))


def _pairs(formation: "Formation") -> Iterator[dict[str, Any]]:
    """Of any two, number 0 is the leader: how far apart, how sure, and what is certain of it."""
    for a, b in combinations(range(len(formation.places_m)), 2):
        yield {
            "pair": [a, b],
            "tied": formation.watches[b - 1] == a,
            "distance_m": round(float(formation.geometry.far_m[a, b]), 3),
            "sigma_m": round(float(formation.sigma_m[a, b]), 3),
            "certain_m": round(float(formation.certain_m[a, b]), 3),
        }


def _plain(formation: "Formation") -> dict[str, Any]:
    return {
        "cost_m": round(formation.cost, 6),
        "worst_sigma_m": round(float(formation.sigma_m.max()), 3),
        "left_alone": {str(lost): left for lost, left in formation.left_alone.items()},
        "slots": [asdict(slot) for slot in formation.slots()],
        "pairs": list(_pairs(formation)),
    }


def _name(number: int) -> str:
    return str(number) if number else "leader"


def _print(formation: "Formation") -> None:
    from rich.console import Console  # noqa: PLC0415 (imported when the verb is used)
    from rich.table import Table  # noqa: PLC0415

    console = Console()
    slots = Table("slot", "watches", "radius, m", "angle, deg", "height, m", "if that is lost")
    for number, slot in enumerate(formation.slots(), 1):
        places = f"{slot.radius_m:.2f}", f"{math.degrees(slot.angle_rad):.1f}"
        its, spare = formation.watches[number - 1], formation.spare(number)
        last = "" if not its else "nobody" if spare is None else _name(spare)
        slots.add_row(str(number), _name(its), *places, f"{slot.altitude_step_m:g}", last)
    pairs = Table("pair", "distance, m", "sigma, m", "certain, m", "")
    for one in _pairs(formation):
        figures = (f"{one[key]:.2f}" for key in ("distance_m", "sigma_m", "certain_m"))
        name = " and ".join(map(_name, one["pair"]))
        pairs.add_row(name, *figures, "sonar" if one["tied"] else "")
    console.print(slots, pairs)
    console.print(f"Worst pair: standard deviation {formation.sigma_m.max():.2f} m.")
    for lost, left in formation.left_alone.items():
        others = ", ".join(map(str, left))
        console.print(f"The loss of {lost} splits it: nobody to watch is left for {others}.")
    if not formation.left_alone:
        console.print("No single loss splits it: each follower then has another to watch.")


def _compare(limits: "Limits", args: argparse.Namespace, evaluations: int) -> int:
    from echowing.planning.optimise import compare  # noqa: PLC0415

    rows = list(compare(limits, COMPARED, range(1, args.seeds + 1), evaluations))
    if args.json:
        print(json.dumps([_plain_row(row) for row in rows], indent=2))
    else:
        _print_rows(rows, args.seeds, evaluations)
    return 0


def _plain_row(row: "Row") -> dict[str, Any]:
    return {
        "followers": row.followers,
        "method": row.method,
        "kept": row.kept,
        "spared": row.spared,
        "costs_m": row.costs_m,
        "worst_m": row.worst_m,
        "cpu_s": row.cpu_s,
    }


def _print_rows(rows: "list[Row]", seeds: int, evaluations: int) -> None:
    from statistics import fmean, median  # noqa: PLC0415 (imported when it is used)

    print("| followers | method | limits kept | no loss splits | worst pair, m | cost | CPU, s |")
    print("|---:|---|---:|---:|---:|---:|---:|")
    for row in rows:
        counts = f"{row.kept} of {seeds} | {row.spared} of {seeds}"
        figures = f"{median(row.worst_m):.2f} | {fmean(row.costs_m):.2f} | {row.cpu_s:.1f}"
        print(f"| {row.followers} | {row.method} | {counts} | {figures} |")
    print(f"\n{evaluations} evaluations of the cost in each run. Worst pair: median; cost: mean.")
