"""The report's plots as plain plotly figures ({"data": …, "layout": …}); no plotly import needed.

Maps are north up with equal axes: x is east, y is north. Every series is thinned to what a screen
can show and rounded to what can be read off, so that a report stays a few megabytes.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Flight, Floats

Figure = dict[str, Any]

LEADER_COLOUR = "#1f6feb"
FOLLOWER_COLOUR = "#e8710a"
QUIET_COLOUR = "#8a94a6"
GOOD_COLOUR = "#1a7f5a"
SECOND_COLOUR = "#8250df"

# Thesis Fig. 37: about one position every 10 s. Not 10 itself: a lap of the standard rectangle
# takes 100 s, and the positions of two laps would cover each other.
MATCHING_PERIOD_S = 9.5
NOTHING_SEEN_M = 7.65  # where the sonar's own "no target" lies (MB1202 datasheet), thesis Fig. 38
# A plot is some 1200 px wide on a large screen: more points than this cannot be told apart.
MOST_POINTS = 1200
MAP_STEP_M = 0.15  # tracks: nearer points than this fall on one pixel


def tracks(flight: Flight) -> Figure:
    """Both tracks (thesis Fig. 36)."""
    return _map(
        "Tracks",
        [
            _track("leader", flight.leader_ned_m, flight.time_s, LEADER_COLOUR),
            _track("follower", flight.follower_ned_m, flight.time_s, FOLLOWER_COLOUR),
        ],
    )


def matching_times(flight: Flight) -> Figure:
    """Where both were at the same time, and how far apart (thesis Fig. 37)."""
    at = matching_indices(flight)
    leader, follower = flight.leader_ned_m[at], flight.follower_ned_m[at]
    separation_m, middle = flight.separation_m[at], (leader + follower) / 2.0
    across = leader - follower
    seconds = plain(flight.time_s[at], 1)
    return _map(
        f"Positions every {MATCHING_PERIOD_S:g} s, distance in metres between them",
        [
            _joined(leader, follower),
            _points("leader", leader, seconds, LEADER_COLOUR),
            _points("follower", follower, seconds, FOLLOWER_COLOUR),
            {
                "type": "scatter",
                "mode": "text",
                "showlegend": False,
                "hoverinfo": "skip",
                "x": plain(middle[:, 1]),
                "y": plain(middle[:, 0]),
                "text": [
                    # Beside an upright pair; above a lying one, a line up from its points.
                    f"  {metres:.1f}" if upright else f"{metres:.1f}<br> "
                    for metres, upright in zip(separation_m, _upright(across), strict=True)
                ],
                "textposition": [
                    "middle right" if upright else "top center" for upright in _upright(across)
                ],
                "textfont": {"size": 11},
            },
        ],
    )


def matching_indices(flight: Flight) -> NDArray[np.intp]:
    """A sample every MATCHING_PERIOD_S at which both positions are known."""
    known = np.flatnonzero(np.isfinite(flight.separation_m))
    if len(known) == 0:
        return known
    times = flight.time_s[known]
    wanted = np.arange(times[0], times[-1] + 1e-9, MATCHING_PERIOD_S)
    nearest = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    return np.asarray(known[np.unique(nearest)])


def sonar(flight: Flight) -> Figure:
    """Raw readings over time (thesis Fig. 38), the real distance behind them."""
    seen = np.isfinite(flight.sonar_m)
    blind_s = flight.time_s[~seen]
    data = [
        _line("distance of the positions", flight.time_s, flight.separation_m, QUIET_COLOUR),
        {
            **_line("sonar", flight.time_s[seen], flight.sonar_m[seen], FOLLOWER_COLOUR),
            "mode": "markers",
            "marker": {"size": 4, "color": FOLLOWER_COLOUR},
        },
        {
            **_line("nothing seen", blind_s, np.full(len(blind_s), NOTHING_SEEN_M), QUIET_COLOUR),
            "mode": "markers",
            "marker": {"size": 5, "color": QUIET_COLOUR, "symbol": "line-ns-open"},
            "hovertemplate": "nothing seen<extra></extra>",
        },
    ]
    figure = _over_time("Raw sonar", "m", data)
    far_m = float(np.nanmax(flight.separation_m, initial=NOTHING_SEEN_M))
    figure["layout"]["yaxis"]["range"] = [0.0, min(far_m, 12.0) + 0.5]
    return with_level(figure, flight.wanted_separation_m, "wanted", GOOD_COLOUR)


def speeds(flight: Flight) -> Figure:
    """Commanded speed against ground speed (thesis Figs. 39 and 40)."""
    ground_mps = np.hypot(*flight.follower_velocity_mps[:, :2].T)
    leader_mps = np.hypot(*flight.leader_velocity_mps[:, :2].T)
    command = _line("speed command", flight.time_s, flight.speed_command_mps, LEADER_COLOUR)
    command["line"].update(dash="dash", shape="hv")
    return _over_time(
        "Speed command and ground speed",
        "m/s",
        [
            _line("leader", flight.time_s, leader_mps, QUIET_COLOUR),
            command,
            _line("follower", flight.time_s, ground_mps, FOLLOWER_COLOUR),
        ],
    )


def separation_error(flights: Sequence[Flight], labels: Sequence[str], title: str) -> Figure:
    """Separation error over time with its mean (thesis Figs. 41 and 42)."""
    data = []
    colours = (FOLLOWER_COLOUR, SECOND_COLOUR, GOOD_COLOUR, LEADER_COLOUR)
    for number, (flight, label) in enumerate(zip(flights, labels, strict=True)):
        colour = colours[number % len(colours)]
        time_s = flight.time_s - flight.time_s[0] if len(flights) > 1 else flight.time_s
        error_m = flight.separation_m - flight.wanted_separation_m
        data.append(_line(label, time_s, error_m, colour))
        data.append(_mean_line(time_s, error_m, colour))
    return with_level(_over_time(title, "m", data), 0.0, "", QUIET_COLOUR)


def gimbal(flight: Flight) -> Figure:
    """Servo pulses over time."""
    return _over_time(
        "Gimbal",
        "pulse, us",
        [
            _line("pan", flight.time_s, flight.pan_us, LEADER_COLOUR, places=0),
            _line("tilt", flight.time_s, flight.tilt_us, FOLLOWER_COLOUR, places=0),
        ],
    )


def thinned(values: Floats, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Which samples to keep: all, or the lowest and the highest of each stretch, gaps kept."""
    count = len(values)
    if count <= most:
        return np.arange(count)
    keep: set[int] = {0, count - 1}
    for stretch in np.array_split(np.arange(count), most // 2):
        piece = values[stretch]
        known = np.isfinite(piece)
        if known.any():
            keep.add(int(stretch[np.nanargmin(piece)]))
            keep.add(int(stretch[np.nanargmax(piece)]))
        if not known.all():
            keep.add(int(stretch[np.flatnonzero(~known)[0]]))
    return np.array(sorted(keep))


def _line(name: str, time_s: Floats, values: Floats, colour: str, places: int = 2) -> Figure:
    at = thinned(values)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": plain(time_s[at], 1),
        "y": plain(values[at], places),
        "line": {"color": colour, "width": 1.6},
    }


