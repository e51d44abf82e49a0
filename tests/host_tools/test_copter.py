"""The copter's motion: what the autopilot's rules say, and what recordings of it showed."""

import math
import statistics
from collections.abc import Callable
from dataclasses import replace

import pytest

from echowing.sim.vehicle.copter import HOVER_THROTTLE, Copter, tuning_of, wrap_pi
from echowing.sim.vehicle.guided import Guided
from echowing.sim.vehicle.parameters import Generation, Parameters
from echowing.sim.vehicle.wpnav import LeanLimits, TrackLimits

STEP_S = 0.02
START = (0.0, 0.0, -10.0)


def fly(
    copter: Copter, duration_s: float, each: Callable[[float], None] | None = None
) -> list[tuple[float, float, float]]:
    """Step the copter; gives (time, north, speed north) after every step."""
    track = []
    for count in range(round(duration_s / STEP_S)):
        if each is not None:
            each(count * STEP_S)
        copter.step(STEP_S)
        track.append(((count + 1) * STEP_S, copter.north_m, copter.vn_mps))
    return track


def guided(speed_limit_mps: float = 5.0) -> Copter:
    copter = Copter(START, flying=True)
    copter.start_guided(speed_limit_mps)
    return copter


def test_stays_where_it_is_without_a_target() -> None:
    copter = guided()
    fly(copter, 10.0)
    assert (copter.north_m, copter.east_m, copter.down_m) == pytest.approx(START, abs=1e-9)


def test_streamed_position_is_trailed_by_the_recorded_distance() -> None:
    # ArduCopter settles 2.2 m behind a position-only target that moves at 2 m/s, sent at 8 Hz.
    copter = guided()
    sent = 0.0

    def stream(time_s: float) -> None:
        nonlocal sent
        if time_s >= sent:
            copter.guided_position((2.0 * time_s, 0.0, -10.0))
            sent += 0.125

    track = fly(copter, 20.0, stream)
    behind = [2.0 * time_s - north for time_s, north, _ in track if time_s > 15.0]
    assert sum(behind) / len(behind) == pytest.approx(2.2, abs=0.1)


@pytest.mark.parametrize("generation", [Generation.V4_5, Generation.V4_6, Generation.V4_7])
def test_before_4_8_a_moving_target_is_trailed_by_more(generation: Generation) -> None:
    # In the recordings `stream_pos_2mps`, 12 s to 19.5 s, the mean way to the last target is 1.99 m
    # with ArduCopter 4.8 and 2.23 m with 4.6 and 4.7.
    assert trail_m(Generation.V4_8) == pytest.approx(1.99, abs=0.03)
    assert trail_m(generation) == pytest.approx(2.23, abs=0.03)


def trail_m(generation: Generation) -> float:
    """Mean way to a position target that moves at 2 m/s, sent at 8 Hz."""
    copter = Copter(START, tuning=tuning_of(generation), flying=True)
    copter.start_guided(5.0)
    ways: list[float] = []
    target_m = 0.0
    for count in range(round(19.5 / STEP_S)):
        if int(count * STEP_S * 8) != int((count - 1) * STEP_S * 8):
            target_m = 2.0 * count * STEP_S
            copter.guided_position((target_m, 0.0, -10.0))
        copter.step(STEP_S)
        if count * STEP_S > 12.0:
            ways.append(target_m - copter.north_m)
    return sum(ways) / len(ways)


def test_position_and_velocity_settles_on_the_target() -> None:
    copter = guided()
    track = fly(
        copter, 20.0, lambda time_s: copter.guided_posvel((2.0 * time_s, 0, -10), (2.0, 0, 0))
    )
    assert track[-1][1] == pytest.approx(2.0 * track[-1][0], abs=0.1)


@pytest.mark.parametrize("generation", [Generation.V4_6, Generation.V4_8])
def test_a_point_that_brakes_is_followed_sooner_with_its_acceleration(
    generation: Generation,
) -> None:
    """From 2 m/s at 2.5 m/s2: by WP_ACC / PSC_JERK_NE, the time by which shaping is late.

    input_pos_vel_accel of AC_PosControl adds the acceleration to what corrects, and carries the
    point on with it.
    """
    late_m = furthest_past_m(generation, 0.0) - furthest_past_m(generation, 2.5)
    assert 0.15 < late_m < 0.5  # 2.5 m/s2 / (20 m/s3 / 5 m/s2) = 0.25 s at up to 2 m/s


