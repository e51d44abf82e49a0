import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.belief import Curve, SonarBelief
from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import Limits
from echowing.flight.guidance import GRAY, GuidanceSettings, Slot
from echowing.flight.hearing import Heard
from echowing.flight.jumps import AGREEING_REPORTS
from echowing.flight.leader_track import CLOCKS_AGREE_S, VehicleClock
from echowing.flight.plan import planned, quickens_mps2
from echowing.flight.session import FollowSession
from echowing.flight.steps import Phase, Standing
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.mavlink.messages import EARTH_FRAME, FORWARD, TOOL_SYSTEM_ID, guides, sonar_range_m
from echowing.sonar_file import load_sonar, shipped_sonar

LEADER, FOLLOWER = 1, 2
HERE = GlobalPosition(39.34, -86.03, 260.0)
FOLLOWER_AT = displace(HERE, (-4.0, 0.0, 0.0))
REACH_M = shipped_sonar().reach_m


def from_vehicle(system_id: int, message: Any) -> Any:
    """The message as received: packed by the vehicle, parsed by us."""
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


def position(boot_s: float, at: GlobalPosition, velocity: tuple[float, float] = (0.0, 0.0)) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3),
        round(at.lat_deg * 1e7),
        round(at.lon_deg * 1e7),
        round(at.alt_m * 1e3),
        10_000,
        round(velocity[0] * 100),
        round(velocity[1] * 100),
        0,
        0,
    )


def heartbeat(mode: int = 4, *, armed: bool = True) -> Any:
    flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(2, 3, flags, mode, 4, 3)


# Without what is learnt from the sonar, which has tests of its own below.
PLAIN = GuidanceSettings(learn_offset=False)
BY_POSITION = replace(PLAIN, feed_forward=False)


def session(settings: GuidanceSettings = PLAIN, *, hears: bool = False) -> FollowSession:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 12.0, sonar=shipped_sonar())
    follow = FollowSession(LEADER, [plan], settings)
    if hears:
        follow.followers[FOLLOWER].estimate.offset._heard_at_s = math.inf
    follow.receive(from_vehicle(FOLLOWER, heartbeat()), 0.0)
    follow.receive(from_vehicle(FOLLOWER, position(0.1, FOLLOWER_AT)), 0.0)
    return follow


def targets(follow: FollowSession, now_s: float) -> list[Any]:
    return [
        message
        for _, message in follow.tick(now_s)
        if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    ]


def metres_from_here(target: Any) -> tuple[float, float]:
    point = GlobalPosition(target.lat_int / 1e7, target.lon_int / 1e7, HERE.alt_m)
    north, east, _ = ned_between(HERE, point)
    return north, east


def test_a_point_with_a_velocity_is_sent_behind_the_leader_at_the_planned_altitude() -> None:
    follow = session(hears=True)
    near_its_slot = displace(HERE, (-2.8, 0.0, 0.0))
    follow.receive(from_vehicle(FOLLOWER, position(1.0, near_its_slot)), 1.0)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (1.6, 0.0))), 1.0)

    (target,) = targets(follow, 1.0)

    # The slot is 3 m behind where the leader is when the point arrives, a quarter of a second on at
    # 1.6 m/s: 0.2 m ahead of the follower, which closes half of that in a second.
    assert metres_from_here(target) == pytest.approx((-2.8, 0.0), abs=0.03)
    assert (target.vx, target.vy, target.vz) == pytest.approx((1.7, 0.0, 0.0), abs=0.01)
    assert target.alt == pytest.approx(12.0)
    assert target.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    assert target.target_system == FOLLOWER
    assert target.yaw == pytest.approx(0.0, abs=0.01)
    assert not target.type_mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    assert not target.type_mask & mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    assert target.type_mask & mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE


def test_a_point_without_a_velocity_runs_ahead() -> None:
    follow = session(BY_POSITION)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (2.0, 0.0))), 1.0)

    (target,) = targets(follow, 1.0)

    # 3 m behind where it is when the point arrives, a quarter of a second on; led by 2 m.
    assert metres_from_here(target) == pytest.approx((-0.5, 0.0), abs=0.03)
    assert target.type_mask & mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE


@pytest.mark.parametrize(("behind_m", "mps"), [(5.0, 1.5), (1.0, 0.5)])
@pytest.mark.parametrize("unheard_s", [0.0, 2.0, math.inf])
def test_a_slot_is_closed_on_by_speed(behind_m: float, mps: float, unheard_s: float) -> None:
    """Guided would close 1 m by 2 m/s and more, where the envelope reckons with 1 m/s.

    No place ahead, that it would overshoot. With or without an echo of the leader, which stands.
    """
    follow = session()
    state, at = follow.followers[FOLLOWER], displace(HERE, (-3.0 - behind_m, 0.0, 0.0))
    state.estimate.offset._heard_at_s = 1.0 - unheard_s
    follow.receive(from_vehicle(FOLLOWER, position(0.9, at)), 0.9)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)

    (target,) = targets(follow, 1.0)
    assert metres_from_here(target)[0] == pytest.approx(-3.0 - behind_m, abs=0.03)
    assert target.vx == pytest.approx(mps, abs=0.02)


