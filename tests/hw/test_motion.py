"""The servos are strong and fast enough, the boom is stiff enough."""

import math
import re

import numpy as np
import pytest
import trimesh

from echowing.rig import search
from hwtools import motion, servos
from hwtools.facts import ROOT, gimbal_reach, load, read, scan_aims
from hwtools.figures import figures
from hwtools.mount import number
from hwtools.rig import Rig


def test_every_line_holds(solids: Rig) -> None:
    checks = motion.checks(solids)
    assert len(checks) == 10
    assert [check for check in checks if not check.holds] == []


def test_inertia_is_that_of_the_book(solids: Rig) -> None:
    """A box about an axis beside it: m (a2 + b2) / 12 and m d2."""
    box = trimesh.creation.box((20.0, 30.0, 40.0))
    box.apply_translation(solids.pivot + np.array([50.0, 0.0, 0.0]))
    rig = Rig({**solids.solids, "sonar_mass": box}, solids.measures)
    mass = motion.masses_kg()["sonar_mass"]
    by_book = mass * ((0.02**2 + 0.03**2) / 12 + 0.05**2)
    pan = np.array([0.0, 0.0, 1.0])
    inertia, moment = motion.turned(rig, ("sonar_mass",), pan)
    assert inertia == pytest.approx(by_book)
    assert moment == pytest.approx(mass * 0.05)


def test_pan_turns_more_than_tilt_and_the_tilt_servo_is_most_of_it(solids: Rig) -> None:
    pan, tilt = motion.loads(solids)
    servo, _ = motion.turned(solids, ("tilt_servo_mass",), np.array([0.0, 0.0, 1.0]))
    assert pan.inertia_kg_m2 > servo > 0.5 * pan.inertia_kg_m2
    assert pan.inertia_kg_m2 > 5 * tilt.inertia_kg_m2


def test_a_heavier_load_would_not_pass(solids: Rig) -> None:
    """Ten times the unbalance leaves no margin: the check can fail."""
    pan = motion.loads(solids)[0]
    heavy = motion.Load("pan", pan.inertia_kg_m2, 10 * pan.unbalance_kg_m, pan.lead_nm)
    servo, duty = servos.Servo(), servos.duty()
    left = servo.torque_nm(duty["steady_dps"])
    assert left / pan.torque_nm(duty) > motion.TORQUE_MARGIN > left / heavy.torque_nm(duty)


def test_torque_falls_with_speed() -> None:
    servo = servos.Servo()
    # 1.8 kgf cm; 0.1 s for 60 degrees
    assert servo.stall_nm == pytest.approx(0.1765, abs=1e-4)
    assert servo.fastest_dps == pytest.approx(600.0)
    assert servo.torque_nm(300.0) == pytest.approx(servo.stall_nm / 2)
    assert servo.torque_nm(700.0) == 0.0


def test_the_servo_turns_the_whole_reach_within_the_firmwares_pulses() -> None:
    settings = motion.settings()
    for axis, most in (("PAN", gimbal_reach().pan_deg), ("TILT", gimbal_reach().tilt_deg)):
        turns = motion.reach_deg(settings[f"{axis}_MIDDLE"], settings[f"{axis}_US_DEG"])
        assert turns >= most


def test_pulse_limits_are_the_firmwares() -> None:
    source = read(ROOT / "firmware/echowing/src/core/ports.h")
    found = re.findall(r"k(?:Shortest|Longest)Pulse_us = ([\d.]+)f;", source)
    assert tuple(map(float, found)) == motion.PULSES_US


def test_settings_keep_the_thesiss_figure_8() -> None:
    normal = dict(search.parameter_defaults()) | motion.settings()
    centre, scales = (
        (normal["PAN_MIDDLE"], normal["TILT_MIDDLE"]),
        (
            normal["PAN_US_DEG"],
            normal["TILT_US_DEG"],
        ),
    )
    ours = search.aims(search.scan_pulses_us(normal), centre, scales)
    for mine, thesis in zip(ours, scan_aims(), strict=True):
        assert mine.right_deg == pytest.approx(thesis.right_deg, abs=0.1)
        assert mine.up_deg == pytest.approx(thesis.up_deg, abs=0.1)


def test_every_value_of_the_servo_has_a_source() -> None:
    rows = servos.Servo().rows
    assert len(rows) >= 10
    assert all(row["source"] and row["what"] and row["unit"] for row in rows)
    assert all(row["source"] for row in (*servos.others(), *servos.seen()))
    assert load(servos.SOURCE)["chosen"] in load(servos.SOURCE)


def test_hovering_propellers_turn_as_thrust_wants() -> None:
    # 8 x 0.117 x 1.225 x 85 squared x 0.254 to the fourth = 34.5 N, 3.5 kg
    f = figures()
    turns, disc_m = motion.hover_turns_hz(f), number("frame_propeller_diameter_mm") / 1e3
    lift_n = 8 * f.thrust_coefficient * f.air_density * turns**2 * disc_m**4
    assert lift_n == pytest.approx(f.vehicle_mass * 9.80665)
    assert turns == pytest.approx(85.0, abs=1.0)


def test_play_is_told_where_it_can_be_felt(solids: Rig) -> None:
    by_hand = 21.5 * math.radians(servos.life()["play_most_deg"])
    assert motion.play_mm(solids) == pytest.approx(by_hand)
