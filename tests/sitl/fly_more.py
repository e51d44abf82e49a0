"""Two followers, a signed link, and what the logs say of a flight whose truth is known."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from . import truth
from .formation import FOLLOWER, RADIUS_M, Formation, rectangle, rest
from .plugin import Start
from .table import Entry, Figures
from .tools import first_json, run
from .vehicle import GUIDED

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
# Receivers that do not drift: what is left are the estimators, and clocks set alike to 0.02 s.
LOGS_AGREE_M = 0.25


def test_two_followers(start: Start, table: list[Entry], case_folder: Path) -> None:
    formation = start(followers=2)
    file = case_folder / "vee.toml"
    file.write_text(FORMATION)
    formation.leader.upload(rectangle(formation), 10.0)
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
        return (row.get("system_id"), row.get("state")) == (system_id, "following")

    return told


def test_analyze_agrees_with_the_truth(start: Start, table: list[Entry]) -> None:
    formation = start(drifting=False)
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
    binaries = [str(_bin(formation, who)) for who in ("leader", f"follower-{FOLLOWER}")]
    logs = {
        "BIN logs": (binaries, began_s - formation.armed_s),
        "follow's log": ([str(formation.folder / "log")], began_s - opened_s),
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
            for one in (told, flown.to_json())
        )
        note = "by the logs; truth in place of sim"
        case = f"analyze, {name}"
        table.append(Entry(formation.kit.version.line, case, by_logs, true, note))
        for one, other in ((by_logs.mean_m, true.mean_m), (by_logs.rmsd_m, true.rmsd_m)):
            assert one == pytest.approx(other, abs=LOGS_AGREE_M)


def _bin(formation: Formation, who: str) -> Path:
    return max((formation.folder / who / "logs").glob("*.BIN"))