def _mean_line(time_s: Floats, error_m: Floats, colour: str) -> Figure:
    known = error_m[np.isfinite(error_m)]
    mean_m = float(known.mean()) if len(known) else math.nan
    ends = np.array([time_s[0], time_s[-1]]) if len(time_s) else np.array([])
    line = _line(f"its mean, {mean_m:+.2f} m", ends, np.full(len(ends), mean_m), colour)
    line["line"].update(dash="dash", width=1.2)
    return line


def _track(name: str, ned_m: Floats, time_s: Floats, colour: str) -> Figure:
    at = _apart(ned_m)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": plain(ned_m[at, 1]),
        "y": plain(ned_m[at, 0]),
        "customdata": plain(time_s[at], 1),
        "hovertemplate": "%{customdata} s: east %{x} m, north %{y} m",
        "line": {"color": colour, "width": 1.8},
    }


def _apart(ned_m: Floats) -> NDArray[np.intp]:
    """Samples at least MAP_STEP_M from the one kept before."""
    keep: list[int] = []
    last = (math.inf, math.inf)
    for index, (north_m, east_m) in enumerate(ned_m[:, :2].tolist()):
        if math.dist((north_m, east_m), last) >= MAP_STEP_M:
            keep.append(index)
            last = (north_m, east_m)
    return np.array(keep, dtype=np.intp)


