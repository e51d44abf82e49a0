"""Fuzzing of the byte entry and of the parameter store, from a fixed seed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.seconds(40)
FUZZ = Path(__file__).resolve().parent / "fuzz"


def test_some_thousand_inputs_break_nothing() -> None:
    done = subprocess.run(
        [sys.executable, str(FUZZ / "run.py"), "--inputs"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
