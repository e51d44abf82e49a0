"""Two followers, a signed link, and what the logs say of a flight whose truth is known."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from . import truth
from .formation import (
    FOLLOWER,
    RADIUS_M,
    SERIAL,
    Follower,
    Kit,
    copied,
    rectangle,
    rest,
)
from .plugin import Start
from .sonar import silence
from .table import Entry, Figures
from .tools import first_json, run
from .vehicle import GUIDED, Vehicle

LEAST_M = 1.0
SPEED_MPS = 2.0
FORMATION = """\
[[slots]]
radius_m = 4.0
angle_deg = 40.0
[[slots]]
radius_m = 4.0
angle_deg = -40.0
"""
SLOT_RADIUS_M = 4.0
FLIGHT_S, AFTER_S = 90.0, 5.0
KEY = bytes(range(32))
SIGNED_S = 20.0
TRACKING = (2.0, 7.0)  # ECHO_STATE: tracking, holding the distance
# Receivers that do not drift: what is left are the estimators, and clocks set alike to 0.02 s.
LOGS_AGREE_M = 0.25


def test_two_followers(start: Start, table: list[Entry], case_folder: Path) -> None:
    formation = start(followers=2)
    file = case_folder / "vee.toml"
    file.write_text(FORMATION)
    formation.leader.upload(rectangle(formation), 10.0)
    for vehicle in formation.everybody[1:]:
        vehicle.set("ECHO_DIST", SLOT_RADIUS_M)
    formation.take_off()
    tool = formation.follow("--formation", str(file), radius_m=None)
    for vehicle in formation.everybody[1:]:
        tool.wait_for(_follows(vehicle.system_id))
    formation.until_in_slot(SLOT_RADIUS_M)
    began_s = time.monotonic()
    formation.leader.fly_mission(SPEED_MPS)
    rest(FLIGHT_S)
    ended_s = time.monotonic()
    least_m = formation.least_m(began_s, ended_s)
    leader = formation.leader.heard.truth
    for vehicle in formation.everybody[1:]:
        flown = truth.figures(leader, vehicle.heard.truth, began_s, ended_s, SLOT_RADIUS_M)
        figures = Figures(flown.mean_separation_m, flown.mean_abs_error_m, flown.rmsd_m, least_m)
        case = f"two followers, {vehicle.system_id}"
        note = formation.note(began_s)
        table.append(Entry(formation.kit.version.line, case, figures, note=note))
        assert flown.mean_abs_error_m < SLOT_RADIUS_M / 2
    assert least_m >= LEAST_M


def _follows(system_id: int) -> Callable[[str], bool]:
    """Whether a row says that this one follows."""

    def told(line: str) -> bool:
        row = json.loads(line)
        followed = str(row.get("state")).startswith("following")
        return row.get("system_id") == system_id and followed

    return told


def test_analyze_agrees_with_the_truth(start: Start, table: list[Entry]) -> None:
    formation = start(drifting=False, same_clock=True)
    formation.leader.upload(rectangle(formation), 10.0)
    formation.take_off()
    opened_s = time.monotonic()
    tool = formation.follow()
    formation.until_in_slot()
    began_s = time.monotonic()
    formation.leader.fly_mission(SPEED_MPS)
    rest(FLIGHT_S)
    formation.leader.set_mode(GUIDED)  # it stands while the logs are closed, one after the other
    rest(AFTER_S)
    assert tool.end() == 0
    flown = formation.measured(began_s, time.monotonic())
    binaries = [str(vehicle.newest_log()) for vehicle in formation.everybody]
    logs = {
        "BIN logs": (binaries, began_s - formation.armed_s),
        "follow's table": ([str(formation.folder / "log")], began_s - opened_s),
        "follow's tlog": ([str(max(formation.folder.glob("log/*.tlog")))], began_s - opened_s),
    }
    for name, (files, before_s) in logs.items():
        options = ("--radius", f"{RADIUS_M:g}", "--settle", f"{before_s:.1f}", "--json")
        told = first_json(run("analyze", *files, *options))
        by_logs, true = (
            Figures(
                one["mean_separation_m"],
                one["mean_abs_error_m"],
                one["rmsd_m"],
                one["min_separation_m"],
            )
            for one in (told["by_gps"], flown.to_json())
        )
        note = "by the logs; truth in place of sim"
        case = f"analyze, {name}"
        table.append(Entry(formation.kit.version.line, case, by_logs, true, note))
        for one, other in ((by_logs.mean_m, true.mean_m), (by_logs.rmsd_m, true.rmsd_m)):
            assert one == pytest.approx(other, abs=LOGS_AGREE_M)


def test_a_signed_link(
    kit: Kit, start: Start, table: list[Entry], case_folder: Path, tmp_path: Path
) -> None:
    """From 4.7 on the co-processor's port can be exempt; before, `check` says what is lost."""
    signed = sign(kit, case_folder, tmp_path)
    if not signed.exempt:
        assert "up to ArduCopter 4.6 only the USB port takes unsigned messages" in signed.said
        return
    formation = start(prepared=signed.folder, key=KEY)
    formation.fly_in_formation(*signed.options)
    began_s = time.monotonic()
    formation.leader.fly((SPEED_MPS, 0.0, 0.0))
    tracking = formation.follower.heard.named
    formation.follower.until("tracked", lambda: tracking.get("ECHO_STATE") in TRACKING)
    rest(SIGNED_S)
    flown = formation.measured(began_s, time.monotonic())
    figures = Figures(flown.mean_separation_m, flown.mean_abs_error_m, flown.rmsd_m)
    entry = Entry(kit.version.line, "signed links", figures, note=formation.note(began_s))
    table.append(entry)
    assert flown.min_separation_m >= LEAST_M
    assert flown.mean_abs_error_m < RADIUS_M / 2


@dataclass(frozen=True, slots=True)
class Signed:
    """A follower's folder with signing in its memory, the tools' options, what `check` said.

    exempt: its co-processor's port may be without.
    """

    folder: Path
    options: tuple[str, str]
    said: str
    exempt: bool


def sign(kit: Kit, case_folder: Path, keys: Path) -> Signed:
    """Have a follower sign, and do what `check` advises."""
    key_file = keys / "field.key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o600)
    options = ("--signing-key-file", str(key_file))
    folder = copied(kit.prepared, case_folder / "signed")
    vehicle = Vehicle(kit.binary, FOLLOWER, folder, fresh=False)
    board = Follower(vehicle, silence)
    try:
        vehicle.until_positioned()
        vehicle.sign(KEY)
        where = ("--vehicle", vehicle.link(), "--serial", SERIAL)
        said = run("setup", "check", *where, *options, code=1)
        assert "WRONG" in said
        advice = re.search(r"param set (MAV\d_OPTIONS) (\d+)", said)
        if advice is None:
            return Signed(folder, options, said, False)
        vehicle.set(advice[1], float(advice[2]))
        return Signed(folder, options, said, True)
    finally:
        board.close()
