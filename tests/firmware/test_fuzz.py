"""A minute of fuzzing of the byte entry and of the parameter store, from a fixed seed."""

import subprocess
import sys
from pathlib import Path

FUZZ = Path(__file__).resolve().parent / "fuzz"


def test_a_minute_of_fuzzing_breaks_nothing() -> None:
    done = subprocess.run(
        [sys.executable, str(FUZZ / "run.py"), "60"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
