"""The swept volume: what moves touches nothing, over the whole reach and a little beyond.

Looking at many poses would leave the poses between them open. Here each look covers a cell of
poses: from its middle no point of a solid moves farther than its radius times the cell's half
width, so a gap that is wider than that and the gap wanted holds in the whole cell. Else the cell is
cut in two.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh, OpType  # type: ignore[import-not-found]

from echowing.rig.search import Aim
from hwtools import mount
from hwtools.facts import Reach, gimbal_reach
from hwtools.lead import Lead, bend_radius_mm, curve
from hwtools.rig import PANNING, TILTING, Points, Rig

# Gaps that are wider than wanted by more than this are not told apart: looking far takes long.
LOOK_MM = 100.0
LOOK_NEAR_MM = 5.0
LOOK_LEAD_MM = 10.0
LEAST_CELL_DEG = 0.05  # a cell so small that fails would fail however small
LEAD_STEP_DEG = 10.0  # at every 2.5 degrees the least gaps are the same to 0.2 mm
# Pieces of a lead (of 24) at its ends that lie against what holds them.
HELD_PIECES = 4


@dataclass(frozen=True, slots=True)
class Gap:
    """The narrowest gap that was seen between two things, where, and what was wanted there.

    look_mm: as far as was looked; a gap of that is that or more.
    """

    moving: str
    other: str
    least_mm: float
    at: Aim
    wanted_mm: float
    look_mm: float

    @property
    def holds(self) -> bool:
        """Whether the gap is as wanted at every pose."""
        return self.least_mm >= self.wanted_mm

    @property
    def told(self) -> str:
        """The gap for a reader."""
        return f"{self.least_mm:.1f}" if self.least_mm < self.look_mm else f"over {self.look_mm:g}"


@dataclass(frozen=True, slots=True)
class Cell:
    """Poses within `half` degrees of the middle, right and up."""

    middle: Aim
    half: Aim

    def parts(self, pan: bool) -> Iterator["Cell"]:
        """Yield its two halves, cut across pan or across tilt."""
        half = Aim(self.half.right_deg / 2, self.half.up_deg) if pan else self.half
        half = half if pan else Aim(self.half.right_deg, self.half.up_deg / 2)
        for side in (-1.0, 1.0):
            right = self.middle.right_deg + (side * half.right_deg if pan else 0.0)
            up = self.middle.up_deg + (0.0 if pan else side * half.up_deg)
            yield Cell(Aim(right, up), half)


@cache
def gaps(rig: Rig) -> list[Gap]:
    """Return the gaps between the solids, proved over the reach and `beyond_deg`."""
    number = mount.number
    most = swept_reach()
    narrow, plain = number("sweep_cradle_gap_mm"), number("sweep_mount_gap_mm")
    wide, far = number("sweep_aircraft_gap_mm"), number("sweep_propeller_gap_mm")
    pairs = (
        (TILTING, PANNING, narrow),
        (PANNING, "fixed", plain),
        (TILTING, "fixed", plain),
        (PANNING, "frame", wide),
        (TILTING, "frame", wide),
        (PANNING, "discs", far),
        (TILTING, "discs", far),
        ("fixed", "discs", far),
    )
    return [solid_gap(rig, moving, other, wanted, most) for moving, other, wanted in pairs]


def swept_reach() -> Reach:
    """Return how far the mount must be free: the firmware's reach and `beyond_deg`."""
    reach, beyond = gimbal_reach(), mount.number("sweep_beyond_deg")
    return Reach(reach.pan_deg + beyond, reach.tilt_deg + beyond)


def solid_gap(rig: Rig, moving: str, other: str, wanted_mm: float, most: Reach) -> Gap:
    """Return the gap between two solids of the rig, at every pose within `most`."""
    tilts, pans = moving == TILTING, moving != "fixed" and other not in (PANNING, TILTING)
    whole = Aim(most.pan_deg if pans else 0.0, most.tilt_deg if tilts else 0.0)
    from_pivot = np.asarray(rig.solids[moving].vertices) - rig.pivot
    radius = Aim(_farthest(from_pivot if tilts else from_pivot[:, :2]), _farthest(from_pivot))
    look_mm = wanted_mm + (LOOK_NEAR_MM if other in (PANNING, "fixed") else LOOK_MM)
    bodies = solid(rig.solids[moving]), solid(rig.solids[other])

    def seen(aim: Aim) -> float:
        return float(bodies[0].transform(rig.motion(moving, aim)).min_gap(bodies[1], look_mm))

    least_mm, at = _proved(seen, Cell(Aim(0.0, 0.0), whole), radius, wanted_mm)
    return Gap(moving, other, least_mm, at, wanted_mm, look_mm)


