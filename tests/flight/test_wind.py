"""What the wind leaves of a lean: figures by g tan(lean), ArduCopter's 30 degrees."""

import math

import pytest

from echowing.flight.wind import BODY_PER_M, GUST_SHARE, LEAST_MPS2, ROTORS_PER_S, Wind
from echowing.geo import GRAVITY_MPS2

LEAN_MAX_RAD = math.radians(30.0)
ALL_MPS2 = GRAVITY_MPS2 * math.tan(LEAN_MAX_RAD)
STEP_S = 0.5


def after(attitude_deg: tuple[float, float, float], seconds: float = 30.0) -> Wind:
    """A vehicle that keeps its place and leans so."""
    wind = Wind()
    roll, pitch, yaw = map(math.radians, attitude_deg)
    for step in range(round(seconds / STEP_S)):
        wind.leans((roll, pitch, yaw), (0.0, 0.0), 100.0 + step * STEP_S)
    return wind


def mps2(lean_deg: float) -> float:
    return GRAVITY_MPS2 * math.tan(math.radians(lean_deg))


@pytest.mark.parametrize("bearing_deg", [0.0, 135.0])
def test_in_calm_all_of_the_lean_is_left(bearing_deg: float) -> None:
    bearing_rad = math.radians(bearing_deg)
    assert Wind().leaves_mps2(bearing_rad, LEAN_MAX_RAD) == pytest.approx(ALL_MPS2)
    still = after((0.0, 0.0, 40.0))
    assert still.leaves_mps2(bearing_rad, LEAN_MAX_RAD) == pytest.approx(ALL_MPS2)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, -150.0])
def test_wind_from_behind_takes_what_it_needs_and_a_gust_half_as_much_again(yaw_deg: float) -> None:
    """Leaning back 10 degrees towards a leader ahead, whichever way that is."""
    wind, ahead_rad = after((0.0, 10.0, yaw_deg)), math.radians(yaw_deg)
    left_mps2 = ALL_MPS2 - (1.0 + GUST_SHARE) * mps2(10.0)
    assert wind.leaves_mps2(ahead_rad, LEAN_MAX_RAD) == pytest.approx(left_mps2)
    # The other way the same wind helps to brake, less what its gusts take.
    helped_mps2 = ALL_MPS2 + (1.0 - GUST_SHARE) * mps2(10.0)
    assert wind.leaves_mps2(ahead_rad + math.pi, LEAN_MAX_RAD) == pytest.approx(helped_mps2)


def test_wind_from_the_side_takes_its_share_of_the_lean() -> None:
    wind = after((12.0, 0.0, 0.0))
    across_mps2 = (1.0 + GUST_SHARE) * mps2(12.0)
    left_mps2 = math.sqrt(ALL_MPS2**2 - across_mps2**2) - GUST_SHARE * mps2(12.0)
    assert wind.leaves_mps2(0.0, LEAN_MAX_RAD) == pytest.approx(left_mps2)


def test_its_own_speed_is_no_wind() -> None:
    """It brakes to none and on to as much the other way: hovering counts, not the leg it flies."""
    wind, flying = Wind(), Wind()
    flies_mps, wind_mps = 2.0, 6.0  # north, from the north

    def lean_rad(airspeed_mps: float) -> float:
        drag_mps2 = airspeed_mps * (ROTORS_PER_S + BODY_PER_M * airspeed_mps)
        return -math.atan(drag_mps2 / GRAVITY_MPS2)

    for step in range(60):
        now_s = step * STEP_S
        wind.leans((0.0, lean_rad(wind_mps), 0.0), (0.0, 0.0), now_s)
        flying.leans((0.0, lean_rad(wind_mps + flies_mps), 0.0), (flies_mps, 0.0), now_s)
    for bearing_rad in (0.0, math.pi / 2.0, math.pi):
        left_mps2 = wind.leaves_mps2(bearing_rad, LEAN_MAX_RAD)
        assert flying.leaves_mps2(bearing_rad, LEAN_MAX_RAD) == pytest.approx(left_mps2)
        assert left_mps2 > LEAST_MPS2


def test_something_is_always_left() -> None:
    assert after((0.0, 29.0, 0.0)).leaves_mps2(0.0, LEAN_MAX_RAD) == LEAST_MPS2
    assert after((0.0, 10.0, 0.0)).leaves_mps2(0.0, math.radians(45.0)) > ALL_MPS2


def test_its_own_manoeuvres_are_no_wind() -> None:
    """North and back at up to 3 m/s2: the lean changes its velocity, and nothing else."""
    wind, mps, least_mps2 = Wind(), 0.0, math.inf
    for step in range(240):
        now_s = step * 0.25
        accel_mps2 = 3.0 * math.cos(2.0 * math.pi * now_s / 6.0)
        wind.leans((0.0, math.atan(-accel_mps2 / GRAVITY_MPS2), 0.0), (mps, 0.0), now_s)
        mps += accel_mps2 * 0.25
        if now_s > 10.0:
            least_mps2 = min(least_mps2, wind.leaves_mps2(0.0, LEAN_MAX_RAD))
    assert least_mps2 > 4.5


def test_after_a_gap_it_begins_anew() -> None:
    wind = after((0.0, 20.0, 0.0))
    wind.leans((0.0, 0.0, 0.0), (0.0, 0.0), 1000.0)
    assert wind.leaves_mps2(0.0, LEAN_MAX_RAD) == pytest.approx(ALL_MPS2)
