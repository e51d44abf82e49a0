"""`echowing setup`: the judgements, each alone; writing and putting back; files of old values."""

import argparse
import io
import json
import math
import os
import pty
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from echowing.applets import APPLETS, SPEED, Applet
from echowing.cli import main
from echowing.commands import setup
from echowing.errors import EchowingError
from echowing.flight.by_sonar import applet_by_sonar
from echowing.paths import repository_root
from echowing.setup.applet import applet_parameters
from echowing.setup.apply import (
    Change,
    Saved,
    changes_for,
    default_file,
    hidden_for,
    load,
    others_of,
    save,
    write_all,
)
from echowing.setup.checks import Finding, Verdict, examine, exit_code
from echowing.setup.job import Work
from echowing.setup.readout import CardApplet, Readout, Reports, Role
from echowing.setup.settings import settings_for
from echowing.setup.view import as_json, as_lines, differences, tuning_note
from echowing.sim.vehicle.parameters import Generation, Parameters
from echowing.sonar_file import load_sonar, sonar_names

from .test_background import DEADLINE_S, read_until

# ArduPilot's board ids, and what they give to scripts: 200, 100, 43 KiB, and nothing.
CUBE_ORANGE, PIXHAWK_4, CUBE_BLACK, MATEK_F405 = 140, 50, 9, 125
NOW = datetime(2026, 11, 21, 9, 30)
STEADY = Reports(count=60, heard_for_s=3.0, longest_gap_s=0.06, orientation=0, sensor_id=0)
# What a pilot may have set, besides what Echowing needs.
PILOTS = {"FS_GCS_ENABLE": 1.0, "BATT_FS_LOW_ACT": 2.0, "FENCE_ENABLE": 1.0}
METRIC = {
    "SERIAL2_BAUD": 115.0,
    "RNGFND1_TYPE": 10.0,
    "RNGFND1_ORIENT": 0.0,
    "RNGFND1_MAX": 7.65,
    "WP_ACC": 5.0,
    "PSC_JERK_NE": 20.0,
}
CENTIMETRES = {
    "SERIAL2_BAUD": 115.0,
    "RNGFND1_TYPE": 10.0,
    "RNGFND1_ORIENT": 0.0,
    "RNGFND1_MAX_CM": 765.0,
    "RTL_SPEED": 500.0,
    "WPNAV_ACCEL": 500.0,
    "PSC_JERK_XY": 20.0,
    "ANGLE_MAX": 4500.0,
}
NEEDED = {
    Generation.V4_5: CENTIMETRES,
    Generation.V4_6: CENTIMETRES,
    Generation.V4_7: {**METRIC, "RTL_SPEED": 500.0, "ANGLE_MAX": 4500.0},
    Generation.V4_8: {**METRIC, "RTL_SPEED_MS": 5.0, "ATC_ANGLE_MAX": 45.0},
}


def factory(generation: Generation = Generation.V4_8) -> dict[str, float]:
    return {name: value for name, value, _ in Parameters(generation, {})}


def ready(generation: Generation = Generation.V4_8, **changes: Any) -> Readout:
    """A vehicle with nothing wrong, but for the changes of its parameters or of the read-out."""
    applet = {row.name: row.default for row in applet_parameters()} | {"ECHO_ENABLE": 1.0}
    parameters = {**factory(generation), **NEEDED[generation], **applet, **PILOTS}
    rest: dict[str, Any] = {
        "serial_port": 2,
        "coprocessor": 191,
        "coprocessor_status": 4,
        "coprocessor_parameters": {"TRACK_RANGE": 450.0, "BEAM_WIDTH": 40.0},
        "reports": STEADY,
        "takes_range": True,
        "applet_on_card": CardApplet.OURS,
        "board_id": CUBE_ORANGE,
    }
    for key, value in changes.items():
        if key[0].isupper():
            parameters[key] = value
        else:
            rest[key] = value
    known = {name: value for name, value in parameters.items() if value is not None}
    return Readout(known, **rest)


def odd_ones(readout: Readout) -> dict[str, Finding]:
    return {one.about: one for one in examine(readout) if one.verdict is not Verdict.FINE}


# ---- judgements -------------------------------------------------------------------------------


@pytest.mark.parametrize("generation", list(Generation))
def test_a_ready_vehicle_has_nothing_wrong_in_any_generation(generation: Generation) -> None:
    assert odd_ones(ready(generation)) == {}
    assert exit_code(examine(ready(generation))) == 0


@pytest.mark.parametrize("generation", list(Generation))
def test_the_factory_needs_just_what_the_docs_say(generation: Generation) -> None:
    readout = Readout(factory(generation), serial_port=2, board_id=CUBE_ORANGE)
    assert {one.name: one.new for one in changes_for(readout)} == NEEDED[generation]


