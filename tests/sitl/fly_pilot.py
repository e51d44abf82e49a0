"""The pilot wins: his modes, his switch, his speed parameter, his fence; and scripts that die."""

import math
import time

from . import truth
from .formation import Formation, rest, still
from .names import SPEED
from .plugin import Start
from .table import Entry, Figures
from .tools import Tool
from .vehicle import GUIDED, LAND, LOITER, Vehicle

STANDS_S = 3.0
GIVE_UP_S = 8.0
LEAST_M = 1.0
SPEED_MPS = 1.5
SETTLE_S = 8.0
MIDDLE_US, LOW_US, HIGH_US = 1500, 1100, 1900
SWITCH = 7
PILOTS_SPEED_MPS = 4.0
SAME_MPS = 0.01
LANDING_S = 90.0
FENCE_RADIUS_M = 40.0
CIRCLE = 2  # FENCE_TYPE
# Its home is south of the origin, and its receiver drifts.
FROM_HOME_M = 3.0
DEADLY_COUNT, COUNT = 100.0, 10_000.0  # SCR_VM_I_COUNT


def _following(formation: Formation, *more: str) -> Tool:
    formation.follower.set(SPEED, PILOTS_SPEED_MPS)
    tool = formation.fly_in_formation(*more)
    formation.follower.override({3: MIDDLE_US})  # Loiter with the throttle down would land
    formation.leader.fly((SPEED_MPS, 0.0, 0.0))
    rest(SETTLE_S)
    return tool


def _enter(table: list[Entry], formation: Formation, case: str, since_s: float) -> float:
    """A row of the table; returns the least distance of any two vehicles."""
    least_m = formation.least_m(since_s, time.monotonic())
    note = formation.note(since_s)
    table.append(Entry(formation.kit.version.line, case, Figures(least_m=least_m), note=note))
    return least_m


def _has_his_speed(vehicle: Vehicle) -> None:
    vehicle.until(
        "had its pilot's speed", lambda: abs(vehicle.get(SPEED) - PILOTS_SPEED_MPS) < SAME_MPS
    )


def test_pilot_changes_the_mode_and_comes_back(start: Start, table: list[Entry]) -> None:
    formation = start()
    tool = _following(formation)
    follower, since, began_s = formation.follower, len(tool.lines), time.monotonic()
    assert abs(follower.get(SPEED) - PILOTS_SPEED_MPS) > SAME_MPS  # the applet's, meanwhile
    follower.set_mode(LOITER)
    tool.event("left Guided for LOITER, pilot has control", since)
    follower.until_said("ECHO: handed back", began_s)
    _has_his_speed(follower)
    rest(5.0)
    assert follower.mode == LOITER
    formation.leader.fly((0.0, 0.0, 0.0))
    back = len(tool.lines)
    follower.set_mode(GUIDED)
    tool.event("in Guided, following", back)
    formation.until_in_slot()
    # Loiter flies on from the speed and lean that it finds: how near it comes is no demand here.
    _enter(table, formation, "pilot's mode, and back", began_s)


def test_stop_switch(start: Start, table: list[Entry]) -> None:
    formation = start()
    tool = _following(formation, "--stop-switch", f"{SWITCH}:1700")
    follower, since, began_s = formation.follower, len(tool.lines), time.monotonic()
    follower.override({3: MIDDLE_US, SWITCH: HIGH_US})
    stood_s = still(follower, GIVE_UP_S)
    tool.event("stop switch, holding", since)
    assert stood_s <= STANDS_S
    assert follower.mode == GUIDED
    back = len(tool.lines)
    formation.leader.fly((0.0, 0.0, 0.0))
    follower.override({3: MIDDLE_US, SWITCH: LOW_US})
    # What stops by the switch stays stopped until its pilot, who sees the switch off in `follow`,
    # puts it in Guided anew.
    tool.row(lambda row: row["switch"] != "on", back)
    follower.set_mode(LOITER)
    tool.event("left Guided for LOITER", back)
    rest(2.5)  # two heartbeats
    follower.set_mode(GUIDED)
    tool.event("in Guided, following", back)
    formation.until_in_slot()
    assert _enter(table, formation, "stop switch", began_s) >= LEAST_M


def test_the_speed_parameter_is_the_pilots_after_landing_and_a_restart(start: Start) -> None:
    formation = start()
    _following(formation)
    follower = formation.follower
    follower.set_mode(LAND)
    _has_his_speed(follower)
    follower.until("disarmed on the ground", lambda: not follower.armed, LANDING_S)
    follower.restart()
    assert abs(follower.get(SPEED) - PILOTS_SPEED_MPS) < SAME_MPS


def test_script_dies_and_is_restarted(start: Start) -> None:
    formation = start()
    tool = _following(formation)
    follower, began_s = formation.follower, time.monotonic()
    follower.set("SCR_VM_I_COUNT", DEADLY_COUNT)
    follower.until_said("exceeded time limit", began_s)
    follower.set_mode(LOITER)
    tool.end()
    assert abs(follower.get(SPEED) - PILOTS_SPEED_MPS) > SAME_MPS  # nobody has put it back
    follower.set("SCR_VM_I_COUNT", COUNT)
    again_s = time.monotonic()
    follower.restart_scripts()
    follower.until_said("ECHO: restarted", again_s)
    _has_his_speed(follower)


def test_a_fence_refuses_points(start: Start, table: list[Entry]) -> None:
    """The leader flies out of its follower's fence: the follower stays in it, and it is told."""
    formation = start()
    follower = formation.follower
    # A fence that only reports: what stops the vehicle is to be seen, not what brings it home.
    fence = {"TYPE": CIRCLE, "RADIUS": FENCE_RADIUS_M, "ACTION": 0.0, "ENABLE": 1.0}
    for name, value in fence.items():
        follower.set(f"FENCE_{name}", value)
    tool = _following(formation)
    began_s = time.monotonic()
    tool.event("its points are refused, holding")
    stood_s = still(follower, GIVE_UP_S)
    assert stood_s <= STANDS_S
    assert follower.mode == GUIDED
    at_m = math.hypot(*truth.track_ned_m([follower.state])[0, :2])
    assert at_m < FENCE_RADIUS_M + FROM_HOME_M
    assert _enter(table, formation, "a fence refuses points", began_s) >= LEAST_M
