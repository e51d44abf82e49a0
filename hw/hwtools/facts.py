"""Where the hardware room's facts live, and how to read those that live in other rooms."""

import re
import tomllib
from pathlib import Path
from typing import Any

from echowing import search
from echowing.search import Aim
from echowing.sim import sonar

HW = Path(__file__).resolve().parents[1]
ROOT = HW.parent
WIRING = HW / "wiring"
MOUNT = HW / "mount"
PICTURES = HW / "pictures"
FIRMWARE = ROOT / "firmware" / "echowing" / "src"


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
    """Return the firmware's pin table: board, then name as the table's heading has it, then pin.

    Raises:
        HardwareError: the table or its heading is missing.

    """
    path = FIRMWARE / "board" / "pin_table.h"
    source = read(path)
    heading = re.search(r"^// ECHOWING_PINS_board\((.*)\)", source, re.MULTILINE)
    rows = re.findall(r"^ECHOWING_PINS_(\w+)\((.*)\)", source, re.MULTILINE)
    if heading is None or not rows:
        raise HardwareError(f"{path}: no rows ECHOWING_PINS_board(...) under their heading")
    names = _words(heading.group(1))
    return {board: dict(zip(names, _words(pins), strict=True)) for board, pins in rows}


def scan_aims() -> list[Aim]:
    """Return the search's points as directions; pulses grow to the right and upwards."""
    normal = search.parameter_defaults()
    centre_us = (normal["PAN_MIDDLE"], normal["TILT_MIDDLE"])
    scales = (sonar.SERVO_US_PER_DEG, sonar.SERVO_US_PER_DEG)
    return search.aims(search.scan_pulses_us(), centre_us, scales)


def beam_half_angle_deg() -> float:
    """Return the sonar's beam half-angle, from the simulator's sonar."""
    return sonar.BEAM_HALF_ANGLE_DEG


def lever_arm_mm() -> float:
    """Return how far the sonar's face is ahead of the aircraft's centre, from the simulator."""
    return sonar.LEVER_ARM_M * 1000.0


def _words(listed: str) -> list[str]:
    return [word.strip() for word in listed.split(",")]
