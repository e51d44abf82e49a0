"""The servos' figures, from `servos.toml`."""

import math
from typing import Any

from echowing.geo import GRAVITY_MPS2
from hwtools.facts import HW, load

SOURCE = HW / "servos.toml"
KGF_CM = GRAVITY_MPS2 * 0.01  # newton metres


class Servo:
    """The chosen servo."""

    def __init__(self) -> None:
        table = load(SOURCE)
        self._rows: dict[str, Any] = table[table["chosen"]]

    def __getattr__(self, name: str) -> float:
        return float(self._rows[name]["value"])

    @property
    def title(self) -> str:
        """Its name."""
        return str(self._rows["name"])

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Its figures, each with value, unit, what, source."""
        return [row for row in self._rows.values() if isinstance(row, dict)]

    @property
    def us_per_deg(self) -> float:
        """How much longer a pulse turns it by a degree."""
        return self.travel_us / self.travel_deg

    @property
    def fastest_dps(self) -> float:
        """Its speed without load."""
        return 60.0 / self.speed

    @property
    def stall_nm(self) -> float:
        """Its torque at a standstill, newton metres."""
        return self.stall_torque * KGF_CM

    def torque_nm(self, speed_dps: float) -> float:
        """The torque that is left at a speed: a brushed motor's falls in a straight line."""
        return self.stall_nm * max(0.0, 1.0 - speed_dps / self.fastest_dps)


def duty() -> dict[str, Any]:
    """Return how hard the gimbal works."""
    return dict(load(SOURCE)["duty"])


def life() -> dict[str, float]:
    """Return after how many hours, and with how much play, a servo is changed."""
    return dict(load(SOURCE)["life"])


def seen() -> list[dict[str, Any]]:
    """Return what users saw of servos' lives."""
    return list(load(SOURCE)["seen"])


def others() -> list[dict[str, Any]]:
    """Return other servos that fit."""
    return list(load(SOURCE)["other"])


def radians_per_s2(duty_row: dict[str, Any]) -> float:
    """Return the acceleration at which the gimbal takes up its speed."""
    return math.radians(duty_row["steady_dps"]) / float(duty_row["start_s"])
