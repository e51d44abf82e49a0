"""Where the hardware room's facts live, and how to read those that live in other rooms."""

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from echowing.flight.sonar import SERVO_US_PER_DEG
from echowing.rig import search
from echowing.rig.search import Aim
from echowing.sim.boards import firmware
from echowing.sim.world import sonar

HW = Path(__file__).resolve().parents[1]
ROOT = HW.parent
WIRING = HW / "wiring"
MOUNT = HW / "mount"
PICTURES = HW / "pictures"
# What a pin is for, and its name in the boards' files of the firmware.
PIN_ROLES = {
    "pan": "PAN",
    "tilt": "TILT",
    "i2c_data": "SDA",
    "i2c_clock": "SCL",
    "link_rx": "RX",
    "link_tx": "TX",
    "led": "LED",
}


class HardwareError(Exception):
    """A source in `hw/` (or one it reads) is not as expected: what, where, what to do."""


def load(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        HardwareError: the file is missing or is not TOML.

    """
    try:
        return tomllib.loads(read(path))
    except tomllib.TOMLDecodeError as error:
        raise HardwareError(f"{path} is not TOML: {error}") from error


def read(path: Path) -> str:
    """Read a text file.

    Raises:
        HardwareError: it is missing or cannot be read.

    """
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise HardwareError(f"{path} cannot be read ({error.strerror})") from error


def firmware_pins() -> dict[str, dict[str, str]]:
    """Return the firmware's pins: board, then what a pin is for, then the board's name of it."""
    return {
        board.name: {role: board.pins[pin] for role, pin in PIN_ROLES.items()}
        | {"led_on_level": board.led_on}
        for board in firmware.BOARDS.values()
    }


@dataclass(frozen=True, slots=True)
class Reach:
    """How far the gimbal may turn to each side, and up and down."""

    pan_deg: float
    tilt_deg: float


def gimbal_reach() -> Reach:
    """Return the reach of a board with its defaults, from the firmware's parameter table."""
    normal = search.parameter_defaults()
    return Reach(normal["PAN_REACH"], normal["TILT_REACH"])


def scan_aims() -> list[Aim]:
    """Return the search's points as directions; pulses grow to the right and upwards."""
    normal = search.parameter_defaults()
    centre_us = (normal["PAN_MIDDLE"], normal["TILT_MIDDLE"])
    scales = (SERVO_US_PER_DEG, SERVO_US_PER_DEG)
    return search.aims(search.scan_pulses_us(), centre_us, scales)


def beam_half_angle_deg() -> float:
    """Return the sonar's beam half-angle, from the simulator's sonar on a desk."""
    return math.degrees(sonar.ON_A_DESK.widest_rad)
