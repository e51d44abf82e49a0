"""Where the sonar looks: along the leader's bearing; the applet carries that on."""

from __future__ import annotations

import math
import struct
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.lua.conftest import mavlink_frame
from tests.lua.test_hold import BACK, HIGH, HOLDING, LEADER_MPS, NOTHING, newest

from echowing.flight.axis import axis_of
from echowing.mavlink.messages import WITHOUT_HEIGHT
from echowing.sim.vehicle import luahost

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


def parts(north: float, east: float) -> tuple[float, float]:
    """Along the leader's bearing, and across it."""
    cos, sin = math.cos(ASIDE_RAD), math.sin(ASIDE_RAD)
    return north * cos + east * sin, east * cos - north * sin


@pytest.mark.parametrize("range_m", [2.9, 3.15])
@pytest.mark.parametrize("ahead_m", [0.0, 0.4])
def test_a_point_is_moved_along_the_leaders_bearing(
    rig: MakeRig, range_m: float, ahead_m: float
) -> None:
    """Not along the nose: the gimbal looks at the leader, and there the range counts.

    Across it the point stays where it is, 0.4 m north here.
    """
    r = flown(rig(), 2.0, range_m, ASIDE_RAD)
    north_mps, east_mps, _ = r.vehicle.velocity or (0.0, 0.0, 0.0)
    r.send_target(ahead_m, north_mps, aside_mps=east_mps, yaw_rad=ASIDE_RAD)
    r.run(0.04)

    along_m, across_m = parts(newest(r).north_m, newest(r).east_m)
    assert r.state == HOLDING
    missing_m = range_m - 3.0
    assert along_m == pytest.approx(max(missing_m, BACK * missing_m), abs=0.02)
    assert across_m == pytest.approx(-ahead_m * math.sin(ASIDE_RAD), abs=0.02)


def test_a_leader_that_brakes_is_answered_along_its_bearing(rig: MakeRig) -> None:
    """By a velocity and an acceleration; across it the velocity is the point's."""
    r = flown(rig(), 2.0, 3.0, ASIDE_RAD)
    north_mps, east_mps, _ = r.vehicle.velocity or (0.0, 0.0, 0.0)
    for number in range(40):
        time_s = 0.01 * (number + 1)
        r.range(3.0 - 0.5 * 2.0 * time_s * time_s)
        if number % 12 == 0:
            r.send_target(0.0, north_mps, aside_mps=east_mps, yaw_rad=ASIDE_RAD)
        r.step()

    target = newest(r)
    along_mps, across_mps = parts(target.north_mps, target.east_mps)
    along_mps2, across_mps2 = parts(target.north_mps2, target.east_mps2)
    assert along_mps < LEADER_MPS - 0.5
    assert along_mps2 == pytest.approx(-2.0, rel=0.35)
    assert (across_mps, across_mps2) == pytest.approx((0.0, 0.0), abs=0.02)


def test_the_own_speed_counts_along_the_bearing(rig: MakeRig) -> None:
    """The leader flies east at 2 m/s, and so does the follower, whose nose is north."""
    r = flown(rig(), 2.0, 3.0, math.pi / 2, along_rad=math.pi / 2)
    assert r.host.local_value("own").mps == pytest.approx(LEADER_MPS, abs=0.01)
    assert r.host.local_value("track").leader_mps == pytest.approx(LEADER_MPS, abs=0.05)


@pytest.mark.parametrize("heard_of_three", [1, 3])
def test_two_that_pass_each_other_are_tracked(rig: MakeRig, heard_of_three: int) -> None:
    """Each at 1.5 m/s, 3 m apart: neither changes its speed, and the beam turns by 57 deg/s.

    Along it the leader's speed is soon another; where that is not foreseen, the few readings that
    come are taken for wild ones.
    """
    r = rig()
    r.vehicle.velocity = (0.0, -1.5, 0.0)
    r.raw_every_ms = 100
    off_mps = []
    for number in range(200):
        east_m = 0.03 * (number - 100)
        bearing_rad = math.atan2(east_m, 3.0)
        heard = number < 60 or number // 10 % 3 < heard_of_three
        r.range(math.hypot(3.0, east_m) if heard else NOTHING)
        if number % 12 == 0:
            r.send_target(0.0, 0.01, aside_mps=-1.5, yaw_rad=bearing_rad)
        r.step()
        if number > 60:  # a few readings after it is trusted
            leader_mps = r.host.local_value("track").leader_mps
            off_mps.append(leader_mps - 1.5 * math.sin(bearing_rad))
    assert max(map(abs, off_mps)) < 0.5


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


