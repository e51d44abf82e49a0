"""Receivers that jump, clocks that begin anew, two vehicles with one id."""

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.alignment import Report
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.jumps import (
    AGREEING_REPORTS,
    UNCONFIRMED_S,
    BootClocks,
    RangeMemory,
    is_jump,
)
from echowing.flight.leader_track import LeaderTrack
from echowing.flight.standstill import Standstill
from echowing.flight.streams import IN_A_ROW, Streams
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.sim.fault_section import FaultSection
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario
from echowing.sim.world.gps import Filter

from ..world import CLEARLY
from .yard import FOLLOWER, GUIDED, HERE, LEADER, LOITER, TICK_S, Vehicle, Yard

JUMP_M = (12.0, 0.0, 0.0)
COPROCESSOR = 191
AT_LAST_S = AGREEING_REPORTS * TICK_S + 3.0


class SonarYard(Yard):
    """A leader and a follower that stand 3 m apart; a sonar, and receivers that may jump."""

    def __init__(self, *, sonar: bool = True) -> None:
        vehicles = {LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-3.0, 0.0))}
        super().__init__(vehicles=vehicles, settings=GuidanceSettings())
        self.sonar = sonar
        self.range_m = 2.8
        self.off_m: dict[int, tuple[float, float, float]] = {}

    def fly(self, seconds: float) -> list[Any]:
        points = []
        for _ in range(round(seconds / TICK_S)):
            if self.sonar:
                boot_ms = round((self.now_s + TICK_S) * 1e3)
                # Two vehicles in the air: never long the same to the centimetre.
                range_m = self.range_m + 0.01 * (boot_ms // 500 % 2)
                reading = mavlink.MAVLink_named_value_float_message(boot_ms, b"SNR_RAW", range_m)
                self.tell(FOLLOWER, reading, COPROCESSOR)
            points += super().fly(TICK_S)
        return points

    def jump(self, system_id: int, by_m: tuple[float, float, float]) -> None:
        north_m, east_m = self.vehicles[system_id].at_m
        self.vehicles[system_id].at_m = north_m + by_m[0], east_m + by_m[1]


def off_m(points: list[Any], from_m: float) -> float:
    """The furthest that any point is from a place so far north of `HERE`."""
    origin = displace(HERE, (from_m, 0.0, 0.0))
    places = (GlobalPosition(one.lat_int / 1e7, one.lon_int / 1e7, HERE.alt_m) for one in points)
    return max(math.hypot(*ned_between(origin, place)[:2]) for place in places)


def leave_and_come_back(yard: Yard) -> None:
    for mode in (LOITER, LOITER, GUIDED):
        yard.vehicles[FOLLOWER].mode = mode
        yard.tell(FOLLOWER, yard.vehicles[FOLLOWER].heartbeat())


def test_a_leaders_jump_that_the_sonar_denies_moves_nobody_and_is_followed_on() -> None:
    yard = SonarYard()
    yard.fly(6.0)
    assert yard.state() == "following"
    yard.jump(LEADER, JUMP_M)
    points = yard.fly(AT_LAST_S)
    assert yard.said("leader's receiver jumped by 12.0 m: the sonar's range did not change")
    assert yard.state() == "following"
    assert off_m(points, -3.0) < 1.0
    # Back again, the other way round.
    yard.jump(LEADER, (-12.0, 0.0, 0.0))
    assert off_m(yard.fly(AT_LAST_S), -3.0) < 1.0
    assert yard.state() == "following"


@pytest.mark.parametrize("changes", [False, True])
def test_a_jump_that_no_sonar_denies_is_held_until_guided_is_left(changes: bool) -> None:
    yard = SonarYard(sonar=changes)
    yard.fly(6.0)
    yard.jump(LEADER, JUMP_M)
    yard.range_m = 4.2  # 1.4 m more than before: it has really moved
    points = yard.fly(AT_LAST_S)
    assert yard.state() == "holding: leader jumped by 12.0 m, until it leaves Guided"
    assert yard.said("leader's reports agree 12.0 m away from where it was: nobody is flown there")
    assert off_m(points, -3.0) < 1.0
    yard.fly(20.0)
    assert yard.state().startswith("holding: leader jumped")
    yard.tell(FOLLOWER, Vehicle((0.0, 0.0), mode=LOITER).heartbeat())  # a false one
    yard.fly(3.0)
    assert yard.state().startswith("holding: leader jumped")
    leave_and_come_back(yard)
    yard.fly(2.0)
    assert yard.state() == "following"


def test_its_own_jump_that_the_sonar_denies_moves_nobody() -> None:
    yard = SonarYard()
    yard.fly(6.0)
    yard.jump(FOLLOWER, JUMP_M)
    # Until it is sure that no other vehicle says so no point goes: its applet goes on by itself.
    assert yard.fly((IN_A_ROW - 1) * TICK_S) == []
    first = yard.fly(TICK_S)
    # Where it stands has another name: a point at the old one would fly it 12 m.
    assert off_m(first, 9.0) < 1.0
    # From 4.8 on the autopilot slews over to the old place until its sub-mode begins anew.
    anew = [number for number, (_, one) in enumerate(yard.sent) if begins_anew(one)]
    assert len(anew) == 1
    assert yard.sent[anew[0] + 1][1] is first[0]
    assert yard.state() == "holding: its position jumps"
    points = yard.fly(AT_LAST_S)
    assert yard.said("follower 2: its receiver jumped by 12.0 m: the sonar's range did not change")
    assert yard.state() == "following"
    assert off_m(points, 9.0) < 1.0
    assert sum(begins_anew(one) for _, one in yard.sent) == 1


def begins_anew(message: Any) -> bool:
    """Whether it ends what Guided was about to do: a velocity of nothing, and no place."""
    local = message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    nothing = local and bool(message.type_mask & mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE)
    return nothing and (message.vx, message.vy, message.vz) == (0.0, 0.0, 0.0)


def test_a_tool_whose_tick_fails_lets_guided_begin_anew_too() -> None:
    yard = SonarYard(sonar=False)
    yard.fly(6.0)
    yard.jump(FOLLOWER, JUMP_M)
    assert yard.fly((IN_A_ROW - 1) * TICK_S) == []
    yard.now_s += TICK_S
    yard._report(FOLLOWER, yard.vehicles[FOLLOWER])  # now it is believed, and no tick comes
    still = Standstill(yard.session.known, yard.session.guard)
    (_, first), (_, point) = still.messages(yard.now_s)
    assert begins_anew(first)
    assert not begins_anew(point)
    assert len(still.messages(yard.now_s)) == 1


def test_its_own_jump_that_no_sonar_denies_is_held() -> None:
    yard = SonarYard(sonar=False)
    yard.fly(6.0)
    yard.jump(FOLLOWER, JUMP_M)
    points = yard.fly(UNCONFIRMED_S + 1.0)
    assert yard.state() == "holding: its position jumped by 12.0 m, until it leaves Guided"
    assert off_m(points, 9.0) < 1.0
    leave_and_come_back(yard)
    yard.fly(2.0)
    assert yard.state() == "following"
    # The pilot's word does not tell where it truly is: that counts between followers.
    jump = yard.session.followers[FOLLOWER].own_jump
    assert jump.total_m == pytest.approx((12.0, 0.0), abs=0.3)
    yard.jump(FOLLOWER, (-12.0, 0.0, 0.0))
    yard.fly(IN_A_ROW * TICK_S)
    assert jump.total_m == pytest.approx((0.0, 0.0), abs=0.3)


def test_a_place_that_is_drawn_away_smoothly_is_followed_as_drift() -> None:
    """A campaign's find: 8.4 m in 3 s were flown after, past whom it followed, to 0.68 m.

    As EKF3 follows a step of that: its velocity is drawn along.
    """
    yard, filter_ = SonarYard(), Filter(1.5, 0.0)
    yard.fly(6.0)
    before = yard.session.followers[FOLLOWER].drift.lately_m[0]
    for _ in range(round(6.0 / TICK_S)):
        was_m = filter_.error_m
        for _ in range(25):
            filter_.step(6.0, 0.0, TICK_S / 25)
        yard.vehicles[FOLLOWER].velocity_mps = filter_.error_mps, 0.0
        yard.jump(FOLLOWER, (filter_.error_m - was_m - TICK_S * filter_.error_mps, 0.0, 0.0))
        yard.fly(TICK_S)

    assert yard.state() == "following"
    drifted_m = yard.session.followers[FOLLOWER].drift.lately_m[0] - before
    assert drifted_m == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize("system_id", [LEADER, FOLLOWER])
@pytest.mark.parametrize("by_m", [2.0, 3.7])
def test_a_receiver_that_jumps_by_a_few_metres_leads_nobody(system_id: int, by_m: float) -> None:
    """A campaign's find: 3.7 m counted as a movement, and the follower flew them: 0.34 m."""
    yard = SonarYard()
    yard.fly(6.0)
    yard.jump(system_id, (by_m, 0.0, 0.0))
    points = yard.fly(AT_LAST_S)
    assert yard.said(f"receiver jumped by {by_m} m: the sonar's range did not change")
    assert yard.state() == "following"
    # Where its slot is by its own receiver.
    assert off_m(points, -3.0 if system_id == LEADER else by_m - 3.0) < 1.0


@pytest.mark.parametrize("elapsed_s", [0.1, 0.25, 1.0, 2.0])
def test_what_a_copter_can_fly_between_two_reports_is_no_jump(elapsed_s: float) -> None:
    """It speeds up at 5 m/s2 and brakes again, and its clock is 0.25 s off in the second report."""
    flown_m = 5.0 * elapsed_s + 5.0 / 4.0 * elapsed_s**2
    before = Report(0.0, HERE, (5.0, 0.0), 0.0)
    for late_s in (-0.25, 0.0, 0.25):
        there = displace(HERE, (flown_m + 5.0 * late_s, 0.0, 0.0))
        assert not is_jump(before, Report(elapsed_s, there, (5.0, 0.0), 0.0))
    beyond = displace(HERE, (flown_m + 4.0, 0.0, 0.0))
    assert is_jump(before, Report(elapsed_s, beyond, (5.0, 0.0), 0.0))


def test_a_jump_does_not_become_a_movement_while_it_is_looked_at() -> None:
    """A campaign's find: 2.5 s later a copter might have flown 6.5 m, and it was led by that."""
    track = LeaderTrack()
    there = displace(HERE, (6.5, 0.0, 0.0))
    for number in range(AGREEING_REPORTS + 4):
        now_s = 1.0 + 0.4 * number
        track.receive(a_report(now_s, HERE if number < 4 else there), now_s)
    assert track.agreeing == AGREEING_REPORTS - 1
    assert track.jumps == 0
    assert track.fix is not None
    assert track.fix.position.lat_deg == pytest.approx(HERE.lat_deg, abs=1e-6)
    track.receive(a_report(now_s + 0.4, HERE), now_s + 0.4)
    assert track.fix.time_s == pytest.approx(now_s + 0.4)
    assert track.agreeing == 0


@pytest.mark.parametrize("jump_m", [1.6, 3.0, 15.0])
def test_a_jump_that_is_believed_at_once_is_no_drift_as_well(jump_m: float) -> None:
    """Reports come at 10 Hz: between those before and after it a copter might have flown 1.6 m."""
    track = LeaderTrack()
    there = displace(HERE, (jump_m, 0.0, 0.0))
    for number in range(20):
        now_s = 1.0 + 0.1 * number
        track.receive(a_report(now_s, HERE if number < 10 else there), now_s)
        if number == 12:
            assert track.believe_jump()[0] == pytest.approx(jump_m, abs=0.02)
    assert track.drift.lately_m == pytest.approx((0.0, 0.0), abs=0.02)


def a_report(now_s: float, at: GlobalPosition) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        round(now_s * 1e3), round(at.lat_deg * 1e7), round(at.lon_deg * 1e7), 0, 0, 0, 0, 0, 0
    )


