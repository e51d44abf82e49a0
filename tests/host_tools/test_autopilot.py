"""The simulated autopilot flies, arms, refuses and stops as ArduCopter does."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.modes import AUTO, BRAKE, GUIDED, LAND, LOITER, RTL
from echowing.sim.vehicle.parameters import Generation
from echowing.sim.world.leader import TrackedBody

from .autopilot_bench import (
    FORWARD_SONAR,
    POSITION_ONLY_YAW,
    POSITION_VELOCITY,
    SYSTEM_ID,
    VELOCITY_ONLY,
    Bench,
)

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
ARM, TAKE_OFF, SET_MODE = (
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_DO_SET_MODE,
)
CHANGE_SPEED, PAUSE = mavlink.MAV_CMD_DO_CHANGE_SPEED, mavlink.MAV_CMD_DO_PAUSE_CONTINUE
GROUND_SPEED = 1
CRUISE_S = (
    4.0  # 90 % of a step of the limit takes 1.2 to 1.4 s (cap_steps.csv): twice that, and more
)


def cruising(bench: Bench, seconds: float = CRUISE_S) -> float:
    bench.run(seconds)
    return bench.speed_mps


# ---- the speed limit --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("generation", "name", "units"),
    [
        (Generation.V4_5, "WPNAV_SPEED", 100.0),
        (Generation.V4_6, "WPNAV_SPEED", 100.0),
        (Generation.V4_7, "WP_SPD", 1.0),
        (Generation.V4_8, "WP_SPD", 1.0),
    ],
)
def test_the_parameter_is_the_limit_when_a_sub_mode_starts(
    generation: Generation, name: str, units: float
) -> None:
    bench = Bench(generation=generation, parameters={name: 2.0 * units})
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(2.0, abs=0.05)


def test_writing_the_parameter_alone_changes_nothing_in_guided() -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.run(CRUISE_S, lambda: bench.target(200.0))
    bench.autopilot.parameter_set("WP_SPD", 4.0)
    bench.run(CRUISE_S, lambda: bench.target(200.0))  # a streamed target makes no use of it either
    assert bench.speed_mps == pytest.approx(2.0, abs=0.05)


def test_entering_the_mode_again_reads_the_parameter() -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.target(200.0)
    bench.run(1.0)
    bench.autopilot.parameter_set("WP_SPD", 4.0)
    bench.autopilot.set_mode("LOITER")
    bench.autopilot.set_mode("GUIDED")
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(4.0, abs=0.1)


def test_another_sub_mode_reads_the_parameter_and_drops_the_limit_set_before() -> None:
    bench = Bench(parameters={"WP_SPD": 3.0})
    bench.target(200.0)
    bench.step()
    assert bench.autopilot.set_desired_speed(1.0)
    assert cruising(bench) == pytest.approx(1.0, abs=0.05)
    bench.target(200.0, mask=VELOCITY_ONLY, velocity=(1.0, 0.0, 0.0))
    bench.step()
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(3.0, abs=0.1)


def test_a_speed_set_before_the_first_target_is_lost() -> None:
    """Guided starts in its velocity sub-mode: the first position target starts another one."""
    bench = Bench(parameters={"WP_SPD": 3.0})
    bench.autopilot.set_desired_speed(1.0)
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(3.0, abs=0.1)


def test_change_speed_command() -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.target(200.0)
    bench.run(1.0)
    assert bench.command(CHANGE_SPEED, GROUND_SPEED, 4.0) == ACCEPTED
    assert cruising(bench) == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("speed_mps", [0.0, -1.0, math.nan])
def test_change_speed_to_nothing_is_denied(speed_mps: float) -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.target(200.0)
    bench.run(CRUISE_S)
    assert bench.command(CHANGE_SPEED, GROUND_SPEED, speed_mps) == DENIED
    assert cruising(bench) == pytest.approx(2.0, abs=0.05)


def test_change_speed_outside_guided_and_auto_fails() -> None:
    bench = Bench()
    bench.autopilot.set_mode("LOITER")
    assert bench.command(CHANGE_SPEED, GROUND_SPEED, 2.0) == FAILED
    assert not bench.autopilot.set_desired_speed(2.0)


def test_a_limit_of_zero_is_no_limit() -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.target(400.0)
    bench.run(1.0)
    assert bench.autopilot.set_desired_speed(0.0)
    assert cruising(bench, 8.0) > 8.0


def test_a_position_target_never_times_out() -> None:
    bench = Bench(parameters={"WP_SPD": 5.0})
    bench.target(30.0)  # said once; GUID_TIMEOUT is 3 s and the way takes over 6
    bench.run(15.0)
    assert bench.copter.north_m == pytest.approx(30.0, abs=0.1)


def test_a_velocity_target_times_out_after_3_s() -> None:
    bench = Bench()
    bench.target(0.0, mask=VELOCITY_ONLY, velocity=(2.0, 0.0, 0.0))
    assert cruising(bench, 2.9) > 1.8  # and rising: the controller is still learning the drag
    assert cruising(bench, 6.0) < 0.1


def test_with_velocity_the_limit_caps_the_correction_only() -> None:
    bench = Bench(parameters={"WP_SPD": 1.0})

    def stream() -> None:
        if bench.steps % 6 == 0:
            north_m = 2.0 * bench.t_s
            velocity = (2.0, 0.0, 0.0)
            bench.target(north_m, mask=POSITION_VELOCITY, velocity=velocity)

    bench.run(8.0, stream)
    assert bench.speed_mps == pytest.approx(2.0, abs=0.1)
    assert bench.copter.north_m == pytest.approx(2.0 * bench.t_s, abs=0.3)


# ---- floors and returns -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("generation", "name", "low", "floor"),
    [
        (Generation.V4_6, "WPNAV_SPEED", 5.0, 20.0),
        (Generation.V4_7, "WP_SPD", 0.05, 0.1),
        (Generation.V4_8, "WP_SPD", 0.001, 0.01),
    ],
)
def test_a_speed_under_its_floor_is_saved_as_the_floor_at_a_waypoint_start(
    generation: Generation, name: str, low: float, floor: float
) -> None:
    bench = Bench(generation=generation)
    bench.autopilot.parameter_set(name, low)
    bench.autopilot.set_mode("LOITER")
    bench.autopilot.set_mode("GUIDED")
    bench.target(50.0)
    bench.run(0.1)
    assert bench.autopilot.parameter_get(name) == pytest.approx(low)  # Guided is no waypoint start
    bench.autopilot.start_mission([(50.0, 0.0, -10.0)])
    assert bench.autopilot.parameter_get(name) == pytest.approx(floor)
    assert bench.autopilot.parameters.saved[name] == pytest.approx(floor)


def test_a_return_flies_at_the_speed_parameter_climbs_waits_and_lands() -> None:
    bench = Bench(parameters={"WP_SPD": 3.0, "RTL_LOIT_TIME": 1000.0})
    bench.target(40.0)
    bench.run(20.0)
    assert bench.copter.north_m == pytest.approx(40.0, abs=0.2)
    bench.autopilot.parameter_set("WP_SPD", 1.5)  # a low value left behind
    assert bench.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    assert bench.autopilot.mode_number() == RTL
    fastest = 0.0
    for _ in range(50):
        bench.run(1.0)
        fastest = max(fastest, bench.speed_mps)
        if bench.copter.north_m > 5.0:
            highest_m = -bench.copter.down_m
    assert fastest == pytest.approx(1.5, abs=0.1)
    assert highest_m == pytest.approx(15.0, abs=0.2)  # RTL_ALT_M
    bench.run(30.0)
    assert bench.copter.landed
    assert not bench.autopilot.armed()


def test_a_return_has_a_speed_of_its_own_if_one_is_given() -> None:
    bench = Bench(generation=Generation.V4_6, parameters={"WPNAV_SPEED": 100.0, "RTL_SPEED": 300.0})
    bench.target(40.0)
    bench.run(50.0)
    bench.autopilot.set_mode("RTL")
    bench.run(9.0)  # 5 m up at 2.5 m/s, then on the way
    assert bench.speed_mps == pytest.approx(3.0, abs=0.1)


# ---- targets ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "alt_m"),
    [
        (mavlink.MAV_FRAME_GLOBAL_INT, 262.0),
        (mavlink.MAV_FRAME_GLOBAL, 262.0),
        (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 12.0),
        (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, 12.0),
        (mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT, 12.0),
    ],
)
def test_altitude_frames(frame: int, alt_m: float) -> None:
    bench = Bench()
    bench.target(5.0, 3.0, alt_m, frame=frame)
    bench.run(12.0)
    assert bench.copter.north_m == pytest.approx(5.0, abs=0.1)
    assert bench.copter.east_m == pytest.approx(3.0, abs=0.1)
    assert bench.copter.down_m == pytest.approx(-12.0, abs=0.1)


def test_the_altitude_above_home_is_home_s() -> None:
    bench = Bench()
    bench.autopilot.places.home_ned_m = (0.0, 0.0, 2.0)  # 2 m under the origin
    bench.target(0.0, 0.0, 10.0)
    bench.run(8.0)
    assert bench.copter.down_m == pytest.approx(-8.0, abs=0.1)


def test_yaw_in_a_target_and_without() -> None:
    bench = Bench()
    bench.target(20.0, mask=POSITION_ONLY_YAW, yaw_rad=1.5)
    bench.run(4.0)
    assert bench.copter.yaw_rad == pytest.approx(1.5, abs=0.05)
    bench.target(20.0, 40.0)  # without yaw it looks along its way: east
    bench.run(6.0)
    assert bench.copter.yaw_rad == pytest.approx(math.pi / 2, abs=0.1)


@pytest.mark.parametrize(
    "bad",
    [
        {"lat_e7": 910_000_000, "lon_e7": 0, "alt_m": 10.0},
        {"lat_e7": 0, "lon_e7": 1_810_000_000, "alt_m": 10.0},
        {"lat_e7": 393_400_000, "lon_e7": -860_300_000, "alt_m": math.nan},
        {
            "lat_e7": 393_400_000,
            "lon_e7": -860_300_000,
            "alt_m": 10.0,
            "frame": mavlink.MAV_FRAME_LOCAL_NED,
        },
        {
            "lat_e7": 393_400_000,
            "lon_e7": -860_300_000,
            "alt_m": 10.0,
            "mask": 0x0DFF,
        },  # nothing wanted
        {
            "lat_e7": 393_400_000,
            "lon_e7": -860_300_000,
            "alt_m": 10.0,
            "mask": 0x0C38,
        },  # acceleration
        {
            "lat_e7": 393_400_000,
            "lon_e7": -860_300_000,
            "alt_m": 10.0,
            "mask": POSITION_VELOCITY,
            "frame": mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
        },
        {
            "lat_e7": 0,
            "lon_e7": 0,
            "alt_m": 10.0,
            "mask": VELOCITY_ONLY,
            "velocity": (math.nan, 0.0, 0.0),
        },
    ],
)
def test_invalid_fields_stop_the_vehicle_and_reset_the_limit(bad: dict[str, Any]) -> None:
    bench = Bench(parameters={"WP_SPD": 3.0})
    bench.target(200.0)
    bench.step()
    bench.autopilot.set_desired_speed(1.0)
    bench.run(CRUISE_S)
    bench.raw_target(**bad)
    assert cruising(bench) < 0.1
    assert bench.autopilot.mode_number() == GUIDED
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    ("lat_e7", "mask"),
    [(393_400_000, 0x0C00 | 0x200 | 0x38), (393_400_000, 0x0200)],
)
def test_forces_are_not_flown(lat_e7: int, mask: int) -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.target(200.0)
    bench.run(CRUISE_S)
    bench.raw_target(lat_e7, -860_300_000, 10.0, mask=mask)
    assert cruising(bench) == pytest.approx(2.0, abs=0.05)  # the former target stays


def test_any_ignored_part_leaves_the_whole_group_out() -> None:
    bench = Bench(parameters={"WP_SPD": 5.0})
    bench.target(200.0, mask=0x0DC0 | 0x4, velocity=(1.0, 0.0, 0.0))  # only z of the place ignored
    assert cruising(bench, 2.5) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("frame", "position", "expected"),
    [
        (mavlink.MAV_FRAME_LOCAL_NED, (4.0, 3.0, -10.0), (4.0, 3.0)),
        (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, (4.0, 0.0, 0.0), (4.0, 2.0)),
        (mavlink.MAV_FRAME_BODY_OFFSET_NED, (4.0, 0.0, 0.0), (0.0, 6.0)),
        (mavlink.MAV_FRAME_BODY_NED, (0.0, 1.0, 0.0), (-1.0, 2.0)),
    ],
)
def test_local_frames(
    frame: int, position: tuple[float, float, float], expected: tuple[float, float]
) -> None:
    bench = Bench()
    bench.copter.east_m, bench.copter.yaw_rad = 2.0, math.pi / 2  # 2 m east, looking east
    bench.autopilot.set_mode("LOITER")
    bench.autopilot.set_mode("GUIDED")
    bench.local_target(position, frame=frame)
    bench.run(8.0)
    assert (bench.copter.north_m, bench.copter.east_m) == pytest.approx(expected, abs=0.1)
    assert bench.copter.down_m == pytest.approx(-10.0, abs=0.1)


def test_a_local_target_in_an_unknown_frame_stops() -> None:
    bench = Bench(parameters={"WP_SPD": 3.0})
    bench.local_target((50.0, 0.0, -10.0))
    bench.run(CRUISE_S)
    bench.local_target((50.0, 0.0, -10.0), frame=mavlink.MAV_FRAME_GLOBAL)
    assert cruising(bench, 6.0) < 0.1


def test_body_velocity_turns_with_the_vehicle() -> None:
    bench = Bench()
    bench.copter.yaw_rad = math.pi / 2
    bench.local_target(
        (0.0, 0.0, 0.0),
        mask=VELOCITY_ONLY,
        velocity=(2.0, 0.0, 0.0),
        frame=mavlink.MAV_FRAME_BODY_NED,
    )
    bench.run(2.9)
    assert bench.copter.vn_mps == pytest.approx(0.0, abs=0.05)
    assert bench.copter.ve_mps > 1.8


def test_targets_outside_guided_are_ignored() -> None:
    bench = Bench()
    bench.autopilot.set_mode("LOITER")
    bench.target(20.0)
    bench.run(CRUISE_S)
    assert abs(bench.copter.north_m) < 0.1
    bench.autopilot.set_mode("GUIDED")
    bench.run(CRUISE_S)  # nor are they kept for later
    assert abs(bench.copter.north_m) < 0.1
    assert not bench.heard("POSITION_TARGET_GLOBAL_INT")


@pytest.mark.parametrize("outside", [(200.0, 0.0, 10.0), (10.0, 0.0, 120.0)])
@pytest.mark.parametrize("mask", [0x0DF8, POSITION_VELOCITY])
def test_a_target_outside_the_fence_is_refused_in_silence(
    outside: tuple[float, float, float], mask: int
) -> None:
    bench = Bench(parameters={"FENCE_ENABLE": 1.0, "WP_SPD": 5.0})  # radius 150 m, height 100 m
    bench.target(40.0)
    bench.step()
    bench.forget()
    bench.target(*outside, mask=mask)
    bench.run(20.0)
    assert bench.copter.north_m == pytest.approx(40.0, abs=0.1)
    assert -bench.copter.down_m == pytest.approx(10.0, abs=0.1)
    assert not bench.texts()
    assert not bench.heard("COMMAND_ACK")
    bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 87)
    told = bench.heard("POSITION_TARGET_GLOBAL_INT")[-1]
    assert told.lat_int == pytest.approx(393_400_000 + 40.0 / 111_000 * 1e7, abs=10.0)


def test_without_a_fence_the_same_target_is_flown() -> None:
    bench = Bench(parameters={"WP_SPD": 5.0})
    bench.target(200.0)
    bench.run(20.0)
    assert bench.copter.north_m > 50.0


def test_position_target_is_told_for_positions_only() -> None:
    bench = Bench()
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 87) == FAILED  # no target yet
    bench.target(20.0, 10.0, 12.0)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 87) == ACCEPTED
    told = bench.heard("POSITION_TARGET_GLOBAL_INT")[-1]
    assert told.coordinate_frame == mavlink.MAV_FRAME_GLOBAL
    assert told.alt == pytest.approx(262.0, abs=0.01)
    bench.target(20.0, mask=POSITION_VELOCITY)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 87) == FAILED
    assert bench.autopilot.get_target_location() is None


# ---- pause ------------------------------------------------------------------------------------


def test_while_paused_targets_wait_until_continued() -> None:
    bench = Bench(parameters={"WP_SPD": 4.0})
    bench.target(200.0)
    bench.step()
    bench.autopilot.set_desired_speed(2.0)
    bench.run(CRUISE_S)
    assert bench.command(PAUSE, 0.0) == ACCEPTED
    stopped = cruising(bench)
    north_m = bench.copter.north_m
    bench.target(north_m, 50.0)
    bench.run(CRUISE_S)
    assert stopped < 0.05
    assert bench.copter.east_m == pytest.approx(0.0, abs=0.1)
    assert bench.command(PAUSE, 1.0) == ACCEPTED
    assert cruising(bench) == pytest.approx(2.0, abs=0.1)  # the limit was kept
    assert bench.copter.ve_mps == pytest.approx(2.0, abs=0.1)


def test_pause_elsewhere_fails_and_nonsense_is_denied() -> None:
    bench = Bench()
    assert bench.command(PAUSE, 7.0) == DENIED
    bench.autopilot.set_mode("LOITER")
    assert bench.command(PAUSE, 0.0) == FAILED


def test_leaving_guided_ends_the_pause() -> None:
    bench = Bench(parameters={"WP_SPD": 2.0})
    bench.command(PAUSE, 0.0)
    bench.autopilot.set_mode("LOITER")
    bench.autopilot.set_mode("GUIDED")
    bench.target(200.0)
    assert cruising(bench) == pytest.approx(2.0, abs=0.05)


def test_reposition() -> None:
    reposition = mavlink.MAV_CMD_DO_REPOSITION
    bench = Bench(parameters={"FENCE_ENABLE": 1.0})
    where = (393_401_000, -860_300_000, 10.0)  # 11.1 m north
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    assert bench.command_int(reposition, frame, -1.0, 0.0, 0.0, 0.0, *where) == ACCEPTED
    bench.run(10.0)
    assert bench.copter.north_m == pytest.approx(11.1, abs=0.1)
    far = (393_500_000, -860_300_000, 10.0)
    assert bench.command_int(reposition, frame, -1.0, 0.0, 0.0, 0.0, *far) == FAILED
    bench.autopilot.set_mode("LOITER")
    assert bench.command_int(reposition, frame, -1.0, 0.0, 0.0, 0.0, *where) == DENIED
    assert bench.command_int(reposition, frame, -1.0, 1.0, 0.0, 0.0, *where) == ACCEPTED
    assert bench.autopilot.mode_number() == GUIDED


# ---- modes, arming, take-off ------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0, GUIDED, LOITER, RTL, LAND, BRAKE])
def test_modes_by_command_and_by_message(mode: int) -> None:
    bench = Bench()
    assert bench.command(SET_MODE, 1.0, float(mode)) == ACCEPTED
    bench.run(1.0)
    assert bench.heard("HEARTBEAT")[-1].custom_mode == mode
    bench = Bench()
    bench.send(mavlink.MAVLink_set_mode_message(SYSTEM_ID, 1, mode))
    bench.run(1.0)
    assert bench.heard("HEARTBEAT")[-1].custom_mode == mode
    assert bench.heard("COMMAND_ACK")[-1].result == ACCEPTED


def test_modes_that_cannot_be() -> None:
    bench = Bench()
    assert bench.command(SET_MODE, 1.0, 77.0) == FAILED
    assert bench.command(SET_MODE, 1.0, float(AUTO)) == FAILED  # no mission
    assert bench.command(SET_MODE, 0.0, float(LOITER)) == DENIED  # no custom mode named
    assert bench.command(SET_MODE, 1.0, 23.0) == FAILED
    assert bench.autopilot.mode_number() == GUIDED


def test_arm_take_off_land() -> None:
    bench = Bench(flying=False)
    assert bench.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 5.0) == FAILED  # neither armed nor in Guided
    bench.command(SET_MODE, 1.0, float(GUIDED))
    assert bench.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 5.0) == FAILED
    assert bench.command(ARM, 1.0) == ACCEPTED
    assert bench.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 0.0) == FAILED
    assert bench.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 5.0) == ACCEPTED
    bench.run(10.0)
    assert -bench.copter.down_m == pytest.approx(5.0, abs=0.1)
    assert bench.autopilot.flying()
    beat = bench.heard("HEARTBEAT")[-1]
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert beat.system_status == mavlink.MAV_STATE_ACTIVE
    assert bench.command(ARM, 0.0) == FAILED  # not in the air
    assert bench.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 9.0) == FAILED
    assert bench.command(SET_MODE, 1.0, float(LAND)) == ACCEPTED
    bench.run(20.0)
    assert bench.copter.landed
    assert not bench.heard("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_armed_on_the_ground_disarms_itself_after_10_s() -> None:
    bench = Bench(flying=False)
    bench.command(ARM, 1.0)
    bench.run(9.5)
    assert bench.autopilot.armed()
    bench.run(1.0)  # DISARM_DELAY 10
    assert not bench.autopilot.armed()


def test_a_silent_rangefinder_refuses_arming() -> None:
    bench = Bench(flying=False, parameters=FORWARD_SONAR)
    bench.command(SET_MODE, 1.0, float(GUIDED))
    assert bench.command(ARM, 1.0) == FAILED
    assert bench.texts()[-1] == "Arm: Rangefinder 1: No Data"
    assert bench.command(ARM, 1.0, 21196.0) == ACCEPTED  # forced


def test_out_of_range_does_not_refuse_arming() -> None:
    bench = Bench(flying=False, parameters=FORWARD_SONAR)
    bench.sonar(900)
    bench.step()
    assert bench.autopilot.rangefinder_status(0) == 3
    assert bench.command(ARM, 1.0) == ACCEPTED


@pytest.mark.parametrize(
    ("generation", "parameter", "value", "result"),
    [
        (Generation.V4_6, "ARMING_CHECK", 0.0, ACCEPTED),
        (Generation.V4_6, "ARMING_CHECK", 8.0, ACCEPTED),
        (Generation.V4_6, "ARMING_CHECK", float(1 << 15), FAILED),
        (Generation.V4_8, "ARMING_SKIPCHK", float(1 << 15), ACCEPTED),
        (Generation.V4_8, "ARMING_SKIPCHK", -1.0, ACCEPTED),
        (Generation.V4_8, "ARMING_SKIPCHK", 8.0, FAILED),
    ],
)
def test_arming_checks_can_be_left_out(
    generation: Generation, parameter: str, value: float, result: int
) -> None:
    parameters = {**FORWARD_SONAR, parameter: value}
    bench = Bench(flying=False, generation=generation, parameters=parameters)
    assert bench.command(ARM, 1.0) == result


def test_the_reason_not_to_arm_is_told_every_30_s() -> None:
    bench = Bench(flying=False, parameters=FORWARD_SONAR)
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.run(61.0)
    assert bench.texts().count("PreArm: Rangefinder 1: No Data") == 2


def test_auxiliary_authorisation() -> None:
    bench = Bench(flying=False)
    autopilot = bench.autopilot
    first, second, third = (autopilot.aux_auth_id() for _ in range(3))
    assert (first, second, third) == (0, 1, 2)
    assert autopilot.aux_auth_id() is None  # three a vehicle
    assert bench.command(ARM, 1.0) == FAILED  # nobody has answered
    autopilot.aux_auth_passed(0)
    autopilot.aux_auth_failed(1, "sonar upside down")
    autopilot.aux_auth_passed(2)
    assert bench.command(ARM, 1.0) == FAILED
    assert bench.texts()[-1] == "Arm: sonar upside down"
    autopilot.aux_auth_passed(1)
    assert bench.command(ARM, 1.0) == ACCEPTED


def test_not_armable_in_return() -> None:
    bench = Bench(flying=False)
    bench.command(SET_MODE, 1.0, float(RTL))
    assert bench.command(ARM, 1.0) == FAILED
    assert "Mode not armable" in bench.texts()[-1]


def test_unknown_commands_are_unsupported() -> None:
    assert Bench().command(mavlink.MAV_CMD_DO_PARACHUTE) == UNSUPPORTED


# ---- missions, fail-safe ----------------------------------------------------------------------


def test_auto_flies_its_waypoints_at_its_speed() -> None:
    bench = Bench()
    bench.autopilot.start_mission([(30.0, 0.0, -10.0), (30.0, 20.0, -10.0)], 2.0)
    bench.run(10.0)
    assert bench.autopilot.mode_number() == AUTO
    assert bench.copter.vn_mps == pytest.approx(2.0, abs=0.05)
    bench.run(30.0)
    assert (bench.copter.north_m, bench.copter.east_m) == pytest.approx((30.0, 20.0), abs=0.2)


def test_gcs_fail_safe_is_off_by_default_and_returns_when_on() -> None:
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for wish, mode in ((0.0, GUIDED), (1.0, RTL), (5.0, LAND)):
        bench = Bench(parameters={"FS_GCS_ENABLE": wish})
        bench.send(beat, source=(255, 190))
        bench.run(4.9)
        assert bench.autopilot.mode_number() == GUIDED
        bench.run(0.3)  # FS_GCS_TIMEOUT 5 s
        assert bench.autopilot.mode_number() == mode


def test_another_tool_s_heartbeat_does_not_hold_the_fail_safe_off() -> None:
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    bench = Bench(parameters={"FS_GCS_ENABLE": 1.0})
    bench.send(beat, source=(255, 190))
    bench.run(6.0, lambda: bench.send(beat))  # the tool's id is 245
    assert bench.autopilot.mode_number() == RTL


# ---- the estimate, RC, restart ----------------------------------------------------------------


def test_drift_moves_what_is_reported_and_flown_not_the_truth_at_once() -> None:
    bench = Bench()
    bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 33.0, 20_000.0)
    bench.autopilot.set_errors((3.0, 0.0, 0.5), (0.0, 0.0), 0.0)
    bench.step()
    told = bench.position()
    assert (told.lat_deg - 39.34) * 111_000 == pytest.approx(3.0, abs=0.05)
    assert told.alt_m == pytest.approx(259.5, abs=0.01)
    bench.target(0.0)
    bench.run(10.0)
    assert bench.copter.north_m == pytest.approx(-3.0, abs=0.1)  # flies to where it believes 0 is


@pytest.mark.parametrize(
    ("pwm", "position"),
    [
        (1100, 0),
        (1199, 0),
        (1201, 1),
        (1500, 1),
        (1800, 1),
        (1801, 2),
        (1900, 2),
        (0, None),
        (800, None),
        (2200, None),
    ],
)
def test_switch_positions(pwm: int, position: int | None) -> None:
    bench = Bench(parameters={"RC9_OPTION": 300.0})
    bench.autopilot.set_rc(9, pwm)
    assert bench.autopilot.rc_option_position(300) == position
    assert bench.autopilot.rc_option_position(301) is None


def test_rc_channels_are_reported() -> None:
    bench = Bench()
    bench.autopilot.set_rc(5, 1234)
    bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_RC_CHANNELS)
    assert bench.heard("RC_CHANNELS")[-1].chan5_raw == 1234


def test_restart_forgets_what_was_only_set_and_starts_the_clock_again() -> None:
    reboot = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    bench = Bench(flying=False)
    bench.run(5.0)
    bench.autopilot.parameter_set("WP_SPD", 1.0)
    bench.autopilot.parameter_save("WP_RADIUS_M", 1.0)
    bench.autopilot.arm_and_fly(5.0)
    assert bench.command(reboot, 1.0) == FAILED  # armed
    bench = Bench(flying=False)
    bench.run(5.0)
    bench.autopilot.parameter_set("WP_SPD", 1.0)
    bench.autopilot.parameter_save("WP_RADIUS_M", 1.0)
    assert bench.command(reboot, 1.0) == ACCEPTED
    bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME)
    assert bench.heard("SYSTEM_TIME")[-1].time_boot_ms < 100
    assert bench.autopilot.parameter_get("WP_SPD") == 10.0
    assert bench.autopilot.parameter_get("WP_RADIUS_M") == 1.0
    assert bench.autopilot.system_id == SYSTEM_ID


def test_a_carried_body_needs_no_controls() -> None:
    body = TrackedBody([(0.0, 0.0, 0.0, -2.0, 0.0), (10.0, 10.0, 0.0, -2.0, 0.0)])
    autopilot = Autopilot(body, system_id=1)
    assert autopilot.armed()
    assert autopilot.set_mode("LOITER")
    assert not isinstance(body, Copter)
