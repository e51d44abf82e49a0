"""`echowing emulator` as a process of its own."""

import re
import signal
import subprocess
import sys
from pathlib import Path

# Generous: a busy machine may take its time, a broken emulator takes for ever.
PATIENCE_S = 120.0


class Emulator:
    """The process, and what it says."""

    def __init__(self, *options: str | Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "echowing.cli", "emulator", *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def told(self, pattern: str) -> str:
        """The first group of the next line that matches."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(pattern, line):
                return found[1]
        raise AssertionError(f"never said {pattern!r}: {self.stop()}")

    def stop(self) -> str:
        """Interrupt it as a user would; returns what it complained of."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=PATIENCE_S)[1]
