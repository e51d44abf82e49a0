"""Fuzzing of the byte entry and of the parameter store, from a fixed seed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.seconds(20)
FUZZ = Path(__file__).resolve().parent / "fuzz"


@pytest.mark.parametrize("inputs", ["--few", pytest.param("--inputs", marks=pytest.mark.long)])
def test_some_thousand_inputs_break_nothing(inputs: str) -> None:
    done = subprocess.run(
        [sys.executable, str(FUZZ / "run.py"), inputs],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
