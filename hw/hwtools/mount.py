"""The gimbal mount: parameters for OpenSCAD, STL files and pictures."""

import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hwtools.facts import (
    MOUNT,
    HardwareError,
    beam_half_angle_deg,
    gimbal_reach,
    load,
    scan_aims,
)

PARTS = ("base", "cap", "yoke", "cradle")
SCAD = MOUNT / "mount.scad"
SCAD_PARAMETERS = MOUNT / "parameters.scad"
PARAMETERS = MOUNT / "parameters.toml"


@dataclass(frozen=True, slots=True)
class View:
    """A picture: what mount.scad is told, and from where it is looked at.

    camera: centre x y z, angles x y z, distance. arrow: the one that points forward: x y z, length,
    how far along it the word stands. aim: where the gimbal looks, OpenSCAD's way: left, up.
    """

    part: str
    camera: str
    projection: str = "p"
    arrow: str = ""
    left_deg: float = 0.0
    up_deg: float = 0.0


VIEWS = {
    "assembly": View("assembly", "-16,0,28,68,0,128,330", arrow="8,-45,-6,28,0.3"),
    "assembly_back": View("assembly", "-30,0,26,62,0,-40,330", arrow="20,0,-45,55,0.8"),
    "reach": View(
        "assembly", "-22,0,26,50,0,150,340", arrow="36,-25,-10,28,0.5", left_deg=60.0, up_deg=-30.0
    ),
    "printed_parts": View("plate", "10,-8,5,50,0,-32,330"),
    "vehicle_top": View("vehicle", "-150,0,0,0,0,90,2700", "o", "70,500,0,150,0"),
    "vehicle_side": View("vehicle", "-140,0,-40,90,0,180,2000", "o", "150,-330,-360,200,0.5"),
}
IMAGE_SIZE = "1200,900"


@cache
def parameters() -> dict[str, float | list[float]]:
    """Return the mount's parameters by their flat name, `[servo] fit_mm` as `servo_fit_mm`."""
    return {
        f"{table}_{name}": value
        for table, values in load(PARAMETERS).items()
        for name, value in values.items()
    }


def number(name: str) -> float:
    """Return one parameter by its flat name."""
    value = parameters()[name]
    assert isinstance(value, float)
    return value


def scad_parameters_text() -> str:
    """Return the OpenSCAD include: the parameters and what other rooms own."""
    # OpenSCAD turns left and tilts up positive; the firmware's pan grows to the right
    points = ", ".join(f"[{0.0 - aim.right_deg:g}, {aim.up_deg:g}]" for aim in scan_aims())
    reach = gimbal_reach()
    ends = ", ".join(
        f"[{side * reach.pan_deg:g}, {way * reach.tilt_deg:g}]"
        for side in (1, -1)
        for way in (1, -1)
    )
    lines = [
        "// Written by `make hw` from parameters.toml, the firmware's scan and reach and the",
        "// simulator's sonar. Do not edit.",
        *(f"{name} = {_scad(value)};" for name, value in parameters().items()),
        f"beam_half_angle_deg = {beam_half_angle_deg():g};",
        f"scan_points_deg = [{points}]; // left, up",
        f"reach_ends_deg = [{ends}];",
    ]
    return "\n".join(lines) + "\n"


def stl_path(part: str) -> Path:
    """Return where a printed part's STL goes."""
    return MOUNT / "stl" / f"{part}.stl"


def export_stl(part: str, path: Path, **changed: float) -> None:
    """Have OpenSCAD write one `part` of mount.scad as STL, some parameters changed by name.

    Raises:
        HardwareError: OpenSCAD is missing or fails.

    """
    _openscad(path, part, [f"-D{name}={value:g}" for name, value in changed.items()])
    path.write_text(_in_order(path.read_text(encoding="utf-8")), encoding="utf-8")


def render(view: str, path: Path, leads: Sequence[NDArray[np.float64]] = ()) -> None:
    """Have OpenSCAD draw one of VIEWS as PNG, on a virtual display where there is no other.

    leads: the points of the sonar's lead and of the servo's, at the view's pose.

    Raises:
        HardwareError: OpenSCAD or xvfb-run is missing or fails.

    """
    seen = VIEWS[view]
    told = [f"-Dpan_deg={seen.left_deg:g}", f"-Dtilt_deg={seen.up_deg:g}"]
    if leads:
        told.append(f"-Dleads_mm={np.round(np.array(leads), 2).tolist()}")
    if seen.arrow:
        angles = ",".join(seen.camera.split(",")[3:6])
        told += [f"-Darrow=[{seen.arrow}]", f"-Dlook_deg=[{angles}]"]
    look = ["--camera", seen.camera, "--imgsize", IMAGE_SIZE, "--colorscheme", "Tomorrow"]
    display = [] if os.environ.get("DISPLAY") else ["xvfb-run", "-a"]
    _openscad(path, seen.part, [*told, *look, "--projection", seen.projection], display)


def derived(folder: Path) -> dict[str, float]:
    """Return the measures mount.scad derives, by name, millimetres."""
    path = folder / "derived.echo"
    _openscad(path, "none")
    return {
        name: float(value)
        for name, value in re.findall(r"(\w+) = ([-\d.]+)", path.read_text(encoding="utf-8"))
    }


def _openscad(path: Path, part: str, more: Sequence[str] = (), first: Sequence[str] = ()) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    command = [*first, "openscad", *more, "-D", f'part="{part}"', "-o", str(path), str(SCAD)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise HardwareError(f"{command[0]} is missing: install openscad, xvfb, xauth") from error
    if done.returncode != 0:
        raise HardwareError(f"openscad, part {part}: {done.stderr.strip()[-500:]}")


def _in_order(stl: str) -> str:
    """Sort an ASCII STL's facets and turn each to its least corner: CGAL's order is never twice."""
    first, *_, last = stl.splitlines()
    facets = []
    for facet in re.findall(r"^  facet.*?endfacet$", stl, re.DOTALL | re.MULTILINE):
        normal, loop, *corners, endloop, endfacet = facet.splitlines()
        least = corners.index(min(corners))
        turned = corners[least:] + corners[:least]
        facets.append("\n".join([normal, loop, *turned, endloop, endfacet]))
    return "\n".join([first, *sorted(facets), last]) + "\n"


def _scad(value: float | list[float]) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(f"{item:g}" for item in value) + "]"
    return f"{value:g}"
