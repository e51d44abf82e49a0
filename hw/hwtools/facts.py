"""Where the hardware room's facts live, and how to read those that live in other rooms."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from echowing.sim import sonar

HW = Path(__file__).resolve().parents[1]
ROOT = HW.parent
WIRING = HW / "wiring"
MOUNT = HW / "mount"
PICTURES = HW / "pictures"
FIRMWARE = ROOT / "firmware" / "echowing" / "src"


class HardwareError(Exception):
    """A source in `hw/` (or one it reads) is not as expected: what, where, what to do."""


@dataclass(frozen=True, slots=True)
class Aim:
    """Where the gimbal looks: degrees right and up of straight ahead."""

    right_deg: float
    up_deg: float


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


def scan_pulses_us() -> list[tuple[float, float]]:
    """Return the search's points in order, (pan, tilt) pulses, from the firmware's scan table."""
    source = read(FIRMWARE / "core" / "scan.cpp")
    normal = _parameter_defaults()
    role = {
        alias: normal[parameter]
        for alias, parameter in re.findall(r"Parameter (k\w+) = Parameter::(k\w+);", source)
    }
    table = re.search(r"kCells\[.*?=\s*\{(.*?)\};", source, re.DOTALL)
    cells = re.findall(r"\{(k\w+),\s*(k\w+)\}", table.group(1)) if table else []
    if not cells:
        raise HardwareError(f"{FIRMWARE / 'core' / 'scan.cpp'}: no table kCells of scan points")
    return [(role[pan], role[tilt]) for pan, tilt in cells]


def scan_aims() -> list[Aim]:
    """Return the search's points as directions; pulses grow to the right and upwards."""
    normal = _parameter_defaults()
    return [
        Aim(
            (pan_us - normal["kPanMiddle"]) / sonar.SERVO_US_PER_DEG,
            (tilt_us - normal["kTiltMiddle"]) / sonar.SERVO_US_PER_DEG,
        )
        for pan_us, tilt_us in scan_pulses_us()
    ]


def beam_half_angle_deg() -> float:
    """Return the sonar's beam half-angle, from the simulator's sonar."""
    return sonar.BEAM_HALF_ANGLE_DEG


def lever_arm_mm() -> float:
    """Return how far the sonar's face is ahead of the aircraft's centre, from the simulator."""
    return sonar.LEVER_ARM_M * 1000.0


def _parameter_defaults() -> dict[str, float]:
    table = read(FIRMWARE / "core" / "parameter_table.h")
    rows = re.findall(r'^ECHOWING_PARAMETER\((k\w+), "[^"]*", ([-\d.]+)', table, re.MULTILINE)
    return {identifier: float(value) for identifier, value in rows}


def _words(listed: str) -> list[str]:
    return [word.strip() for word in listed.split(",")]