def test_a_hold_goes_along_with_its_own_jump() -> None:
    yard = SonarYard(sonar=False)
    yard.fly(3.0)
    yard.vehicles[LEADER].silent = True
    yard.fly(2.0)
    assert yard.state() == "holding: leader is stale"
    yard.jump(FOLLOWER, JUMP_M)
    assert off_m(yard.fly(1.0), 9.0) < 1.0


def test_a_leader_that_boots_again_is_held_for_first_and_followed_where_it_was() -> None:
    yard = SonarYard()
    yard.fly(6.0)
    yard.vehicles[LEADER].boot_s = yard.now_s
    yard.fly(AGREEING_REPORTS * TICK_S - TICK_S)
    assert yard.session.leader.fix is not None
    assert yard.now_s - yard.session.leader.fix.time_s > 0.7  # nothing of the new clock yet
    yard.fly(3.0)
    assert yard.state() == "following"
    assert yard.session.leader.clock.known


def test_a_leader_that_boots_again_elsewhere_is_not_flown_to() -> None:
    yard = SonarYard(sonar=False)
    yard.fly(6.0)
    yard.vehicles[LEADER].boot_s = yard.now_s
    yard.jump(LEADER, (57.0, 0.0, 0.0))
    points = yard.fly(10.0)
    assert yard.state().startswith("holding: leader jumped by 57")
    assert off_m(points, -3.0) < 1.0


