"""The bench on which a procedure runs: board, operator and clock; and how to run it."""

import contextlib
import json
import math
import queue
import signal
import sys
import threading
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from echowing.analysis.page import told
from echowing.errors import EchowingError
from echowing.rig.board import Board, ScanMode, open_board
from echowing.rig.result import EXIT_CODES, Result, prepare_folder, write_result

EXIT_INTERRUPTED = 130
# How often a wait looks at its end: quick for a person, slow for a processor.
POLL_S = 0.05
# From the farthest point of the search: 100 us at the board's SERVO_RATE of 2500 us/s, and the
# readings that were begun meanwhile (100 ms to full range).
SETTLE_S = 0.25


class Procedure(Protocol):
    """A guided test: measures step by step, and can report its findings at any time."""

    def run(self, bench: "Bench") -> None:
        """Measure; EchowingError or KeyboardInterrupt stop it."""

    def result(self) -> Result:
        """The judged measurements so far."""


class Operator:
    """The person who moves the target. Answers are lines of `answers`; `yes`: no questions."""

    def __init__(self, console: Console, answers: TextIO, *, yes: bool = False) -> None:
        self.console = console
        self._yes = yes
        self._answers = answers
        self._lines: queue.Queue[str] = queue.Queue()
        self._reader: threading.Thread | None = None

    def tell(self, text: str) -> None:
        """Print a line for the operator."""
        self.console.print(text, highlight=False, markup=False)

    def ask(self, text: str, meanwhile: Callable[[], str]) -> None:
        """Say what to do and wait for Enter; `meanwhile` keeps the board going and reports."""
        if self._yes:
            self.tell(text)
            return
        self.tell(f"{text} Then press Enter.")
        self._listen()
        with self._status() as show:
            while self._lines.empty():
                show(meanwhile())
        if not self._lines.get():
            raise EchowingError("no answer: the input has ended; with --yes nothing is asked")

    @contextlib.contextmanager
    def progress(
        self, text: str, total: float, unit: str = "s"
    ) -> Iterator[Callable[[float, str], None]]:
        """A bar that gets how much of `total` is done, and a status text."""
        if not self.console.is_terminal:
            self.tell(f"{text}, {total:g} {unit}")
            yield lambda done, words: None
            return
        columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
        with Progress(*columns, console=self.console, transient=True) as bar:
            task = bar.add_task(text, total=total)
            yield lambda done, words: bar.update(
                task, completed=done, description=f"{text}  {words}"
            )

    @contextlib.contextmanager
    def _status(self) -> Iterator[Callable[[str], None]]:
        if not self.console.is_terminal:
            yield lambda text: None
            return
        with self.console.status("") as status:
            yield status.update

    def _listen(self) -> None:
        """A thread reads the lines, so that a waiting terminal does not keep the board waiting."""
        if self._reader is None:
            self._reader = threading.Thread(target=self._read, daemon=True)
            self._reader.start()

    def _read(self) -> None:
        for line in self._answers:
            self._lines.put(line)
        self._lines.put("")  # the end; answered lines have at least their line feed


def ignore(message: Any) -> None:
    """Ignore the message."""


