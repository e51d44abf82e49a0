"""The bench's procedures as they are run: their own process, the co-processor on a pty.

The operator is played here: each prompt says where the target has to be; it is put there, and
answered. Deadlines are generous, nothing waits a fixed time.
"""

import contextlib
import csv
import json
import math
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from echowing.paths import lua_folder
from echowing.rig.board import Board, open_board
from echowing.sim.serve import Server
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sonar_file import load_sonar

pytestmark = pytest.mark.seconds(140)
PATIENCE_S = 120.0
# The sonar's face is 0.1 m ahead of the follower's centre, the leader's legs 0.1 m nearer than its
# own: told at 3.2 m, it is heard at 3.0 m (sim/world/sonar.py).
NEARER_M = 0.2
AWAY_M = 50.0
# A busy machine holds bytes back far longer than a USB chip does.
SLOW_HOST = ("--host-ms", "500")
# A board that had to wait for a core for so long was not in real time; then it is measured again.
LATE_S = 0.1
TRIES = 8
BIG_STEP = "attract, big step"


def start(*arguments: str | Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "echowing", *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        bufsize=1,
    )


class Emulator:
    """The co-processor, its USB port on a terminal, its target where it is put.

    Its core, built for this computer, is a third of the work of the Mega's binary: that one is
    spoken to in `test_rig`, and here where the board itself restarts.
    """

    def __init__(self, *options: str) -> None:
        self.process = start("emulator", "--board", "native", "--usb", "pty", *options)
        self.link = self._told(r"autopilot port: (?:tcp )?(\S+)")
        self.port = self._told(r"USB port: (/dev/\S+)")
        udp = self._told(r"udp 127\.0\.0\.1:(\d+)") if "--target" in options else None
        self._target = int(udp) if udp else None
        threading.Thread(target=self._drain, daemon=True).start()

    def _told(self, pattern: str) -> str:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(pattern, line):
                return found[1]
        raise AssertionError(f"the emulator never said {pattern!r}")

    def _drain(self) -> None:
        assert self.process.stdout is not None
        for _ in self.process.stdout:
            pass

    def put_target(self, distance_m: float, right_m: float = 0.0, up_m: float = 0.0) -> None:
        """In front of the sonar, so far from its face; or so far to a side of that, as far away."""
        assert self._target is not None
        forward_m = math.sqrt(distance_m**2 - right_m**2 - up_m**2)
        place = {"forward_m": forward_m + NEARER_M, "right_m": right_m, "down_m": -up_m}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(json.dumps(place).encode(), ("127.0.0.1", self._target))

    def waited_s(self) -> float:
        """How long it has waited for a core so far: it could run, and the machine had others."""
        return int(Path(f"/proc/{self.process.pid}/schedstat").read_text().split()[1]) * 1e-9

    def stop(self) -> None:
        self.process.kill()
        self.process.wait(timeout=PATIENCE_S)


class Rig:
    """A procedure that has ended: what it said, its exit code, its result."""

    def __init__(self, code: int, said: str, out: Path, verb: str) -> None:
        assert "Traceback" not in said
        self.code, self.said, self.out = code, said, out
        self.result: dict[str, Any] = json.loads((out / f"{verb}.json").read_text())
        page = (out / f"{verb}.html").read_text()
        assert self.result["verdict"] in page

    def check(self, what: str) -> str:
        found = next(check for check in self.result["checks"] if check["what"] == what)
        return str(found["verdict"])


def rig(
    out: Path,
    port: str,
    verb: str,
    *options: str,
    place: Callable[[float], None] | None = None,
    help_it: Callable[[str], None] | None = None,
    watch: Callable[[str, "subprocess.Popen[str]"], None] = lambda line, process: None,
) -> Rig:
    """Run a procedure; `place` puts the target where each prompt wants it. Without: --yes.

    help_it: does what a prompt says, where that is more than a distance.
    """
    answers = () if place or help_it else ("--yes",)
    process = start("rig", "--port", port, verb, "--out", out, *options, *answers)
    assert process.stdin is not None
    assert process.stdout is not None
    said = []
    for line in process.stdout:
        said.append(line)
        watch(line, process)
        if help_it and "press Enter" in line:
            help_it(line)
            process.stdin.write("\n")
        if place and "press Enter" in line:
            wanted = re.search(r"(?:at|leader) (\d+(?:\.\d+)?) m", line)
            place(float(wanted[1]) if wanted else AWAY_M)
            process.stdin.write("\n")
    return Rig(process.wait(timeout=PATIENCE_S), "".join(said), out, verb)


