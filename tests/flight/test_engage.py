"""Before anything moves: what has to be known and right, and what stops a follower later."""

import math
import re
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.engage import (
    FLOWN_M,
    PATIENCE_S,
    READ_AGAIN_S,
    Finding,
    StuckPosition,
    table,
)
from echowing.flight.envelope import Answer
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.handling import SELDOM_S, STEERED_MPS2, least_slot_m
from echowing.flight.readiness import Readiness
from echowing.flight.switch import StopSwitch
from echowing.geo import distance_m
from echowing.mavlink.messages import POINT_FORMAT
from echowing.mavlink.seats import StrangerWatch, parse_seat
from echowing.sonar_file import shipped_sonar

from .yard import AUTO, FOLLOWER, GUIDED, LEADER, LOITER, SECOND, TICK_S, Vehicle, Yard

SOON_S = PATIENCE_S + 2.0


def test_where_all_is_right_points_go_within_two_seconds_and_the_table_comes_first() -> None:
    yard = Yard()
    assert len(yard.fly(2.0)) > 4
    assert yard.state() == "following"
    head, leader, follower, more, _, its_rest = shown = yard.events()[1:7]
    assert head.split() == [
        *("before", "engaging", "clock", "GPS", "EKF", "battery"),
        *("applet", "distance"),
    ]
    assert more.split() == ["least", "home", "height"]
    assert leader.startswith("leader 1 ")
    assert "3D 10  ok   80 %" in leader
    assert "hold, 1.0 s  3.0 m" in follower
    assert its_rest.split() == ["follower", "2", "2.7", "m", "+0.0", "m", "10.0", "m"]
    assert not any("!" in line for line in shown)


# The widest cell of each column of a follower, as `findings` and its helpers give it.
WIDEST = {
    **{"clock": "0.46 s", "switch": "not seen", "applet": "law 1, 10.0 s", "distance": "3.0 m"},
    **{"least": "4.6 m", "home": "-123.4 m", "height": "4810.2 m", "RTL": "4810.0 m"},
    **{"GPS": "3D 255", "EKF": "no position", "battery": "not reported", "side": "crosses"},
    **{"room": "123.4 m", "who": "doubtful", "sonar": "co-processor"},
}


def test_the_table_fits_a_terminal_of_80_columns_and_cuts_nothing() -> None:
    wrong = [Finding(name, shown, "!") for name, shown in WIDEST.items()]
    lines = table([("leader 255", wrong[8:11]), ("follower 254", wrong), ("follower 2", wrong)])
    time = f"{12345.6:7.1f} s  "
    assert max(len(time + line) for line in lines) <= 80
    assert "before engaging" in lines[0]
    words = [word for line in lines for word in re.split(r" {2,}", line.strip())]
    for name, shown in WIDEST.items():
        assert words.count(name) == 1
        assert words.count(f"{shown}!") >= 2
    # Every part has its line of names, and names each vehicle again.
    assert len(lines) % 4 == 0
    assert [line.split("  ")[0] for line in lines[5:8]] == [
        "leader 255",
        "follower 254",
        "follower 2",
    ]


