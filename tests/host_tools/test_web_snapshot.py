"""What the page shows of a moment, and what it calls wrong."""

import json
import math
from typing import Any

import pytest

from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.health import Cut, Health
from echowing.tool.moment import Moment, apart_by_plan
from echowing.tool.panel import VehicleHealth
from echowing.web.alarms import Level, alarms, headline
from echowing.web.options import PageAddress
from echowing.web.snapshot import ellipse, glance, snapshot

from .flights import FOLLOWER, HERE, LEADER, STRAIGHT_US, moment, row, track


def test_places_are_metres_about_the_origin() -> None:
    frame = snapshot(moment(12.5), HERE)
    assert frame["t"] == 12.5
    (follower,) = frame["followers"]
    assert frame["leader"]["at"] == pytest.approx([0.0, 0.0], abs=0.002)
    assert follower["at"] == pytest.approx([-3.0, 0.0], abs=0.002)
    assert follower["slot"] == pytest.approx([-3.0, 0.0], abs=0.002)


def test_a_follower_is_carried_on_over_the_age_of_its_report() -> None:
    """As the leader is: else a fast formation is drawn too long."""
    frame = snapshot(moment(age_s=0.5), HERE)
    assert frame["followers"][0]["at"] == pytest.approx([-3.0 + 0.5 * 2.0, 0.0], abs=0.002)


def test_the_sonar_looks_where_the_gimbal_points() -> None:
    turned = Moment(0.0, [row()], [track(heading_deg=350.0, pan_us=STRAIGHT_US + 200.0)])
    assert snapshot(turned, HERE)["followers"][0]["sonar"]["bearing"] == pytest.approx(10.0)
    unknown = Moment(0.0, [row()], [track(pan_us=None)])
    assert snapshot(unknown, HERE)["followers"][0]["sonar"]["bearing"] is None


def test_the_ellipse_is_where_the_follower_takes_the_leader_to_be() -> None:
    seen = snapshot(moment(), HERE)["followers"][0]["seen"]
    assert seen["at"] == pytest.approx([0.5, -0.25], abs=0.002)
    # Standard deviations 0.2 m north and 0.4 m east.
    assert (seen["major"], seen["minor"]) == pytest.approx((SURE_SIGMAS * 0.4, SURE_SIGMAS * 0.2))
    assert seen["bearing"] == pytest.approx(90.0)


def test_an_oblique_ellipse() -> None:
    # 0.5 m along 30 deg, 0.1 m across.
    cos, sin = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    nn = 0.25 * cos * cos + 0.01 * sin * sin
    ee = 0.25 * sin * sin + 0.01 * cos * cos
    ne = (0.25 - 0.01) * sin * cos
    major, minor, bearing = ellipse(nn, ne, ee)
    assert (major, minor) == pytest.approx((SURE_SIGMAS * 0.5, SURE_SIGMAS * 0.1))
    assert bearing == pytest.approx(30.0)


def test_what_is_not_known_is_null_and_everything_is_json() -> None:
    bare: dict[str, Any] = dict.fromkeys(
        ("separation_m", "error_m", "sonar_m", "gimbal", "command_mps", "age_s")
    )
    nowhere: dict[str, Any] = dict.fromkeys(
        ("leader_lat_deg", "leader_lon_deg", "leader_alt_m", "lat_deg", "lon_deg", "alt_m")
    )
    unheard = Moment(
        0.0, [row(**bare, own=VehicleHealth(), leader_age_s=math.inf)], [track(**nowhere)]
    )
    frame = json.loads(json.dumps(snapshot(unheard, HERE), allow_nan=False))
    assert frame["leader"]["at"] is None
    assert frame["followers"][0]["at"] is None
    assert frame["followers"][0]["error"] is None
    assert frame["followers"][0]["height"] is None
    assert frame["leader"]["age"] is None


def test_a_glance_is_enough_for_tracks_and_plots() -> None:
    small = glance(snapshot(moment(7.0), HERE))
    assert small["t"] == 7.0
    ((system_id, at, height, separation, sonar, wanted),) = small["followers"]
    assert (system_id, height, separation, sonar, wanted) == (FOLLOWER, 10.0, 3.0, 2.8, 3.0)
    assert at == pytest.approx([-3.0, 0.0], abs=0.002)


# ---- what is wrong ----------------------------------------------------------------------------


def test_what_the_sonar_has_heard_is_on_the_page_and_worse_is_to_be_looked_at() -> None:
    heard = row(heard_percent=74.2, scatter_m=0.021, wrong_percent=1.4)
    shown = snapshot(Moment(0.0, [heard], [track()]), HERE)
    sonar = shown["followers"][0]["sonar"]
    assert (sonar["heard"], sonar["scatter"], sonar["wrong"]) == (74.0, 0.02, 1.0)
    assert shown["alarms"] == []

    worse = row(heard_percent=31.0, worse="sonar hears 31%, 50% is believed")
    (alarm,) = alarms(Moment(0.0, [worse], [track()]))
    assert alarm.level is Level.LOOK
    assert alarm.text == "Follower 2: sonar hears 31%, 50% is believed"


