"""What moves touches nothing, over the whole reach, and the reports say by how much."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from echowing.rig import search
from echowing.rig.search import Aim
from hwtools import facts, keepout, lead, made, motion, sweep
from hwtools.facts import Reach, gimbal_reach
from hwtools.mount import number
from hwtools.rig import PANNING, TILTING, Rig, rotation

pytestmark = pytest.mark.seconds(30)  # with its folder


def moved(rig: Rig, name: str, by_mm: tuple[float, float, float]) -> Rig:
    """The rig with one solid out of its place."""
    solid = rig.solids[name].copy()
    solid.apply_translation(by_mm)
    return replace(rig, solids={**rig.solids, name: solid})


def test_every_gap_is_as_wanted_over_the_whole_reach(solids: Rig) -> None:
    gaps = sweep.gaps(solids)
    assert len(gaps) == 8
    assert [gap for gap in gaps if not gap.holds] == []
    # by hand: shelf, ear to the tower's top 10.2 mm; to the yoke 15.7 less the horn's recess 1.4
    seen = {(gap.moving, gap.other): gap.least_mm for gap in gaps}
    assert seen[PANNING, "fixed"] == pytest.approx(15.7 - 1.4 - 10.2, abs=0.05)
    assert seen[TILTING, PANNING] == pytest.approx(number("print_gap_mm"), abs=0.01)


def test_what_is_swept_is_the_firmwares_reach_and_more() -> None:
    reach, swept = gimbal_reach(), sweep.swept_reach()
    assert reach.pan_deg >= 60.0
    assert reach.tilt_deg >= 30.0
    assert swept.pan_deg - reach.pan_deg == number("sweep_beyond_deg") > 0.0


def test_the_reach_is_what_a_board_has_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than the servos turn, in the firmware's table, and the mount's checks fail."""
    normal = {**search.parameter_defaults(), "PAN_REACH": 70.0, "TILT_REACH": 40.0}
    monkeypatch.setattr(search, "parameter_defaults", lambda: normal)
    assert gimbal_reach() == Reach(70.0, 40.0)
    assert sweep.swept_reach() == Reach(75.0, 45.0)
    assert [check.board for check in motion.travel_checks() if not check.holds] == ["pan"]


def test_a_peg_between_two_poses_of_the_search_is_found(solids: Rig) -> None:
    """A needle that only the tilt servo's two outer corners meet, each within a degree of pan."""
    corners = np.asarray(solids.solids[PANNING].vertices)
    farthest = corners[np.argmax(np.linalg.norm(corners[:, :2], axis=1))]
    x, y, z = rotation(Aim(37.0, 0.0)) @ farthest
    peg = trimesh.creation.cylinder(0.05, segment=([x, y, z - 3.0], [x, y, z + 3.0]))
    standing = trimesh.util.concatenate([solids.solids["fixed"], peg])
    assert isinstance(standing, trimesh.Trimesh)
    blocked = replace(solids, solids={**solids.solids, "fixed": standing})
    most = max(abs(aim.right_deg) for aim in keepout.whole_reach() if aim.up_deg == 0.0)
    assert most == gimbal_reach().pan_deg
    scan = Reach(10.0, 10.0)
    assert sweep.solid_gap(blocked, PANNING, "fixed", 0.1, scan).holds
    found = sweep.solid_gap(blocked, PANNING, "fixed", 0.1, sweep.swept_reach())
    assert not found.holds
    beside = 2 * np.degrees(np.arctan2(number("servo_body_width_mm") / 2, abs(farthest[1])))
    assert min(abs(found.at.right_deg - met) for met in (37.0, 37.0 - beside, 37.0 + beside)) < 1.0


def test_a_cradle_that_touches_only_when_it_tilts_is_found(solids: Rig) -> None:
    # the transducer's front edge goes down by some 13 mm at 35 degrees; level it would pass
    low = moved(solids, TILTING, (0.0, 0.0, -6.0))
    level, tilted = Reach(65.0, 0.0), sweep.swept_reach()
    assert sweep.solid_gap(low, TILTING, PANNING, 0.8, level).holds
    assert not sweep.solid_gap(low, TILTING, PANNING, 0.8, tilted).holds


