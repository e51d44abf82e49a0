"""Geodesy: between global positions (WGS-84) and local NED metres.

What is asked for many times a tick is worked out here, one place at a time (the tests hold it
against pymap3d); the rest is pymap3d's.
"""

import math
from functools import cache, lru_cache
from typing import Any, NamedTuple

Ned = tuple[float, float, float]

# WGS-84, worked out as pymap3d does, to the last digit: NumPy behind it loads for half a second.
_A_M, _B_M = 6_378_137.0, 6_356_752.31424518
_FLATTENING = (_A_M - _B_M) / _A_M
_E2 = math.sqrt(2.0 * _FLATTENING - _FLATTENING**2) ** 2

# Within this distance, and outside the polar caps, the radii of curvature at the start
# place a point to better than 1 cm; beyond it the exact conversion is used (40 times slower).
LOCAL_RADIUS_M = 200.0
POLAR_LATITUDE_DEG = 80.0
# A degree of latitude is 110 574 m at the equator (WGS-84) and more elsewhere; one of longitude
# there 111 320 m, times the cosine of the latitude. Beyond the second margin no rounding counts.
LEAST_M_PER_DEGREE = 110_000.0
SURE_M = 1.0
# Standard gravity, by definition (CGPM 1901); what ArduPilot flies by too (AP_Math, GRAVITY_MSS).
GRAVITY_MPS2 = 9.80665


class GlobalPosition(NamedTuple):
    """WGS-84 latitude and longitude in degrees, altitude in metres (datum as the caller says)."""

    lat_deg: float
    lon_deg: float
    alt_m: float


@cache
def load_exact() -> tuple[Any, Any, Any]:
    """pymap3d, its vincenty and its WGS-84, for what is far. Call it before a flight, not in one.

    The ellipsoid is made once: by default it is made anew in every call.
    """
    import pymap3d  # noqa: PLC0415 (loads NumPy)
    from pymap3d import vincenty  # noqa: PLC0415

    return pymap3d, vincenty, pymap3d.Ellipsoid.from_name("wgs84")


def ned_between(origin: GlobalPosition, point: GlobalPosition) -> Ned:
    """Local NED metres from `origin` to `point`; works across the antimeridian."""
    here_x_m, here_y_m, here_z_m, sin_lat, cos_lat, sin_lon, cos_lon = _frame(origin)
    there_x_m, there_y_m, there_z_m, _, _, _, _ = _frame(point)
    x_m, y_m, z_m = there_x_m - here_x_m, there_y_m - here_y_m, there_z_m - here_z_m
    outward_m = cos_lon * x_m + sin_lon * y_m
    return (
        cos_lat * z_m - sin_lat * outward_m,
        cos_lon * y_m - sin_lon * x_m,
        -cos_lat * outward_m - sin_lat * z_m,
    )


@lru_cache(maxsize=256)
def _frame(place: GlobalPosition) -> tuple[float, float, float, float, float, float, float]:
    """A place in earth-centred metres, and sine and cosine of its latitude and its longitude.

    Kept, as home and the other vehicles are asked for again and again.

    As `pymap3d.geodetic2ecef`, which goes through NumPy and takes ten times as long for one place.
    """
    lat_rad, lon_rad = math.radians(place.lat_deg), math.radians(place.lon_deg)
    sin_lat, cos_lat = math.sin(lat_rad), math.cos(lat_rad)
    sin_lon, cos_lon = math.sin(lon_rad), math.cos(lon_rad)
    transverse_m = _A_M / math.sqrt(1.0 - _E2 * sin_lat * sin_lat)
    level_m = (transverse_m + place.alt_m) * cos_lat
    z_m = (transverse_m * (1.0 - _E2) + place.alt_m) * sin_lat
    return level_m * cos_lon, level_m * sin_lon, z_m, sin_lat, cos_lat, sin_lon, cos_lon


def displace(origin: GlobalPosition, ned_m: Ned) -> GlobalPosition:
    """The global position `ned_m` metres north, east and down of `origin`.

    Longitude comes back in -180 to 180.
    """
    north_m, east_m, down_m = ned_m
    near = abs(north_m) < LOCAL_RADIUS_M and abs(east_m) < LOCAL_RADIUS_M
    if not near or abs(origin.lat_deg) > POLAR_LATITUDE_DEG:
        pymap3d, _, wgs84 = load_exact()
        lat, lon, alt = pymap3d.ned2geodetic(north_m, east_m, down_m, *origin, wgs84)
        return GlobalPosition(float(lat), float(lon), float(alt))
    sin_lat = math.sin(math.radians(origin.lat_deg))
    flat = 1.0 - _E2 * sin_lat * sin_lat
    transverse_m = _A_M / math.sqrt(flat)
    meridian_m = transverse_m * (1.0 - _E2) / flat + origin.alt_m
    lat_deg = origin.lat_deg + math.degrees(north_m / meridian_m)
    lon_deg = origin.lon_deg + math.degrees(
        east_m / ((transverse_m + origin.alt_m) * math.cos(math.radians(lat_deg)))
    )
    return GlobalPosition(lat_deg, wrap_longitude_deg(lon_deg), origin.alt_m - down_m)


def distance_m(a: GlobalPosition, b: GlobalPosition) -> float:
    """Straight-line distance in metres between two nearby positions, altitude included."""
    return math.hypot(*ned_between(a, b))


def nearer_than(a: GlobalPosition, b: GlobalPosition, least_m: float) -> bool:
    """Whether two positions are nearer than `least_m`; quick where they clearly are not."""
    if abs(a.lat_deg - b.lat_deg) * LEAST_M_PER_DEGREE > least_m:
        return False
    if abs(a.alt_m - b.alt_m) > least_m + SURE_M:
        return False
    east_deg = abs(wrap_longitude_deg(a.lon_deg - b.lon_deg))
    if east_deg * LEAST_M_PER_DEGREE * math.cos(math.radians(a.lat_deg)) > least_m + SURE_M:
        return False
    return distance_m(a, b) < least_m


def relay_pos(ground: GlobalPosition, remote: GlobalPosition) -> GlobalPosition:
    """Midway on the ellipsoid's surface, at the mean altitude (thesis Appendix D, relay_pos).

    The thesis halves the straight chord in space, which sinks below the surface with distance;
    here the geodesic is halved, so the altitude stays what the operator expects.
    """
    _, vincenty, _ = load_exact()
    metres, azimuth_deg = vincenty.vdist(ground.lat_deg, ground.lon_deg, *remote[:2])
    lat, lon = vincenty.vreckon(
        ground.lat_deg, ground.lon_deg, float(metres) / 2.0, float(azimuth_deg)
    )
    alt_m = (ground.alt_m + remote.alt_m) / 2.0
    return GlobalPosition(float(lat), wrap_longitude_deg(float(lon)), alt_m)


def wrap_longitude_deg(lon_deg: float) -> float:
    """Longitude in -180 to 180."""
    return (lon_deg + 180.0) % 360.0 - 180.0


def wrap_angle_rad(angle_rad: float) -> float:
    """Angle in -pi to pi."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
