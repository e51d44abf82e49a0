"""`echowing setup` against parked vehicles of `echowing sim --serve`: real processes, real time."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from echowing.setup.applet import applet_path
from echowing.setup.apply import load

from .field import FOLLOWER, Process, free_ports

pytestmark = pytest.mark.seconds(120)

# Two rounds of reading and writing with a restart between, on a machine that has more to do.
SET_UP_S = 180.0
# The older names: the newer ones are `test_setup_vehicle`'s.
OLD_GENERATION = ("--set", 'follower.generation="4.6"')


class Served:
    """Vehicles to be set up, and the verb at work on the follower."""

    def __init__(self, *more: str) -> None:
        self.port = free_ports()
        self.process = Process("sim", "echowing", "--serve", str(self.port), *more)
        self.process.wait_for(lambda line: f"system {FOLLOWER}" in line)
        self.link = f"tcp:127.0.0.1:{self.port + 10}@{FOLLOWER}"

    def setup(self, part: str, *more: str) -> Process:
        """A part of `echowing setup`, not waited for."""
        return Process("setup", part, *more, "--vehicle", self.link)

    def done(self, part: str, *more: str, code: int) -> str:
        """A part of `echowing setup`, ended with this exit code: what it said."""
        tool = self.setup(part, *more)
        ended = tool.exit_code(SET_UP_S)
        said = "\n".join(tool.lines)
        assert ended == code, said
        assert "Traceback" not in said
        return said


@pytest.fixture
def parked(tmp_path: Path) -> Iterator[Served]:
    served = Served("--parked", "--card", str(tmp_path / "cards"), *OLD_GENERATION)
    yield served
    assert served.process.end() == 0


def wrong_lines(said: str) -> set[str]:
    return {line.split()[1] for line in said.splitlines() if line.startswith("WRONG")}


def ready(parked: Served) -> str:
    """What the check says of a vehicle that is ready.

    A machine that stands still for half a second makes a gap between two ranges, which is rightly
    said: then it is checked once more.
    """
    for _ in range(3):
        tool = parked.setup("check", "--serial", "2")
        code, said = tool.exit_code(), "\n".join(tool.lines)
        if code == 0:
            return said
        assert wrong_lines(said) == {"DISTANCE_SENSOR"}, said
    pytest.fail(said)


BEFORE = {
    "co-processor",
    "applet",
    "SERIAL2_BAUD",
    "RNGFND1_TYPE",
    "RNGFND1_ORIENT",
    "RNGFND1_MAX_CM",
    "RTL_SPEED",
    "WPNAV_ACCEL",
    "PSC_JERK_XY",
    "ANGLE_MAX",
}


def test_a_new_vehicle_is_made_ready(parked: Served, tmp_path: Path) -> None:
    said = parked.done("check", "--serial", "2", code=1)
    assert wrong_lines(said) == BEFORE
    assert "param set RTL_SPEED 500; or echowing setup apply" in said

    said = parked.done("lua", code=0)
    assert "written, read back" in said
    assert "the applet runs" in said
    card = tmp_path / "cards" / str(FOLLOWER) / "APM" / "scripts"
    assert [one.name for one in card.iterdir()] == ["echowing.lua"]
    assert (card / "echowing.lua").read_bytes() == applet_path().read_bytes()

    file = tmp_path / "old.json"
    more = ("--restart", "--save", str(file), "--vehicle", parked.link)
    tool = Process("setup", "apply", "--serial", "2", *more, stdin="y\n")
    assert tool.exit_code(SET_UP_S) == 0, tool.lines
    said = "\n".join(tool.lines)
    assert f"Write these to vehicle {FOLLOWER} on " in said
    assert "WPNAV_ACCEL, PSC_JERK_XY, ANGLE_MAX: in Auto and RTL, too" in said
    assert "FS_GCS_ENABLE     0 stays; it is yours to decide" in said
    assert "it has restarted" in said
    assert "all is set; next: echowing setup check" in said
    assert load(file).parameters["RNGFND1_MAX_CM"] == 700.0
    assert load(file).parameters["ECHO_ENABLE"] == 0.0

    said = ready(parked)
    assert "the one of this package" in said


def test_killed_in_the_middle_of_writing_everything_can_be_put_back(
    parked: Served, tmp_path: Path
) -> None:
    file = tmp_path / "old.json"
    tool = parked.setup("apply", "--serial", "2", "--yes", "--save", str(file))
    tool.wait_for(lambda line: line.startswith("writing 2 of"))
    tool.kill()
    assert set(load(file).parameters) == BEFORE - {"co-processor", "applet"}
    said = parked.done("restore", str(file), code=0)
    assert "8 of 8 written and read back" in said
    said = parked.done("check", "--serial", "2", "--json", code=1)
    told = json.loads(said[said.index("{") :])
    found = {one["about"]: one["found"] for one in told["findings"]}
    for name, value in load(file).parameters.items():
        assert found[name] == f"{value:g}"
    assert told["version"] == "4.6"


def test_a_vehicle_lost_in_the_middle_of_a_check_is_told(parked: Served) -> None:
    tool = parked.setup("check")
    tool.wait_for(lambda line: "listening and reading" in line)
    parked.process.send_signal(signal.SIGSTOP)
    try:
        assert tool.exit_code() == 2
        assert f"vehicle {FOLLOWER}" in tool.lines[-1]
        assert "is silent: no message of its autopilot" in tool.lines[-1]
    finally:
        parked.process.send_signal(signal.SIGCONT)


def test_a_flying_vehicle_is_looked_at_but_not_touched(tmp_path: Path) -> None:
    served = Served("--card", str(tmp_path / "cards"))
    file = tmp_path / "old.json"
    said = served.done("apply", "--yes", "--save", str(file), code=2)
    assert "is armed: parameters are written only while it is disarmed" in said
    assert not file.exists()
    said = served.done("lua", code=2)
    assert "is armed: scripts are replaced only while it is disarmed" in said
    assert not (tmp_path / "cards" / str(FOLLOWER) / "APM" / "scripts").exists()
    said = served.done("check", code=1)  # no applet on this card
    assert "ArduCopter 4.8, armed" in said
    assert "applet" in wrong_lines(said)
    assert served.process.end() == 0


def test_parked_vehicles_are_for_serving_only() -> None:
    tool = Process("sim", "echowing", "--parked")
    assert tool.exit_code() == 2
    assert tool.lines == ["echowing sim: --parked and --card need --serve PORT"]


def test_a_vehicle_that_reads_its_sensor_itself_needs_no_co_processor(tmp_path: Path) -> None:
    served = Served(
        "--parked", "--card", str(tmp_path / "cards"), "--set", "sonar.file=mb1202-fixed"
    )
    sonar = "--sonar", "mb1202-fixed"
    file = str(tmp_path / "old.params.json")
    said = served.done("apply", *sonar, "--yes", "--restart", "--save", file, code=0)
    assert "RNGFND1_TYPE" in said
    assert "SERIAL2" not in said
    assert "co-processor" not in served.done("check", *sonar, code=0)
    assert served.process.end() == 0
