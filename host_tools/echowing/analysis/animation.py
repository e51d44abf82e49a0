"""A flown formation as an animated SVG, for pages that cannot run scripts (the README).

The vehicles move by SMIL, which browsers play in pictures too. The same flight gives the same
bytes.
"""

import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from echowing.analysis.flight import Flight, Floats
from echowing.analysis.page import write_page
from echowing.analysis.picture import (
    EDGE_PX,
    WIDTH_PX,
    document,
    heading,
    north_arrow,
    path_line,
    projection,
    scale_bar,
)
from echowing.analysis.plots import FOLLOWER_COLOUR, GOOD_COLOUR, LEADER_COLOUR, QUIET_COLOUR
from echowing.errors import EchowingError

SPEED_UP = 8.0
# Of flight, between two places of a vehicle; it moves straight and evenly from one to the next.
FRAME_S = 0.5
CHART_PX, GAP_PX = 120.0, 28.0
CHART_TOP_M = 6.0
# The beam of the MB1202, as wide as it looks; a reading as old as this is still shown.
BEAM_HALF_DEG, BEAM_LENGTH_M = 12.0, 5.0
SEEN_S = 0.5


@dataclass(frozen=True, slots=True)
class Frames:
    """What moves, a row per frame: pixels of the picture, metres of the chart.

    beam_deg: clockwise from up, from the follower towards the leader; seen: the sonar has measured.
    """

    time_s: Floats
    leader_px: Floats
    follower_px: Floats
    beam_deg: Floats
    seen: Floats
    separation_m: Floats

    @property
    def lasts_s(self) -> float:
        """How long the animation takes."""
        return float(self.time_s[-1] - self.time_s[0]) / SPEED_UP


def write_animation_svg(
    path: Path, flight: Flight, span_s: tuple[float, float], title: str
) -> None:
    """Both vehicles on their tracks, eight times as fast as flown; under them the separation.

    span_s: the part of the flight that is shown. Raises EchowingError where there is nothing to
    show, or where the file cannot be written.
    """
    inside = (flight.time_s >= span_s[0]) & (flight.time_s <= span_s[1])
    known = np.flatnonzero(inside & np.isfinite(flight.separation_m))
    if len(known) < 2:
        raise EchowingError(f"animation of {flight.name!r}: no two samples have both positions")
    project, map_px = projection(flight, known)
    leader, follower = project(flight.leader_ned_m[known]), project(flight.follower_ned_m[known])
    unit_px = np.hypot(*np.diff(project(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])), axis=0)[0])
    frames = _frames(flight, known, leader, follower)
    parts = [
        path_line(leader, LEADER_COLOUR),
        path_line(follower, FOLLOWER_COLOUR),
        heading(title),
        scale_bar(project, map_px),
        north_arrow(project, map_px),
        *_vehicles(frames, float(unit_px)),
        *_chart(frames, flight.wanted_separation_m, map_px + GAP_PX),
    ]
    write_page(path, document("\n".join(parts), map_px + GAP_PX + CHART_PX + EDGE_PX), "animation")


def _frames(flight: Flight, known: np.ndarray, leader: Floats, follower: Floats) -> Frames:
    times = flight.time_s[known]
    at_s = np.arange(times[0], times[-1] + 1e-9, FRAME_S)

    def along(values: Floats) -> Floats:
        return np.column_stack([np.interp(at_s, times, column) for column in values.T])

    leader_px, follower_px = along(leader), along(follower)
    dx, dy = (leader_px - follower_px).T
    beam_deg = np.degrees(np.unwrap(np.arctan2(dx, -dy)))
    measured_s = flight.time_s[np.isfinite(flight.sonar_m)]
    before = np.searchsorted(measured_s, at_s, side="right") - 1
    age_s = at_s - measured_s[np.maximum(before, 0)] if len(measured_s) else np.full(len(at_s), 1e9)
    seen = ((before >= 0) & (age_s <= SEEN_S)).astype(float)
    separation_m = np.interp(at_s, times, flight.separation_m[known])
    return Frames(at_s, leader_px, follower_px, beam_deg, seen, separation_m)


