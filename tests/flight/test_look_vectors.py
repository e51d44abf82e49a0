"""The geometry of looking, by the vectors that the applet is tested with, too."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from echowing.flight.axis import along, axis_of, spread_rad, turns_rps

VECTORS = tomllib.loads(Path(__file__).with_name("look.toml").read_text(encoding="utf-8"))["look"]
TO_1E4_DEG = 6e-5  # half of the last digit that the table gives


def down(vector: list[float]) -> tuple[float, float, float]:
    north, east, up = vector
    return north, east, -up


@pytest.mark.parametrize("row", VECTORS)
def test_a_look_is_the_tables(row: dict[str, Any]) -> None:
    to_it_m, past_mps = down(row["to_it_m"]), down(row["past_mps"])
    axis = along(to_it_m)
    azimuth_rps, elevation_rps = turns_rps(to_it_m, past_mps)
    unsure_rad = spread_rad(row["unsure_m"], to_it_m)

    for told_rad, name in (
        (axis.azimuth_rad, "azimuth_deg"),
        (axis.elevation_rad, "elevation_deg"),
        (azimuth_rps, "azimuth_dps"),
        (elevation_rps, "elevation_dps"),
        (unsure_rad, "unsure_deg"),
    ):
        assert math.degrees(told_rad) == pytest.approx(row[name], abs=TO_1E4_DEG), name
    assert axis.quaternion == pytest.approx(row["quaternion"], abs=6e-6)


@pytest.mark.parametrize("row", VECTORS)
def test_a_quaternion_is_the_tables_axis(row: dict[str, Any]) -> None:
    axis = axis_of(row["quaternion"])

    assert axis is not None
    assert math.degrees(axis.azimuth_rad) == pytest.approx(row["azimuth_deg"], abs=2e-3)
    assert math.degrees(axis.elevation_rad) == pytest.approx(row["elevation_deg"], abs=2e-3)
