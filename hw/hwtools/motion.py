"""What the gimbal can do: reach, gaps over it, torque, speed, the boom that carries it, wear."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from echowing.geo import GRAVITY_MPS2
from echowing.rig import search
from hwtools import bom, mount, servos, sweep
from hwtools.budget import Check, check_table
from hwtools.facts import MOUNT, gimbal_reach
from hwtools.figures import Figures, figures
from hwtools.rig import Point, Rig

REPORT = MOUNT / "MOTION.md"
# The firmware lets no pulse leave these, whatever it is told.
PULSES_US = (800.0, 2200.0)
MIDDLE_US = 1500.0  # where a servo's travel has its middle
SCREWS_G = 1.5  # each: M3 with nut; two of the sonar, one of the pivot
HORNS_G = 0.5
BOLTS_G = 4 * 2.0 + 3 * SCREWS_G  # the clamp's as well
TORQUE_MARGIN = 3.0  # friction, cold grease, a servo that is worse than its sheet
BOOM_MARGIN = 1.25  # a beam that rings within a fifth of what shakes it swings several times as far
BATTERY_ROOM_MM = 50.0  # what the plates give; assumed


@dataclass(frozen=True, slots=True)
class Load:
    """What a servo turns: moment of inertia, and its mass times its centre's distance."""

    axis: str
    inertia_kg_m2: float
    unbalance_kg_m: float
    lead_nm: float

    def torque_nm(self, duty: dict[str, Any]) -> float:
        """The most torque: taking up speed, a manoeuvre's pull and the leads, all against it."""
        start = self.inertia_kg_m2 * servos.radians_per_s2(duty)
        pull = self.unbalance_kg_m * duty["most_g"] * GRAVITY_MPS2
        return float(start + pull + self.lead_nm)


def masses_kg() -> dict[str, float]:
    """Return what the moving bodies weigh, their screws with them."""
    sonar_g = next(part["mass_g"] for part in bom.parts() if "MB1202" in part["name"])
    grams = {
        "cradle_mass": bom.print_mass_g("cradle") + 2 * SCREWS_G,
        "sonar_mass": sonar_g,
        "yoke_mass": bom.print_mass_g("yoke") + SCREWS_G + 2 * HORNS_G,
        "tilt_servo_mass": servos.Servo().mass,
    }
    return {name: mass / 1e3 for name, mass in grams.items()}


def loads(rig: Rig) -> list[Load]:
    """Return what pan and tilt turn, level."""
    f = figures()
    tilting = ("cradle_mass", "sonar_mass")
    panning = (*tilting, "yoke_mass", "tilt_servo_mass")
    bends_m = {name: radius / 1e3 for name, radius in sweep.bends(rig).items()}
    sonar_nm = f.lead_stiffness / 1e6 / bends_m["sonar's lead"]
    servo_nm = f.servo_lead_stiffness / 1e6 / bends_m["servo's lead"]
    return [
        Load("pan", *turned(rig, panning, np.array([0.0, 0.0, 1.0])), sonar_nm + servo_nm),
        Load("tilt", *turned(rig, tilting, np.array([0.0, 1.0, 0.0])), sonar_nm),
    ]


def turned(rig: Rig, bodies: tuple[str, ...], axis: Point) -> tuple[float, float]:
    """Return inertia about an axis through the pivot, and mass times distance from it."""
    mass_kg = masses_kg()
    inertia, moment = 0.0, np.zeros(3)
    for name in bodies:
        mesh, mass = rig.solids[name], mass_kg[name]
        offset_m = _across((mesh.center_mass - rig.pivot) / 1e3, axis)
        own = _inertia_kg_m2(mesh, mass, axis)
        inertia += own + mass * float(offset_m @ offset_m)
        moment += mass * offset_m
    return inertia, float(np.linalg.norm(moment))


def _across(vector: Point, axis: Point) -> Point:
    across: Point = vector - (vector @ axis) * axis
    return across


