"""One moment of a flight, to show and to judge: all rows and tracks about one origin. Pure."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pymap3d

from echowing.flight.belief import SonarBelief
from echowing.flight.estimate import LONGEST_CARRY_S
from echowing.flight.guidance import Slot, slot_offset_m
from echowing.flight.health import Health, Member
from echowing.flight.sonar import pan_rad
from echowing.geo import GlobalPosition, Ned
from echowing.tool.panel import Row
from echowing.tool.track import Track


@dataclass(frozen=True, slots=True)
class Moment:
    """The vehicles at `time_s`: a row and a track per follower, in one order."""

    time_s: float
    rows: Sequence[Row]
    tracks: Sequence[Track]
    health: Health = field(default_factory=Health)

    @property
    def leader_id(self) -> int:
        """The leader's system id; 0: not known."""
        return (self.tracks[0].leader_id or 0) if self.tracks else 0

    @property
    def origin(self) -> GlobalPosition | None:
        """A known position: the leader's, else a follower's."""
        for track in self.tracks:
            if track.leader_lat_deg is not None:
                return _global(track.leader_lat_deg, track.leader_lon_deg, track.leader_alt_m)
        for track in self.tracks:
            if track.lat_deg is not None:
                return _global(track.lat_deg, track.lon_deg, track.alt_m)
        return None


def _global(lat_deg: float | None, lon_deg: float | None, alt_m: float | None) -> GlobalPosition:
    return GlobalPosition(lat_deg or 0.0, lon_deg or 0.0, alt_m or 0.0)


@dataclass(frozen=True, slots=True)
class Places:
    """Metres about an origin, NED; None: not known. `slots` and `points` are level with it."""

    leader: Ned | None
    followers: Sequence[Ned | None]
    slots: Sequence[Ned | None]
    points: Sequence[Ned | None]


def places(moment: Moment, origin: GlobalPosition) -> Places:
    """Where all vehicles are and should be; in one call, which costs as much as for one vehicle."""
    first = moment.tracks[0] if moment.tracks else None
    known: list[tuple[float | None, float | None, float | None]] = []
    if first is not None:
        known.append((first.leader_lat_deg, first.leader_lon_deg, first.leader_alt_m))
    for track in moment.tracks:
        known.append((track.lat_deg, track.lon_deg, track.alt_m))
        known.append((track.slot_lat_deg, track.slot_lon_deg, origin.alt_m))
        known.append((track.point_lat_deg, track.point_lon_deg, origin.alt_m))
    ned = list(_ned(known, origin))
    leader = ned.pop(0) if ned else None
    followers = [
        None if place is None else _carried_on(place, row, track)
        for place, row, track in zip(ned[0::3], moment.rows, moment.tracks, strict=True)
    ]
    return Places(leader, followers, ned[1::3], ned[2::3])


def _carried_on(place: Ned, row: Row, track: Track) -> Ned:
    """A follower's position extrapolated over the age of its report, as the leader's is."""
    age_s = min(_age(row.age_s), LONGEST_CARRY_S)
    return place[0] + track.north_mps * age_s, place[1] + track.east_mps * age_s, place[2]


def _ned(
    known: Sequence[tuple[float | None, float | None, float | None]], origin: GlobalPosition
) -> Iterator[Ned | None]:
    table = np.array([[math.nan if one is None else one for one in row] for row in known])
    if not len(table):
        return
    columns = pymap3d.geodetic2ned(*table.T, *origin)
    for place in np.column_stack(columns).tolist():
        yield None if any(map(math.isnan, place)) else (place[0], place[1], place[2])


def members(moment: Moment, where: Places, sonar: SonarBelief) -> list[Member]:
    """The vehicles as `flight.health` judges them, by what is believed of their sonars."""
    leader_age_s = moment.rows[0].leader_age_s if moment.rows else None
    leader = Member(moment.leader_id, where.leader, _age(leader_age_s))
    followers = [
        Member(
            row.system_id,
            at_ned_m,
            _age(row.age_s),
            math.radians(track.heading_deg) + (pan_rad(track.pan_us) if track.pan_us else 0.0),
            _apart_m(row.sonar_m, sonar),
            seen_leader(track, where.leader),
            apart,
        )
        for row, track, at_ned_m, apart in zip(
            moment.rows,
            moment.tracks,
            where.followers,
            apart_by_plan(moment.tracks, sonar.reach_m),
            strict=True,
        )
    ]
    return [leader, *followers]


def apart_by_plan(tracks: Sequence[Track], reach_m: float) -> list[bool]:
    """Which slots are beyond a sonar's reach from the leader and from all other slots."""
    north, east = np.array([slot_offset_m(_slot(track), 0.0) for track in tracks]).reshape(-1, 2).T
    down = np.array([-track.wanted_step_m for track in tracks])
    places_m = np.vstack([np.zeros(3), np.column_stack([north, east, down])])
    apart_m = np.linalg.norm(places_m[:, np.newaxis] - places_m, axis=2)
    np.fill_diagonal(apart_m, math.inf)
    alone = apart_m.min(axis=1) > reach_m
    # A relay has no slot, and comes near nobody.
    return [
        bool(one) or track.wanted_radius_m == 0.0
        for one, track in zip(alone[1:], tracks, strict=True)
    ]


def _slot(track: Track) -> Slot:
    return Slot(track.wanted_radius_m, math.radians(track.wanted_angle_deg), track.wanted_step_m)


def _apart_m(sonar_m: float | None, sonar: SonarBelief) -> float | None:
    """The distance between centres for a range."""
    return None if sonar_m is None or sonar_m >= sonar.reach_m else sonar_m + sonar.inset_m


def seen_leader(track: Track, leader: Ned | None) -> Ned | None:
    """Where a follower estimates the leader; None: it has no estimate."""
    if leader is None or track.seen_north_m is None or track.seen_east_m is None:
        return None
    return leader[0] + track.seen_north_m, leader[1] + track.seen_east_m, leader[2]


def _age(age_s: float | None) -> float:
    return math.inf if age_s is None else age_s
