"""Where the sonar looks: the hold works along the leader's bearing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from tests.lua.test_hold import HOLDING, LEADER_MPS, newest

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Rig

ASIDE_RAD = 0.6  # off the nose, which points north; a gimbal reaches 60 degrees


def flown(
    r: Rig, seconds: float, range_m: float, yaw_rad: float | None, along_rad: float = ASIDE_RAD
) -> Rig:
    """Behind a leader of the same speed, in a direction that is not the nose's."""
    north_mps, east_mps = LEADER_MPS * math.cos(along_rad), LEADER_MPS * math.sin(along_rad)
    r.vehicle.velocity = (north_mps, east_mps, 0.0)
    r.range(range_m)
    r.raw_every_ms = 100
    for _ in range(round(seconds / 0.12)):
        r.send_target(0.0, north_mps, aside_mps=east_mps, yaw_rad=yaw_rad)
        r.run(0.12)
    return r


@pytest.mark.parametrize("range_m", [2.9, 3.15])
def test_a_point_is_moved_along_the_leaders_bearing(rig: MakeRig, range_m: float) -> None:
    """Not along the nose: the gimbal looks at the leader, and that is where the range counts."""
    r = flown(rig(), 2.0, range_m, ASIDE_RAD)
    r.send_target(0.0, 0.001, yaw_rad=ASIDE_RAD)
    r.run(0.04)

    target = newest(r)
    assert r.state == HOLDING
    assert math.hypot(target.north_m, target.east_m) > 0.03
    moved_rad = math.atan2(target.east_m, target.north_m)
    assert math.tan(moved_rad) == pytest.approx(math.tan(ASIDE_RAD), abs=0.02)
    assert math.copysign(1.0, target.north_m) == math.copysign(1.0, range_m - 3.0)


def test_the_own_speed_counts_along_the_bearing(rig: MakeRig) -> None:
    """The leader flies east at 2 m/s, and so does the follower, whose nose is north."""
    r = flown(rig(), 2.0, 3.0, math.pi / 2, along_rad=math.pi / 2)
    assert r.host.local_value("own").mps == pytest.approx(LEADER_MPS, abs=0.01)
    assert r.host.local_value("track").leader_mps == pytest.approx(LEADER_MPS, abs=0.05)


def test_a_beam_that_turns_is_no_acceleration(rig: MakeRig) -> None:
    """From points without a yaw, along the nose, to a leader 60 degrees aside; and back.

    Neither vehicle has changed its speed, and the range stays: no more does anything else.
    """
    r = flown(rig(), 2.0, 3.0, None)
    own, track = r.host.local_value("own"), r.host.local_value("track")
    before = newest(r)
    for yaw_rad in (1.0, None):
        for _ in range(6):
            flown(r, 0.12, 3.0, yaw_rad)
            assert own.accel_mps2 == pytest.approx(0.0, abs=1e-3)
            assert track.leader_mps == pytest.approx(own.mps, abs=0.02)
            assert track.range_m == pytest.approx(3.0, abs=0.01)
            assert newest(r).north_mps == pytest.approx(before.north_mps, abs=0.02)
            assert newest(r).east_mps == pytest.approx(before.east_mps, abs=0.02)
            assert newest(r).north_mps2 == 0.0


def bearing_rad(r: Rig) -> float:
    look = r.host.local_value("look")
    return math.atan2(look.east, look.north)


def test_the_bearing_goes_on_between_points(rig: MakeRig) -> None:
    """By the point's velocity and the own: 0.5 m/s across at 3 m, 0.6 s on."""
    r = flown(rig(), 2.0, 3.0, 0.0, along_rad=0.0)
    r.send_target(0.0, LEADER_MPS, aside_mps=0.5, yaw_rad=0.0)
    r.run(0.66)
    assert bearing_rad(r) == pytest.approx(math.atan2(0.3, 3.0), abs=0.01)


def test_after_the_points_have_ended_it_looks_ahead(rig: MakeRig) -> None:
    r = flown(rig(), 2.0, 3.0, ASIDE_RAD)
    r.raw_every_ms = None
    r.range(8.0)
    r.run(2.5)
    assert bearing_rad(r) == 0.0


def test_it_backs_off_along_the_bearing(rig: MakeRig) -> None:
    """Straight away from the leader, also where the tool has stopped the vehicle."""
    r = rig()
    r.raw_every_ms = 50
    for number in range(150):
        r.range(max(0.8, 3.0 - 0.015 * number))  # the leader comes, 1.5 m/s
        if number % 12 == 0:
            r.send_target(0.0, 0.0, yaw_rad=ASIDE_RAD)
        r.step()
    target = newest(r)
    assert r.texts[-1] == "too close, backing off"
    assert target.north_m < -0.5
    assert math.tan(ASIDE_RAD) == pytest.approx(target.east_m / target.north_m, abs=0.02)