def test_two_vehicles_with_the_leaders_id_are_said_and_refused() -> None:
    yard = SonarYard(sonar=False)
    yard.fly(6.0)
    double = Vehicle((57.0, 0.0), boot_s=-5000.0)
    points = []
    for _ in range(40):
        yard.tell(LEADER, double.position(yard.now_s))
        points += yard.fly(TICK_S)
    assert yard.said("two vehicles with id 1, or an old recording on the link")
    assert yard.state() == "holding: two vehicles with the leader's id, until it leaves Guided"
    assert off_m(points, -3.0) < 1.0
    leave_and_come_back(yard)
    assert yard.fly(3.0) == []
    assert yard.said("follower 2: not engaged, two vehicles with the leader's id")


JUMP = """leader.script=[
    {at_s=1.0, act="fly", velocity_ned_mps=[1.0, 0.0, 0.0]},
    {at_s=20.0, act="gps_jump", jump_ned_m=[0.0, 12.0, 0.0]}]"""


@pytest.mark.parametrize("learns", [True, False])
def test_in_simulated_flight_the_sonar_denies_it_or_the_pilot_engages_it_again(
    learns: bool,
) -> None:
    changes = [" ".join(JUMP.split()), f"guidance.learn_offset={str(learns).lower()}"]
    flight = FormationFlight(load_scenario("hostile", [*changes, *CLEARLY, "duration_s=35"]), 1)
    events = [text for _, text in flight.run().events]
    if learns:
        assert any("jumped by 12.0 m: the sonar's range did not change" in text for text in events)
        assert not any("nobody is flown there" in text for text in events)
        return
    held = next(i for i, text in enumerate(events) if "nobody is flown there" in text)
    left = events.index("follower 2: left Guided for LOITER, pilot has control", held)
    assert "follower 2: in Guided, following" in events[left:]