def _proved(
    gap_at: Callable[[Aim], float], whole: Cell, radius: Aim, wanted_mm: float
) -> tuple[float, Aim]:
    """Return the least gap seen while every cell is proved, and where; at once if one fails."""
    least = (math.inf, whole.middle)
    cells = [whole]
    while cells:
        cell = cells.pop()
        gap_mm = gap_at(cell.middle)
        least = min(least, (gap_mm, cell.middle), key=lambda seen: seen[0])
        by_pan = np.radians(cell.half.right_deg) * radius.right_deg
        by_tilt = np.radians(cell.half.up_deg) * radius.up_deg
        if gap_mm - by_pan - by_tilt >= wanted_mm:
            continue
        if gap_mm < wanted_mm or max(cell.half.right_deg, cell.half.up_deg) < LEAST_CELL_DEG:
            return min(gap_mm, np.nextafter(wanted_mm, 0.0)), cell.middle
        cells += cell.parts(pan=by_pan > by_tilt)
    return least


def _farthest(points: Points) -> float:
    return float(np.linalg.norm(points, axis=1).max())


def solid(mesh: trimesh.Trimesh) -> Manifold:
    """Return a mesh as a manifold."""
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    return Manifold(Mesh(vertices, faces))


def leads(at: Mapping[str, float]) -> list[Lead]:
    """Return the moving pieces of the sonar's lead and of the tilt servo's.

    at: the measures that mount.scad derives.
    """
    number, pivot = mount.number, np.array([0.0, 0.0, at["tilt_z"]])
    sonar_mm, servo_mm = number("lead_sonar_diameter_mm"), number("lead_servo_diameter_mm")
    plate_top, clamp_top = at["yoke_bottom"] + number("print_wall_mm"), at["shelf_top"]
    tie_x = number("lead_tie_x_mm")
    return [
        Lead(
            "sonar's lead",
            start=np.array([at["plate_back"], 0.0, at["tilt_z"]]),
            tie=np.array([tie_x, 0.0, clamp_top + sonar_mm / 2]),
            pivot=pivot,
            tilts=True,
            diameter_mm=sonar_mm,
            free_mm=number("lead_sonar_free_mm"),
        ),
        Lead(
            "servo's lead",
            start=np.array([at["yoke_back"], 0.0, plate_top + servo_mm / 2]),
            tie=np.array([tie_x, 0.0, clamp_top + sonar_mm + servo_mm / 2]),
            pivot=pivot,
            tilts=False,
            diameter_mm=servo_mm,
            free_mm=number("lead_servo_free_mm"),
        ),
    ]


def lead_poses() -> list[Aim]:
    """Return the poses at which the leads are looked at, to the ends of what is swept."""
    most = swept_reach()
    pans = np.linspace(-most.pan_deg, most.pan_deg, 1 + round(2 * most.pan_deg / LEAD_STEP_DEG))
    tilts = np.linspace(-most.tilt_deg, most.tilt_deg, 1 + round(2 * most.tilt_deg / LEAD_STEP_DEG))
    return [Aim(float(pan), float(tilt)) for pan in pans for tilt in tilts]


@cache
def lead_gaps(rig: Rig) -> list[Gap]:
    """Return the gaps between the leads and all else, and between the two of them."""
    both = sonar, servo = leads(rig.measures)
    wanted, soft = mount.number("sweep_mount_gap_mm"), mount.number("sweep_leads_gap_mm")
    bodies = {name: solid(rig.solids[name]) for name in ("fixed", PANNING, TILTING)}
    found: dict[tuple[str, str], Gap] = {}
    for aim in lead_poses():
        tubes = [_tube(curve(lead, aim), lead) for lead in both]
        others = {name: body.transform(rig.motion(name, aim)) for name, body in bodies.items()}
        for lead, tube in zip(both, tubes, strict=True):
            for name, other in others.items():
                _keep(found, Gap(lead.name, name, _gap_mm(tube, other), aim, wanted, LOOK_LEAD_MM))
        _keep(found, Gap(sonar.name, servo.name, _gap_mm(*tubes), aim, soft, LOOK_LEAD_MM))
    return list(found.values())


@cache
def bends(rig: Rig) -> dict[str, float]:
    """Return each lead's sharpest bend over what is swept: radius, millimetres."""
    return {
        lead.name: min(bend_radius_mm(curve(lead, aim)) for aim in lead_poses())
        for lead in leads(rig.measures)
    }


def _gap_mm(one: Manifold, other: Manifold) -> float:
    return float(one.min_gap(other, LOOK_LEAD_MM))


def _tube(points: Points, lead: Lead) -> Manifold:
    """Return the lead as a solid, without what lies against its holders."""
    free = points[HELD_PIECES:-HELD_PIECES]
    balls = [Manifold.sphere(lead.diameter_mm / 2, 8).translate(tuple(p)) for p in free]
    pieces = [Manifold.batch_hull(list(pair)) for pair in pairwise(balls)]
    return Manifold.batch_boolean(pieces, OpType.Add)


def _keep(found: dict[tuple[str, str], Gap], gap: Gap) -> None:
    key = gap.moving, gap.other
    found[key] = min(found.get(key, gap), gap, key=lambda one: one.least_mm)
