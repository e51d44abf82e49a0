"""`echowing rig` as it is run: its own process, the board's binary at the other end of a pty."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

pytestmark = pytest.mark.seconds(50)
# Generous: a busy machine may take its time, a broken tool takes for ever.
PATIENCE_S = 120.0
RANGE_CM = 321


def echowing(*arguments: str | Path, **options: Any) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "echowing", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


class Board:
    """The emulated board: a process with a terminal for its USB port."""

    def __init__(self) -> None:
        self.process = echowing("emulator", "--usb", "pty", "--range-cm", str(RANGE_CM))
        self.port = ""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(r"USB port: (/dev/\S+)", line):
                self.port = found[1]
                break
        # Nobody reads the rest; a full pipe would stop it.
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    def unplug(self) -> None:
        self.process.kill()
        self.process.wait(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def board() -> Iterator[Board]:
    """One board for all who leave it as they found it."""
    emulated = Board()
    yield emulated
    emulated.unplug()


@pytest.fixture
def own_board() -> Iterator[Board]:
    """A board to be unplugged."""
    emulated = Board()
    yield emulated
    emulated.unplug()


class Done:
    """A rig that has ended."""

    def __init__(self, *arguments: str | Path, stdin: str = "") -> None:
        process = echowing("rig", *arguments, stdin=subprocess.PIPE)
        self.out, self.err = process.communicate(stdin, timeout=PATIENCE_S)
        self.code = process.returncode
        assert "Traceback" not in self.err

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def rig(board: Board) -> Callable[..., Done]:
    """Runs a verb on the board."""
    return lambda *arguments, **options: Done("--port", board.port, *arguments, **options)


class TestOnTheBoard:
    def test_info(self, rig: Callable[..., Done]) -> None:
        told = rig("info", "--json").json
        assert (told["system_id"], told["component_id"]) == (250, 191)  # no vehicle learned yet
        assert told["version"] == "0.1.0"
        assert re.fullmatch("[0-9a-f]{8}", told["git_hash"])
        assert told["parameters"]["SONAR_ADDR"] == 112.0
        people = rig("info")
        assert people.code == 0
        assert f"firmware   0.1.0 (git {told['git_hash']})" in people.out

    def test_watch(self, board: Board) -> None:
        last = watched(board, tracks)
        assert last["range_m"] == pytest.approx(RANGE_CM / 100.0)
        # The port may have been opened in the middle of a frame.
        assert last["wire"]["damaged"] <= 1
        shown = "tracking, range  3.21 m, reading  3.21 m"
        watched_until(board, lambda line: shown in line)

    def test_watch_on_a_terminal(self, board: Board) -> None:
        master, slave = pty.openpty()
        process = subprocess.Popen(
            [sys.executable, "-m", "echowing", "rig", "--port", board.port, "watch"],
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"},
        )
        os.close(slave)
        try:
            seen = read_until(master, " tracking ", "3.21 m", "point")
        finally:
            process.send_signal(signal.SIGINT)
        read_to_end(master)
        assert process.wait(timeout=PATIENCE_S) == 0
        assert f"Echowing on {board.port}" in seen
        assert "3.21 m" in seen

    def test_aim_then_scan(self, rig: Callable[..., Done], board: Board) -> None:
        assert rig("aim", "1500", "1300", "--json").json == {"pan_us": 1500, "tilt_us": 1300}
        watched(board, lambda line: (line["pan_us"], line["tilt_us"]) == (1500.0, 1300.0))
        assert "looks straight ahead" in rig("scan", "stop").out
        watched(board, lambda line: line["points"] == [6, 12])
        assert rig("scan", "auto").code == 0
        refused = rig("aim", "700", "1300")
        assert refused.code == 2
        assert "pan pulse 700 us: servos take 800 to 2200" in refused.err

    def test_parameters_there_and_back(self, rig: Callable[..., Done], tmp_path: Path) -> None:
        file = tmp_path / "board.params"
        assert rig("params", "save", file).code == 0
        assert rig("params", "diff").code == 0
        changed = rig("params", "set", "TRACK_RANGE", "400", "--json").json
        assert changed == {"name": "TRACK_RANGE", "before": 450.0, "value": 400.0, "stored": True}
        assert rig("params", "get", "TRACK_RANGE", "--json").json == {"TRACK_RANGE": 400.0}
        differs = rig("params", "diff", file)
        assert differs.code == 1
        assert f"TRACK_RANGE: board 400, {file} 450" in differs.out
        loaded = rig("params", "load", file, "--json").json
        assert loaded == {"changed": {"TRACK_RANGE": 450.0}, "stored": True}
        refused = rig("params", "set", "SCAN_DWELL", "20")
        assert refused.code == 2
        assert "it stays 300; it takes whole numbers from 50 to 5000 ms" in refused.err

    def test_self_test(self, rig: Callable[..., Done]) -> None:
        passed = rig("self-test", "--yes", "--json")
        assert passed.code == 0
        assert passed.json["passed"] is True
        failed = rig("self-test", stdin="n\n")
        assert failed.code == 1
        assert re.search(r"sonar +fine", failed.out)
        assert re.search(r"servos +failed +check the servos' own 5 V", failed.out)

    def test_a_recording_is_replayed(
        self, rig: Callable[..., Done], board: Board, tmp_path: Path
    ) -> None:
        file = tmp_path / "bench.ewr"
        watched(board, tracks)  # the test before may have left it searching
        recording = echowing("rig", "--port", board.port, "record", file, "--json")
        until(lambda: file.exists() and file.stat().st_size > 8000)
        recording.send_signal(signal.SIGINT)
        said, _ = recording.communicate(timeout=PATIENCE_S)
        assert recording.returncode == 0
        assert json.loads(said)["frames"] > 40
        replayed = Done("replay", file, "--fast", "--json")
        last = json.loads(replayed.out.splitlines()[-1])
        assert last["state"] == "tracking"
        assert last["range_m"] == pytest.approx(RANGE_CM / 100.0)
        assert rig("record", file).code == 2  # never over another


class TestTrouble:
    def test_a_cable_pulled_while_watching(self, own_board: Board) -> None:
        watching = echowing("rig", "--port", own_board.port, "watch", "--json")
        assert watching.stdout is not None
        assert watching.stdout.readline()
        own_board.unplug()
        _, said = watching.communicate(timeout=PATIENCE_S)
        assert watching.returncode == 2
        assert f"{own_board.port}: the connection was lost: the cable was unplugged" in said
        assert "Traceback" not in said

    def test_a_cable_pulled_while_recording(self, own_board: Board, tmp_path: Path) -> None:
        file = tmp_path / "bench.ewr"
        recording = echowing("rig", "--port", own_board.port, "record", file)
        until(lambda: file.exists() and file.stat().st_size > 4000)
        own_board.unplug()
        _, said = recording.communicate(timeout=PATIENCE_S)
        assert recording.returncode == 2
        assert "the cable was unplugged" in said
        assert f"{file}: " in said  # what it holds
        assert Done("replay", file, "--fast").code == 0

    def test_a_recorder_that_is_killed_loses_nothing(self, board: Board, tmp_path: Path) -> None:
        file = tmp_path / "bench.ewr"
        watched(board, tracks)
        recording = echowing("rig", "--port", board.port, "record", file)
        until(lambda: file.exists() and file.stat().st_size > 4000)
        recording.kill()
        recording.communicate(timeout=PATIENCE_S)
        last = json.loads(Done("replay", file, "--fast", "--json").out.splitlines()[-1])
        assert last["wire"]["frames"] > 20
        assert last["range_m"] == pytest.approx(RANGE_CM / 100.0)

    def test_a_port_that_is_in_use(self, board: Board) -> None:
        watching = echowing("rig", "--port", board.port, "watch", "--json")
        assert watching.stdout is not None
        assert watching.stdout.readline()
        second = Done("--port", board.port, "info")
        watching.send_signal(signal.SIGTERM)
        watching.communicate(timeout=PATIENCE_S)
        assert watching.returncode == 0
        assert second.code == 2
        assert "the port is busy: another program has it open" in second.err

    def test_a_wrong_baud_rate(self) -> None:
        with talking(b"\xf8\x00\x80\x1e" * 40) as port:
            done = Done("--port", port, "--baud", "57600", "info")
        assert done.code == 2
        assert "no MAVLink in them: the baud rate may be wrong (57600;" in done.err

    def test_an_autopilot_on_the_port(self) -> None:
        pilot = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3
        ).pack(pilot)
        with talking(beat) as port:
            done = Done("--port", port, "info")
        assert done.code == 2
        assert "not the co-processor but an autopilot (ArduPilot, quadrotor," in done.err

    def test_no_such_device(self) -> None:
        done = Done("--port", "/dev/ttyACM99", "info")
        assert done.code == 2
        assert "/dev/ttyACM99: no such device" in done.err


class talking:  # noqa: N801 (used like a function)
    """A terminal on which somebody says the same again and again."""

    def __init__(self, says: bytes) -> None:
        self._says = says
        self._master, self._slave = pty.openpty()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)

    def _talk(self) -> None:
        os.set_blocking(self._master, False)
        while not self._end.wait(0.2):
            try:
                os.write(self._master, self._says)
            except BlockingIOError:
                continue

    def __enter__(self) -> str:
        self._thread.start()
        return os.ttyname(self._slave)

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)


def watched_until(board: Board, fits: Callable[[str], bool], *options: str) -> str:
    """The first line that fits of a watch, which is then interrupted, and ends well."""
    watching = echowing("rig", "--port", board.port, "watch", *options)
    assert watching.stdout is not None
    deadline_s = time.monotonic() + PATIENCE_S
    for line in watching.stdout:
        if fits(line):
            break
        assert time.monotonic() < deadline_s, line
    watching.send_signal(signal.SIGINT)
    watching.communicate(timeout=PATIENCE_S)
    assert watching.returncode == 0
    return line


def tracks(line: dict[str, Any]) -> bool:
    """Whether it tracks, and a range has come since the watch began: the state comes first."""
    return line["state"] == "tracking" and line["range_m"] is not None


def watched(board: Board, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first state of a watch that fits."""

    def told(line: str) -> bool:
        record = json.loads(line)
        return "state" in record and fits(record)

    found: dict[str, Any] = json.loads(watched_until(board, told, "--json"))
    return found


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def read_until(terminal: int, *words: str) -> str:
    """What a terminal shows, until it has shown all of these."""
    seen = ""
    deadline_s = time.monotonic() + PATIENCE_S
    while not all(re.search(word, seen) for word in words):
        assert time.monotonic() < deadline_s, seen
        if select.select([terminal], [], [], 0.1)[0]:
            seen += os.read(terminal, 65_536).decode(errors="replace")
    return seen


def read_to_end(terminal: int) -> None:
    """Take what still comes, so that its writer can end."""
    try:
        while os.read(terminal, 65_536):
            pass
    except OSError:  # the other end has gone: Linux's way to say so
        os.close(terminal)