def _inertia_kg_m2(mesh: trimesh.Trimesh, mass_kg: float, axis: Point) -> float:
    """A solid's own, about an axis through its centre, its mass spread evenly."""
    per_mm5 = float(axis @ np.asarray(mesh.moment_inertia) @ axis)
    return per_mm5 / float(mesh.volume) * mass_kg / 1e6


def checks(rig: Rig) -> list[Check]:
    """Return what the servos and the boom must do, against what they can."""
    servo, duty = servos.Servo(), servos.duty()
    slowest_us = search.parameter_defaults()["SERVO_RATE"]
    left = servo.torque_nm(duty["steady_dps"])
    found = []
    for load in loads(rig):
        need = load.torque_nm(duty)
        speed = servo.fastest_dps * (1.0 - need / servo.stall_nm)
        how = f"{left * 1e3:.0f} against {need * 1e3:.1f} N mm"
        found += [
            Check(load.axis, "torque left at that speed, to what is needed", left / need, ">=",
                  TORQUE_MARGIN, "1", how),
            Check(load.axis, "speed under that load", speed, ">=", duty["steady_dps"], "deg/s",
                  f"{servo.fastest_dps:.0f} without load"),
            Check(load.axis, "speed under that load, in pulse", speed * servo.us_per_deg, ">=",
                  slowest_us, "us/s", "the firmware's SERVO_RATE counts on it"),
        ]  # fmt: skip
    return [*found, *travel_checks(), *_boom(rig)]


def reach_deg(middle_us: float, us_per_deg: float) -> float:
    """Return how far a servo turns to both sides of a middle within the firmware's pulses."""
    least, most = PULSES_US
    return min(most - middle_us, middle_us - least) / us_per_deg


def travel_checks() -> list[Check]:
    """Return whether the servos turn as far as the firmware may tell them to."""
    servo, reach = servos.Servo(), gimbal_reach()
    turns = reach_deg(MIDDLE_US, servo.us_per_deg)
    how = f"{MIDDLE_US:g} us straight ahead, {PULSES_US[0]:g} to {PULSES_US[1]:g} us"
    wanted = (("pan", reach.pan_deg), ("tilt", reach.tilt_deg))
    return [
        Check(axis, "turns to each side", turns, ">=", most, "deg", how) for axis, most in wanted
    ]


def _boom(rig: Rig) -> list[Check]:
    """The tube as a beam that is held at the body's edge and carries the mount at its end."""
    f, number = figures(), mount.number
    pan_ahead_mm = number("frame_face_ahead_mm") - rig.face_x
    free_m = (pan_ahead_mm - number("frame_body_front_mm")) / 1e3
    carried_kg, tube_kg = _carried_kg(), _tube_kg_m(f) * free_m
    # Rayleigh: 33/140 of a cantilever's own mass swings with its end
    stiff_n_m = 3 * f.tube_modulus * 1e9 * _tube_second_moment_m4() / free_m**3
    rings_hz = math.sqrt(stiff_n_m / (carried_kg + 33 / 140 * tube_kg)) / (2 * math.pi)
    turns_hz = hover_turns_hz(f)
    moment_kg_mm = carried_kg * pan_ahead_mm + tube_kg * (pan_ahead_mm - free_m * 500)
    how = f"{rings_hz:.0f} Hz with {carried_kg * 1e3:.0f} g at {free_m * 1e3:.0f} mm"
    return [
        Check("boom", "its first bending, over the propellers' turns in hover",
              rings_hz / turns_hz, ">=", BOOM_MARGIN, "1",
              f"{how}, against {turns_hz:.0f} turns a second"),
        Check("boom", "battery moved back for balance", moment_kg_mm / f.battery_mass, "<=",
              BATTERY_ROOM_MM, "mm",
              f"{moment_kg_mm / 1e3:.3f} kg m, a battery of {f.battery_mass:g} kg"),
    ]  # fmt: skip


def _carried_kg() -> float:
    prints_g = sum(bom.print_mass_g(part) for part in mount.PARTS)
    return (prints_g + BOLTS_G + 2 * servos.Servo().mass) / 1e3 + masses_kg()["sonar_mass"]


