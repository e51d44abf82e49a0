import math
import random
import statistics
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from echowing.flight.belief import Curve
from echowing.flight.sonar import PAN_CENTRE_US, TILT_CENTRE_US
from echowing.sim.world import sonar
from echowing.sim.world.sonar import (
    GROUND,
    LEVER_ARM_M,
    ON_A_DESK,
    SPEED_OF_SOUND_MPS,
    Ear,
    Gimbal,
    MaxSonar,
    Pose,
    Surface,
    Target,
    TrueSonar,
    body_to_ned,
    surface_range_m,
    target_range_m,
)

NORTH = (1.0, 0.0, 0.0)
HIGH = (0.0, 0.0, -10.0)
WALL_AT_5_M = Surface((5.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
BODY_SIZES_M = ON_A_DESK.inset_m
QUIET = replace(ON_A_DESK, wild_share=0.0)
HALF_DEG = math.degrees(ON_A_DESK.widest_rad)


def quiet_ear(seed: int = 1, **other: Any) -> Ear:
    """A sonar on a desk without wild readings, and what is told otherwise of it."""
    return ear_of(replace(QUIET, **other), seed)


def ear_of(true: TrueSonar, seed: int = 1) -> Ear:
    return Ear(lambda name: random.Random(f"{seed} {name}"), true)


def target_at(
    distance_m: float, off_axis_deg: float = 0.0, heard_to_m: float = ON_A_DESK.foil_m
) -> Target:
    """A leader so far from the sonar's face, that far off its axis."""
    off = math.radians(off_axis_deg)
    north_m, east_m = LEVER_ARM_M + distance_m * math.cos(off), distance_m * math.sin(off)
    return Target((north_m, east_m, -10.0), heard_to_m)


def readings_m(ear: Ear, target: Target, pings: int = 400) -> list[float | None]:
    return [ear.ping(k * 0.1, Pose(HIGH, NORTH), [target], ()) for k in range(pings)]


def heard_share(target: Target, pings: int = 400, **other: Any) -> float:
    readings = readings_m(quiet_ear(**other), target, pings)
    return sum(one is not None for one in readings) / pings


def test_the_range_is_from_the_sonars_face_to_the_leaders_foil() -> None:
    range_m, off_rad = target_range_m(Pose(HIGH, NORTH), target_at(3.0, 12.0))

    assert range_m == pytest.approx(3.0 + LEVER_ARM_M - BODY_SIZES_M)
    assert math.degrees(off_rad) == pytest.approx(12.0)


def test_another_inset_is_other_legs_on_the_leader() -> None:
    legs_m = 0.15
    leader = replace(target_at(3.0), radius_m=legs_m)

    assert target_range_m(Pose(HIGH, NORTH), leader)[0] == pytest.approx(3.0 - legs_m)


def test_on_a_desk_the_beam_is_a_cone() -> None:
    assert heard_share(target_at(3.0, HALF_DEG - 0.1)) == 1.0
    assert heard_share(target_at(3.0, HALF_DEG + 0.1)) == 0.0
    assert heard_share(target_at(3.0, 180.0)) == 0.0


@pytest.mark.parametrize("heard_to_m", [ON_A_DESK.stock_m, ON_A_DESK.foil_m])
def test_a_leader_is_heard_as_far_as_table_5_says(heard_to_m: float) -> None:
    reads_more_m = BODY_SIZES_M - LEVER_ARM_M
    near = target_at(heard_to_m * 0.94 + reads_more_m, heard_to_m=heard_to_m)
    at_limit = target_at(heard_to_m + reads_more_m, heard_to_m=heard_to_m)
    beyond = target_at(heard_to_m * 1.06 + reads_more_m, heard_to_m=heard_to_m)

    assert heard_share(near) == 1.0
    assert 0.35 < heard_share(at_limit) < 0.65
    assert heard_share(beyond) == 0.0


# A share of 2,000 pings is known to 0.011 (one standard deviation), or better.
def test_only_a_share_of_the_pings_is_heard_by_range() -> None:
    heard = Curve((1.0, 3.0), (0.9, 0.5))

    assert heard_share(target_at(2.1), 2_000, heard=heard) == pytest.approx(0.7, abs=0.04)
    assert heard_share(target_at(3.1), 2_000, heard=heard) == pytest.approx(0.5, abs=0.04)


def test_propellers_leave_a_share_of_what_is_heard() -> None:
    loud = replace(QUIET, left=Curve((0.2, 0.6), (1.0, 0.2)))

    def share(throttle: float) -> float:
        ear, pose = ear_of(loud), Pose(HIGH, NORTH, throttle=throttle)
        heard = [ear.ping(k * 0.1, pose, [target_at(3.0)], ()) for k in range(1000)]
        return 1.0 - heard.count(None) / len(heard)

    assert share(0.2) == 1.0
    assert share(0.4) == pytest.approx(0.6, abs=0.05)
    assert share(0.8) == pytest.approx(0.2, abs=0.05)


def test_the_beam_narrows_with_the_range() -> None:
    narrowing = Curve((1.0, 3.0), (math.radians(20.0), math.radians(6.0)))

    assert heard_share(target_at(1.1, 12.0), half_rad=narrowing) == 1.0
    assert heard_share(target_at(3.1, 12.0), half_rad=narrowing) == 0.0
    assert heard_share(target_at(3.1, 5.0), half_rad=narrowing) == 1.0


def test_the_beams_edge_is_as_soft_as_it_is_told() -> None:
    edge_rad = math.radians(4.0)

    assert heard_share(target_at(3.0, HALF_DEG), 2_000, edge_rad=edge_rad) == pytest.approx(
        0.5, abs=0.04
    )
    # One edge outside, and one inside: 1 / (1 + e^2) = 0.12.
    outside, inside = (target_at(3.0, HALF_DEG + off_deg) for off_deg in (4.0, -4.0))
    assert heard_share(outside, 2_000, edge_rad=edge_rad) == pytest.approx(0.12, abs=0.03)
    assert heard_share(inside, 2_000, edge_rad=edge_rad) == pytest.approx(0.88, abs=0.03)


def test_a_smaller_leader_is_heard_over_a_narrower_beam() -> None:
    narrowing = Curve((2.0, 4.6), (math.radians(20.0), math.radians(8.0)))
    foil, stock = target_at(2.9, 12.0), target_at(2.9, 12.0, ON_A_DESK.stock_m)

    assert heard_share(foil, half_rad=narrowing) == 1.0
    assert heard_share(stock, half_rad=narrowing) == 0.0


def test_deafness_comes_in_bursts() -> None:
    """A third of the time, two seconds at a time: 20 readings."""
    readings = readings_m(quiet_ear(deaf_share=1.0 / 3.0, deaf_s=2.0), target_at(3.0), 40_000)
    silent = [one is None for one in readings]
    bursts = sum(silent[k] and not silent[k - 1] for k in range(1, len(silent)))

    # About 670 bursts: their mean length is known to 4 %.
    assert sum(silent) / len(silent) == pytest.approx(1.0 / 3.0, abs=0.05)
    assert 0.1 * sum(silent) / bursts == pytest.approx(2.0, rel=0.15)


def test_a_strangers_sonar_makes_anything_of_a_range_in_bursts() -> None:
    readings = readings_m(quiet_ear(tone_share=0.25), target_at(4.0), 40_000)
    # Of the ranges that are anything up to 7.65 m, half are nearer than the leader.
    wrong = sum(one is not None and one < 3.7 for one in readings) / len(readings)

    assert wrong == pytest.approx(0.25 * (3.7 - 0.2) / 7.45, abs=0.03)


def test_noise_is_as_told() -> None:
    readings = [one or 0.0 for one in readings_m(quiet_ear(noise_m=0.05), target_at(3.0), 2_000)]

    assert statistics.pstdev(readings) == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize(
    "other",
    [
        {"heard": Curve((0.0,), (0.5,))},
        {"deaf_share": 0.5},
        {"wild_share": 0.3},
        {"late_share": 0.3},
    ],
)
def test_what_else_is_different_changes_no_other_draw(other: dict[str, Any]) -> None:
    """A reading that is the leader's in both flights is the same in both.

    Wild ones may come to lie just before the leader; of other noise two thirds would be different.
    """
    usual = readings_m(quiet_ear(), target_at(3.0))
    changed = readings_m(quiet_ear(**other), target_at(3.0))

    right = [(a, b) for a, b in zip(usual, changed, strict=True) if b is not None and b > 2.8]
    assert len(right) > 100
    assert sum(a != b for a, b in right) < 0.03 * len(right)
    assert usual != changed


def test_the_nearest_of_all_vehicles_is_what_is_heard() -> None:
    pings = quiet_ear().ping(0.0, Pose(HIGH, NORTH), [target_at(4.0), target_at(2.0)], ())

    assert pings == pytest.approx(2.0 + LEVER_ARM_M - BODY_SIZES_M, abs=0.05)


def test_readings_come_in_whole_centimetres_with_centimetre_noise() -> None:
    ear, pose = quiet_ear(), Pose(HIGH, NORTH)

    readings = [ear.ping(k * 0.1, pose, [target_at(3.0)], ()) for k in range(300)]

    assert all(r is not None and abs(r * 100 - round(r * 100)) < 1e-9 for r in readings)
    mean = statistics.mean(r for r in readings if r is not None)
    # Truncation to the centimetre takes half of one off on average.
    assert mean == pytest.approx(3.0 + LEVER_ARM_M - BODY_SIZES_M - 0.005, abs=0.003)


def test_nothing_is_nearer_than_the_shortest_range() -> None:
    assert quiet_ear().ping(0.0, Pose(HIGH, NORTH), [target_at(0.25)], ()) == sonar.SHORTEST_M


def test_a_wall_met_squarely_is_heard_and_one_met_along_is_not() -> None:
    along = Surface((0.0, 2.0, 0.0), (0.0, -1.0, 0.0))

    assert surface_range_m(Pose(HIGH, NORTH), WALL_AT_5_M) == pytest.approx(5.0)
    assert surface_range_m(Pose(HIGH, NORTH), along) is None
    assert surface_range_m(Pose((6.0, 0.0, -10.0), NORTH), WALL_AT_5_M) is None


def test_the_beam_reaches_the_wall_by_its_squarest_ray() -> None:
    aslant = body_to_ned((1.0, 0.0, 0.0), 0.0, 0.0, math.radians(30.0))

    # 30 degrees off, 20 of them inside the beam.
    expected = 5.0 / math.cos(math.radians(30.0 - HALF_DEG))
    assert surface_range_m(Pose(HIGH, aslant), WALL_AT_5_M) == pytest.approx(expected)


def test_level_flight_at_ten_metres_does_not_hear_the_ground_and_looking_down_does() -> None:
    down = (0.0, 0.0, 1.0)

    assert surface_range_m(Pose(HIGH, NORTH), GROUND) is None
    assert surface_range_m(Pose((0.0, 0.0, -5.0), down), GROUND) == pytest.approx(5.0)


def test_a_far_echo_comes_back_in_the_next_reading_as_a_near_one() -> None:
    ear, pose = quiet_ear(), Pose((0.0, 0.0, -10.0), (0.0, 0.0, 1.0))

    first = ear.ping(0.0, pose, [], (GROUND,))
    ghost = ear.ping(0.05, pose, [], (GROUND,))

    # 10 m is beyond the span; 50 ms later it looks 8.6 m nearer (maxsonar.md: 1.4 m).
    assert first is None
    assert ghost == pytest.approx(10.0 - 0.05 * SPEED_OF_SOUND_MPS / 2.0, abs=0.05)


def test_at_the_recommended_100_ms_there_is_no_ghost() -> None:
    ear, pose = quiet_ear(), Pose((0.0, 0.0, -10.0), (0.0, 0.0, 1.0))
    ear.ping(0.0, pose, [], (GROUND,))

    assert ear.ping(0.1, pose, [], (GROUND,)) is None


def test_one_reading_in_a_hundred_is_wild() -> None:
    ear, pose = ear_of(ON_A_DESK, 5), Pose(HIGH, NORTH)

    wild = sum(ear.ping(k * 0.1, pose, [], ()) is not None for k in range(20_000))

    # 200 expected, standard deviation 14.
    assert 150 < wild < 250


@pytest.mark.parametrize("jitter_s", [0.0, 0.01])
def test_its_share_of_the_readings_comes_late_and_stays_where_pings_are_regular(
    jitter_s: float,
) -> None:
    ear, pose, chance = quiet_ear(late_share=0.4), Pose(HIGH, NORTH), random.Random(1)
    times_s = [k * 0.05 + chance.uniform(0.0, jitter_s) for k in range(5_000)]
    readings = [ear.ping(t_s, pose, [], ()) for t_s in times_s]
    late = [one for one in readings if one is not None]

    # 2,000 expected, standard deviation 35.
    assert 1_880 < len(late) < 2_120
    assert min(late) < 1.0
    assert max(late) > 6.5
    both = [(a, b) for a, b in pairwise(readings) if a is not None and b is not None]
    # A second brings twenty pings; its noise is 1 cm. A jitter of 5 ms is 0.9 m.
    alike = sum(abs(a - b) < 0.06 for a, b in both) / len(both)
    assert alike > 0.9 if jitter_s == 0.0 else alike < 0.2


def test_the_leader_is_heard_before_what_comes_late_behind_it() -> None:
    readings = readings_m(quiet_ear(late_share=1.0), target_at(3.0), 2_000)
    nearer = sum(one is not None and one < 2.8 for one in readings) / len(readings)
    assert max(one or 0.0 for one in readings) < 3.0
    # Late ones are anywhere from 0.2 to 7.65 m, in 200 places: standard deviation 0.034.
    assert nearer == pytest.approx(2.6 / 7.45, abs=0.12)


def test_two_sonars_that_face_each_other_hear_each_others_tone() -> None:
    facing = Pose((4.0, 0.0, -10.0), (-1.0, 0.0, 0.0))
    same_way = Pose((4.0, 0.0, -10.0), NORTH)
    ear, pose = quiet_ear(), Pose(HIGH, NORTH)

    assert all(ear.ping(k * 0.1, pose, [], (), [facing]) is not None for k in range(20))
    assert all(ear.ping(k * 0.1, pose, [], (), [same_way]) is None for k in range(20))


def test_the_gimbal_slews_at_the_servos_rate_and_stops_half_its_play_short_of_its_pulse() -> None:
    gimbal = Gimbal()

    gimbal.step(0.015, PAN_CENTRE_US - 100.0, TILT_CENTRE_US)
    on_the_way = gimbal.pan_deg
    gimbal.step(1.0, PAN_CENTRE_US - 100.0, TILT_CENTRE_US)

    # A dead time of 5 ms, then 500 deg/s for 10 ms; half a degree of play is taken up first.
    assert on_the_way == pytest.approx(-4.5)
    assert gimbal.pan_deg == pytest.approx(-9.5)  # 100 us at 10 us a degree


def test_play_is_a_degree_between_coming_from_the_left_and_from_the_right() -> None:
    gimbal = Gimbal()
    stops_deg = []
    for from_us in (-100.0, 100.0):
        gimbal.step(1.0, PAN_CENTRE_US + from_us, TILT_CENTRE_US + from_us)
        gimbal.step(1.0, PAN_CENTRE_US + 50.0, TILT_CENTRE_US + 50.0)
        stops_deg.append((gimbal.pan_deg, gimbal.tilt_deg))
    assert stops_deg == [pytest.approx((4.5, 4.5)), pytest.approx((5.5, 5.5))]
    # Less than the play moves the gears, and not the axis.
    gimbal.step(1.0, PAN_CENTRE_US + 59.0, TILT_CENTRE_US)
    assert gimbal.pan_deg == pytest.approx(5.5)


@pytest.mark.parametrize("step_s", [0.001, 0.004, 0.02])
def test_pulses_count_after_the_dead_time_in_their_order_at_any_step(step_s: float) -> None:
    """A pulse of a frame's length turns the servo out and back, 5 ms later, and loses nothing."""
    gimbal = Gimbal()
    reached_deg = []
    for k in range(round(0.1 / step_s)):
        out = k * step_s < 0.0199
        gimbal.step(step_s, PAN_CENTRE_US + (300.0 if out else 0.0), TILT_CENTRE_US)
        reached_deg.append(gimbal.pan_deg)
    # Out for 20 ms at 500 deg/s, from 5 to 25 ms; half a degree of play on each side.
    if step_s == 0.001:
        assert max(reached_deg) == pytest.approx(9.5)
        assert reached_deg[3] == 0.0
    assert reached_deg[round(0.02 / step_s) - 1] == pytest.approx(7.0)
    assert reached_deg[round(0.04 / step_s) - 1] == pytest.approx(3.0)
    assert reached_deg[-1] == pytest.approx(0.5)


VECTORS = tomllib.loads((Path(__file__).parents[1] / "flight" / "axis.toml").read_text())["axis"]


@pytest.mark.parametrize("row", VECTORS, ids=lambda row: f"{row['azimuth_deg']:g}")
def test_the_gimbal_s_axis_is_the_one_of_the_table_that_all_share(row: dict[str, float]) -> None:
    pan, tilt = math.radians(row["pan_deg"]), math.radians(row["tilt_deg"])
    body = math.cos(tilt) * math.cos(pan), math.cos(tilt) * math.sin(pan), -math.sin(tilt)
    north, east, down = body_to_ned(
        body, *(math.radians(row[f"{angle}_deg"]) for angle in ("roll", "pitch", "yaw"))
    )
    turn_deg = math.degrees(math.atan2(east, north)) - row["azimuth_deg"]
    assert (turn_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-3)
    assert math.degrees(math.asin(-down)) == pytest.approx(row["elevation_deg"], abs=1e-3)


def test_longer_pulses_look_right_and_up() -> None:
    gimbal = Gimbal()

    gimbal.step(1.0, PAN_CENTRE_US + 100.0, TILT_CENTRE_US + 100.0)
    forward, right, down = gimbal.axis_body()

    assert forward > 0.9
    assert right > 0.1
    assert down < -0.1


def test_attitude_turns_the_beam() -> None:
    nose_down = body_to_ned((1.0, 0.0, 0.0), 0.0, math.radians(-10.0), 0.0)
    facing_east = body_to_ned((1.0, 0.0, 0.0), 0.0, 0.0, math.pi / 2)
    rolled_right = body_to_ned((0.0, 1.0, 0.0), math.radians(90.0), 0.0, 0.0)

    assert nose_down[2] == pytest.approx(math.sin(math.radians(10.0)))
    assert facing_east == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert rolled_right == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)


def bus_sonar(range_m: float | None = 3.0) -> MaxSonar:
    return MaxSonar(lambda _t_s: range_m)


def test_a_reading_is_two_bytes_of_centimetres_high_first() -> None:
    device = bus_sonar(3.21)

    assert device.write(0, 0x70, b"\x51")
    assert device.read(100_000, 0x70, 2) == (321).to_bytes(2, "big")


def test_before_the_first_command_a_read_is_not_a_distance() -> None:
    assert bus_sonar().read(0, 0x70, 2) == sonar.PART_INFORMATION


def test_while_ranging_nothing_is_acknowledged_longer_for_far_targets() -> None:
    def busy_us(range_m: float | None) -> int:
        device = bus_sonar(range_m)
        device.write(0, 0x70, b"\x51")
        return next(t for t in range(0, 200_000, 500) if device.read(t, 0x70, 2) is not None)

    assert busy_us(0.5) < 25_000  # "40 Hz possible for near targets"
    assert 60_000 < busy_us(None) < 70_000  # "15 Hz at full range"


def test_nothing_heard_is_reported_as_the_maximum() -> None:
    device = bus_sonar(None)
    device.write(0, 0x70, b"\x51")

    assert device.read(100_000, 0x70, 2) == (765).to_bytes(2, "big")


def test_the_address_changes_by_its_sequence_and_odd_or_refused_ones_do_not() -> None:
    device = bus_sonar()

    device.write(0, 0x70, bytes([0xAA, 0xA5, 0xE3]))
    device.write(0, 0x70, bytes([0xAA, 0xA5, 164]))
    assert device.address == 0x70
    device.write(0, 0x70, bytes([0xAA, 0xA5, 0xE2]))

    assert device.address == 0x71
    assert not device.write(0, 0x70, b"\x51")
    assert device.write(0, 0x71, b"\x51")


def test_an_unplugged_sensor_is_silent() -> None:
    device = bus_sonar()
    device.plugged = False

    assert not device.write(0, 0x70, b"\x51")
    assert device.read(0, 0x70, 2) is None