WRONG = [
    # what is changed, where it shows, what fixes it
    ({"SERIAL2_PROTOCOL": 1.0}, "SERIAL2_PROTOCOL", "param set SERIAL2_PROTOCOL 2"),
    ({"SERIAL2_PROTOCOL": -1.0}, "SERIAL2_PROTOCOL", "restart"),
    ({"SERIAL2_BAUD": 57.0}, "SERIAL2_BAUD", "param set SERIAL2_BAUD 115"),
    ({"SERIAL2_OPTIONS": 1025.0}, "SERIAL2_OPTIONS", "param set SERIAL2_OPTIONS 1;"),
    ({"RNGFND1_TYPE": 0.0}, "RNGFND1_TYPE", "param set RNGFND1_TYPE 10"),
    ({"RNGFND1_TYPE": 8.0}, "RNGFND1_TYPE", "--rangefinder 2"),
    ({"RNGFND1_ORIENT": 25.0}, "RNGFND1_ORIENT", "param set RNGFND1_ORIENT 0"),
    ({"RNGFND1_MIN": 0.5}, "RNGFND1_MIN", "param set RNGFND1_MIN 0.2"),
    ({"RNGFND1_MAX": 7.0}, "RNGFND1_MAX", "param set RNGFND1_MAX 7.65"),
    ({"RNGFND1_ADDR": 3.0}, "RNGFND1_ADDR", "param set RNGFND1_ADDR 0"),
    ({"PRX1_TYPE": 2.0}, "PRX1_TYPE", "param set PRX1_TYPE 0"),
    ({"PRX3_TYPE": 4.0}, "PRX3_TYPE", "param set PRX3_TYPE 0"),
    ({"SCR_ENABLE": 0.0}, "SCR_ENABLE", "param set SCR_ENABLE 1"),
    ({"SCR_DIR_DISABLE": 2.0}, "SCR_DIR_DISABLE", "param set SCR_DIR_DISABLE 0"),
    ({"SCR_HEAP_SIZE": 44_032.0}, "SCR_HEAP_SIZE", "204800"),
    ({"SCR_VM_I_COUNT": 1_000.0}, "SCR_VM_I_COUNT", "10000"),
    ({"GUID_OPTIONS": 65.0}, "GUID_OPTIONS", "param set GUID_OPTIONS 1;"),
    ({"GUID_TIMEOUT": 60.0}, "GUID_TIMEOUT", "param set GUID_TIMEOUT 3"),
    ({"RTL_SPEED_MS": 0.0}, "RTL_SPEED_MS", "param set RTL_SPEED_MS 5"),
    ({"WP_ACC": 2.5}, "WP_ACC", "param set WP_ACC 5;"),
    ({"WP_ACC": 0.0}, "WP_ACC", "param set WP_ACC 5;"),  # ArduCopter flies 2.5 then
    ({"PSC_JERK_NE": 5.0}, "PSC_JERK_NE", "param set PSC_JERK_NE 20;"),
    ({"PSC_JERK_NE": 0.0}, "PSC_JERK_NE", "param set PSC_JERK_NE 20;"),
    ({"ATC_ANGLE_MAX": 30.0}, "ATC_ANGLE_MAX", "param set ATC_ANGLE_MAX 45;"),
    ({"ECHO_ENABLE": 0.0}, "ECHO_ENABLE", "param set ECHO_ENABLE 1"),
    ({"ECHO_DIST": 0.5}, "ECHO_DIST", "param set ECHO_DIST 3"),
    ({"ECHO_SPD_MIN": 0.1}, "ECHO_SPD_MIN", "param set ECHO_SPD_MIN 0.2"),
    ({"ECHO_SWITCH": 301.0}, "switch", "param set RC7_OPTION 301"),
    (
        {"ECHO_ENABLE": None, "applet_on_card": CardApplet.NONE},
        "applet",
        "echowing setup lua",
    ),
    ({"ECHO_ENABLE": None, "applet_on_card": None}, "applet", "echowing setup lua"),
    ({"ECHO_ENABLE": None}, "applet", "restart the autopilot"),
    ({"objections": ["Scripting: Error: ./x.lua:9: boom"]}, "applet", "remove that from the card"),
    (
        {"coprocessor": None, "reports": None, "signs": True, "takes_range": False},
        "co-processor",
        "MAV3_OPTIONS 1 ",
    ),
    ({"applet_on_card": CardApplet.ANOTHER}, "applet on the card", "echowing setup lua"),
    ({"ECHO_MIRROR": 10.0, "WP_SPD": 0.2}, "WP_SPD", "restart the autopilot or its scripts"),
    ({"coprocessor": None, "reports": None}, "co-processor", "look at the wires"),
    ({"coprocessor_status": 5}, "co-processor", "SONAR_ADDR"),
    ({"reports": None}, "DISTANCE_SENSOR", "LED"),
    ({"reports": Reports(6, 3.0, 0.3, 0, 0)}, "DISTANCE_SENSOR", "REPORT_RATE"),
    ({"reports": Reports(50, 3.0, 0.6, 0, 0)}, "DISTANCE_SENSOR", "REPORT_RATE"),
    ({"reports": Reports(60, 3.0, 0.06, 25, 0)}, "DISTANCE_SENSOR", "another device"),
    ({"takes_range": False}, "range in the autopilot", "RNGFND1_"),
]