def _tube_mm() -> tuple[float, float]:
    """The tube's outer and inner diameter."""
    outer = mount.number("frame_tube_diameter_mm")
    return outer, outer - 2 * mount.number("frame_tube_wall_mm")


def _tube_kg_m(f: Figures) -> float:
    outer, inner = _tube_mm()
    return f.tube_density * math.pi / 4 * (outer**2 - inner**2) * 1e-6


def _tube_second_moment_m4() -> float:
    outer, inner = _tube_mm()
    return math.pi / 64 * (outer**4 - inner**4) * 1e-12


def hover_turns_hz(f: Figures) -> float:
    """Return how often a propeller turns in a second where eight carry the X8."""
    disc_m = mount.number("frame_propeller_diameter_mm") / 1e3
    thrust_n = f.vehicle_mass * GRAVITY_MPS2 / 8
    return math.sqrt(thrust_n / (f.thrust_coefficient * f.air_density * disc_m**4))


def report_text(rig: Rig) -> str:
    """Return the motion report as Markdown."""
    return f"""# Motion

Written by `make hw` from `parameters.toml`, `../servos.toml`, the solids and the firmware's
parameters.

{_reach_text()}
{_gap_text(rig)}
{_torque_text(rig)}
{_wear_text(rig)}
{_figures_text()}"""


def _reach_text() -> str:
    servo, reach, normal = servos.Servo(), gimbal_reach(), search.parameter_defaults()
    rows = _rows(
        f"| {name} | {middle:g} | {scale:.1f} | {reach_deg(middle, scale):.0f} |"
        for name, middle, scale in (
            (f"{servo.title}, set as below", MIDDLE_US, servo.us_per_deg),
            ("pan, the firmware's defaults", normal["PAN_MIDDLE"], normal["PAN_US_DEG"]),
            ("tilt, the firmware's defaults", normal["TILT_MIDDLE"], normal["TILT_US_DEG"]),
        )
    )
    return f"""## Reach

Pan {reach.pan_deg:g} degrees to each side, tilt {reach.tilt_deg:g} up and down: the firmware's
`PAN_REACH` and `TILT_REACH`. It keeps each pulse within {PULSES_US[0]:g} to {PULSES_US[1]:g} us.

| servo | straight ahead, us | us per degree | to the nearer side, degrees |
|---|---|---|---|
{rows}

The defaults are the thesis's pulses: they keep its figure 8, and reach less far to the left. Set:

| parameter | value |
|---|---|
{_rows(f"| `{name}` | {value:g} |" for name, value in settings().items())}
"""


def _gap_text(rig: Rig) -> str:
    swept, bends = sweep.swept_reach(), sweep.bends(rig)
    told = ", ".join(f"{name} {radius:.0f} mm" for name, radius in bends.items())
    gaps = _rows(
        f"| {gap.moving} | {gap.other} | {gap.told} | {gap.wanted_mm:g} |"
        for gap in (*sweep.gaps(rig), *sweep.lead_gaps(rig))
    )
    return f"""## Gaps

Over pan {swept.pan_deg:g} and tilt {swept.tilt_deg:g} degrees, {mount.number("sweep_beyond_deg"):g}
beyond the reach. Between solids the gap wanted is proved for every pose, not only for those looked
at; *least* is the narrowest that was seen. *tilting* is cradle and sonar, *panning* yoke and tilt
servo, *fixed* base, cap, pan servo and tube, all with their screws; *frame* and *discs* are the
aircraft.

| moves | beside | least, mm | wanted, mm |
|---|---|---|---|
{gaps}

The leads' sharpest bends: {told}; wanted {mount.number("lead_bend_least_mm"):g} mm. A lead is
reckoned as an elastic rod without weight, every {sweep.LEAD_STEP_DEG:g} degrees. A softer one hangs
lower, and may lie on the tube.
"""


