"""The builder's pages lead somewhere."""

import math
import re
from pathlib import Path

import pytest

from echowing.sonar_file import load_sonar
from hwtools import bom, motion, mount, servos, wiring
from hwtools.facts import HW, gimbal_reach
from hwtools.rig import Rig

PAGES = sorted(HW.rglob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(HW).as_posix())
def test_links_and_pictures_exist(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    inside = [link for link in links if not link.startswith(("../", "http"))]
    missing = [link for link in inside if not (page.parent / link).exists()]
    assert not missing


def test_every_board_and_harness_is_shown_or_linked() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    for board in wiring.BOARDS:
        assert f"pictures/wiring/{board}/all.svg" in text
    drawn = {name for board in wiring.BOARDS for name in wiring.harnesses(board)} - {"usb"}
    assert all(f"/{name}.svg" in text for name in drawn)


def test_every_view_of_the_mount_is_shown() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^]]*\]\(pictures/mount/(\w+)\.png\)", text)
    assert set(shown) == set(mount.VIEWS)
    assert {path.stem for path in (HW / "pictures" / "mount").iterdir()} == set(mount.VIEWS)


def test_build_ends_with_the_self_test() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    steps = [text.index(word) for word in ("Carrier board", "First power-up", "rig self-test")]
    assert steps == sorted(steps)


def test_readmes_numbers_are_the_computed_ones(solids: Rig) -> None:
    text = " ".join((HW / "README.md").read_text(encoding="utf-8").split())
    masses = [sum(bom.masses_g(board).values()) for board in wiring.BOARDS]
    assert 220 < min(masses) < max(masses) < 260, "README says about 230 to 250 g"
    assert f"{bom.payload_limit_g():.0f} g payload" in text
    ahead_m = mount.number("frame_face_ahead_mm") / 1000
    assert f"{ahead_m:.2f} m ahead of the aircraft's centre" in text
    inset_m = ahead_m + 0.10  # the leader's legs with their foil, around its centre
    assert f"reads {inset_m:.2f} m less than the distance" in text
    pan_deg, boom_m = gimbal_reach().pan_deg, ahead_m - solids.face_x / 1000
    aside_m = inset_m - boom_m * (1.0 - math.cos(math.radians(pan_deg)))
    assert f"{aside_m:.2f} m less at {pan_deg:g} degrees of pan" in text
    file = load_sonar("mb1202-boom")
    assert file.inset_m == pytest.approx((inset_m - 0.05, inset_m + 0.05))
    assert file.boom_m == pytest.approx(boom_m, abs=0.005)
    for lead in ("sonar", "servo"):
        assert f"{mount.number(f'lead_{lead}_free_mm'):g} mm" in text


def test_battery_moves_as_far_as_is_computed(solids: Rig) -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    moved = next(c for c in motion.checks(solids) if c.what.startswith("battery"))
    assert f"about {moved.value:.0f} mm" in text


def test_the_pages_change_the_servos_when_the_table_says_so() -> None:
    hours = servos.life()["change_h"]
    assert f"after {hours:g} hours" in (HW / "README.md").read_text(encoding="utf-8")
    flying = HW.parent / "host_tools" / "FLYING.md"
    assert f"new ones after {hours:g} hours" in flying.read_text(encoding="utf-8")


def test_parts_are_told_to_be_printed() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    assert all(f"{part}.stl" in text for part in mount.PARTS)
