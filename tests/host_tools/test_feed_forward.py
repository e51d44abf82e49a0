import math
import re
from dataclasses import dataclass, field
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing import feed_forward
from echowing.feed_forward import (
    CLEAR_M,
    CLOSE_M,
    DECEL_MPS2,
    DELAY_S,
    LOST_S,
    SLACK_M,
    Keeper,
    backed_off,
    closing_distance_m,
    moving_slot,
    no_further,
    retreat_m,
    sonar_range_m,
)
from echowing.follow import RAW_FRESH_S, FollowerPlan, FollowSession
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.guard import REFUSED_FOR_S, Limits
from echowing.guidance import GuidanceSettings, GuidedPoint, Slot
from echowing.leader_track import USUAL_ROUND_TRIP_S
from echowing.panel import state_of
from echowing.paths import lua_folder
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

LEADER, FOLLOWER, SECOND = 1, 2, 3
HERE = GlobalPosition(39.34, -86.03, 260.0)
TICK_S = 0.125
POINT = "SET_POSITION_TARGET_GLOBAL_INT"
VELOCITY_IGNORED = 0x38


# ---- the rule ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ours", "applets"),
    [
        ("CLOSE_M", r"'CLOSE', ([\d.]+)"),
        ("DELAY_S", r"'DELAY', ([\d.]+)"),
        ("DECEL_MPS2", r"'DECEL', ([\d.]+)"),
        ("LOST_S", r"'LOST_T', ([\d.]+)"),
        ("DETECTION_LIMIT_M", r"'DETECT', ([\d.]+)"),
        ("HARD_CLOSE_M", r"HARD_CLOSE_M = ([\d.]+)"),
        ("CLEAR_M", r"CLEAR_M = ([\d.]+)"),
        ("EVADE_LEAST_M", r"EVADE_LEAST_M, EVADE_MOST_M = ([\d.]+)"),
        ("EVADE_MOST_M", r"EVADE_LEAST_M, EVADE_MOST_M = [\d.]+, ([\d.]+)"),
    ],
)
def test_the_rule_is_the_applets(ours: str, applets: str) -> None:
    script = (lua_folder() / "echowing.lua").read_text(encoding="utf-8")
    (value,) = re.findall(applets, script)
    assert getattr(feed_forward, ours) == float(value)


def test_the_closing_distance_is_the_delay_and_the_braking() -> None:
    assert closing_distance_m(2.0, 0.6) == pytest.approx(2.0 * 0.6 + 4.0 / 5.0)
    assert closing_distance_m(-1.0, 0.6) == 0.0


def test_too_close_counts_what_is_still_closed_until_it_stands() -> None:
    still, fast = Keeper(), Keeper()
    for keeper in (still, fast):
        keeper.heard(10.0, 2.5)
    assert not still.judge(10.0, 0.0, 0.0)
    # 2.5 m less 0.9 s x 1 m/s less 0.2 m of braking is under 1.5 m.
    assert 2.5 - (DELAY_S + 0.3) - 1.0 / (2.0 * DECEL_MPS2) < CLOSE_M
    assert fast.judge(10.0, 1.0, 0.3)
    assert not Keeper().judge(10.0, 5.0, 1.0)  # nothing has been heard


def test_too_close_ends_only_a_little_further_out() -> None:
    keeper = Keeper()
    keeper.heard(1.0, CLOSE_M - 0.1)
    assert keeper.judge(1.0, 0.0, 0.0)
    keeper.heard(1.1, CLOSE_M + CLEAR_M - 0.1)
    assert keeper.judge(1.1, 0.0, 0.0)
    keeper.heard(1.2, CLOSE_M + CLEAR_M + 0.1)
    assert not keeper.judge(1.2, 0.0, 0.0)


def test_a_leader_lost_while_too_close_is_believed_there_for_longer() -> None:
    keeper = Keeper()
    keeper.heard(1.0, 1.0)
    assert keeper.judge(1.0, 0.0, 0.0)
    keeper.heard(1.5, None)
    assert keeper.judge(1.0 + LOST_S + 0.1, 0.0, 0.0)
    assert not keeper.judge(4.0, 0.0, 0.0)
    assert not keeper.sees(1.0 + LOST_S + 0.1)