def opens_to_m(behind_m: float, *, deaf: bool = False) -> float:
    """The widest slot of one that hears a leader at 4 m/s, 3 m ahead, and then is so far behind.

    deaf: what it does not hear then would have been heard, wherever it is.
    """
    follow = session(GuidanceSettings())
    state = follow.followers[FOLLOWER]
    widest_m, lost_s = 0.0, 4.0
    for tick in range(100):
        now_s = 1.0 + 0.1 * tick
        hears = now_s < lost_s
        leader, flown = displace(HERE, (4.0 * now_s, 0.0, 0.0)), (4.0, 0.0)
        at = displace(leader, (-3.0 if hears else -behind_m, 0.0, 0.0))
        follow.receive(from_vehicle(FOLLOWER, position(now_s, at, flown)), now_s)
        follow.receive(from_vehicle(LEADER, position(now_s, leader, flown)), now_s)
        state.estimate.heard(now_s, 3.0 if hears else REACH_M)
        if deaf and not hears:
            state.estimate.offset._deaf[:] = True
        follow.tick(now_s)
        assert state.guided is not None
        if now_s > lost_s:
            widest_m = max(widest_m, math.hypot(*state.guided.offset_m))
    return widest_m


def test_one_that_fell_behind_closes_to_where_its_sonar_hears_the_leader() -> None:
    """5 m behind it cannot hear it: as far off as its sonar reaches, less what receivers err by."""
    assert opens_to_m(5.0) == pytest.approx(3.8)
    assert opens_to_m(4.0, deaf=True) > 3.5, "within reach, and not heard"


def test_a_slot_that_was_opened_closes_at_once_and_is_flown_to_by_speed() -> None:
    follow = session()
    state, at = follow.followers[FOLLOWER], displace(HERE, (-5.0, 0.0, 0.0))
    ways = []
    for tick in range(8):
        now_s = 1.0 + 0.125 * tick
        state.reversal_m = 5.0 if tick < 4 else 0.0
        follow.receive(from_vehicle(FOLLOWER, position(now_s, at)), now_s)
        follow.receive(from_vehicle(LEADER, position(now_s, HERE)), now_s)
        (target,) = targets(follow, now_s)
        assert state.guided is not None
        ways.append((math.hypot(*state.guided.offset_m), target.vx))
    assert ways[3] == pytest.approx((5.0, 0.0), abs=0.02)
    # 3 m of slot, and half of the 2 m in a second.
    assert ways[4] == pytest.approx((3.0, 1.0), abs=0.02)


@pytest.mark.parametrize(
    ("before_mps", "stops_m"),
    [
        # 2 m/s as reported 0.1 s ago, a quarter of a second on the way; 0.3 s until it leans; then
        # WP_ACC's default, 2.5 m/s2.
        (2.0, 0.35 * 2.0 + 0.3 * 2.0 + 2.0**2 / 5.0),
        # Braking with 2.5 m/s2 already: 0.6 s of that, and it flies 0.5 m/s.
        (2.25, 0.05 * 2.0 + 0.6 * 1.25 + 0.5**2 / 5.0),
    ],
)
def test_a_stop_counts_with_the_braking_that_is_under_way(
    before_mps: float, stops_m: float
) -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    at = displace(HERE, (-9.0, 0.0, 0.0))
    follow.receive(from_vehicle(FOLLOWER, position(2.0, at, (before_mps, 0.0))), 2.0)
    follow.receive(from_vehicle(FOLLOWER, position(2.1, at, (2.0, 0.0))), 2.1)

    (target,) = targets(follow, 2.2)  # the leader is stale
    assert follow.followers[FOLLOWER].standing == Standing(Phase.HELD, "leader is stale")
    assert metres_from_here(target)[0] + 9.0 == pytest.approx(stops_m, abs=0.03)


def test_what_the_point_is_late_by_its_vehicle_is_carried_on_too() -> None:
    """A follower as fast as its leader is where it was, as seen from it: no correction."""
    follow = session()
    place = displace(HERE, (-3.0, 0.0, 0.0))
    follow.receive(from_vehicle(FOLLOWER, position(1.0, place, (2.0, 0.0))), 1.0)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (2.0, 0.0))), 1.0)

    (target,) = targets(follow, 1.0)

    assert metres_from_here(target) == pytest.approx((-2.5, 0.0), abs=0.03)
    assert target.yaw == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("beat", [heartbeat(5), heartbeat(4, armed=False)])
def test_a_follower_that_is_not_armed_in_guided_is_left_alone(beat: Any) -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    assert len(targets(follow, 1.0)) == 1

    follow.receive(from_vehicle(FOLLOWER, beat), 1.1)

    assert targets(follow, 1.2) == []
    assert any("pilot has control" in text for _, text in follow.events)


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg"), [(91.0, -86.03), (-214.0, 0.0), (39.34, 180.1), (39.34, -214.0)]
)
def test_a_place_that_is_nowhere_is_no_report(lat_deg: float, lon_deg: float) -> None:
    follow = session(hears=True)
    follow.receive(from_vehicle(LEADER, position(100.0, HERE)), 1.0)
    nowhere = GlobalPosition(lat_deg, lon_deg, 260.0)
    for system_id in (LEADER, FOLLOWER):  # with the stamp of a vehicle that has just started
        follow.receive(from_vehicle(system_id, position(0.05, nowhere)), 1.05)
    assert targets(follow, 1.1)
    follower = follow.followers[FOLLOWER]
    assert follower.guided is not None
    slot_m = ned_between(HERE, follower.guided.slot)[:2]
    assert slot_m == pytest.approx((-3.0, 0.0), abs=0.03)
    assert follower.position == pytest.approx(FOLLOWER_AT, abs=1e-7)


def test_an_unknown_heading_is_not_a_heading() -> None:
    """65535 is MAVLink's word for it, and 655 degrees would put the slot to the leader's side."""
    follow = session(GRAY)
    for boot_s, heading_cdeg in ((1.0, 9_000), (1.25, 65_535)):
        report = position(boot_s, HERE)
        report.hdg = heading_cdeg
        for system_id in (LEADER, FOLLOWER):
            follow.receive(from_vehicle(system_id, report), boot_s)
    (target,) = targets(follow, 1.3)
    assert metres_from_here(target) == pytest.approx((0.0, -3.0), abs=0.03)
    assert follow.followers[FOLLOWER].heading_rad == pytest.approx(math.pi / 2)


