import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.flight.axis import Axis
from echowing.flight.clocks import UNHEARD_S
from echowing.flight.closing import Closing
from echowing.flight.envelope import OTHERS_MPS2, closing_limit_mps
from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import (
    FIELD_LIMITS,
    REFUSED_FOR_S,
    REMEMBERED_S,
    REMIND_S,
    STEADY_S,
    STILL_FOR_S,
    STUCK_FOR_S,
    Guard,
    Limits,
)
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.known import Known
from echowing.flight.plan import planned
from echowing.flight.requests import RATE_WINDOW_S, RateWatch
from echowing.flight.session import FollowSession
from echowing.flight.switch import StopSwitch, parse_stop_switch
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.mavlink.plausible import Door
from echowing.mavlink.vehicle_limits import usual_parameters
from echowing.sonar_file import shipped_sonar
from echowing.tool.panel import Panel, left_as, state_of

from .yard import Yard

LEADER, FOLLOWER, SECOND = 1, 2, 3
HERE = GlobalPosition(39.34, -86.03, 260.0)
LOITER = mavlink.COPTER_MODE_LOITER
GUIDED = mavlink.COPTER_MODE_GUIDED
POINT = "SET_POSITION_TARGET_GLOBAL_INT"
TICK_S = 0.125


def received(system_id: int, message: Any) -> Any:
    """The message as packed by the vehicle and parsed by us."""
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


def heartbeat(mode: int = GUIDED, *, flying: bool = True) -> Any:
    flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    state = mavlink.MAV_STATE_ACTIVE if flying else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(2, 3, flags, mode, state, 3)


def rc_channels(channel: int, pulse_us: int) -> Any:
    pulses = [1500] * 18
    pulses[channel - 1] = pulse_us
    return mavlink.MAVLink_rc_channels_message(0, 18, *pulses, 255)


@dataclass
class Field:
    """Vehicles in a field: who is where, and a session told so at every tick."""

    limits: Limits
    engaged: bool = True
    followers: tuple[int, ...] = (FOLLOWER,)
    north_m: dict[int, float] = field(default_factory=lambda: {LEADER: 0.0, FOLLOWER: -4.0})
    east_m: dict[int, float] = field(default_factory=dict)
    speed_mps: dict[int, float] = field(default_factory=dict)
    height_m: float = 10.0
    climb_mps: float = 0.0
    late_s: float = 0.0
    home_m: dict[int, float] = field(default_factory=dict)
    radius_m: float = 3.0
    feed_forward: bool = True
    silent: set[int] = field(default_factory=set)
    now_s: float = 0.0
    door: Door = field(default_factory=Door)

    def __post_init__(self) -> None:
        plans = [
            FollowerPlan(i, Slot(self.radius_m * (i - 1)), 10.0, sonar=shipped_sonar())
            for i in self.followers
        ]
        self.session = FollowSession(
            LEADER,
            plans,
            GuidanceSettings(learn_offset=False, feed_forward=self.feed_forward),
            limits=self.limits,
            engaged=self.engaged,
        )
        for system_id in (LEADER, *self.followers):
            self.tell(system_id, heartbeat())
        for follower in self.session.followers.values():
            for name, value in usual_parameters().items():
                follower.handling.receive(name, value)

    def tell(self, system_id: int, message: Any) -> None:
        heard = received(system_id, message)
        if self.door.admits(heard):
            self.session.receive(heard, self.now_s)

    def fly(self, seconds: float) -> list[Any]:
        """Let time pass; returns all that was sent."""
        sent: list[Any] = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            for system_id in {LEADER, *self.followers} - self.silent:
                self.tell(system_id, self.position(system_id))
            sent += [message for _, message in self.session.tick(self.now_s)]
        return sent

    def points(self, seconds: float = TICK_S) -> list[Any]:
        return [message for message in self.fly(seconds) if message.get_type() == POINT]

    def position(self, system_id: int) -> Any:
        at = displace(HERE, (self.north_m[system_id], self.east_m.get(system_id, 0.0), 0.0))
        late_s = self.late_s if system_id == FOLLOWER else 0.0
        return mavlink.MAVLink_global_position_int_message(
            round((self.now_s - late_s) * 1e3),
            round(at.lat_deg * 1e7),
            round(at.lon_deg * 1e7),
            round((self.home_m.get(system_id, 250.0) + self.height_m) * 1e3),
            round(self.height_m * 1e3),
            round(self.speed_mps.get(system_id, 0.0) * 100),
            0,
            round(-self.climb_mps * 100),
            0,
        )

    def events(self) -> list[str]:
        return [text for _, text in self.session.events]

    @property
    def state(self) -> str:
        return state_of(self.session.followers[FOLLOWER])


def north_of(point: Any) -> float:
    at = GlobalPosition(point.lat_int / 1e7, point.lon_int / 1e7, HERE.alt_m)
    return ned_between(HERE, at)[0]


def read_back(point: Any, shift_m: float = 0.0) -> Any:
    at = displace(
        GlobalPosition(point.lat_int / 1e7, point.lon_int / 1e7, 0.0), (shift_m, 0.0, 0.0)
    )
    return mavlink.MAVLink_position_target_global_int_message(
        0, 0, 0xFDF8, round(at.lat_deg * 1e7), round(at.lon_deg * 1e7), *(0.0,) * 9
    )


def test_points_flow_while_nothing_is_wrong() -> None:
    """Two receivers of which no sonar knows more: 2.5 x 1.13 m more than 1.5 m are kept."""
    there = Field(Limits(max_distance_m=20.0, min_separation_m=1.5), radius_m=6.0)
    there.north_m[FOLLOWER] = -7.0
    (point,) = there.points()
    # 1 m to its slot, by speed: the envelope has changed nothing.
    assert north_of(point) == pytest.approx(-7.0, abs=0.02)
    assert (point.vx, point.vy) == pytest.approx((0.5, 0.0), abs=0.01)
    assert there.state == "following"


def test_a_take_off_that_its_pilot_has_begun_is_not_ended_near_the_ground() -> None:
    """In Guided it is airborne as soon as it leaves the ground, and a point sends it sideways."""
    there = Field(Limits(), height_m=0.5)
    assert there.points(2.0) == []
    assert there.state == "no points sent"
    assert [text for text in there.events() if "too low" in text] == [
        "follower 2: too low to be led, until it is 2 m up"
    ]
    there.height_m = 2.5
    assert len(there.points(1.0)) == 8
    there.height_m = 1.5  # on its way somewhere it is ours, and has to be told where
    assert len(there.points(1.0)) == 8