# ---- orders to the gimbal through a lost link -----

VECTORS = Path(__file__).parents[1] / "flight" / "look.toml"
LOOKS = tomllib.loads(VECTORS.read_text(encoding="utf-8"))["look"]
LEVEL = [row for row in LOOKS if row["to_it_m"][2] == 0.0 and row["past_mps"][2] == 0.0]
SET_ATTITUDE, LINK, SONAR = 284, 1, 191


def alone(r: Rig, seconds: float, range_m: float = 3.0) -> Rig:
    """No point comes any more. The sonar reads on; a reading that never wavers is stuck."""
    for number in range(round(seconds / 0.1)):
        r.range(range_m + 0.01 * (number % 3))
        r.run(0.1)
    return r


def looks(r: Rig) -> list[Any]:
    """The orders that have left, as the co-processor's parser sees them."""
    orders = []
    for link, number, payload in r.vehicle.sent:
        assert (link, number) == (LINK, SET_ATTITUDE)
        frame = mavlink_frame(number, payload, 1, component=1)
        orders.append(mavlink.MAVLink(None).decode(bytearray(frame)))
    return orders


def azimuth_rad(order: Any) -> float:
    axis = axis_of(order.q)
    assert axis is not None
    assert axis.elevation_rad == pytest.approx(0.0, abs=1e-6)
    return axis.azimuth_rad


@pytest.mark.parametrize("row", LEVEL)
def test_a_look_is_the_tables(rig: MakeRig, row: dict[str, Any]) -> None:
    """As the ground tool's (tests/flight/test_look_vectors.py)."""
    r = flown(rig(), 0.5, 3.0, 0.0)
    (north_m, east_m, _), (north_mps, east_mps, _) = row["to_it_m"], row["past_mps"]
    r.host.local_value("look").order(north_m, east_m, north_mps, east_mps, row["unsure_m"])

    (order,) = looks(r)
    assert order.q == pytest.approx(row["quaternion"], abs=1e-5)
    assert math.degrees(order.angular_velocity_z) == pytest.approx(row["azimuth_dps"], abs=1e-3)
    assert math.degrees(order.angular_velocity_x) == pytest.approx(row["unsure_deg"], abs=1e-3)
    assert order.angular_velocity_y == 0.0
    assert order.flags == WITHOUT_HEIGHT
    assert (order.target_system, order.target_component) == (1, SONAR)


def test_while_points_come_the_ground_tool_alone_tells_where_to_look(rig: MakeRig) -> None:
    """Up to half a second without a point is the radio."""
    r = flown(rig(), 2.0, 3.0, ASIDE_RAD)
    alone(r, 0.4)  # and the 0.12 s from the last one
    assert r.vehicle.sent == []


def test_through_a_lost_link_the_gimbal_is_ordered_on(rig: MakeRig) -> None:
    """From half a second on, 5 to 10 times a second, at the leader whom it still hears."""
    r = flown(rig(), 2.0, 3.0, ASIDE_RAD)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    r.send_target(0.0, 0.001, yaw_rad=ASIDE_RAD)
    alone(r, 10.5)
    orders = looks(r)
    assert 50 <= len(orders) <= 100
    for one in orders:
        assert azimuth_rad(one) == pytest.approx(ASIDE_RAD, abs=0.01)


def test_its_orders_end_with_the_lost_link(rig: MakeRig) -> None:
    r = flown(rig(), 2.0, 3.0, ASIDE_RAD)
    alone(r, 1.0)
    assert len(r.vehicle.sent) > 0
    flown(r, 0.12, 3.0, ASIDE_RAD)
    before = len(r.vehicle.sent)
    flown(r, 2.0, 3.0, ASIDE_RAD)
    assert len(r.vehicle.sent) == before


def test_a_leader_that_is_lost_is_not_looked_at_any_longer(rig: MakeRig) -> None:
    """ECHO_LOST_T after the last reading."""
    r = flown(rig(LOST_T=1.3), 2.0, 3.0, 0.0)
    r.range(7.66, HIGH)
    r.run(0.9)
    assert len(r.vehicle.sent) > 1
    r.run(0.5)
    before = len(r.vehicle.sent)
    r.run(3.0)
    assert len(r.vehicle.sent) == before