WRONG: dict[str, tuple[int, dict[str, Any], str]] = {
    "leader's clock": (LEADER, {"says_clock": False}, "the leader's clock is not known"),
    "its clock": (FOLLOWER, {"says_clock": False}, "its clock is not known"),
    "leader's fix": (LEADER, {"fix_type": 1}, "the leader has no GPS fix"),
    "its fix": (FOLLOWER, {"fix_type": 2}, "it has no GPS fix"),
    "its EKF": (FOLLOWER, {"ekf_flags": 831 & ~16}, "it has an EKF without a position"),
    "constant position": (FOLLOWER, {"ekf_flags": 831 | 128}, "it has an EKF without a position"),
    "leader's satellites": (LEADER, {"satellites": 5}, "the leader has 5 satellites: wait for 6"),
    "its HDOP": (FOLLOWER, {"hdop": 1.6}, "it has a GPS with HDOP 1.6: wait for 1.4"),
    "its doubts": (FOLLOWER, {"ekf_variance": 0.8}, "it has an EKF that doubts its position"),
    "its battery": (FOLLOWER, {"battery_percent": 12}, "it has 12 % of its battery left"),
    "no applet": (FOLLOWER, {"parameters": {}}, "no applet (ECHO_STREAM_T does not answer)"),
    "home": (FOLLOWER, {"home_m": 251.5}, "its home is +1.5 m from the leader's"),
    "height": (FOLLOWER, {"height_m": 14.0}, "it is 14.0 m up and would be flown to 10.0 m"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_said_and_keeps_it_from_being_sent_points(what: str) -> None:
    who, changes, said = WRONG[what]
    yard = Yard()
    yard.vehicles[who] = replace(yard.vehicles[who], **changes)
    assert yard.fly(SOON_S) == []
    assert yard.said(f"follower 2: not engaged, {said}")
    assert yard.state().startswith("not engaged: ")
    assert sum(f"not engaged, {said}" in text for text in yard.events()) == 1


APPLET = {
    "ECHO_ENABLE": (0.0, "its applet is off: param set ECHO_ENABLE 1"),
    "ECHO_STREAM_T": (0.0, "its stream watchdog is off: param set ECHO_STREAM_T 1"),
    "ECHO_INSET": (0.5, "its ECHO_INSET is 0.5 m and the sonar file's is 0.2 m"),
    "ECHO_DETECT": (4.3, "its ECHO_DETECT is 4.3 m and the sonar file's is 4.5 m"),
    "ECHO_DIST": (4.0, "its ECHO_DIST is 4 m and its slot is 3 m from the leader"),
}


@pytest.mark.parametrize("name", APPLET)
def test_an_applet_that_does_not_fit_is_said_and_read_again_until_it_does(name: str) -> None:
    wrong, said = APPLET[name]
    yard = Yard()
    parameters = yard.vehicles[FOLLOWER].parameters
    right, parameters[name] = parameters[name], wrong
    assert yard.fly(SOON_S) == []
    assert yard.said(said)
    parameters[name] = right
    assert yard.fly(READ_AGAIN_S + 1.0) != []


def test_an_applet_whose_values_setup_check_takes_is_engaged() -> None:
    """0.3 m are a little more in the 32 bits of a parameter: over a tenth off the file's 0.2 m."""
    yard = Yard()
    yard.vehicles[FOLLOWER].parameters["ECHO_INSET"] = 0.30000001
    assert yard.fly(SOON_S) != []


SPEED_APPLET = {"ECHO_LAW": 0.0}


@pytest.mark.parametrize(
    ("runs", "sends_velocity", "said"),
    [
        ({"ECHO_FORMAT": POINT_FORMAT}, True, None),
        (SPEED_APPLET, False, None),
        (
            {"ECHO_FORMAT": POINT_FORMAT},
            False,
            "it runs the hold, which needs points with a velocity",
        ),
        (SPEED_APPLET, True, "it runs the speed applet, which needs points without a velocity"),
        ({"ECHO_LAW": 2.0, "ECHO_GAIN_P": 0.7}, True, "its applet is of another version: update"),
        ({"ECHO_LAW": 2.0, "ECHO_GAIN_P": 0.7}, False, "its applet is of another version: update"),
        ({"ECHO_LAW": 0.0, "ECHO_GAIN_P": 0.7}, False, "its applet is of another version: update"),
        ({"ECHO_FORMAT": POINT_FORMAT + 1.0}, True, "its applet is of another version: update it"),
        ({}, True, "its applet is of another version: update it"),
    ],
)
def test_the_applet_must_be_the_one_that_flies_these_points(
    runs: dict[str, float], sends_velocity: bool, said: str | None
) -> None:
    yard = Yard(settings=GuidanceSettings(learn_offset=False, feed_forward=sends_velocity))
    parameters = yard.vehicles[FOLLOWER].parameters
    del parameters["ECHO_FORMAT"]
    parameters.update(runs)
    points = yard.fly(SOON_S)
    if said is None:
        assert points != []
        return
    assert points == []
    assert yard.said(f"not engaged, {said}")
    for name in runs:
        del parameters[name]
    parameters.update({"ECHO_FORMAT": POINT_FORMAT} if sends_velocity else SPEED_APPLET)
    assert yard.fly(READ_AGAIN_S + 5.0) != []  # another one is on the card now


def test_limits_too_slow_for_a_leader_that_turns_round_are_refused() -> None:
    """ArduCopter's own defaults: 4.6 m at 2 m/s. A slot of 5 m may have them."""
    slow = {"WP_ACC": 2.5, "PSC_JERK_NE": 5.0}
    yard = Yard()
    yard.vehicles[FOLLOWER].parameters.update(slow)
    assert yard.fly(SOON_S) == []
    assert yard.said("its slot is 3 m from the leader, and 4.6 m is the least")
    far = Yard(slots=[Slot(5.0)])
    far.vehicles[FOLLOWER].parameters.update(slow)
    assert far.fly(SOON_S) != []


def test_a_slot_opens_for_a_leader_too_fast_to_turn_round_from_it() -> None:
    """With the limits of 3 m/s2 and 10 m/s3: 2.5 m at 1 m/s, 4.6 m at 3 m/s."""
    yard = Yard(slots=[Slot(3.8)])
    limits = {"WP_ACC": 3.0, "PSC_JERK_NE": 10.0}
    yard.vehicles[FOLLOWER].parameters.update({"ECHO_DIST": 3.8, **limits})
    follower = yard.session.followers[FOLLOWER]
    yard.vehicles[LEADER].mode = AUTO
    yard.vehicles[LEADER].velocity_mps = yard.vehicles[FOLLOWER].velocity_mps = 1.0, 0.0
    yard.fly(SOON_S)
    assert follower.reversal_m == pytest.approx(2.46, abs=0.02)
    assert not yard.said("slot opens")
    yard.vehicles[LEADER].velocity_mps = 3.0, 0.0
    yard.fly(1.0)
    guided, leader = follower.guided, yard.session.leader.fix
    assert guided is not None
    assert leader is not None
    assert distance_m(guided.slot, guided.leader) == pytest.approx(4.6, abs=0.02)
    assert sum("slot opens to 4.6 m, leader at 3.0 m/s" in text for text in yard.events()) == 1


def test_a_sonar_that_reads_seldom_needs_more_room() -> None:
    """Two readings show a leader's braking: at 4 Hz after 0.6 s instead of 0.3."""
    slow = replace(shipped_sonar(), rate_hz=4.0)
    assert shipped_sonar().noticed_s == 0.3
    assert slow.noticed_s == 0.6
    assert replace(slow, rate_hz=50.0).noticed_s == 0.3
    yard = Yard(slots=[Slot(3.0)], sonar=slow)
    assert yard.fly(SOON_S) == []
    needs_m = least_slot_m(2.0, yard.session.followers[FOLLOWER].handling.answer, noticed_s=0.6)
    assert yard.said(f"its slot is 3 m from the leader, and {needs_m:.1f} m is the least")
    assert needs_m > 3.0

    far = Yard(slots=[Slot(5.0)], sonar=slow)
    far.vehicles[LEADER].mode = AUTO
    far.vehicles[LEADER].velocity_mps = far.vehicles[FOLLOWER].velocity_mps = 2.0, 0.0
    far.fly(SOON_S)
    follower = far.session.followers[FOLLOWER]
    assert follower.reversal_m == least_slot_m(2.0, follower.handling.answer, noticed_s=0.6)


def test_a_slot_opens_for_a_leader_that_is_steered() -> None:
    """At 2 m/s one on a mission leaves room enough to 3 m, one in Guided does not: 3.4 m.

    The applet is told with each point: by itself it would go on keeping ECHO_DIST.
    """
    yard = Yard()
    yard.vehicles[LEADER].velocity_mps = yard.vehicles[FOLLOWER].velocity_mps = 2.0, 0.0
    yard.vehicles[LEADER].mode = AUTO
    yard.vehicles[FOLLOWER].pitch_rad = math.radians(-3.7)  # against the air at 2 m/s, in calm
    assert {point.afx for point in yard.fly(SOON_S)} == {0.0}

    yard.vehicles[LEADER].mode = GUIDED
    point = yard.fly(3.0)[-1]

    answer = yard.session.followers[FOLLOWER].handling.answer
    least_m = least_slot_m(2.0, answer, 0.3, brakes_mps2=STEERED_MPS2)
    assert point.afx == pytest.approx(least_m)
    assert 3.3 < least_m < 3.6
    ignored = mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    assert point.type_mask & ignored
    assert yard.said("slot opens to 3.5 m, leader at 2.0 m/s")


@pytest.mark.parametrize(("speed_mps", "told"), [(4.3, 0), (6.0, 1)])
def test_a_leader_that_outruns_its_followers_is_told_of(speed_mps: float, told: int) -> None:
    yard = Yard()
    yard.fly(2.0)
    assert yard.said("the leader may fly at up to 4 m/s")
    for vehicle in yard.vehicles.values():
        vehicle.velocity_mps = (speed_mps, 0.0)
    yard.fly(20.0)
    warnings = [text for text in yard.events() if "leader too fast" in text]
    assert len(warnings) == told
    shown = [
        (who, m.text)
        for who, m in yard.sent
        if m.get_type() == "STATUSTEXT" and "too fast" in m.text
    ]
    text = "leader too fast, 6.0 m/s (most 4)"
    assert shown == [(FOLLOWER, f"Echowing: {text}"), (LEADER, f"Echowing: 2 {text}")] * told


def test_a_follower_that_the_wind_leaves_nothing_to_brake_with_is_not_engaged() -> None:
    """Leaning back 20 of 30 degrees, 3.6 of 5.7 m/s2; a gust takes half as much again."""
    yard = Yard()
    yard.vehicles[FOLLOWER].pitch_rad = math.radians(20.0)
    assert yard.fly(SOON_S) == []
    assert yard.said("not engaged, the wind leaves it 0.5 m/s2 to brake with, 1.0 are the least")
    yard.vehicles[FOLLOWER].pitch_rad = math.radians(-20.0)  # it comes from ahead
    assert yard.fly(20.0) != []


def test_a_slot_opens_where_the_wind_leaves_little_to_brake_with() -> None:
    """Blown from behind, 4.5 degrees at 2 m/s are 10 in hover: they leave 3.1 of 5 m/s2."""
    yard = Yard()
    yard.vehicles[LEADER].mode = AUTO
    yard.vehicles[LEADER].velocity_mps = yard.vehicles[FOLLOWER].velocity_mps = 2.0, 0.0
    yard.fly(SOON_S)
    follower = yard.session.followers[FOLLOWER]
    assert follower.reversal_m < 3.0
    assert not yard.said("m, wind leaves ")
    yard.vehicles[FOLLOWER].pitch_rad = math.radians(4.48)
    yard.fly(30.0)
    answer = Answer(follower.handling.answer_in_calm.dead_s, 3.1)
    assert follower.reversal_m == least_slot_m(2.0, answer, 0.3) > 3.0
    assert yard.said("m, wind leaves ")


def test_a_vehicle_that_leans_slowly_is_refused_a_near_slot() -> None:
    """At 300 deg/s2 the jerk is 8 m/s3, not 15, and all of that is lost before it brakes."""
    yard = Yard()
    slow = {"ATC_ACC_R_MAX": 300.0, "ATC_ACC_P_MAX": 300.0, "ATC_INPUT_TC": 0.3}
    yard.vehicles[FOLLOWER].parameters.update(slow)
    assert yard.fly(SOON_S) == []
    assert yard.said("its slot is 3 m from the leader, and 4.")


def test_what_it_does_not_tell_counts_as_the_worst_and_is_named() -> None:
    yard = Yard()
    parameters = yard.vehicles[FOLLOWER].parameters
    told = parameters.pop("ATC_INPUT_TC")
    assert yard.fly(SOON_S) == []
    assert yard.said("is the least at which it gets away")
    assert yard.said("not known, so taken as the worst: ATC_INPUT_TC")
    parameters["ATC_INPUT_TC"] = told
    assert yard.fly(SELDOM_S + 2.0) != []


def test_the_slot_does_not_open_for_limits_that_are_on_their_way() -> None:
    """They come one after another by radio: what is missing meanwhile is no reason to open."""
    yard = Yard()
    yard.vehicles[LEADER].velocity_mps = yard.vehicles[FOLLOWER].velocity_mps = 2.0, 0.0
    yard.vehicles[LEADER].mode = AUTO
    parameters = yard.vehicles[FOLLOWER].parameters
    late = {name: parameters.pop(name) for name in ("ATC_INPUT_TC", "ATC_ACC_P_MAX")}
    yard.fly(1.5)
    parameters.update(late)
    point = yard.fly(SOON_S)[-1]
    assert point.afx == 0.0
    assert not yard.said("slot opens")


@pytest.mark.parametrize("value", [1e-30, math.nan, math.inf])
def test_one_false_parameter_neither_hangs_nor_moves_anybody(value: float) -> None:
    """From anybody on the link: WP_ACC = 1e-30 was computed with for ever."""
    yard = Yard()
    yard.fly(SOON_S)
    follower = yard.session.followers[FOLLOWER]
    before = follower.handling.answer
    for name in ("WP_ACC", "PSC_JERK_NE", "ATC_ANGLE_MAX", "ATC_ACC_R_MAX"):
        follower.handling.receive(name, value)
    assert yard.fly(1.0) != []
    assert follower.handling.answer == before
    assert follower.opens_m == 0.0


def test_a_parameter_that_no_vehicle_has_is_named() -> None:
    yard = Yard()
    yard.vehicles[FOLLOWER].parameters["WP_ACC"] = 0.1
    assert yard.fly(SOON_S) == []
    assert yard.door.news == ["system 2: WP_ACC 0.1 cannot be: not believed"]


def test_limits_that_are_not_told_are_not_guessed() -> None:
    yard = Yard()
    del yard.vehicles[FOLLOWER].parameters["WP_ACC"]
    assert yard.fly(SOON_S) == []
    assert yard.said("its acceleration and jerk are not known")


def test_the_limits_of_a_4_6_are_read_in_its_units() -> None:
    yard = Yard()
    parameters = yard.vehicles[FOLLOWER].parameters
    parameters["WPNAV_ACCEL"] = 100.0 * parameters.pop("WP_ACC")
    parameters["PSC_JERK_XY"] = parameters.pop("PSC_JERK_NE")
    assert yard.fly(SOON_S) != []


def test_a_slot_out_of_the_sonars_reach_asks_for_no_distance() -> None:
    yard = Yard(slots=[Slot(8.0)])
    assert yard.fly(SOON_S) != []


def test_a_receiver_that_weakens_in_flight_stops_nobody_who_is_flown() -> None:
    yard = Yard()
    yard.fly(2.0)
    yard.vehicles[LEADER].satellites, yard.vehicles[LEADER].hdop = 5, 1.6
    yard.fly(3.0)
    assert yard.state() == "following"


def test_what_was_told_is_not_asked() -> None:
    yard = Yard(
        vehicles={
            LEADER: Vehicle((0.0, 0.0)),
            FOLLOWER: Vehicle((-4.0, 0.0), home_m=251.5, height_m=14.0),
        },
        ready=Readiness(homes_told=True, height_told=True),
    )
    assert yard.fly(SOON_S) != []


@pytest.mark.parametrize("who", [LEADER, FOLLOWER])
def test_the_stop_switch_has_to_be_seen_and_off(who: int) -> None:
    yard = Yard(limits=Limits(switch=StopSwitch(7, 1700)))

    def hear(pulse_us: int) -> None:
        for system_id in (LEADER, FOLLOWER):
            pulses = [1100] * 18
            pulses[6] = pulse_us if system_id == who else 1100
            boot_ms = yard.vehicles[system_id].boot_ms(yard.now_s)
            yard.tell(system_id, mavlink.MAVLink_rc_channels_message(boot_ms, 18, *pulses, 255))

    whose = "the leader's" if who == LEADER else "its"
    assert yard.fly(SOON_S) == []
    assert yard.said("stop switch is not seen")
    hear(1900)
    assert yard.fly(1.0) == []
    assert yard.said(f"follower 2: not engaged, {whose} stop switch is on")
    hear(1100)
    assert yard.fly(1.0) == []  # as the docstring says: until Guided is left
    for mode in (LOITER, LOITER, GUIDED):
        yard.vehicles[FOLLOWER].mode = mode
        yard.tell(FOLLOWER, yard.vehicles[FOLLOWER].heartbeat())
    assert yard.fly(1.0) != []


def test_old_data_is_held_where_the_clocks_are_known() -> None:
    """What comes 3 s late is not flown as fresh; where no clock was known nobody is engaged."""
    yard = Yard()
    yard.fly(2.0)
    yard.vehicles[LEADER].late_s = 3.0
    yard.fly(4.0)
    assert yard.state() == "holding: leader is stale"


@pytest.mark.parametrize(
    ("who", "change", "reason"),
    [
        (LEADER, {"fix_type": 1}, "leader has no GPS fix"),
        (FOLLOWER, {"ekf_flags": 0}, "it has an EKF without a position"),
        (LEADER, {"ekf_variance": 1.0}, "leader has an EKF that doubts its position"),
    ],
)
def test_a_position_that_is_worth_nothing_stops_it_until_it_is_back(
    who: int, change: dict[str, Any], reason: str
) -> None:
    yard = Yard()
    yard.fly(2.0)
    well = yard.vehicles[who]
    yard.vehicles[who] = replace(well, **change)
    yard.fly(1.0 + TICK_S)
    assert yard.state() == f"holding: {reason}"
    yard.vehicles[who] = well
    yard.fly(1.0 + TICK_S)
    assert yard.state() == "following"


def test_a_leader_whose_position_stays_put_with_fresh_stamps_stops_it() -> None:
    yard = Yard()
    for vehicle in yard.vehicles.values():
        vehicle.velocity_mps = (2.0, 0.0)
    yard.fly(3.0)
    assert yard.state() == "following"
    yard.vehicles[LEADER].stuck = yard.vehicles[LEADER].position(yard.now_s)
    yard.fly(FLOWN_M / 2.0 + 0.5)
    assert yard.state() == "holding: leader reports a position that stays put while it moves"


def test_a_hover_that_wanders_is_not_stuck_and_a_drift_that_adds_up_is() -> None:
    hover, stuck = StuckPosition(), StuckPosition()
    at = Vehicle((0.0, 0.0))
    for step in range(400):
        at.velocity_mps = (0.3 * math.sin(step / 5.0), 0.0)
        hover.report(at.position(step / 10.0))
        assert not hover.stuck
        report = at.position(step / 10.0)
        report.vx = 55
        stuck.report(report)
        assert stuck.stuck is (step >= 37)  # 0.55 m/s for 3.7 s is 2.03 m


def test_followers_on_each_others_sides_are_refused() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0)),
        FOLLOWER: Vehicle((-6.0, 5.0)),
        SECOND: Vehicle((-6.0, -5.0)),
    }
    left_and_right = [Slot(5.0, math.radians(-40.0)), Slot(5.0, math.radians(40.0))]
    found = []
    for slots in (left_and_right, left_and_right[::-1]):
        yard = Yard(vehicles=dict(vehicles), slots=slots)
        points = yard.fly(SOON_S)
        found.append((bool(points), yard.said("its way to its slot crosses")))
    assert sorted(found) == [(False, True), (True, False)]


