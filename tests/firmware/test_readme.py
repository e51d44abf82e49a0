"""The tables of firmware/README.md say what the firmware does."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from echowing.errors import EchowingError
from echowing.sim.boards.coprocessor import parameter_table
from echowing.sim.boards.firmware import BOARD_FILES, BOARDS, read_board

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
    text = (FIRMWARE / "README.md").read_text()
    for board in BOARDS.values():
        assert f"| {board.title} |" in text
        assert f"| {board.name} |" in text


def test_every_board_s_file_is_taken_by_the_sketch() -> None:
    row = FIRMWARE / "echowing" / "src" / "board" / "board_here.h"
    taken = re.findall(r'^#include "boards/(\w+)\.h"$', row.read_text(), re.MULTILINE)
    assert sorted(taken) == sorted(BOARDS)


def test_servo_outputs_are_the_servo_pins() -> None:
    # The core names a pin PA7, and what it can do PA_7, PA_7_ALT1...: the file says both.
    for board in BOARDS.values():
        told = (BOARD_FILES / f"{board.name}.h").read_text()
        for servo, pin in (("PAN", board.pins["PAN"]), ("TILT", board.pins["TILT"])):
            for port, number in re.findall(rf"{servo}_OUTPUT P(\w)_(\d+)", told):
                assert pin == f"P{port}{number}"


def test_board_file_without_a_line_is_told(tmp_path: Path) -> None:
    told = (BOARD_FILES / "mega.h").read_text()
    for line, words in (("PIN_SCL 21", "'PIN_SCL' is missing"), ("8192", "no number")):
        (tmp_path / "mega.h").write_text(told.replace(f"{line}\n", "x\n").replace("SCL x", "x"))
        with pytest.raises(EchowingError, match=words):
            read_board(tmp_path / "mega.h")