def test_it_backs_off_to_the_wanted_range_and_more_from_a_leader_that_comes() -> None:
    assert retreat_m(2.8, 1.2, 0.0) == pytest.approx(1.6)
    assert retreat_m(2.8, 1.2, 1.5) == pytest.approx(3.1)
    assert retreat_m(2.8, 1.2, -1.5) == pytest.approx(1.6)
    assert retreat_m(2.8, 2.7, 0.0) == 0.5
    assert retreat_m(2.8, 0.5, 9.0) == 5.0


def test_back_is_away_from_where_it_looks() -> None:
    north_m, east_m, _ = ned_between(HERE, backed_off(HERE, math.radians(90.0), 2.0))
    assert (north_m, east_m) == pytest.approx((0.0, -2.0), abs=0.01)


def test_a_point_too_far_ahead_is_moved_straight_back_and_others_are_left() -> None:
    ahead = displace(HERE, (3.0, 1.0, 0.0))
    assert ned_between(HERE, no_further(ahead, HERE, 0.0, 1.2))[:2] == pytest.approx(
        (1.2, 1.0), abs=0.01
    )
    assert no_further(ahead, HERE, 0.0, 3.5) == ahead


@pytest.mark.parametrize(
    ("offset_m", "expected_m"),
    [
        ((-3.0, 0.0), (-2.0, 0.0)),  # 2 m/s over half a second
        ((-1.5, 0.0), (-1.0, 0.0)),  # never nearer than 1 m
        ((0.0, 3.0), (0.0, 3.0)),  # nor ahead
    ],
)
def test_a_moving_slot_stays_behind_the_leader_and_clear_of_it(
    offset_m: tuple[float, float], expected_m: tuple[float, float]
) -> None:
    slot = displace(HERE, (*offset_m, 0.0))
    guided = GuidedPoint(slot, slot, HERE, 0.0, 0.0, velocity_mps=(2.0, 0.0), course_rad=0.0)
    point, velocity_mps = moving_slot(guided, GuidanceSettings(), 0.5)
    assert ned_between(HERE, point)[:2] == pytest.approx(expected_m, abs=0.01)
    assert velocity_mps == (2.0, 0.0)


def test_the_velocity_fades_as_the_leaders_report_grows_old() -> None:
    for age_s, share in ((0.5, 1.0), (0.75, 0.5), (1.0, 0.0)):
        guided = GuidedPoint(HERE, HERE, HERE, 0.0, age_s, velocity_mps=(2.0, -1.0))
        _, velocity_mps = moving_slot(guided, GuidanceSettings(), 0.0)
        assert velocity_mps == pytest.approx((2.0 * share, -1.0 * share))


def distance_sensor(range_m: float, orientation: int = 0) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        0, 20, 765, round(range_m * 100), 1, 0, orientation, 0
    )


def test_a_range_beyond_the_detection_limit_is_no_target() -> None:
    assert sonar_range_m(distance_sensor(3.2)) == pytest.approx(3.2)
    assert sonar_range_m(distance_sensor(4.5)) is None
    assert sonar_range_m(distance_sensor(7.66)) is None


# ---- the session ------------------------------------------------------------------------------


def received(system_id: int, message: Any) -> Any:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


@dataclass
class Field:
    """A leader flying north at 2 m/s and followers that keep up with it."""

    range_m: float | None = 2.8
    behind_m: dict[int, float] = field(default_factory=lambda: {FOLLOWER: 3.0})
    faster_mps: float = 0.0
    limits: Limits | None = None
    now_s: float = 0.0
    leader_m: float = 0.0

    def __post_init__(self) -> None:
        plans = [FollowerPlan(i, Slot(3.0 * (i - 1)), 10.0) for i in self.behind_m]
        settings = GuidanceSettings(learn_offset=False, feed_forward=True)
        self.session = FollowSession(LEADER, plans, settings, limits=self.limits)
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        for system_id in (LEADER, *self.behind_m):
            self.tell(system_id, mavlink.MAVLink_heartbeat_message(2, 3, flags, 4, 4, 3))

    def tell(self, system_id: int, message: Any) -> None:
        self.session.receive(received(system_id, message), self.now_s)

    def at(self, system_id: int) -> GlobalPosition:
        north_m = self.leader_m - self.behind_m.get(system_id, 0.0)
        return displace(HERE, (north_m, 0.0, 0.0))

    def position(self, system_id: int) -> Any:
        at = self.at(system_id)
        speed_mps = 2.0 + (self.faster_mps if system_id in self.behind_m else 0.0)
        lat_lon = round(at.lat_deg * 1e7), round(at.lon_deg * 1e7)
        return mavlink.MAVLink_global_position_int_message(
            round(self.now_s * 1e3), *lat_lon, 260_000, 10_000, round(speed_mps * 100), 0, 0, 0
        )

    def point(self) -> Any:
        """Let a tick pass; the point that goes to the first follower."""
        self.now_s += TICK_S
        self.leader_m += 2.0 * TICK_S
        for system_id in (LEADER, *self.behind_m):
            self.tell(system_id, self.position(system_id))
        if self.range_m is not None:
            self.tell(FOLLOWER, distance_sensor(self.range_m))
        (sent,) = (
            m for i, m in self.session.tick(self.now_s) if i == FOLLOWER and m.get_type() == POINT
        )
        return sent

    def ahead_m(self, point: Any) -> float:
        """How far ahead of the follower a point is."""
        at = GlobalPosition(point.lat_int / 1e7, point.lon_int / 1e7, HERE.alt_m)
        return ned_between(self.at(FOLLOWER), at)[0]

    def state(self) -> str:
        return state_of(self.session, self.session.followers[FOLLOWER], self.now_s)