def _torque_text(rig: Rig) -> str:
    servo, duty = servos.Servo(), servos.duty()
    rows = _rows(
        f"| {load.axis} | {load.inertia_kg_m2 * 1e7:.0f} | {load.unbalance_kg_m * 1e6:.0f} "
        f"| {load.lead_nm * 1e3:.1f} |"
        for load in loads(rig)
    )
    return f"""## Torque and speed

{servo.title}: {duty["steady_dps"]:g} degrees a second, taken up within one servo frame
({1e3 * duty["start_s"]:g} ms), while {duty["most_g"]:g} g pull at what is out of balance. In flight
it is less: {duty["measured"]}.

| axis | inertia, g cm2 | unbalance, g mm | leads, N mm |
|---|---|---|---|
{rows}

{chr(10).join(check_table(checks(rig), "of"))}

A dead band of {servo.dead_band:g} us is {servo.dead_band / servo.us_per_deg:.1f} degrees, and new
gears have {servo.backlash:g} degree of play: together the axis is off by less than a tenth of the
beam's half width.
"""


def _wear_text(rig: Rig) -> str:
    duty, life = servos.duty(), servos.life()
    flights = life["change_h"] * 60 / figures().flight_time
    turns = duty["mean_dps"] * 3600 / 360
    users = _rows(
        f"| {row['what']} | {row['hours']:g} | {row['source']} |" for row in servos.seen()
    )
    return f"""## Wear

**Estimate: change a servo after {life["change_h"]:g} hours of flight ({flights:.0f} flights), or
when it has {life["play_most_deg"]:g} degrees of play.** No maker gives hours. Users saw:

| servo and duty | hours | source |
|---|---|---|
{users}

Gears and potentiometer wear by travel: {duty["mean_dps"]:g} degrees a second (assumed) are
{turns:.0f} turns an hour, most of them near straight ahead. The potentiometer wears there first:
the gimbal then twitches at one place.

| when | what |
|---|---|
| each flight day | power off: turn the sonar to and fro with two fingers, both axes; its front \
edge may move {play_mm(rig):.1f} mm. Then `echowing rig self-test`: no twitch, no hum |
| every 5 hours | screws of horns, clamp and pivot; the leads' ends; no grit in the tilt pivot |
| {life["change_h"]:g} hours, or more play, or after a crash | change the servo, centre it again |

Carry one spare servo with its horn.
"""


def _figures_text() -> str:
    figures_rows = _rows(
        f"| {row['what']} | {row['value']:g} {row['unit']} | {_sourced(row)} |"
        for row in servos.Servo().rows
    )
    others = _rows(
        f"| {row['name']} | {row['says']} | {row['source']} | {row['remark']} |"
        for row in servos.others()
    )
    return f"""## The servo's figures

{servos.Servo().title}. Lines marked *assumed* have no source to trust: measure, then change
`../servos.toml`.

| what | value | source |
|---|---|---|
{figures_rows}

Others that fit: put their sizes into `parameters.toml`.

| servo | figures | source | remark |
|---|---|---|---|
{others}
"""


def _rows(rows: Iterable[str]) -> str:
    return "\n".join(rows)


def settings() -> dict[str, float]:
    """Return the parameters of a board with these servos: the thesis's figure 8, in degrees."""
    scale = servos.Servo().us_per_deg
    normal = search.parameter_defaults()
    found = {}
    for axis, ends in (("PAN", ("LEFT", "RIGHT")), ("TILT", ("LOW", "HIGH"))):
        found[f"{axis}_US_DEG"] = round(scale, 1)
        found[f"{axis}_MIDDLE"] = MIDDLE_US
        for end in ends:
            off_us = normal[f"{axis}_{end}"] - normal[f"{axis}_MIDDLE"]
            off_deg = off_us / normal[f"{axis}_US_DEG"]
            found[f"{axis}_{end}"] = round(MIDDLE_US + off_deg * scale)
    return found


def play_mm(rig: Rig) -> float:
    """Return how far the most play that is allowed lets the sonar's front edge move."""
    return rig.face_x * math.radians(servos.life()["play_most_deg"])


def _sourced(row: dict[str, Any]) -> str:
    return f"*assumed*: {row['source']}" if row.get("assumed") else str(row["source"])
