"""The beam is free over the whole reach, or the report says where it is not."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from echowing.rig.search import Aim
from hwtools import keepout
from hwtools.facts import beam_half_angle_deg, gimbal_reach, scan_aims
from hwtools.mount import number
from hwtools.rig import Rig, sampled


@pytest.fixture(scope="module")
def clear(solids: Rig) -> dict[str, dict[Aim, float]]:
    """By how much each solid is clear of the beam."""
    return keepout.beam(solids)


def test_nothing_stands_in_the_beam_over_the_whole_reach(
    clear: dict[str, dict[Aim, float]],
) -> None:
    found = {row.solid: row.clear_deg for row in keepout.clearances(clear)}
    assert set(found) == {"fixed", "panning", "frame", "discs"}
    assert min(found.values()) >= number("keepout_margin_deg")
    assert keepout.shadowed(clear) == []


def test_the_whole_reach_is_looked_at() -> None:
    aims, reach = list(keepout.whole_reach()), gimbal_reach()
    for right in (-1.0, 1.0):
        for up in (-1.0, 1.0):
            assert Aim(right * reach.pan_deg, up * reach.tilt_deg) in aims
    assert set(scan_aims()) <= set(aims)


def test_a_sonar_where_the_thesis_had_its_own_would_hear_its_propellers(solids: Rig) -> None:
    """So the boom: 0.1 m ahead of the centre the gimbal may hardly pan at all."""
    aircraft = np.vstack([sampled(solids.solids[n], keepout.SAMPLE_MM) for n in keepout.AIRCRAFT])
    back = np.array([number("frame_face_ahead_mm") - 100.0, 0.0, 0.0])
    there = keepout.free_pan_deg(solids, aircraft + back, 0.0)
    here = keepout.free_pan_deg(solids, aircraft, -gimbal_reach().tilt_deg)
    assert there is not None
    assert there <= 15.0
    assert here == gimbal_reach().pan_deg


def test_keepout_notices_a_propeller_in_the_way(
    solids: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keepout, "SOLIDS", ("discs",))
    monkeypatch.setattr(keepout, "PLACES_MM", ())
    # a disc that would just touch a beam looking straight ahead: panned, the beam enters it
    disc_mm = number("frame_propeller_diameter_mm")
    edge = 300.0 * float(np.tan(np.radians(beam_half_angle_deg())))
    x, y, z = solids.face_x + 300.0, edge + disc_mm / 2, solids.pivot[2]
    disc = trimesh.creation.cylinder(disc_mm / 2, segment=([x, y, z - 1.0], [x, y, z + 1.0]))
    blocked = replace(solids, solids={**solids.solids, "discs": disc})
    clear = keepout.beam(blocked)
    assert min(clear["discs"].values()) < 0.0
    shadows = keepout.shadowed(clear)
    assert Aim(0.0, 0.0) in shadows
    assert "**Shadowed** (degrees right, up): " in keepout.report_text(blocked)


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
    solids: Rig, ahead_mm: float, beside_mm: float, wanted_deg: float
) -> None:
    rim = number("sonar_transducer_diameter_mm") / 2
    beside = beside_mm + rim if beside_mm else 0.0
    point = np.array([[solids.face_x + ahead_mm, beside, solids.pivot[2]]])
    assert keepout.off_axis_deg(solids, point, Aim(0.0, 0.0)) == pytest.approx(wanted_deg)


def test_the_beam_turns_with_the_gimbal(solids: Rig) -> None:
    # pan 30 degrees right, tilt 10 up: a point on that line from the pivot is on the axis
    right, up = np.radians(30.0), np.radians(10.0)
    line = np.array([np.cos(up) * np.cos(right), -np.cos(up) * np.sin(right), np.sin(up)])
    point = np.array([solids.pivot]) + 200.0 * line
    assert keepout.off_axis_deg(solids, point, Aim(30.0, 10.0)) == pytest.approx(0.0, abs=1e-6)
    assert keepout.off_axis_deg(solids, point, Aim(-30.0, 10.0)) > 45.0


def test_sampling_leaves_no_gap_for_the_beam() -> None:
    # a plate with corners only far apart; the beam is never narrower than the transducer
    points = sampled(trimesh.creation.box((200.0, 200.0, 2.0)), keepout.SAMPLE_MM)
    probe = np.array([13.0, 29.0, 1.0])
    assert np.linalg.norm(points - probe, axis=1).min() < keepout.SAMPLE_MM
    assert number("sonar_transducer_diameter_mm") > keepout.SAMPLE_MM