def test_no_message_ever_changes_a_mode() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    follow.receive(from_vehicle(FOLLOWER, heartbeat(5)), 1.0)

    sent = [message for step in range(100) for _, message in follow.tick(step * 0.125)]

    commands = {m.command for m in sent if m.get_type() == "COMMAND_LONG"}
    assert commands == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}
    assert "SET_MODE" not in {m.get_type() for m in sent}


def test_a_heartbeat_of_another_component_does_not_engage() -> None:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), sonar=shipped_sonar())
    follow = FollowSession(LEADER, [plan], GuidanceSettings())
    sender = mavlink.MAVLink(None, srcSystem=FOLLOWER, srcComponent=191)
    follow.receive(mavlink.MAVLink(None).decode(bytearray(heartbeat().pack(sender))), 0.0)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)

    assert targets(follow, 1.0) == []


def sonar_reading(boot_s: float, range_m: float) -> Any:
    """A single reading, dated by the co-processor's own clock."""
    return mavlink.MAVLink_named_value_float_message(round(boot_s * 1e3), b"SNR_RAW", range_m)


def average(range_m: float, orientation: int = FORWARD) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        0, 20, 765, round(range_m * 100.0), 0, 0, orientation, 0
    )


@pytest.mark.parametrize(
    ("component", "message", "is_read"),
    [
        (1, heartbeat(), True),
        (
            191,
            mavlink.MAVLink_gimbal_device_attitude_status_message(
                0, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0
            ),
            True,
        ),
        (191, sonar_reading(1.0, 3.0), True),
        (191, average(3.0), True),
        (191, heartbeat(), False),
        (191, mavlink.MAVLink_param_value_message(b"WP_ACC", 1.0, 9, 1, 0), False),
    ],
)
def test_of_another_component_only_the_sonar_counts(
    component: int, message: Any, is_read: bool
) -> None:
    sender = mavlink.MAVLink(None, srcSystem=FOLLOWER, srcComponent=component)
    assert guides(mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))) == is_read


def test_where_neither_point_nor_place_is_known_nothing_is_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A follower in Guided that has not told where it is, and a plan that is no number."""
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 12.0, sonar=shipped_sonar())
    follow = FollowSession(LEADER, [plan], PLAIN)
    follow.receive(from_vehicle(FOLLOWER, heartbeat()), 0.0)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    assert len(targets(follow, 1.1)) == 1
    nowhere = GlobalPosition(math.nan, HERE.lon_deg, HERE.alt_m)
    monkeypatch.setattr(
        "echowing.flight.plan.planned",
        lambda *given: replace(planned(*given), point=nowhere),
    )
    assert targets(follow, 1.2) == []
    follow.receive(from_vehicle(FOLLOWER, position(1.3, FOLLOWER_AT)), 1.3)
    (held,) = targets(follow, 1.4)
    assert metres_from_here(held) == pytest.approx((-4.0, 0.0), abs=0.03)


def test_a_stale_leader_stops_the_follower_where_it_is() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (2.0, 0.0))), 1.0)
    assert metres_from_here(targets(follow, 1.9)[0]) != pytest.approx((-4.0, 0.0), abs=0.05)

    (held,) = targets(follow, 2.1)
    follow.receive(from_vehicle(FOLLOWER, position(2.1, displace(HERE, (-3.0, 0.0, 0.0)))), 2.15)
    (still_held,) = targets(follow, 2.2)

    assert metres_from_here(held) == pytest.approx((-4.0, 0.0), abs=0.03)
    # The point stays where it was taken: it must not creep along with the vehicle.
    assert metres_from_here(still_held) == pytest.approx((-4.0, 0.0), abs=0.03)
    # It goes on looking at where the leader is: that way it sees it come.
    assert not held.type_mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    assert held.yaw == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("settings", [PLAIN, BY_POSITION])
def test_a_hold_is_flown_in_the_same_way_as_what_it_stops(settings: GuidanceSettings) -> None:
    """Guided starts a new way with the lean of braking for its steady part: it swings back."""
    follow = session(settings)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (2.0, 0.0))), 1.0)

    (flown,), (held,) = targets(follow, 1.9), targets(follow, 2.1)

    assert follow.followers[FOLLOWER].hold is not None
    assert held.type_mask == flown.type_mask
    assert (held.vx, held.vy) == (0.0, 0.0)


@pytest.mark.parametrize("now_s", [1.0, 9.0], ids=["led", "held"])
def test_what_is_asked_of_the_receivers_is_of_when_the_points_arrive(
    monkeypatch: pytest.MonkeyPatch, now_s: float
) -> None:
    """Of one that is held, too, and before anybody asks: where it looks, where it flies."""
    follow = session(GuidanceSettings())
    asked: list[Any] = []
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    follower = follow.followers[FOLLOWER]
    monkeypatch.setattr(follower.estimate.offset, "foretell", asked.append)
    looks = "echowing.flight.session.look_at"
    monkeypatch.setattr(looks, lambda *_: asked.append("where it looks"))

    follow.tick(now_s)

    assert asked == [pytest.approx(now_s + follower.way_s), "where it looks"]


def test_a_hold_keeps_looking_at_a_leader_of_which_nothing_is_known_any_more() -> None:
    follow = session()
    beside = displace(HERE, (-2.0, -2.0, 0.0))
    follow.receive(from_vehicle(FOLLOWER, position(0.9, beside)), 0.9)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    targets(follow, 1.1)

    for now_s in (2.2, 4.0, 20.0):  # stale; then too old to be carried on
        follow.receive(from_vehicle(FOLLOWER, position(now_s, beside)), now_s)
        (held,) = targets(follow, now_s)
        assert held.yaw == pytest.approx(math.radians(45.0), abs=0.02)


def test_it_goes_on_when_the_leader_is_heard_again() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    targets(follow, 3.0)

    follow.receive(from_vehicle(LEADER, position(3.4, HERE)), 3.4)

    assert metres_from_here(targets(follow, 3.5)[0]) == pytest.approx((-3.0, 0.0), abs=0.03)
    assert [text.split(": ")[1] for _, text in follow.events] == [
        "leader is stale, holding",
        "leader reports again, following",
    ]


def test_reordered_and_doubled_reports_are_dropped() -> None:
    follow = session()
    newest = position(2.0, displace(HERE, (1.0, 0.0, 0.0)))
    follow.receive(from_vehicle(LEADER, newest), 2.0)
    fix = follow.leader.fix

    follow.receive(from_vehicle(LEADER, position(1.75, HERE)), 2.1)
    follow.receive(from_vehicle(LEADER, newest), 2.2)

    assert follow.leader.fix is fix


def test_a_leader_that_reboots_is_taken_on_its_new_clock() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(500.0, HERE)), 500.0)

    for quarter in range(AGREEING_REPORTS + 1):
        assert follow.leader.fix is not None
        assert follow.leader.fix.time_s == 500.0  # not on one report's word
        late_s = quarter / 4.0
        again = position(3.0 + late_s, displace(HERE, (1.0, 0, 0)))
        follow.receive(from_vehicle(LEADER, again), 504.0 + late_s)

    assert follow.leader.fix is not None
    assert follow.leader.fix.time_s == 506.0


def test_a_jump_is_not_followed_and_stops_the_follower_after_a_second() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    away = displace(HERE, (15.0, 0.0, 0.0))
    for number in range(1, 6):
        t_s = 1.0 + number * 0.25
        follow.receive(from_vehicle(LEADER, position(t_s, away)), t_s)

    (target,) = targets(follow, 2.3)

    assert metres_from_here(target) == pytest.approx((-4.0, 0.0), abs=0.03)
    assert follow.leader.rejected == 5


def test_a_place_that_many_reports_agree_on_is_believed() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
    away = displace(HERE, (15.0, 0.0, 0.0))
    for number in range(AGREEING_REPORTS + 2):
        t_s = 1.25 + number * 0.25
        follow.receive(from_vehicle(LEADER, position(t_s, away)), t_s)

    assert follow.leader.fix is not None
    assert ned_between(away, follow.leader.fix.position)[0] == pytest.approx(0.0, abs=0.02)


def test_time_stamps_become_our_time_by_timesync() -> None:
    """Booted at 100 s of our time; 0.46 s each way; the answer shows the vehicle's clock."""
    clock = VehicleClock()
    assert clock.to_ours(5.0, 105.9) == 105.9

    clock.answered(asked_s=105.0, vehicle_boot_s=5.46, now_s=105.92)

    assert clock.to_ours(6.0, 106.46) == pytest.approx(106.0)


