"""The keep-out cone: nothing of the aircraft or of the mount may stand in the beam.

The solids come from mount.scad itself, so picture, print and check cannot differ. The beam starts
as wide as the transducer and opens by its half-angle; which way a servo turns is a setting, so
every scan point is taken with both signs of pan and of tilt.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from echowing.rig.search import Aim
from hwtools import mount
from hwtools.facts import beam_half_angle_deg, scan_aims

Points = NDArray[np.float64]  # (n, 3), mount frame, millimetres: x forward, y left, z up

SAMPLE_MM = 8.0  # faces are cut to this size, so that no cone slips through a large one
STANDING = ("fixed", "panning", "aircraft")  # what the beam may not touch; the cradle carries it


@dataclass(frozen=True, slots=True)
class Clearance:
    """How far a solid stays outside the beam at the worst scan point."""

    solid: str
    aim: Aim
    clear_deg: float


@dataclass(frozen=True, slots=True)
class Rig:
    """The mount's solids, gimbal centred, and the measures that place the beam (millimetres)."""

    solids: dict[str, trimesh.Trimesh]
    tilt_z: float
    face_x: float
    transducer_radius: float


def load_rig(folder: Path) -> Rig:
    """Have OpenSCAD write the solids into `folder` and read them back."""
    measures = mount.derived(folder)
    transducer_mm = mount.parameters()["sonar_transducer_diameter_mm"]
    assert isinstance(transducer_mm, float)
    return Rig(
        {name: _solid(name, folder) for name in (*STANDING, "tilting")},
        measures["tilt_z"],
        measures["face_x"],
        transducer_mm / 2,
    )


def clearances(rig: Rig) -> list[Clearance]:
    """Return for each solid its worst clearance over the whole search."""
    half_angle_deg = beam_half_angle_deg()
    found = []
    for name in STANDING:
        points = sampled(rig.solids[name])
        angles = {aim: off_axis_deg(rig, _turned(points, name, aim), aim) for aim in every_aim()}
        worst = min(angles, key=lambda aim: angles[aim])
        found.append(Clearance(name, worst, angles[worst] - half_angle_deg))
    return found


def off_axis_deg(rig: Rig, points: Points, aim: Aim) -> float:
    """Return the half-angle at which the beam, looking along `aim`, would first touch a point."""
    turn = rotation(aim)
    axis = turn @ np.array([1.0, 0.0, 0.0])
    face = np.array([0.0, 0.0, rig.tilt_z]) + rig.face_x * axis
    away = points - face
    along = away @ axis
    across = np.linalg.norm(away - np.outer(along, axis), axis=1)
    beside = np.maximum(across - rig.transducer_radius, 0.0)
    return float(np.degrees(np.arctan2(beside, along)).min())


def every_aim() -> Iterator[Aim]:
    """Yield the scan's distinct points, with every sign of pan and tilt."""
    for aim in dict.fromkeys(scan_aims()):
        for side in (1.0, -1.0):
            for way in (1.0, -1.0):
                yield Aim(side * aim.right_deg, way * aim.up_deg)


def rotation(aim: Aim) -> NDArray[np.float64]:
    """Return the rotation (3, 3) from gimbal centred to `aim`: tilt first, then pan."""
    pan, tilt = np.radians(-aim.right_deg), np.radians(-aim.up_deg)  # x forward, y left, z up
    about_z = [[np.cos(pan), -np.sin(pan), 0.0], [np.sin(pan), np.cos(pan), 0.0], [0.0, 0.0, 1.0]]
    about_y = [
        [np.cos(tilt), 0.0, np.sin(tilt)],
        [0.0, 1.0, 0.0],
        [-np.sin(tilt), 0.0, np.cos(tilt)],
    ]
    return np.array(about_z) @ np.array(about_y)


def sampled(solid: trimesh.Trimesh) -> Points:
    """Return points on the solid's surface, no farther apart than SAMPLE_MM."""
    cut: Any = trimesh.remesh.subdivide_to_size  # has no types of its own
    vertices, _ = cut(solid.vertices, solid.faces, SAMPLE_MM, max_iter=12)
    return np.asarray(vertices, dtype=np.float64)


def clash_mm3(rig: Rig, aim: Aim) -> dict[str, float]:
    """Return by how much the moving solids cut into each other with the gimbal at `aim`."""
    pivot = np.array([0.0, 0.0, rig.tilt_z])
    tilting = rig.solids["tilting"].copy()
    tilting.vertices = (tilting.vertices - pivot) @ rotation(aim).T + pivot
    panning = rig.solids["panning"].copy()
    panning.vertices = _turned(panning.vertices, "panning", aim)
    pairs = {
        "cradle, yoke": (tilting, panning),
        "cradle, base": (tilting, rig.solids["fixed"]),
        "yoke, base": (panning, rig.solids["fixed"]),
        "base, aircraft": (rig.solids["fixed"], rig.solids["aircraft"]),
    }
    return {name: common_mm3(*pair) for name, pair in pairs.items()}


def common_mm3(one: trimesh.Trimesh, other: trimesh.Trimesh) -> float:
    """Return the volume two solids share."""
    shared = trimesh.boolean.intersection([one, other], engine="manifold")
    return 0.0 if shared.is_empty else float(shared.volume)


def report_text(rig: Rig) -> str:
    """Return the keep-out report as Markdown."""
    rows = clearances(rig)
    half_angle_deg = beam_half_angle_deg()
    margin_deg = mount.parameters()["keepout_margin_deg"]
    assert isinstance(margin_deg, float)
    most_deg = half_angle_deg + min(row.clear_deg for row in rows)
    table = "\n".join(
        f"| {row.solid} | {row.clear_deg:.0f} "
        f"| {abs(row.aim.right_deg):g} | {abs(row.aim.up_deg):g} |"
        for row in rows
    )
    return f"""# Keep-out

Written by `make hw`. Beam half-angle {half_angle_deg:g} degrees, every scan point with both signs
of pan and tilt, sonar's face {rig.face_x:.1f} mm ahead of the tilt axis.

| solid | clear of the beam, degrees | worst at pan, degrees | and tilt, degrees |
|---|---|---|---|
{table}

Wanted: {margin_deg:g} degrees. A wider beam keeps that margin up to a half-angle of
{most_deg - margin_deg:.0f} degrees, and touches something from {most_deg:.0f} degrees on.

Solids: *fixed* is base, cap, pan servo and tube; *panning* is yoke and tilt servo; *aircraft* is
propeller discs, motors, arms, legs and body, from `[frame]` in `parameters.toml`. The cradle
carries the sonar and lies behind its face.
"""


def _solid(name: str, folder: Path) -> trimesh.Trimesh:
    path = folder / f"{name}.stl"
    mount.export_stl(name, path)
    return read_stl(path)


def read_stl(path: Path) -> trimesh.Trimesh:
    """Read one STL as a single mesh with its equal corners joined."""
    mesh = trimesh.load_mesh(path)
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.merge_vertices()
    return mesh


def _turned(points: Points, solid: str, aim: Aim) -> Points:
    return points @ rotation(Aim(aim.right_deg, 0.0)).T if solid == "panning" else points
