"""A planned formation as files: slots for `follow --formation`, a scenario, and a picture."""

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from echowing.errors import EchowingError
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import check_formation
from echowing.flight.guidance import Slot
from echowing.planning.cost import Formation

# A picture: pixels per metre, and around the slots.
SCALE_PX, EDGE_PX = 60.0, 60.0
LEADER_COLOUR, FOLLOWER_COLOUR, QUIET_COLOUR = "#1f6feb", "#e8710a", "#8a94a6"


def file_slots(formation: Formation) -> list[Slot]:
    """Its slots as a file has them: in millimetres and hundredths of a degree.

    Raises EchowingError where `follow` and `sim` would refuse them: nothing in the file allows
    what they do not allow by themselves.
    """
    slots = [_rounded(slot) for slot in formation.slots()]
    try:
        check_formation(slots, formation.limits.sonar, LEAST_M)
    except EchowingError as error:
        raise EchowingError(
            f"the best one that was found would not be flown: {error}. Try another --seed, more "
            "--evaluations or other limits"
        ) from error
    return slots


def formation_table(slots: Sequence[Slot]) -> dict[str, Any]:
    """What a formation file has."""
    return {"slots": [_slot_table(slot) for slot in slots]}


def _rounded(slot: Slot) -> Slot:
    angle_rad = math.radians(round(math.degrees(slot.angle_rad), 2))
    return replace(slot, radius_m=round(slot.radius_m, 3), angle_rad=angle_rad)


def _slot_table(slot: Slot) -> dict[str, Any]:
    table: dict[str, Any] = {
        "radius_m": slot.radius_m,
        "angle_deg": round(math.degrees(slot.angle_rad), 2),
        "altitude_step_m": slot.altitude_step_m,
    }
    return table if slot.behind is None else {**table, "behind": slot.behind + 1}


def toml_text(table: Mapping[str, Any], said: str) -> str:
    """A TOML file, and above it what is said of it."""
    import tomli_w  # noqa: PLC0415 (only where a file is written)

    comment = "".join(f"# {line}\n" for line in said.splitlines())
    return comment + tomli_w.dumps(table)


def write(path: Path, text: str) -> None:
    """Write a file. Raises EchowingError where that cannot be done."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{path}: cannot be written: {error.strerror}") from error


def svg_text(formation: Formation, title: str) -> str:
    """A picture from above, the leader flies up: arrows lead to whom each sonar watches."""
    back_m, right_m = formation.places_m[:, 0], formation.places_m[:, 1]
    half_px = EDGE_PX + SCALE_PX * max(3.0, float(abs(right_m).max()))
    height_px = 2.0 * EDGE_PX + SCALE_PX * float(back_m.max())
    at_px = [
        (half_px + SCALE_PX * float(right), EDGE_PX + SCALE_PX * float(back))
        for back, right in zip(back_m, right_m, strict=True)
    ]
    body = "\n".join((*_arrows(formation, at_px), *_vehicles(formation, at_px)))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2.0 * half_px:.0f} '
        f'{height_px:.0f}" font-family="system-ui, sans-serif" font-size="13" fill="#253046">\n'
        f'<defs><marker id="a" viewBox="0 0 10 10" refX="24" refY="5" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path d="M0,0 L10,5 L0,10 Z" fill="{QUIET_COLOUR}"/>'
        "</marker></defs>\n"
        '<rect width="100%" height="100%" rx="10" fill="#ffffff"/>\n'
        f'<text x="16" y="24" font-weight="600">{html.escape(title)}</text>\n{body}\n</svg>\n'
    )


def _arrows(formation: Formation, at_px: list[tuple[float, float]]) -> Iterator[str]:
    for one, its in enumerate(formation.watches, 1):
        (x, y), (to_x, to_y) = at_px[one], at_px[its]
        yield (
            f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{to_x:.1f}" y2="{to_y:.1f}" '
            f'stroke="{QUIET_COLOUR}" stroke-width="1.5" marker-end="url(#a)"/>'
            f'<text x="{(x + to_x) / 2.0 + 6.0:.1f}" y="{(y + to_y) / 2.0:.1f}" '
            f'fill="{QUIET_COLOUR}">{formation.geometry.far_m[one, its]:.2f} m</text>'
        )


def _vehicles(formation: Formation, at_px: list[tuple[float, float]]) -> Iterator[str]:
    for one, (x, y) in enumerate(at_px):
        name, colour = (str(one), FOLLOWER_COLOUR) if one else ("L", LEADER_COLOUR)
        up_m = float(formation.places_m[one, 2])
        step = f" {up_m:+g} m" if up_m else ""
        yield (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="14" fill="{colour}"/>'
            f'<text x="{x:.1f}" y="{y + 5.0:.1f}" text-anchor="middle" fill="#fff">{name}</text>'
            f'<text x="{x + 18.0:.1f}" y="{y + 5.0:.1f}">{step}</text>'
        )