def test_the_quickest_answer_counts() -> None:
    clock = VehicleClock()
    clock.answered(asked_s=10.0, vehicle_boot_s=0.1, now_s=10.2)
    clock.answered(asked_s=11.0, vehicle_boot_s=1.9, now_s=12.0)

    assert clock.to_ours(1.0, 99.0) == pytest.approx(11.0)


def test_an_answer_too_old_for_clocks_that_drift_is_forgotten() -> None:
    clock = VehicleClock()
    clock.answered(asked_s=10.0, vehicle_boot_s=0.1, now_s=10.2)
    # Its crystal is slow: after so long it is 0.1 s behind, and the link has become worse.
    late_s = 10.2 + CLOCKS_AGREE_S
    clock.answered(asked_s=late_s - 0.6, vehicle_boot_s=late_s - 0.6 - 10.1, now_s=late_s - 0.1)
    assert clock.to_ours(1.0, 99.0) == pytest.approx(11.0)
    clock.answered(asked_s=late_s + 0.5, vehicle_boot_s=late_s + 0.75 - 10.1, now_s=late_s + 1.0)
    assert clock.to_ours(1.0, 99.0) == pytest.approx(11.1)


def aged(settings: GuidanceSettings, north_m: float = -3.0) -> FollowSession:
    """The leader booted with our clock, and its answers and reports take 0.46 s each way."""
    follow = session(settings, hears=True)
    # Only what was asked is an answer of ours.
    follow.tick(5.0)
    answer = mavlink.MAVLink_timesync_message(round(5.46e9), round(5.0e9))
    follow.receive(from_vehicle(LEADER, answer), 5.92)
    follow.receive(from_vehicle(FOLLOWER, position(6.4, displace(HERE, (north_m, 0.0, 0.0)))), 6.4)
    follow.receive(from_vehicle(LEADER, position(6.0, HERE, (2.0, 0.0))), 6.46)
    assert follow.leader.fix is not None
    assert follow.leader.fix.time_s == pytest.approx(6.0)
    return follow


def test_the_leaders_age_is_measured_through_timesync() -> None:
    """Predicted on over 0.46 s, and a quarter of a second more until the point arrives."""
    (target,) = targets(aged(PLAIN, -1.5), 6.46)
    assert metres_from_here(target)[0] == pytest.approx(-3.0 + 2.0 * 0.71, abs=0.05)

    # By position: the same slot, and a lead of 0.8 s.
    (target,) = targets(aged(replace(BY_POSITION, lead_time_s=0.8)), 6.46)
    assert metres_from_here(target)[0] == pytest.approx(-3.0 + 2.0 * (0.71 + 0.8), abs=0.05)