def in_real_time(
    emulator: Emulator, out: Path, measure: Callable[[Path], Rig], right: Callable[[Rig], bool]
) -> Rig:
    """A measurement that is right, or wrong although the machine left the board its time."""
    for number in range(TRIES):
        before_s = emulator.waited_s()
        done = measure(out / str(number))
        if right(done) or emulator.waited_s() - before_s < LATE_S:
            break
    return done


def passed(done: Rig) -> bool:
    return bool(done.result["verdict"] == "PASS")


@contextlib.contextmanager
def only_now(emulator: Emulator) -> Iterator[Emulator]:
    """It runs for one test: in the others' time it would take a third of a core from them."""
    emulator.process.send_signal(signal.SIGCONT)
    yield emulator
    emulator.process.send_signal(signal.SIGSTOP)


@pytest.fixture(scope="module")
def with_target() -> Iterator[Emulator]:
    emulator = Emulator("--target", "udp:0")
    yield emulator
    emulator.stop()


@pytest.fixture
def movable(with_target: Emulator) -> Iterator[Emulator]:
    """A board whose target is moved."""
    with only_now(with_target):
        yield with_target


@pytest.fixture(scope="module")
def with_range() -> Iterator[Emulator]:
    emulator = Emulator("--range-cm", "280")
    yield emulator
    emulator.stop()


@pytest.fixture
def fixed(with_range: Emulator) -> Iterator[Emulator]:
    """A board that always hears something at 2.8 m: 3 m from centre to centre."""
    with only_now(with_range):
        yield with_range


@contextlib.contextmanager
def listening(emulator: Emulator) -> Iterator[Board]:
    board = open_board(emulator.port, 115_200)
    yield board
    board.close()


def wait_for(board: Board, fits: Callable[[Any], bool]) -> Any:
    """The first message that fits, however slow the machine."""
    end_s = board.now_s() + PATIENCE_S
    while board.now_s() < end_s:
        for message in board.poll(0.1):
            if fits(message):
                return message
    raise AssertionError("no message that fits")


def is_tilt(message: Any) -> bool:
    return bool(message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "SNR_TILT")


# ---- range test ---------------------------------------------------------------------------------


def test_range_test_finds_where_the_target_is_lost(movable: Emulator, tmp_path: Path) -> None:
    options = ("--distances", "1,3.3,5.5", "--seconds", "1.5")

    def measure(out: Path) -> Rig:
        return rig(out, movable.port, "range-test", *options, place=movable.put_target)

    done = in_real_time(movable, tmp_path, measure, passed)
    assert (done.code, done.result["verdict"]) == (0, "PASS")
    # The foil of Table 5 is heard to 4.6 m: at 3.3 m surely, at 5.5 m never.
    assert done.result["measured"]["maximum_effective_range_m"] == 3.3
    near, _, far = done.result["measured"]["points"]
    assert near["mean_m"] == pytest.approx(1.0, abs=0.02)  # noise of 1 cm, whole centimetres down
    assert far["detection_rate"] < 0.1  # one in a hundred is wild
    assert "range-test: PASS" in done.said


def test_range_test_fails_with_the_target_elsewhere(fixed: Emulator, tmp_path: Path) -> None:
    options = ("--distances", "2", "--need", "2", "--seconds", "1")
    done = rig(tmp_path, fixed.port, "range-test", *options)
    assert (done.code, done.result["verdict"]) == (1, "FAIL")
    assert done.result["measured"]["points"][0]["elsewhere_rate"] == 1.0


