"""The core's own unit tests, built with the sanitizers and run by CTest."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "core_tests"


def run(*command: str) -> str:
    """Run a tool of this environment; its words, if it fails, are the test's failure."""
    tool = shutil.which(command[0], path=str(Path(sys.executable).parent)) or command[0]
    done = subprocess.run(
        [tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_core_behaves_and_the_sanitizers_are_silent() -> None:
    run("cmake", "-S", "tests/firmware", "-B", str(BUILD), "-G", "Ninja")
    run("cmake", "--build", str(BUILD))
    run("ctest", "--test-dir", str(BUILD), "--output-on-failure")