def test_the_velocity_is_the_slots_however_old_the_leaders_report() -> None:
    """All of it until the report is stale: with less the follower would fall behind its slot."""
    speeds = [
        targets(aged(PLAIN, -3.0 + 2.0 * (now_s - 5.75)), now_s)[0].vx
        for now_s in (6.48, 6.75, 6.99)
    ]

    assert speeds == pytest.approx([2.0, 2.0, 2.0], abs=0.02)


@pytest.mark.parametrize(
    ("leader_mps", "follower_mps", "fresh_s", "expected_mps2"),
    [
        # It brakes by 2 m/s2, 3 m ahead; the older that is, the less it tells of now.
        ((1.8, 0.0), (2.0, 0.0), 0.0, -2.0),
        ((1.8, 0.0), (2.0, 0.0), 0.25, -1.0),
        ((1.8, 0.0), (2.0, 0.0), 0.45, -0.2),
        # It crosses ahead of one that stands: the beam turns, 1.5 m/s across at 3 m.
        ((0.0, 1.5), (0.0, 0.0), 0.0, 0.75),
        # Both fly side by side: nothing turns.
        ((0.0, 1.5), (0.0, 1.5), 0.0, 0.0),
    ],
)
def test_a_point_tells_how_its_follower_has_to_speed_up(
    leader_mps: tuple[float, float],
    follower_mps: tuple[float, float],
    fresh_s: float,
    expected_mps2: float,
) -> None:
    """Of the distance's second derivative, which is to be none: range'' = a_leader - a + v2 / r."""
    follow = session(replace(PLAIN, predict=True), hears=True)
    before_mps = (2.0, 0.0) if leader_mps[0] else leader_mps
    place = displace(HERE, (-3.0, 0.0, 0.0))
    follow.receive(from_vehicle(LEADER, position(5.9, HERE, before_mps)), 5.9)
    follow.receive(from_vehicle(FOLLOWER, position(6.0, place, follower_mps)), 6.0)
    follow.receive(from_vehicle(LEADER, position(6.0, HERE, leader_mps)), 6.0)
    way_s = follow.followers[FOLLOWER].way_s
    mps2 = quickens_mps2(follow.known, follow.followers[FOLLOWER], 6.0 + fresh_s - way_s)
    assert mps2 == pytest.approx(expected_mps2, abs=0.12)


def test_our_own_timesync_requests_coming_back_are_ignored() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, mavlink.MAVLink_timesync_message(0, 5)), 1.0)

    assert not follow.leader.clock.known


def test_it_asks_for_rates_and_beats_under_its_own_id() -> None:
    follow = session()

    first = follow.tick(0.0)

    wanted = {
        (system_id, round(m.param1)): m.param2
        for system_id, m in first
        if m.get_type() == "COMMAND_LONG"
    }
    assert wanted[(LEADER, 33)] == pytest.approx(250_000)  # 4 Hz
    assert wanted[(FOLLOWER, 33)] == pytest.approx(100_000)
    beats = [m for _, m in first if m.get_type() == "HEARTBEAT"]
    assert {beat.type for beat in beats} == {mavlink.MAV_TYPE_ONBOARD_CONTROLLER}
    assert TOOL_SYSTEM_ID != 255
    again = [m for _, m in follow.tick(0.5) if m.get_type() in ("HEARTBEAT", "COMMAND_LONG")]
    assert again == []


def test_fifty_followers_each_get_their_own_point() -> None:
    plans = [FollowerPlan(2 + i, Slot(3.0 + 2 * i), 10.0, sonar=shipped_sonar()) for i in range(50)]
    follow = FollowSession(LEADER, plans, PLAIN)
    for plan in plans:
        follow.receive(from_vehicle(plan.system_id, heartbeat()), 0.0)
    follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)

    norths = {t.target_system: metres_from_here(t)[0] for t in targets(follow, 1.0)}

    assert len(norths) == 50
    for plan in plans:
        assert norths[plan.system_id] == pytest.approx(-plan.slot.radius_m, abs=0.03)
        assert math.isfinite(norths[plan.system_id])


def looks_north(boot_s: float) -> Any:
    """Where the sonar looked for the reading of that moment."""
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, round(boot_s * 1e3), EARTH_FRAME, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0
    )


def listening_session(range_m: float) -> FollowSession:
    """A still leader, a follower that believes to be 4 m south of it, and 20 s of readings."""
    follow = session(GuidanceSettings())
    for number in range(200):
        t_s = 10.0 + number * 0.1
        follow.receive(from_vehicle(LEADER, position(t_s, HERE)), t_s)
        follow.receive(from_vehicle(FOLLOWER, position(t_s, FOLLOWER_AT)), t_s)
        # Two vehicles in the air: never long the same to the centimetre.
        swaying_m = range_m * (1.0 + 0.004 * (number // 5 % 2))
        follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, swaying_m)), t_s)
    return follow


@pytest.mark.parametrize("told", [True, False])
def test_a_sonar_that_does_not_say_where_it_looks_is_told_of_once(told: bool) -> None:
    """By one the estimate takes each reading for straight ahead, and the nose looks around."""
    follow = session(GuidanceSettings())
    for number in range(100):
        t_s = 10.0 + number * 0.1
        for system_id, place in ((LEADER, HERE), (FOLLOWER, FOLLOWER_AT)):
            follow.receive(from_vehicle(system_id, position(t_s, place)), t_s)
        follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, 3.8 + 0.01 * (number % 2))), t_s)
        if told:
            follow.receive(from_vehicle(FOLLOWER, looks_north(t_s)), t_s)
        follow.tick(t_s)

    said = [text for _, text in follow.events if "sonar axis unknown" in text]
    assert said == ([] if told else ["follower 2: sonar axis unknown: update firmware"])