def test_interrupted_range_test_keeps_its_points_and_frees_the_gimbal(
    movable: Emulator, tmp_path: Path
) -> None:
    def stop_at_the_second(line: str, process: "subprocess.Popen[str]") -> None:
        if "measuring at 2.00" in line:
            process.send_signal(signal.SIGINT)

    def measure(out: Path) -> Rig:
        return rig(
            out,
            movable.port,
            "range-test",
            *("--distances", "1,2,3", "--seconds", "1"),
            place=movable.put_target,
            watch=stop_at_the_second,
        )

    def heard(done: Rig) -> bool:
        return bool(done.result["measured"]["points"][0]["detection_rate"] >= 0.9)

    done = in_real_time(movable, tmp_path, measure, heard)
    assert (done.code, done.result["verdict"]) == (130, "INCOMPLETE")
    assert done.result["incomplete"] == "interrupted"
    nearest = done.result["measured"]["points"][0]
    assert (nearest["distance_m"], nearest["detection_rate"]) == (1.0, pytest.approx(1.0, abs=0.1))
    movable.put_target(AWAY_M)
    with listening(movable) as board:  # no autopilot beside it: left to itself it searches
        at_first = wait_for(board, is_tilt).value
        wait_for(board, lambda message: is_tilt(message) and message.value != at_first)


# ---- scan test ----------------------------------------------------------------------------------


def test_scan_test_sees_the_twelve_points(movable: Emulator, tmp_path: Path) -> None:
    def measure(out: Path) -> Rig:
        return rig(out, movable.port, "scan-test", "--rounds", "1", place=movable.put_target)

    done = in_real_time(movable, tmp_path, measure, passed)
    assert done.result["verdict"] == "PASS", done.said
    assert done.result["measured"]["coverage_gain_percent"] == pytest.approx(95.0, abs=1.0)


def test_scan_test_fails_with_something_in_the_beam(fixed: Emulator, tmp_path: Path) -> None:
    done = rig(tmp_path, fixed.port, "scan-test", "--rounds", "1")
    assert (done.code, done.check("search")) == (1, "FAIL")


# ---- latency test -------------------------------------------------------------------------------


def test_latency_test_measures_both_ways(fixed: Emulator, tmp_path: Path) -> None:
    options = ("--commands", "20", "--seconds", "2", *SLOW_HOST)

    def measure(out: Path) -> Rig:
        return rig(out, fixed.port, "latency-test", *options)

    done = in_real_time(fixed, tmp_path, measure, passed)
    assert done.result["verdict"] == "PASS", done.said
    assert len(done.result["measured"]["ack_ms"]) == 20
    # 41 bytes of the report take 3.6 ms at 115200 baud, and the sonar is read before: never less.
    assert min(done.result["measured"]["report_ms"]) > 3.0


def test_latency_test_fails_without_a_target(movable: Emulator, tmp_path: Path) -> None:
    movable.put_target(AWAY_M)
    options = ("--commands", "5", "--seconds", "1", *SLOW_HOST)
    done = rig(tmp_path, movable.port, "latency-test", *options)
    assert (done.code, done.check("reading to report")) == (1, "FAIL")


# ---- response matrix ----------------------------------------------------------------------------


def test_response_matrix_finds_the_beam_and_writes_its_file(
    movable: Emulator, tmp_path: Path
) -> None:
    """The emulated sonar is one on a desk: it hears all within 20 degrees, up to 4.6 m."""
    file = tmp_path / "mine.toml"
    where = ("--distances", "1.5,3", "--angles", "0,17,23", "--throttles", "0.4")
    options = (*where, "--seconds", "3", "--slot", "2", "--write", str(file))

    def place(distance_m: float) -> None:
        if distance_m < AWAY_M:  # centre to centre; the other prompts are about propellers
            movable.put_target(distance_m - NEARER_M)

    def measure(out: Path) -> Rig:
        return rig(out, movable.port, "response-matrix", *options, place=place)

    done = in_real_time(movable, tmp_path, measure, passed)
    assert done.result["verdict"] == "PASS", done.said
    sonar = load_sonar(file)
    assert sonar.heard.least[0] > 0.8
    assert all(one < 20.0 for one in sonar.beam.narrowest_deg)
    assert all(17.0 < one < 30.0 for one in sonar.beam.widest_deg)
    assert sonar.inset_m[0] < NEARER_M + 0.005 < sonar.inset_m[1]  # whole centimetres down
    assert f"echowing follow --sonar {file}" in done.said


# ---- law test -----------------------------------------------------------------------------------


