"""Moments of a made-up flight, for what is shown of it."""

from dataclasses import replace
from typing import Any

from echowing.flight.health import Health
from echowing.geo import GlobalPosition, displace
from echowing.tool.moment import Moment
from echowing.tool.panel import Row, VehicleHealth
from echowing.tool.track import Track

HERE = GlobalPosition(39.34, -86.03, 250.0)
LEADER, FOLLOWER = 1, 2
STRAIGHT_US = 1380.0


def row(system_id: int = FOLLOWER, **changes: Any) -> Row:
    """A follower in its slot, 3 m behind a leader that flies north at 2 m/s."""
    well = Row(
        time_s=0.0,
        system_id=system_id,
        state="following",
        separation_m=3.0,
        error_m=0.0,
        slot_error_m=0.0,
        sonar_m=2.8,
        gimbal="tracking",
        leader_age_s=0.1,
        age_s=0.0,
        command_mps=3.0,
        speed_mps=2.0,
        leader_speed_mps=2.0,
        link_percent=100.0,
        north_offset_m=0.0,
        east_offset_m=0.0,
        own=VehicleHealth(mode="GUIDED", altitude_m=10.0, battery_percent=80.0),
        leader=VehicleHealth(mode="AUTO", battery_percent=70.0),
    )
    return replace(well, **changes)


def track(
    north_m: float = -3.0, east_m: float = 0.0, leader_north_m: float = 0.0, **changes: Any
) -> Track:
    """The same as a track; places are from `HERE`."""
    leader = displace(HERE, (leader_north_m, 0.0, 0.0))
    own = displace(HERE, (north_m, east_m, 0.0))
    slot = displace(HERE, (leader_north_m - 3.0, 0.0, 0.0))
    well = Track(
        wanted_radius_m=3.0,
        wanted_angle_deg=0.0,
        wanted_step_m=0.0,
        leader_lat_deg=leader.lat_deg,
        leader_lon_deg=leader.lon_deg,
        leader_alt_m=leader.alt_m,
        leader_north_mps=2.0,
        leader_east_mps=0.0,
        leader_heading_deg=0.0,
        lat_deg=own.lat_deg,
        lon_deg=own.lon_deg,
        alt_m=own.alt_m,
        north_mps=2.0,
        east_mps=0.0,
        heading_deg=0.0,
        slot_lat_deg=slot.lat_deg,
        slot_lon_deg=slot.lon_deg,
        point_lat_deg=slot.lat_deg,
        point_lon_deg=slot.lon_deg,
        yaw_deg=0.0,
        pan_us=STRAIGHT_US,
        tilt_us=1400.0,
        leader_id=LEADER,
        leader_height_m=10.0,
        wanted_height_m=10.0,
        seen_north_m=0.5,
        seen_east_m=-0.25,
        seen_nn_m2=0.04,
        seen_ne_m2=0.0,
        seen_ee_m2=0.16,
    )
    return replace(well, **changes)


def moment(time_s: float = 0.0, health: Health | None = None, **changes: Any) -> Moment:
    """One follower behind its leader; changes are of its row."""
    return Moment(time_s, [row(time_s=time_s, **changes)], [track()], health or Health())


def many(time_s: float, followers: int = 50) -> Moment:
    """As many followers in a line."""
    ids = range(FOLLOWER, FOLLOWER + followers)
    rows = [row(one, time_s=time_s) for one in ids]
    return Moment(time_s, rows, [track(-3.0 * (one - 1)) for one in ids])