def test_a_hold_begins_where_it_is_when_points_begin_to_go_to_it() -> None:
    """What was against it while nothing was sent was noted at another place and height."""
    there = Field(Limits(), height_m=0.5)
    there.fly(1.0)
    there.silent = {LEADER}
    assert there.points(2.0) == []
    there.height_m, there.north_m[FOLLOWER] = 4.0, -6.0
    (held, *_) = there.points(1.0)
    assert (held.alt, north_of(held)) == pytest.approx((4.0, -6.0), abs=0.02)

    there.silent = {LEADER, FOLLOWER}  # the watchdog has stopped it somewhere else
    there.fly(UNHEARD_S + 1.0)
    there.silent, there.north_m[FOLLOWER] = {LEADER}, -9.0
    (again, *_) = there.points(1.0)
    assert (again.alt, north_of(again)) == pytest.approx((4.0, -9.0), abs=0.02)


def test_only_watching_sends_nothing_that_moves_a_vehicle() -> None:
    there = Field(Limits(switch=StopSwitch(5, 1200, "LAND")), engaged=False)
    kinds = {message.get_type() for message in there.fly(10.0)}
    assert kinds == {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG"}
    there.tell(FOLLOWER, rc_channels(5, 1900))
    commands = {m.command for m in there.fly(10.0) if m.get_type() == "COMMAND_LONG"}
    assert commands == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}


def test_beyond_the_greatest_distance_it_holds_until_well_inside() -> None:
    there = Field(Limits(max_distance_m=20.0))
    there.fly(1.0)
    there.north_m[FOLLOWER] = -21.0
    assert north_of(there.points()[0]) == pytest.approx(-21.0, abs=0.02)
    assert "follower 2: leader is beyond 20 m, holding" in there.events()

    there.north_m[FOLLOWER] = -19.0  # inside, but not by a tenth
    assert north_of(there.points()[-1]) == pytest.approx(-21.0, abs=0.02)
    there.north_m[FOLLOWER] = -17.0
    # A leader that is not heard is approached at 1.5 m/s.
    last = there.points()[-1]
    assert (north_of(last), last.vx) == pytest.approx((-17.0, 1.5), abs=0.02)
    assert there.events()[-1] == "follower 2: clear again, following"


def flown_mps(point: Any, here_m: float) -> tuple[float, float]:
    """What Guided makes of a point with a velocity, by ArduCopter's defaults, (N, E)."""
    return answered_mps(point, (here_m, 0.0), Closing().pace_per_s)


def answered_mps(
    point: Any, here_m: tuple[float, float], pace_per_s: Callable[[float], float]
) -> tuple[float, float]:
    at = GlobalPosition(point.lat_int / 1e7, point.lon_int / 1e7, HERE.alt_m)
    north, east, _ = ned_between(displace(HERE, (*here_m, 0.0)), at)
    pace = pace_per_s(math.hypot(north, east))
    return pace * north + point.vx, pace * east + point.vy


def test_too_near_to_the_leader_it_flies_away_from_it() -> None:
    """1.2 m by receivers that may be off by all of that: 1.5 m/s for each metre that lacks."""
    there = Field(Limits(min_separation_m=1.5), height_m=7.0)
    there.fly(1.0)
    there.north_m[FOLLOWER] = -1.2
    (point,) = there.points()
    back_mps, aside_mps = flown_mps(point, -1.2)
    assert -3.0 <= back_mps < -1.9
    assert aside_mps == pytest.approx(0.0, abs=0.02)
    assert point.alt == 10.0
    assert point.yaw == pytest.approx(0.0, abs=0.01)  # and looks at it
    assert there.state == "gives way to the leader"
    assert point.afy == 0.0  # the applet knows the leader
    assert there.points(3.0)  # it is never left without a point
    assert there.events().count("follower 2: gives way to the leader") == 1

    there.north_m[FOLLOWER] = -8.0
    assert flown_mps(there.points()[-1], -8.0)[0] > 1.0
    assert there.state == "following"


def quick(there: Field) -> None:
    """The follower reports the acceleration and jerk that `setup` recommends."""
    handling = there.session.followers[FOLLOWER].handling
    handling.receive("WP_ACC", 5.0)
    handling.receive("PSC_JERK_NE", 20.0)


def test_one_that_closes_far_too_fast_is_not_led_back_to_the_tail_meanwhile() -> None:
    """Beside its slot by 0.8 m: braking takes all its lean, the tail can wait."""
    there = Field(Limits(min_separation_m=1.0))
    there.fly(1.0)
    there.north_m[FOLLOWER], there.east_m[FOLLOWER] = -4.5, 0.8
    assert there.points()[0].vy < -0.3  # on the way to its slot
    there.speed_mps[FOLLOWER] = 4.0
    (point,) = there.points()
    follower = there.session.followers[FOLLOWER]
    here = follower.on_arrival(there.now_s)
    assert here is not None
    here_m = ned_between(HERE, here)
    pace_per_s = follower.handling.closing.pace_per_s
    north_mps, east_mps = answered_mps(point, here_m[:2], pace_per_s)
    change_north, change_east = north_mps - 4.0, east_mps
    assert change_north < -2.0
    assert change_east / change_north == pytest.approx(here_m[1] / here_m[0], abs=0.01)


@pytest.mark.parametrize(
    ("reports", "back_m", "back_mps"), [(lambda _: None, 2.2, 2.0), (quick, 1.8, 2.5)]
)
def test_a_point_without_a_velocity_is_as_far_back_as_guided_flies_so_fast(
    reports: Callable[[Field], None], back_m: float, back_mps: float
) -> None:
    """As fast as with one: 2.0 m/s by ArduCopter's defaults, 2.5 m/s with 5 m/s2 and 20 m/s3.

    The first hangs on how its guesses were drawn: 1.98 to 2.11 m/s, 2.19 to 2.40 m.
    """
    flown = []
    for feed_forward in (True, False):
        there = Field(Limits(min_separation_m=1.5), feed_forward=feed_forward)
        there.fly(1.0)
        reports(there)
        there.north_m[FOLLOWER] = -1.2
        point = there.points()[-1]
        closing = there.session.followers[FOLLOWER].handling.closing
        flown.append(answered_mps(point, (-1.2, 0.0), closing.pace_per_s)[0])

    assert flown == pytest.approx([-back_mps, -back_mps], abs=0.15)
    assert flown[1] == pytest.approx(flown[0], abs=0.05)
    assert point.vx == 0.0
    assert north_of(point) == pytest.approx(-1.2 - back_m, abs=0.25)
    assert back_m * closing.pace_per_s(back_m) == pytest.approx(back_mps, abs=0.05)