def test_law_test_with_the_built_in_applet(movable: Emulator, tmp_path: Path) -> None:
    def measure(out: Path) -> Rig:
        options = ("law-test", "--hold", "2.2")
        return rig(out, movable.port, *options, place=movable.put_target)

    def two_steps(done: Rig) -> bool:
        return passed(done) and done.result["measured"]["bands"][BIG_STEP]["right_steps"] == 2

    done = in_real_time(movable, tmp_path, measure, two_steps)
    assert done.result["verdict"] == "PASS", done.said
    bands = done.result["measured"]["bands"]
    # From 2.5 m/s to 4.5 m/s are two big steps; one more would reach the limit of 5 m/s.
    assert bands[BIG_STEP]["right_steps"] == 2
    assert all(step["right"] for step in done.result["measured"]["steps"])


def test_law_test_fails_with_a_target_that_stays(fixed: Emulator, tmp_path: Path) -> None:
    done = rig(tmp_path, fixed.port, "law-test", "--hold", "0.5")
    assert (done.code, done.result["verdict"]) == (1, "FAIL")
    assert done.check("monitor") == "PASS"  # it stood there for 3 s: long enough
    assert done.check(BIG_STEP) == "FAIL"
    assert done.check("gimbal out of range") == "FAIL"


def leave_alone(copter: Copter, t_s: float) -> None:
    """Nobody touches it."""


class ServedVehicle:
    """A simulated autopilot: the board on one port, us on another. In the air it flies an applet.

    hand: turns the vehicle at a time, seconds, after it has moved by itself.
    """

    def __init__(
        self,
        board_port: str,
        *,
        flying: bool = True,
        hand: Callable[[Copter, float], None] = leave_alone,
    ) -> None:
        copter = Copter((0.0, 0.0, -10.0 if flying else 0.0), 0.0, flying=flying)
        parameters = {"RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 0.0, "SCR_ENABLE": 1.0}
        parameters |= {"ECHO_ENABLE": 1.0, "ECHO_LAW": 0.0}
        autopilot = Autopilot(copter, system_id=7, parameters=parameters)
        for name in ("board", "telemetry"):
            autopilot.add_link(name)
        if flying:
            autopilot.load_script(lua_folder() / "echowing_speed.lua")

        def step(t_s: float) -> None:
            copter.step(0.02)
            hand(copter, t_s)
            autopilot.step(t_s)

        self._server = Server(step)
        self._server.connect(autopilot, "board", f"tcp:{board_port}")
        wire = self._server.connect(autopilot, "telemetry", "tcpin:0")
        found = re.search(r"127\.0\.0\.1:\d+", wire.describe())
        assert found is not None
        self.where = f"tcp:{found[0]}"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._server.run, args=(self._stop.is_set,))
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(timeout=PATIENCE_S)
        self._server.close()


def test_law_test_with_an_autopilot(tmp_path: Path) -> None:
    emulator = Emulator("--link", "tcpin:0", "--target", "udp:0")
    vehicle = ServedVehicle(emulator.link)

    def measure(out: Path) -> Rig:
        options = ("law-test", "--hold", "2.5", "--autopilot", vehicle.where)
        return rig(out, emulator.port, *options, place=emulator.put_target)

    done = in_real_time(emulator, tmp_path, measure, passed)
    vehicle.stop()
    emulator.stop()
    assert done.result["verdict"] == "PASS", done.said
    assert done.result["system"] == "7"  # the board has taken the autopilot's


# ---- axis test ----------------------------------------------------------------------------------


class Hand:
    """Turns the vehicle by up to 20 degrees, nose up and down and to the sides, when told to."""

    def __init__(self) -> None:
        self.turns = False
        self._since_s: float | None = None

    def __call__(self, copter: Copter, t_s: float) -> None:
        if not self.turns:
            self._since_s = None
            copter.pitch_rad = copter.yaw_rad = copter.pitchspeed_rps = copter.yawspeed_rps = 0.0
            return
        self._since_s = t_s if self._since_s is None else self._since_s
        t_s -= self._since_s
        copter.pitch_rad, copter.pitchspeed_rps = self._swing(t_s, 2.0)
        copter.yaw_rad, copter.yawspeed_rps = self._swing(t_s, 1.5)

    @staticmethod
    def _swing(t_s: float, rate_rps: float) -> tuple[float, float]:
        angle = math.radians(20.0)
        return angle * math.sin(rate_rps * t_s), rate_rps * angle * math.cos(rate_rps * t_s)