def test_points_carry_the_leaders_velocity_and_are_the_slot_when_they_arrive() -> None:
    there = Field()
    sent = there.point()
    assert (sent.vx, sent.vy, sent.vz) == pytest.approx((2.0, 0.0, 0.0), abs=0.01)
    assert not sent.type_mask & VELOCITY_IGNORED
    assert sent.type_mask & mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    # Where the slot is half a round trip later, and no lead beside that.
    assert there.ahead_m(sent) == pytest.approx(2.0 * USUAL_ROUND_TRIP_S / 2.0, abs=0.03)
    assert there.state() == "following"


def test_without_the_leader_in_the_sonars_ear_the_position_goes_alone() -> None:
    there = Field()
    there.point()
    there.range_m = None
    for _ in range(round(LOST_S / TICK_S) + 2):
        sent = there.point()
    assert sent.type_mask & VELOCITY_IGNORED == VELOCITY_IGNORED
    assert there.ahead_m(sent) == pytest.approx(2.0, abs=0.05)  # with the lead, as ever
    assert there.state() == "following: position only"
    there.range_m = 7.66  # the sonar is well, and hears nobody
    assert there.point().type_mask & VELOCITY_IGNORED
    there.range_m = 2.8
    assert not there.point().type_mask & VELOCITY_IGNORED
    assert [text.split(": ")[1] for _, text in there.session.events] == [
        "the sonar hears the leader, points carry its velocity",
        "the sonar does not hear the leader, position only",
    ]


def test_too_close_by_the_sonar_it_is_flown_back_whatever_the_receivers_say() -> None:
    there = Field(range_m=1.2)
    sent = there.point()
    assert sent.type_mask & VELOCITY_IGNORED == VELOCITY_IGNORED
    # Back to 2.8 m from 1.2 m.
    assert there.ahead_m(sent) == pytest.approx(-1.6, abs=0.03)
    assert there.state() == "following: backing off"
    there.range_m = CLOSE_M + CLEAR_M + 0.2
    assert there.point().type_mask & VELOCITY_IGNORED == 0


def test_one_that_closes_fast_is_too_close_from_further_away() -> None:
    there = Field(range_m=2.5, faster_mps=1.0)
    assert there.ahead_m(there.point()) < 0.0
    assert there.state() == "following: backing off"


def test_the_sonar_holds_back_a_point_that_the_receivers_would_set_too_near() -> None:
    # The receivers say 4.5 m, the sonar 2.3 m: the slot seems 1.5 m ahead, and is 0.5 m behind.
    there = Field(range_m=2.3, behind_m={FOLLOWER: 4.5})
    sent = there.point()
    moved_m = 2.0 * USUAL_ROUND_TRIP_S
    assert there.ahead_m(sent) == pytest.approx(moved_m + 2.3 - 2.8 + SLACK_M, abs=0.05)


def test_it_does_not_back_off_into_another_follower() -> None:
    there = Field(
        range_m=1.2,
        behind_m={FOLLOWER: 3.0, SECOND: 5.0},
        limits=Limits(min_separation_m=1.5, leader_flies=False),
    )
    assert there.ahead_m(there.point()) == pytest.approx(0.0, abs=0.02)


def test_downward_sonars_are_none() -> None:
    there = Field(range_m=None)
    there.tell(FOLLOWER, distance_sensor(2.8, orientation=25))
    assert there.point().type_mask & VELOCITY_IGNORED