def test_nothing_wrong() -> None:
    assert alarms(moment()) == []
    assert headline(moment()) == "1 of 1 following"
    assert headline(moment(state="only watched")) == "Only watching"
    assert headline(moment(state="")) == "1 follower"


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({"leader_age_s": 1.2}, Level.ACT, "Leader: no report for 1.2 s"),
        ({"leader_age_s": None}, Level.ACT, "Leader: no report yet"),
        ({"age_s": 4.0}, Level.ACT, "Follower 2: no report for 4 s"),
        ({"state": "holding: stop switch"}, Level.LOOK, "Follower 2: holding: stop switch"),
        ({"state": "no points sent"}, Level.ACT, "Follower 2: no points sent"),
        ({"separation_m": 1.4}, Level.ACT, "Follower 2 is 1.4 m from the leader (wanted 3.0 m)"),
        (
            {"separation_m": 1.4, "watches": 5},
            Level.ACT,
            "Follower 2 is 1.4 m from follower 5 (wanted 3.0 m)",
        ),
        ({"gimbal": "sonar fault"}, Level.LOOK, "Follower 2: its sonar has a fault"),
    ],
)
def test_what_is_wrong_is_said_plainly(changes: dict[str, Any], level: Level, words: str) -> None:
    (alarm,) = alarms(moment(**changes))
    assert (alarm.level, alarm.text) == (level, words)


@pytest.mark.parametrize(
    ("whose", "wrong"),
    [("own", "Follower 2"), ("leader", "The leader")],
)
def test_an_empty_battery(whose: str, wrong: str) -> None:
    low, enough = (
        Moment(0.0, [row(2, **{whose: VehicleHealth(battery_percent=percent)})], [track()])
        for percent in (19.0, 20.0)
    )
    (alarm,) = alarms(low)
    assert alarm.text == f"{wrong} has 19 % of its battery left"
    assert alarms(enough) == []


def test_the_worst_comes_first() -> None:
    rows = [row(2, state="holding: stop switch"), row(3, age_s=3.0)]
    found = alarms(Moment(0.0, rows, [track(), track()]))
    assert [alarm.system_id for alarm in found] == [3, 2]


def test_a_follower_that_sees_nobody_any_more_is_wrong_and_a_wide_formation_is_not() -> None:
    assert alarms(moment(health=Health(alone=(FOLLOWER,)))) == []
    (alarm,) = alarms(moment(health=Health(alone=(FOLLOWER,), lost=(FOLLOWER,))))
    assert alarm.text == "Follower 2 sees nobody any more"
    (alarm,) = alarms(moment(health=Health(lost=(2, 3))))
    assert alarm.text == "Followers 2, 3 see nobody any more"


def test_an_articulation_point_is_marked_and_is_no_alarm() -> None:
    health = Health(ranges=((2, 1), (3, 1)), near=((1, 2),), cuts=(Cut(LEADER, ((2,), (3,))),))
    frame = snapshot(moment(health=health), HERE)
    assert frame["level"] == 0
    assert frame["health"]["cuts"] == [{"id": LEADER, "parts": ((2,), (3,))}]
    # A pair that is ranged is drawn once.
    assert frame["health"]["edges"] == [[2, 1, "ranges"], [3, 1, "ranges"]]


def test_slots_out_of_sight_are_known_by_the_plan() -> None:
    """At 8 m behind the leader one is apart, unless another's slot is near it."""
    wide = track(wanted_radius_m=8.0)
    beside = track(wanted_radius_m=8.0, wanted_angle_deg=20.0)  # 2.8 m off
    above = track(wanted_radius_m=3.0, wanted_step_m=4.0)  # 5 m from the leader
    assert apart_by_plan([wide], 4.5) == [True]
    assert apart_by_plan([wide, track()], 4.5) == [True, False]
    assert apart_by_plan([wide, beside], 4.5) == [False, False]
    assert apart_by_plan([above], 4.5) == [True]
    assert apart_by_plan([track(wanted_radius_m=0.0)], 4.5) == [True]  # a relay
    assert apart_by_plan([], 4.5) == []
    assert apart_by_plan([wide], 8.5) == [False]


# ---- where it is ------------------------------------------------------------------------------


def test_an_address_that_is_not_loopback_is_said() -> None:
    assert PageAddress().said == "page: http://127.0.0.1:8017/"
    assert "everybody on the network can open it" in PageAddress("0.0.0.0").said
    assert PageAddress("::1", 80).said == "page: http://[::1]:80/"
