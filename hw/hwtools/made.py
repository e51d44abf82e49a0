"""What is made, from what, and whether the committed files are current.

Texts (reports, bills of materials, the OpenSCAD include) are compared as they are. Pictures and STL
files differ in bytes from one version of Graphviz, Mesa or CGAL to the next, so `made.json` keeps
the hash of what each was made from; when a source changes, the hash no longer fits.
"""

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from echowing.rig.search import Aim
from hwtools import bom, budget, coverage, keepout, lead, motion, mount, sheet, sweep, wiring
from hwtools.facts import HW, MOUNT, PICTURES, read
from hwtools.lead import curve
from hwtools.rig import load_rig

RECORD = HW / "made.json"
# The reports that are computed from the solids.
REPORTS = {MOUNT / "KEEPOUT.md": keepout.report_text, motion.REPORT: motion.report_text}
COVERAGE_PLOT = PICTURES / "coverage.svg"


@dataclass(frozen=True, slots=True)
class Text:
    """A made text: where it goes, and how to get it."""

    path: Path
    content: Callable[[], str]


@dataclass(frozen=True, slots=True)
class Made:
    """A made picture or solid: where it goes, the text that determines it, how to make it."""

    path: Path
    inputs: Callable[[], str]
    make: Callable[[Path], None]


def texts() -> list[Text]:
    """Return the made texts that need no external program."""
    return [
        Text(mount.SCAD_PARAMETERS, mount.scad_parameters_text),
        Text(budget.REPORT, budget.report_text),
        Text(bom.REPORT, bom.report_text),
        *(
            Text(wiring.outputs(board, name)["bom"], partial(_wiring_bom, board, name))
            for board, name in wiring.sheet_names()
        ),
        *(
            Text(wiring.outputs(board, wiring.OVERVIEW)["svg"], partial(sheet.svg_text, board))
            for board in wiring.BOARDS
        ),
    ]


def drawings() -> Iterator[Made]:
    """Yield the wiring diagrams."""
    for board, name in wiring.sheet_names():
        paths = wiring.outputs(board, name)
        inputs = partial(_wiring_graph, board, name)
        if name == wiring.OVERVIEW:
            yield Made(paths["png"], inputs, partial(_write_png, board, name))
        else:
            yield Made(paths["svg"], inputs, partial(_write_svg, board, name))


def solids() -> Iterator[Made]:
    """Yield the printed parts."""
    for part in mount.PARTS:
        yield Made(
            mount.stl_path(part), partial(_solid_inputs, part), partial(mount.export_stl, part)
        )


def views() -> Iterator[Made]:
    """Yield the pictures of the mount."""
    for view in mount.VIEWS:
        path = PICTURES / "mount" / f"{view}.png"
        yield Made(path, partial(_view_inputs, view), partial(render, view))


def plots() -> Iterator[Made]:
    """Yield the plots."""
    yield Made(COVERAGE_PLOT, coverage.inputs_text, coverage.draw)


def everything() -> list[Made]:
    """Return all that `made.json` records."""
    return [*drawings(), *solids(), *views(), *plots()]


def render(view: str, path: Path) -> None:
    """Draw one of the mount's views, the leads as they run at its pose."""
    seen = mount.VIEWS[view]
    aim = Aim(0.0 - seen.left_deg, seen.up_deg)
    with tempfile.TemporaryDirectory() as folder:
        measures = mount.derived(Path(folder))
    mount.render(view, path, [curve(one, aim) for one in sweep.leads(measures)])


def digest(made: Made) -> str:
    """Return the hash of what a picture or solid is made from."""
    return hashlib.sha256(made.inputs().encode()).hexdigest()


def name_of(path: Path) -> str:
    """Return a made file's name in `made.json`: its path from `hw/`."""
    return path.relative_to(HW).as_posix()


def record() -> dict[str, str]:
    """Return `made.json`: the hash of the inputs each file was made from."""
    return dict(json.loads(read(RECORD)))


def write_record() -> None:
    """Write `made.json` for the sources as they are now."""
    hashes = {name_of(made.path): digest(made) for made in everything()}
    _write(RECORD, json.dumps(hashes, indent=1, sort_keys=True) + "\n")


def make_everything(folder: Path, tell: Callable[[str], None]) -> None:
    """Make all there is; `folder` takes what is only passing through."""
    _write(mount.SCAD_PARAMETERS, mount.scad_parameters_text())  # OpenSCAD reads it
    for made in everything():
        tell(name_of(made.path))
        made.path.parent.mkdir(parents=True, exist_ok=True)
        made.make(made.path)
    for text in texts():
        tell(name_of(text.path))
        _write(text.path, text.content())
    rig = load_rig(folder)
    for path, report_text in REPORTS.items():
        tell(name_of(path))
        _write(path, report_text(rig))
    write_record()


def _wiring_graph(board: str, name: str) -> str:
    return wiring.graph_text(wiring.draw(board, name))


def _wiring_bom(board: str, name: str) -> str:
    return wiring.bom_text(wiring.draw(board, name))


def _write_svg(board: str, name: str, path: Path) -> None:
    _write(path, wiring.svg_text(wiring.draw(board, name)))


def _write_png(board: str, name: str, path: Path) -> None:
    path.write_bytes(wiring.draw(board, name).png)


def _solid_inputs(part: str) -> str:
    return part + read(mount.SCAD) + mount.scad_parameters_text()


def _view_inputs(view: str) -> str:
    seen = f"{mount.VIEWS[view]}{mount.IMAGE_SIZE}"
    return seen + read(mount.SCAD) + mount.scad_parameters_text() + read(Path(lead.__file__))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