def test_axis_test_with_an_autopilot_that_a_hand_turns(tmp_path: Path) -> None:
    emulator = Emulator("--link", "tcpin:0", "--target", "udp:0")
    hand = Hand()
    vehicle = ServedVehicle(emulator.link, flying=False, hand=hand)
    with listening(emulator) as board:  # it learns its vehicle, and asks it for its attitude
        wait_for(board, lambda message: message.get_srcSystem() == 7)

    def watch(line: str, process: "subprocess.Popen[str]") -> None:
        hand.turns = "turn it by hand" in line or (hand.turns and "axis-test" not in line)

    def put(line: str) -> None:
        if found := re.search(r"arget (?:(\S+) m (to the right|up).* )?(\d) m from", line):
            aside_m = float(found[1] or 0.0)
            sides = {"to the right": (aside_m, 0.0), "up": (0.0, aside_m)}
            emulator.put_target(float(found[3]), *sides.get(found[2], (0.0, 0.0)))

    def measure(out: Path) -> Rig:
        options = ("axis-test", "--rounds", "1", "--seconds", "4", *SLOW_HOST)
        return rig(out, emulator.port, *options, help_it=put, watch=watch)

    done = in_real_time(emulator, tmp_path, measure, passed)
    vehicle.stop()
    emulator.stop()
    assert done.result["verdict"] == "PASS", done.said
    assert min(done.result["measured"]["turned_deg"]) > 25.0
    assert max(move["off_deg"] for move in done.result["measured"]["moves"]) < 1.0
    assert done.check("pan really turns right") == done.check("tilt really turns up") == "PASS"


def test_axis_test_fails_without_an_autopilot(fixed: Emulator, tmp_path: Path) -> None:
    done = rig(tmp_path, fixed.port, "axis-test", "--still")
    assert (done.code, done.check("attitude")) == (1, "FAIL")
    assert "does the autopilot's TX reach the board" in done.said


# ---- soak ---------------------------------------------------------------------------------------


def test_soak_counts_and_passes(fixed: Emulator, tmp_path: Path) -> None:
    options = ("--duration", "2", "--row", "0.5", "--still")

    def measure(out: Path) -> Rig:
        return rig(out, fixed.port, "soak", *options)

    done = in_real_time(fixed, tmp_path, measure, passed)
    assert done.result["verdict"] == "PASS", done.said
    rows = list(csv.DictReader((done.out / "soak.csv").open()))
    assert [float(row["end_s"]) for row in rows] == [0.5, 1.0, 1.5, 2.0]
    assert float(rows[0]["range_m"]) == 2.8


def test_soak_counts_a_reboot_and_fails(tmp_path: Path) -> None:
    emulator = Emulator("--board", "mega", "--range-cm", "300", "--link", "tcpin:0")
    options = ("--duration", "3", "--row", "1")

    def reboot(line: str, process: "subprocess.Popen[str]") -> None:
        if "soaking" in line:
            other = open_board(f"tcp:{emulator.link}", 115_200)
            other.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
            other.close()

    done = rig(tmp_path, emulator.port, "soak", *options, watch=reboot)
    emulator.stop()
    assert (done.code, done.check("reboots")) == (1, "FAIL")
    assert done.result["measured"]["reboots"] == 1


def test_soak_survives_the_cable_being_pulled(tmp_path: Path) -> None:
    plug = tmp_path / "ttyBOARD"
    # Both run from the start: on a busy machine one takes longer to start than the soak lasts.
    pulled, plugged_in = Emulator("--range-cm", "300"), Emulator("--range-cm", "300")
    plug.symlink_to(pulled.port)

    def pull(line: str, process: "subprocess.Popen[str]") -> None:
        if "soaking" in line:
            pulled.stop()
        if "waiting for the board" in line:
            plug.unlink()
            plug.symlink_to(plugged_in.port)

    done = rig(tmp_path, str(plug), "soak", "--duration", "8", "--row", "2", watch=pull)
    plugged_in.stop()
    assert "start again" not in done.said  # it waits
    assert done.result["measured"]["unplugged"] == 1
    assert done.result["measured"]["reboots"] == 0
    assert done.result["verdict"] == "PASS", done.said
