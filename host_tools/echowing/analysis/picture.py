"""A flown formation as a static SVG, for pages that cannot run scripts (the README)."""

import html
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echowing.analysis.flight import Flight, Floats
from echowing.analysis.plots import (
    FOLLOWER_COLOUR,
    LEADER_COLOUR,
    QUIET_COLOUR,
    matching_indices,
    thinned,
)
from echowing.errors import EchowingError

WIDTH_PX = 860.0
EDGE_PX = 48.0
HEAD_PX = 40.0
SCALE_BAR_M = 10.0

Indices = NDArray[np.intp]
# NED metres (n, 3) to picture (n, 2).
Project = Callable[[Floats], Floats]


def write_formation_svg(
    path: Path, flight: Flight, title: str = "", span_s: tuple[float, float] | None = None
) -> None:
    """`formation_svg` as a file. Raises EchowingError if it cannot be written."""
    text = formation_svg(flight, title, span_s)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"picture {path}: cannot be written: {error.strerror}") from error


def formation_svg(
    flight: Flight, title: str = "", span_s: tuple[float, float] | None = None
) -> str:
    """Both tracks, and the distance between the two about every 10 s (thesis Fig. 37).

    span_s: only this part of the flight (from, to), as one lap; all of it without.

    East is right and north is up, unless the flight is longer north than east: then the picture
    is turned a quarter to lie down, and its north arrow points left.
    """
    start_s, end_s = span_s or (-np.inf, np.inf)
    inside = (flight.time_s >= start_s) & (flight.time_s <= end_s)
    known = np.flatnonzero(inside & np.isfinite(flight.separation_m))
    if len(known) == 0:
        raise EchowingError(f"picture of {flight.name!r}: no sample in it has both positions")
    project, height_px = projection(flight, known)
    leader, follower = project(flight.leader_ned_m), project(flight.follower_ned_m)
    parts = [
        path_line(leader[known], LEADER_COLOUR),
        path_line(follower[known], FOLLOWER_COLOUR),
        *_pairs(flight, leader, follower, known),
        heading(title or f"{flight.name}: wanted {flight.wanted_separation_m:g} m"),
        scale_bar(project, height_px, "; distances in metres"),
        north_arrow(project, height_px),
    ]
    return document("\n".join(parts), height_px)


def projection(flight: Flight, known: Indices) -> tuple[Project, float]:
    """From metres to the picture, and the height of the picture in pixels."""
    both = np.vstack([flight.leader_ned_m[known, :2], flight.follower_ned_m[known, :2]])
    low, high = both.min(axis=0), both.max(axis=0)
    north_m, east_m = high - low
    lying = north_m > east_m
    across_m, up_m = (north_m, east_m) if lying else (east_m, north_m)
    scale = (WIDTH_PX - 2 * EDGE_PX) / max(float(across_m), SCALE_BAR_M)
    top_px = EDGE_PX + HEAD_PX

    def project(ned_m: Floats) -> Floats:
        if lying:  # north to the left, east up
            x, y = high[0] - ned_m[:, 0], high[1] - ned_m[:, 1]
        else:
            x, y = ned_m[:, 1] - low[1], high[0] - ned_m[:, 0]
        return np.column_stack([EDGE_PX + x * scale, top_px + y * scale])

    return project, float(up_m) * scale + top_px + EDGE_PX + HEAD_PX


def path_line(points: Floats, colour: str) -> str:
    """One line, thinned where it wiggles less than can be seen."""
    keep = np.union1d(thinned(points[:, 0], 600), thinned(points[:, 1], 600)).astype(int)
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points[keep])
    return (
        f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="1.6" '
        'stroke-opacity="0.55"/>'
    )


def _pairs(flight: Flight, leader: Floats, follower: Floats, known: Indices) -> list[str]:
    separation_m = flight.separation_m
    parts = []
    for index in np.intersect1d(matching_indices(flight), known):
        (ax, ay), (bx, by) = leader[index], follower[index]
        label_x, label_y = _label_place(float(ax - bx), float(ay - by))
        parts.append(
            f'<line x1="{ax:.1f}" y1="{ay:.1f}" x2="{bx:.1f}" y2="{by:.1f}" '
            f'stroke="{QUIET_COLOUR}" stroke-width="1.2"/>'
            f'<circle cx="{ax:.1f}" cy="{ay:.1f}" r="5" fill="{LEADER_COLOUR}"/>'
            f'<circle cx="{bx:.1f}" cy="{by:.1f}" r="5" fill="{FOLLOWER_COLOUR}"/>'
            f'<text x="{(ax + bx) / 2 + label_x:.1f}" y="{(ay + by) / 2 + label_y:.1f}" '
            f'text-anchor="middle">{separation_m[index]:.1f}</text>'
        )
    return parts


def _label_place(dx_px: float, dy_px: float) -> tuple[float, float]:
    """Beside an upright pair, above a lying one."""
    return (20.0, 5.0) if abs(dy_px) > abs(dx_px) else (0.0, -11.0)


def heading(title: str) -> str:
    """The title and who has which colour."""
    right = WIDTH_PX - EDGE_PX
    return (
        f'<text x="{EDGE_PX}" y="36" class="title">{html.escape(title)}</text>'
        f'<circle cx="{right - 150}" cy="31" r="5" fill="{LEADER_COLOUR}"/>'
        f'<text x="{right - 139}" y="36">leader</text>'
        f'<circle cx="{right - 72}" cy="31" r="5" fill="{FOLLOWER_COLOUR}"/>'
        f'<text x="{right - 61}" y="36">follower</text>'
    )


def scale_bar(project: Project, height_px: float, note: str = "") -> str:
    """How long some metres are, and a note beside it."""
    ends = project(np.array([[0.0, 0.0, 0.0], [SCALE_BAR_M, 0.0, 0.0]]))
    length_px = float(np.hypot(*(ends[1] - ends[0])))
    y = height_px - 26.0
    return (
        f'<line x1="{EDGE_PX}" y1="{y}" x2="{EDGE_PX + length_px:.1f}" y2="{y}" '
        'stroke="#253046" stroke-width="2"/>'
        f'<text x="{EDGE_PX + length_px + 8:.1f}" y="{y + 5}">{SCALE_BAR_M:g} m{note}</text>'
    )


def north_arrow(project: Project, height_px: float) -> str:
    """Where north is."""
    ends = project(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    dx, dy = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    x, y = WIDTH_PX - EDGE_PX - 8.0, height_px - 26.0
    angle_deg = float(np.degrees(np.arctan2(dx, -dy)))
    return (
        f'<g transform="translate({x} {y}) rotate({angle_deg:.0f})">'
        '<path d="M0,-12 L5,8 L0,4 L-5,8 Z" fill="#253046"/></g>'
        f'<text x="{x - 20}" y="{y + 5}" text-anchor="end">north</text>'
    )


def document(body: str, height_px: float) -> str:
    """The SVG file."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX:.0f} {height_px:.0f}" '
        f'width="{WIDTH_PX:.0f}" height="{height_px:.0f}" '
        'font-family="system-ui, sans-serif" font-size="13" fill="#253046">\n'
        "<style>.title { font-size: 17px; font-weight: 600 }</style>\n"
        # A ground of its own: it must be readable on dark pages too.
        '<rect width="100%" height="100%" rx="10" fill="#ffffff"/>\n'
        f"{body}\n</svg>\n"
    )
