"""The tables of firmware/README.md say what the firmware does."""

import subprocess
import sys
from pathlib import Path

from echowing.firmware import BOARDS
from echowing.sim.coprocessor import parameter_table

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def test_tables_are_up_to_date() -> None:
    done = subprocess.run([sys.executable, str(FIRMWARE / "tables.py"), "--check"], check=False)
    assert done.returncode == 0, "run `python firmware/tables.py`"


def test_every_parameter_is_there_with_its_default_and_limits() -> None:
    text = (FIRMWARE / "README.md").read_text()
    for row in parameter_table():
        start = f"| `{row.name}` | {row.default:g} | {row.least:g} | {row.most:g} | {row.unit} |"
        assert start in text


def test_every_board_has_its_pins_and_its_size() -> None:
    pins = (FIRMWARE / "echowing" / "src" / "board" / "pin_table.h").read_text()
    text = (FIRMWARE / "README.md").read_text()
    for board in BOARDS:
        assert f"ECHOWING_PINS_{board}(" in pins
        assert f"| {board} |" in text