@pytest.mark.parametrize(("changes", "about", "fix"), WRONG)
def test_one_thing_wrong_is_one_line_that_fixes_it(
    changes: dict[str, Any], about: str, fix: str
) -> None:
    odd = odd_ones(ready(**changes))
    assert list(odd) == [about]
    assert odd[about].verdict is Verdict.WRONG
    assert fix in odd[about].fix
    assert odd[about].why
    assert exit_code(examine(ready(**changes))) == 1


YOURS = [
    ({"FS_GCS_ENABLE": 0.0}, "FS_GCS_ENABLE"),
    ({"MAV_GCS_SYSID": 245.0}, "MAV_GCS_SYSID"),
    ({"FS_THR_ENABLE": 0.0}, "FS_THR_ENABLE"),
    ({"FS_OPTIONS": 20.0}, "FS_OPTIONS"),
    ({"BATT_FS_LOW_ACT": 0.0}, "BATT_FS_LOW_ACT"),
    ({"FENCE_ENABLE": 0.0}, "FENCE_ENABLE"),
    ({"PRX1_TYPE": 5.0}, "AVOID_ENABLE"),
    ({"PRX1_TYPE": 5.0, "AVOID_ENABLE": 1.0, "OA_TYPE": 1.0}, "OA_TYPE"),
    ({"ECHO_STREAM_T": 0.0}, "ECHO_STREAM_T"),
    ({"ECHO_ARM_CHK": 0.0}, "ECHO_ARM_CHK"),
    ({"WP_SPD": 0.5}, "WP_SPD"),
    ({"ECHO_DETECT": 4.0}, "ECHO_DETECT"),
    ({"ECHO_INSET": 0.45}, "ECHO_INSET"),
    ({"coprocessor_parameters": {"TRACK_RANGE": 400.0}}, "TRACK_RANGE"),
    ({"coprocessor_parameters": {"BEAM_WIDTH": 60.0}}, "BEAM_WIDTH"),
]


@pytest.mark.parametrize(("changes", "about"), YOURS)
def test_the_pilots_own_is_reported_and_never_written(changes: dict[str, Any], about: str) -> None:
    readout = ready(**changes)
    odd = odd_ones(readout)
    assert list(odd) == [about]
    assert odd[about].verdict is Verdict.YOURS
    assert exit_code(examine(readout)) == 0
    assert changes_for(readout) == []
    assert any("stays; it is yours" in line for line in differences(readout, [], {}))


def test_another_sonar_has_other_limits() -> None:
    lidar = load_sonar("lidar").belief()
    odd = odd_ones(ready(sonar=lidar))
    assert set(odd) == {"ECHO_DETECT", "TRACK_RANGE", "BEAM_WIDTH"}
    assert "param set ECHO_DETECT 7.5, " in odd["ECHO_DETECT"].fix
    assert "param set TRACK_RANGE 750 of component 191" in odd["TRACK_RANGE"].fix
    assert "param set BEAM_WIDTH 6 of" in odd["BEAM_WIDTH"].fix
    told = {"TRACK_RANGE": 750.0, "BEAM_WIDTH": 6.0}
    assert odd_ones(ready(sonar=lidar, ECHO_DETECT=7.5, coprocessor_parameters=told)) == {}


@pytest.mark.parametrize("name", sonar_names())
@pytest.mark.parametrize("before_m", [2.0, 4.0, 4.5, 7.6, 7.65, 9.0])
def test_apply_with_a_sonars_file_writes_what_check_asks_for(name: str, before_m: float) -> None:
    file = load_sonar(name)
    carries: dict[str, Any] = {
        "sonar": file.belief(),
        "range_type": file.rangefinder_type,
        "coprocessor_parameters": {},
        "RNGFND1_TYPE": float(file.rangefinder_type),
    }
    before = ready(**carries, sonar_named=True, ECHO_DETECT=before_m)
    written = {one.name: one.new for one in changes_for(before)}
    wanted = {"ECHO_DETECT": file.reach_m, "ECHO_INSET": sum(file.inset_m) / 2.0}
    were = {"ECHO_DETECT": before_m, "ECHO_INSET": 0.2}
    most_m = 7.6  # the applet takes no more
    assert written == {
        name: m for name, m in wanted.items() if abs(m - were[name]) > 0.1 or were[name] > most_m
    }
    told = "\n".join(differences(before, changes_for(before), {}))
    assert "stays" not in told
    assert "left alone" not in told
    after = ready(**{**carries, "ECHO_DETECT": before_m, **written})
    assert odd_ones(after) == {}
    assert changes_for(replace(after, sonar_named=True)) == []