def test_without_an_altitude_it_flies_at_the_leaders_height_when_it_is_engaged() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0), height_m=25.0),
        FOLLOWER: Vehicle((-4.0, 0.0), height_m=23.0, home_m=250.4),
    }
    yard = Yard(vehicles=vehicles, leaders_height=True)
    points = yard.fly(2.0)
    # The leader's height, corrected by what the homes differ by.
    assert points[-1].alt == pytest.approx(24.6, abs=0.05)
    assert yard.said("follower 2: flies 25.0 m above the leader's home")
    vehicles[LEADER].height_m = 20.0
    assert yard.fly(2.0)[-1].alt == pytest.approx(24.6, abs=0.05)


def test_a_leader_far_below_takes_nobody_down_without_a_word() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0), height_m=10.0),
        FOLLOWER: Vehicle((-4.0, 0.0), height_m=25.0),
    }
    yard = Yard(vehicles=vehicles, leaders_height=True)
    assert yard.fly(SOON_S) == []
    assert yard.said("it is 25.0 m up and would be flown to 10.0 m: fly it to within 3 m of that")


def test_an_answer_to_another_tool_sets_no_clock() -> None:
    yard = Yard()
    yard.vehicles[LEADER].says_clock = False
    yard.fly(1.0)
    others_ns = round(yard.now_s * 1e9) - 1
    yard.tell(LEADER, mavlink.MAVLink_timesync_message(round(101e9), others_ns))
    assert not yard.session.leader.clock.known