def furthest_past_m(generation: Generation, told_mps2: float) -> float:
    """How far the vehicle flies past a point that brakes to a stop."""
    limits = replace(TrackLimits(), acceleration_mps2=5.0, shaping_jerk_mps3=20.0)
    copter = Copter(START, tuning=tuning_of(generation), flying=True)
    copter.set_limits(limits)
    copter.start_guided(5.0)
    past_m = 0.0
    for count in range(round(14.0 / STEP_S)):
        time_s = count * STEP_S
        braking_s = min(0.8, max(0.0, time_s - 10.0))
        mps = 2.0 - 2.5 * braking_s
        place_m = 2.0 * min(time_s, 10.0 + braking_s) - 1.25 * braking_s**2
        acceleration = (-told_mps2 if 0.0 < braking_s < 0.8 else 0.0, 0.0, 0.0)
        copter.guided_posvel(
            (place_m, 0.0, -10.0), (mps, 0.0, 0.0), acceleration_ned_mps2=acceleration
        )
        copter.step(STEP_S)
        if time_s > 9.0:
            past_m = max(past_m, copter.north_m - place_m)
    return past_m


def test_limit_holds_back_only_the_correction_of_a_moving_target() -> None:
    copter = guided()
    copter.guided_posvel((0.0, 0.0, -10.0), (2.0, 0.0, 0.0))
    copter.set_speed_limit(1.0)
    track = fly(
        copter, 30.0, lambda time_s: copter.guided_posvel((2.0 * time_s, 0, -10), (2.0, 0, 0))
    )
    fastest = max(speed for _, _, speed in track)
    assert fastest == pytest.approx(3.1, abs=0.15)  # 2 m/s and at most 1 m/s more, as recorded
    assert track[-1][1] == pytest.approx(60.0, abs=0.1)


def test_limit_caps_the_whole_speed_towards_a_position() -> None:
    copter = guided(1.0)
    copter.guided_position((50.0, 0.0, -10.0))
    track = fly(copter, 20.0)
    assert track[-1][2] == pytest.approx(1.0, abs=0.01)
    assert max(speed for _, _, speed in track) < 1.1


def test_limit_of_zero_is_no_limit() -> None:
    copter = guided(1.0)
    copter.guided_position((200.0, 0.0, -10.0))
    copter.set_speed_limit(0.0)
    assert max(speed for _, _, speed in fly(copter, 20.0)) > 9.0


def test_response_to_the_limit_is_the_recorded_one() -> None:
    # Recorded: dead time about 0.3 s, 63 % after 1.0-1.1 s, 90 % after 1.2-1.4 s (rising, 3 m/s),
    # and 2.3 m travelled from 2.5 to 0.5 m/s.
    copter = guided(0.5)
    copter.guided_position((500.0, 0.0, -10.0))
    fly(copter, 10.0)
    copter.set_speed_limit(3.5)
    rise = fly(copter, 10.0)
    assert first_time(rise, lambda speed: speed > 0.5 + 0.05 * 3.0) == pytest.approx(0.45, abs=0.1)
    assert first_time(rise, lambda speed: speed > 0.5 + 0.63 * 3.0) == pytest.approx(1.1, abs=0.12)
    assert first_time(rise, lambda speed: speed > 0.5 + 0.9 * 3.0) == pytest.approx(1.35, abs=0.15)
    copter.set_speed_limit(2.5)
    fly(copter, 10.0)
    copter.set_speed_limit(0.5)
    begin = copter.north_m
    fall = fly(copter, 10.0)
    reached = next(north for _, north, speed in fall if speed < 0.55)
    assert reached - begin == pytest.approx(2.3, abs=0.2)


def first_time(
    track: list[tuple[float, float, float]], condition: Callable[[float], bool]
) -> float:
    return next(time_s for time_s, _, speed in track if condition(speed))


def test_position_target_never_times_out() -> None:
    copter = guided(2.0)
    copter.guided_position((60.0, 0.0, -10.0))
    fly(copter, 60.0)
    assert copter.north_m == pytest.approx(60.0, abs=0.01)


def test_velocity_target_times_out_after_three_seconds() -> None:
    copter = guided()
    copter.guided_velocity((2.0, 0.0, 0.0))
    fly(copter, 2.9)
    assert copter.vn_mps > 1.8  # and rising: the controller is still learning the drag
    fly(copter, 5.0)
    assert abs(copter.vn_mps) < 0.1


def test_moving_point_stops_after_three_seconds_of_silence() -> None:
    copter = guided()
    copter.guided_posvel((0.0, 0.0, -10.0), (2.0, 0.0, 0.0))
    fly(copter, 20.0)
    assert copter.north_m == pytest.approx(6.0, abs=0.1)  # 3 s at 2 m/s


