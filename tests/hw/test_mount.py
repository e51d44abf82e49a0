"""The mount prints and fits its parts."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from hwtools import mount
from hwtools.mount import number
from hwtools.rig import common_mm3, read_stl

BED_MM = 180.0  # the smallest printers in common use


def rod(
    diameter_mm: float, length_mm: float, axis: str, centre: tuple[float, float, float]
) -> trimesh.Trimesh:
    """A cylinder along x or z about its centre."""
    half = {"x": (length_mm / 2, 0.0, 0.0), "z": (0.0, 0.0, length_mm / 2)}[axis]
    ends = (np.subtract(centre, half), np.add(centre, half))
    solid: trimesh.Trimesh = trimesh.creation.cylinder(diameter_mm / 2, segment=ends)
    return solid


@pytest.mark.parametrize("part", mount.PARTS)
def test_part_is_manifold_and_in_one_piece(part: str, fresh_parts: dict[str, Path]) -> None:
    solid = read_stl(fresh_parts[part])
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0
    assert len(solid.split(only_watertight=False)) == 1


@pytest.mark.parametrize("part", mount.PARTS)
def test_part_lies_flat_on_the_bed(part: str, fresh_parts: dict[str, Path]) -> None:
    solid = read_stl(fresh_parts[part])
    assert solid.bounds[0][2] == pytest.approx(0.0, abs=1e-3)
    assert max(solid.extents[:2]) < BED_MM
    faces_down = solid.face_normals[:, 2] < -0.999
    flat = solid.area_faces[faces_down & (solid.triangles_center[:, 2] < 1e-3)]
    assert flat.sum() > 200.0, "too little to stick by"


@pytest.mark.parametrize("diagonal", [1.0, -1.0])
def test_sonars_screws_pass_the_cradle(diagonal: float, fresh_parts: dict[str, Path]) -> None:
    # as printed: back plate on the bed, up is -x; two screws at opposite corners of the pattern
    cradle = read_stl(fresh_parts["cradle"])
    for end in (1.0, -1.0):
        up = end * number("sonar_hole_pitch_height_mm") / 2
        side = diagonal * end * number("sonar_hole_pitch_width_mm") / 2
        screw = rod(number("sonar_hole_diameter_mm"), 40.0, "z", (-up, side, 0.0))
        assert common_mm3(cradle, screw) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("tube_mm", [12.0, 25.0])
def test_clamp_fits_the_tube_it_is_set_to(tube_mm: float, tmp_path: Path) -> None:
    for part in ("base", "cap"):
        path = tmp_path / f"{part}.stl"
        mount.export_stl(part, path, frame_tube_diameter_mm=tube_mm)
        solid = read_stl(path)
        assert solid.is_watertight
        # as printed the tube's axis lies half a tube and a wall above the bed; it ends at its front
        middle = (number("frame_tube_front_mm") - 50.0, 0.0, tube_mm / 2 + number("print_wall_mm"))
        inside = rod(tube_mm - 0.2, 100.0, "x", middle)
        assert common_mm3(solid, inside) == pytest.approx(0.0, abs=1e-6)
        thicker = rod(tube_mm + 1.0, 100.0, "x", middle)
        assert common_mm3(solid, thicker) > 100.0