def _upright(across_ned_m: Floats) -> list[bool]:
    """Which pairs are further apart in north than in east."""
    return [bool(one) for one in np.abs(across_ned_m[:, 0]) > np.abs(across_ned_m[:, 1])]


def _points(name: str, ned_m: Floats, seconds: list[float | None], colour: str) -> Figure:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": plain(ned_m[:, 1]),
        "y": plain(ned_m[:, 0]),
        "customdata": seconds,
        "hovertemplate": "%{customdata} s: east %{x} m, north %{y} m",
        "marker": {"color": colour, "size": 8},
    }


def _joined(a_ned_m: Floats, b_ned_m: Floats) -> Figure:
    """A line between each pair, one trace with gaps."""
    gap = np.full(len(a_ned_m), math.nan)
    east = np.column_stack([a_ned_m[:, 1], b_ned_m[:, 1], gap]).ravel()
    north = np.column_stack([a_ned_m[:, 0], b_ned_m[:, 0], gap]).ravel()
    return {
        "type": "scatter",
        "mode": "lines",
        "showlegend": False,
        "hoverinfo": "skip",
        "x": plain(east),
        "y": plain(north),
        "line": {"color": QUIET_COLOUR, "width": 1},
    }


def _map(title: str, data: list[Figure]) -> Figure:
    figure = chart(title, "east, m", "north, m", data)
    figure["layout"]["yaxis"].update(scaleanchor="x", scaleratio=1)
    figure["layout"]["legend"]["y"] = -0.16
    figure["layout"]["height"] = 520
    return figure


def _over_time(title: str, unit: str, data: list[Figure]) -> Figure:
    figure = chart(title, "time, s", unit, data)
    figure["layout"].update(hovermode="x unified", height=370)
    return figure


def chart(title: str, x_title: str, y_title: str, data: list[Figure]) -> Figure:
    """A figure of these traces in the house's look; axes named with their units."""
    axis = {"gridcolor": "#e6e9ef", "zeroline": False, "linecolor": "#c5ccd8", "ticks": "outside"}
    return {
        "data": data,
        "layout": {
            "title": {"text": title, "x": 0.01, "xanchor": "left", "font": {"size": 15}},
            "xaxis": {**axis, "title": {"text": x_title}},
            "yaxis": {**axis, "title": {"text": y_title}},
            # Under the plot: many or long names must not run into the title.
            "legend": {"orientation": "h", "x": 0, "y": -0.26, "yanchor": "top"},
            "margin": {"l": 64, "r": 16, "t": 36, "b": 104},
            "paper_bgcolor": "#ffffff",
            "plot_bgcolor": "#ffffff",
            "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#253046"},
        },
    }


def with_level(figure: Figure, level: float, label: str, colour: str) -> Figure:
    """A thin horizontal line across the plot."""
    line = {"color": colour, "width": 1, "dash": "dot"}
    shape = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": level, "y1": level}
    shape["line"] = line
    layout = figure["layout"]
    layout["shapes"] = [shape]
    if label:  # beside the plot, not over the data
        text = {"text": f"{label}<br>{level:g} m", "xref": "paper", "x": 1.01, "y": level}
        text |= {"xanchor": "left", "align": "left", "showarrow": False}
        text["font"] = {"size": 11, "color": colour}
        layout["annotations"] = [*layout.get("annotations", []), text]
        layout["margin"]["r"] = 64
    return figure


def with_upright(figure: Figure, at: float, label: str, colour: str) -> Figure:
    """A thin upright line across the plot, its label over it."""
    layout = figure["layout"]
    line = {"type": "line", "yref": "paper", "x0": at, "x1": at, "y0": 0, "y1": 1}
    line["line"] = {"color": colour, "width": 1.2, "dash": "dash"}
    text = {"text": label, "x": at, "yref": "paper", "y": 1.0, "showarrow": False}
    text |= {"xanchor": "center", "yanchor": "bottom"}
    text["font"] = {"size": 11, "color": colour}
    layout["shapes"] = [*layout.get("shapes", []), line]
    layout["annotations"] = [*layout.get("annotations", []), text]
    return figure


def plain(values: Floats, places: int = 2) -> list[float | None]:
    """Rounded plain numbers; None (JSON null, a gap) for what is not known."""
    rounded = np.round(np.asarray(values, dtype=float), places).tolist()
    return [value if math.isfinite(value) else None for value in rounded]
