"""The builder's pages lead somewhere."""

import re
from pathlib import Path

import pytest

from hwtools import bom, mount, wiring
from hwtools.facts import HW, lever_arm_mm

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


def test_build_ends_with_the_self_test() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    steps = [text.index(word) for word in ("Carrier board", "First power-up", "rig self-test")]
    assert steps == sorted(steps)


def test_readmes_numbers_are_the_computed_ones() -> None:
    text = " ".join((HW / "README.md").read_text(encoding="utf-8").split())
    masses = [sum(bom.masses_g(board).values()) for board in wiring.BOARDS]
    assert 165 < min(masses) < max(masses) < 205, "README says about 170 to 200 g"
    assert f"{bom.payload_limit_g():.0f} g payload" in text
    assert f"{lever_arm_mm() / 1000:.2f} m ahead of the aircraft's centre" in text


def test_parts_are_told_to_be_printed() -> None:
    text = (HW / "README.md").read_text(encoding="utf-8")
    assert all(f"{part}.stl" in text for part in mount.PARTS)
