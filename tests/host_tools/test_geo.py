import math

import pymap3d
import pytest

from echowing import geo
from echowing.geo import (
    GlobalPosition,
    Ned,
    displace,
    distance_m,
    nearer_than,
    ned_between,
    relay_pos,
    wrap_angle_rad,
    wrap_longitude_deg,
)

EVERYWHERE = [
    GlobalPosition(39.34, -86.03, 260.0),
    GlobalPosition(0.0, 0.0, 0.0),
    GlobalPosition(-33.9, 151.2, 50.0),
    GlobalPosition(12.0, 179.99999, 10.0),
    GlobalPosition(-12.0, -179.99999, 10.0),
    GlobalPosition(79.0, 20.0, 10.0),
    GlobalPosition(89.99, 20.0, 10.0),
    GlobalPosition(-89.99, -120.0, 10.0),
]


@pytest.mark.parametrize("origin", EVERYWHERE)
@pytest.mark.parametrize("ned_m", [(3.0, -4.0, 1.5), (-60.0, 40.0, 0.0), (900.0, 1200.0, -30.0)])
def test_a_displaced_position_is_found_where_it_was_put(origin: GlobalPosition, ned_m: Ned) -> None:
    there = displace(origin, ned_m)

    # 1 cm: the resolution of a MAVLink latitude.
    assert ned_between(origin, there) == pytest.approx(ned_m, abs=0.01)
    assert -180.0 <= there.lon_deg <= 180.0


@pytest.mark.parametrize("origin", EVERYWHERE)
@pytest.mark.parametrize("apart_deg", [1e-5, 0.01, 3.0])
def test_places_are_apart_as_pymap3d_has_it(origin: GlobalPosition, apart_deg: float) -> None:
    towards_equator = -math.copysign(apart_deg, origin.lat_deg)
    there = GlobalPosition(origin.lat_deg + towards_equator, origin.lon_deg + 0.7 * apart_deg, 70.0)
    expected = pymap3d.geodetic2ned(*there, *origin)

    # Earth-centred metres are millions: 1e-9 of them is left of 16 digits.
    assert ned_between(origin, there) == pytest.approx([float(m) for m in expected], abs=1e-8)


def test_across_the_antimeridian_east_is_still_east() -> None:
    west_of_it = GlobalPosition(10.0, 179.999999, 0.0)

    there = displace(west_of_it, (0.0, 5.0, 0.0))

    assert there.lon_deg < -179.9
    assert distance_m(west_of_it, there) == pytest.approx(5.0, abs=0.01)


def test_one_degree_of_latitude_is_111_km() -> None:
    # 110.57 km at the equator on WGS-84.
    north_m, east_m, _ = ned_between(GlobalPosition(-0.5, 7.0, 0.0), GlobalPosition(0.5, 7.0, 0.0))

    assert north_m == pytest.approx(110_570, rel=2e-3)
    assert east_m == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("ground", "remote"),
    [
        (GlobalPosition(39.34, -86.03, 250.0), GlobalPosition(39.35, -86.01, 350.0)),
        (GlobalPosition(10.0, 179.99, 0.0), GlobalPosition(10.01, -179.98, 100.0)),
        (GlobalPosition(84.0, 10.0, 0.0), GlobalPosition(84.02, 10.5, 40.0)),
        (GlobalPosition(-45.0, 170.0, 5.0), GlobalPosition(-45.0, 170.0, 25.0)),
    ],
)
def test_the_relay_is_as_far_from_both_and_at_their_mean_altitude(
    ground: GlobalPosition, remote: GlobalPosition
) -> None:
    relay = relay_pos(ground, remote)

    level = [point._replace(alt_m=0.0) for point in (ground, relay, remote)]
    first_m, second_m = distance_m(level[0], level[1]), distance_m(level[1], level[2])
    assert first_m == pytest.approx(second_m, abs=0.02)
    assert first_m + second_m == pytest.approx(distance_m(level[0], level[2]), abs=0.02)
    assert relay.alt_m == pytest.approx((ground.alt_m + remote.alt_m) / 2.0)


def test_a_distant_relay_stays_on_the_ellipsoid() -> None:
    # The thesis's chord midpoint would be 196 m under the surface for 100 km.
    relay = relay_pos(GlobalPosition(40.0, -86.0, 100.0), GlobalPosition(40.0, -84.8, 100.0))

    assert relay.alt_m == pytest.approx(100.0)
    assert relay.lon_deg == pytest.approx(-85.4, abs=1e-6)


@pytest.mark.parametrize(("raw", "wrapped"), [(190.0, -170.0), (-181.0, 179.0), (12.0, 12.0)])
def test_longitudes_wrap(raw: float, wrapped: float) -> None:
    assert wrap_longitude_deg(raw) == pytest.approx(wrapped)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
def test_angles_wrap_by_whole_turns(turns: int) -> None:
    assert wrap_angle_rad(0.3 + turns * 2.0 * math.pi) == pytest.approx(0.3)


@pytest.mark.parametrize("origin", EVERYWHERE)
@pytest.mark.parametrize(
    "ned_m",
    [
        *((2.9, 0.0, 0.0), (3.1, 0.0, 0.0), (0.0, 2.9, 0.0), (0.0, -3.1, 0.0), (0.0, 0.0, -2.9)),
        *((0.0, 0.0, 3.1), (1.7, -1.7, 1.7), (1.8, 1.8, -1.8), (900.0, -1200.0, 5.0)),
    ],
)
def test_nearer_than_is_what_the_distance_says(origin: GlobalPosition, ned_m: Ned) -> None:
    there = displace(origin, ned_m)
    assert nearer_than(origin, there, 3.0) is (distance_m(origin, there) < 3.0)
    assert nearer_than(there, origin, 3.0) is (distance_m(origin, there) < 3.0)


def test_the_ellipsoid_is_pymap3ds_to_the_last_digit() -> None:
    wgs84 = pymap3d.Ellipsoid.from_name("wgs84")
    assert (wgs84.semimajor_axis, wgs84.eccentricity**2) == (geo._A_M, geo._E2)
