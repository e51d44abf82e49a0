"""The gimbal's search: the twelve points as the firmware has them, and what they cover.

The points' home is the firmware's scan table (`kCells`), their pulses its parameter table.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from echowing.errors import EchowingError
from echowing.paths import shipped

GRID_STEP_DEG = 0.1  # an area error under 0.1 % for a 20 degree beam


@dataclass(frozen=True, slots=True)
class Aim:
    """Where the gimbal looks: degrees right and up of straight ahead."""

    right_deg: float
    up_deg: float


@dataclass(frozen=True, slots=True)
class Coverage:
    """Solid angles of one beam and of the whole search, steradians."""

    one_sr: float
    all_sr: float

    @property
    def gain_percent(self) -> float:
        """What the search adds to a beam that stands still."""
        return 100.0 * (self.all_sr / self.one_sr - 1.0)


@cache
def parameter_defaults() -> Mapping[str, float]:
    """The co-processor's default parameters by name.

    Raises EchowingError when the firmware's parameter table is missing or has no rows.
    """
    return dict(_parameter_rows().values())


@cache
def point_parameters() -> tuple[tuple[str, str], ...]:
    """Of each point, in order, the names of the parameters that hold its pan and tilt pulse.

    Raises EchowingError when the firmware's scan table is missing or has no points.
    """
    source = _read("scan.cpp")
    rows = _parameter_rows()
    names = {
        alias: rows[identifier][0]
        for alias, identifier in re.findall(r"Parameter (k\w+) = Parameter::(k\w+);", source)
    }
    table = re.search(r"kCells\[.*?=\s*\{(.*?)\};", source, re.DOTALL)
    cells = re.findall(r"\{(k\w+),\s*(k\w+)\}", table.group(1)) if table else []
    if not cells:
        raise EchowingError(f"{shipped('scan.cpp')}: no table kCells of scan points")
    return tuple((names[pan], names[tilt]) for pan, tilt in cells)


def scan_pulses_us(parameters: Mapping[str, float] | None = None) -> list[tuple[float, float]]:
    """The search's points in order, (pan, tilt) pulses, of a board with these parameters.

    Without parameters: of a board with its defaults.
    """
    values = parameter_defaults() if parameters is None else parameters
    return [(values[pan], values[tilt]) for pan, tilt in point_parameters()]


def aims(
    pulses_us: Sequence[tuple[float, float]],
    centre_us: tuple[float, float],
    us_per_deg: tuple[float, float],
) -> list[Aim]:
    """Pulses (pan, tilt) as directions; with positive scales they grow to the right and upwards."""
    (pan_centre, tilt_centre), (pan_scale, tilt_scale) = centre_us, us_per_deg
    return [
        Aim((pan - pan_centre) / pan_scale, (tilt - tilt_centre) / tilt_scale)
        for pan, tilt in pulses_us
    ]


def covered(
    looked: Sequence[Aim], half_angle_deg: float, step_deg: float = GRID_STEP_DEG
) -> Coverage:
    """What cones about `looked` cover together, on the sphere about the sonar.

    looked: directions of the search. half_angle_deg: of the beam, taken as a cone. step_deg: of the
    grid that is counted.
    """
    reach = half_angle_deg + max(max(abs(aim.right_deg), abs(aim.up_deg)) for aim in looked) + 1.0
    line = np.radians(np.arange(-reach, reach + step_deg / 2, step_deg))
    right, up = np.meshgrid(line, line)
    looks = np.stack(_direction(right, up), axis=-1)
    cell_sr = np.radians(step_deg) ** 2 * np.cos(up)

    def within(group: Sequence[Aim]) -> float:
        axes = [_direction(np.radians(aim.right_deg), np.radians(aim.up_deg)) for aim in group]
        nearest = np.max(looks @ np.array(axes).T, axis=-1)
        return float(cell_sr[nearest >= np.cos(np.radians(half_angle_deg))].sum())

    return Coverage(within([Aim(0.0, 0.0)]), within(looked))


def _direction(right: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.cos(up) * np.cos(right), np.cos(up) * np.sin(right), np.sin(up)


@cache
def _parameter_rows() -> Mapping[str, tuple[str, float]]:
    """Identifier in the firmware -> name and default."""
    rows = re.findall(
        r'^ECHOWING_PARAMETER\((k\w+), "(\w+)", ([-\d.]+)',
        _read("parameter_table.h"),
        re.MULTILINE,
    )
    if not rows:
        raise EchowingError(f"{shipped('parameter_table.h')}: no rows ECHOWING_PARAMETER(...)")
    return {identifier: (name, float(value)) for identifier, name, value in rows}


def _read(name: str) -> str:
    path = shipped(name)
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{path} cannot be read ({error.strerror})") from error