@pytest.mark.parametrize(
    ("sonar", "name", "wanted_m"),
    [
        ({"reach_m": 1.2}, "ECHO_DETECT", 2.0),
        ({"reach_m": 9.0}, "ECHO_DETECT", 7.6),
        ({"inset_m": 1.2}, "ECHO_INSET", 1.0),
    ],
)
def test_what_the_applet_does_not_take_is_set_as_near_as_it_does(
    sonar: dict[str, Any], name: str, wanted_m: float
) -> None:
    belief = replace(load_sonar("mb1202").belief(), **sonar)
    changes = changes_for(ready(sonar=belief, sonar_named=True))
    assert [(one.name, one.new) for one in changes] == [(name, wanted_m)]
    # And check asks for no more than that.
    told: dict[str, Any] = {name: wanted_m}
    assert name not in odd_ones(ready(sonar=belief, **told))


@pytest.mark.parametrize("applet", APPLETS, ids=lambda applet: applet.name)
def test_what_a_sonars_file_gives_is_within_what_each_applet_takes(applet: Applet) -> None:
    rows = {row.name: row for row in applet_parameters(applet)}
    belief = load_sonar("mb1202").belief()
    for far in (0.0, 99.0):
        by_sonar = applet_by_sonar(replace(belief, reach_m=far, inset_m=far))
        ends = {name: (rows[name].low, rows[name].high) for name in by_sonar}
        assert {name: one.value for name, one in by_sonar.items()} == {
            name: most if far else least for name, (least, most) in ends.items()
        }


def test_what_does_well_enough_is_let_be() -> None:
    fine = ready(
        SERIAL2_BAUD=115_200.0,
        RNGFND1_ADDR=9.0,
        reports=Reports(60, 3.0, 0.06, 0, 9),
        PRX1_TYPE=5.0,  # a lidar of its own, with avoidance off
        AVOID_ENABLE=1.0,
        SCR_HEAP_SIZE=307_200.0,
        GUID_OPTIONS=9.0,
        RTL_SPEED_MS=3.0,
        WP_ACC=6.0,
        PSC_JERK_NE=30.0,
        ATC_ANGLE_MAX=50.0,
    )
    assert odd_ones(fine) == {}
    assert changes_for(fine) == []


def test_the_applet_in_control_keeps_the_pilots_speed_in_its_mirror() -> None:
    flying = ready(WP_SPD=1.2, ECHO_MIRROR=10.0, armed=True, in_guided=True, applet_heard=True)
    assert odd_ones(flying) == {}
    dead = ready(armed=True, in_guided=True)
    assert odd_ones(dead)["applet"].found == "silent in Guided"
    switched_off = ready(armed=True, in_guided=True, ECHO_SWITCH=300.0, RC7_OPTION=300.0)
    assert odd_ones(switched_off) == {}


def test_what_cannot_be_told_is_neither_fine_nor_wrong() -> None:
    readout = ready(SCR_HEAP_SIZE=None)
    assert odd_ones(readout)["SCR_HEAP_SIZE"].verdict is Verdict.UNKNOWN
    assert exit_code(examine(readout)) == 2
    assert "SCR_ENABLE is 1" in odd_ones(readout)["SCR_HEAP_SIZE"].fix
    hidden = odd_ones(ready(RNGFND1_ORIENT=None))["RNGFND1_ORIENT"]
    assert "shown once the rangefinder's TYPE is set" in hidden.fix
    no_copter = ready(WP_SPD=None)
    assert "neither WP_SPD nor WPNAV_SPEED" in odd_ones(no_copter)["speed parameter"].found
    assert odd_ones(ready(WP_ACC=None))["WP_ACC"].verdict is Verdict.UNKNOWN
    assert odd_ones(ready(PSC_JERK_NE=None))["PSC_JERK_NE"].verdict is Verdict.UNKNOWN
    both = ready(SCR_HEAP_SIZE=None, RTL_SPEED_MS=0.0)
    assert exit_code(examine(both)) == 1


def test_limits_are_judged_in_the_units_of_the_generation() -> None:
    old = Generation.V4_6
    slow = odd_ones(ready(old, WPNAV_ACCEL=250.0, PSC_JERK_XY=5.0, ANGLE_MAX=3000.0))
    assert set(slow) == {"WPNAV_ACCEL", "PSC_JERK_XY", "ANGLE_MAX"}
    assert "param set WPNAV_ACCEL 500;" in slow["WPNAV_ACCEL"].fix
    assert "param set PSC_JERK_XY 20;" in slow["PSC_JERK_XY"].fix
    assert "param set ANGLE_MAX 4500;" in slow["ANGLE_MAX"].fix
    assert odd_ones(ready(old, WPNAV_ACCEL=600.0)) == {}