def test_new_sub_mode_reads_the_limit_of_the_parameter_again() -> None:
    copter = guided(5.0)
    copter.guided_position((200.0, 0.0, -10.0))
    copter.set_speed_limit(1.0)
    fly(copter, 8.0)
    copter.guided_velocity((1.0, 0.0, 0.0))
    copter.guided_position((200.0, 0.0, -10.0))
    fly(copter, 8.0)
    assert copter.vn_mps == pytest.approx(5.0, abs=0.1)


def test_changing_the_parameter_alone_changes_nothing() -> None:
    copter = guided(1.0)
    copter.guided_position((200.0, 0.0, -10.0))
    copter.default_speed_mps = 5.0
    fly(copter, 8.0)
    assert copter.vn_mps == pytest.approx(1.0, abs=0.05)


def test_drifting_estimate_moves_the_vehicle_the_other_way() -> None:
    copter = guided()
    copter.guided_position(START)

    def drift(time_s: float) -> None:
        copter.set_estimate_offset((0.05 * time_s, -0.02 * time_s, 0.01 * time_s))

    fly(copter, 40.0, drift)
    assert copter.north_m == pytest.approx(-2.0, abs=0.1)
    assert copter.east_m == pytest.approx(0.8, abs=0.05)
    assert copter.down_m == pytest.approx(-10.4, abs=0.05)
    assert copter.est_north_m == pytest.approx(0.0, abs=0.1)
    assert copter.est_down_m == pytest.approx(-10.0, abs=0.05)


def test_jump_of_the_estimate_pulls_no_harder_than_the_limit() -> None:
    copter = guided(1.0)
    copter.guided_position(START)
    copter.set_estimate_offset((30.0, 0.0, 0.0))
    track = fly(copter, 60.0)
    assert (
        min(speed for _, _, speed in track) > -2.5
    )  # the leash: correction and return, 1 m/s each
    assert copter.north_m == pytest.approx(-30.0, abs=0.1)


def flown_after_a_reset(
    generation: Generation, again: Callable[[Copter], None] | None = None
) -> list[tuple[float, float, float]]:
    """North at 1 m/s, ten points a second; then its filter resets by 12 m to the east.

    again: what it is told half a second later, ten times a second. Every 20 ms since the reset: way
    east, speed north and east.
    """
    copter = Copter(START, flying=True, tuning=tuning_of(generation))
    copter.start_guided(10.0)
    track = []
    for count in range(1050):
        time_s = count * STEP_S
        if count % 5 == 0:
            if again is not None and time_s > 10.49:
                again(copter)
            else:
                copter.guided_posvel((time_s, 0.0, START[2]), (1.0, 0.0, 0.0))
        if time_s == pytest.approx(10.0):
            copter.set_estimate_offset((0.0, 12.0, 0.0))
            copter.estimate_reset((0.0, 12.0, 0.0))
        copter.step(STEP_S)
        if time_s > 9.99:
            track.append((copter.east_m, copter.vn_mps, copter.ve_mps))
    return track


# Fastest west, slowest north meanwhile (m/s), and seconds between 1 and 3.75 m/s.
@pytest.mark.parametrize(
    ("generation", "sitl"),
    [(Generation.V4_8, (-5.13, 0.93, 0.91)), (Generation.V4_6, (-4.05, 0.60, 1.12))],
)
def test_a_reset_of_the_filter_is_flown_as_sitl_flies_it(
    generation: Generation, sitl: tuple[float, float, float]
) -> None:
    """SITL 4.8 and 4.6 (SIMSTATE): a receiver that jumps is rejected for ten seconds, then taken.

    The vehicle begins to move half a second after that, and not at the full lean.
    """
    track = flown_after_a_reset(generation)
    west_mps = [-east for _, _, east in track]
    took = [next(i for i, mps in enumerate(west_mps) if mps > limit) for limit in (1.0, 3.75)]
    assert max(west_mps) == pytest.approx(-sitl[0], abs=0.1)
    assert min(north for _, north, _ in track[:150]) == pytest.approx(sitl[1], abs=0.1)
    assert (took[1] - took[0]) * STEP_S == pytest.approx(sitl[2], abs=0.06)
    assert min(east for east, _, _ in track[:25]) > -0.1