ORIGIN = displace(HERE, (-100.0, 0.0, 0.0))  # of the vehicle's local coordinates


def told_locally(there: Field, target: GlobalPosition) -> None:
    """Its place and its target in its own coordinates."""
    boot_ms = round(there.now_s * 1e3)
    place_m, target_m = (ned_between(ORIGIN, at)[0] for at in (there.at(FOLLOWER), target))
    local = mavlink.MAVLink_local_position_ned_message(boot_ms, place_m, *(0.0,) * 5)
    there.tell(FOLLOWER, local)
    there.tell(
        FOLLOWER,
        mavlink.MAVLink_position_target_local_ned_message(
            boot_ms, 1, 0xDC0, target_m, *(0.0,) * 10
        ),
    )


@pytest.mark.parametrize("taken", [True, False])
def test_a_refused_point_with_a_velocity_is_noticed_in_local_coordinates(taken: bool) -> None:
    there = Field(limits=Limits(leader_flies=False))
    before = HERE
    for _ in range(round(2.0 * REFUSED_FOR_S / TICK_S)):
        sent = there.point()
        newest = GlobalPosition(sent.lat_int / 1e7, sent.lon_int / 1e7, HERE.alt_m)
        told_locally(there, newest if taken else displace(before, (-5.0, 0.0, 0.0)))
    refused = any("did not take the points" in text for _, text in there.session.events)
    assert refused is not taken


def test_a_range_teaches_the_offset_only_where_single_readings_do_not_come() -> None:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 10.0)
    taught = []
    for raw in (False, True):
        session = FollowSession(LEADER, [plan], GuidanceSettings())
        there = Field()
        there.session = session
        for number in range(100):
            there.now_s = 10.0 + number * 0.1
            there.tell(LEADER, there.position(LEADER))
            there.tell(FOLLOWER, there.position(FOLLOWER))
            if raw:
                quiet = mavlink.MAVLink_named_value_float_message(0, b"SNR_RAW", 7.66)
                there.tell(FOLLOWER, quiet)
            for _ in range(2):  # the autopilot's, and the co-processor's own that it forwards
                there.tell(FOLLOWER, distance_sensor(1.8))
            session.tick(there.now_s)
        taught.append(session.followers[FOLLOWER].offset.north_m)
    assert RAW_FRESH_S > 0.1
    # 1.8 m + 0.2 m to the centres: 1 m nearer than the receivers say.
    assert taught == [pytest.approx(1.0, abs=0.2), 0.0]


# ---- in simulated flight ----------------------------------------------------------------------

# A leader at 1.5 m/s whose receiver then puts it 2.6 m further ahead than it is; nothing learns
# that, and no applet flies: the rule here is all there is.
LIE = """leader.script=[
    {at_s=2.0, act="fly", velocity_ned_mps=[1.5, 0.0, 0.0]},
    {at_s=15.0, act="gps_jump", jump_ned_m=[2.6, 0.0, 0.0]},
    {at_s=15.02, act="fly", velocity_ned_mps=[1.5, 0.0, 0.0]}]"""
DECEIVED = [
    *("guidance.feed_forward=true", "guidance.learn_offset=false", "gps.sigma_m=0.01"),
    *('law="none"', "duration_s=40", " ".join(LIE.split())),
]


def test_a_deceived_follower_is_kept_off_its_leader_by_the_sonar(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = FormationFlight(load_scenario("hostile", DECEIVED), 1).run()
    # A GPS wrong by 2.6 m leaves 0.4 m of the 3 m.
    assert kept.closest_m > 0.9

    monkeypatch.setattr(Keeper, "judge", lambda *arguments: False)
    monkeypatch.setattr("echowing.follow.no_further", lambda point, *rest: point)
    assert FormationFlight(load_scenario("hostile", DECEIVED), 1).run().closest_m < 0.5


def test_feed_forward_keeps_the_distance_at_least_as_well_as_the_position_alone() -> None:
    errors_m = []
    for fed in ("false", "true"):
        changes = [f"guidance.feed_forward={fed}", "duration_s=120"]
        flight = FormationFlight(load_scenario("echowing", changes), 3).run().flights[0]
        apart_m = list(flight.separation_m[150:])
        errors_m.append(sum(abs(one - 3.0) for one in apart_m) / len(apart_m))
    assert errors_m[1] < errors_m[0] + 0.05