def test_without_a_port_named_the_ports_are_left_alone_and_listed() -> None:
    readout = ready(serial_port=None, SERIAL2_BAUD=57.0, SERIAL4_PROTOCOL=2.0, SERIAL4_BAUD=115.0)
    assert odd_ones(readout) == {}
    unheard = ready(
        serial_port=None, coprocessor=None, reports=None, SERIAL4_PROTOCOL=2.0, SERIAL4_BAUD=115.0
    )
    # SERIAL0 is USB; 2 and 4 are MAVLink at 115200 baud.
    assert "is now on: SERIAL2, SERIAL4" in odd_ones(unheard)["co-processor"].fix


def test_a_second_rangefinder_may_be_ours() -> None:
    second: dict[str, Any] = {
        "RNGFND2_TYPE": 10.0,
        "RNGFND2_ORIENT": 0.0,
        "RNGFND2_MIN": 0.2,
        "RNGFND2_MAX": 7.65,
    }
    down: dict[str, Any] = {"RNGFND1_TYPE": 8.0, "RNGFND1_ORIENT": 25.0}
    assert odd_ones(ready(rangefinder=2, **down, **second)) == {}
    readout = ready(rangefinder=2, **down, **{**second, "RNGFND2_TYPE": 0.0})
    assert [one.name for one in changes_for(readout)] == ["RNGFND2_TYPE"]


SECOND = {"RNGFND2_TYPE": 20.0, "RNGFND2_ORIENT": 0.0}


@pytest.mark.parametrize(
    ("vehicle", "verdict"),
    [
        ({}, Verdict.YOURS),  # the applet takes the co-processor's
        ({"applet": SPEED}, Verdict.WRONG),
        ({"range_type": 2, "RNGFND1_TYPE": 2.0}, Verdict.WRONG),
        ({"RNGFND2_ORIENT": 25.0}, None),  # it looks down
        ({"RNGFND2_TYPE": 0.0}, None),
        ({"RNGFND2_ORIENT": None}, None),
    ],
)
def test_a_second_forward_sensor_is_told(vehicle: dict[str, Any], verdict: Verdict | None) -> None:
    told = odd_ones(ready(**{**SECOND, **vehicle})).get("RNGFND2_ORIENT")
    assert (told and told.verdict) is verdict


def test_a_sensor_of_the_pilots_is_never_overwritten() -> None:
    readout = ready(RNGFND1_TYPE=8.0)
    assert changes_for(readout) == []
    told = "\n".join(differences(readout, [], {}))
    assert "another sensor is set up there, left alone" in told


@pytest.mark.parametrize("applet", APPLETS, ids=[applet.name for applet in APPLETS])
def test_the_applets_ranges_are_read_out_of_the_applet(applet: Applet) -> None:
    rows = {row.name: row for row in applet_parameters(applet)}
    script = repository_root() / "lua" / applet.file
    page = script.with_suffix(".md").read_text(encoding="utf-8")
    assert list(rows) == re.findall(r"^\| `(ECHO_\w+)` \|", page, re.MULTILINE)
    assert (rows["ECHO_DIST"].default, rows["ECHO_DIST"].low, rows["ECHO_DIST"].high) == (3, 1.5, 6)
    assert rows["ECHO_SPD_MIN"].low == 0.2


def test_the_page_for_people_says_the_same() -> None:
    text = (repository_root() / "lua" / "echowing.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", text, re.MULTILINE))
    fits = {one.name: one.fits for one in settings_for(ready())}
    compared = [name for name in fits if name in rows and not name.startswith("ECHO_")]
    assert {"SERIAL2_BAUD", "SERIAL2_PROTOCOL", "RNGFND1_TYPE"} <= set(compared)
    for name in compared:
        assert fits[name](float(rows[name])), name


def test_the_applets_absence_has_a_reason() -> None:
    off = ready(ECHO_ENABLE=None, SCR_ENABLE=0.0, applet_on_card=CardApplet.NONE)
    assert odd_ones(off)["applet"].found == "does not run: scripting is off"
    # The autopilot's own reason comes before all guesses.
    told = "Scripting: Error: ./scripts/echowing.lua:673: too many l"
    failed = ready(ECHO_ENABLE=None, objections=[told, "GPS 1: Bad fix"])
    odd = odd_ones(failed)
    assert odd["applet"].found == told
    assert (odd["arming"].found, odd["arming"].verdict) == ("GPS 1: Bad fix", Verdict.YOURS)