def test_a_new_place_alone_does_not_end_the_way_back_after_a_reset() -> None:
    """Told to stay where it believes to be, SITL 4.8 went 3.07 m towards the old place.

    Told a velocity of nothing first, it went 1.28 m: a sub-mode that begins forgets the old place.
    """

    def stay(copter: Copter) -> None:
        copter.guided_posvel((10.5, 12.0, START[2]), (0.0, 0.0, 0.0))

    def stop_and_stay(copter: Copter) -> None:
        if not stopped:
            stopped.append(True)
            copter.guided_velocity((0.0, 0.0, 0.0))
        stay(copter)

    stopped: list[bool] = []
    ways_m = [
        -min(east for east, _, _ in flown_after_a_reset(Generation.V4_8, told))
        for told in (stay, stop_and_stay)
    ]
    assert ways_m == pytest.approx([3.07, 1.28], abs=0.35)


def test_who_has_no_absolute_place_stays_where_it_is_when_its_filter_resets() -> None:
    for generation in Generation:
        copter = Copter(START, flying=True, tuning=tuning_of(generation))
        copter.hold()
        copter.set_estimate_offset((30.0, 0.0, 2.0))
        copter.estimate_reset((30.0, 0.0, 2.0))
        fly(copter, 10.0)
        assert (copter.north_m, copter.down_m) == pytest.approx((0.0, START[2]), abs=0.01)


@pytest.mark.parametrize("angle_rad", [0.7, math.pi / 2, -2.2])
def test_no_direction_is_special(angle_rad: float) -> None:
    straight, turned = guided(), guided()
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)

    def turn(north: float, east: float) -> tuple[float, float, float]:
        return north * cosine - east * sine, north * sine + east * cosine, -10.0

    for target in ((20.0, 0.0), (20.0, 10.0), (0.0, 5.0)):
        straight.guided_position((*target, -10.0))
        turned.guided_position(turn(*target))
        for _ in range(150):
            straight.step(STEP_S)
            turned.step(STEP_S)
        north, east, _ = turn(straight.north_m, straight.east_m)
        # Each axis of the lean has limits of its own (ATC_ACC_R_MAX, ATC_ACC_P_MAX), as it has in
        # ArduCopter: along both at once a little more is possible.
        assert (turned.north_m, turned.east_m) == pytest.approx((north, east), abs=0.005)


def test_mirrored_flight_is_the_mirrored_trajectory() -> None:
    right, left = guided(), guided()
    for target in ((20.0, 15.0), (-5.0, 10.0)):
        right.guided_position((*target, -10.0))
        left.guided_position((target[0], -target[1], -10.0))
        fly(right, 4.0)
        fly(left, 4.0)
        assert (left.north_m, left.east_m) == pytest.approx((right.north_m, -right.east_m))
        assert left.roll_rad == pytest.approx(-right.roll_rad)


def test_step_length_hardly_matters() -> None:
    # The autopilot's loop runs at 400 Hz, the simulator's at 50 Hz: 12 m on they are 5 cm apart.
    coarse, fine = guided(), guided()
    for copter, step_s in ((coarse, 0.02), (fine, 0.0025)):
        copter.guided_position((20.0, 10.0, -12.0))
        for _ in range(round(4.0 / step_s)):
            copter.step(step_s)
    assert math.dist((coarse.north_m, coarse.east_m), (fine.north_m, fine.east_m)) < 0.06


def test_long_step_is_split() -> None:
    one, many = guided(), guided()
    for copter in (one, many):
        copter.guided_position((20.0, 0.0, -10.0))
    one.step(1.0)
    fly(many, 1.0)
    assert one.north_m == pytest.approx(many.north_m, abs=1e-9)


def test_climbs_and_descends_within_the_limits() -> None:
    copter = guided(5.0)
    copter.guided_position((0.0, 0.0, -30.0))
    fastest = 0.0
    for _ in range(1000):
        copter.step(STEP_S)
        fastest = min(fastest, copter.vd_mps)
    assert fastest == pytest.approx(-2.5, abs=0.1)  # WP_SPD_UP
    assert copter.down_m == pytest.approx(-30.0, abs=0.02)
    copter.guided_position((0.0, 0.0, -10.0))
    for _ in range(1000):
        copter.step(STEP_S)
        fastest = max(fastest, copter.vd_mps)
    assert fastest == pytest.approx(1.5, abs=0.1)  # WP_SPD_DN
    assert copter.down_m == pytest.approx(-10.0, abs=0.02)


def test_its_motors_throttle_is_what_holds_it_up_and_what_makes_it_climb() -> None:
    copter = guided()
    fly(copter, 5.0)
    assert copter.throttle == pytest.approx(HOVER_THROTTLE)
    copter.guided_velocity((0.0, 0.0, -2.0))
    fly(copter, 0.5)
    assert HOVER_THROTTLE + 0.02 < copter.throttle < 1.0
    copter.guided_velocity((8.0, 0.0, 0.0))
    fly(copter, 3.0)
    leans = math.cos(copter.roll_rad) * math.cos(copter.pitch_rad)
    assert leans < 0.98
    assert copter.throttle == pytest.approx(HOVER_THROTTLE / leans, abs=0.03)
    assert Copter((0.0, 0.0, 0.0), flying=False).throttle == 0.0


