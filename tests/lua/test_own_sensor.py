"""A forward rangefinder that the autopilot's own driver reads, fixed to the nose."""

import math

import pytest
from tests.lua.conftest import MakeRig, Rig

from echowing.sim.vehicle.luahost import RangefinderBackend
from echowing.sim.vehicle.rangefinder import (
    GOOD,
    MAVLINK_TYPE,
    MAXBOTIX_TYPE,
    OUT_OF_RANGE_HIGH,
    OUT_OF_RANGE_LOW,
)

FORWARD, DOWN = 0, 25  # RNGFNDn_ORIENT
STARTED_MS = 10  # from then on the applet counts
TFMINI_TYPE = 25  # RNGFNDn_TYPE of a Benewake TFmini Plus by I2C
SEARCHING, TOO_CLOSE, NO_SONAR, HOLDING = 1, 3, 4, 7


def flying(rig: MakeRig, kind: int = TFMINI_TYPE, every_ms: int = 100, **applet: float) -> Rig:
    """3 m behind its leader, at its speed; points every 120 ms, readings every so often."""
    r = rig(**applet)
    r.vehicle.range_type = kind
    r.stream_mps, r.stream_every_ms, r.raw_every_ms = 2.0, 120, every_ms
    r.vehicle.velocity = (2.0, 0.0, 0.0)
    return r.range(3.0).run(3.0)


def track(r: Rig) -> dict[str, float]:
    state: dict[str, float] = r.host.local_value("track")
    return state


@pytest.mark.parametrize("kind", [TFMINI_TYPE, MAXBOTIX_TYPE])
def test_it_is_held_by(rig: MakeRig, kind: int) -> None:
    r = flying(rig, kind)
    assert r.state == HOLDING
    assert track(r)["range_m"] == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((FORWARD, TFMINI_TYPE), MAVLINK_TYPE),
        ((DOWN, TFMINI_TYPE), MAVLINK_TYPE),
        ((DOWN, TFMINI_TYPE), MAXBOTIX_TYPE),
        ((DOWN, MAVLINK_TYPE), MAXBOTIX_TYPE),
    ],
)
def test_the_co_processors_counts_before_another_and_no_other_one_than_a_forward_one(
    rig: MakeRig, first: tuple[int, int], second: int
) -> None:
    r = flying(rig, second)
    r.vehicle.first_sensors = [RangefinderBackend(*first, GOOD, 4.0, r.vehicle.t_ms)]
    r.run(3.0)
    assert r.state == HOLDING
    assert track(r)["range_m"] == pytest.approx(3.0, abs=0.01)


def test_of_two_that_the_autopilot_reads_the_first_counts(rig: MakeRig) -> None:
    r = flying(rig)
    r.vehicle.first_sensors = [RangefinderBackend(FORWARD, MAXBOTIX_TYPE, GOOD, 4.0, 0)]
    assert r.run(2.0).state == NO_SONAR


def test_a_vehicle_may_arm_with_it(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.range_type, r.vehicle.is_armed = TFMINI_TYPE, False
    r.run(2.5)
    assert list(r.vehicle.auth.values()) == [None]


def test_the_gimbal_gets_no_orders(rig: MakeRig) -> None:
    """Through a lost link the applet moves the co-processor's; here it has none."""
    for kind, orders in ((MAVLINK_TYPE, True), (TFMINI_TYPE, False)):
        r = flying(rig, kind)
        r.send_raw(3.0)
        r.run(0.1)
        r.send_target(5.0, 2.0, yaw_rad=0.0)
        r.stream_every_ms = None
        r.run(1.0)
        assert bool(r.vehicle.sent) is orders


def test_readings_of_the_co_processor_do_not_count_then(rig: MakeRig) -> None:
    r = flying(rig)
    r.raw_every_ms = None
    seen_ms = track(r)["seen_ms"]
    for _ in range(10):
        r.send_raw(3.0)
        r.run(0.1)
    assert track(r)["seen_ms"] <= seen_ms + 100


def test_a_driver_that_renews_nothing_is_no_data(rig: MakeRig) -> None:
    """The status stays good: some drivers never say that they have lost their sensor."""
    r = flying(rig)
    r.raw_every_ms = None
    r.run(2.2)
    assert r.state == NO_SONAR


def test_one_that_reads_the_same_while_the_vehicle_changes_its_speed_is_stuck(rig: MakeRig) -> None:
    r = flying(rig)
    for step in range(100):
        r.vehicle.velocity = (2.0 + 0.01 * step, 0.0, 0.0)
        r.run(0.02)
    assert "sonar stuck, not used" in r.texts


def test_too_far_is_no_target(rig: MakeRig) -> None:
    r = flying(rig)
    r.range(12.0, OUT_OF_RANGE_HIGH).run(2.0)
    assert r.state == SEARCHING
    assert "no sonar data" not in "".join(r.texts)


def test_too_near_is_too_close_and_no_reading(rig: MakeRig) -> None:
    r = flying(rig)
    raw_ms = track(r)["raw_ms"]
    r.range(0.05, OUT_OF_RANGE_LOW).run(2.0)
    assert track(r)["raw_ms"] == raw_ms
    assert r.state == TOO_CLOSE


def test_good_and_nothing_is_no_measurement(rig: MakeRig) -> None:
    r = flying(rig)
    assert r.range(0.0).run(2.0).state == SEARCHING


@pytest.mark.parametrize(("off_deg", "used"), [(15.0, True), (40.0, False)])
def test_only_a_nose_that_points_at_the_leader_counts(
    rig: MakeRig, off_deg: float, used: bool
) -> None:
    """The point's yaw is the leader's bearing; a gimbal looks there, a fixed sensor may not."""
    r = flying(rig)
    r.vehicle.yaw = math.radians(off_deg)
    r.stream_every_ms = None
    for _ in range(16):
        r.send_target(5.0, 2.0, yaw_rad=0.0)
        r.run(0.12)
    assert (r.state == HOLDING) is used


@pytest.mark.parametrize(("every_ms", "counted"), [(100, 10), (50, 10), (20, 12)])
def test_a_fast_one_counts_twelve_times_a_second_at_the_most(
    rig: MakeRig, every_ms: int, counted: int
) -> None:
    """What counts readings (agreement, stuck, noise) reckons with the sonar's ten."""
    r = flying(rig, every_ms=every_ms)
    before = track(r)["readings"]
    r.run(1.0)
    assert track(r)["readings"] - before == pytest.approx(counted, abs=1)


def test_each_is_dated_by_its_driver(rig: MakeRig) -> None:
    r = flying(rig)
    assert r.vehicle.range_read_ms - STARTED_MS - track(r)["seen_ms"] in (0, 100)


def test_a_maxbotix_is_read_once_its_driver_has_handed_the_reading_out(rig: MakeRig) -> None:
    """Its stamp is up to 50 ms older than its distance, and the ping 0.1 s older than the stamp."""
    r = flying(rig, MAXBOTIX_TYPE)
    while r.vehicle.t_ms % 100:
        r.step()
    r.raw_every_ms = None
    r.vehicle.range_read_ms = r.vehicle.t_ms
    stamp_ms = r.vehicle.t_ms - STARTED_MS
    r.run(0.04)
    assert track(r)["seen_ms"] < stamp_ms - 100
    r.range(3.05).run(0.08)
    assert track(r)["seen_ms"] == stamp_ms - 50
    assert track(r)["same_m"] == pytest.approx(3.05)