def test_signing_silences_the_co_processor_and_the_fix_is_named() -> None:
    unheard: dict[str, Any] = {
        "coprocessor": None,
        "reports": None,
        "signs": True,
        "takes_range": False,
    }
    # MAVn counts MAVLink ports: without SERIAL1 the co-processor's is the second.
    second = odd_ones(ready(SERIAL1_PROTOCOL=-1.0, MAV2_OPTIONS=4.0, **unheard))["co-processor"]
    assert "param set MAV2_OPTIONS 5 " in second.fix
    exempt = odd_ones(ready(MAV3_OPTIONS=1.0, **unheard))["co-processor"]
    assert "look at the wires" in exempt.fix
    old = odd_ones(ready(Generation.V4_6, **unheard))["co-processor"]
    assert "only the USB port" in old.fix
    assert "update to 4.7" in old.fix
    unnamed = odd_ones(ready(serial_port=None, **unheard))["co-processor"]
    assert "--serial 2" in unnamed.fix
    assert odd_ones(ready(signs=True)) == {}  # heard: nothing is dropped
    # On a signed link what is passed on without a signature is not believed, but the range counts.
    assert odd_ones(ready(**{**unheard, "takes_range": True})) == {}


def test_a_leader_is_not_judged_as_a_follower() -> None:
    bare = Readout({**factory(), **PILOTS, "WP_SPD": 4.0})
    assert [one for one in examine(bare, Role.LEADER) if one.verdict is not Verdict.FINE] == []
    assert exit_code(examine(bare)) == 1
    careless = Readout({**factory(), "ECHO_ENABLE": 1.0, "ECHO_STREAM_T": 0.0})
    doubts = {one.about for one in examine(careless, Role.LEADER) if one.verdict is Verdict.YOURS}
    assert doubts == {"WP_SPD", "ECHO_ENABLE", "FS_GCS_ENABLE", "BATT_FS_LOW_ACT", "FENCE_ENABLE"}
    assert exit_code(examine(careless, Role.LEADER)) == 0


# ---- what is printed --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "slower"),
    [("WP_SPD", 10.0, "WP_SPD 4,"), ("WPNAV_SPEED", 450.0, "WPNAV_SPEED 400,")],
)
def test_a_leader_whose_missions_outrun_its_followers_is_told(
    name: str, value: float, slower: str
) -> None:
    parameters = {**factory(Generation.V4_6 if "NAV" in name else Generation.V4_8), **PILOTS}
    (speed,) = (
        one
        for one in examine(Readout({**parameters, name: value}), Role.LEADER)
        if one.about == name
    )
    assert speed.verdict is Verdict.YOURS
    assert "up to 4 m/s" in speed.why
    assert slower in speed.fix


def test_lines_say_why_and_what_to_type_and_fold_what_is_dull() -> None:
    readout = ready(RTL_SPEED_MS=0.0, version=(4, 8))
    lines = list(as_lines(2, readout, examine(readout)))
    assert lines[0] == "vehicle 2, ArduCopter 4.8, disarmed, as a follower"
    at = next(i for i, line in enumerate(lines) if line.startswith("WRONG"))
    assert lines[at].split() == ["WRONG", "RTL_SPEED_MS", "0"]
    assert "returns home at the speed parameter" in lines[at + 1]
    assert "param set RTL_SPEED_MS 5" in lines[at + 2]
    assert not any("ECHO_TAU" in line for line in lines)
    folded = len(applet_parameters()) - 2  # ECHO_MIRROR and ECHO_FORMAT are no settings
    assert any(f"{folded} parameters within their ranges" in line for line in lines)
    assert lines[-1].startswith("1 wrong, ")


def test_no_label_runs_into_what_was_found() -> None:
    findings = [
        Finding("range in the autopilot", Verdict.FINE, "it"),
        Finding("x", Verdict.FINE, "y"),
    ]
    lines = list(as_lines(2, ready(), findings))
    assert lines[1:3] == ["fine   range in the autopilot it", "fine   x                      y"]


def test_json_holds_every_finding() -> None:
    readout = ready(RTL_SPEED_MS=0.0)
    told = json.loads(json.dumps(as_json(2, readout, examine(readout))))
    assert (told["system_id"], told["result"], told["version"]) == (2, "wrong", None)
    verdicts = {one["about"]: one["verdict"] for one in told["findings"]}
    assert verdicts["RTL_SPEED_MS"] == "wrong"
    assert verdicts["ECHO_TAU"] == "fine"


# ---- writing, and the file of old values ------------------------------------------------------


class Store:
    """Parameters that take what they are given, a rounded or a refused value if told so."""

    def __init__(self, values: Mapping[str, float], dies_after: int = 99) -> None:
        self.values = dict(values)
        self.stubborn: set[str] = set()
        self._left = dies_after

    def write(self, name: str, value: float) -> float:
        if self._left == 0:
            raise EchowingError("vehicle 2 is silent")
        self._left -= 1
        if name not in self.stubborn:
            self.values[name] = value
        return self.values[name]


CHANGES = [Change("A", 1.0, 2.0), Change("B", 0.1, 0.2), Change("C", 5.0, 6.0)]


def silent(name: str) -> None:
    assert name


