"""Missions are uploaded by MAVLink and flown in Auto."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import displace
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.sim.vehicle.modes import AUTO

from .autopilot_bench import RELATIVE, SYSTEM_ID, Bench

WAYPOINT, TAKE_OFF = mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_TAKEOFF
RETURN, SPEED = mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_DO_CHANGE_SPEED


def item(seq: int, command: int, north_m: float = 0.0, z: float = 8.0, p2: float = 0.0) -> Any:
    place = displace(ORIGIN, (north_m, 0.0, 0.0))
    x, y = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
    return mavlink.MAVLink_mission_item_int_message(
        SYSTEM_ID, 1, seq, RELATIVE, command, 0, 1, 0.0, p2, 0.0, 0.0, x, y, z
    )


def upload(bench: Bench, items: list[Any]) -> int:
    bench.send(mavlink.MAVLink_mission_count_message(SYSTEM_ID, 1, len(items)))
    bench.step()
    for asked, one in enumerate(items):
        if bench.heard("MISSION_ACK"):
            break
        assert bench.heard("MISSION_REQUEST_INT")[-1].seq == asked
        bench.send(one)
        bench.step()
    return int(bench.heard("MISSION_ACK")[-1].type)


def test_upload_fly_and_return() -> None:
    bench = Bench(flying=False, parameters={"RTL_LOIT_TIME": 500.0})
    items = [item(0, WAYPOINT), item(1, TAKE_OFF), item(2, SPEED, p2=3.0), item(3, WAYPOINT, 40.0)]
    assert upload(bench, [*items, item(4, RETURN)]) == mavlink.MAV_MISSION_ACCEPTED
    assert bench.autopilot.arm_and_fly(4.0)
    bench.run(6.0)
    assert bench.command(mavlink.MAV_CMD_MISSION_START) == 0
    assert bench.autopilot.mode_number() == AUTO
    bench.run(9.0)
    assert bench.speed_mps == pytest.approx(3.0, abs=0.1)
    bench.run(90.0)
    assert bench.copter.landed
    assert abs(bench.copter.north_m) < 0.5


def test_download_gives_back_what_was_uploaded() -> None:
    bench = Bench()
    upload(bench, [item(0, WAYPOINT), item(1, WAYPOINT, 25.0)])
    bench.send(mavlink.MAVLink_mission_request_list_message(SYSTEM_ID, 1))
    bench.send(mavlink.MAVLink_mission_request_int_message(SYSTEM_ID, 1, 1))
    bench.step()
    assert bench.heard("MISSION_COUNT")[-1].count == 2
    assert bench.heard("MISSION_ITEM_INT")[-1].x == item(1, WAYPOINT, 25.0).x


def test_what_cannot_be_flown_is_refused_and_the_old_mission_stays() -> None:
    bench = Bench()
    upload(bench, [item(0, WAYPOINT), item(1, WAYPOINT, 25.0)])
    bench.forget()
    unknown = item(1, mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT)
    assert upload(bench, [item(0, WAYPOINT), unknown]) == mavlink.MAV_MISSION_UNSUPPORTED
    assert len(bench.autopilot.modes.waypoints) == 1
    bench.send(item(5, WAYPOINT))  # nobody asked for it
    bench.step()
    assert bench.heard("MISSION_ACK")[-1].type == mavlink.MAV_MISSION_INVALID_SEQUENCE


def test_clearing_leaves_nothing_to_fly() -> None:
    bench = Bench()
    upload(bench, [item(0, WAYPOINT), item(1, WAYPOINT, 25.0)])
    bench.send(mavlink.MAVLink_mission_clear_all_message(SYSTEM_ID, 1))
    bench.step()
    assert bench.heard("MISSION_ACK")[-1].type == mavlink.MAV_MISSION_ACCEPTED
    assert not bench.autopilot.set_mode("AUTO")
