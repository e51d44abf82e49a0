"""The gimbal mount: parameters for OpenSCAD, STL files and pictures."""

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from hwtools.facts import (
    MOUNT,
    HardwareError,
    beam_half_angle_deg,
    lever_arm_mm,
    load,
    scan_aims,
)

PARTS = ("base", "cap", "yoke", "cradle")
SCAD = MOUNT / "mount.scad"
SCAD_PARAMETERS = MOUNT / "parameters.scad"
PARAMETERS = MOUNT / "parameters.toml"

# name: (what mount.scad is told, camera: centre x y z, angles x y z, distance; projection;
# the arrow that points forward: x y z, length, how far along it the word stands)
VIEWS: dict[str, tuple[str, str, str, str]] = {
    "assembly": ("assembly", "-12,0,26,68,0,128,290", "p", "8,-40,-6,28,0.3"),
    "assembly_back": ("assembly", "-25,0,26,62,0,-40,290", "p", "20,0,-45,55,0.8"),
    "printed_parts": ("plate", "10,-8,5,50,0,-32,320", "p", ""),
    "keepout": ("keepout", "130,0,30,72,0,130,1350", "p", "50,150,-150,170,0.3"),
    "vehicle_top": ("vehicle", "-15,0,0,0,0,90,1900", "o", "-330,0,0,120,0"),
    "vehicle_side": ("vehicle", "-15,0,-50,90,0,180,1700", "o", "120,-330,-260,260,0.5"),
}
IMAGE_SIZE = "1200,900"


def parameters() -> dict[str, float | list[float]]:
    """Return the mount's parameters by their flat name, `[servo] fit_mm` as `servo_fit_mm`."""
    return {
        f"{table}_{name}": value
        for table, values in load(PARAMETERS).items()
        for name, value in values.items()
    }


def scad_parameters_text() -> str:
    """Return the OpenSCAD include: the parameters and what other rooms own."""
    # OpenSCAD turns left and tilts up positive; the firmware's pan grows to the right
    points = ", ".join(f"[{0.0 - aim.right_deg:g}, {aim.up_deg:g}]" for aim in scan_aims())
    lines = [
        "// Written by `make hw` from parameters.toml, the firmware's scan and the simulator's",
        "// sonar. Do not edit.",
        *(f"{name} = {_scad(value)};" for name, value in parameters().items()),
        f"beam_half_angle_deg = {beam_half_angle_deg():g};",
        f"lever_arm_mm = {lever_arm_mm():g};",
        f"scan_points_deg = [{points}]; // left, up",
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


def render(view: str, path: Path) -> None:
    """Have OpenSCAD draw one of VIEWS as PNG, on a virtual display where there is no other.

    Raises:
        HardwareError: OpenSCAD or xvfb-run is missing or fails.

    """
    part, camera, projection, arrow = VIEWS[view]
    angles = ",".join(camera.split(",")[3:6])
    forward = [f"-Darrow=[{arrow}]", f"-Dlook_deg=[{angles}]"] if arrow else []
    look = ["--camera", camera, "--imgsize", IMAGE_SIZE, "--colorscheme", "Tomorrow"]
    display = [] if os.environ.get("DISPLAY") else ["xvfb-run", "-a"]
    _openscad(path, part, [*forward, *look, "--projection", projection], display)


def derived(folder: Path) -> dict[str, float]:
    """Return the measures mount.scad derives: yoke_bottom, tilt_z, face_x, millimetres."""
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
