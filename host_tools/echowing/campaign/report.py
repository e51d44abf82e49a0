"""The report of a campaign: one HTML page, readable without a network."""

import html
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from echowing.analysis import plots
from echowing.analysis.page import box, page, table, write_page
from echowing.analysis.tables import Grid
from echowing.analysis.tables import Row as TableRow
from echowing.campaign.files import FINDS, REPORT
from echowing.campaign.fly import Row
from echowing.campaign.properties import LEAST_M
from echowing.campaign.run import ORDER, finds_of

WORST = 20
MOST_PAIRS = 60
NOTHING = "-"
# Columns of a formation (campaign.swarm.Swarm), and what they are called.
_FORMATION = {
    "nearest_m": "nearest neighbour, m",
    "spread": "spread, of the slots'",
    "misaligned_mps": "off the mean velocity, m/s",
    "polarisation": "polarisation",
    "rotation": "rotation",
    "held": "held, of the time",
}


def write_report(folder: Path, rows: Sequence[Row], seed: int, kinds: Sequence[str]) -> Path:
    """Write report.html into the campaign's folder; `kinds`: of fault, that could be drawn."""
    ordered = sorted(rows, key=lambda row: row["index"])
    flown = [row for row in ordered if "closest_m" in row]
    figures = {
        "closest": _histogram("Least distance of a flight", _values(flown, "closest_m"), LEAST_M),
        "error": _histogram("Mean separation error", _values(flown, "mean_error_m"), None),
    }
    title = f"Campaign: {len(ordered)} flights, seed {seed}"
    body = "\n".join(
        [
            f"<header><h1>{title}</h1><p>{_summary(ordered, flown)}</p></header>",
            _card(_properties(ordered)),
            f'<div class="plots">{box("closest")}{box("error")}</div>',
            f"<h2>Finds</h2>{_finds(folder)}",
            f"<h2>By fault</h2>{_card(_by_fault(flown, kinds))}",
            f"<h2>Formations</h2>{_card(_formations(flown))}",
            f"<h2>Worst flights</h2>{_worst(folder, flown)}",
            f"<h2>Coverage</h2>{_card(_states(flown))}{_card(_pairs(flown, kinds))}",
        ]
    )
    path = folder / REPORT
    write_page(path, page(title, body, figures), "report")
    return path


def _card(grid: Grid) -> str:
    return f'<div class="card">{table(grid)}</div>'


def _values(rows: Iterable[Row], key: str) -> list[float]:
    return [row[key] for row in rows if row.get(key) is not None]


def _summary(rows: Sequence[Row], flown: Sequence[Row]) -> str:
    hours = sum(row.get("duration_s", 0.0) for row in rows) / 3600.0
    broken = sum(bool(row["broken"]) for row in rows)
    least = min(_values(flown, "closest_m"), default=float("nan"))
    return (
        f"{hours:.1f} hours in the air; {broken} flights broke a property; least distance of any "
        f"two vehicles {least:.2f} m"
    )


def _properties(rows: Sequence[Row]) -> Grid:
    found = finds_of(rows)
    cells = []
    for name in ORDER:
        entries = found.get(name, [])
        worst = entries[0][1].text if entries else "held in each flight"
        cells.append(TableRow((name, str(len(entries)), worst)))
    return Grid("Properties", ("property", "broken in", "the worst"), tuple(cells))


def _histogram(title: str, values: Sequence[float], level: float | None) -> plots.Figure:
    data = [
        {
            "type": "histogram",
            "x": plots.plain(np.array(values)),
            "y": [],
            "xbins": {"size": 0.1},
            "marker": {"color": plots.LEADER_COLOUR},
        }
    ]
    data[0].pop("y")
    figure = plots.chart(title, "m", "flights", data)
    figure["layout"]["height"] = 370
    if level is not None:
        plots.with_upright(figure, level, "promised", plots.GOOD_COLOUR)
    return figure


def _by_fault(rows: Sequence[Row], kinds: Sequence[str]) -> Grid:
    groups = {"none": [row for row in rows if not row["faults"]]}
    groups |= {kind: [row for row in rows if kind in row["faults"]] for kind in kinds}
    lines = []
    for name, mine in groups.items():
        close, errors = _values(mine, "closest_m"), _values(mine, "mean_error_m")
        broken = sum(bool(row["broken"]) for row in mine)
        in_force_s = sum((row["in_force_s"] or {}).get(name, 0.0) for row in mine)
        lines.append(
            TableRow(
                (
                    name.replace("_", " "),
                    str(len(mine)),
                    f"{in_force_s / 60.0:.0f}" if name != "none" else NOTHING,
                    str(broken),
                    f"{min(close):.2f}" if close else NOTHING,
                    f"{np.percentile(close, 5):.2f}" if close else NOTHING,
                    f"{np.median(errors):.2f}" if errors else NOTHING,
                    f"{np.percentile(errors, 95):.2f}" if errors else NOTHING,
                )
            )
        )
    head = ("fault", "flights", "in force, min", "broke", "least, m", "5 %, m")
    return Grid("Each fault", (*head, "error, median, m", "95 %, m"), tuple(lines))


