"""The mount as solids, and how they turn.

The solids come from mount.scad itself, so picture, print and checks cannot differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from echowing.rig.search import Aim
from hwtools import mount

Points = NDArray[np.float64]  # (n, 3), mount frame, millimetres: x forward, y left, z up
Point = NDArray[np.float64]  # (3,), the same

# What turns with the yoke, what with the cradle; the rest stands.
PANNING, TILTING = "panning", "tilting"
STANDING = ("fixed", "frame", "discs")
# Single bodies, for the inertia.
BODIES = ("yoke_mass", "tilt_servo_mass", "cradle_mass", "sonar_mass")


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The mount's solids, gimbal centred, and the measures that mount.scad derives (millimetres).

    Each is itself alone: what takes seconds is worked out once for it, and kept.

    measures: yoke_bottom, tilt_z, face_x, shelf_top, plate_back, yoke_back.
    """

    solids: dict[str, trimesh.Trimesh]
    measures: dict[str, float]

    @property
    def pivot(self) -> Point:
        """Where the pan axis meets the tilt axis."""
        return np.array([0.0, 0.0, self.measures["tilt_z"]])

    @property
    def face_x(self) -> float:
        """How far the sonar's face is ahead of the pivot."""
        return self.measures["face_x"]

    def motion(self, solid: str, aim: Aim) -> NDArray[np.float64]:
        """Return how a solid is moved with the gimbal at `aim`: turn and shift (3, 4)."""
        pans, tilts = solid in (PANNING, TILTING), solid == TILTING
        turn = rotation(Aim(aim.right_deg if pans else 0.0, aim.up_deg if tilts else 0.0))
        return np.column_stack([turn, self.pivot - turn @ self.pivot])

    def turned(self, points: Points, solid: str, aim: Aim) -> Points:
        """Return points of a solid with the gimbal at `aim`."""
        if solid in STANDING:
            return points
        motion = self.motion(solid, aim)
        turned: Points = points @ motion[:, :3].T + motion[:, 3]
        return turned


def load_rig(folder: Path, names: Sequence[str] = (*STANDING, PANNING, TILTING, *BODIES)) -> Rig:
    """Have OpenSCAD write the solids that are not in `folder` yet, and read all back."""
    return Rig({name: _solid(name, folder) for name in names}, mount.derived(folder))


def _solid(name: str, folder: Path) -> trimesh.Trimesh:
    path = folder / f"{name}.stl"
    if not path.exists():
        mount.export_stl(name, path)
    return read_stl(path)


def read_stl(path: Path) -> trimesh.Trimesh:
    """Read one STL as a single mesh with its equal corners joined."""
    mesh = trimesh.load_mesh(path)
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.merge_vertices()
    return mesh


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


def sampled(solid: trimesh.Trimesh, size_mm: float) -> Points:
    """Return points on the solid's surface, no farther apart than `size_mm`."""
    cut: Any = trimesh.remesh.subdivide_to_size  # has no types of its own
    vertices, _ = cut(solid.vertices, solid.faces, size_mm, max_iter=12)
    return np.unique(np.asarray(vertices, dtype=np.float64).round(2), axis=0)


def common_mm3(one: trimesh.Trimesh, other: trimesh.Trimesh) -> float:
    """Return the volume two solids share."""
    shared = trimesh.boolean.intersection([one, other], engine="manifold")
    return 0.0 if shared.is_empty else float(shared.volume)
