import math

import pytest

from echowing.flight.axis import Axis, along, apart_rad, axis_of


@pytest.mark.parametrize("azimuth_deg", [-170.0, -90.0, 0.0, 35.0, 179.0])
@pytest.mark.parametrize("elevation_deg", [-30.0, 0.0, 80.0])
def test_a_quaternion_tells_the_axis_that_it_was_made_of(
    azimuth_deg: float, elevation_deg: float
) -> None:
    axis = Axis(math.radians(azimuth_deg), math.radians(elevation_deg))

    told = axis_of(axis.quaternion)

    assert told is not None
    assert told.azimuth_rad == pytest.approx(axis.azimuth_rad)
    assert told.elevation_rad == pytest.approx(axis.elevation_rad)


@pytest.mark.parametrize(
    ("vector", "azimuth_deg", "elevation_deg"),
    [
        ((3.0, 0.0, 0.0), 0.0, 0.0),
        ((0.0, 2.0, 0.0), 90.0, 0.0),  # east is clockwise from north
        ((1.0, 0.0, -1.0), 0.0, 45.0),  # up is negative down
        ((-1.0, 0.0, 1.0), 180.0, -45.0),
    ],
)
def test_an_axis_along_a_vector(
    vector: tuple[float, float, float], azimuth_deg: float, elevation_deg: float
) -> None:
    axis = along(vector)

    assert math.degrees(axis.azimuth_rad) == pytest.approx(azimuth_deg)
    assert math.degrees(axis.elevation_rad) == pytest.approx(elevation_deg)
    length = math.hypot(*vector)
    assert axis.unit_ned == pytest.approx([one / length for one in vector], abs=1e-12)


@pytest.mark.parametrize(
    "quaternion",
    [(0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0, 0, 0)],
)
def test_what_is_no_rotation_has_no_axis(quaternion: tuple[float, ...]) -> None:
    assert axis_of(quaternion) is None


@pytest.mark.parametrize(
    ("other", "apart_deg"),
    [((5.0, 0.0, 0.0), 0.0), ((0.0, 0.0, -1.0), 90.0), ((-1.0, 1.0, 0.0), 135.0)],
)
def test_two_directions_are_apart_by_an_angle_however_long_they_are(
    other: tuple[float, float, float], apart_deg: float
) -> None:
    assert apart_rad((0.1, 0.0, 0.0), other) == pytest.approx(math.radians(apart_deg))
    assert apart_rad((0.0, 0.0, 0.0), other) == pytest.approx(math.pi / 2.0)
