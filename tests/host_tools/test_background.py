"""Nothing that shows or logs holds up the loop that flies."""

import io
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.tool.background import BackgroundLog, BackgroundView, Worker
from echowing.tool.panel import Row

pytestmark = pytest.mark.seconds(10)

DEADLINE_S = 120.0
FOLLOW = [sys.executable, "-m", "echowing", "follow", "--json", "--no-log"]


class StoppedScreen:
    """Takes nothing until it is let go."""

    def __init__(self) -> None:
        self.goes, self.blocked = threading.Event(), threading.Event()
        self.shown: list[Any] = []

    def event(self, time_s: float, text: str) -> None:
        self.blocked.set()
        assert self.goes.wait(DEADLINE_S)
        self.shown.append(text)

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        self.event(time_s, f"rows of {time_s:g} s")

    def keys(self, text: str) -> None:
        self.event(0.0, text)

    def close(self) -> None:
        self.shown.append("closed")


def test_a_stopped_screen_holds_up_nobody_and_what_was_left_out_is_said() -> None:
    screen = StoppedScreen()
    view = BackgroundView(screen, most=4)
    view.event(0.0, "first")
    assert screen.blocked.wait(DEADLINE_S)
    for second in range(100):  # returns at all: the screen takes nothing
        view.event(float(second), f"event {second}")
        view.rows(float(second), [])
    screen.goes.set()
    view.settle(DEADLINE_S)
    view.rows(100.0, [])
    view.settle(DEADLINE_S)
    view.close()
    # Three events and the rows waited beside the first, of the rows the newest.
    shown = ["first", "event 0", "rows of 99 s", "event 1", "event 2"]
    assert screen.shown[:5] == shown
    assert screen.shown[5].endswith(
        "97 events and 99 updates of the table were left out; flying went on"
    )
    assert screen.shown[6:] == ["rows of 100 s", "closed"]
    assert not view.stuck


def test_a_screen_that_stays_stopped_does_not_hold_up_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("echowing.tool.background.LAST_WORDS_S", 0.01)
    screen = StoppedScreen()
    view = BackgroundView(screen)
    view.event(0.0, "first")
    view.close()
    assert view.stuck
    screen.goes.set()


def test_a_screen_that_has_gone_is_known_to_be_lost() -> None:
    class Gone(StoppedScreen):
        def event(self, time_s: float, text: str) -> None:
            raise BrokenPipeError(32, "Broken pipe")

    view = BackgroundView(Gone())
    assert view.lost is None
    view.event(0.0, "first")
    view.settle(DEADLINE_S)
    assert isinstance(view.lost, BrokenPipeError)
    view.close()


class SlowDisk:
    """A log on a disk that takes nothing until it is let go."""

    def __init__(self, say: Any) -> None:
        self.goes = threading.Event()
        self.frames: list[bytes] = []
        self.say = say

    def frame(self, unix_s: float, frame: bytes) -> None:
        assert self.goes.wait(DEADLINE_S)
        self.frames.append(frame)
        self.say("log: a word")

    def close(self) -> None:
        pass


def test_a_slow_disk_holds_up_nobody_and_what_is_missing_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("echowing.tool.background.MOST_LOGGED", 10)
    disks: list[SlowDisk] = []

    def open_log(say: Any) -> Any:
        disks.append(SlowDisk(say))
        return disks[0]

    log = BackgroundLog(open_log)
    for number in range(100):
        log.frame(0.0, bytes([number]))
    said: list[str] = []
    log.tell(said.append)
    assert said == []  # nothing can be said of what is not over
    disks[0].goes.set()
    log.close()
    log.tell(said.append)
    # Ten wait, and the first may have been taken out before the eleventh came.
    missing = 100 - len(disks[0].frames)
    assert missing in (89, 90)
    assert said[-1] == f"log: {missing} frames and rows are missing: the disk was too slow"
    assert said[0] == "log: a word"


