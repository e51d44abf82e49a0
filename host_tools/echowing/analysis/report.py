"""The report: one HTML file with everything in it, readable without a network."""

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from echowing.analysis import plots
from echowing.analysis.flight import Flight
from echowing.analysis.metrics import Metrics, approach_s, metrics
from echowing.analysis.page import box, page, table, write_page
from echowing.analysis.picture import formation_svg
from echowing.analysis.tables import Result, answer, called, footnotes, grids
from echowing.errors import EchowingError

BASELINE = "gray"  # what the thesis compares its own flight with (Fig. 42)
# Leaders of one mission are this near each other at the same time, drift and all.
SAME_WAY_M = 5.0
MOST_COMPARISONS = 4


def write_report(
    path: Path,
    flights: Sequence[Flight],
    results: Sequence[Result] = (),
    notes: Sequence[str] = (),
    title: str = "Echowing: flown formations",
    settle_s: Sequence[float] = (),
    pictured: tuple[Flight, tuple[float, float]] | None = None,
) -> None:
    """Write the HTML file.

    flights: those that are plotted. results: what the table is made from (all flights, over the
    seeds); without, the plotted flights. notes: paragraphs of plain text under the table. settle_s:
    what of each plotted flight is left out of its figures; without, its approach. pictured: a
    flight, and from when to when it is drawn above all else.
    Raises EchowingError when there is nothing to show or the file cannot be written.
    """
    if not flights:
        raise EchowingError("report: no flights to show; fly or read at least one")
    left_s = settle_s or [approach_s(flight) for flight in flights]
    measured = [metrics(flight, one) for flight, one in zip(flights, left_s, strict=True)]
    shown = results or [
        Result(flight.name, one) for flight, one in zip(flights, measured, strict=True)
    ]
    figures: dict[str, plots.Figure] = {}
    sections = [
        _flight_section(number, flight, one, figures)
        for number, (flight, one) in enumerate(zip(flights, measured, strict=True), 1)
    ]
    comparisons = _comparison_section(flights, figures)
    body = [
        f"<header><h1>{html.escape(title)}</h1>{_contents(flights, bool(comparisons))}</header>",
        *_opening(shown, pictured),
        f'<h2 id="results">Results</h2><div class="card">{_tables(shown)}</div>',
        *(f"<p>{html.escape(note)}</p>" for note in notes),
        comparisons,
        *sections,
    ]
    write_page(path, page(title, "\n".join(body), figures), "report")


def _opening(
    results: Sequence[Result], pictured: tuple[Flight, tuple[float, float]] | None
) -> list[str]:
    """Who keeps the distance best, and how that looks."""
    told = answer(results)
    parts = [f"<p><b>{html.escape(told)}</b></p>"] if told else []
    if pictured is not None:
        flight, span_s = pictured
        parts.append(formation_svg(flight, flight_label(flight), span_s))
    return parts


def flight_label(flight: Flight) -> str:
    """How a flight is called in headings: name, law and seed."""
    parts = [called(flight.name, flight.law)]
    if parts[0] == flight.name and flight.law not in ("", "none", flight.name):
        parts.append(f"{flight.law} law")
    if flight.seed is not None:
        parts.append(f"seed {flight.seed}")
    return ", ".join(parts)


def _flight_section(
    number: int, flight: Flight, measured: Metrics, figures: dict[str, plots.Figure]
) -> str:
    drawn = {
        "tracks": plots.tracks(flight),
        "matching": plots.matching_times(flight),
        "error": plots.separation_error([flight], ["separation error"], "Separation error"),
        "sonar": plots.sonar(flight),
        "speed": plots.speeds(flight),
        "gimbal": plots.gimbal(flight),
    }
    drawn = {name: figure for name, figure in drawn.items() if _holds_data(figure)}
    figures.update({f"{number}-{name}": figure for name, figure in drawn.items()})
    boxes = "".join(box(f"{number}-{name}", name in ("tracks", "matching")) for name in drawn)
    warnings = "".join(f"<li>{html.escape(text)}</li>" for text in flight.warnings)
    return (
        f'<section><h2 id="flight-{number}">{html.escape(flight_label(flight))}</h2>'
        f'<p class="facts">{html.escape(_facts(flight, measured))}</p>'
        + (f'<ul class="notes warning">{warnings}</ul>' if warnings else "")
        + f'<div class="plots">{boxes}</div></section>'
    )


def _holds_data(figure: plots.Figure) -> bool:
    """Whether anything was recorded of it (many rigs do not log their gimbal)."""
    return any(value is not None for trace in figure["data"] for value in trace["y"])


def _facts(flight: Flight, figures: Metrics) -> str:
    seen = f", leader seen {figures.seen_share:.0%} of the time" if flight.sonar_known else ""
    origin = (
        "true positions" if flight.source == "truth" else "positions as the vehicles logged them"
    )
    left_out = "whole flight"
    if figures.settle_s > 0.0:
        left_out = f"the first {figures.settle_s:.1f} s left out"
    return (
        f"wanted {flight.wanted_separation_m:g} m; mean {figures.mean_separation_m:.2f} m, "
        f"RMSD {figures.rmsd_m:.2f} m, {figures.min_separation_m:.2f} to "
        f"{figures.max_separation_m:.2f} m{seen}; {origin}, {left_out}"
    )


def _comparison_section(flights: Sequence[Flight], figures: dict[str, plots.Figure]) -> str:
    """The baseline's separation error beside that of each other flight of its kind (Fig. 42)."""
    base = next((flight for flight in flights if flight.name == BASELINE), flights[0])
    others = [flight for flight in flights if flight is not base and _alike(flight, base)][
        :MOST_COMPARISONS
    ]
    if not others:
        return ""
    boxes = []
    for number, other in enumerate(others, 1):
        pair = [base, other]
        labels = [flight_label(flight) for flight in pair]
        names = [called(flight.name, flight.law) for flight in pair]
        figures[f"compare-{number}"] = plots.separation_error(
            pair, labels, f"Separation error: {names[0]} and {names[1]}"
        )
        boxes.append(box(f"compare-{number}"))
    return (
        '<section><h2 id="compared">Separation error compared</h2>'
        f'<div class="plots">{"".join(boxes)}</div></section>'
    )


def _alike(one: Flight, other: Flight) -> bool:
    """Whether two flights can be set side by side: the same leader's way and wanted separation."""
    samples = min(len(one.time_s), len(other.time_s))
    apart_m = one.leader_ned_m[:samples] - other.leader_ned_m[:samples]
    same_way = float(np.nanmean(np.abs(apart_m))) < SAME_WAY_M
    return same_way and one.wanted_separation_m == other.wanted_separation_m


def _contents(flights: Sequence[Flight], compared: bool) -> str:
    links = [("results", "Results")]
    links += [("compared", "Separation error compared")] if compared else []
    links += [(f"flight-{i}", flight_label(flight)) for i, flight in enumerate(flights, 1)]
    items = "".join(f'<li><a href="#{anchor}">{html.escape(t)}</a></li>' for anchor, t in links)
    return f"<nav><ol>{items}</ol></nav>"


def _tables(results: Sequence[Result]) -> str:
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in footnotes(results))
    first, *more = map(table, grids(results))
    fold = "<details><summary>Position errors, and the thesis's tables beside ours</summary>"
    return f'{first}{fold}{"".join(more)}<ul class="notes">{notes}</ul></details>'
