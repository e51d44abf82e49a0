"""GUIDANCE.md's picture of the formations by name: `python -m echowing.docs.shapes FILE.svg`."""

import sys
from pathlib import Path

from echowing.flight.guidance import place_m
from echowing.flight.shapes import shape

SHOWN = (("column", 3), ("vee", 4), ("echelon", 4), ("abreast", 3), ("diamond", 3))
SPACING_PX, TOP_PX, HEIGHT_PX = 42.0, 50.0, 210
# From the left edge to each leader, and the whole.
LEADERS_PX, WIDTH_PX = (60.0, 190.0, 310.0, 440.0, 650.0), 730
# A link ends so far from the centre of each of the two.
ROOM_PX = 12.0
LEADER, FOLLOWER = "#d9730d", "#1f6fb4"


def picture() -> str:
    """The picture as SVG: who is where, and at whom each sonar looks."""
    shapes = "".join(
        _drawn(name, followers, x_px)
        for (name, followers), x_px in zip(SHOWN, LEADERS_PX, strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" '
        f'width="{WIDTH_PX}" height="{HEIGHT_PX}" font-family="sans-serif" font-size="13" '
        'fill="#222">\n<title>Formations by name; each sonar looks along its arrow</title>\n'
        f'<rect width="{WIDTH_PX}" height="{HEIGHT_PX}" fill="white"/>\n'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="{FOLLOWER}"/></marker>'
        f"</defs>\n{shapes}</svg>\n"
    )


def _drawn(name: str, followers: int, x_px: float) -> str:
    slots = shape(name, followers, SPACING_PX)
    everybody = [(x_px, TOP_PX)]
    for number in range(followers):
        north_px, east_px, _ = place_m(slots, number)
        everybody.append((x_px + east_px, TOP_PX - north_px))
    lines = [f'<text x="{x_px:.0f}" y="24" text-anchor="middle">{name}</text>']
    for number, (slot, own) in enumerate(zip(slots, everybody[1:], strict=True), 1):
        watched = everybody[0 if slot.behind is None else slot.behind + 1]
        lines += [_link(own, watched), _vehicle(own, FOLLOWER, str(number))]
    lines.append(_vehicle(everybody[0], LEADER, "L"))
    return "\n".join(lines) + "\n"


def _link(own: tuple[float, float], watched: tuple[float, float]) -> str:
    """An arrow along the beam."""
    share = ROOM_PX / SPACING_PX
    (x1, y1), (x2, y2) = (
        tuple(a + part * (b - a) for a, b in zip(own, watched, strict=True))
        for part in (share, 1.0 - share)
    )
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{FOLLOWER}" '
        'stroke-width="1.5" stroke-dasharray="4 3" marker-end="url(#tip)"/>'
    )


def _vehicle(place: tuple[float, float], colour: str, text: str) -> str:
    x, y = place
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="10" fill="white" stroke="{colour}" '
        f'stroke-width="2"/><text x="{x:.1f}" y="{y + 4.5:.1f}" text-anchor="middle" '
        f'fill="{colour}">{text}</text>'
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(), encoding="utf-8")
