"""Wiring diagrams: a board's pins and a harness's wires, put together and drawn by WireViz.

A board file names the harnesses it needs; a harness file names pins by their role (SDA, PAN ...).
So four boards and eleven harnesses are fifteen sources, not twenty-eight copies.
"""

import contextlib
import copy
import io
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from wireviz.Harness import Harness  # type: ignore[import-untyped]
from wireviz.wireviz import parse  # type: ignore[import-untyped]
from wireviz.wv_bom import bom_list  # type: ignore[import-untyped]
from wireviz.wv_helper import tuplelist2tsv  # type: ignore[import-untyped]

from hwtools.facts import PICTURES, WIRING, HardwareError

Sheet = dict[str, Any]

OVERVIEW = "all"  # the drawing with every harness of a board

BOARDS = tuple(sorted(path.stem for path in (WIRING / "boards").glob("*.yml")))


def read_sheet(path: Path) -> Sheet:
    """Read one YAML source.

    Raises:
        HardwareError: the file is missing or is not a YAML mapping.

    """
    try:
        # What is given away may be changed.
        sheet = copy.deepcopy(_parsed_yaml(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise HardwareError(f"{path} cannot be read ({error.strerror})") from error
    except yaml.YAMLError as error:
        raise HardwareError(f"{path} is not YAML: {error}") from error
    if not isinstance(sheet, dict):
        raise HardwareError(f"{path}: a mapping of connectors, cables, connections is expected")
    return sheet


@cache
def _parsed_yaml(text: str) -> Any:
    """The same few sources are read hundreds of times, and parsing one takes long."""
    return yaml.safe_load(text)


def board_sheet(board: str) -> Sheet:
    """Return the source of one board by its name (`mega`, `blackpill_f411` ...)."""
    return read_sheet(WIRING / "boards" / f"{board}.yml")


def board_pins(board: str) -> dict[str, str]:
    """Return the board's pins by role, as its WireViz source has them: {"SDA": "20", ...}."""
    connector = board_sheet(board)["connectors"]["BOARD"]
    return {str(role): str(pin) for role, pin in zip(*_labelled(connector), strict=True)}


def harnesses(board: str) -> list[str]:
    """Return the names of the harnesses the board needs."""
    return list(board_sheet(board)["metadata"]["harnesses"])


def sheet_names() -> list[tuple[str, str]]:
    """Return every drawing as (board, harness), each board's OVERVIEW first."""
    return [(board, name) for board in BOARDS for name in (OVERVIEW, *harnesses(board))]


def compose(board: str, harness: str) -> Sheet:
    """Put a board and one harness (or its OVERVIEW) together into one WireViz input."""
    names = harnesses(board) if harness == OVERVIEW else [harness]
    parts = [read_sheet(WIRING / "harness" / f"{name}.yml") for name in names]
    shared = read_sheet(WIRING / "parts.yml")
    title = "everything" if harness == OVERVIEW else parts[0]["metadata"]["title"]
    sheet: Sheet = {
        "metadata": {"title": f"{board_sheet(board)['metadata']['title']}: {title}"},
        "options": {"mini_bom_mode": False},
        "connectors": {},
        "cables": {},
        "connections": [],
    }
    for source in (shared, board_sheet(board), *parts):
        sheet["connectors"].update(copy.deepcopy(source.get("connectors", {})))
        sheet["cables"].update(copy.deepcopy(source.get("cables", {})))
        sheet["connections"] += copy.deepcopy(source.get("connections", []))
    return _only_used(sheet)


def draw(board: str, harness: str) -> Harness:
    """Have WireViz read one composed sheet; its `svg`, `png` and `bom()` are then to be had."""
    sheet = compose(board, harness)
    told = io.StringIO()
    with contextlib.redirect_stdout(told):  # WireViz warns on stdout
        made = _parsed(sheet, f"wiring {board}, {harness}")
    if told.getvalue():
        raise HardwareError(f"wiring {board}, {harness}: {told.getvalue().strip()}")
    return made


def graph_text(harness: Harness) -> str:
    """Return the Graphviz source of a diagram: its whole content, the same on every machine."""
    return str(harness.graph.source)


def svg_text(harness: Harness) -> str:
    """Return the diagram as SVG, its text a little smaller than the boxes were laid out for.

    Graphviz fits the boxes to its own measure of Arial; what a browser puts in its place often runs
    a few percent wider and would touch the frames.
    """
    return str(harness.svg).replace('font-size="14.00"', 'font-size="13.00"')


def bom_text(harness: Harness) -> str:
    """Return the diagram's bill of materials as tab-separated text."""
    return str(tuplelist2tsv(bom_list(harness.bom()))).replace("\r\n", "\n")


def outputs(board: str, harness: str) -> dict[str, Path]:
    """Return where a drawing's files go, by kind (`svg`, `png`, `bom`)."""
    stem = PICTURES / "wiring" / board / harness
    return {
        "svg": stem.with_suffix(".svg"),
        "png": stem.with_suffix(".png"),
        "bom": stem.with_suffix(".bom.tsv"),
    }


def _parsed(sheet: Sheet, where: str) -> Harness:
    try:
        return parse(sheet, return_types="harness")
    except Exception as error:  # WireViz raises nothing more precise
        raise HardwareError(f"{where}: {error}") from error


def _labelled(connector: Sheet) -> tuple[list[Any], list[Any]]:
    labels = connector["pinlabels"]
    return labels, connector.get("pins", list(range(1, len(labels) + 1)))


def _only_used(sheet: Sheet) -> Sheet:
    used = {
        name
        for connection in sheet["connections"]
        for entry in connection
        for name in (entry if isinstance(entry, dict) else [entry])
    }
    for kind in ("connectors", "cables"):
        sheet[kind] = {name: part for name, part in sheet[kind].items() if name in used}
    return sheet
