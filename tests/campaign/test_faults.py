"""Timed faults of a scenario: each does in the flight what it says, for as long as it says."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from echowing.campaign.properties import judge, texts_said
from echowing.campaign.record import FlightRecord, fly_recorded
from echowing.errors import EchowingError
from echowing.flight.guidance import LeaderFix
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.mavlink.messages import position_target
from echowing.sim.faults import _BEGIN
from echowing.sim.scenario import Scenario, scenario_of
from echowing.sim.vehicle.modes import GUIDED, LAND, LOITER, STABILIZE

from ..world import CLEAR

pytestmark = pytest.mark.seconds(40)

HOVERS = {"path": "rectangle", "start_s": 1000.0}


def scenario(*faults: dict[str, object], **changes: object) -> Scenario:
    table = {"title": "t", "duration_s": 24.0, "fault": list(faults), **CLEAR, **changes}
    return scenario_of(table, "test")


@cache
def _flown(text: str) -> FlightRecord:
    return fly_recorded(Scenario.model_validate_json(text), 3)


def flown(*faults: dict[str, object], **changes: object) -> FlightRecord:
    """Each flight is flown once for all the tests that look at it.

    duration_s: where nothing is looked at later, the flight ends there.
    """
    return _flown(scenario(*faults, **changes).model_dump_json(exclude_unset=True))


def said(record: FlightRecord, text: str) -> list[float]:
    """When a text was said, on the ground or by a vehicle."""
    everything = [*record.events, *((t_s, one) for t_s, _, one in record.texts)]
    return sorted(t_s for t_s, one in everything if text in one)


def between(record: FlightRecord, begin_s: float, end_s: float) -> slice:
    return slice(*np.searchsorted(record.time_s, [begin_s, end_s]))


def test_an_outage_of_the_leaders_radio_makes_its_data_stale_and_then_ends() -> None:
    record = flown({"kind": "outage", "vehicle": 1, "at_s": 12.0, "for_s": 4.0})

    # What was on the way when it began still arrives, 0.46 s later.
    assert record.leader_age_s[between(record, 12.0, 12.4)].max() < 1.0
    assert record.leader_age_s[between(record, 15.0, 16.4)].min() > 2.5
    assert record.leader_age_s[between(record, 17.0, 24.0)].max() < 1.0
    assert len(said(record, "leader is stale, holding")) == 1
    assert len(said(record, "leader reports again")) == 1


def test_an_outage_up_to_a_follower_loses_its_points_and_not_its_reports() -> None:
    outage = {"kind": "outage", "vehicle": 2, "at_s": 12.0, "for_s": 4.0, "way": "up"}
    record = flown(outage, duration_s=16.5)

    assert record.stream_age_s[between(record, 15.0, 16.0)].min() > 2.5
    assert said(record, "stream lost, holding here")
    assert not said(record, "no report for")


def test_a_follower_that_is_heard_no_more_gets_no_points_and_that_is_said() -> None:
    record = flown({"kind": "outage", "vehicle": 2, "at_s": 12.0, "for_s": 5.0, "way": "down"})

    assert said(record, "follower 2: no report for 2 s, no points sent")
    assert texts_said(record) == []
    silent = [(t_s, text) for t_s, text in record.events if "no report for" not in text]
    assert "no report for" in texts_said(replace(record, events=silent))[0].text


def test_a_radio_that_loses_all_bytes_up_lets_no_point_through_and_then_all() -> None:
    lost = {"kind": "bytes_lost", "vehicle": 2, "way": "up", "byte_loss": 1.0}
    record = flown({**lost, "at_s": 12.0, "for_s": 4.0})

    assert record.stream_age_s[between(record, 15.0, 15.9)].min() > 2.5
    assert record.stream_age_s[between(record, 17.0, 24.0)].max() < 0.5
    assert said(record, "stream lost, holding here")
    assert not said(record, "no report for")


def test_a_radio_that_loses_some_bytes_loses_frames_and_brings_none_that_is_broken() -> None:
    lost = {"kind": "bytes_lost", "vehicle": 2, "byte_loss": 0.2, "at_s": 8.0}
    record = flown(lost)

    # At 8 points a second a third is lost: some gaps, none for long.
    ages_s = record.stream_age_s[between(record, 10.0, 24.0)]
    assert 0.25 < ages_s.max() < 1.5
    assert not said(record, "error")
    assert record.closest_m > 2.0


def test_a_wire_that_loses_all_bytes_is_a_sonar_without_data_and_then_one_with() -> None:
    lost = {"kind": "bytes_lost", "vehicle": 2, "link": "wire", "way": "up", "byte_loss": 1.0}
    record = flown({**lost, "at_s": 12.0, "for_s": 4.0})

    [at_s] = said(record, "no sonar data")
    assert 12.5 < at_s < 14.0
    assert {"holding the distance", "tracking"} & {
        text.removeprefix("ECHO: ") for t_s, _, text in record.texts if t_s > 16.0
    }


def test_the_leader_has_no_wire() -> None:
    lost = {"kind": "bytes_lost", "vehicle": 1, "byte_loss": 0.1}
    scenario(lost)
    with pytest.raises(EchowingError, match="the leader has no co-processor"):
        scenario({**lost, "link": "wire"})


def test_a_jump_moves_the_estimate_and_goes_back() -> None:
    jump = {"kind": "gps_jump", "vehicle": 2, "jump_ned_m": [0.0, 0.0, 3.0]}
    record = flown({**jump, "at_s": 8.0, "for_s": 4.0}, leader=HOVERS)

    assert record.height_m[between(record, 8.1, 8.2), 1].max() < 7.5
    assert record.height_m[between(record, 20.0, 24.0), 1].min() > 9.0


def test_a_lost_receiver_stops_its_vehicle_and_the_autopilot_lands_it() -> None:
    record = flown({"kind": "gps_lost", "vehicle": 2, "at_s": 8.0}, leader=HOVERS)

    assert said(record, "it has no GPS fix, holding")
    landing = record.mode[:, 1] == LAND
    assert record.time_s[landing][0] == pytest.approx(16.0, abs=0.15)


def test_a_home_on_a_hill_is_so_from_the_start() -> None:
    hill = {"kind": "home_differs", "vehicle": 2, "height_m": 3.0}
    # Else the beam may seem to show another height of its leader.
    exact = {**CLEAR["gps"], "sigma_m": 0.0}
    record = flown(hill, leader=HOVERS, gps=exact)

    assert record.height_m[50:, 1] == pytest.approx(7.0, abs=0.2)
    assert -record.position_ned_m[50:, 1, 2] == pytest.approx(10.0, abs=0.2)


@pytest.mark.parametrize(
    ("fault", "heard"),
    [
        ({"kind": "sonar_dead"}, "nothing"),
        ({"kind": "sonar_stuck"}, "the same"),
        ({"kind": "sonar_wild"}, "anything"),
        ({"kind": "late_echoes", "range_m": 7.0}, "something always"),
    ],
)
def test_what_a_broken_sonar_hears(fault: dict[str, object], heard: str) -> None:
    # Behind a leader that hovers a stuck range leads nobody out of the beam.
    record = flown({**fault, "vehicle": 2, "at_s": 10.0, "for_s": 8.0}, leader=HOVERS)
    ranges_m = record.sonar_m[between(record, 10.2, 18.0), 0]

    if heard == "nothing":
        assert np.isnan(ranges_m).all()
    elif heard == "the same":
        assert len({None if math.isnan(one) else one for one in ranges_m.tolist()}) == 1
    elif heard == "anything":
        # Evenly spread over 0.2 to 7.65 m.
        assert np.nanmin(ranges_m) < 1.5
        assert np.nanmax(ranges_m) > 6.0
    else:
        assert np.isfinite(ranges_m).all()
    # And afterwards it is well: the leader is ranged again, from face to body.
    after = between(record, 18.5, 24.0)
    leader_m, follower_m = (record.position_ned_m[after, vehicle] for vehicle in (0, 1))
    short_m = np.linalg.norm(leader_m - follower_m, axis=1) - record.sonar_m[after, 0]
    assert np.nanmedian(short_m) == pytest.approx(0.2, abs=0.1)


def test_an_unplugged_sonar_and_a_dead_board_are_announced() -> None:
    off = {"vehicle": 2, "at_s": 10.0, "for_s": 6.0}
    unplugged = flown({"kind": "sonar_unplugged", **off}, duration_s=16.5)
    dead = flown({"kind": "coprocessor_off", **off}, duration_s=20.0)

    # ECHO_NODATA_T is 1 s, and the autopilot gives a rangefinder half a second.
    assert 10.5 < said(dead, "no sonar data")[0] < 12.5
    assert said(unplugged, "searching") or said(unplugged, "no sonar data")
    assert np.isfinite(dead.sonar_m[between(dead, 17.0, 20.0), 0]).any()


def test_a_board_that_starts_anew_ranges_again_within_seconds() -> None:
    record = flown({"kind": "coprocessor_reset", "vehicle": 2, "at_s": 10.0}, duration_s=15.0)

    assert np.isfinite(record.sonar_m[between(record, 12.0, 15.0), 0]).any()


def test_a_jammed_gimbal_loses_a_leader_in_a_corner_sooner_than_a_free_one() -> None:
    from echowing.sim.world.sonar import Gimbal  # noqa: PLC0415

    gimbal = Gimbal()
    gimbal.jammed = True
    gimbal.step(1.0, 1800.0, 1400.0)
    assert gimbal.pan_deg == 0.0
    gimbal.jammed = False
    gimbal.step(1.0, 1800.0, 1400.0)
    assert gimbal.pan_deg == pytest.approx(41.5)  # half the servo's play short


def test_a_narrow_beam_hears_less_often() -> None:
    """A tenth less: the gimbal looks at its leader, and loses it at a corner."""
    usual = flown()
    narrow = flown({"kind": "narrow_beam", "vehicle": 2, "half_angle_deg": 8.0})

    assert np.isfinite(narrow.sonar_m).mean() < 0.95 * np.isfinite(usual.sonar_m).mean()


def test_a_killed_applet_is_gone_until_it_is_started_again() -> None:
    record = flown({"kind": "script_killed", "vehicle": 2, "at_s": 10.0, "for_s": 5.0})

    assert not record.applet[between(record, 10.1, 14.9), 0].any()
    assert record.applet[between(record, 15.1, 24.0), 0].all()
    assert said(record, "restarted, WP_SPD back to 5.00")


def test_a_pilot_takes_over_and_comes_back() -> None:
    record = flown({"kind": "pilot_takes_over", "vehicle": 2, "at_s": 10.0, "for_s": 5.0})

    assert (record.mode[between(record, 10.1, 14.9), 1] == LOITER).all()
    assert (record.mode[between(record, 15.1, 24.0), 1] == GUIDED).all()
    assert said(record, "left Guided for LOITER, pilot has control")


def test_a_stop_switch_stops_and_its_pilot_engages_again() -> None:
    record = flown({"kind": "stop_switch", "vehicle": 2, "at_s": 8.0, "for_s": 3.0})

    assert said(record, "stop switch, holding")
    assert record.switched[between(record, 9.0, 15.0), 0].all()
    assert (record.mode[between(record, 15.0, 20.0), 1] == LOITER).any()
    assert not record.switched[between(record, 20.0, 24.0), 0].any()


def test_a_switch_that_is_off_before_guided_is_reported_stops_nobody() -> None:
    """Its pilot flies, engages and only then puts the switch off: by radio both come at once."""
    record = flown(
        {"kind": "pilot_takes_over", "vehicle": 2, "at_s": 8.0, "for_s": 5.0},
        {"kind": "stop_switch", "vehicle": 2, "at_s": 10.0, "for_s": 3.04},
    )

    assert record.switched[between(record, 11.0, 13.0), 0].all()
    assert not record.switched[between(record, 15.0, 17.0), 0].any()
    assert judge(record) == []


def test_a_tool_that_is_ended_stops_its_follower_and_then_itself() -> None:
    record = flown({"kind": "tool_stopped", "at_s": 10.0})

    assert said(record, "the tool ends, holding")
    assert not record.tool[between(record, 21.0, 24.0)].any()
    assert not [point for point in record.points if point.time_s > 21.0]


def test_a_killed_tool_says_and_sends_nothing_until_it_is_started_again() -> None:
    record = flown({"kind": "tool_killed", "at_s": 10.0, "for_s": 5.0}, duration_s=18.0)

    assert not [point for point in record.points if 10.1 < point.time_s < 15.0]
    assert [point for point in record.points if point.time_s > 17.0]
    assert not [t_s for t_s, _ in record.events if 10.1 < t_s < 15.0]
    assert said(record, "stream lost, holding here")


def test_what_a_leader_does_instead_of_its_path() -> None:
    """A leader northwards at 2 m/s; it brakes and speeds up within some seconds."""

    def north_mps(kind: str, **values: float) -> float:
        record = flown({"kind": kind, "at_s": 10.0, "for_s": 5.0, **values}, duration_s=15.0)
        return float(record.velocity_ned_mps[between(record, 14.0, 15.0), 0, 0].mean())

    assert north_mps("leader_reverses", speed_mps=1.5) == pytest.approx(-1.5, abs=0.2)
    assert north_mps("leader_stops") == pytest.approx(0.0, abs=0.2)
    climbs = flown({"kind": "leader_climbs", "at_s": 10.0, "for_s": 5.0, "climb_mps": 1.0})
    assert climbs.velocity_ned_mps[between(climbs, 13.0, 15.0), 0, 2].mean() < -0.7
    # And then goes on with its mission.
    assert (climbs.velocity_ned_mps[between(climbs, 20.0, 24.0), 0, 0] > 1.0).all()


def test_an_attack_leads_at_where_the_follower_was() -> None:
    record = flown(
        {"kind": "leader_attacks", "at_s": 8.0, "for_s": 4.0, "speed_mps": 1.0},
        leader=HOVERS,
        duration_s=12.0,
    )
    to_it = record.position_ned_m[79, 1] - record.position_ned_m[79, 0]
    flown_mps = record.velocity_ned_mps[between(record, 11.0, 12.0), 0].mean(axis=0)

    assert flown_mps @ to_it / np.linalg.norm(to_it) == pytest.approx(1.0, abs=0.2)


def test_followers_that_cross_start_behind_each_others_slots() -> None:
    slots = [
        {"radius_m": 5.0, "angle_deg": 45.0, "starts_at": 2},
        {"radius_m": 5.0, "angle_deg": -45.0, "starts_at": 1},
    ]
    record = flown(formation={"slots": slots}, leader=HOVERS, duration_s=0.2)

    # Counter-clockwise off the tail is to the east of a leader that looks north.
    assert record.position_ned_m[0, 1, 1] * record.position_ned_m[0, 2, 1] < 0.0
    own_side = flown(
        formation={"slots": [{k: v for k, v in one.items() if k != "starts_at"} for one in slots]},
        leader=HOVERS,
        duration_s=0.2,
    )
    assert own_side.position_ned_m[0, 1] == pytest.approx(record.position_ned_m[0, 2], abs=0.2)


def test_a_heavier_airframe_answers_otherwise() -> None:
    usual, heavy = flown(), flown(airframe={"mass": 2.0, "lag": 1.5})

    assert not np.allclose(usual.position_ned_m[:, 1], heavy.position_ned_m[:, 1], atol=0.05)


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        ([{"kind": "sonar_dead"}], r"fault\.0: sonar_dead needs `vehicle`"),
        ([{"kind": "sonar_dead", "vehicle": 1}], "sonar_dead is a follower's"),
        ([{"kind": "tool_killed", "vehicle": 2}], "tool_killed is not a follower's"),
        ([{"kind": "sonar_dead", "vehicle": 3}], "fault 1: no vehicle 3; the last is 2"),
        ([{"kind": "sonar_dead", "vehicle": 2, "range_m": 3.0}], "sonar_dead takes no range_m"),
        ([{"kind": "gps_jump", "vehicle": 2}], "gps_jump needs `jump_ned_m`"),
        ([{"kind": "tool_stopped", "for_s": 3.0}], "tool_stopped is over at once"),
        ([{"kind": "home_differs", "vehicle": 2, "height_m": 1.0, "at_s": 3.0}], "from the start"),
        ([{"kind": "tool_killed", "at_s": 99.0}], r"at_s \(99\) is after the flight's end"),
        ([{"kind": "leader_stops"}, {"kind": "leader_stops", "at_s": 5.0}], "twice at a time"),
        ([{"kind": "sonar_deaf", "vehicle": 2}], r"fault\.0\.kind: .*'sonar_dead'"),
        (
            [{"kind": "outage", "vehicle": 2, "hours": 1}],
            r"hours: no such key; allowed here:.*at_s",
        ),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(faults: list[dict[str, object]], says: str) -> None:
    with pytest.raises(EchowingError, match=says):
        scenario(*faults)


def test_a_leader_that_is_carried_does_nothing_else() -> None:
    with pytest.raises(EchowingError, match="a leader on a walk does nothing else"):
        scenario({"kind": "leader_stops"}, leader={"path": "walk"})


def test_two_followers_cannot_start_at_one_slot() -> None:
    slots = [{"radius_m": 3.0}, {"radius_m": 6.0, "starts_at": 1}]
    with pytest.raises(EchowingError, match="two followers would start at one slot"):
        scenario(formation={"slots": slots})


def test_a_flight_without_faults_is_what_it_was() -> None:
    """The chance of a fault is its own: one that comes late changes nothing before it."""
    usual = flown()
    late = flown({"kind": "sonar_wild", "vehicle": 2, "at_s": 20.0})

    until = between(usual, 0.0, 19.9)
    assert np.array_equal(usual.position_ned_m[until], late.position_ned_m[until])
    assert not np.array_equal(usual.position_ned_m, late.position_ned_m)


def test_a_rebooted_autopilot_is_led_again_only_once_its_pilot_has_it_in_the_air() -> None:
    record = flown(
        {"kind": "autopilot_rebooted", "vehicle": 2, "at_s": 8.0, "for_s": 20.0},
        duration_s=38.0,
        leader={**HOVERS, "altitude_m": 4.0},
    )

    landed = between(record, 20.0, 28.0)
    assert not record.flying[landed, 1].any()
    assert set(record.mode[landed, 1].tolist()) == {STABILIZE}
    # The applet starts anew with the autopilot, and finds the pilot's speed.
    assert len(said(record, "ECHO: ready")) == 2
    assert record.speed_mps[between(record, 20.0, 28.0), 0] == pytest.approx(5.0)
    assert record.stream_age_s[landed, 0].min() > 8.0
    assert said(record, "too low to be led, until it is 2 m up")
    assert record.stream_age_s[between(record, 36.0, 38.0), 0].max() < 1.0
    assert judge(record) == []


def test_a_stuck_sonar_is_told_of_until_it_moves_again() -> None:
    record = flown({"kind": "sonar_stuck", "vehicle": 2, "at_s": 8.0, "for_s": 8.0})

    # It sticks on a range, not on nothing. 30 readings at 10 Hz, and their way.
    assert record.sonar_m[between(record, 9.0, 15.0), 0].max() < 4.5
    (stuck_s,) = said(record, "follower 2: sonar is stuck, not believed")
    assert 10.9 < stuck_s < 11.8
    (moves_s,) = said(record, "follower 2: sonar is believed again")
    assert 16.0 < moves_s < 16.5


def test_a_sonar_that_hears_anything_is_told_of_until_its_readings_agree() -> None:
    record = flown({"kind": "sonar_wild", "vehicle": 2, "at_s": 8.0, "for_s": 8.0})

    # Two readings in five are odd, so the sixth comes after 1.5 s, and six leave the last 3 s.
    told_s = said(record, "follower 2: sonar hears anything, not believed")
    assert 8.5 < told_s[0] < 11.0
    again_s = said(record, "follower 2: sonar is believed again")
    assert 16.0 < again_s[-1] < 19.5
    assert len(told_s) == len(again_s) <= 2
    assert judge(record) == []


@pytest.mark.parametrize(("velocity_mps", "turned"), [((2.0, 0.3), True), ((0.3, -2.0), False)])
def test_the_thesis_frame_fault_puts_points_abeam_on_north_and_south_courses(
    velocity_mps: tuple[float, float], turned: bool
) -> None:
    leader = GlobalPosition(47.0, 8.0, 460.0)
    fix = LeaderFix(0.0, leader, (*velocity_mps, 0.0), 0.0)
    ground = SimpleNamespace(session=SimpleNamespace(leader=SimpleNamespace(fix=fix)))
    sent = position_target(2, displace(leader, (-3.0, 0.0, 0.0)), 10.0, None, 0.0)

    with _BEGIN["north_south_offset"](SimpleNamespace(ground=ground), None):  # type: ignore[arg-type]
        point = ground.distort(sent)

    north_m, east_m, _ = ned_between(
        leader, GlobalPosition(point.lat_int / 1e7, point.lon_int / 1e7, 460.0)
    )
    expected_m = (0.0, -3.0) if turned else (-3.0, 0.0)
    assert (north_m, east_m) == pytest.approx(expected_m, abs=0.02)
