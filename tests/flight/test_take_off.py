"""Taking off against simulated autopilots, in lock step: bytes both ways, no real time."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.readiness import Readiness
from echowing.flight.session import FollowSession
from echowing.flight.switch import StopSwitch
from echowing.flight.take_off import STALE_S, WARNING_S, Lift, TakeOff
from echowing.geo import ned_between
from echowing.sim.vehicle.autopilot import ORIGIN, Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sonar_file import shipped_sonar
from echowing.tool.panel import left_as, state_of

LEADER, FIRST, SECOND = 1, 2, 3
TELEMETRY = "telemetry"
POINT = "SET_POSITION_TARGET_GLOBAL_INT"
STEP_S, TICK_S = 0.02, 0.1
SWITCH = StopSwitch(7, 1700)


class Field:
    """A leader in the air, two followers on the ground, and a session that hears them all."""

    def __init__(
        self, *, engaged: bool = False, next_at_m: float = 4.0, ready: Readiness | None = None
    ) -> None:
        starts = {LEADER: (0.0, 0.0, -10.0), FIRST: (-6.0, 0.0, 0.0), SECOND: (-12.0, 0.0, 0.0)}
        self.copters = {i: Copter(start, flying=i == LEADER) for i, start in starts.items()}
        self.autopilots = {i: Autopilot(c, system_id=i) for i, c in self.copters.items()}
        self.parsers = {i: mavlink.MAVLink(None) for i in starts}
        self.packer = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        plans = [
            FollowerPlan(i, Slot(6.0 * (i - 1)), 10.0, sonar=shipped_sonar())
            for i in (FIRST, SECOND)
        ]
        self.session = FollowSession(
            LEADER,
            plans,
            GuidanceSettings(learn_offset=False),
            limits=Limits(min_separation_m=1.5, switch=SWITCH, ready=ready),
            engaged=engaged,
            take_off=TakeOff(5.0, next_at_m),
        )
        self.t_s = 0.0
        self.deaf: set[int] = set()
        self.lost: set[str] = set()
        self.sent: list[tuple[int, Any]] = []
        for autopilot in self.autopilots.values():
            autopilot.add_link(TELEMETRY)
            for channel in (5, 6, 7, 8):
                autopilot.set_rc(channel, 1100)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.t_s += STEP_S
            for system_id, autopilot in self.autopilots.items():
                self.copters[system_id].step(STEP_S)
                autopilot.step(self.t_s)
                self.hear(system_id, autopilot.transmit(TELEMETRY))
            if round(self.t_s / STEP_S) % round(TICK_S / STEP_S) == 0:
                self.send(self.session.tick(self.t_s))

    def hear(self, system_id: int, data: bytes) -> None:
        for message in self.parsers[system_id].parse_buffer(data) or ():
            if system_id not in self.deaf and message.get_type() not in self.lost:
                self.session.receive(message, self.t_s)

    def send(self, messages: list[tuple[int, Any]]) -> None:
        self.sent += messages
        for system_id, message in messages:
            self.autopilots[system_id].receive(TELEMETRY, bytes(message.pack(self.packer)))

    def arm(self, *followers: int) -> None:
        for system_id in followers:
            assert self.autopilots[system_id].set_mode("GUIDED")
            assert self.autopilots[system_id].modes.arm(force=True)

    def until(self, text: str, seconds: float = 30.0) -> None:
        until_s = self.t_s + seconds
        while not any(text in event for event in self.events()):
            assert self.t_s < until_s, self.events()
            self.run(TICK_S)

    def height_m(self, system_id: int) -> float:
        return -self.copters[system_id].down_m

    def events(self) -> list[str]:
        return [text for _, text in self.session.events]

    def commands(self) -> list[int]:
        return [m.command for _, m in self.sent if m.get_type() == "COMMAND_LONG"]

    def points(self) -> list[int]:
        return [system_id for system_id, m in self.sent if m.get_type() == POINT]

    def lift(self, system_id: int) -> Lift | None:
        return None if self.session.take_offs is None else self.session.take_offs.lift(system_id)

    def state(self, system_id: int) -> str:
        return state_of(self.session.followers[system_id])


def keep_on_the_ground(autopilot: Autopilot) -> None:
    """Its motors take their time."""
    autopilot.modes.guided.take_off = lambda altitude_m: None  # type: ignore[method-assign]


def test_one_takes_off_after_the_other_and_nothing_else_is_done() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    field.until("follower 2: takes off in 3 s to 5 m")
    announced_s = field.t_s
    assert field.state(FIRST) == "about to take off"
    field.until("follower 2: takes off")
    while field.commands().count(mavlink.MAV_CMD_NAV_TAKEOFF) == 0:
        field.run(TICK_S)
    assert field.t_s - announced_s == pytest.approx(WARNING_S, abs=3 * TICK_S)

    while field.lift(SECOND) is Lift.WAITING:
        field.run(TICK_S)
        assert field.height_m(SECOND) == 0.0
    assert field.height_m(FIRST) == pytest.approx(4.0, abs=0.3)
    field.until("follower 3: has taken off")

    field.run(3.0)
    for system_id, north_m in ((FIRST, -6.0), (SECOND, -12.0)):
        assert field.height_m(system_id) == pytest.approx(5.0, abs=0.1)
        assert field.copters[system_id].north_m == pytest.approx(north_m, abs=0.1)
        assert field.state(system_id) == "only watched"
    assert field.points() == []
    allowed = {mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}
    assert set(field.commands()) == allowed


def test_engaged_it_is_led_only_once_it_is_up() -> None:
    field = Field(engaged=True)
    field.arm(FIRST, SECOND)
    while field.lift(FIRST) is not Lift.DONE:
        assert FIRST not in field.points()
        field.run(TICK_S)
    assert field.height_m(FIRST) > 4.4
    field.run(6.0)
    assert field.state(FIRST) == "following"
    assert field.height_m(FIRST) == pytest.approx(10.0, abs=0.3)


def test_a_climb_is_no_reason_not_to_be_engaged() -> None:
    """At 0.3 m it was said that it would be flown to 10 m, which is too far."""
    ready = Readiness(applet=False, reversal=False, sides=False)
    field = Field(engaged=True, ready=ready)
    field.arm(FIRST)
    field.until("follower 2: has taken off", 40.0)
    field.run(1.0)
    events = field.events()
    assert any("to 5.0 m" in text and text.startswith("follower 2 ") for text in events)  # a row
    judged = [number for number, text in enumerate(events) if "would be flown" in text]
    up = next(number for number, text in enumerate(events) if "has taken off" in text)
    assert judged
    assert judged[0] > up  # then 5 m are not near enough to 10 m
    assert FIRST not in field.points()


def test_nobody_takes_off_whom_no_pilot_has_armed_in_guided() -> None:
    field = Field()
    field.run(10.0)
    assert "follower 2: waits to take off, until its pilot puts it in Guided" in field.events()
    field.autopilots[FIRST].set_mode("GUIDED")
    field.run(10.0)
    assert "follower 2: waits to take off, until its pilot arms it" in field.events()
    armed_elsewhere = field.autopilots[SECOND]
    assert armed_elsewhere.set_mode("LOITER")
    assert armed_elsewhere.modes.arm(force=True)
    field.run(8.0)
    assert mavlink.MAV_CMD_NAV_TAKEOFF not in field.commands()
    assert field.state(FIRST) == "waiting to take off"


def test_a_change_of_mode_during_the_warning_calls_it_off() -> None:
    field = Field()
    field.arm(FIRST)
    field.until("takes off in 3 s")
    field.autopilots[FIRST].set_mode("LOITER")
    field.run(5.0)
    assert "follower 2: take-off called off, until its pilot puts it in Guided" in field.events()
    assert mavlink.MAV_CMD_NAV_TAKEOFF not in field.commands()


def test_a_pilot_who_takes_over_on_the_way_up_is_left_alone_and_so_is_everybody() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    field.until("follower 2: takes off")
    while field.height_m(FIRST) < 2.0:
        field.run(TICK_S)
    field.autopilots[FIRST].set_mode("LAND")
    field.run(8.0)
    assert "follower 2: has left Guided, take-off given up; nobody else takes off" in field.events()
    assert field.height_m(SECOND) == 0.0
    assert field.points() == []
    assert field.state(FIRST) == field.state(SECOND) == "only watched"


def test_a_disarmed_vehicle_ends_it() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    keep_on_the_ground(field.autopilots[FIRST])
    field.until("follower 2: takes off")
    while field.lift(FIRST) is not Lift.CLIMBING:
        field.run(TICK_S)
    field.run(1.0)
    assert field.autopilots[FIRST].modes.disarm()
    field.run(5.0)
    assert "follower 2: is disarmed, take-off given up; nobody else takes off" in field.events()
    assert field.height_m(SECOND) == 0.0


@pytest.mark.parametrize("who", [FIRST, LEADER])
def test_the_stop_switch_stops_the_climb_where_it_is(who: int) -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    while field.height_m(FIRST) < 2.0:
        field.run(TICK_S)
    field.autopilots[who].set_rc(SWITCH.channel, 1900)
    field.until("follower 2: take-off stopped, stop switch; nobody else takes off")
    field.until("follower 2: has stopped")
    height_m = field.height_m(FIRST)
    assert 2.0 < height_m < 4.5
    field.run(5.0)
    assert field.height_m(FIRST) == pytest.approx(height_m, abs=0.2)
    assert field.height_m(SECOND) == 0.0


def test_the_end_stops_the_climb_and_says_how_it_was_left() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    while field.height_m(FIRST) < 2.0:
        field.run(TICK_S)
    field.session.stop("the tool ends")
    field.run(TICK_S)
    assert not field.session.stopped()
    while not field.session.stopped():
        field.run(TICK_S)
    text, well = left_as(field.session, field.session.followers[FIRST], field.t_s)
    assert well
    assert text.startswith("stopped, GUIDED")
    assert field.height_m(FIRST) < 4.5
    assert field.height_m(SECOND) == 0.0


def test_the_end_after_take_offs_sees_that_all_stand() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    field.until("follower 3: has taken off")
    field.session.stop("the tool ends")
    field.until("follower 2: has stopped")
    field.until("follower 3: has stopped")
    assert field.session.stopped()
    for follower in field.session.followers.values():
        text, well = left_as(field.session, follower, field.t_s)
        assert well
        assert text.startswith("stopped, GUIDED")


def test_the_end_on_the_ground_keeps_what_was_told_to_take_off_there() -> None:
    field = Field()
    field.arm(FIRST)
    keep_on_the_ground(field.autopilots[FIRST])
    while field.lift(FIRST) is not Lift.CLIMBING:
        field.run(TICK_S)
    field.session.stop("the tool ends")
    field.run(2.0)
    assert set(field.points()) == {FIRST}
    assert field.session.stopped()
    assert field.height_m(FIRST) == 0.0


def test_stale_telemetry_stops_the_climb_and_nobody_else_goes() -> None:
    field = Field(next_at_m=1.0)
    field.arm(FIRST, SECOND)
    while field.height_m(FIRST) < 0.7:
        field.run(TICK_S)
    field.deaf = {FIRST}
    field.run(STALE_S + 3 * TICK_S)
    told = "follower 2: take-off stopped, its telemetry is stale; nobody else takes off"
    assert told in field.events()
    field.deaf = set()
    field.run(10.0)
    assert field.height_m(SECOND) == 0.0


def test_nobody_takes_off_whose_mode_is_no_longer_heard() -> None:
    field = Field()
    field.arm(FIRST)
    field.until("takes off in 3 s")
    field.lost = {"HEARTBEAT"}
    field.autopilots[FIRST].set_mode("LOITER")
    field.run(8.0)
    told = "follower 2: take-off called off, no report of its position and mode yet"
    assert told in field.events()
    assert mavlink.MAV_CMD_NAV_TAKEOFF not in field.commands()


def test_a_refusal_is_said_and_ends_it() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    field.autopilots[FIRST].modes.take_off = lambda altitude_m: False  # type: ignore[method-assign]
    field.until("follower 2: its autopilot refuses to take off (FAILED); nobody else takes off")
    field.run(5.0)
    assert field.commands().count(mavlink.MAV_CMD_NAV_TAKEOFF) == 1
    assert field.height_m(SECOND) == 0.0


def test_one_that_stays_on_the_ground_is_told_of() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    field.autopilots[FIRST].parameters.set("DISARM_DELAY", 0.0)
    keep_on_the_ground(field.autopilots[FIRST])
    field.until("follower 2: take-off stopped, it does not leave the ground; nobody else takes off")
    assert field.lift(SECOND) is Lift.LEFT
    # Motors that reach their speed at last (TKOFF_RPM_MIN) would lift it when nobody expects it.
    field.run(1.0)
    held = [m for system_id, m in field.sent if system_id == FIRST and m.get_type() == POINT]
    assert len(held) >= 9
    assert all(abs(m.alt) < 0.1 for m in held)


def test_one_that_flies_already_is_no_reason_to_wait() -> None:
    field = Field()
    field.arm(FIRST, SECOND)
    assert field.autopilots[FIRST].modes.take_off(6.0)
    field.run(1.0)
    assert "follower 2: flies already, no take-off" in field.events()
    field.until("follower 3: has taken off")


def test_vehicles_too_near_to_each_other_do_not_take_off() -> None:
    field = Field()
    field.copters[FIRST].north_m = -10.8
    field.arm(FIRST, SECOND)
    field.run(5.0)
    told = "follower 2: waits to take off, nearer to follower 3 than 1.5 m"
    assert told in field.events()
    assert mavlink.MAV_CMD_NAV_TAKEOFF not in field.commands()


def test_a_lost_acknowledgement_is_asked_for_again_and_a_late_refusal_is_none() -> None:
    field = Field()
    field.arm(FIRST)
    acknowledged = field.session.take_offs
    assert acknowledged is not None
    while field.lift(FIRST) is not Lift.CLIMBING:
        field.run(TICK_S)
    while field.height_m(FIRST) < 1.0:
        field.run(TICK_S)
    refusal = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_NAV_TAKEOFF, 4)
    acknowledged.acknowledged(field.session.followers[FIRST], refusal, field.t_s)
    assert field.lift(FIRST) is Lift.CLIMBING


def test_the_field_is_where_the_test_thinks() -> None:
    field = Field()
    field.run(1.0)
    position = field.session.followers[SECOND].position
    assert position is not None
    assert ned_between(ORIGIN, position)[0] == pytest.approx(-12.0, abs=0.05)


@pytest.mark.parametrize("engaged", [True, False])
def test_a_leader_that_is_lost_during_the_climb_brings_nobody_down_again(engaged: bool) -> None:
    """A hold begins where the follower is when points go to it, not where it once left the ground.

    Engaged, it is told to hold once it is up; else at the end, when the tool stops what it moved.
    """
    field = Field(engaged=engaged)
    field.arm(FIRST)
    field.run(2.0)  # the leader is heard, and then no more
    field.deaf.add(LEADER)
    field.until("follower 2: has taken off")
    field.run(5.0)
    assert field.height_m(FIRST) == pytest.approx(5.0, abs=0.5)
    field.session.stop("the tool ends")
    field.run(8.0)
    assert FIRST in field.points()
    assert field.height_m(FIRST) == pytest.approx(5.0, abs=0.5)


def test_a_climb_stopped_while_the_leader_is_lost_stops_where_it_is() -> None:
    field = Field(engaged=True)
    field.arm(FIRST)
    field.run(2.0)
    field.deaf.add(LEADER)
    while field.height_m(FIRST) < 3.0:
        field.run(TICK_S)
    field.session.stop("the tool ends")
    field.run(8.0)
    assert 3.0 < field.height_m(FIRST) < 4.5
