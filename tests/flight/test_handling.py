import math

import pytest

from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.closing import Closing
from echowing.flight.envelope import LEAST_M, OTHERS_MPS2, Answer
from echowing.flight.handling import (
    OFTEN,
    SELDOM_S,
    STEERED_MPS2,
    Handling,
    leader_brakes_mps2,
    least_slot_m,
)
from echowing.mavlink.vehicle_limits import LIMITS, is_plausible, usual_parameters

# From a leader's first braking to the follower's order, by a sonar of ten readings a second.
SHOWN_S = 0.3


def reported(**parameters: float) -> Handling:
    """One that has reported ArduCopter's defaults, and what differs."""
    handling = Handling()
    for name, value in (usual_parameters() | parameters).items():
        handling.receive(name, value)
    return handling


def test_arducopters_defaults_are_the_default_answer() -> None:
    assert reported().answer == Answer() == Answer(0.6, 2.5)
    assert reported().closing == Closing()
    assert reported().missing == []


def test_each_generation_reports_the_same_limits_in_its_own_units() -> None:
    old = Handling()
    for name, value in {
        "WPNAV_ACCEL": 500.0,
        "PSC_JERK_XY": 20.0,
        "ANGLE_MAX": 4500.0,
        "PSC_ANGLE_MAX": 0.0,
        "ATC_ACCEL_R_MAX": 30_000.0,
        "ATC_ACCEL_P_MAX": 72_000.0,
        "ATC_RATE_R_MAX": 0.0,
        "ATC_RATE_P_MAX": 180.0,
        "ATC_INPUT_TC": 0.2,
    }.items():
        old.receive(name, value)
    new = reported(
        WP_ACC=5.0,
        PSC_JERK_NE=20.0,
        ATC_ANGLE_MAX=45.0,
        ATC_ACC_R_MAX=300.0,
        ATC_ACC_P_MAX=720.0,
        ATC_RATE_P_MAX=180.0,
        ATC_INPUT_TC=0.2,
    )
    assert old.missing == new.missing == []
    assert (old.answer, old.closing, old.lean_max_rad) == (
        *(new.answer, new.closing, new.lean_max_rad),
    )


def test_the_jerk_is_what_the_lean_can_follow() -> None:
    """AC_PosControl.cpp: 0.5 sqrt(5 m/s2 x 1100 deg/s2 x g) = 15.3 m/s3; at 300 deg/s2 8.0."""
    recommended = {"WP_ACC": 5.0, "PSC_JERK_NE": 20.0}
    for slower, jerk_mps3 in (
        ({}, 15.34),
        ({"PSC_JERK_NE": 100.0}, 15.34),
        ({"PSC_JERK_NE": 5.0}, 5.0),
        ({"ATC_ACC_R_MAX": 300.0}, 8.01),
        ({"ATC_ACC_P_MAX": 300.0}, 8.01),
        ({"ATC_ACC_R_MAX": 0.0, "ATC_ACC_P_MAX": 0.0}, 20.0),
        ({"ATC_RATE_R_MAX": 60.0}, math.radians(60.0) * 9.80665),
        ({"ATC_RATE_P_MAX": 30.0}, math.radians(30.0) * 9.80665),
    ):
        handling = reported(**recommended | slower)
        assert handling.closing.jerk_mps3 == pytest.approx(jerk_mps3, abs=0.01)
        dead_s = 0.35 + 5.0 / (2.0 * jerk_mps3)
        assert handling.answer.dead_s == pytest.approx(dead_s, abs=1e-3)


def test_a_soft_lean_answers_later() -> None:
    """One lag of ATC_INPUT_TC up to 4.7, two in 4.8: the slower of both."""
    dead_s = reported().answer.dead_s
    assert reported(ATC_INPUT_TC=0.3).answer.dead_s - dead_s == pytest.approx(0.3)
    assert reported(ATC_INPUT_TC=0.05).answer.dead_s - dead_s == pytest.approx(-0.1)


def test_it_brakes_no_harder_than_it_leans() -> None:
    steep = {"WP_ACC": 8.0, "PSC_JERK_NE": 20.0}
    most_mps2 = 9.80665 * math.tan(math.radians(30.0))
    assert reported(**steep).answer.decel_mps2 == pytest.approx(most_mps2)
    assert reported(**steep, ATC_ANGLE_MAX=45.0).answer.decel_mps2 == 8.0
    guided_mps2 = 9.80665 * math.tan(math.radians(20.0))
    by_guided = reported(**steep, ATC_ANGLE_MAX=45.0, PSC_ANGLE_MAX=20.0).answer
    assert by_guided.decel_mps2 == pytest.approx(guided_mps2)