def _formations(rows: Sequence[Row]) -> Grid:
    """How formations of three and more kept together, by the share of messages lost, in tenths."""
    groups: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        if row.get("polarisation") is not None:
            groups[math.ceil(row["loss"] * 10.0 - 1e-9)].append(row)
    lines = []
    for tenths, mine in sorted(groups.items()):
        least = min(_values(mine, "closest_followers_m"))
        means = [float(np.mean(_values(mine, name))) for name in _FORMATION]
        cells = (f"{one:.2f}" for one in (least, *means))
        lines.append(TableRow((f"up to {10 * tenths} %", str(len(mine)), *cells)))
    head = ("messages lost", "flights", "least between followers, m", *_FORMATION.values())
    return Grid("Formations of three followers and more, means", head, tuple(lines))


def _finds(folder: Path) -> str:
    paths = sorted((folder / FINDS).glob("*.toml"))
    if not paths:
        return "<p>None.</p>"
    return f"<ul>{''.join(map(_find, paths))}</ul>"


def _find(path: Path) -> str:
    first = path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
    return (
        f'<li><a href="{FINDS}/{path.with_suffix(".html").name}">{html.escape(path.stem)}</a> '
        f'(<a href="{FINDS}/{path.name}">scenario</a>): {html.escape(first)}</li>'
    )


def _worst(folder: Path, rows: Sequence[Row]) -> str:
    worst = sorted(rows, key=lambda row: (row["closest_m"], row["index"]))[:WORST]
    head = "".join(
        f"<th>{name}</th>" for name in ("flight", "seed", "least, m", "error, m", "faults", "find")
    )
    lines = "".join(_worst_line(folder, row) for row in worst)
    return f'<div class="card"><table><tr>{head}</tr>{lines}</table></div>'


def _worst_line(folder: Path, row: Row) -> str:
    files = sorted((folder / FINDS).glob(f"*-{row['index']}.html"))
    links = " ".join(f'<a href="{FINDS}/{one.name}">{html.escape(one.stem)}</a>' for one in files)
    error = NOTHING if row["mean_error_m"] is None else f"{row['mean_error_m']:.2f}"
    faults = html.escape(", ".join(row["faults"]).replace("_", " ")) or NOTHING
    cells = (str(row["index"]), str(row["seed"]), f"{row['closest_m']:.2f}", error)
    shown = "".join(f"<td>{cell}</td>" for cell in cells)
    return f'<tr>{shown}<td class="words">{faults}</td><td>{links or NOTHING}</td></tr>'


def _states(rows: Sequence[Row]) -> Grid:
    """Minutes that each fault was in force, by the state of the followers that it met."""
    minutes: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for row in rows:
        for key, seconds in row["states_s"].items():
            kind, _, state = key.partition(": ")
            minutes[kind][state] += seconds / 60.0
    states = sorted({state for one in minutes.values() for state in one})
    lines = [
        TableRow(
            (
                kind.replace("_", " "),
                *(f"{one[state]:.1f}" if one.get(state) else NOTHING for state in states),
            )
        )
        for kind, one in sorted(minutes.items())
    ]
    return Grid("Minutes in force, by the follower's state", ("fault", *states), tuple(lines))


def _pairs(rows: Sequence[Row], kinds: Sequence[str]) -> Grid:
    """How often each pair of faults was in force at a time."""
    flights: dict[str, int] = defaultdict(int)
    minutes: dict[str, float] = defaultdict(float)
    for row in rows:
        for name, seconds in row["in_force_s"].items():
            if " + " in name:
                flights[name] += 1
                minutes[name] += seconds / 60.0
    most = sorted(flights, key=lambda name: (-flights[name], name))
    lines = [
        TableRow((name.replace("_", " "), str(flights[name]), f"{minutes[name]:.1f}"))
        for name in most[:MOST_PAIRS]
    ]
    possible = len(kinds) * (len(kinds) - 1) // 2
    title = f"Pairs of faults at a time: {len(most)} of {possible} were, the most frequent first"
    return Grid(title, ("pair", "flights", "minutes"), tuple(lines))
