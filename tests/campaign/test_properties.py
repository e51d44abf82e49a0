"""Each property on a record made up for it: what it lets pass, and what it does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from echowing.campaign.properties import (
    BLOWN,
    MISLED,
    Broken,
    judge,
    mean_error,
    not_too_low,
    pilots_word,
    retreat_bound_m,
    separation,
    speed_handed_back,
    stopped,
    texts_said,
)
from echowing.campaign.record import FlightRecord, Point, fly_recorded
from echowing.sim.fault_section import FaultSection
from echowing.sim.scenario import Scenario, scenario_of
from echowing.sim.vehicle.modes import GUIDED, LOITER

from ..world import CLEAR

STEP_S = 0.1


@cache
def quiet() -> FlightRecord:
    """A flight behind a leader that stands, with two followers: nothing is wrong in it."""
    table = {
        "title": "t",
        "duration_s": 20.0,
        "leader": {"path": "rectangle", "start_s": 1000.0},
        "formation": {"slots": [{"radius_m": 3.0}, {"radius_m": 9.0}]},
        "gps": {"sigma_m": 0.2},
    }
    return fly_recorded(scenario_of(table, "test"), 1)


def with_least(record: FlightRecord, pair: int, sample: int, least_m: float) -> FlightRecord:
    changed = record.least_m.copy()
    changed[sample, pair] = least_m
    return replace(record, least_m=changed)


def approached(
    leader_mps: float, follower_mps: float, apart_m: float, *, age_s: float = 0.5
) -> FlightRecord:
    """From 10 s on the leader flies south at its follower, which flies south or stands."""
    record = quiet()
    place, velocity = record.position_ned_m.copy(), record.velocity_ned_mps.copy()
    place[:, 0] = (0.0, 0.0, -10.0)
    place[:, 1] = (-apart_m, 0.0, -10.0)
    velocity[:] = 0.0
    for sample in range(100, len(record.time_s)):
        velocity[sample, 0] = (-leader_mps, 0.0, 0.0)
        velocity[sample, 1] = (-follower_mps, 0.0, 0.0)
        place[sample, :2] = place[sample - 1, :2] + STEP_S * velocity[sample, :2]
    least_m = record.least_m.copy()
    least_m[:, 0] = np.linalg.norm(place[:, 1] - place[:, 0], axis=1)
    return replace(
        record,
        position_ned_m=place,
        velocity_ned_mps=velocity,
        least_m=least_m,
        leader_age_s=np.full(len(record.time_s), age_s),
        sonar_m=np.full_like(record.sonar_m, np.nan),
    )


def test_a_quiet_flight_holds_all() -> None:
    assert judge(quiet()) == []


def test_two_followers_within_a_metre_are_found_and_those_beyond_are_not() -> None:
    (found,) = separation(with_least(quiet(), 2, 50, 0.99))

    assert (found.vehicle, found.value) == (3, 0.99)
    assert found.time_s == pytest.approx(5.1)
    assert separation(with_least(quiet(), 2, 50, 1.0)) == []


def test_a_leader_that_stands_is_no_excuse() -> None:
    assert separation(with_least(quiet(), 0, 50, 0.5))[0].text.endswith("0.50 m of the leader")


def test_a_leader_that_is_too_fast_to_flee_from_is_an_excuse_and_a_slow_one_is_not() -> None:
    # 8 m/s from 4 m: gone through in half a second, before any report of it has come.
    assert separation(approached(8.0, 0.0, 4.0)) == []
    # 1 m/s from 4 m: 3 s of time, and 2.5 m/s2 to flee with. Who stands is at fault.
    assert separation(approached(1.0, 0.0, 4.0))


def test_the_retreat_begins_when_the_approach_can_be_known_of() -> None:
    def bound_m(age_s: float) -> float:
        return retreat_bound_m(approached(2.0, 0.0, 4.0, age_s=age_s), 119, 1)

    # Closing at 2 m/s until known (age) and answered (0.6 s), then 0.8 s more to be as fast.
    assert bound_m(0.1) == pytest.approx(4.0 - 2.0 * 0.7 - 0.8, abs=0.3)
    assert bound_m(0.6) == pytest.approx(bound_m(0.1) - 2.0 * 0.5, abs=0.25)


def test_before_an_approach_is_known_of_its_follower_drifts_and_does_not_retreat() -> None:
    """A leader comes from 16 m at 2 m/s, unseen; 0.1 m/s of drift at the start is no way out."""
    record = approached(2.0, 0.0, 16.0)
    unseen = replace(record, leader_age_s=np.full(len(record.time_s), 60.0))
    unseen.velocity_ned_mps[100, 1] = (-0.1, 0.0, 0.0)
    assert retreat_bound_m(unseen, 177, 1) == pytest.approx(16.0 - 2.0 * 7.8, abs=0.25)
    assert separation(unseen) == []
    assert separation(record)


def test_an_approach_from_too_fast_a_chase_is_no_excuse() -> None:
    """A follower that closes at 4 m/s from 3 m was wrong before its leader turned round."""
    record = approached(1.0, -4.0, 4.5)
    assert record.least_m[:, 0].min() < 1.0
    assert separation(record)


def test_a_leader_that_is_run_through_does_not_fly_at_its_follower() -> None:
    """Once the follower has passed, the leader that flies on comes nearer to it: no excuse."""
    # Nearest, 0.05 m, just after it has passed.
    assert separation(approached(-1.0, -2.5, 2.95))


def test_in_wind_that_takes_all_lean_it_is_counted_apart() -> None:
    record = with_least(quiet(), 0, 50, 0.5)
    windy = record.scenario.model_copy(
        update={"wind": record.scenario.wind.model_copy(update={"speed_mps": 6.0})}
    )
    lean = np.full_like(record.lean_rad, np.radians(29.0))

    assert separation(replace(record, scenario=windy))[0].name == "separation"
    assert separation(replace(record, scenario=windy, lean_rad=lean))[0].name == BLOWN
    assert separation(replace(record, lean_rad=lean))[0].name == "separation"
    retreats = np.full_like(lean, np.radians(10.0))
    retreats[30:50] = lean[30:50]
    assert separation(replace(record, scenario=windy, lean_rad=retreats))[0].name == "separation"
    took_off = np.where(np.arange(len(lean))[:, np.newaxis] < 30, 0.0, lean)
    height_m = np.where(took_off > 0.0, 10.0, 0.0)
    just_up = replace(record, scenario=windy, lean_rad=took_off, height_m=height_m)
    assert separation(just_up)[0].name == BLOWN


def test_receivers_that_disagree_by_more_than_is_allowed_for_are_counted_apart() -> None:
    """2.8 m, 2.5 standard deviations of two: shown 4 m apart two may be 1.2 m apart, not 0.9 m."""
    record = with_least(quiet(), 2, 50, 0.9)
    place, error = record.position_ned_m.copy(), np.zeros_like(record.receiver_error_m)
    place[:, 1], place[:, 2] = (-5.0, 0.0, -10.0), (-5.9, 0.0, -10.0)
    place[:, 0] = (0.0, 0.0, -10.0)
    record = replace(record, position_ned_m=place, receiver_error_m=error)
    assert separation(record)[0].name == "separation"

    error[:, 1, 0], error[:, 2, 0] = 1.4, -1.4
    assert separation(record)[0].name == "separation"
    error[:, 2, 0] = -1.5
    assert separation(record)[0].name == MISLED
    jump = FaultSection(kind="gps_jump", vehicle=3, at_s=4.0, jump_ned_m=(-3.0, 0.0, 0.0))
    jumped = record.scenario.model_copy(update={"fault": (jump,)})
    assert separation(replace(record, scenario=jumped))[0].name == "separation"
    later = record.scenario.model_copy(update={"fault": (jump.model_copy(update={"at_s": 9.0}),)})
    assert separation(replace(record, scenario=later))[0].name == MISLED
    # Without the tool nobody sees the jump: the autopilot flies it.
    alone = np.zeros_like(record.tool)
    assert separation(replace(record, scenario=jumped, tool=alone))[0].name == MISLED


def test_nor_are_receivers_an_excuse_where_the_sonar_ranges_the_leader() -> None:
    record = with_least(quiet(), 0, 50, 0.9)
    place, error = record.position_ned_m.copy(), np.zeros_like(record.receiver_error_m)
    place[:, 0], place[:, 1] = (0.0, 0.0, -10.0), (-0.9, 0.0, -10.0)
    place[:, 2] = (-30.0, 0.0, -10.0)
    error[:, 0, 0] = 3.5
    deaf = replace(
        record,
        position_ned_m=place,
        velocity_ned_mps=np.zeros_like(record.velocity_ned_mps),
        receiver_error_m=error,
        sonar_m=np.full_like(record.sonar_m, np.nan),
    )
    assert separation(deaf)[0].name == MISLED
    heard = deaf.sonar_m.copy()
    heard[40, 0] = 0.7
    assert separation(replace(deaf, sonar_m=heard))[0].name == "separation"


def test_what_pilots_fly_is_theirs_to_keep_apart_until_the_tool_leads_again() -> None:
    taken = with_pilot(quiet(), 80, 140, followers=(1,))
    leaders, others = quiet().pairs.index((0, 1)), quiet().pairs.index((1, 2))

    assert separation(with_least(taken, leaders, 100, 0.5)) == []
    # The other follower is led, and has to keep away from one that its pilot flies.
    assert separation(with_least(taken, others, 100, 0.5))
    both = with_pilot(quiet(), 80, 140, followers=(1, 2))
    assert separation(with_least(both, others, 100, 0.5)) == []

    # Back in Guided at 0.8 m: it may take its time to part, and is not to come nearer.
    back = taken.least_m.copy()
    back[130:160, leaders] = 0.8
    parting = replace(taken, least_m=back)
    assert separation(parting) == []
    assert separation(with_least(parting, leaders, 155, 0.7))[0].value == pytest.approx(0.7)
    # Once apart, the whole is promised again.
    assert separation(with_least(parting, leaders, 180, 0.9))


def with_pilot(
    record: FlightRecord, begin: int, end: int, *, followers: tuple[int, ...]
) -> FlightRecord:
    """Pilots fly these followers (vehicles' indices) in Loiter from one sample to another."""
    mode = record.mode.copy()
    mode[begin:end, followers] = LOITER
    return replace(record, mode=mode)


def test_a_retreat_begins_once_it_is_led() -> None:
    """The same approach, with its pilot flying it until shortly before they meet."""
    record = approached(2.0, 0.0, 4.0)
    meets = 100 + round(4.0 / 2.0 / STEP_S)
    led = retreat_bound_m(record, meets, 1)
    flown = retreat_bound_m(with_pilot(record, 90, meets - 2, followers=(1,)), meets, 1)

    assert flown < led - 0.5


def moving(record: FlightRecord, begin: int, mps: float, *, away: bool = False) -> FlightRecord:
    """The first follower moves towards its leader, north of it, or away."""
    velocity = record.velocity_ned_mps.copy()
    velocity[begin:, 1] = (-mps if away else mps, 0.0, 0.0)
    return replace(record, velocity_ned_mps=velocity)


def stale(record: FlightRecord, begin: int) -> FlightRecord:
    age_s = record.leader_age_s.copy()
    age_s[begin:] = 1.1 + STEP_S * np.arange(len(age_s) - begin)
    return replace(record, leader_age_s=age_s)


def test_who_moves_on_stale_data_is_found_two_seconds_later() -> None:
    (found,) = stopped(moving(stale(quiet(), 100), 100, 1.0))

    assert found.vehicle == 2
    # From 1.0 s of age on, 2 s to stop, and half a second that is no gust.
    assert found.time_s == pytest.approx(10.1 + 2.0 + 0.5, abs=0.25)
    assert stopped(moving(quiet(), 100, 1.0)) == []
    assert stopped(stale(quiet(), 100)) == []


def test_from_more_than_4_mps_a_stop_takes_as_long_as_its_braking() -> None:
    """6 m/s at 2.5 m/s2, and 0.35 s until it leans."""
    (found,) = stopped(moving(stale(quiet(), 100), 100, 6.0))

    assert found.time_s == pytest.approx(10.1 + 0.35 + 6.0 / 2.5 + 0.5, abs=0.25)


def test_who_makes_room_may_move() -> None:
    assert stopped(moving(stale(quiet(), 100), 100, 1.0, away=True)) == []


def test_who_has_made_room_is_given_the_time_to_stop_again() -> None:
    """Away from its leader for 4 s, at the end 7 m off and still fast; then braking, or not."""
    record = stale(quiet(), 60)
    place, velocity = record.position_ned_m.copy(), record.velocity_ned_mps.copy()
    place[:, 0], velocity[:] = (0.0, 0.0, -10.0), 0.0
    place[:, 1] = (-3.0, 0.0, -10.0)
    place[:, 2] = (-30.0, 0.0, -10.0)
    velocity[100:105, 1] = (-2.0, 0.0, 0.0)
    place[105:, 1] = (-4.0, 0.0, -10.0)  # beyond its slot
    velocity[105:117, 1] = (-2.0, 0.0, 0.0)
    braked = replace(record, position_ned_m=place, velocity_ned_mps=velocity)
    assert stopped(braked) == []

    velocity = velocity.copy()
    velocity[105:140, 1] = (-2.0, 0.0, 0.0)
    assert stopped(replace(braked, velocity_ned_mps=velocity))


def test_a_lost_stream_and_a_switch_stop_too() -> None:
    record = quiet()
    age_s = record.stream_age_s.copy()
    age_s[100:, 0] = 5.0
    on = record.switched.copy()
    on[100:, 0] = True

    assert stopped(moving(replace(record, stream_age_s=age_s), 100, 1.0))
    assert stopped(moving(replace(record, switched=on), 100, 1.0))
    # In the pilot's hands he flies as he likes.
    mode = record.mode.copy()
    mode[100:, 1] = LOITER
    assert stopped(moving(replace(record, switched=on, mode=mode), 100, 1.0)) == []


@pytest.mark.parametrize("why", ["silent", "switched"])
def test_one_that_holds_alone_goes_along_with_its_own_receiver(why: str) -> None:
    record = quiet()
    age_s, on = record.stream_age_s.copy(), record.switched.copy()
    if why == "silent":
        age_s[60:, 0] = 5.0
    else:
        on[60:, 0] = True
    silent = replace(record, stream_age_s=age_s, switched=on)
    flown = moving(moving(silent, 60, 0.0), 150, 1.0)
    assert stopped(flown)

    jump = {"kind": "gps_jump", "at_s": 14.5, "jump_ned_m": (5.0, 0.0, 0.0)}
    own = scenario_of({"title": "t", "fault": [{**jump, "vehicle": 2}]}, "test")
    others = scenario_of({"title": "t", "fault": [{**jump, "vehicle": 1}]}, "test")
    earlier = scenario_of({"title": "t", "fault": [{**jump, "vehicle": 2, "at_s": 3.0}]}, "test")

    def with_faults(of: Scenario) -> FlightRecord:
        return replace(flown, scenario=record.scenario.model_copy(update={"fault": of.fault}))

    assert stopped(with_faults(own)) == []
    assert stopped(with_faults(others))
    assert stopped(with_faults(earlier))


def test_one_that_the_tool_holds_is_given_time_after_a_jump_of_its_own_receiver() -> None:
    """2 s until the tool is sure of it, and 2 s to stop again."""
    record = stale(quiet(), 60)
    velocity = record.velocity_ned_mps.copy()
    velocity[60:, 1] = (0.0, 0.0, 0.0)
    velocity[150:185, 1] = (1.0, 0.0, 0.0)
    flown = replace(record, velocity_ned_mps=velocity)
    assert stopped(flown)

    jump = {"kind": "gps_jump", "vehicle": 2, "at_s": 14.5, "jump_ned_m": (5.0, 0.0, 0.0)}
    fault = scenario_of({"title": "t", "fault": [jump]}, "test").fault
    jumped = record.scenario.model_copy(update={"fault": fault})
    assert stopped(replace(flown, scenario=jumped)) == []
    velocity = velocity.copy()
    velocity[150:, 1] = (1.0, 0.0, 0.0)
    assert stopped(replace(flown, velocity_ned_mps=velocity, scenario=jumped))


def test_a_point_to_a_vehicle_that_said_it_is_the_pilots() -> None:
    right = Point(5.0, 2, GUIDED, True)
    assert pilots_word(replace(quiet(), points=[right])) == []

    wrong = pilots_word(replace(quiet(), points=[right, Point(6.0, 2, LOITER, True)]))
    assert [(one.time_s, one.vehicle) for one in wrong] == [(6.0, 2)]
    landed = pilots_word(replace(quiet(), points=[Point(6.0, 2, GUIDED, False)]))
    assert "on the ground" in landed[0].text
    assert pilots_word(replace(quiet(), points=[Point(1.0, 2, None, False)]))


def test_the_speed_is_the_pilots_soon_after_every_end() -> None:
    record = quiet()
    mode, speed = record.mode.copy(), record.speed_mps.copy()
    mode[100:, 1] = LOITER
    speed[:100, 0] = 2.5
    speed[100:, 0] = 5.0
    ended = replace(record, mode=mode, speed_mps=speed)
    assert speed_handed_back(ended) == []

    speed = speed.copy()
    speed[100:, 0] = 2.5
    kept = replace(ended, speed_mps=speed)
    assert speed_handed_back(kept)[0].vehicle == 2
    # Without an applet nobody can.
    applet = record.applet.copy()
    applet[100:, 0] = False
    assert speed_handed_back(replace(kept, applet=applet)) == []


def test_nobody_is_led_below_two_metres_unless_asked_to() -> None:
    record = quiet()
    height = record.height_m.copy()
    height[100:, 1] = 1.5
    low = replace(record, height_m=height)
    assert not_too_low(low)[0].value == 1.5

    asked = record.scenario.leader.model_copy(update={"altitude_m": 1.5})
    wished = record.scenario.model_copy(update={"leader": asked})
    assert not_too_low(replace(low, scenario=wished)) == []


def test_a_promised_text_that_is_missing_is_found() -> None:
    table = {
        "title": "t",
        "duration_s": 24.0,
        "fault": [{"kind": "outage", "vehicle": 1, "at_s": 12.0, "for_s": 8.0}],
    }
    record = fly_recorded(scenario_of(table, "test"), 3)
    assert texts_said(record) == []

    mute = replace(record, events=[one for one in record.events if "stale" not in one[1]])
    (found,) = texts_said(mute)
    assert "leader is stale" in found.text
    # A follower that is its pilot's is told nothing of it.
    mode = np.full_like(record.mode, LOITER)
    assert texts_said(replace(mute, mode=mode)) == []


def test_the_mean_error_counts_where_nothing_is_wrong() -> None:
    table = {"title": "t", "duration_s": 40.0, **CLEAR}  # JUDGED_S, and before it the approach
    record = fly_recorded(scenario_of(table, "test"), 3)
    assert mean_error(record) == []

    off = replace(record.flights[0], wanted_separation_m=4.0)
    assert mean_error(replace(record, flights=[off]))[0].name == "mean error"
    windy = record.scenario.model_copy(
        update={"wind": record.scenario.wind.model_copy(update={"speed_mps": 1.0})}
    )
    assert mean_error(replace(record, flights=[off], scenario=windy)) == []
    for section, key, value in (
        ("sonar", "heard_share", 0.4),
        ("sonar", "beam_near_deg", 12.0),
        ("sonar", "noise_m", 0.05),
        ("sonar", "deaf_share", 0.3),
        ("sonar", "late_share", 0.04),
        ("sonar", "inset_m", 0.35),
        ("sonar", "inset_m", 0.1),
        ("follower", "parameters", {"EK3_SRC1_POSZ": 3.0}),
        ("gps", "sigma_m", 1.5),
        ("gps", "vertical_sigma_m", 1.0),
        ("gps", "step_m", 2.0),
    ):
        worse = scenario_of({**table, section: {**CLEAR.get(section, {}), key: value}}, "test")
        assert mean_error(replace(record, flights=[off], scenario=worse)) == [], key
    # Of a flight that was only begun nothing is said.
    begun = replace(record, flights=[off], time_s=record.time_s[:200])
    assert mean_error(begun) == []


def test_what_is_broken_says_where_and_by_how_much() -> None:
    (found,) = judge(with_least(quiet(), 2, 50, 0.4))
    assert found == Broken(
        "separation", found.time_s, 3, 0.4, "follower 3 came to 0.40 m of follower 2"
    )