def test_an_unheard_follower_whose_receiver_jumps_hardly_moves_towards_its_leader() -> None:
    """1.30 m were left where Guided did not begin anew, of 3.6 m before."""
    jumps = FaultSection(kind="gps_jump", vehicle=2, at_s=42.0, jump_ned_m=(0.0, -12.0, 0.0))
    deaf = FaultSection(kind="sonar_dead", vehicle=2, at_s=5.0)
    scenario = load_scenario("echowing", ["duration_s=46", 'follower.generation="4.8"'])
    scenario = scenario.model_copy(update={"fault": [jumps, deaf]})
    result = FormationFlight(scenario, 1).run()
    assert result.closest_m > 1.6
    # Its applet takes no notice of the message that lets Guided begin anew.
    assert not [text for _, text in result.events if "another format" in text]


def test_a_clock_is_believed_after_many_reports_in_a_row() -> None:
    clocks = BootClocks()
    assert clocks.is_believed(1000.0, 10.0)
    assert clocks.is_believed(1000.5, 20.0)  # held back for 9.5 s by a radio
    believed = [clocks.is_believed(1.0 + step / 4, 21.0 + step / 4) for step in range(12)]
    assert believed == [False] * AGREEING_REPORTS + [True] * 4


CLOCKS_S = [60.0, 5.0, 0.3, 0.005, 0.0, -0.3, -5.0, -60.0]