def test_the_file_is_whole_before_the_first_write(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    save(path, 2, CHANGES, NOW)
    assert load(path) == Saved(2, {"A": 1.0, "B": 0.1, "C": 5.0}, "2026-11-21T09:30:00")
    assert [one.name for one in tmp_path.iterdir()] == ["old.json"]


@pytest.mark.parametrize("dies_after", [0, 1, 2])
def test_cut_in_the_middle_everything_can_be_put_back(tmp_path: Path, dies_after: int) -> None:
    before = {change.name: change.old for change in CHANGES}
    store = Store(before, dies_after)
    path = tmp_path / "old.json"
    save(path, 2, CHANGES, NOW)
    with pytest.raises(EchowingError, match="silent"):
        write_all([(c.name, c.new) for c in CHANGES], store.write, silent)
    assert sum(store.values[c.name] != c.old for c in CHANGES) == dies_after
    back = Store(store.values)
    assert not write_all(list(load(path).parameters.items()), back.write, silent).refused
    assert back.values == before


def test_a_value_that_is_not_taken_is_told() -> None:
    store = Store({"A": 1.0, "B": 0.1, "C": 5.0})
    store.stubborn = {"B"}
    outcome = write_all([(c.name, c.new) for c in CHANGES], store.write, silent)
    assert outcome.written == ["A", "C"]
    assert outcome.refused == {"B": 0.1}


class Standing:
    """A vehicle that is disarmed, and whose second write is interrupted by Ctrl-C."""

    def __init__(self) -> None:
        self.written: list[str] = []

    def refuse_armed(self, what: str) -> None:
        assert what == "parameters are written"

    def write(self, name: str, value: float) -> float:
        if self.written:
            raise KeyboardInterrupt
        self.written.append(name)
        return value


def test_interrupted_it_says_how_to_go_back() -> None:
    vehicle: Any = Standing()
    told: list[str] = []
    values = [(change.name, change.new) for change in CHANGES]
    work = Work(vehicle, "V", told.append, restart=False)
    assert work.write(values, "back: echowing setup restore F --vehicle V") is None
    assert vehicle.written == ["A"]
    assert "only some values are written; back: echowing setup restore F" in told[-1]


def test_the_oldest_values_stay_where_a_file_is_added_to(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    save(path, 2, CHANGES[:2], NOW)
    later = [Change("B", 0.2, 0.3), Change("D", 7.0, 8.0)]
    save(path, 2, later, NOW + timedelta(hours=1))
    assert load(path) == Saved(2, {"A": 1.0, "B": 0.1, "D": 7.0}, "2026-11-21T09:30:00")
    assert list(load(path).parameters) == ["A", "B", "D"]  # put back in reverse


def test_a_file_of_anything_else_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    save(path, 2, CHANGES, NOW)
    with pytest.raises(EchowingError, match="with values of vehicle 2; name another file"):
        save(path, 3, CHANGES, NOW)
    assert load(path).system_id == 2
    letter = tmp_path / "letter.txt"
    letter.write_text("Dear pilot")
    with pytest.raises(EchowingError, match="not a file of saved parameters"):
        save(letter, 2, CHANGES, NOW)
    assert letter.read_text() == "Dear pilot"
    with pytest.raises(EchowingError, match="nothing was changed"):
        save(tmp_path / "missing" / "old.json", 2, CHANGES, NOW)


def test_files_of_other_applies_are_found_the_newest_first(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.params.json" for name in ("c", "a", "b")]
    for hours, path in enumerate(files):
        save(path, 2, CHANGES, NOW + timedelta(hours=hours))
    save(tmp_path / "other.params.json", 3, CHANGES, NOW)
    (tmp_path / "broken.params.json").write_text("{")
    assert [path.name[0] for path, _ in others_of(files[1], 2)] == ["b", "c"]


def test_what_hides_is_announced() -> None:
    hides: dict[str, Any] = {"RNGFND1_ORIENT": None, "RNGFND1_MIN": None, "SCR_HEAP_SIZE": None}
    readout = ready(ECHO_ENABLE=None, applet_on_card=CardApplet.NONE, **hides)
    hidden = hidden_for(readout)
    assert hidden == {
        "RNGFND1_ORIENT": 0.0,
        "RNGFND1_MIN": 0.2,
        "SCR_HEAP_SIZE": 204_800.0,
        "ECHO_ENABLE": 1.0,
    }
    told = "\n".join(differences(readout, [], hidden))
    assert "-> 0.2 after the restart" in told
    assert "left alone" not in told
    lidar = replace(readout, sonar=load_sonar("lidar").belief(), sonar_named=True)
    assert hidden_for(lidar) == {**hidden, "ECHO_DETECT": 7.5, "ECHO_INSET": 0.2}
    # A firmware without scripting shows nothing later.
    assert "SCR_HEAP_SIZE" not in hidden_for(ready(SCR_ENABLE=None, SCR_HEAP_SIZE=None))


def test_the_files_name_says_whose_and_when() -> None:
    assert default_file(7, NOW) == Path("echowing-7-20261121-093000.params.json")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("no json", "not a file of saved parameters"),
        ("[1]", "not a file of `echowing setup apply`"),
        ('{"format": "other"}', "not a file of `echowing setup apply`"),
        ('{"format": "echowing parameters 1", "system_id": 2}', "a parameter that is no number"),
        (
            '{"format": "echowing parameters 1", "system_id": 2, "parameters": {"A": "x"}}',
            "a parameter that is no number",
        ),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: str, reason: str) -> None:
    path = tmp_path / "file"
    path.write_text(content)
    with pytest.raises(EchowingError, match=reason):
        load(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [("A", math.nan), ("A", 1e39), ("A", -math.inf), ("RNGFND1_MAX_CM_OLD", 1.0)],
)
def test_what_no_parameter_can_be_is_not_put_back(name: str, value: float, tmp_path: Path) -> None:
    """What no 32-bit float holds, and a name that would be cut to another parameter's."""
    path = tmp_path / "old.params.json"
    content = {"format": "echowing parameters 1", "system_id": 2, "parameters": {name: value}}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(EchowingError, match="a parameter that is no number"):
        load(path)


@pytest.mark.parametrize(
    ("typed", "yes"), [("y\n", True), ("YES\n", True), ("\n", False), ("n\n", False), ("y", True)]
)
def test_the_answer_may_come_through_a_pipe(
    typed: str, yes: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    assert setup.agreed("Write these to vehicle 2 on V? [y/N] ") is yes
    assert capsys.readouterr().out == "Write these to vehicle 2 on V? [y/N] "


ASK_BESIDE_A_BAR = """
from echowing.commands.setup import agreed, progress_bar
with progress_bar() as bar:
    step = bar("writing")
    step(1, 2)
    step(2, 2)
    print("[done]")
    bar("reading back")(1, 2)  # still shown
    print(agreed("Write these too? [y/N] "))
"""


def test_a_question_on_a_terminal_shows_its_answers() -> None:
    master, terminal = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", ASK_BESIDE_A_BAR],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm"},
    ) as asking:
        os.close(terminal)
        try:
            read_until(master, b"Write these too? [y/N] ")
            os.write(master, b"y\n")
            read_until(master, b"True")
            assert asking.wait(DEADLINE_S) == 0
        finally:
            os.close(master)  # a question that waits is hung up


def test_where_nobody_answers_nothing_is_taken_for_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(EchowingError, match="no answer: the input has ended; give --yes"):
        setup.agreed("? ")


# ---- the command line, where no vehicle is needed ---------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["check", "--vehicle", "tcp:nowhere"], "the port is a number"),
        (["check", "--vehicle", "udpin:14550@300"], "after @ comes a system id"),
        (["restore", "missing.json", "--vehicle", "tcp:127.0.0.1:1"], "No such file"),
        (["lua", "--mount", "missing"], "no such folder"),
        (["lua", "--vehicle", "nonsense"], "no such kind"),
    ],
)
def test_bad_input_is_one_clear_line(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["setup", *arguments]) == 2
    told = capsys.readouterr().err
    assert reason in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    "arguments",
    [
        ["check"],
        ["check", "--vehicle", "tcp:127.0.0.1:1", "--serial", "12"],
        ["lua"],
        ["lua", "--mount", ".", "--vehicle", "tcp:127.0.0.1:1"],
    ],
)
def test_missing_and_contradicting_options_are_refused(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["setup", *arguments])
    assert ended.value.code == 2