def test_only_watching_shows_the_table_and_what_would_be_wrong() -> None:
    yard = Yard(engaged=False)
    yard.vehicles[FOLLOWER].battery_percent = 5
    assert yard.fly(SOON_S) == []
    assert any(text.startswith("follower 2") and "5 %!" in text for text in yard.events())
    assert yard.said("follower 2: it has 5 % of its battery left: land it")


def beat_of(system_id: int) -> Any:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return mavlink.MAVLink(None).decode(bytearray(Vehicle((0.0, 0.0)).heartbeat().pack(sender)))


def test_another_vehicle_that_turns_up_on_an_unnamed_link_is_refused_with_its_id() -> None:
    seats = [parse_seat("leader", "udpin:1"), parse_seat("follower", "udpin:2@2")]
    watch = StrangerWatch(seats)
    seats[0].system_id = 1
    assert watch.heard("udpin:1", beat_of(1)) is None
    assert watch.heard("udpin:1", beat_of(2)) is None  # ours, forwarded
    assert watch.heard("udpin:2", beat_of(9)) is None  # that one was named
    found = watch.heard("udpin:1", beat_of(9))
    assert found is not None
    who, text = found
    assert who == LEADER
    assert "systems 1, 9 are on it" in text
    assert "udpin:1@1" in text


