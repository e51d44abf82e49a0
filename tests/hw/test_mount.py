"""The mount prints, fits its parts, turns freely and stays out of the beam."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from echowing.rig.search import Aim
from hwtools import keepout, mount
from hwtools.facts import beam_half_angle_deg

PARAMETERS = mount.parameters()
BED_MM = 180.0  # the smallest printers in common use


def number(name: str) -> float:
    value = PARAMETERS[name]
    assert isinstance(value, float)
    return value


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
    solid = keepout.read_stl(fresh_parts[part])
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0
    assert len(solid.split(only_watertight=False)) == 1


@pytest.mark.parametrize("part", mount.PARTS)
def test_part_lies_flat_on_the_bed(part: str, fresh_parts: dict[str, Path]) -> None:
    solid = keepout.read_stl(fresh_parts[part])
    assert solid.bounds[0][2] == pytest.approx(0.0, abs=1e-3)
    assert max(solid.extents[:2]) < BED_MM
    faces_down = solid.face_normals[:, 2] < -0.999
    flat = solid.area_faces[faces_down & (solid.triangles_center[:, 2] < 1e-3)]
    assert flat.sum() > 200.0, "too little to stick by"


@pytest.mark.parametrize("diagonal", [1.0, -1.0])
def test_sonars_screws_pass_the_cradle(diagonal: float, fresh_parts: dict[str, Path]) -> None:
    # as printed: back plate on the bed, up is -x; two screws at opposite corners of the pattern
    cradle = keepout.read_stl(fresh_parts["cradle"])
    for end in (1.0, -1.0):
        up = end * number("sonar_hole_pitch_height_mm") / 2
        side = diagonal * end * number("sonar_hole_pitch_width_mm") / 2
        screw = rod(number("sonar_hole_diameter_mm"), 40.0, "z", (-up, side, 0.0))
        assert keepout.common_mm3(cradle, screw) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("tube_mm", [12.0, 25.0])
def test_clamp_fits_the_tube_it_is_set_to(tube_mm: float, tmp_path: Path) -> None:
    for part in ("base", "cap"):
        path = tmp_path / f"{part}.stl"
        mount.export_stl(part, path, frame_tube_diameter_mm=tube_mm)
        solid = keepout.read_stl(path)
        assert solid.is_watertight
        # as printed the tube's axis lies half a tube and a wall above the bed; it ends at its front
        middle = (number("frame_tube_front_mm") - 50.0, 0.0, tube_mm / 2 + number("print_wall_mm"))
        inside = rod(tube_mm - 0.2, 100.0, "x", middle)
        assert keepout.common_mm3(solid, inside) == pytest.approx(0.0, abs=1e-6)
        thicker = rod(tube_mm + 1.0, 100.0, "x", middle)
        assert keepout.common_mm3(solid, thicker) > 100.0


def test_nothing_cuts_into_anything_within_the_travel(rig: keepout.Rig) -> None:
    most = number("tilt_mechanical_limit_deg")
    for aim in (*keepout.every_aim(), *(Aim(r, u) for r in (-most, most) for u in (-most, most))):
        assert max(keepout.clash_mm3(rig, aim).values()) < 1e-3


def test_a_clash_would_be_seen(rig: keepout.Rig) -> None:
    lifted = rig.solids["panning"].copy()
    lifted.apply_translation((0.0, 0.0, 14.0))  # into the cradle
    wrong = replace(rig, solids={**rig.solids, "panning": lifted})
    assert keepout.clash_mm3(wrong, Aim(0.0, 0.0))["cradle, yoke"] > 10.0


def test_the_travel_covers_the_scan_twice() -> None:
    most = max(max(abs(aim.right_deg), abs(aim.up_deg)) for aim in keepout.every_aim())
    assert number("tilt_mechanical_limit_deg") >= 2 * most


def test_nothing_stands_in_the_beam(rig: keepout.Rig) -> None:
    clear = {row.solid: row.clear_deg for row in keepout.clearances(rig)}
    assert set(clear) == {"fixed", "panning", "aircraft"}
    assert min(clear.values()) >= number("keepout_margin_deg")


def test_keepout_notices_a_propeller_in_the_way(rig: keepout.Rig) -> None:
    # a disc that would just touch a beam looking straight ahead: panned, the beam enters it
    disc_mm = number("frame_propeller_diameter_mm")
    edge = 300.0 * float(np.tan(np.radians(beam_half_angle_deg())))
    disc = rod(disc_mm, 2.0, "z", (rig.face_x + 300.0, edge + disc_mm / 2, rig.tilt_z))
    blocked = replace(rig, solids={**rig.solids, "aircraft": disc})
    clear = {row.solid: row.clear_deg for row in keepout.clearances(blocked)}
    assert clear["aircraft"] < 0.0


@pytest.mark.parametrize(
    ("ahead_mm", "beside_mm", "wanted_deg"),
    [
        (100.0, 0.0, 0.0),  # on the axis
        (100.0, 100.0, 45.0),  # beside the transducer's rim by as much as ahead
        (0.0, 50.0, 90.0),  # in the plane of its face
        (-50.0, 0.0, 180.0),  # straight behind
    ],
)
def test_angle_is_measured_from_the_transducers_rim(
    rig: keepout.Rig, ahead_mm: float, beside_mm: float, wanted_deg: float
) -> None:
    beside = beside_mm + rig.transducer_radius if beside_mm else 0.0
    point = np.array([[rig.face_x + ahead_mm, beside, rig.tilt_z]])
    assert keepout.off_axis_deg(rig, point, Aim(0.0, 0.0)) == pytest.approx(wanted_deg)


def test_the_beam_turns_with_the_gimbal(rig: keepout.Rig) -> None:
    # pan 30 degrees right, tilt 10 up: a point on that line from the pivot is on the axis
    right, up = np.radians(30.0), np.radians(10.0)
    line = np.array([np.cos(up) * np.cos(right), -np.cos(up) * np.sin(right), np.sin(up)])
    point = np.array([[0.0, 0.0, rig.tilt_z]]) + 200.0 * line
    assert keepout.off_axis_deg(rig, point, Aim(30.0, 10.0)) == pytest.approx(0.0, abs=1e-6)
    assert keepout.off_axis_deg(rig, point, Aim(-30.0, 10.0)) > 45.0


def test_sampling_leaves_no_gap_for_the_beam() -> None:
    # a plate with corners only far apart; the beam is never narrower than the transducer
    points = keepout.sampled(trimesh.creation.box((200.0, 200.0, 2.0)))
    probe = np.array([13.0, 29.0, 1.0])
    assert np.linalg.norm(points - probe, axis=1).min() < keepout.SAMPLE_MM
    assert number("sonar_transducer_diameter_mm") > keepout.SAMPLE_MM