def test_the_leader_flies_on_and_so_does_the_vehicle(rig: MakeRig) -> None:
    """Abreast of it, 3 m to the east, at 2 m/s, the leader flies on north as the vehicle stands.

    Its direction turns to the left, and what is sent turns on with it until the next.
    """
    r = flown(rig(), 2.0, 3.0, math.pi / 2, along_rad=0.0)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    alone(r, 0.7)
    ahead_m = LEADER_MPS * 0.7 * (1.0 - 0.7 / 4.0)  # what a point tells of it fades within 2 s
    order = looks(r)[-1]
    assert azimuth_rad(order) == pytest.approx(math.pi / 2 - ahead_m / 3.0, abs=0.12)
    assert order.angular_velocity_z == pytest.approx(-LEADER_MPS * 0.65 / 3.0, abs=0.1)


def test_after_two_seconds_a_point_tells_nothing_of_the_leaders_speed(rig: MakeRig) -> None:
    """It is heard at the same range all the while: it stands, where it was heard last."""
    r = flown(rig(), 2.0, 3.0, math.pi / 2, along_rad=0.0)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    alone(r, 2.2)
    before_rad = azimuth_rad(looks(r)[-1])
    alone(r, 3.0)
    assert azimuth_rad(looks(r)[-1]) == pytest.approx(before_rad, abs=0.01)
    assert looks(r)[-1].angular_velocity_z == pytest.approx(0.0, abs=1e-3)


def test_it_is_the_less_sure_the_longer_the_leader_is_not_heard(rig: MakeRig) -> None:
    """0.2 m, and what a leader makes aside with 1 m/s2, at 3 m."""
    r = flown(rig(LOST_T=3.0), 2.0, 3.0, 0.0)
    alone(r, 5.0)
    assert looks(r)[-1].angular_velocity_x == pytest.approx(math.atan2(0.2, 3.0), abs=0.01)
    r.range(7.66, HIGH)
    r.run(2.0)
    assert looks(r)[-1].angular_velocity_x == pytest.approx(math.atan2(0.2 + 2.0, 3.0), abs=0.1)


def test_its_own_motion_turns_the_look(rig: MakeRig) -> None:
    """The leader stands 3 m east; the vehicle, pushed north at 1 m/s, passes it."""
    r = flown(rig(), 2.0, 3.0, math.pi / 2)
    r.send_target(0.0, 0.001, yaw_rad=math.pi / 2)
    r.vehicle.velocity = (1.0, 0.0, 0.0)
    alone(r, 1.5)
    assert azimuth_rad(looks(r)[-1]) == pytest.approx(math.pi / 2 + 0.5, abs=0.1)
    assert looks(r)[-1].angular_velocity_z > 0.25


@pytest.mark.parametrize("why", ["pilot", "no leader", "no yaw", "no sonar", "no room", "no call"])
def test_nothing_is_ordered(rig: MakeRig, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By an applet that is not in control, or to nobody; a full link, or ArduPilot's old calls."""
    if why == "no call":
        calls = [one for one in luahost._binding_sources() if one[0].name != "send_chan"]
        monkeypatch.setattr(luahost, "_binding_sources", lambda: calls)
    range_m = 7.66 if why == "no leader" else 3.0
    r = flown(rig(), 2.0, range_m, None if why == "no yaw" else ASIDE_RAD)
    r.vehicle.has_room = why != "no room"
    if why == "pilot":
        r.vehicle.mode = 5
    if why == "no sonar":
        r.host.local_value("look").link = None
        r.raw_every_ms = None
    r.run(3.0)
    assert r.vehicle.sent == []
    assert not [text for text in r.texts if text.startswith("error")]


@pytest.mark.parametrize(
    "given",
    [(math.nan, 1, 0, 0, 1), (1, 1, math.inf, 0, 1), (1, 1, 0, 0, math.nan), (0, 1, 9.0, 0, 1)],
)
def test_no_impossible_look_leaves(rig: MakeRig, given: tuple[float, ...]) -> None:
    r = flown(rig(), 0.5, 3.0, 0.0)
    assert r.host.local_value("look").order(*given) is False
    assert r.vehicle.sent == []
    assert "implausible look, not used" in r.texts


def test_the_gimbal_is_the_sonars_by_sender_and_link(rig: MakeRig) -> None:
    """Another component, on another link."""
    r = flown(rig(), 0.5, 3.0, 0.0)
    r.raw_every_ms = None
    payload = struct.pack("<If10s", r.vehicle.t_ms, 3.0, b"SNR_RAW")
    r.vehicle.inbox.append((mavlink_frame(251, payload, 1, component=154), 0))
    r.run(0.1)
    r.host.local_value("look").order(3, 0, 0, 0, 1)
    ((link, _, sent),) = r.vehicle.sent
    assert (link, sent[-1]) == (0, 154)
