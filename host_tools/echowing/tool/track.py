"""Where all vehicles were and should be, for the follow tool's CSV and its analysis. Pure."""

import math
from dataclasses import dataclass, fields
from typing import Any

from echowing.flight.follower import FollowerState
from echowing.flight.guidance import LeaderFix, is_stale, predicted
from echowing.flight.session import FollowSession
from echowing.geo import GlobalPosition, ned_between
from echowing.tool.panel import Panel

PAN, TILT = "SNR_PAN", "SNR_TILT"


@dataclass(frozen=True, slots=True)
class Track:
    """One follower's place in the formation at one moment; None: not known.

    Degrees are WGS-84, `alt_m` above sea level, speeds over ground, headings clockwise from north.
    wanted_*: its slot. leader_*: extrapolated over the age of its report, by its own receiver.
    lat_deg to heading_deg: the follower's newest report. slot_*, point_*: slot and point of
    the guidance, the learnt offset and the lead included; yaw_deg: the commanded heading. pan_us,
    tilt_us: the gimbal's pulses. leader_height_m: above the leader's home, wanted_height_m: of
    this follower above its own. seen_*: from the leader's position by its own receiver to
    where this follower estimates it, metres, and the covariance, square metres. wander_m: how far
    each of both receivers is found to wander per axis; forgets_s: in how long it is found to
    forget that. sonar_inset_m: how much less than the separation its sonar reads.
    """

    wanted_radius_m: float
    wanted_angle_deg: float
    wanted_step_m: float
    leader_lat_deg: float | None
    leader_lon_deg: float | None
    leader_alt_m: float | None
    leader_north_mps: float | None
    leader_east_mps: float | None
    leader_heading_deg: float | None
    lat_deg: float | None
    lon_deg: float | None
    alt_m: float | None
    north_mps: float
    east_mps: float
    heading_deg: float
    slot_lat_deg: float | None
    slot_lon_deg: float | None
    point_lat_deg: float | None
    point_lon_deg: float | None
    yaw_deg: float | None
    pan_us: float | None
    tilt_us: float | None
    leader_id: int | None = None
    leader_link_percent: float | None = None
    leader_height_m: float | None = None
    wanted_height_m: float | None = None
    seen_north_m: float | None = None
    seen_east_m: float | None = None
    seen_nn_m2: float | None = None
    seen_ne_m2: float | None = None
    seen_ee_m2: float | None = None
    wander_m: float | None = None
    forgets_s: float | None = None
    sonar_inset_m: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Its fields by name: degrees of position as MAVLink carries them, else thousandths."""
        return {column.name: _rounded(column.name, getattr(self, column.name)) for column in _ALL}


def _rounded(name: str, value: float | str | None) -> float | str | None:
    if value is None or isinstance(value, str):
        return value
    return round(value, 7 if name.endswith(("lat_deg", "lon_deg")) else 3)


_ALL = fields(Track)


def track(session: FollowSession, follower: FollowerState, panel: Panel, now_s: float) -> Track:
    """Where leader and follower are at `now_s`, and where the follower is to be."""
    slot, system_id = follower.slot, follower.plan.system_id
    leader = _leader(session, now_s)
    leader_lat_deg, leader_lon_deg, leader_alt_m = _place(
        None if leader is None else leader.position
    )
    lat_deg, lon_deg, alt_m = _place(follower.position)
    guided = None if follower.standing.held else follower.guided
    slot_lat_deg, slot_lon_deg, _ = _place(None if guided is None else guided.slot)
    point_lat_deg, point_lon_deg, _ = _place(None if guided is None else guided.point)
    return Track(
        wanted_radius_m=slot.radius_m,
        wanted_angle_deg=math.degrees(slot.angle_rad),
        wanted_step_m=slot.altitude_step_m,
        leader_lat_deg=leader_lat_deg,
        leader_lon_deg=leader_lon_deg,
        leader_alt_m=leader_alt_m,
        leader_north_mps=None if leader is None else leader.velocity_ned_mps[0],
        leader_east_mps=None if leader is None else leader.velocity_ned_mps[1],
        leader_heading_deg=_degrees(None if leader is None else leader.heading_rad),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=alt_m,
        north_mps=follower.velocity_mps[0],
        east_mps=follower.velocity_mps[1],
        heading_deg=math.degrees(follower.heading_rad),
        slot_lat_deg=slot_lat_deg,
        slot_lon_deg=slot_lon_deg,
        point_lat_deg=point_lat_deg,
        point_lon_deg=point_lon_deg,
        yaw_deg=_degrees(None if guided is None else guided.yaw_rad),
        pan_us=panel.newest(system_id, PAN, now_s),
        tilt_us=panel.newest(system_id, TILT, now_s),
        wanted_height_m=session.heights.wanted_m(follower),
        sonar_inset_m=follower.plan.sonar.inset_m,
        **_of_leader(session, panel),
        **_seen(session, follower, leader, now_s),
    )


def _of_leader(session: FollowSession, panel: Panel) -> dict[str, Any]:
    """The leader's own report."""
    fix = session.leader.fix
    home_m = session.known.homes.above_sea_m(session.leader_id)
    return {
        "leader_id": session.leader_id,
        "leader_link_percent": panel.link_percent(session.leader_id),
        "leader_height_m": None if fix is None or home_m is None else fix.position.alt_m - home_m,
    }


def _seen(
    session: FollowSession, follower: FollowerState, leader: LeaderFix | None, now_s: float
) -> dict[str, Any]:
    """Where this follower estimates the leader, and how sure it is."""
    if leader is None or not session.settings.learn_offset or session.leader.fix is None:
        return {}
    seen = session.known.leader_for(follower, session.leader.fix, now_s)
    north_m, east_m, _ = ned_between(leader.position, seen)
    offset = follower.estimate.offset
    nn_m2, ee_m2 = offset.sigma_m(0.0) ** 2, offset.sigma_m(math.pi / 2.0) ** 2
    # Along a bearing of 45 deg the variance is (nn + ee) / 2 + ne.
    ne_m2 = offset.sigma_m(math.pi / 4.0) ** 2 - (nn_m2 + ee_m2) / 2.0
    return {
        "seen_north_m": north_m,
        "seen_east_m": east_m,
        "seen_nn_m2": nn_m2,
        "seen_ne_m2": ne_m2,
        "seen_ee_m2": ee_m2,
        "wander_m": offset.wander_m,
        "forgets_s": offset.forgets_s,
    }


def _leader(session: FollowSession, now_s: float) -> LeaderFix | None:
    """Where the leader is now; None while its report is stale."""
    fix = session.leader.fix
    if fix is None or is_stale(now_s - fix.time_s, session.settings):
        return None
    return predicted(fix, max(0.0, now_s - fix.time_s))


def _place(place: GlobalPosition | None) -> tuple[float | None, float | None, float | None]:
    return (None, None, None) if place is None else place


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad) % 360.0