@pytest.mark.parametrize("ahead_s", CLOCKS_S)
def test_two_vehicles_with_a_followers_id_are_said_and_get_no_points(ahead_s: float) -> None:
    """Led by the other one's reports it flew 20 m in 8 s, and nobody was named."""
    yard = SonarYard(sonar=False)
    yard.fly(6.0)
    double = Vehicle((40.0, 8.0), boot_s=-100.0 - ahead_s)
    points = []
    for _ in range(24):
        yard.tell(FOLLOWER, double.position(yard.now_s))
        points += yard.fly(TICK_S)
    assert yard.said("two vehicles with id 2, or an old recording on the link")
    assert sum("two vehicles with id 2, or" in text for text in yard.events()) == 1
    assert not points or off_m(points, -3.0) < 1.0
    assert yard.fly(2.0) == []
    assert any(b"two vehicles with id 2" in bytes(text) for text in texts(yard, FOLLOWER))
    leave_and_come_back(yard)
    assert yard.fly(3.0) == []
    assert yard.said("follower 2: not engaged, two vehicles with id 2")


def texts(yard: Yard, system_id: int) -> list[bytes]:
    sent = (one for who, one in yard.sent if who == system_id)
    return [one.text.encode() for one in sent if one.get_type() == "STATUSTEXT"]


@pytest.mark.parametrize("ahead_s", CLOCKS_S)
@pytest.mark.parametrize("sonar", [True, False])
def test_two_vehicles_with_the_leaders_id_are_two_whatever_their_clocks(
    ahead_s: float, sonar: bool
) -> None:
    """With a clock 5 s ahead the other one was a jump, believed in half a second."""
    yard = SonarYard(sonar=sonar)
    yard.fly(6.0)
    double = Vehicle((57.0, 0.0), boot_s=-100.0 - ahead_s)
    points = []
    for _ in range(24):
        yard.tell(LEADER, double.position(yard.now_s))
        points += yard.fly(TICK_S)
    assert yard.said("two vehicles with id 1, or an old recording on the link")
    assert yard.state() == "holding: two vehicles with the leader's id, until it leaves Guided"
    assert off_m(points, -3.0) < 1.0


@pytest.mark.parametrize("system_id", [LEADER, FOLLOWER])
def test_a_receiver_that_jumps_there_and_back_and_a_vehicle_that_boots_again_are_one(
    system_id: int,
) -> None:
    yard = SonarYard()
    yard.fly(6.0)
    for by_m in (12.0, -12.0):
        yard.jump(system_id, (by_m, 0.0, 0.0))
        yard.fly(4.0)
    yard.vehicles[system_id].boot_s = yard.now_s
    yard.fly(8.0)
    assert not yard.said("two vehicles")
    assert yard.state() == "following"


def test_reports_that_come_twice_over_a_slow_way_with_losses_are_of_one_vehicle() -> None:
    """A router with two radios: a third of the reports is lost on either, one is 0.7 s slower."""
    vehicle, streams, drawn = Vehicle((0.0, 0.0), (6.0, 2.0)), Streams(), random.Random(7)
    arrivals = []
    for step in range(600):
        sent_s = 10.0 + step / 4.0
        vehicle.at_m = 6.0 * sent_s, 2.0 * sent_s
        report = vehicle.position(sent_s)
        ways_s = [late_s for late_s in (0.1, 0.8) if drawn.random() > 0.33]
        arrivals += [(sent_s + late_s, report) for late_s in ways_s]
    for at_s, report in sorted(arrivals, key=lambda one: one[0]):
        streams.is_sure(report, at_s)
    assert not streams.two


def test_a_range_is_unchanged_only_where_enough_was_heard() -> None:
    def memory(after_m: list[float], before_m: float = 2.8) -> RangeMemory:
        ranges = RangeMemory()
        for step in range(5):
            ranges.add(9.2 + step / 5, before_m)
        for step, range_m in enumerate(after_m, 1):
            ranges.add(10.0 + step / 5, range_m)
        return ranges

    assert memory([2.8, 3.0, 2.9, 2.7]).unchanged(10.0)
    assert memory([2.8, 0.4, 2.9, 2.7]).unchanged(10.0)  # a wild one
    assert not memory([2.8, 3.0]).unchanged(10.0)
    assert not memory([3.9, 4.0, 3.9, 4.1]).unchanged(10.0)
    assert not RangeMemory().unchanged(10.0)