def test_looks_along_the_path_and_keeps_the_heading_at_rest() -> None:
    copter = guided(5.0)
    copter.guided_position((0.0, 30.0, -10.0))
    fly(copter, 5.0)
    assert copter.yaw_rad == pytest.approx(math.pi / 2, abs=0.02)
    fly(copter, 20.0)
    assert copter.yaw_rad == pytest.approx(math.pi / 2, abs=0.1)


def test_a_turn_is_shaped_to_sixty_degrees_a_second() -> None:
    """The vehicle comes after it, and overshoots: SITL 4.8 turned with 74 (`step3_cap5`)."""
    copter = guided(5.0)
    copter.guided_position(START, yaw_rad=3.0)
    rates = []
    for _ in range(300):
        copter.step(STEP_S)
        rates.append(copter.yawspeed_rps)
    assert rates[100] == pytest.approx(math.pi / 3, abs=0.12)
    assert math.pi / 3 < max(rates) < math.radians(74)
    assert copter.yaw_rad == pytest.approx(3.0, abs=0.01)


def late_s(generation: Generation, rate_rps: float) -> float:
    """How far the nose is behind a yaw that turns at 0.7 rad/s, a point at 50 Hz, after 3 s."""
    copter = Copter(START, tuning=tuning_of(generation), flying=True)
    copter.start_guided(5.0)
    fly(
        copter,
        3.0,
        lambda time_s: copter.guided_posvel(
            START, (0.0, 0.0, 0.0), 0.7 * time_s, yaw_rate_rps=rate_rps
        ),
    )
    return 3.0 - copter.yaw_rad / 0.7


@pytest.mark.parametrize(
    ("generation", "vehicle_s", "shaping_s"),
    # SITL on a ramp of 40 degrees a second, without its rate: yaw behind DesYaw, and DesYaw behind
    # the order (ATT), of which half an order's period, 0.02 s, is the experiment's.
    [(Generation.V4_8, 0.088, 0.108 - 0.02), (Generation.V4_6, 0.109, 0.158 - 0.02)],
)
def test_a_yaw_with_its_rate_is_turned_after_without_the_shaping_s_delay(
    generation: Generation, vehicle_s: float, shaping_s: float
) -> None:
    assert late_s(generation, 0.7) == pytest.approx(vehicle_s, abs=0.035)
    whole_s = late_s(generation, 0.0)
    assert whole_s - late_s(generation, 0.7) == pytest.approx(shaping_s, abs=0.02)


def test_a_turn_sets_in_and_overshoots_as_sitl_s() -> None:
    """SITL 4.8 (SIM.Yaw) after an order to turn by 30 degrees."""
    copter = guided()
    copter.guided_posvel(START, (0.0, 0.0, 0.0), math.radians(30.0))
    turned = []
    for _ in range(100):
        copter.step(STEP_S)
        turned.append(math.degrees(copter.yaw_rad))
    # At rest it looks 0.8 degrees aside; after 0.4, 0.6, 0.8 s it has turned by so much, at most by
    # 33.6 degrees.
    for time_s, sitl_deg in ((0.4, 6.1), (0.6, 18.0), (0.8, 29.7)):
        assert turned[round(time_s / STEP_S) - 1] == pytest.approx(sitl_deg, abs=2.5)
    assert max(turned) == pytest.approx(33.6, abs=1.5)


# SITL's quad with WP_ACC 5 and PSC_JERK_NE 20, as `setup apply` has it.
FOLLOWS = replace(TrackLimits(), acceleration_mps2=5.0, shaping_jerk_mps3=20.0)


def test_a_step_of_a_metre_is_flown_as_sitl_flies_it() -> None:
    """Position and velocity of 0, 25 times a second: SITL 4.8 (SIM.Pitch, SIM2.VN)."""
    copter = Copter(START, flying=True)
    copter.set_limits(FOLLOWS)
    copter.start_guided(10.0)
    pitch_deg, speed_mps = [], []
    for count in range(250):
        if count % 2 == 0:
            copter.guided_posvel((-1.0, 0.0, -10.0), (0.0, 0.0, 0.0), 0.0)
        copter.step(STEP_S)
        pitch_deg.append(math.degrees(copter.pitch_rad))
        speed_mps.append(copter.vn_mps)
    assert (min(pitch_deg), max(pitch_deg)) == pytest.approx((-20.9, 22.9), abs=1.0)
    assert (min(speed_mps), max(speed_mps)) == pytest.approx((-1.86, 0.58), abs=0.05)


