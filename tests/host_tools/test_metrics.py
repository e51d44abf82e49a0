"""Metrics by hand on tiny flights, and the identities they must keep on any."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from echowing.analysis.flight import Flight, Floats
from echowing.analysis.metrics import (
    Metrics,
    aggregate,
    approach_s,
    by_sonar,
    dead_locked,
    metrics,
    position_error_m,
)
from echowing.errors import EchowingError
from echowing.flight.guidance import Slot, slot_offset_m

NAN = math.nan


def flight(
    separations_m: list[float],
    *,
    course_rad: float = 0.0,
    right_m: float = 0.0,
    angle_rad: float = 0.0,
    period_s: float = 0.1,
) -> Flight:
    """A leader at 2 m/s, its follower so far behind it and to the right, wanted 3 m."""
    count = len(separations_m)
    time_s: Floats = np.arange(count, dtype=float) * period_s
    ahead = np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    right = np.array([-math.sin(course_rad), math.cos(course_rad), 0.0])
    leader = 2.0 * time_s[:, np.newaxis] * ahead
    behind = np.array(separations_m)[:, np.newaxis]
    velocity = np.tile(2.0 * ahead, (count, 1))
    slot = slot_offset_m(Slot(3.0, angle_rad), course_rad)
    return Flight(
        name="hand",
        wanted_separation_m=3.0,
        wanted_angle_rad=angle_rad,
        time_s=time_s,
        leader_ned_m=leader,
        leader_velocity_mps=velocity,
        follower_ned_m=leader - behind * ahead + right_m * right,
        follower_velocity_mps=velocity,
        follower_yaw_rad=np.full(count, course_rad),
        slot_ned_m=leader + np.array([*slot, 0.0]),
        sonar_m=np.array(separations_m, dtype=float),
        speed_command_mps=np.full(count, 2.0),
        pan_us=np.full(count, 1500.0),
        tilt_us=np.full(count, 1500.0),
    )


def test_figures_of_two_samples_by_hand() -> None:
    ours = metrics(flight([2.0, 5.0]))
    # errors -1 and +2
    assert ours.mean_separation_m == pytest.approx(3.5)
    assert ours.mean_abs_error_m == pytest.approx(1.5)
    assert ours.rmsd_m == pytest.approx(math.sqrt(2.5))
    assert ours.std_m == pytest.approx(1.5)
    assert (ours.min_separation_m, ours.max_separation_m) == pytest.approx((2.0, 5.0))
    # 2 m behind the leader is 1 m ahead of the slot; 5 m is 2 m behind it
    assert ours.forward_mean_m == pytest.approx(-0.5)
    assert ours.forward_sigma_m == pytest.approx(1.5)
    assert ours.forward_drms_m == pytest.approx(math.sqrt(2.5))
    assert ours.right_drms_m == pytest.approx(0.0)
    assert ours.slot_error_m == pytest.approx(1.5)
    assert ours.position_sigma_m == pytest.approx(0.5)
    assert ours.position_drms_m == pytest.approx(math.sqrt(2.5))
    assert (ours.samples, ours.left_out) == (2, 0)


def test_separation_is_in_three_dimensions_and_slot_error_is_horizontal() -> None:
    level = flight([3.0, 3.0])
    lifted = level.follower_ned_m + np.array([0.0, 0.0, -4.0])
    ours = metrics(replace(level, follower_ned_m=lifted))
    assert ours.mean_separation_m == pytest.approx(5.0)
    assert ours.slot_error_m == pytest.approx(0.0)


@given(
    separations_m=st.lists(st.floats(0.1, 60.0), min_size=1, max_size=40),
    right_m=st.floats(-5.0, 5.0),
    course_rad=st.floats(-math.pi, math.pi),
)
def test_rmsd_and_drms_are_deviation_and_mean_together(
    separations_m: list[float], right_m: float, course_rad: float
) -> None:
    ours = metrics(flight(separations_m, right_m=right_m, course_rad=course_rad))
    bias_m = ours.mean_separation_m - 3.0
    assert ours.rmsd_m**2 == pytest.approx(ours.std_m**2 + bias_m**2, abs=1e-9)
    for mean, sigma, drms in (
        (ours.forward_mean_m, ours.forward_sigma_m, ours.forward_drms_m),
        (ours.right_mean_m, ours.right_sigma_m, ours.right_drms_m),
        (ours.slot_error_m, ours.position_sigma_m, ours.position_drms_m),
    ):
        assert drms**2 == pytest.approx(mean**2 + sigma**2, abs=1e-9)
    both = ours.forward_drms_m**2 + ours.right_drms_m**2
    assert ours.position_drms_m**2 == pytest.approx(both, abs=1e-9)


@pytest.mark.parametrize("course_deg", range(-180, 181, 15))
@pytest.mark.parametrize("angle_deg", [-90.0, 0.0, 60.0])
def test_a_follower_to_the_right_has_a_positive_right_error_on_every_course(
    course_deg: int, angle_deg: float
) -> None:
    course_rad = math.radians(course_deg)
    base = flight([3.0], course_rad=course_rad, angle_rad=math.radians(angle_deg))
    right = np.array([-math.sin(course_rad), math.cos(course_rad), 0.0])
    ahead = np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    moved = replace(base, follower_ned_m=base.slot_ned_m + 1.5 * right - 0.5 * ahead)
    assert position_error_m(moved)[0] == pytest.approx([-0.5, 1.5])


def test_the_first_seconds_can_be_left_out() -> None:
    settling = flight([9.0] * 10 + [3.0] * 10)
    assert metrics(settling, settle_s=1.0).mean_separation_m == pytest.approx(3.0)
    assert metrics(settling).mean_separation_m == pytest.approx(6.0)


def test_samples_without_positions_are_left_out_and_counted() -> None:
    whole = flight([3.0, 4.0, 5.0])
    holed = whole.follower_ned_m.copy()
    holed[1] = NAN
    ours = metrics(replace(whole, follower_ned_m=holed))
    assert ours.mean_separation_m == pytest.approx(4.0)
    assert ours.rmsd_m == pytest.approx(math.sqrt(2.0))
    assert (ours.samples, ours.left_out) == (2, 1)


def test_an_unknown_slot_leaves_the_separation_known() -> None:
    whole = flight([3.0, 4.0])
    ours = metrics(replace(whole, slot_ned_m=np.full((2, 3), NAN)))
    assert ours.mean_separation_m == pytest.approx(3.5)
    assert ours.to_json()["slot_error_m"] is None


def test_share_seen_is_of_readings_and_unknown_without_a_sonar() -> None:
    half = replace(flight([3.0] * 4), sonar_m=np.array([3.0, NAN, 3.1, NAN]))
    assert metrics(half).seen_share == pytest.approx(0.5)
    assert metrics(replace(half, sonar_known=False)).to_json()["seen_share"] is None


@pytest.mark.parametrize("settle_s", [0.0, 100.0])
def test_nothing_to_measure_says_which_flight_and_why(settle_s: float) -> None:
    empty = flight([] if settle_s == 0.0 else [3.0, 3.0])
    with pytest.raises(EchowingError, match="hand"):
        metrics(empty, settle_s=settle_s)


def test_json_holds_every_figure_as_a_plain_value() -> None:
    told = json.loads(json.dumps(metrics(flight([2.0, 5.0])).to_json(), allow_nan=False))
    assert set(told) == {item.name for item in fields(Metrics)}
    assert told["rmsd_m"] == 1.5811


def test_aggregate_has_mean_sample_deviation_and_extremes() -> None:
    spread = aggregate([metrics(flight([m])) for m in (2.0, 4.0, 6.0)])["mean_separation_m"]
    assert (spread.mean, spread.std) == pytest.approx((4.0, 2.0))
    assert (spread.lowest, spread.highest, spread.count) == pytest.approx((2.0, 6.0, 3))


def test_aggregate_leaves_unknown_figures_out_of_the_mean() -> None:
    known = metrics(flight([3.0]))
    spread = aggregate([known, replace(known, seen_share=NAN)])["seen_share"]
    assert (spread.mean, spread.count) == (1.0, 1)


def test_aggregate_of_nothing_is_an_error() -> None:
    with pytest.raises(EchowingError, match="no flights"):
        aggregate([])


def losing(command_mps: float, *, seen_again_s: float | None = None) -> Flight:
    """Sees its leader for 10 s, then falls behind at 0.5 m/s for 30 s, the command held."""
    time_s = np.arange(400) * 0.1
    lost: Floats = np.maximum(time_s - 10.0, 0.0)
    base = flight((4.4 + 0.5 * lost).tolist())
    sonar_m = np.where(time_s <= 10.0, base.separation_m, NAN)
    if seen_again_s is not None:
        at = int(seen_again_s * 10)
        sonar_m[at] = base.separation_m[at]
    return replace(base, sonar_m=sonar_m, speed_command_mps=np.full(400, command_mps))


def test_a_slow_follower_that_lost_its_leader_is_dead_locked() -> None:
    assert dead_locked(losing(1.5))


def test_no_dead_lock_when_the_command_is_not_below_the_leaders_speed() -> None:
    assert not dead_locked(losing(2.5))


def test_no_dead_lock_when_the_speed_is_raised_after_the_loss() -> None:
    raised = losing(1.5)
    command_mps = raised.speed_command_mps.copy()
    command_mps[300:] = 4.5
    assert not dead_locked(replace(raised, speed_command_mps=command_mps))


def test_no_dead_lock_when_the_leader_was_seen_near_the_end() -> None:
    assert not dead_locked(losing(1.5, seen_again_s=30.0))


def test_a_wild_reading_is_no_sight_of_the_leader() -> None:
    lost = losing(1.5)
    sonar_m = lost.sonar_m.copy()
    sonar_m[350] = 1.0  # the leader is 17 m away then
    assert dead_locked(replace(lost, sonar_m=sonar_m))


def test_no_dead_lock_while_the_separation_does_not_grow() -> None:
    steady = flight([4.4] * 400)
    blind = replace(steady, sonar_m=np.full(400, NAN), speed_command_mps=np.full(400, 1.5))
    assert not dead_locked(blind)


def test_no_dead_lock_without_a_speed_command() -> None:
    lost = losing(1.5)
    assert not dead_locked(replace(lost, speed_command_mps=np.full(400, NAN)))


# ---- the approach, and the other witness -------------------------------------------------------


def test_the_approach_ends_at_the_first_moment_near_the_slot() -> None:
    # Wanted 3 m: 1.1 m too far is still on the way, 1.0 m is not; leaving again is flying.
    coming = blind(flight([9.0, 6.0, 4.1, 4.0, 3.0, 5.5]))
    assert approach_s(coming) == pytest.approx(0.3)
    kept = metrics(coming, approach_s(coming))
    assert kept.mean_separation_m == pytest.approx((4.0 + 3.0 + 5.5) / 3.0)
    assert kept.settle_s == pytest.approx(0.3)
    assert kept.wanted_m == 3.0
    assert approach_s(flight([3.2, 3.0])) == 0.0
    # One that never comes is measured whole.
    assert approach_s(flight([9.0, 8.0])) == 0.0


def blind(one: Flight) -> Flight:
    """The same without a reading."""
    return replace(one, sonar_m=np.full(len(one.time_s), NAN))


def test_the_sonar_ends_the_approach_where_the_receivers_disagree() -> None:
    # By positions the follower is 1.5 m off its slot all the time; the sonar knows better.
    off = flight([4.5] * 8, right_m=1.5, period_s=0.5)
    seen = replace(off, sonar_m=np.array([NAN, 3.1, 4.2, 3.9, 3.5, 3.1, 3.0, 3.0]))
    assert approach_s(seen) == pytest.approx(1.5)  # not at the single echo before
    # One reading is no proof, and what is not steady for a second is none.
    single = replace(off, sonar_m=np.array([NAN, 3.2, NAN, 3.2, 3.2, NAN, 3.2, 3.2]))
    assert approach_s(single) == 0.0


def test_a_step_in_height_is_no_part_of_the_way_to_the_slot() -> None:
    low = flight([9.0, 3.0])
    sunk = replace(low, follower_ned_m=low.follower_ned_m + np.array([0.0, 0.0, 4.0]))
    assert approach_s(sunk) == pytest.approx(0.1)


def test_by_sonar_is_what_the_sonar_measured_while_it_saw() -> None:
    whole = flight([9.0, 3.0, 3.5, 4.0])
    seen = replace(whole, sonar_m=np.array([8.0, NAN, 3.1, 3.5]))
    ours = by_sonar(seen, settle_s=0.1)
    assert ours is not None
    assert ours.mean_separation_m == pytest.approx(3.5)  # 0.2 m more than it reads
    assert ours.mean_abs_error_m == pytest.approx(0.5)
    assert ours.seen_share == pytest.approx(2 / 3)
    assert ours.samples == 2
    assert math.isnan(ours.slot_error_m)
    assert by_sonar(replace(whole, sonar_m=np.full(4, NAN))) is None