def test_a_sonar_that_hears_worse_is_told_of_after_one_that_did_not_say_where_it_looks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither takes the other's turn: each is said again after two minutes only."""
    follow = session(GuidanceSettings())
    hearing = follow.followers[FOLLOWER].estimate.hearing
    monkeypatch.setattr(hearing, "heard", lambda: Heard(worse="sonar hears 20%, 50% is believed"))
    for number in range(200):
        t_s = 10.0 + number * 0.1
        for system_id, place in ((LEADER, HERE), (FOLLOWER, FOLLOWER_AT)):
            follow.receive(from_vehicle(system_id, position(t_s, place)), t_s)
        follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, 3.8 + 0.01 * (number % 2))), t_s)
        if number >= 100:
            follow.receive(from_vehicle(FOLLOWER, looks_north(t_s)), t_s)
        follow.tick(t_s)
    said = [text for _, text in follow.events if "sonar" in text]
    assert said == [
        "follower 2: sonar axis unknown: update firmware",
        "follower 2: sonar hears 20%, 50% is believed",
    ]


SHIPPED = shipped_sonar()
BAD = Heard(0.2, 0.4, worse="hears 20%", sonar=replace(SHIPPED, heard=Curve((0.0,), (0.2,))))
WELL_BEYOND = replace(SHIPPED, heard=Curve((2.9, 3.2), (0.2, 0.8)))


def opened_m(
    monkeypatch: pytest.MonkeyPatch, *heard: Heard, sonar: SonarBelief = SHIPPED
) -> tuple[list[float], list[str]]:
    """How far the slot has opened after each 10 s of what is heard, and what was said of it.

    Behind a leader at 2 m/s, whose reports are half a second old.
    """
    follow, opened = session(GuidanceSettings()), list[float]()
    follower = follow.followers[FOLLOWER]
    follower.plan.sonar = sonar
    for part, one in enumerate(heard):
        monkeypatch.setattr(follower.estimate.hearing, "heard", lambda one=one: one)
        for number in range(part * 100, part * 100 + 100):
            t_s = 10.0 + number * 0.1
            for system_id, north_m in ((LEADER, 0.0), (FOLLOWER, -3.2)):
                place = displace(HERE, (north_m + 2.0 * t_s, 0.0, 0.0))
                there = from_vehicle(system_id, position(t_s, place, (2.0, 0.0)))
                follow.receive(there, t_s + (0.5 if system_id == LEADER else 0.0))
            follow.receive(
                from_vehicle(FOLLOWER, sonar_reading(t_s, 3.0 + 0.01 * (number % 2))), t_s
            )
            follow.receive(from_vehicle(FOLLOWER, looks_north(t_s)), t_s)
            follow.tick(t_s + 0.5)
        opened.append(round(follower.opens_m, 1))
    return opened, [text for _, text in follow.events if "slot" in text]


def test_a_sonar_that_is_heard_too_bad_for_its_slot_opens_it_until_it_hears_as_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unknown, nearly, good = Heard(), Heard(0.5, 0.95), Heard(0.6, 1.1)
    opened, said = opened_m(monkeypatch, good, BAD, unknown, nearly, BAD, good)
    # As far as readings tell whether it hears again.
    assert opened == [0.0, 3.5, 3.5, 3.5, 3.5, 0.0]
    assert said == [
        "follower 2: sonar not good enough, slot 3.5 m: as few as 20% of its readings may hear the "
        "leader there",
        "follower 2: sonar as believed again, slot 3.0 m",
    ]


def test_a_sonar_that_carries_a_wider_slot_opens_it_that_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert WELL_BEYOND.objection(3.2) is None
    opened, _ = opened_m(monkeypatch, replace(BAD, sonar=WELL_BEYOND))
    assert opened == [3.2]


def test_a_sonar_that_is_worse_than_believed_and_good_enough_opens_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    enough = replace(SHIPPED, heard=Curve((0.0,), (0.45,)))
    assert opened_m(monkeypatch, replace(BAD, sonar=enough)) == ([0.0], [])


def test_what_the_file_says_of_the_slot_opens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """An operator who flies a slot that the file does not carry knows what it says."""
    noisy = replace(SHIPPED, noise_m=0.1)
    assert opened_m(monkeypatch, replace(BAD, sonar=noisy), sonar=noisy) == ([0.0], [])


def test_what_the_file_does_not_say_of_the_slot_opens_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """It scatters as the file says, and hears much less."""
    noisy = replace(SHIPPED, noise_m=0.1)
    deaf = replace(noisy, heard=Curve((0.0,), (0.05,)))
    assert opened_m(monkeypatch, replace(BAD, sonar=deaf), sonar=noisy)[0] == [3.5]


def test_one_that_is_not_led_any_more_forgets_it(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 12.0, sonar=SHIPPED)
    follow = FollowSession(LEADER, [plan], GuidanceSettings(), engaged=False)
    follower = follow.followers[FOLLOWER]
    follower.heard_as, follower.by_ear_m = BAD.sonar, 3.5
    monkeypatch.setattr(follower.estimate.hearing, "heard", lambda: BAD)
    for number in range(10):
        t_s = 10.0 + number * 0.1
        for system_id, place in ((LEADER, HERE), (FOLLOWER, FOLLOWER_AT)):
            follow.receive(from_vehicle(system_id, position(t_s, place)), t_s)
        follow.tick(t_s)
    assert (follower.heard_as, follower.by_ear_m) == (None, 0.0)


def test_the_point_moves_by_the_receivers_disagreement_that_the_sonar_shows() -> None:
    # 2.8 m + 0.2 m to the centres: the follower is 1 m nearer than the two receivers say.
    (target,) = targets(listening_session(2.8), 30.0)

    # To be at 3 m it has to go where its own receiver says 4 m.
    assert metres_from_here(target) == pytest.approx((-4.0, 0.0), abs=0.15)


