"""The keep-out cone: nothing of the aircraft or of the mount may stand in the beam.

The beam starts as wide as the transducer and opens by its half-angle. It is looked at over the
whole reach of the gimbal, every STEP_DEG in pan and in tilt: between two of these a point comes
nearer to its edge by a few degrees at most, less than the margin.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from echowing.rig.search import Aim
from hwtools import mount
from hwtools.facts import beam_half_angle_deg, gimbal_reach, scan_aims
from hwtools.rig import PANNING, Points, Rig, rotation, sampled

SAMPLE_MM = 8.0  # faces are cut to this size, so that no cone slips through a large one
STEP_DEG = 5.0
SOLIDS = ("fixed", PANNING, "frame", "discs")  # what the beam may not touch
AIRCRAFT = ("frame", "discs")
# Other places of the sonar's face, ahead of the aircraft's centre, and the tilts told for them.
PLACES_MM = (100.0, 200.0, 250.0, 300.0)
TILTS_DEG = (-30.0, -15.0, 0.0, 15.0, 30.0)


@dataclass(frozen=True, slots=True)
class Clearance:
    """How far a solid stays outside the beam at the worst aim."""

    solid: str
    aim: Aim
    clear_deg: float


@cache
def beam(rig: Rig) -> dict[str, dict[Aim, float]]:
    """Return for each solid by how many degrees it is clear of the beam, at every aim."""
    return {name: _clear(rig, name, whole_reach()) for name in SOLIDS}


def clearances(clear: dict[str, dict[Aim, float]]) -> list[Clearance]:
    """Return for each solid its worst clearance over the whole reach."""
    return [
        min((Clearance(name, aim, deg) for aim, deg in at.items()), key=_by_deg)
        for name, at in clear.items()
    ]


def shadowed(clear: dict[str, dict[Aim, float]]) -> list[Aim]:
    """Return the aims, over the whole reach, that keep less than the wanted margin."""
    margin = mount.number("keepout_margin_deg")
    return [aim for aim in whole_reach() if min(at[aim] for at in clear.values()) < margin]


def _by_deg(clearance: Clearance) -> float:
    return clearance.clear_deg


def whole_reach() -> Iterator[Aim]:
    """Yield aims over the gimbal's reach and the scan's points, with either sign of both."""
    reach = gimbal_reach()
    pans, tilts = _steps(reach.pan_deg), _steps(reach.tilt_deg)
    yield from (Aim(float(pan), float(tilt)) for pan in pans for tilt in tilts)
    for aim in dict.fromkeys(scan_aims()):
        for side in (1.0, -1.0):
            for way in (1.0, -1.0):
                yield Aim(side * aim.right_deg, way * aim.up_deg)


def free_pan_deg(rig: Rig, points: Points, up_deg: float) -> float | None:
    """Return how far to each side the beam keeps its margin from these points of the aircraft.

    None: not even straight ahead.
    """
    margin, free = mount.number("keepout_margin_deg"), None
    for pan in np.arange(0.0, gimbal_reach().pan_deg + STEP_DEG / 2, STEP_DEG):
        if off_axis_deg(rig, points, Aim(float(pan), up_deg)) - beam_half_angle_deg() < margin:
            break
        free = float(pan)
    return free


def off_axis_deg(rig: Rig, points: Points, aim: Aim) -> float:
    """Return the half-angle at which the beam, looking along `aim`, would first touch a point."""
    axis = rotation(aim) @ np.array([1.0, 0.0, 0.0])
    away = points - (rig.pivot + rig.face_x * axis)
    along = away @ axis
    ahead = along > 0.0
    if ahead.any():  # what is not is at 90 degrees or more
        away, along = away[ahead], along[ahead]
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", away, away) - along**2, 0.0))
    beside = np.maximum(across - mount.number("sonar_transducer_diameter_mm") / 2, 0.0)
    return float(np.degrees(np.arctan2(beside, along).min()))


def _steps(most_deg: float) -> Points:
    return np.linspace(-most_deg, most_deg, 1 + round(2 * most_deg / STEP_DEG))


@cache
def _points(rig: Rig, solid: str) -> Points:
    return sampled(rig.solids[solid], SAMPLE_MM)


def _clear(rig: Rig, solid: str, aims: Iterable[Aim]) -> dict[Aim, float]:
    points, half_deg = _points(rig, solid), beam_half_angle_deg()
    return {aim: off_axis_deg(rig, rig.turned(points, solid, aim), aim) - half_deg for aim in aims}


def report_text(rig: Rig) -> str:
    """Return the keep-out report as Markdown."""
    clear, reach = beam(rig), gimbal_reach()
    rows = clearances(clear)
    half_angle_deg, margin_deg = beam_half_angle_deg(), mount.number("keepout_margin_deg")
    most_deg = half_angle_deg + min(row.clear_deg for row in rows)
    table = "\n".join(
        f"| {row.solid} | {row.clear_deg:.0f} | {row.aim.right_deg:g} | {row.aim.up_deg:g} |"
        for row in rows
    )
    tilts = " | ".join(f"tilt {tilt:+g}" for tilt in TILTS_DEG)
    places = "\n".join(_place_rows(rig))
    return f"""# Keep-out

Written by `make hw`. Beam half-angle {half_angle_deg:g} degrees, over the gimbal's whole reach: pan
{reach.pan_deg:g} degrees to each side, tilt {reach.tilt_deg:g} up and down, looked at every
{STEP_DEG:g} degrees. Sonar's face {mount.number("frame_face_ahead_mm"):g} mm ahead of the
aircraft's centre.

| solid | clear of the beam, degrees | worst at pan, degrees right | and tilt, degrees up |
|---|---|---|---|
{table}

Wanted: {margin_deg:g} degrees. {_shadow_sentence(clear)} A wider beam keeps that
margin up to a half-angle of {most_deg - margin_deg:.0f} degrees, and touches something from
{most_deg:.0f} degrees on.

Solids: *fixed* is base, cap, pan servo, tube and their screws; *panning* is yoke, tilt servo and
its lead; *frame* is motors, arms, legs and body, *discs* the propellers, from `[frame]` in
`parameters.toml`. The cradle carries the sonar and lies behind its face.

## A sonar farther back

How far to each side the gimbal may look before a propeller comes nearer to the beam than
{margin_deg:g} degrees. Beyond, the sonar hears the propeller instead of the leader: give
`PAN_REACH` no more.

| face ahead of the centre, mm | {tilts} |
|---|{"---|" * len(TILTS_DEG)}
{places}
"""


def _shadow_sentence(clear: dict[str, dict[Aim, float]]) -> str:
    shadows = shadowed(clear)
    if not shadows:
        return "No direction is shadowed."
    told = ", ".join(f"({aim.right_deg:g}, {aim.up_deg:g})" for aim in shadows)
    return f"**Shadowed** (degrees right, up): {told}."


def _place_rows(rig: Rig) -> Iterator[str]:
    """Yield how free the beam is with the face at other places, and at its own."""
    own_mm = mount.number("frame_face_ahead_mm")
    aircraft = np.vstack([_points(rig, name) for name in AIRCRAFT])
    for place_mm in (*PLACES_MM, own_mm):
        points = aircraft + np.array([own_mm - place_mm, 0.0, 0.0])
        free = [free_pan_deg(rig, points, tilt) for tilt in TILTS_DEG]
        cells = " | ".join("none" if pan is None else f"{pan:.0f}" for pan in free)
        yield f"| {place_mm:g} | {cells} |"