@pytest.mark.parametrize(
    ("generation", "sitl_deg"), [(Generation.V4_8, 9.54), (Generation.V4_6, 6.24)]
)
def test_a_leader_that_shakes_makes_it_lean_as_sitl_leans(
    generation: Generation, sitl_deg: float
) -> None:
    """A point 3 m behind a leader whose range is off by 0.1 m at 0.9 Hz; its place jumps thrice.

    The lean's standard deviation in 30 s (SIM.Pitch).
    """
    copter = Copter(START, tuning=tuning_of(generation), flying=True)
    copter.set_limits(FOLLOWS)
    copter.start_guided(10.0)
    leader_m, pitch_deg = -3.0, []
    for count in range(750):
        time_s = 0.04 * count
        speed_mps = -2.0 if time_s < 24.0 else 0.0
        leader_m += 0.04 * speed_mps
        jump_m = 0.0 if time_s < 8.0 else -0.5 if time_s < 13.0 else 0.3 if time_s < 18.0 else -1.0
        range_m = copter.est_north_m - leader_m - jump_m + 0.1 * math.sin(math.tau * 0.9 * time_s)
        target = (copter.est_north_m - (range_m - 3.0), 0.0, -10.0)
        copter.guided_posvel(target, (speed_mps, 0.0, 0.0), 0.0)
        for _ in range(2):
            pitch_deg.append(math.degrees(copter.pitch_rad))
            copter.step(STEP_S)
    assert statistics.pstdev(pitch_deg) == pytest.approx(sitl_deg, rel=0.035)


@pytest.mark.parametrize("generation", [Generation.V4_6, Generation.V4_8])
def test_it_leans_no_quicker_than_its_parameters_allow(generation: Generation) -> None:
    """ATC_RATE_R_MAX and P_MAX; the angle loop (ATC_ANG_PIT_P) overshoots it by a tenth."""
    copter = Copter(START, tuning=tuning_of(generation), flying=True)
    copter.set_limits(replace(FOLLOWS, lean=LeanLimits(rate_rps=math.radians(30.0))))
    copter.start_guided(5.0)
    quickest_rps = 0.0
    for _ in range(100):
        copter.guided_velocity((5.0, 0.0, 0.0), yaw_rad=0.0)
        copter.step(STEP_S)
        quickest_rps = max(quickest_rps, abs(copter.pitchspeed_rps))
    assert math.degrees(quickest_rps) == pytest.approx(30.0, abs=3.0)


def test_commanded_yaw_wins_over_the_path() -> None:
    copter = guided(5.0)
    copter.guided_position((30.0, 0.0, -10.0), yaw_rad=-1.0)
    fly(copter, 4.0)
    assert copter.vn_mps > 3.0
    assert copter.yaw_rad == pytest.approx(-1.0, abs=0.01)


def test_leans_into_the_acceleration() -> None:
    copter = Copter(START, yaw_rad=math.pi / 2, flying=True)
    copter.start_guided(5.0)
    copter.guided_position((30.0, 0.0, -10.0), yaw_rad=math.pi / 2)
    fly(copter, 1.0)
    # looking east and speeding up northwards means leaning to the left
    assert copter.roll_rad < -0.1
    assert abs(copter.pitch_rad) < 0.02


def test_lean_reaches_its_limit_and_stays_within() -> None:
    # without a speed limit drag grows until only the full lean holds the speed
    copter = guided(0.0)
    copter.guided_position((400.0, 0.0, -10.0))
    most = 0.0
    for _ in range(1000):
        copter.step(STEP_S)
        most = max(most, abs(copter.pitch_rad))
    assert most == pytest.approx(LeanLimits().most_rad, abs=0.01)
    # the limit is that of the demand; the angle loop overshoots it by a hair
    assert most <= LeanLimits().most_rad + math.radians(0.1)


def test_hold_brakes_and_stays() -> None:
    copter = Copter(START, flying=True, velocity_ned_mps=(5.0, 0.0, 0.0))
    copter.hold()
    track = fly(copter, 20.0)
    assert abs(copter.vn_mps) < 0.01
    # 5 m/s at 2.5 m/s2 is 5 m, and the jerk limit and lean lag add some
    assert 5.0 < track[-1][1] < 8.0