def test_an_error_of_the_work_is_kept_and_the_rest_is_done() -> None:
    worker, done = Worker(10), []
    worker.do(lambda: done.append(1 // 0))
    assert worker.end(lambda: done.append(1), DEADLINE_S)
    assert done == [1]
    assert isinstance(worker.error, ZeroDivisionError)


@pytest.mark.parametrize("terminal", [True, False])
def test_the_bell_rings_on_a_terminal_only(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    screen, stderr = StoppedScreen(), io.StringIO()
    monkeypatch.setattr(stderr, "isatty", lambda: terminal)
    monkeypatch.setattr("sys.stderr", stderr)
    view = BackgroundView(screen)
    view.ring()
    view.close()
    assert stderr.getvalue() == ("\a" if terminal else "")


# ---- the tool in a process of its own -----------------------------------------------------------


class Vehicles:
    """A leader and a follower that only say that they are there, by datagrams to one port."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        link = f"udpin:127.0.0.1:{self._to[1]}"
        self.ends = ["--leader", f"{link}@1", "--follower", f"{link}@2"]
        self._packers = [mavlink.MAVLink(None, srcSystem=number) for number in (1, 2)]
        for packer in self._packers:
            packer.srcComponent = 1
        self._ear = mavlink.MAVLink(None)
        self._ear.robust_parsing = True

    def talk(self, warnings: int = 0) -> int:
        """Say it once more, with so many warnings; returns how many heartbeats have come."""
        beat = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 5, 4, 3)
        warning = mavlink.MAVLink_statustext_message(4, b"a warning that makes a line to show")
        for packer in self._packers:
            for message in (beat, *[warning] * warnings):
                self._socket.sendto(bytes(message.pack(packer)), self._to)
        return sum(message.get_type() == "HEARTBEAT" for message in self._heard())

    def _heard(self) -> Iterator[Any]:
        try:
            while True:
                yield from self._ear.parse_buffer(self._socket.recv(65_535)) or ()
        except (BlockingIOError, ConnectionRefusedError):
            return

    def until_heard(self, heartbeats: int, warnings: int = 0) -> None:
        until_s = time.monotonic() + DEADLINE_S
        while heartbeats > 0:
            assert time.monotonic() < until_s, "the tool has fallen silent"
            heartbeats -= self.talk(warnings)
            time.sleep(0.02)


@pytest.fixture
def vehicles() -> Vehicles:
    return Vehicles()


def test_a_pipe_that_nobody_reads_stops_neither_the_tool_nor_its_end(vehicles: Vehicles) -> None:
    unread, written = os.pipe()
    os.set_blocking(written, False)
    try:  # full before it begins
        while True:
            os.write(written, b"x" * 4096)
    except BlockingIOError:
        os.set_blocking(written, True)
    with subprocess.Popen([*FOLLOW, *vehicles.ends], stdout=written) as tool:
        os.close(written)
        try:
            vehicles.until_heard(6)  # two links at 1 Hz each
            tool.send_signal(signal.SIGTERM)
            assert tool.wait(DEADLINE_S) == 0
        finally:
            tool.kill()
    os.close(unread)


def test_neither_ctrl_s_nor_ctrl_z_stops_it_and_the_terminal_is_put_back(
    vehicles: Vehicles,
) -> None:
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    assert before[0] & termios.IXON
    with subprocess.Popen([*FOLLOW, *vehicles.ends], stdin=slave, stdout=slave) as tool:
        try:
            read_until(master, b"waiting for")
            assert not termios.tcgetattr(slave)[0] & termios.IXON
            os.write(master, b"\x13")  # Ctrl-S
            tool.send_signal(signal.SIGTSTP)  # what Ctrl-Z sends
            vehicles.until_heard(6)
            read_until(master, b"leader is system 1")
            tool.send_signal(signal.SIGTERM)
            read_until(master, b"left to its pilot")
            assert tool.wait(DEADLINE_S) == 0
        finally:
            tool.kill()
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


def read_until(terminal: int, text: bytes) -> None:
    """Read a terminal until a text has been shown on it."""
    shown = b""
    until_s = time.monotonic() + DEADLINE_S
    while text not in shown:
        assert time.monotonic() < until_s, shown
        if select.select([terminal], [], [], 0.1)[0]:
            shown += os.read(terminal, 4096)