def test_a_leader_in_its_sonar_is_closed_on_as_the_applet_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Guided would make 3.5 m/s of the 3 m to the slot; the applet makes 3 m/s of them."""
    there = Field(Limits(min_separation_m=1.5), radius_m=2.0)
    quick(there)
    there.fly(1.0)
    there.north_m[FOLLOWER] = -5.0
    follower = there.session.followers[FOLLOWER]
    monkeypatch.setattr(follower.estimate.offset, "unheard_s", lambda _: 0.0)
    (point,) = there.points()
    nearest_m = there.session.known.nearest_m(follower, (5.0, 0.0), 1.5)
    certain_m = 5.0 - (nearest_m - 1.5)
    limit_mps = closing_limit_mps(certain_m, follower.handling.answer, 1.5, OTHERS_MPS2)
    # Less what the age of all that is known takes.
    assert limit_mps - 0.2 < answered_mps(point, (-5.0, 0.0), lambda _: 1.0)[0] <= limit_mps + 0.01


def third_behind_second() -> Field:
    """Follower 3 wants to its slot 6 m behind the leader; follower 2 is in its way, at 8 m."""
    there = Field(Limits(min_separation_m=1.0), followers=(FOLLOWER, 3))
    there.north_m = {LEADER: 0.0, FOLLOWER: -8.0, 3: -11.5}
    there.fly(1.0)
    return there


def closing_mps(there: Field, system_id: int = 3) -> float:
    """How fast follower 3, or another, is sent north, at the one ahead of it."""
    (point,) = [point for point in there.points() if point.target_system == system_id]
    return flown_mps(point, there.north_m[system_id])[0]


@pytest.mark.parametrize("silent_s", [3.0, 30.0])
def test_a_follower_that_has_fallen_silent_still_stands_where_it_was(silent_s: float) -> None:
    """Two seconds after its last report it was forgotten, and flown through (0.73 m)."""
    there = third_behind_second()
    there.silent.add(FOLLOWER)
    there.fly(silent_s)

    assert closing_mps(there) < 0.3


@pytest.mark.parametrize("by_itself", [1.0, 5.0, 6.0])
def test_one_that_its_applet_flies_is_given_way_to(by_itself: float) -> None:
    """Ordered forward it was met as if it flew there: back from another (0.09 m), or stopped.

    The points of the second were lost on their way (0.88 m). Its report shows that it flies back
    before its applet says so, and also where that holds the distance (0.92 m).
    """
    slowed = []
    for applet_state, its_mps in ((1.0, 2.0), (by_itself, -2.0)):
        there = Field(Limits(min_separation_m=1.0), followers=(FOLLOWER, 3), late_s=0.5, now_s=9.0)
        there.north_m = {LEADER: 0.0, FOLLOWER: -6.0, 3: -12.0}
        there.fly(1.0)
        say_state(there, applet_state)
        there.speed_mps[FOLLOWER] = its_mps
        slowed.append(closing_mps(there))
    # 0.5 s and the way of the order: a metre and more less room, from one that comes.
    assert slowed[1] < slowed[0] - 1.0


def test_one_that_has_landed_and_is_silent_is_in_nobodys_way() -> None:
    there = third_behind_second()
    there.tell(FOLLOWER, heartbeat(flying=False))
    there.silent.add(FOLLOWER)
    there.fly(3.0)

    assert closing_mps(there) > 1.0


def test_a_receiver_that_jumped_leaves_two_places_to_keep_away_from() -> None:
    """Taken over again by its pilot, it was flown through where it truly was (0.09 m)."""
    there = third_behind_second()
    there.north_m[FOLLOWER] += 20.0
    there.fly(3.0)
    assert closing_mps(there) > 1.0

    there.session.followers[FOLLOWER].own_jump.total_m = (20.0, 0.0)
    assert closing_mps(there) < 0.3


def test_only_who_is_to_find_its_leader_leaves_the_leaders_braking_out() -> None:
    """Pushed by the one behind it a follower met a leader that stopped (0.84 m)."""
    closing = []
    for radius_m in (4.4, 4.6):  # within reach of the sonar, and beyond
        there = Field(Limits(min_separation_m=1.0), radius_m=radius_m)
        there.north_m[FOLLOWER] = -7.0
        quick(there)
        there.fly(1.0)
        there.speed_mps[FOLLOWER] = 3.0
        closing.append(closing_mps(there, FOLLOWER))
    assert closing[0] > 1.5
    assert closing[1] < 0.6 * closing[0]


@pytest.mark.parametrize("whose", ["its own", "the leader's"])
def test_a_receiver_that_jumped_leaves_two_places_of_the_leader(whose: str) -> None:
    """Led on after a jump of 12 m that no sonar denied it was flown at its leader (0.71 m)."""
    there = Field(Limits(min_separation_m=1.0))
    there.north_m[FOLLOWER] = -20.0
    there.fly(3.0)
    known, follower = there.session.known, there.session.followers[FOLLOWER]
    assert closing_mps(there, FOLLOWER) > 1.0

    # The leader may be 3.5 m ahead of it, and the receivers may be off besides.
    if whose == "its own":
        follower.own_jump.total_m = (-16.5, 0.0)
    else:
        known.leader.total_m = (16.5, 0.0)
    assert known.doubted_m(follower) == (-16.5, 0.0)
    assert closing_mps(there, FOLLOWER) < 0.4


def test_a_leader_that_the_sonar_hears_after_a_jump_is_where_it_is_seen() -> None:
    there = Field(Limits(min_separation_m=1.0))
    there.fly(1.0)
    known, follower = there.session.known, there.session.followers[FOLLOWER]
    follower.own_jump.total_m, follower.own_jump.last_s = (2.0, 0.0), there.now_s
    there.fly(1.0)
    assert known.doubted_m(follower) == (2.0, 0.0)

    axis, believed_m = Axis(0.0), (4.0, 0.0, 0.0)
    follower.estimate.offset.heard(there.now_s - 1.5, 4.0, axis, believed_m)
    there.fly(TICK_S)
    assert known.doubted_m(follower) == (2.0, 0.0), "heard before the jump"

    follower.estimate.offset.heard(there.now_s, 4.0, axis, believed_m)
    there.fly(TICK_S)
    assert known.doubted_m(follower) == (0.0, 0.0)


def test_a_sonar_settles_the_jumps_of_whom_it_hears_and_no_others() -> None:
    """A line's second heard its first, believed the leader's new place, and came to 0.51 m of it.

    The leader's receiver was 12 m off, and their pilots had let them follow again.
    """
    there = Field(Limits(min_separation_m=1.0), followers=(FOLLOWER, SECOND))
    there.north_m[SECOND] = -8.0
    there.fly(1.0)
    known, (first, second) = there.session.known, there.session.followers.values()
    known.watch({SECOND: first})
    axis, believed_m = Axis(0.0), (4.0, 0.0, 0.0)

    known.leader.total_m = (12.0, 0.0)
    second.estimate.offset.heard(there.now_s, 4.0, axis, believed_m)
    there.fly(TICK_S)
    assert known.doubted_m(second) == known.doubted_m(first) == (-12.0, 0.0)

    there.fly(1.0)
    first.own_jump.total_m, first.own_jump.last_s = (5.0, 0.0), there.now_s
    there.fly(TICK_S)
    assert known.doubted_m(second) == (-12.0, 0.0)
    assert known.unsettled_m(second) == (-5.0, 0.0), "heard before the jump"

    second.estimate.offset.heard(there.now_s, 4.0, axis, believed_m)
    there.fly(TICK_S)
    assert known.unsettled_m(second) == (0.0, 0.0)

    first.estimate.offset.heard(there.now_s, 4.0, axis, believed_m)
    there.fly(TICK_S)
    assert known.doubted_m(second) == known.doubted_m(first) == (0.0, 0.0)


def test_a_jump_that_the_sonar_denied_leaves_one_place_of_the_leader() -> None:
    there = Field(Limits(min_separation_m=1.0))
    there.fly(1.0)
    known, follower = there.session.known, there.session.followers[FOLLOWER]
    known.leader.total_m = (12.0, -3.0)
    follower.estimate.jumped((12.0, -3.0))
    follower.own_jump.total_m = (5.0, 0.0)
    follower.estimate.jumped((-5.0, 0.0))
    assert known.doubted_m(follower) == (0.0, 0.0)


def test_how_fast_it_closes_depends_on_the_room_that_is_certain() -> None:
    """5 m less what the receivers may be off on the way, 0.6 s dead time, 2.5 m/s2."""
    there = Field(Limits(min_separation_m=1.5), radius_m=2.0)
    there.fly(1.0)
    there.north_m[FOLLOWER] = -5.0
    there.speed_mps[FOLLOWER] = 0.0
    (point,) = there.points()
    follower = there.session.followers[FOLLOWER]
    room_m = 5.0 - there.session.known.nearest_m(follower, (5.0, 0.0), 1.5)
    # What it closes is what stops within the room, a little less for the age of what is known.
    limit_mps = math.sqrt(1.5**2 + 5.0 * room_m) - 1.5
    assert limit_mps - 0.2 < flown_mps(point, -5.0)[0] <= limit_mps + 0.01


def test_a_hold_gives_way_and_is_then_where_it_has_been_moved_to() -> None:
    """A leader that flies back at a follower that was stopped: never a freeze in its way."""
    there = Field(Limits(min_separation_m=1.5), radius_m=6.0)
    there.north_m[FOLLOWER] = -7.0
    there.fly(1.0)
    there.tell(LEADER, heartbeat(flying=False))
    (held, *_) = there.points(0.5)
    assert north_of(held) == pytest.approx(-7.0, abs=0.02)

    for north_m in (-1.0, -2.0, -3.0, -4.0):  # more at once would be its receiver's jump
        there.north_m[LEADER], there.speed_mps[LEADER] = north_m, -2.0
        point = there.points(0.25)[-1]
    assert flown_mps(point, -7.0)[0] < -2.0
    assert point.yaw == pytest.approx(0.0, abs=0.01)
    assert there.state == "holding: leader is not known to fly"

    there.north_m[FOLLOWER] = -11.0
    there.points(0.25)
    there.north_m[LEADER], there.speed_mps[LEADER] = 0.0, 0.0
    point = there.points(4.0)[-1]  # it is believed to be gone after some reports
    assert north_of(point) == pytest.approx(-11.0, abs=0.02)


def test_two_followers_too_near_to_each_other_part() -> None:
    there = Field(
        Limits(min_separation_m=1.5),
        followers=(FOLLOWER, SECOND),
        radius_m=8.0,
        north_m={LEADER: 0.0, FOLLOWER: -11.0, SECOND: -12.0},
    )
    there.fly(1.0)
    points = {point.target_system: point for point in there.points()}
    assert flown_mps(points[FOLLOWER], -11.0)[0] > 1.0
    assert flown_mps(points[SECOND], -12.0)[0] < -2.0
    # The second one's slot is at -16 m: its plan leads away as it is.
    told = [text for text in there.events() if "gives way" in text]
    assert told == ["follower 2: gives way to follower 3"]


@pytest.mark.parametrize(("system_id", "alone_mps"), [(FOLLOWER, 1.5), (SECOND, 5.0)])
def test_followers_on_each_others_side_pass_on_their_right(
    system_id: int, alone_mps: float
) -> None:
    """2 belongs 5 m behind the leader and 3 10 m; each is on the other's way.

    alone_mps: how fast it would fly there by itself. How far leaders and followers may be off, by
    which each keeps away from the other, hangs on how 4000 guesses were drawn.
    """
    there = Field(
        Limits(min_separation_m=1.5),
        followers=(FOLLOWER, SECOND),
        radius_m=5.0,
        north_m={LEADER: 0.0, FOLLOWER: -9.5, SECOND: -5.5},
    )
    there.fly(1.0)
    points = {point.target_system: point for point in there.points()}
    place_m = there.north_m[system_id]
    north_mps, east_mps = flown_mps(points[system_id], place_m)
    forward = 1.0 if system_id == FOLLOWER else -1.0
    # What is too fast towards the other is flown to the right of it.
    assert east_mps * forward > 0.5
    assert -2.0 < north_mps * forward < 0.5 * alone_mps
    # Its applet does not know of the other, and is told to leave the point as it is.
    assert points[system_id].afy == 1.0


def test_another_altitude_datum_is_corrected_and_said_once() -> None:
    there = Field(Limits(home_difference_m=5.0), home_m={FOLLOWER: 254.0})
    (point,) = there.points()
    # 10 m above the leader's home at 250 m is 6 m above its own at 254 m.
    assert point.alt == pytest.approx(6.0)
    there.fly(5.0)
    assert [text for text in there.events() if "home" in text] == [
        "follower 2: its home is +4.0 m from the leader's by their receivers, "
        "so it flies 6.0 m above its own"
    ]
    there.home_m[FOLLOWER] = 249.0  # set anew
    assert there.points()[0].alt == pytest.approx(11.0)
    assert "so it flies 11.0 m above its own" in there.events()[-1]


def test_a_stop_keeps_the_corrected_altitude() -> None:
    there = Field(Limits(home_difference_m=5.0), home_m={FOLLOWER: 254.0}, height_m=6.4)
    there.fly(1.0)
    there.silent = {LEADER}
    there.fly(2.0)
    assert there.points()[0].alt == pytest.approx(6.0)


def test_level_homes_are_not_corrected() -> None:
    limits = Limits(home_difference_m=5.0, level_homes=True)
    there = Field(limits, home_m={FOLLOWER: 254.0})
    assert there.points()[0].alt == pytest.approx(10.0)
    assert not any("home" in text for text in there.events())


def test_level_homes_are_not_shown_as_a_separation() -> None:
    """Nor held against the sonar, which hears the leader 4 m ahead and not 5.7 m away."""
    limits = Limits(home_difference_m=5.0, level_homes=True)
    there = Field(limits, home_m={FOLLOWER: 254.0})
    there.fly(1.0)
    (shown,) = Panel([LEADER, FOLLOWER]).rows(there.session, there.now_s)
    assert shown.separation_m == pytest.approx(4.0, abs=0.02)


@pytest.mark.parametrize("level", [False, True])
def test_homes_that_are_told_apart_are_no_height_to_listen_past(level: bool) -> None:
    """On level ground the sonar looks at the leader, whatever the receivers say of the homes."""
    limits = Limits(home_difference_m=5.0, level_homes=level)
    there = Field(limits, home_m={FOLLOWER: 254.0})
    there.fly(1.0)
    known, follower = there.session.known, there.session.followers[FOLLOWER]
    above_m = 0.0 if level else -4.0
    assert known.watched_above_m(follower) == pytest.approx(above_m)
    at_s = there.now_s - TICK_S
    leader, own = known.leader_history.around(at_s), follower.estimate.history.around(at_s)
    assert leader is not None
    assert own is not None
    assert leader[0].position.alt_m - own[0].position.alt_m == pytest.approx(above_m)


@pytest.mark.parametrize("level", [False, True])
def test_homes_too_far_apart_stop_it(level: bool) -> None:
    there = Field(Limits(home_difference_m=5.0, level_homes=level))
    there.fly(1.0)
    assert there.state == "following"
    there.home_m[FOLLOWER] = 242.5
    there.fly(TICK_S)
    assert there.state == "holding: its home is -7.5 m from the leader's"


def test_homes_that_are_not_known_stop_it() -> None:
    limits = Limits(home_difference_m=5.0, leader_flies=False)
    plan = FollowerPlan(FOLLOWER, Slot(3.0), sonar=shipped_sonar())
    known = Known(LEADER, [plan], GuidanceSettings())
    guard = Guard(limits, known, lambda now_s, text: None)
    follower = known.followers[FOLLOWER]
    follower.position = displace(HERE, (-3.0, 0.0, 0.0))
    assert guard.reason_to_stop(follower, HERE, 0.0) == "homes are not known"


def test_a_correction_never_leads_it_to_the_ground() -> None:
    there = Field(Limits(home_difference_m=20.0), home_m={FOLLOWER: 258.5})
    there.fly(TICK_S)
    assert there.state == "holding: the leader's altitude is only 1.5 m above its own home"


def test_a_leader_that_has_landed_stops_it_unless_it_may() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.tell(LEADER, heartbeat(flying=False))
    there.fly(TICK_S)
    assert there.state == "holding: leader is not known to fly"

    carried = Field(Limits(leader_flies=False))
    carried.tell(LEADER, heartbeat(flying=False))
    carried.fly(1.0)
    assert carried.state == "following"


def test_a_follower_on_the_ground_is_left_alone() -> None:
    there = Field(Limits())
    there.tell(FOLLOWER, heartbeat(flying=False))
    assert there.points(1.0) == []


def test_a_stop_is_verified_by_ground_speed_and_told_of_until_it_holds() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.speed_mps[FOLLOWER] = 1.5
    there.silent = {LEADER}
    there.fly(1.25 + REMIND_S)
    assert "follower 2: still moves at 1.5 m/s, stopped again" in there.events()
    assert "follower 2: has stopped" not in there.events()

    there.speed_mps[FOLLOWER] = 0.1
    there.fly(STILL_FOR_S + 2 * TICK_S)
    assert there.events()[-1] == "follower 2: has stopped"
    assert len(there.points(1.0)) == 8  # and the stop is repeated all the time


def test_one_that_still_climbs_does_not_stand() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.climb_mps = 1.0
    there.silent = {LEADER}
    there.fly(5.0)
    assert "follower 2: has stopped" not in there.events()
    assert "follower 2: still moves at 1.0 m/s, stopped again" in there.events()


def test_a_target_that_is_not_read_back_is_said_once() -> None:
    there = Field(Limits())
    there.fly(3 * RATE_WINDOW_S)
    assert sum("its target is not read back" in text for text in there.events()) == 1

    answers = Field(Limits())
    (sent,) = answers.points()
    answers.tell(FOLLOWER, read_back(sent))
    answers.fly(2 * RATE_WINDOW_S)
    assert not any("not read back" in text for text in answers.events())


def test_silence_is_not_taken_for_standing() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.silent = {FOLLOWER}  # its last report was that it hovered
    there.session.stop("the tool ends")
    there.fly(UNHEARD_S - TICK_S)
    assert not any("has stopped" in text for text in there.events())


def test_a_refused_point_stops_it_until_the_pilot_has_taken_over() -> None:
    there = Field(Limits())
    there.fly(1.0)
    while "its points are refused, holding" not in there.events()[-1] and there.now_s < 10.0:
        (sent,) = there.points()
        there.tell(FOLLOWER, read_back(sent, shift_m=2.0))
    assert there.now_s == pytest.approx(1.0 + REFUSED_FOR_S, abs=3 * TICK_S)
    assert there.state == "holding: its points are refused"

    there.fly(REMEMBERED_S)
    assert there.state == "holding: its points are refused"
    there.tell(FOLLOWER, heartbeat(LOITER))
    there.tell(FOLLOWER, heartbeat(LOITER))
    there.tell(FOLLOWER, heartbeat(GUIDED))
    there.fly(1.0)
    assert there.state == "following"


@pytest.mark.parametrize(("shift_m", "applet_state"), [(0.3, 2), (5.0, 6)])
def test_targets_near_enough_or_the_applets_own_are_no_refusal(
    shift_m: float, applet_state: int
) -> None:
    there = Field(Limits())
    state = mavlink.MAVLink_named_value_float_message(0, b"ECHO_STATE", applet_state)
    there.tell(FOLLOWER, state)
    for _ in range(round(2 * REFUSED_FOR_S / TICK_S)):
        (sent,) = there.points()
        there.tell(FOLLOWER, read_back(sent, shift_m))
    assert there.state == "following"


@pytest.mark.parametrize(
    ("off_m", "velocity_mps"),
    [
        ((400.0, 0.0), (0.0, 0.0)),
        ((0.0, 0.0), (math.nan, 0.0)),
        ((0.0, -400.0), (1.0, 0.0)),
    ],
)
def test_no_point_leaves_that_is_far_or_not_finite_whatever_was_reckoned_with(
    off_m: tuple[float, float],
    velocity_mps: tuple[float, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    yard = Yard(limits=FIELD_LIMITS)
    yard.fly(6.0)
    reckoned = planned

    def wrong(*arguments: Any) -> Any:
        guided = reckoned(*arguments)
        far = displace(guided.point, (*off_m, 0.0))
        return replace(guided, point=far, velocity_mps=velocity_mps)

    monkeypatch.setattr("echowing.flight.plan.planned", wrong)
    points = yard.fly(2.0)
    assert len(points) == 16
    assert all((one.vx, one.vy) == (0.0, 0.0) for one in points)
    assert all(abs(north_of(one) + 4.0) < 1.0 for one in points)
    assert yard.state() == "holding: its point was out of reach, until it leaves Guided"
    assert sum("its point was out of reach" in text for text in yard.events()) == 1


@pytest.mark.parametrize(("leaders_mps", "is_flown"), [(20.0, True), (35.0, False)])
def test_no_point_leaves_that_is_faster_than_a_copter(leaders_mps: float, is_flown: bool) -> None:
    yard = Yard(limits=FIELD_LIMITS)
    yard.fly(6.0)
    yard.vehicles[LEADER].velocity_mps = (leaders_mps, 0.0)
    points = yard.fly(2.0)
    assert len(points) == 16
    assert max(math.hypot(one.vx, one.vy) for one in points) < 30.0
    assert yard.state() == (
        "following" if is_flown else "holding: its point was out of reach, until it leaves Guided"
    )


def test_nor_does_the_place_where_it_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    yard = Yard(limits=FIELD_LIMITS)
    yard.fly(6.0)
    nowhere = GlobalPosition(math.nan, math.nan, 10.0)
    monkeypatch.setattr("echowing.flight.holds._stopping_place", lambda *_: nowhere)
    yard.session.stop("the tool ends")
    points = yard.fly(2.0)
    assert len(points) == 16
    assert all(abs(north_of(one) + 4.0) < 1.0 for one in points)


def test_an_unheard_follower_is_sent_nothing() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.silent = {FOLLOWER}
    there.fly(UNHEARD_S + TICK_S)
    assert there.points(1.0) == []
    assert there.events()[-1] == "follower 2: no report for 2 s, no points sent"
    there.silent = set()
    assert len(there.points(1.0)) == 8


def test_a_radio_that_holds_reports_back_is_as_good_as_silent() -> None:
    there = Field(Limits(), now_s=20.0)
    there.fly(1.0 + TICK_S)
    # Its clock is ours, as a quick answer shows; from now on what comes is 3 s old.
    there.tell(FOLLOWER, mavlink.MAVLink_timesync_message(*(round(there.now_s * 1e9),) * 2))
    there.fly(1.0)
    assert there.state == "following"
    there.late_s = 3.0
    there.fly(3.5)
    assert there.state == "no points sent"
    assert there.events()[-1] == "follower 2: no report for 2 s, no points sent"
    there.late_s = 0.0
    there.fly(1.0)
    assert there.state == "holding: its link was lost"
    there.fly(STEADY_S)
    assert there.state == "following"


def test_a_link_that_comes_back_is_told_to_its_pilot_before_it_is_flown_on() -> None:
    """After ten seconds it flew on with the first report, without a word on its display."""
    yard = Yard()
    yard.fly(6.0)
    yard.vehicles[FOLLOWER].silent = True
    yard.vehicles[LEADER].velocity_mps = (1.0, 0.0)
    yard.fly(10.0)
    assert yard.fly(1.0) == []
    yard.vehicles[FOLLOWER].silent = False
    yard.sent.clear()
    points = yard.fly(STEADY_S - 2 * TICK_S)
    assert len(points) >= 22
    assert {round(one.lat_int, -2) for one in points} == {round(points[0].lat_int, -2)}
    assert {(one.vx, one.vy) for one in points} == {(0.0, 0.0)}
    texts = [m.text for who, m in yard.sent if who == FOLLOWER and m.get_type() == "STATUSTEXT"]
    assert "Echowing: link was lost, holding" in texts
    yard.fly(1.0)
    texts = [m.text for who, m in yard.sent if who == FOLLOWER and m.get_type() == "STATUSTEXT"]
    assert texts[-1] == "Echowing: clear again, following"


def test_a_follower_that_reboots_is_taken_on_its_new_clock() -> None:
    there = Field(Limits(), now_s=20.0)
    there.fly(1.0 + TICK_S)
    there.tell(FOLLOWER, mavlink.MAVLink_timesync_message(*(round(there.now_s * 1e9),) * 2))
    there.fly(1.0)
    there.late_s = 20.0  # its time stamps begin anew
    there.fly(1.0)
    assert there.state == "following"


def test_the_stop_switch_stops_and_hands_back() -> None:
    there = Field(Limits(switch=StopSwitch(5, 1200)))
    there.fly(1.0)
    there.tell(FOLLOWER, rc_channels(5, 1800))
    (held,) = there.points()
    assert north_of(held) == pytest.approx(-4.0, abs=0.02)
    there.fly(STILL_FOR_S + 2 * TICK_S)
    assert there.events()[-2:] == [
        "follower 2: has stopped",
        "follower 2: pilot has control, by the stop switch",
    ]
    assert there.points(1.0) == []

    there.tell(FOLLOWER, rc_channels(5, 1000))
    assert there.points(1.0) == []  # only the pilot's Guided gives it back
    there.tell(FOLLOWER, heartbeat(LOITER))
    there.tell(FOLLOWER, heartbeat(LOITER))
    there.tell(FOLLOWER, heartbeat(GUIDED))
    assert len(there.points(1.0)) == 8


@pytest.mark.parametrize("released", [False, True])
@pytest.mark.parametrize("flying", [False, True])
def test_one_false_heartbeat_does_not_end_what_its_switch_has_stopped(
    released: bool, flying: bool
) -> None:
    """A heartbeat of another mode with its id ended the latch, and it was led on."""
    there = Field(Limits(switch=StopSwitch(5, 1200)))
    there.fly(1.0)
    there.tell(FOLLOWER, rc_channels(5, 1800))
    there.fly(STILL_FOR_S + 1.0 if released else 2 * TICK_S)
    there.tell(FOLLOWER, rc_channels(5, 1000))
    for _ in range(3):
        there.tell(FOLLOWER, heartbeat(GUIDED if not flying else LOITER, flying=flying))
        assert there.points(2 * TICK_S) == []  # it may be its pilot
        there.tell(FOLLOWER, heartbeat(GUIDED))
        there.fly(3.0)
        assert there.state in ("holding: stop switch", "no points sent")
        assert there.session.guard is not None
        assert there.session.guard.switched(FOLLOWER)
    assert any("what has stopped it still does" in text for text in there.events())
    for mode in (LOITER, LOITER, GUIDED):
        there.tell(FOLLOWER, heartbeat(mode))
    there.fly(1.0)
    assert there.state == "following"


def test_one_false_heartbeat_interrupts_one_that_is_led_and_changes_nothing_else() -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.tell(FOLLOWER, heartbeat(LOITER))
    assert there.points(2 * TICK_S) == []
    there.tell(FOLLOWER, heartbeat(GUIDED))
    assert len(there.points(1.0)) == 8
    assert there.events()[-1] == "follower 2: in Guided again after one heartbeat, as before"


@pytest.mark.parametrize("why", ["stop switch", "leader is stale"])
def test_a_hold_goes_along_with_one_that_its_applet_flies_back(why: str) -> None:
    """From a leader that flies at it: back to its old place it would meet the leader again."""
    there = Field(Limits(switch=StopSwitch(5, 1200)))
    there.fly(1.0)
    if why == "stop switch":
        there.tell(FOLLOWER, rc_channels(5, 1800))
    else:
        there.silent = {LEADER}
        there.fly(1.5)
    (held, *_) = there.points()
    assert north_of(held) == pytest.approx(-4.0, abs=0.02)

    say_state(there, 6.0)
    there.north_m[FOLLOWER] = -9.0
    assert north_of(there.points()[-1]) == pytest.approx(-9.0, abs=0.02)
    assert there.state == f"holding: {why}"
    say_state(there, 5.0)
    there.fly(TICK_S)
    there.north_m[FOLLOWER] = -8.0  # the wind: it is to come back
    assert north_of(there.points()[-1]) == pytest.approx(-9.0, abs=0.02)


def test_a_hold_goes_along_until_one_that_backed_off_stands() -> None:
    """0.3 s of backing off gave it 2 m/s; called back it met the leader that came (0.82 m)."""
    there = Field(Limits())
    there.fly(1.0)
    there.silent = {LEADER}
    there.fly(1.5)
    say_state(there, 6.0)
    say_state(there, 5.0)
    there.north_m[FOLLOWER], there.speed_mps[FOLLOWER] = -5.5, -1.0
    assert north_of(there.points()[-1]) < -5.5
    there.north_m[FOLLOWER], there.speed_mps[FOLLOWER] = -6.0, 0.0
    assert north_of(there.points(1.0)[-1]) < -5.5


def say_state(there: Field, state: float) -> None:
    there.tell(FOLLOWER, mavlink.MAVLink_named_value_float_message(0, b"ECHO_STATE", state))


def test_a_stop_is_not_placed_further_off_because_of_the_wind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """2.5 m/s: to a place metres off, where 1 m/s2 would stop it, a follower speeds up."""
    there = Field(Limits())
    there.speed_mps[FOLLOWER] = 2.5
    there.fly(1.0)
    follower = there.session.followers[FOLLOWER]
    monkeypatch.setattr(there.session.known, "feel_wind", lambda *_: None)
    follower.handling.wind_leaves_mps2 = 1.0
    assert follower.handling.answer.decel_mps2 == 1.0
    there.silent = {LEADER}
    far_m = north_of(there.points(1.5)[-1]) + 4.0
    until_it_leans_m = 2.5 * (0.3 + there.session.followers[FOLLOWER].way_s)
    calm_mps2 = follower.handling.closing.accel_mps2
    assert far_m == pytest.approx(until_it_leans_m + 2.5**2 / (2.0 * calm_mps2), abs=0.3)


def test_the_stop_switch_may_change_the_mode() -> None:
    there = Field(Limits(switch=StopSwitch(5, 1200, "BRAKE")))
    there.fly(1.0)
    there.tell(FOLLOWER, rc_channels(5, 1800))
    there.fly(TICK_S)
    there.tell(FOLLOWER, heartbeat(GUIDED))

    changes = [m for m in there.fly(1.0) if getattr(m, "command", 0) == mavlink.MAV_CMD_DO_SET_MODE]

    assert {change.param2 for change in changes} == {mavlink.COPTER_MODE_BRAKE}
    there.tell(FOLLOWER, heartbeat(mavlink.COPTER_MODE_BRAKE))
    after = there.fly(2.0)
    assert not any(getattr(m, "command", 0) == mavlink.MAV_CMD_DO_SET_MODE for m in after)


def test_the_leaders_switch_stops_all_and_a_dead_receiver_nobody() -> None:
    there = Field(Limits(switch=StopSwitch(5, 1200)))
    there.fly(1.0)
    for nothing_us in (0, 65_535):
        there.tell(FOLLOWER, rc_channels(5, nothing_us))
        there.fly(1.0)
        assert there.state == "following"
    there.tell(LEADER, rc_channels(5, 1800))
    there.fly(TICK_S)
    assert there.state == "holding: stop switch"


def test_a_jumping_leader_is_told_of_once_and_stops_it() -> None:
    there = Field(Limits())
    there.fly(2.0)
    there.north_m[LEADER] = 30.0
    there.fly(0.5)
    assert [text for text in there.events() if "jumps" in text] == [
        "leader jumps: not believed until its reports agree again"
    ]


def test_a_leader_that_restarts_on_the_ground_stops_what_was_flown() -> None:
    there = Field(Limits(), now_s=20.0)
    there.fly(1.0 + TICK_S)
    there.now_s = 0.5  # its clock begins anew, as its reports show
    there.tell(LEADER, heartbeat(flying=False))
    there.tell(LEADER, there.position(LEADER))
    there.now_s = 21.0
    there.silent = {LEADER}
    assert north_of(there.points()[0]) == pytest.approx(-4.0, abs=0.02)
    assert there.state.startswith("holding")


def test_leaving_guided_forgets_where_it_was_held() -> None:
    there = Field(Limits(max_distance_m=20.0), north_m={LEADER: 0.0, FOLLOWER: -30.0})
    there.fly(1.0)
    there.tell(FOLLOWER, heartbeat(LOITER))
    there.fly(TICK_S)
    there.north_m[FOLLOWER] = -40.0  # flown there by hand
    there.fly(1.0)
    there.tell(FOLLOWER, heartbeat(GUIDED))
    assert north_of(there.points()[0]) == pytest.approx(-40.0, abs=0.02)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_named_float_that_is_no_number_changes_nothing(value: float) -> None:
    there = Field(Limits())
    there.fly(1.0)
    for name in (b"ECHO_STATE", b"SNR_RAW"):
        there.tell(FOLLOWER, mavlink.MAVLink_named_value_float_message(1, name, value))
        assert len(there.points(1.0)) == 8
    assert there.state == "following"


def test_a_mode_that_was_taken_is_not_asked_for_again_over_the_pilots_next() -> None:
    """Heartbeats come once a second: until the next nobody knows what the pilot has chosen."""
    there = Field(Limits(switch=StopSwitch(5, 1200, "LAND")))
    there.fly(1.0)
    there.tell(FOLLOWER, rc_channels(5, 1800))
    there.fly(TICK_S)
    there.tell(FOLLOWER, heartbeat(GUIDED))
    there.fly(TICK_S)
    command, accepted = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_RESULT_ACCEPTED
    there.tell(FOLLOWER, mavlink.MAVLink_command_ack_message(command, accepted, 0, 0, 245, 190))

    def asked(seconds: float) -> int:
        return sum(getattr(m, "command", 0) == command for m in there.fly(seconds))

    assert asked(1.5) == 0
    there.tell(FOLLOWER, heartbeat(GUIDED))  # it is in Guided all the same
    assert asked(1.0) > 0


@pytest.mark.parametrize("level", [False, True])
def test_homes_that_are_told_apart_hide_nobody_who_is_too_near(level: bool) -> None:
    """What the receivers say of the homes is no height between vehicles on level ground."""
    limits = Limits(home_difference_m=5.0, level_homes=level, min_separation_m=1.0)
    there = Field(limits, home_m={FOLLOWER: 254.0})
    there.north_m[FOLLOWER] = -2.5
    there.fly(1.0)
    # Where the homes are not level these two are really 4 m above each other.
    assert there.state == ("gives way to the leader" if level else "following")


def test_the_end_stops_only_what_was_moved() -> None:
    there = Field(
        Limits(),
        followers=(FOLLOWER, SECOND),
        north_m={LEADER: 0.0, FOLLOWER: -4.0, SECOND: -8.0},
    )
    there.tell(SECOND, heartbeat(LOITER))
    there.fly(1.0)
    there.session.stop("the tool ends")
    there.tell(SECOND, heartbeat(GUIDED))
    sent = there.points(STILL_FOR_S + 3 * TICK_S)
    assert {message.target_system for message in sent} == {FOLLOWER}
    assert there.session.stopped()
    first, second = (
        left_as(there.session, follower, there.now_s)
        for follower in there.session.followers.values()
    )
    assert first == ("stopped, GUIDED, 10.0 m up, 0.0 m/s", True)
    assert second == ("was not moved (GUIDED, 10.0 m up)", True)


@pytest.mark.parametrize("silent", [False, True])
def test_a_follower_that_does_not_stand_at_the_end_is_called_out(silent: bool) -> None:
    there = Field(Limits())
    there.fly(1.0)
    there.speed_mps[FOLLOWER] = 2.0
    there.silent = {FOLLOWER} if silent else set()
    there.session.stop("the tool ends")
    there.fly(5.0)
    text, well = left_as(there.session, there.session.followers[FOLLOWER], there.now_s)
    assert not well
    assert text.startswith("not confirmed stopped")
    assert "take over" in text


def test_rates_that_are_too_low_are_said_once_and_so_is_their_recovery() -> None:
    said: list[str] = []
    rates = RateWatch(
        [(1, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 4.0)], lambda t, s: said.append(s)
    )
    for window, rate_hz in enumerate([4, 1, 1, 4]):
        rates.check(window * RATE_WINDOW_S)
        for _ in range(round(rate_hz * RATE_WINDOW_S)):
            rates.received(1, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    rates.check(4 * RATE_WINDOW_S)
    assert said == [
        "system 1: GLOBAL_POSITION_INT comes at 1.0 Hz, 4 Hz asked for: "
        "check the radio and the stream rates",
        "system 1: GLOBAL_POSITION_INT comes at 4.0 Hz, 4 Hz asked for: well again",
    ]


def test_stop_switches_are_read() -> None:
    assert parse_stop_switch("5:1200") == StopSwitch(5, 1200, None)
    assert parse_stop_switch("7:1700:rtl") == StopSwitch(7, 1700, "RTL")


@pytest.mark.parametrize("text", ["", "5", "0:1200", "5:12", "5:1200:STABILIZE", "5:1200:DRIFT"])
def test_other_stop_switches_are_refused(text: str) -> None:
    with pytest.raises(EchowingError, match="stop switch"):
        parse_stop_switch(text)


def test_one_that_stands_though_it_is_sent_on_is_held() -> None:
    """A fence takes a place inside it and stops the vehicle there: nothing is read back as off."""
    there = Field(Limits(max_distance_m=50.0))
    there.north_m[FOLLOWER] = -20.0
    there.speed_mps[FOLLOWER] = 1.5
    there.fly(STUCK_FOR_S + 1.0)
    assert there.state == "following"
    there.speed_mps[FOLLOWER] = 0.0
    there.fly(STUCK_FOR_S - 0.5)
    assert there.state == "following"
    there.fly(1.0)
    assert there.state == "holding: its points are refused"
    assert sum("did not take the points" in text for text in there.events()) == 1