def offset_by_averages(orientation: int, raw_m: float | None, average_m: float = 2.8) -> float:
    """What 20 s of DISTANCE_SENSOR teach; `raw_m`: single readings beside them."""
    follow = session(GuidanceSettings())
    for number in range(200):
        t_s = 10.0 + number * 0.1
        follow.receive(from_vehicle(LEADER, position(t_s, HERE)), t_s)
        follow.receive(from_vehicle(FOLLOWER, position(t_s, FOLLOWER_AT)), t_s)
        if raw_m is not None:
            follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, raw_m)), t_s)
        swaying_m = average_m + 0.01 * (number // 5 % 2)
        follow.receive(from_vehicle(FOLLOWER, average(swaying_m, orientation)), t_s)
    return follow.followers[FOLLOWER].estimate.offset.north_m


def test_where_single_readings_do_not_come_the_average_has_to_do() -> None:
    """A signed link drops what no autopilot has signed; DISTANCE_SENSOR is the autopilot's own."""
    assert offset_by_averages(FORWARD, None) == pytest.approx(1.0, abs=0.1)
    assert offset_by_averages(FORWARD, 3.8) == pytest.approx(0.0, abs=0.1)  # single ones win
    down = mavlink.MAV_SENSOR_ROTATION_PITCH_270
    assert offset_by_averages(down, None) == pytest.approx(0.0, abs=1e-6)


def test_an_average_of_nothing_is_silence_where_single_readings_do_not_come() -> None:
    """Over a signed link a leader out of the sonar's reach was not looked for (SITL 4.8)."""
    assert offset_by_averages(FORWARD, None, 7.65) < -0.2


def test_a_distance_sensor_without_a_target_has_no_range() -> None:
    assert sonar_range_m(average(2.85), REACH_M) == pytest.approx(2.85)
    assert sonar_range_m(average(4.5), REACH_M) is None
    assert sonar_range_m(average(7.65), REACH_M) is None
    short = mavlink.MAVLink_distance_sensor_message(0, 20, 300, 300, 0, 0, FORWARD, 0)
    assert sonar_range_m(short, REACH_M) is None  # its own end
    assert sonar_range_m(average(5.0), reach_m=6.0) == pytest.approx(5.0)


@pytest.mark.parametrize("range_m", [0.0, math.nan])
def test_what_is_no_reading_teaches_nothing(range_m: float) -> None:
    follow = listening_session(range_m)

    assert follow.followers[FOLLOWER].estimate.offset.north_m == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("range_m", [7.66, 4.5])
def test_silence_says_that_the_leader_is_not_where_it_should_be_heard(range_m: float) -> None:
    """Receivers say 4 m straight ahead; heard it would be there: it is further off, or aside."""
    offset = listening_session(range_m).followers[FOLLOWER].estimate.offset

    assert offset.unheard_s(30.0) == math.inf
    assert offset.north_m < -0.2
    assert offset.sigma_m(math.pi / 2) > 1.73 * 1.13


def test_an_unheard_leader_is_given_a_wider_berth() -> None:
    """Two receivers of 0.8 m disagree by 1.13 m: 1 m + 2.5 x 1.13 m = 3.83 m.

    Not all of that: a leader that is so much nearer may be aside or above, out of the way.
    """
    follow = session(GuidanceSettings())
    for number in range(20):
        t_s = 10.0 + number * 0.1
        follow.receive(from_vehicle(LEADER, position(t_s, HERE)), t_s)
        follow.receive(from_vehicle(FOLLOWER, position(t_s, FOLLOWER_AT)), t_s)
    follow.tick(12.0)

    guided = follow.followers[FOLLOWER].guided
    assert guided is not None
    assert -3.83 < ned_between(HERE, guided.slot)[0] < -3.1


def test_who_may_be_heard_instead_is_as_far_as_the_sonar_reaches() -> None:
    """Receivers put it 9.5 m away: too far for our sonar, not for one that reaches 7.5 m."""
    for sonar, heard in ((shipped_sonar(), []), (load_sonar("radio").belief(), [3])):
        plans = [FollowerPlan(number, Slot(3.0), sonar=sonar) for number in (FOLLOWER, 3)]
        follow = FollowSession(LEADER, plans, GuidanceSettings())
        follow.receive(from_vehicle(LEADER, position(1.0, HERE)), 1.0)
        for plan, north_m in zip(plans, (-3.0, -12.5), strict=True):
            place = displace(HERE, (north_m, 0.0, 0.0))
            follow.receive(from_vehicle(plan.system_id, position(1.0, place)), 1.0)
        others = follow.known._beside(follow.followers[FOLLOWER])
        assert [one.system_id for one in others] == heard


def test_another_vehicles_echo_is_not_taken_for_the_leader() -> None:
    follow = session(GuidanceSettings())
    far_away = displace(HERE, (-20.0, 0.0, 0.0))
    for number in range(200):
        t_s = 10.0 + number * 0.1
        follow.receive(from_vehicle(LEADER, position(t_s, HERE)), t_s)
        follow.receive(from_vehicle(FOLLOWER, position(t_s, far_away)), t_s)
        follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, 3.0)), t_s)

    offset = follow.followers[FOLLOWER].estimate.offset
    assert math.hypot(offset.north_m, offset.east_m) < 0.1
    assert offset.unheard_s(30.0) == math.inf


def go_on(
    follow: FollowSession, start_s: float, ranges_m: list[float], *, leader_reports: bool = True
) -> None:
    """Readings of a tenth of a second each, and the reports they wait for."""
    for number, range_m in enumerate(ranges_m):
        t_s = start_s + number * 0.1
        follow.receive(from_vehicle(FOLLOWER, sonar_reading(t_s, range_m)), t_s)
        follow.receive(from_vehicle(FOLLOWER, position(t_s, FOLLOWER_AT)), t_s)
        if leader_reports:
            follow.receive(from_vehicle(LEADER, position(t_s, HERE)), t_s)