def test_takes_off_to_the_height_and_stays() -> None:
    copter = Copter((3.0, 4.0, 0.0))
    assert copter.landed
    fly(copter, 1.0)
    assert copter.down_m == 0.0
    copter.take_off(10.0)
    fly(copter, 15.0)
    assert not copter.landed
    assert (copter.north_m, copter.east_m, copter.down_m) == pytest.approx((3, 4, -10), abs=0.02)


def test_lands_slowly_and_rests() -> None:
    copter = Copter((0.0, 0.0, -20.0), flying=True)
    copter.land()
    fly(copter, 6.0)
    assert copter.vd_mps > 1.2  # WP_SPD_DN above LAND_ALT_LOW_M
    fly(copter, 10.0)
    assert copter.vd_mps == pytest.approx(0.5, abs=0.05)  # LAND_SPD_MS below
    fly(copter, 30.0)
    assert copter.landed
    assert (copter.down_m, copter.vd_mps) == (0.0, 0.0)


def within(acceleration_mps2: float, jerk_mps3: float) -> TrackLimits:
    return TrackLimits(acceleration_mps2=acceleration_mps2, shaping_jerk_mps3=jerk_mps3)


def retreat(limits: TrackLimits) -> Copter:
    """One second after the order to fly back at 2 m/s, while flying on at 2 m/s."""
    copter = Copter(START, flying=True, velocity_ned_mps=(2.0, 0.0, 0.0))
    copter.set_limits(limits)
    copter.start_guided(5.0)
    for _ in range(50):
        copter.guided_velocity((-2.0, 0.0, 0.0), yaw_rad=0.0)
        copter.step(STEP_S)
    return copter


def test_higher_limits_turn_the_vehicle_round_sooner() -> None:
    # 2.5 m/s2 and 5 m/s3 take 0.5 s to full braking; 5 and 20 (15.3 in force) 0.33 s
    slow, fast = retreat(within(2.5, 5.0)), retreat(within(5.0, 20.0))
    assert slow.vn_mps - fast.vn_mps > 1.0
    assert slow.north_m - fast.north_m > 0.2


@pytest.mark.parametrize(
    ("generation", "acceleration", "jerk", "scale"),
    [
        (Generation.V4_6, "WPNAV_ACCEL", "PSC_JERK_XY", 100.0),
        (Generation.V4_8, "WP_ACC", "PSC_JERK_NE", 1.0),
    ],
)
def test_guided_reads_its_limits_with_the_sub_mode_and_with_the_speed(
    generation: Generation, acceleration: str, jerk: str, scale: float
) -> None:
    copter, parameters = guided(), Parameters(generation, {})
    mode = Guided(copter, parameters, lambda _: True, lambda *_: None)
    mode.start()
    assert copter.limits == TrackLimits()
    parameters.set(acceleration, 5.0 * scale)
    parameters.set(jerk, 20.0)
    mode.velocity((0.0, 0.0, 0.0))  # the sub-mode it is in already
    assert copter.limits == TrackLimits()
    mode.position(START)
    assert (copter.limits.acceleration_mps2, copter.limits.shaping_jerk_mps3) == (5.0, 20.0)
    assert copter.limits.corner_acceleration_mps2 == 10.0  # twice the other, as WP_ACC_CNR 0 says
    parameters.set(acceleration, 4.0 * scale)
    mode.position((1.0, 0.0, -10.0))
    assert copter.limits.acceleration_mps2 == 5.0
    mode.set_speed(3.0)
    assert copter.limits.acceleration_mps2 == 4.0
    parameters.set(acceleration, 0.0)  # AC_WPNav.h: the default then
    mode.set_speed(3.0)
    assert copter.limits.acceleration_mps2 == 2.5


def test_jerk_in_force_is_what_the_lean_can_follow() -> None:
    # 0.5 sqrt(5 m/s2 x 1100 deg/s2 x g) = 15.3 m/s3, whatever PSC_JERK_NE asks for
    assert retreat(within(5.0, 20.0)).north_m == pytest.approx(
        retreat(within(5.0, 15.34)).north_m, abs=1e-3
    )
    assert retreat(within(5.0, 10.0)).north_m - retreat(within(5.0, 20.0)).north_m > 0.02


