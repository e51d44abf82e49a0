"""A find in words and as a plot: what happened when."""

import html
import math
from pathlib import Path

import numpy as np

from echowing.analysis import plots
from echowing.analysis.page import box, page, write_page
from echowing.campaign.properties import LEAST_M, Broken
from echowing.campaign.record import FlightRecord
from echowing.sim.vehicle.modes import MODES

_MODES = {number: name for name, number in MODES.items()}
_COLOURS = (plots.FOLLOWER_COLOUR, plots.SECOND_COLOUR, plots.GOOD_COLOUR, plots.QUIET_COLOUR)


def story(record: FlightRecord, broken: list[Broken]) -> list[str]:
    """What happened, a line for each event, with its time, in order."""
    scenario = record.scenario
    lines: list[tuple[float, str]] = [(0.0, _beginning(record))]
    for fault in scenario.fault:
        if fault.at_s > record.time_s[-1]:
            continue
        lines.append((fault.at_s, f"fault begins: {fault.told}"))
        if fault.ends_s <= record.time_s[-1] and fault.ends_s > fault.at_s:
            lines.append((fault.ends_s, f"fault ends: {fault.told}"))
    lines += [(t_s, f"on the ground: {text}") for t_s, text in record.events]
    lines += [(t_s, f"{_name(vehicle)} says: {text}") for t_s, vehicle, text in record.texts]
    lines += _mode_changes(record)
    for number, (a, b) in enumerate(record.pairs):
        at = int(np.argmin(record.least_m[:, number]))
        text = f"{_name(a + 1)} and {_name(b + 1)} are nearest: {record.least_m[at, number]:.2f} m"
        lines.append((float(record.time_s[at]), text))
    lines += [(one.time_s, f"BROKEN, {one.name}: {one.text}") for one in broken]
    return [f"{t_s:6.1f} s  {text}" for t_s, text in sorted(lines, key=lambda line: line[0])]


def _beginning(record: FlightRecord) -> str:
    scenario = record.scenario
    slots = ", ".join(f"{slot.radius_m:g} m" for slot in scenario.formation.slots)
    wind = f", wind {scenario.wind.speed_mps:g} m/s" if scenario.wind.speed_mps else ""
    return (
        f"leader on a {scenario.leader.path} at {scenario.leader.speed_mps:g} m/s, followers at "
        f"{slots}, ArduCopter {scenario.follower.generation}{wind}"
    )


def _name(vehicle: int) -> str:
    return "leader" if vehicle == 1 else f"follower {vehicle}"


def _mode_changes(record: FlightRecord) -> list[tuple[float, str]]:
    changes = []
    for vehicle in range(record.mode.shape[1]):
        modes = record.mode[:, vehicle]
        for at in np.flatnonzero(np.diff(modes)) + 1:
            name = _MODES.get(int(modes[at]), str(modes[at]))
            changes.append((float(record.time_s[at]), f"{_name(vehicle + 1)} is in {name}"))
    return changes


def distance_figure(record: FlightRecord) -> plots.Figure:
    """Distances of all pairs over time, with the promise and the faults' times."""
    data = []
    for number, (a, b) in enumerate(record.pairs):
        least_m = record.least_m[:, number]
        at = plots.thinned(least_m)
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"{_name(a + 1)}, {_name(b + 1)}",
                "x": plots.plain(record.time_s[at], 1),
                "y": plots.plain(least_m[at]),
                "line": {"color": _COLOURS[number % len(_COLOURS)], "width": 1.6},
            }
        )
    figure = plots.chart("Distances between vehicles", "time, s", "m", data)
    figure = plots.with_level(figure, LEAST_M, "promised", plots.GOOD_COLOUR)
    for fault in record.scenario.fault:
        if fault.at_s > 0.0 and math.isfinite(fault.at_s):
            plots.with_upright(figure, fault.at_s, fault.told, plots.QUIET_COLOUR)
    figure["layout"]["height"] = 420
    return figure


def track_figure(record: FlightRecord) -> plots.Figure:
    """All tracks from above."""
    data = []
    for vehicle in range(record.position_ned_m.shape[1]):
        ned_m = record.position_ned_m[:, vehicle]
        at = plots.thinned(ned_m[:, 0])
        colour = plots.LEADER_COLOUR if vehicle == 0 else _COLOURS[(vehicle - 1) % len(_COLOURS)]
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": _name(vehicle + 1),
                "x": plots.plain(ned_m[at, 1]),
                "y": plots.plain(ned_m[at, 0]),
                "customdata": plots.plain(record.time_s[at], 1),
                "hovertemplate": "%{customdata} s: east %{x} m, north %{y} m",
                "line": {"color": colour, "width": 1.6},
            }
        )
    figure = plots.chart("Tracks", "east, m", "north, m", data)
    figure["layout"]["yaxis"].update(scaleanchor="x", scaleratio=1)
    figure["layout"]["height"] = 520
    return figure


def write_story(path: Path, title: str, record: FlightRecord, broken: list[Broken]) -> None:
    """The page of one flight: its story, its distances, its tracks."""
    lines = html.escape("\n".join(story(record, broken)))
    body = (
        f"<header><h1>{html.escape(title)}</h1></header>"
        f'<div class="plots">{box("distances")}{box("tracks", is_map=True)}</div>'
        f'<h2>What happened when</h2><div class="card"><pre>{lines}</pre></div>'
    )
    figures = {"distances": distance_figure(record), "tracks": track_figure(record)}
    write_page(path, page(title, body, figures), "find")