@pytest.mark.parametrize(
    ("options", "reached"),
    [
        (["--vehicle", "udpin:14550@2"], "udpin:14550@2"),
        (
            ["--vehicle", "/dev/ttyUSB0", "--baud", "115200", "--signing-key-file", "my key"],
            "/dev/ttyUSB0 --baud 115200 --signing-key-file 'my key'",
        ),
    ],
)
def test_the_next_command_reaches_the_same_vehicle(options: list[str], reached: str) -> None:
    parser = argparse.ArgumentParser()
    setup.add_arguments(parser)

    assert setup.reached(parser.parse_args(["apply", *options])) == reached


@pytest.mark.parametrize("part", ["check", "apply", "restore", "lua"])
def test_every_help_has_an_example(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["setup", part, "--help"])
    assert f"  echowing setup {part} " in capsys.readouterr().out


@pytest.mark.parametrize(
    "name",
    ["WP_ACC", "WPNAV_ACCEL", "PSC_JERK_NE", "PSC_JERK_XY", "ATC_ANGLE_MAX", "ANGLE_MAX"],
)
def test_higher_limits_are_raised_only_with_a_word_on_what_they_do_elsewhere(name: str) -> None:
    note = "\n".join(tuning_note([Change("SCR_ENABLE", 0.0, 1.0), Change(name, 2.5, 5.0)]))
    assert note.startswith(f"{name}: in Auto and RTL, too")
    assert "tuned (AutoTune)" in note
    assert tuning_note([Change("SCR_ENABLE", 0.0, 1.0)]) == []