@pytest.mark.parametrize(
    ("acceleration_mps2", "jerk_mps3", "low_deg", "high_deg"),
    # 2.5 m/s2 are 14 degrees, 5 m/s2 27: the lean comes 0.3 s late, so that the controller asks for
    # some more, and no more than ATC_ANGLE_MAX, 30 degrees.
    [(2.5, 5.0, 14.3, 21.0), (5.0, 20.0, 27.0, 30.1)],
)
def test_rears_up_to_fly_back(
    acceleration_mps2: float, jerk_mps3: float, low_deg: float, high_deg: float
) -> None:
    copter = retreat(within(acceleration_mps2, jerk_mps3))
    highest_rad = copter.pitch_rad
    for _ in range(300):
        copter.guided_velocity((-2.0, 0.0, 0.0), yaw_rad=0.0)
        copter.step(STEP_S)
        highest_rad = max(highest_rad, copter.pitch_rad)
    assert low_deg < math.degrees(highest_rad) < high_deg
    # flying back at 2 m/s leans against the drag, 0.63 m/s2: 3.7 degrees
    assert math.degrees(copter.pitch_rad) == pytest.approx(3.7, abs=0.3)


def test_attitude_follows_a_ramp_late_by_its_command_model() -> None:
    # A lean that grows steadily comes 2 x 0.15 s late from 4.8 on, 0.15 s up to 4.7 (ATC_INPUT_TC;
    # seen in SITL's dataflash logs): while the demand rises at 5 m/s3, that is 1.5 or 0.75 m/s2.
    for generation, late_s in ((Generation.V4_8, 0.3), (Generation.V4_6, 0.15)):
        copter = Copter(START, tuning=tuning_of(generation), flying=True)
        copter.start_guided(0.0)
        copter.guided_position((400.0, 0.0, -10.0), yaw_rad=0.0)
        copter.set_limits(TrackLimits(acceleration_mps2=25.0, shaping_jerk_mps3=5.0))
        fly(copter, 0.7)
        demand, lean = copter.demand_ne_mps2[0], -math.tan(copter.pitch_rad) * 9.80665
        fly(copter, STEP_S)
        rate = (copter.demand_ne_mps2[0] - demand) / STEP_S
        assert (demand - lean) / rate == pytest.approx(late_s, abs=0.04)


def test_same_commands_give_the_same_flight() -> None:
    flights = []
    for _ in range(2):
        copter = guided()
        copter.guided_position((20.0, 10.0, -12.0))
        flights.append(fly(copter, 5.0))
    assert flights[0] == flights[1]


@pytest.mark.parametrize(("angle", "wrapped"), [(4.0, 4.0 - math.tau), (-4.0, math.tau - 4.0)])
def test_angles_wrap(angle: float, wrapped: float) -> None:
    assert wrap_pi(angle) == pytest.approx(wrapped)


@pytest.mark.parametrize(
    ("generation", "lean", "acceleration", "factor"),
    [
        (Generation.V4_6, "ANGLE_MAX", "ATC_ACCEL_{}_MAX", 100.0),
        (Generation.V4_8, "ATC_ANGLE_MAX", "ATC_ACC_{}_MAX", 1.0),
    ],
)
def test_it_leans_as_far_and_as_quickly_as_its_parameters_allow(
    generation: Generation, lean: str, acceleration: str, factor: float
) -> None:
    parameters = Parameters(generation, {})
    assert parameters.motion_limits().lean == LeanLimits()
    parameters.set(lean, 20.0 * factor)
    for axis in "RP":
        parameters.set(acceleration.format(axis), 300.0 * factor)
        parameters.set(f"ATC_RATE_{axis}_MAX", 90.0)
    parameters.set("ATC_INPUT_TC", 0.3)
    read = parameters.motion_limits().lean
    assert read == LeanLimits(math.radians(20.0), 0.3, math.radians(90.0), math.radians(300.0))
    parameters.set("PSC_ANGLE_MAX", 15.0)
    assert parameters.motion_limits().lean.most_rad == math.radians(15.0)
    parameters.set(acceleration.format("R"), 0.0)  # AC_PosControl.cpp: MIN of both, 0 is no limit
    assert parameters.motion_limits().lean.acceleration_rps2 == math.inf


def test_a_vehicle_that_leans_slowly_flies_back_later() -> None:
    def north_m(lean: LeanLimits) -> float:
        return retreat(replace(within(5.0, 20.0), lean=lean)).north_m

    usual_m = north_m(LeanLimits())
    # 0.5 sqrt(5 m/s2 x 300 deg/s2 x g) = 8 m/s3 instead of 15: 0.15 s later at 2 m/s.
    slowly_m = north_m(LeanLimits(acceleration_rps2=math.radians(300.0)))
    assert slowly_m - usual_m == pytest.approx(0.3, abs=0.05)
    assert north_m(LeanLimits(rate_rps=math.radians(30.0))) - usual_m > 0.1
    assert north_m(LeanLimits(input_s=0.3)) - usual_m > 0.2
    assert north_m(LeanLimits(most_rad=math.radians(12.0))) - usual_m > 0.2
