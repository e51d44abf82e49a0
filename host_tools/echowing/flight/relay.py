"""Relay: a vehicle kept midway between a ground station and a remote vehicle. Pure.

After thesis Appendix D; flown by the same follow session as a formation, with the same guard.
"""

import math

from echowing.errors import EchowingError
from echowing.flight.follower import Guide
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    Horizontal,
    LeaderFix,
    Slot,
)
from echowing.geo import GlobalPosition, displace, ned_between, relay_pos

# Nothing here looks at the remote vehicle with a sonar, and no point runs ahead.
RELAY_SETTINGS = GuidanceSettings(
    lead_time_s=0.0,
    face_leader=False,
    learn_offset=False,
    feed_forward=False,
)


# Two barometers wander by a metre each, and two homes by their receivers differ by 3 m at the most.
HEIGHTS_APART_M = 5.0
# Added to --min-separation beside the remote's way: two receivers are off by 2.8 m at the most
# (2.5 standard deviations of 1.1 m), and a copter is 2 m beside its point while that moves.
BESIDE_M = 5.0
# Nearer than twice this to the ground station a remote vehicle gives no usable line: two receivers
# that are off by 2.8 m turn it by 16 degrees.
LINE_M = 5.0
# A remote vehicle at this speed has a way; the relay gives way to one that arrives within AHEAD_S.
# A copter needs 6 s for 15 m aside, and a second until it begins.
MOVING_MPS, AHEAD_S = 1.0, 15.0
# A relay this far to a side of the remote's way is on that side; else it goes to the right.
ON_A_SIDE_M = 0.5


class RelayGuide(Guide):
    """Guided points midway to where the remote vehicle is believed to be now, beside its ways.

    A remote vehicle that comes back along the line would fly through a relay on it, even without
    reports, as after a lost link, while the relay stands where it is. So the relay's place is
    `clear_m` beside the line. It gives way in time to a remote vehicle that flies at it from
    elsewhere, and is never led nearer to it than `clear_m`.
    """

    def __init__(self, ground: GlobalPosition, clear_m: float) -> None:
        self._ground = ground
        self._line, self._way = _Side(clear_m), _Side(clear_m)
        self._clear_m = clear_m

    def update(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
        formation_mps: Horizontal | None = None,
    ) -> GuidedPoint:
        """As `TowBar.update`; the relay's own place only decides which side it takes."""
        remote = leader.position
        middle = relay_pos(self._ground, remote)
        middle_m = ned_between(remote, middle)[:2]
        here_m = None if follower is None else ned_between(remote, follower)[:2]
        place_m = self._beside(middle_m, leader.velocity_ned_mps[:2], here_m)
        place_m = _out(place_m, here_m, self._clear_m)
        shift_m = place_m[0] - middle_m[0], place_m[1] - middle_m[1], 0.0
        place = displace(middle, shift_m)
        return GuidedPoint(point=place, slot=place, leader=remote, yaw_rad=None)

    def place(self, slot: Slot, bar_m: float) -> None:
        """As `TowBar.place`; a relay has no slot."""

    def _beside(
        self, middle_m: Horizontal, velocity_mps: Horizontal, here_m: Horizontal | None
    ) -> Horizontal:
        """The relay's place, seen from the remote vehicle: beside the line, and beside its way."""
        is_line = math.hypot(*middle_m) >= LINE_M
        place_m = self._line.beside(middle_m, middle_m if is_line else None, here_m)
        speed_mps = math.hypot(*velocity_mps)
        way = velocity_mps if speed_mps >= MOVING_MPS else None
        if way is not None:
            ahead_m, _ = _along(place_m, *way)
            if not -self._clear_m < ahead_m < self._clear_m + AHEAD_S * speed_mps:
                way = None
        return self._way.beside(place_m, way, here_m)


class _Side:
    """The side of a way that the relay keeps to as long as there is that way."""

    def __init__(self, clear_m: float) -> None:
        self._clear_m = clear_m
        self._right: float | None = None  # 1.0 right of it, -1.0 left

    def beside(
        self, place_m: Horizontal, way: Horizontal | None, here_m: Horizontal | None
    ) -> Horizontal:
        """A place moved aside until it is clear of a way from the origin (a vector; None: none).

        here_m: where the vehicle is, which stays on its side.
        """
        if way is None:
            self._right = None
            return place_m
        ahead_m, right_m = _along(place_m, *way)
        if self._right is None:
            _, here_right_m = (0.0, 0.0) if here_m is None else _along(here_m, *way)
            self._right = -1.0 if here_right_m < -ON_A_SIDE_M else 1.0
        if abs(right_m) >= self._clear_m:
            return place_m
        aside_m = self._right * self._clear_m
        north, east = _unit(way)
        return ahead_m * north - aside_m * east, ahead_m * east + aside_m * north


def _unit(vector: Horizontal) -> Horizontal:
    length = math.hypot(*vector)
    return vector[0] / length, vector[1] / length


def _along(place_m: Horizontal, north: float, east: float) -> Horizontal:
    """How far ahead and to the right a place is, for somebody who flies that way."""
    north, east = _unit((north, east))
    return place_m[0] * north + place_m[1] * east, place_m[1] * north - place_m[0] * east


def _out(place_m: Horizontal, here_m: Horizontal | None, clear_m: float) -> Horizontal:
    """A place no nearer to the remote vehicle than `clear_m`, on the relay's own side of it."""
    if math.hypot(*place_m) >= clear_m:
        return place_m
    north_m, east_m = here_m or place_m
    far_m = math.hypot(north_m, east_m)
    if far_m < ON_A_SIDE_M:
        north_m, east_m, far_m = -1.0, 0.0, 1.0
    return clear_m * north_m / far_m, clear_m * east_m / far_m


def parse_ground(text: str) -> GlobalPosition:
    """`LAT,LON` in degrees. Raises EchowingError."""
    lat, comma, lon = text.partition(",")
    try:
        ground = GlobalPosition(float(lat), float(lon), 0.0)
    except ValueError:
        ground = None
    if (
        not comma
        or ground is None
        or not (abs(ground.lat_deg) <= 90 and abs(ground.lon_deg) <= 180)
    ):
        raise EchowingError(f"ground {text!r}: write LAT,LON in degrees, as 39.3400,-86.0300")
    return ground