def test_single_wild_readings_move_nobody() -> None:
    """One in four, each unlike the one before it, of a leader that is heard all the time."""
    follow = listening_session(2.8)
    offset = follow.followers[FOLLOWER].estimate.offset
    before_m = offset.north_m

    go_on(follow, 30.0, [1.0, 2.8, 2.81, 2.8, 3.9, 2.81, 2.8, 2.79, 1.6, 2.8, 2.81, 2.8])

    assert offset.north_m == pytest.approx(before_m, abs=0.05)
    assert offset.unheard_s(31.2) < 1.0


def yaws_deg(follow: FollowSession, start_s: float, every: int = 1) -> list[float]:
    """Four seconds of them, the time of a sway there and back; as heard before.

    With each reading, or one of `every`, a report of the leader.
    """
    yaws = []
    for step in range(40):
        swaying_m = 2.8 + 0.01 * (step // 5 % 2)
        go_on(follow, start_s + step * 0.1, [swaying_m], leader_reports=step % every == 0)
        yaws.append(math.degrees(targets(follow, start_s + step * 0.1)[0].yaw))
    return yaws


def test_a_leader_heard_somewhere_in_the_beam_is_looked_at_from_side_to_side() -> None:
    """The bearing is not sure to 7 degrees: where the beam's edge passes over it, it will be."""
    yaws = yaws_deg(listening_session(2.8), 30.0)

    assert max(yaws) > 4.0
    assert min(yaws) < -4.0
    assert max(map(abs, yaws)) <= 15.0


def test_a_reading_that_waits_for_a_report_is_no_leader_lost() -> None:
    """By telemetry radio one is used when it is a second old; on SITL 4.8 the nose swung by it.

    A sway's own rate is 15 degrees in a quarter of 4 s, 2.4 in a tenth of a second at the most.
    """
    yaws = yaws_deg(listening_session(2.8), 30.0, every=9)

    assert max(abs(after - before) for before, after in pairwise(yaws)) < 2.5


def test_a_leader_that_is_lost_is_looked_for_to_both_sides() -> None:
    """By the nose, as this sonar says nothing of a gimbal."""
    follow, yaws = listening_session(2.8), []
    go_on(follow, 30.0, [7.66] * 60)
    for step in range(80):
        go_on(follow, 36.0 + step * 0.1, [7.66])
        yaws.append(math.degrees(targets(follow, 36.0 + step * 0.1)[0].yaw))

    assert max(yaws) > 20.0
    assert min(yaws) < -20.0
    # A copter turns at 60 deg/s, and the sonar has to have time to hear.
    assert max(abs(after - before) for before, after in pairwise(yaws)) < 4.5


def test_the_leaders_acceleration_is_taken_from_two_reports_and_limited() -> None:
    follow = session()
    follow.receive(from_vehicle(LEADER, position(1.0, HERE, (2.0, 0.0))), 1.0)
    follow.receive(from_vehicle(LEADER, position(1.25, HERE, (1.5, 0.0))), 1.25)
    assert follow.leader.fix is not None
    assert follow.leader.fix.acceleration_ned_mps2[0] == pytest.approx(-2.0)

    follow.receive(from_vehicle(LEADER, position(1.5, HERE, (-2.0, 0.0))), 1.5)
    assert follow.leader.fix.acceleration_ned_mps2[0] == pytest.approx(-3.0)


def test_a_leader_believed_in_a_new_place_is_given_the_wide_berth_again() -> None:
    follow = listening_session(2.8)
    assert follow.followers[FOLLOWER].estimate.offset.north_m > 0.5
    away = displace(HERE, (15.0, 0.0, 0.0))

    for number in range(AGREEING_REPORTS + 2):
        t_s = 30.0 + number * 0.25
        follow.receive(from_vehicle(LEADER, position(t_s, away)), t_s)

    assert follow.leader.jumps == 1
    assert follow.followers[FOLLOWER].estimate.offset.north_m == pytest.approx(0.0, abs=1e-6)


def test_a_follower_that_is_stopped_by_a_stale_leader_stands_still() -> None:
    """It does not flee from all that a leader could have done since it was last heard."""
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 12.0, sonar=shipped_sonar())
    limits = Limits(min_separation_m=1.0, leader_flies=False)
    follow = FollowSession(LEADER, [plan], PLAIN, limits=limits)
    follow.receive(from_vehicle(FOLLOWER, heartbeat()), 0.0)
    here = displace(HERE, (-2.5, 0.0, 0.0))
    follow.receive(from_vehicle(LEADER, position(0.1, HERE)), 0.1)
    stands = []
    for number in range(1, 35):
        t_s = 0.1 * number
        follow.receive(from_vehicle(FOLLOWER, position(t_s, here)), t_s)
        sent = targets(follow, t_s)
        if follow.followers[FOLLOWER].hold is not None:
            stands.append(metres_from_here(sent[-1])[:2])
    assert len(stands) > 20
    assert set(stands) == {stands[0]}  # a place for good
    assert stands[0] == pytest.approx((-2.5, 0.0), abs=0.1)


def test_a_clock_that_is_set_anew_takes_no_report_back_in_time() -> None:
    track = session().leader
    track.receive(position(6.0, HERE), 6.9)  # no clock yet: as old as it came
    track.clock.answered(6.95, 6.96, 6.97)  # it is 0.9 s older than it seemed
    track.receive(position(6.25, HERE), 7.15)
    assert track.fix is not None and track.fix.time_s == pytest.approx(6.9)
    track.receive(position(7.25, HERE), 8.15)
    assert track.fix.time_s == pytest.approx(7.25, abs=0.02)