def test_a_gap_a_little_too_narrow_does_not_pass(solids: Rig) -> None:
    wanted = number("print_gap_mm") + 0.02
    gap = sweep.solid_gap(solids, TILTING, PANNING, wanted, sweep.swept_reach())
    assert not gap.holds
    assert gap.least_mm < wanted


def test_a_propeller_too_near_does_not_pass(solids: Rig) -> None:
    # the discs are some 130 mm away; here one stands beside the pan axis
    near = moved(solids, "discs", (150.0, -60.0, 40.0))
    wanted = number("sweep_propeller_gap_mm")
    assert not all(
        sweep.solid_gap(near, name, "discs", wanted, sweep.swept_reach()).holds
        for name in (PANNING, TILTING)
    )


def test_the_leads_touch_nothing_and_bend_gently(solids: Rig) -> None:
    gaps = sweep.lead_gaps(solids)
    assert len(gaps) == 7
    assert [gap for gap in gaps if not gap.holds] == []
    assert min(sweep.bends(solids).values()) >= number("lead_bend_least_mm")


def test_a_lead_in_the_way_is_found(solids: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    # the clamp 6 mm higher reaches into the loops, at the first few poses and at most others
    poses = sweep.lead_poses()
    monkeypatch.setattr(sweep, "lead_poses", lambda: poses[:8])
    blocked = moved(solids, "fixed", (0.0, 0.0, 6.0))
    assert any(not gap.holds for gap in sweep.lead_gaps(blocked))


def test_a_lead_keeps_its_length_and_its_ends(solids: Rig) -> None:
    for one in sweep.leads(solids.measures):
        for aim in (Aim(0.0, 0.0), Aim(65.0, 35.0), Aim(-65.0, -35.0)):
            points = lead.curve(one, aim)
            length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
            assert length == pytest.approx(one.free_mm, rel=0.003)
            assert points[-1] == pytest.approx(one.tie)
            up = Aim(aim.right_deg, aim.up_deg if one.tilts else 0.0)
            start = rotation(up) @ (one.start - one.pivot) + one.pivot
            assert points[0] == pytest.approx(start)


def test_a_lead_bends_as_an_elastic_rod_does() -> None:
    """Ends parallel, and between them the length of half a circle: half a circle it is."""
    radius = 20.0
    piece = np.pi * radius / (lead.PIECES - 2)  # the first and the last are held straight
    bow = lead.Lead(
        "bow",
        start=np.array([0.0, 0.0, 2 * radius]),
        tie=np.array([0.0, 0.0, 0.0]),
        pivot=np.array([0.0, 0.0, 2 * radius]),
        tilts=True,
        diameter_mm=2.0,
        free_mm=float(piece * lead.PIECES),
    )
    points = lead.curve(bow, Aim(0.0, 0.0))
    away = np.linalg.norm(points[1:-1] - np.array([-piece, 0.0, radius]), axis=1)
    assert away == pytest.approx(radius, rel=0.05)
    assert lead.bend_radius_mm(points) == pytest.approx(radius, rel=0.1)


def test_a_lead_that_is_too_short_is_named(solids: Rig) -> None:
    short = replace(sweep.leads(solids.measures)[0], free_mm=40.0)
    with pytest.raises(facts.HardwareError, match="sonar's lead is too short"):
        lead.curve(short, Aim(0.0, 0.0))


@pytest.mark.parametrize("path", made.REPORTS, ids=made.name_of)
def test_report_of_the_solids_is_current(path: Path, solids: Rig) -> None:
    """Here, as most of what it tells is worked out for the tests above."""
    assert path.read_text(encoding="utf-8") == made.REPORTS[path](solids), "run `make hw`, commit"
