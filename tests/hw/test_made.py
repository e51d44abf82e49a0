"""The committed files are the ones their sources make.

Texts are compared as they are, labels of the drawings and volumes of the solids with fresh ones.
Rendered pixels depend on the versions of Graphviz and Mesa, so for pictures `made.json` keeps the
hash of their inputs: it fails as soon as a source changes and the pictures do not follow.
"""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from PIL import Image

from hwtools import made, mount, wiring
from hwtools.facts import HW, MOUNT, PICTURES
from hwtools.rig import read_stl

pytestmark = pytest.mark.seconds(15)  # with its folder


def label_of(item: made.Made | made.Text) -> str:
    return made.name_of(item.path)


@pytest.mark.parametrize("text", made.texts(), ids=label_of)
def test_text_is_current(text: made.Text) -> None:
    assert text.path.read_text(encoding="utf-8") == text.content(), "run `make hw`, commit"


@pytest.mark.parametrize("item", made.everything(), ids=label_of)
def test_picture_was_made_from_the_sources_as_they_are(item: made.Made) -> None:
    assert item.path.stat().st_size > 0
    assert made.record()[made.name_of(item.path)] == made.digest(item), "run `make hw`, commit"


def test_record_and_folders_hold_nothing_stale() -> None:
    items = made.everything()
    assert set(made.record()) == {made.name_of(item.path) for item in items}
    known = {item.path for item in items} | {text.path for text in made.texts()}
    found = {p for folder in (PICTURES, MOUNT / "stl") for p in folder.rglob("*") if p.is_file()}
    assert found <= known


def svg_labels(svg: str) -> list[str]:
    root = ElementTree.fromstring(svg)
    return sorted(node.text or "" for node in root.iter("{http://www.w3.org/2000/svg}text"))


@pytest.mark.parametrize("board", wiring.BOARDS)
def test_drawings_say_what_fresh_ones_say(board: str) -> None:
    for name in wiring.harnesses(board):
        committed = wiring.outputs(board, name)["svg"].read_text(encoding="utf-8")
        assert svg_labels(committed) == svg_labels(wiring.svg_text(wiring.draw(board, name)))


@pytest.mark.parametrize("part", mount.PARTS)
def test_committed_solid_is_the_fresh_one(part: str, fresh_parts: dict[str, Path]) -> None:
    committed = read_stl(mount.stl_path(part))
    fresh = read_stl(fresh_parts[part])
    assert committed.volume == pytest.approx(fresh.volume, rel=1e-4)
    assert committed.bounds.ravel() == pytest.approx(fresh.bounds.ravel(), abs=1e-3)


def test_a_changed_source_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    item = next(item for item in made.solids() if item.path.stem == "base")
    before = made.digest(item)
    changed = mount.scad_parameters_text().replace("clamp_length_mm = 30", "clamp_length_mm = 31")
    monkeypatch.setattr(mount, "scad_parameters_text", lambda: changed)
    assert made.digest(item) != before


def test_mount_can_be_rendered_here(tmp_path: Path) -> None:
    picture = tmp_path / "assembly.png"
    made.render("assembly", picture)
    with Image.open(picture) as image:
        colours = image.convert("RGB").getcolors(maxcolors=1 << 24)
    assert len(colours or []) > 20, "an empty scene has one colour"


def test_every_made_path_lies_in_the_room() -> None:
    assert all(item.path.is_relative_to(HW) for item in made.everything())