def test_who_is_not_known_to_be_ours_is_not_engaged_and_is_held() -> None:
    early, late = Yard(), Yard()
    late.fly(2.0)
    for yard in (early, late):
        assert yard.session.engagement is not None
        yard.session.engagement.doubt(LEADER, "systems 1, 9 are on it", yard.now_s)
    assert early.fly(SOON_S) == []
    late.fly(1.0)
    assert late.state() == "holding: leader may not be the vehicle that was meant"


def test_the_pilots_display_shows_why_it_stands_and_the_bell_rings() -> None:
    yard = Yard()
    yard.fly(2.0)
    yard.sent.clear()
    yard.vehicles[LEADER].silent = True
    yard.fly(2.0)
    yard.vehicles[LEADER].silent = False
    yard.fly(1.0)
    texts = [(who, m.text) for who, m in yard.sent if m.get_type() == "STATUSTEXT"]
    assert texts == [
        (FOLLOWER, "Echowing: holding, leader is stale"),
        (LEADER, "Echowing: 2 holding, leader is stale"),
        (FOLLOWER, "Echowing: leader reports again, following"),
        (LEADER, "Echowing: 2 leader reports again, following"),
    ]
    assert yard.session.alerts == 2


def test_what_keeps_it_from_being_engaged_is_on_the_display_too() -> None:
    yard = Yard()
    yard.vehicles[FOLLOWER].battery_percent = 5
    yard.fly(SOON_S)
    (text,) = [m.text for who, m in yard.sent if who == FOLLOWER and m.get_type() == "STATUSTEXT"]
    assert text == "Echowing: not engaged, it has 5 % of its battery l"


def test_followers_that_receivers_cannot_tell_apart_are_not_engaged() -> None:
    def at(apart_m: float) -> dict[int, Vehicle]:
        return {
            LEADER: Vehicle((0.0, 0.0)),
            FOLLOWER: Vehicle((-6.0, 0.5 * apart_m)),
            SECOND: Vehicle((-6.0, -0.5 * apart_m)),
        }

    slots = [Slot(5.0, math.radians(-40.0)), Slot(5.0, math.radians(40.0))]
    yard = Yard(
        vehicles=at(3.7),
        slots=slots,
        limits=Limits(min_separation_m=1.0, home_difference_m=5.0),
        ready=Readiness(sides=False),
    )
    assert yard.fly(SOON_S) == []
    # 2.5 sigmas of two receivers that wander by 0.8 m each are 2.8 m, and 1 m is to remain.
    assert yard.said(
        "follower 2: not engaged, it is 3.7 m from follower 3 by receivers that may err by 2.8 m: "
        "fly them 4.8 m apart"
    )
    yard.vehicles.update(at(3.9))
    assert yard.fly(SOON_S)