def _vehicles(frames: Frames, unit_px: float) -> Iterable[str]:
    """The beam, the line between the two, and the two."""
    half = np.radians(BEAM_HALF_DEG)
    x, y = BEAM_LENGTH_M * unit_px * np.sin(half), -BEAM_LENGTH_M * unit_px * np.cos(half)
    yield (
        f"<g>{_moved(frames, 'translate', frames.follower_px)}<g>"
        f"{_moved(frames, 'rotate', frames.beam_deg[:, None])}"
        f'<path d="M0,0 L{-x:.1f},{y:.1f} Q0,{y * 1.06:.1f} {x:.1f},{y:.1f} Z" '
        f'fill="{FOLLOWER_COLOUR}">'
        f"{_animated(frames, 'fill-opacity', 0.08 + 0.27 * frames.seen, places=2, steps=True)}"
        "</path></g></g>"
    )
    ends = {
        "x1": frames.leader_px[:, 0],
        "y1": frames.leader_px[:, 1],
        "x2": frames.follower_px[:, 0],
        "y2": frames.follower_px[:, 1],
    }
    yield _line(frames, ends, QUIET_COLOUR)
    for place, colour in ((frames.leader_px, LEADER_COLOUR), (frames.follower_px, FOLLOWER_COLOUR)):
        yield f'<circle r="8" fill="{colour}">{_moved(frames, "translate", place)}</circle>'


def _chart(frames: Frames, wanted_m: float, top_px: float) -> Iterable[str]:
    """The true separation over time, the wanted one, and where the vehicles are in it."""
    bottom = top_px + CHART_PX
    right = WIDTH_PX - EDGE_PX
    span_s = frames.time_s[-1] - frames.time_s[0]
    x = EDGE_PX + (frames.time_s - frames.time_s[0]) / span_s * (right - EDGE_PX)
    y = bottom - np.clip(frames.separation_m, 0.0, CHART_TOP_M) / CHART_TOP_M * CHART_PX
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    # Under the line, where the separation hardly ever is.
    wanted_y = bottom - wanted_m / CHART_TOP_M * CHART_PX
    yield (
        f'<path d="M{EDGE_PX},{top_px:.1f} V{bottom:.1f} H{right}" fill="none" stroke="#c5ccd8"/>'
        f'<text x="{EDGE_PX}" y="{top_px - 8:.1f}">true separation, m</text>'
        f'<line x1="{EDGE_PX}" y1="{wanted_y:.1f}" x2="{right}" y2="{wanted_y:.1f}" '
        f'stroke="{GOOD_COLOUR}" stroke-dasharray="5 4"/>'
        f'<text x="{right}" y="{wanted_y + 38:.1f}" text-anchor="end" fill="{GOOD_COLOUR}">'
        f"wanted {wanted_m:g} m</text>"
        f'<polyline points="{points}" fill="none" stroke="{FOLLOWER_COLOUR}" stroke-width="1.6"/>'
        f'<text x="{EDGE_PX - 8}" y="{bottom + 5:.1f}" text-anchor="end">0</text>'
        f'<text x="{EDGE_PX - 8}" y="{top_px + 5:.1f}" text-anchor="end">{CHART_TOP_M:g}</text>'
        f'<text x="{right}" y="{bottom + 18:.1f}" text-anchor="end">{span_s:.0f} s of flight, '
        f"played {SPEED_UP:g} times as fast</text>"
    )
    yield _line(frames, {"x1": x, "x2": x}, LEADER_COLOUR, f' y1="{top_px:.1f}" y2="{bottom:.1f}"')


def _line(frames: Frames, ends: Mapping[str, Floats], colour: str, fixed: str = "") -> str:
    first = " ".join(f'{name}="{values[0]:.1f}"' for name, values in ends.items())
    moves = "".join(_animated(frames, name, values) for name, values in ends.items())
    return f'<line {first}{fixed} stroke="{colour}" stroke-width="1.6">{moves}</line>'


def _animated(
    frames: Frames, attribute: str, values: Floats, *, places: int = 1, steps: bool = False
) -> str:
    mode = "discrete" if steps else "linear"
    return (
        f'<animate attributeName="{attribute}" calcMode="{mode}" '
        f'values="{_listed(values[:, None], places)}" {_timing(frames)}/>'
    )


def _moved(frames: Frames, kind: str, values: Floats) -> str:
    return (
        f'<animateTransform attributeName="transform" type="{kind}" '
        f'values="{_listed(values, 1)}" {_timing(frames)}/>'
    )


def _timing(frames: Frames) -> str:
    return f'dur="{html.escape(f"{frames.lasts_s:g}")}s" repeatCount="indefinite"'


def _listed(values: Floats, places: int) -> str:
    return ";".join(",".join(f"{one:.{places}f}" for one in row) for row in values)