def test_what_is_not_known_counts_as_the_worst() -> None:
    """Each limit by itself is worse unknown than as ArduCopter has it, and all of them at most."""
    worst = Handling().answer
    assert worst.decel_mps2 == 0.5
    assert worst.dead_s > 2.0
    assert Handling().lean_max_rad == pytest.approx(math.radians(10.0))
    needs_m = least_slot_m(2.0, reported(WP_ACC=5.0, PSC_JERK_NE=20.0).answer, SHOWN_S)
    for unknown in LIMITS:
        handling = Handling()
        for name, value in (usual_parameters() | {"WP_ACC": 5.0, "PSC_JERK_NE": 20.0}).items():
            if name not in unknown.names:
                handling.receive(name, value)
        assert handling.missing == [next(iter(unknown.names))]
        then_m, worst_m = (least_slot_m(2.0, one, SHOWN_S) for one in (handling.answer, worst))
        assert needs_m < then_m < worst_m < math.inf


def test_each_is_asked_for_under_all_its_names_until_it_is_known() -> None:
    handling = Handling()
    names = {name for limit in LIMITS for name in limit.names}
    assert {"ATC_ANGLE_MAX", "ANGLE_MAX", "ATC_ACC_R_MAX", "ATC_ACCEL_R_MAX"} < names
    assert set(handling.asks(0.0)) == names
    assert handling.asks(ASK_PERIOD_S / 2.0) == []
    assert set(handling.asks(ASK_PERIOD_S)) == names
    handling.receive("WPNAV_ACCEL", 500.0)
    assert not handling.known
    assert set(handling.asks(2.0 * ASK_PERIOD_S)) == names - {"WP_ACC", "WPNAV_ACCEL"}
    handling.receive("PSC_JERK_XY", 20.0)
    assert handling.known
    assert set(handling.asks(3.0 * ASK_PERIOD_S)) >= {"ATC_INPUT_TC", "ATC_RATE_P_MAX"}
    assert reported().asks(0.0) == []


def test_the_wind_leaves_less_to_brake_with() -> None:
    handling = reported(WP_ACC=5.0, PSC_JERK_NE=20.0)
    calm = handling.answer
    handling.wind_leaves_mps2 = 1.26
    assert handling.answer == Answer(calm.dead_s, 1.3)
    assert handling.answer_in_calm == calm
    handling.wind_leaves_mps2 = 5.7
    assert handling.answer == calm


def test_a_vehicle_that_does_not_answer_is_asked_seldom_but_for_ever() -> None:
    """Five answers lost to a noisy radio are no reason never to engage it."""
    handling = Handling()
    asked_s = [second for second in range(60) if handling.asks(float(second))]
    assert asked_s[:OFTEN] == [0, 1, 2, 3, 4]
    assert asked_s[OFTEN:] == list(range(4 + int(SELDOM_S), 60, int(SELDOM_S)))


def test_what_only_a_report_shows_takes_more_room() -> None:
    """At 4 m/s, shown 0.5 s later, the leader is 1.25 m/s slower before the follower knows."""
    answer = Answer(0.5, 5.0)
    by_sonar_m, by_report_m = (least_slot_m(4.0, answer, s) for s in (SHOWN_S, 0.8))
    unaware_s = [noticed_s + 0.5 for noticed_s in (SHOWN_S, 0.8)]
    # a/2 t^2 until it knows, and as much again until both are equally fast: 2.5 of 5 m/s2 are left.
    lost_m = [OTHERS_MPS2 * s * s for s in unaware_s]
    assert by_report_m - by_sonar_m == pytest.approx(lost_m[1] - lost_m[0], abs=0.05)


def test_a_follower_quicker_than_its_leader_loses_the_dead_time_and_the_catching_up() -> None:
    """Of an endless reversal: a/2 t^2 while it does not react, u^2 / 2 (a_F - a_L) until it has."""
    answer = Answer(0.5, 5.0)
    unaware_s = SHOWN_S + answer.dead_s
    closing_mps = OTHERS_MPS2 * unaware_s
    lost_m = closing_mps * unaware_s / 2.0 + closing_mps**2 / (2.0 * (5.0 - OTHERS_MPS2))
    assert least_slot_m(4.0, answer, SHOWN_S) == pytest.approx(LEAST_M + lost_m, abs=0.05)


def test_a_follower_as_slow_as_its_leader_loses_more_the_faster_it_is() -> None:
    """Both turn alike, the follower later: the delay times twice the speed."""
    for speed_mps in (1.0, 2.0, 3.0):
        lost_m = 2.0 * speed_mps * (SHOWN_S + 0.6)
        least_m = least_slot_m(speed_mps, Answer(), SHOWN_S)
        assert least_m == pytest.approx(LEAST_M + lost_m, abs=0.1)


