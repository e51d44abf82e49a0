"""The product's own verbs as processes: what a user runs, and nothing else."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest

from ..system.field import Process

# Whatever kills the suite ends what it has started, too.
UNDER = ("setpriv", "--pdeathsig", "KILL", "--")
PATIENCE_S = 60.0
VERB_S = 240.0


class Tool(Process):
    """A verb that runs until it is ended; events and rows as JSON lines."""

    def __init__(self, *arguments: str) -> None:
        self._arguments = arguments
        self.name = arguments[0]
        super().__init__(*arguments, under=UNDER)

    def wait_for(
        self, told: Callable[[str], bool], since: int = 0, within_s: float = PATIENCE_S
    ) -> int:
        """As `Process.wait_for`, with the patience that a flight needs."""
        until_s = time.monotonic() + within_s
        with self._news:
            while True:
                for number, line in enumerate(self.lines[since:], since):
                    if told(line):
                        return number
                if time.monotonic() > until_s or not self._reader.is_alive():
                    said = "\n".join(self.lines[-40:])
                    pytest.fail(
                        f"echowing {' '.join(self._arguments)}: never told; it said:\n{said}"
                    )
                self._news.wait(0.5)

    def rows(self) -> list[dict[str, Any]]:
        """The rows so far."""
        return [record for record in self._records() if "state" in record]

    def events(self, since: int = 0) -> list[str]:
        """What it has reported so far, from a line on."""
        return [record["event"] for record in self._records(since) if "event" in record]

    def _records(self, since: int = 0) -> list[dict[str, Any]]:
        return [json.loads(line) for line in list(self.lines)[since:] if line.startswith("{")]

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None


def run(*arguments: str, code: int | None = 0, within_s: float = VERB_S) -> str:
    """Run a verb to its end and return all that it said; `code` None: whatever it ends with."""
    ended = subprocess.run(
        [*UNDER, sys.executable, "-m", "echowing", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=within_s,
        check=False,
    )
    if code is not None and ended.returncode != code:
        pytest.fail(
            f"echowing {' '.join(arguments)}: exit code {ended.returncode}, {code} was expected; "
            f"it said:\n{ended.stdout}"
        )
    return ended.stdout


def first_json(text: str) -> Any:
    """The first JSON object in what a verb has printed."""
    return json.JSONDecoder().raw_decode(text[text.index("{") :])[0]


def simulated(changes: list[str], scenario: str, seed: int) -> dict[str, Any]:
    """The built-in simulator's figures of a flight."""
    settings = [part for change in changes for part in ("--set", change)]
    said = run("sim", scenario, "--seed", str(seed), "--json", *settings)
    figures: dict[str, Any] = first_json(said)
    return figures


def port_told(emulator: Tool) -> int:
    """The port on which an emulator takes target datagrams."""
    number = emulator.wait_for(lambda line: line.startswith("target datagrams"))
    found = re.search(r":(\d+)$", emulator.lines[number])
    assert found is not None
    return int(found[1])
