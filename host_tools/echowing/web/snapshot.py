"""A moment of a flight as the page draws it: plain lists and numbers, ready for JSON. Pure."""

import math
from typing import Any

from echowing.flight.belief import SonarBelief
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.health import Health
from echowing.flight.sonar import pan_rad
from echowing.geo import GlobalPosition, Ned
from echowing.tool.moment import Moment, places, seen_leader
from echowing.tool.panel import Row, VehicleHealth
from echowing.tool.track import Track
from echowing.web.alarms import alarms, headline, level_of

Json = dict[str, Any]


def beam(sonar: SonarBelief) -> Json:
    """The beam as the page draws it: as wide as it is half way to its reach."""
    half_rad = sonar.widest_rad.at(0.5 * sonar.reach_m)
    return {"half_deg": round(math.degrees(half_rad), 1), "reach_m": sonar.reach_m}


def snapshot(moment: Moment, origin: GlobalPosition) -> Json:
    """All that the page shows of a moment.

    Places are [north, east] in metres about `origin`, bearings in degrees clockwise from north,
    heights in metres above a vehicle's own home; null: not known.
    """
    where = places(moment, origin)
    wrong = alarms(moment)
    return {
        "t": round(moment.time_s, 3),
        "level": max((alarm.level for alarm in wrong), default=0),
        "headline": headline(moment),
        "alarms": [
            {"level": int(alarm.level), "id": alarm.system_id, "text": alarm.text}
            for alarm in wrong
        ],
        "leader": _leader(moment, where.leader),
        "followers": [
            _follower(row, track, (where.leader, *own))
            for row, track, *own in zip(
                moment.rows,
                moment.tracks,
                where.followers,
                where.slots,
                where.points,
                strict=True,
            )
        ],
        "health": _health(moment.health),
    }


def _leader(moment: Moment, at_ned_m: Ned | None) -> Json | None:
    if not moment.rows:
        return None
    row, track = moment.rows[0], moment.tracks[0]
    return {
        "id": moment.leader_id,
        "at": _level(at_ned_m),
        "height": _number(track.leader_height_m),
        "velocity": _pair(track.leader_north_mps, track.leader_east_mps),
        "heading": _number(track.leader_heading_deg, 1),
        "mode": row.leader.mode or "?",
        "speed": _number(row.leader_speed_mps),
        "age": _number(row.leader_age_s),
        "link": _number(track.leader_link_percent, 0),
        "battery": _battery(row.leader),
        "gps": row.leader.gps,
        "switch": row.leader.switch,
    }


def _follower(row: Row, track: Track, where: tuple[Ned | None, ...]) -> Json:
    leader, at_ned_m, slot, point = where
    wanted_m = math.hypot(track.wanted_radius_m, track.wanted_step_m)
    error_m = None if row.separation_m is None else row.separation_m - wanted_m
    return {
        "id": row.system_id,
        "state": row.state,
        "level": int(level_of(row)),
        "mode": row.own.mode or "?",
        "at": _level(at_ned_m),
        "height": _number(row.own.altitude_m),
        "wanted_height": _number(track.wanted_height_m),
        "velocity": _pair(track.north_mps, track.east_mps),
        "heading": _number(track.heading_deg, 1),
        "slot": _level(slot),
        "point": _level(point),
        "separation": _number(row.separation_m, 3),
        "watches": row.watches,
        # A relay has no distance to keep.
        "wanted": _number(wanted_m) if wanted_m > 0.0 else None,
        "error": _number(error_m, 3) if wanted_m > 0.0 else None,
        "sonar": {
            "range": _number(row.sonar_m),
            "bearing": _number(_axis_deg(track), 1),
            "state": row.gimbal,
            "heard": _number(row.heard_percent, 0),
            "scatter": _number(row.scatter_m),
            "wrong": _number(row.wrong_percent, 0),
        },
        "seen": _seen(track, leader),
        "speed": _number(row.speed_mps),
        "limit": _number(row.command_mps),
        "age": _number(row.age_s),
        "link": _number(row.link_percent, 0),
        "battery": _battery(row.own),
        "gps": row.own.gps,
        "switch": row.own.switch,
    }


def _axis_deg(track: Track) -> float | None:
    """Where the gimbal points; without its state nothing is known of that."""
    if track.pan_us is None:
        return None
    return (track.heading_deg + math.degrees(pan_rad(track.pan_us))) % 360.0


def _seen(track: Track, leader: Ned | None) -> Json | None:
    """The ellipse in which this follower takes the leader to be, half axes in metres."""
    at_ned_m = seen_leader(track, leader)
    spread = (track.seen_nn_m2, track.seen_ne_m2, track.seen_ee_m2)
    if at_ned_m is None or None in spread:
        return None
    major_m, minor_m, bearing_deg = ellipse(*(one or 0.0 for one in spread))
    return {
        "at": _level(at_ned_m),
        "major": round(major_m, 3),
        "minor": round(minor_m, 3),
        "bearing": round(bearing_deg, 1),
    }


def ellipse(nn_m2: float, ne_m2: float, ee_m2: float) -> tuple[float, float, float]:
    """Half axes and the longer one's bearing (0 to 180 deg), `SURE_SIGMAS` standard deviations."""
    middle_m2, half_m2 = (nn_m2 + ee_m2) / 2.0, (nn_m2 - ee_m2) / 2.0
    reach_m2 = math.hypot(half_m2, ne_m2)
    major_m, minor_m = (
        SURE_SIGMAS * math.sqrt(max(0.0, one))
        for one in (middle_m2 + reach_m2, middle_m2 - reach_m2)
    )
    return major_m, minor_m, math.degrees(math.atan2(ne_m2, half_m2) / 2.0) % 180.0


def _health(health: Health) -> Json:
    ranged = {frozenset(pair) for pair in health.ranges}
    near = [pair for pair in health.near if frozenset(pair) not in ranged]
    return {
        "edges": [
            *([*pair, "ranges"] for pair in health.ranges),
            *([*pair, "near"] for pair in near),
        ],
        "cuts": [{"id": cut.system_id, "parts": cut.parts} for cut in health.cuts],
        "alone": list(health.alone),
    }


def glance(frame: Json) -> Json:
    """The little of a frame that plots and tracks of the last minute need."""
    followers = [
        [
            *(one["id"], one["at"], one["height"], one["separation"], one["sonar"]["range"]),
            one["wanted"],
        ]
        for one in frame["followers"]
    ]
    leader = frame["leader"]
    if leader is None:
        return {"t": frame["t"], "leader": None, "followers": followers}
    return {
        "t": frame["t"],
        "leader": [leader["id"], leader["at"], leader["height"]],
        "followers": followers,
    }


def _level(place: Ned | None) -> list[float] | None:
    return None if place is None else [round(place[0], 3), round(place[1], 3)]


def _pair(north: float | None, east: float | None) -> list[float] | None:
    return None if north is None or east is None else [round(north, 2), round(east, 2)]


def _number(value: float | None, places: int = 2) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, places)


def _battery(one: VehicleHealth) -> str | None:
    if one.battery_percent is not None:
        return f"{one.battery_percent:.0f} %"
    return None if one.battery_v is None else f"{one.battery_v:.1f} V"