class Bench:
    """What a procedure works with. clock: seconds, the same as the board's arrival times."""

    def __init__(
        self,
        board: Board,
        operator: Operator,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.board = board
        self.operator = operator
        self.clock = clock
        self.pause = pause
        self.connected = True

    def ask(self, text: str, hear: Callable[[Any], None] = ignore) -> None:
        """Have the operator do something; the board's messages meanwhile go to `hear`."""

        def meanwhile() -> str:
            for message in self.heard(POLL_S):
                hear(message)
            return standing(self.board)

        self.operator.ask(text, meanwhile)
        for message in self.heard(0.0):
            hear(message)

    def listen(self, text: str, duration_s: float) -> Iterator[Any]:
        """The board's messages as they arrive, for this time."""
        start_s = self.clock()
        with self.operator.progress(text, duration_s) as show:
            while (done_s := self.clock() - start_s) < duration_s:
                show(done_s, standing(self.board))
                yield from self.heard(POLL_S)

    def heard(self, timeout_s: float) -> list[Any]:
        """The board's own messages; others share some ports."""
        board = self.board
        return [message for message in board.poll(timeout_s) if board.is_from_board(message)]

    def centre(self) -> None:
        """Centre the gimbal and wait; messages received meanwhile are dropped."""
        self.board.scan(ScanMode.CENTRE)
        self._settle()

    def _settle(self) -> None:
        end_s = self.clock() + SETTLE_S
        while self.clock() < end_s:
            self.board.poll(POLL_S)

    def aim(self, pan_us: float, tilt_us: float) -> None:
        """Point the gimbal there and wait; messages received meanwhile are dropped."""
        self.board.aim(pan_us, tilt_us)
        self._settle()

    def search(self) -> None:
        """The gimbal searches, and holds still on what it detects."""
        self.board.scan(ScanMode.SCAN)

    def leave(self) -> None:
        """Centre the gimbal, and let the board scan as in flight, if it is connected."""
        if not self.connected:
            return
        self.board.scan(ScanMode.CENTRE)
        self.board.scan(ScanMode.AUTO)


def standing(board: Board) -> str:
    """The board's state, in a few words."""
    state = board.state
    raw = "nothing detected" if state.raw_m is None else f"{state.raw_m:.2f} m"
    average = "" if state.range_m is None else f", average {state.range_m:.2f} m"
    return f"{raw}{average}, {state.state}"


def add_bench_arguments(parser: ArgumentParser) -> None:
    """Options that every procedure has."""
    parser.add_argument(
        "--out", type=Path, default=Path("out/rig"), metavar="DIR", help="results (out/rig)"
    )
    parser.add_argument("--yes", action="store_true", help="ask nothing: everything is in place")


def positive(text: str) -> float:
    """A number over 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f"{text!r}: a number over 0")
    return value


def whole(text: str) -> int:
    """A whole number from 1 on, for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r}: a whole number from 1 on")
    return int(text)


def perform(procedure: Procedure, args: Namespace) -> int:
    """Run a procedure on the board; the result is always written. Returns exit code."""
    console = Console(stderr=args.json, soft_wrap=True)
    # Whoever stops it shall find the result and the gimbal as after Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    prepare_folder(args.out)
    board = open_board(args.port, args.baud)
    bench = Bench(board, Operator(console, sys.stdin, yes=args.yes))
    try:
        version = board.version()
        firmware = f"{version.firmware} {version.git_hash}"
        result, code = run_to_result(procedure, bench)
        result.facts = {**result.facts, "firmware": firmware}
    finally:
        bench.board.close()  # another one than before where it was unplugged
    document, shown = write_result(result, args.out)
    result.show(console)
    console.print(f"{document}, {told(shown)}", style="dim", highlight=False, markup=False)
    if args.json:
        print(json.dumps(result.document(), allow_nan=False))
    return code


def run_to_result(procedure: Procedure, bench: Bench) -> tuple[Result, int]:
    """Run it; returns the result, complete or not, and the exit code. Releases the board."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    why, code = None, None
    try:
        procedure.run(bench)
    except KeyboardInterrupt:
        why, code = "interrupted", EXIT_INTERRUPTED
    except EchowingError as error:
        why = str(error)
    with contextlib.suppress(EchowingError, KeyboardInterrupt):  # gone, or flying: not ours to turn
        bench.leave()
    result = procedure.result()
    if why is not None:
        result.incomplete = why
    result.facts = {
        "started": started,
        "board": bench.board.name,
        "system": str(bench.board.system_id),
        "component": str(bench.board.component_id),
    }
    return result, EXIT_CODES[result.verdict] if code is None else code