def test_a_leader_on_a_mission_brakes_as_its_parameters_say_and_any_other_harder() -> None:
    """In Guided ArduCopter 4.8 braked with 3.3 to 3.5 m/s2 where 2.5 are set."""
    answer = Answer(0.5, 5.0)
    auto, guided, stabilize = 3, 4, 0
    assert leader_brakes_mps2(auto) == OTHERS_MPS2
    assert leader_brakes_mps2(guided) == leader_brakes_mps2(stabilize) == STEERED_MPS2
    assert leader_brakes_mps2(None) == STEERED_MPS2
    least_m = least_slot_m(2.0, answer, SHOWN_S, brakes_mps2=STEERED_MPS2)
    assert least_m > least_slot_m(2.0, answer, SHOWN_S, brakes_mps2=OTHERS_MPS2) + 0.5


def test_a_leader_that_stands_turns_no_way() -> None:
    assert least_slot_m(0.0, Answer(), SHOWN_S) == LEAST_M
    assert least_slot_m(2.0, Answer(), SHOWN_S, least_m=2.0) == pytest.approx(
        1.0 + least_slot_m(2.0, Answer(), SHOWN_S)
    )
    assert math.isfinite(least_slot_m(20.0, Answer(2.0, 0.5), SHOWN_S))


@pytest.mark.parametrize("stops", [True, False])
def test_the_least_slot_is_what_flying_the_reversal_step_by_step_loses(stops: bool) -> None:
    """Or the stop. In steps of 1 ms: braking harder than the leader, alike, less, and very late."""
    for decel_mps2, noticed_s in ((5.0, 0.3), (4.0, 1.0), (2.5, 0.3), (1.0, 0.3), (8.0, 4.0)):
        for speed_mps in (0.3, 2.0, 8.0):
            leader_mps = follower_mps = speed_mps
            end_mps = 0.0 if stops else -speed_mps
            lost_m = most_m = 0.0
            for step in range(40_000):
                leader_mps = max(end_mps, leader_mps - 2.5e-3)
                if step * 1e-3 > noticed_s + 0.5:
                    follower_mps = max(end_mps, follower_mps - decel_mps2 * 1e-3)
                lost_m += (follower_mps - leader_mps) * 1e-3
                most_m = max(most_m, lost_m)
            answer = Answer(0.5, decel_mps2)
            least_m = least_slot_m(speed_mps, answer, noticed_s, 1.0, 2.5, stops=stops)
            assert least_m == pytest.approx(1.0 + most_m, abs=0.02)


@pytest.mark.parametrize("decel_mps2", [0.0, -1.0, math.nan])
def test_there_is_no_slot_for_one_that_cannot_brake(decel_mps2: float) -> None:
    assert least_slot_m(2.0, Answer(0.5, decel_mps2), SHOWN_S) == math.inf


def test_there_is_no_slot_behind_a_leader_of_which_nothing_is_known() -> None:
    assert least_slot_m(math.nan, Answer(), SHOWN_S) == math.inf
    assert least_slot_m(2.0, Answer(math.inf, 2.5), SHOWN_S) == math.inf
    assert least_slot_m(2.0, Answer(), SHOWN_S, brakes_mps2=math.nan) == math.inf


def test_one_that_hardly_brakes_needs_a_slot_out_of_sight() -> None:
    """Stepping through such a reversal would take for ever."""
    assert least_slot_m(2.0, Answer(0.5, 1e-30), SHOWN_S) > 1e30


def test_a_lean_may_be_shaped_as_good_as_not_at_all() -> None:
    assert reported(ATC_INPUT_TC=1e-30).missing == []


@pytest.mark.parametrize("value", [1e-30, -5.0, 1e30, math.nan, math.inf])
@pytest.mark.parametrize("name", [name for limit in LIMITS for name in limit.names])
def test_a_parameter_that_no_vehicle_has_is_not_known(name: str, value: float) -> None:
    value = -value if name == "ATC_INPUT_TC" else value
    assert not is_plausible(name, value)
    handling = Handling()
    handling.receive(name, value)
    assert name in handling.asks(0.0)
    assert handling.answer == Handling().answer

    known = reported()
    known.receive(name, value)
    assert known.answer == reported().answer


def test_nothing_stands_for_no_limit_only_where_arducopter_takes_it_so() -> None:
    names = {name for limit in LIMITS for name in limit.names if is_plausible(name, 0.0)}
    assert names == {
        *("ATC_RATE_R_MAX", "ATC_RATE_P_MAX", "PSC_ANGLE_MAX", "ATC_INPUT_TC"),
        *("ATC_ACC_R_MAX", "ATC_ACC_P_MAX", "ATC_ACCEL_R_MAX", "ATC_ACCEL_P_MAX"),
    }


def test_of_parameters_that_are_no_limit_any_number_is_plausible() -> None:
    assert is_plausible("ECHO_DIST", -1e9)
    assert not is_plausible("ECHO_DIST", math.nan)
