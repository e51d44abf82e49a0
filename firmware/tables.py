"""Bring the tables of README.md and sketch.yaml up to date with the firmware: tables.py [--check].

Parameters come from src/core/parameter_table.h, wiring and profiles from src/board/boards, commands
from src/core/command_table.h. With --check nothing is written: the exit code is 1 if they differ.
"""

import re
import sys
from pathlib import Path

from echowing.sim.boards import firmware

FIRMWARE = Path(__file__).resolve().parent
README = FIRMWARE / "README.md"
SOURCE = FIRMWARE / "echowing" / "src"

PROFILES = FIRMWARE / "echowing" / "sketch.yaml"

# The cores that the profiles pin; an index where Arduino's own does not have them.
CORES = {
    firmware.AVR: ("arduino:avr (1.8.6)", None),
    firmware.STM32: (
        "STMicroelectronics:stm32 (2.12.0)",
        "https://github.com/stm32duino/BoardManagerFiles/raw/main/package_stmicroelectronics_index.json",
    ),
}
ROLES = (
    "pan servo, signal",
    "tilt servo, signal",
    "sonar SDA (its pin 4)",
    "sonar SCL (its pin 5)",
    "from the autopilot's TX",
    "to the autopilot's RX",
    "status LED",
)


def parameters() -> str:
    """The parameter table."""
    text = (SOURCE / "core" / "parameter_table.h").read_text()
    rows = re.findall(
        r'^ECHOWING_PARAMETER\(\w+, "(\w+)", ([-\d.]+), ([-\d.]+), ([-\d.]+), (\w+), (\w+),'
        r' "(.*?)", "(.*)"\)$',
        text,
        re.MULTILINE,
    )
    lines = [
        "| name | default | least | most | unit | in flight | what it does |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, normal, least, most, whole, in_flight, unit, what in rows:
        kind = "" if whole == "true" else " (fractions allowed)"
        flight = "yes" if in_flight == "true" else ""
        lines.append(
            f"| `{name}` | {normal} | {least} | {most} | {unit} | {flight} | {what}{kind} |"
        )
    return "\n".join(lines)


def wiring() -> str:
    """Pins of every board, a row a connection."""
    boards = firmware.BOARDS.values()
    lines = [
        "| connection | " + " | ".join(board.title for board in boards) + " |",
        "|---|" + "---|" * len(boards),
    ]
    for name, role in zip(firmware.PINS, ROLES, strict=True):
        lines.append(f"| {role} | " + " | ".join(board.pins[name] for board in boards) + " |")
    return "\n".join(lines)


def profiles() -> str:
    """The file with arduino-cli's profiles."""
    lines = [
        "# Boards and the exact cores they are compiled with: arduino-cli compile --profile NAME",
        "# Written by firmware/tables.py from src/board/boards.",
        "profiles:",
    ]
    for board in firmware.BOARDS.values():
        core, index = CORES[board.family]
        lines += [
            f"  {board.name}:",
            f"    fqbn: {board.fqbn}",
            "    platforms:",
            f"      - platform: {core}",
            *([f"        platform_index_url: {index}"] if index else []),
        ]
    return "\n".join([*lines, f"default_fqbn: {firmware.BOARDS['mega'].fqbn}", ""])


def commands() -> str:
    """The commands understood."""
    text = (SOURCE / "core" / "command_table.h").read_text()
    rows = re.findall(r'^ECHOWING_COMMAND\((\w+), (\d+), (\w+), "(.*)"\)$', text, re.MULTILINE)
    lines = ["| number | what | in flight | parameters |", "|---|---|---|---|"]
    for name, number, in_flight, what in rows:
        flight = "yes" if in_flight == "true" else ""
        lines.append(f"| {number} | {name.replace('_', ' ')} | {flight} | {what} |")
    return "\n".join(lines)


def filled(text: str) -> str:
    """The text with the tables between its markers renewed."""
    tables = {"wiring": wiring(), "parameters": parameters(), "commands": commands()}
    for name, table in tables.items():
        start, end = f"<!-- {name} -->\n", "<!-- end -->"
        before, found, rest = text.partition(start)
        if not found or end not in rest:
            raise SystemExit(f"{README}: the markers {start.strip()} and {end} are missing")
        text = before + start + table + "\n" + rest[rest.index(end) :]
    return text


def main() -> int:
    """Write, or check."""
    wanted = {README: filled(README.read_text()), PROFILES: profiles()}
    stale = [path for path, text in wanted.items() if path.read_text() != text]
    if "--check" in sys.argv[1:]:
        return int(bool(stale))
    for path in stale:
        path.write_text(wanted[path])
    return 0


if __name__ == "__main__":
    sys.exit(main())
