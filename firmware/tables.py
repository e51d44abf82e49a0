"""Bring the tables of README.md up to date with the firmware: tables.py [--check].

Parameters come from src/core/parameter_table.h, wiring from src/board/pin_table.h, commands from
src/core/command_table.h. With --check nothing is written and the exit code is 1 if they differ.
"""

import re
import sys
from pathlib import Path

FIRMWARE = Path(__file__).resolve().parent
README = FIRMWARE / "README.md"
SOURCE = FIRMWARE / "echowing" / "src"

BOARDS = {
    "mega": "Arduino Mega 2560",
    "blackpill_f411": "WeAct Black Pill F411CE",
    "bluepill_f103": "Blue Pill F103C8",
    "nucleo_f446": "ST Nucleo F446RE",
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
    text = (SOURCE / "board" / "pin_table.h").read_text()
    found = dict(re.findall(r"^ECHOWING_PINS_(\w+)\((.*)\)$", text, re.MULTILINE))
    pins = {board: [pin.strip() for pin in found[board].split(",")] for board in BOARDS}
    lines = [
        "| connection | " + " | ".join(BOARDS.values()) + " |",
        "|---|" + "---|" * len(BOARDS),
    ]
    for row, role in enumerate(ROLES):
        lines.append(f"| {role} | " + " | ".join(pins[board][row] for board in BOARDS) + " |")
    return "\n".join(lines)


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
    before = README.read_text()
    after = filled(before)
    if "--check" in sys.argv[1:]:
        return int(before != after)
    README.write_text(after)
    return 0


if __name__ == "__main__":
    sys.exit(main())
