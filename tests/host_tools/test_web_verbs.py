"""The verbs that show a flight in the browser beside `follow`: `sim --serve --web`, `replay`."""

import math
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from echowing.cli import main
from echowing.sim.flight import FormationWorld
from echowing.sim.hangar import Hangar
from echowing.sim.page import SHOWN_EVERY, WorldOnPage, moment_of
from echowing.sim.scenario import load_scenario
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.tool.moment import Moment
from echowing.web.snapshot import snapshot

DATA = Path(__file__).parent / "data"


class Screen:
    """A page that remembers."""

    said = "page"

    def __init__(self) -> None:
        self.moments: list[Moment] = []
        self.events: list[str] = []

    def event(self, time_s: float, text: str) -> None:
        self.events.append(text)

    def show(self, moment: Moment) -> None:
        self.moments.append(moment)

    def lost(self) -> str | None:
        return None


def flown(seconds: float, *changes: str) -> tuple[FormationWorld, Screen]:
    scenario = load_scenario("echowing", list(changes))
    world, screen = FormationWorld(scenario, Hangar(scenario, 1)), Screen()
    shown = WorldOnPage(world, screen)
    for _ in range(round(seconds / 0.02)):
        shown.step()
    return world, screen


def test_a_simulated_world_is_shown_as_it_truly_is() -> None:
    world, screen = flown(10.0)
    assert len(screen.moments) == 500 // SHOWN_EVERY
    last = screen.moments[-1]
    assert last.time_s == pytest.approx(10.0)
    frame = snapshot(last, ORIGIN)
    leader, (follower,) = world.leader, world.followers
    assert frame["leader"]["at"] == pytest.approx(leader.position_ned_m[:2], abs=0.01)
    (shown,) = frame["followers"]
    assert shown["at"] == pytest.approx(follower.position_ned_m[:2], abs=0.01)
    apart_m = math.dist(leader.position_ned_m, follower.position_ned_m)
    assert shown["separation"] == pytest.approx(apart_m, abs=0.001)
    assert shown["height"] == pytest.approx(-follower.position_ned_m[2], abs=0.01)
    # The slot is 3 m behind where the leader truly flies.
    course_rad = math.atan2(*leader.velocity_ned_mps[1::-1])
    behind_m = [
        a - 3.0 * b for a, b in zip(leader.position_ned_m[:2], _unit(course_rad), strict=True)
    ]
    assert shown["slot"] == pytest.approx(behind_m, abs=0.02)
    assert screen.events[:2] == ["leader 1: GUIDED", "follower 2: GUIDED"]
    assert "leader 1: AUTO" in screen.events


def test_a_simulated_column_is_shown_with_its_gaps() -> None:
    world, screen = flown(2.0, "formation.slots=[{radius_m=3.0}, {radius_m=3.0, behind=1}]")
    first, second = snapshot(screen.moments[-1], ORIGIN)["followers"]
    assert (first["watches"], second["watches"]) == (None, first["id"])
    gap_m = math.dist(*(follower.position_ned_m for follower in world.followers))
    assert second["separation"] == pytest.approx(gap_m, abs=0.001)


def _unit(bearing_rad: float) -> tuple[float, float]:
    return math.cos(bearing_rad), math.sin(bearing_rad)


def test_what_is_no_target_is_no_range() -> None:
    """The sonar's longest reading is its word for nothing."""
    world, _ = flown(2.0)
    world.followers[0].sensor.last_range_m = world.scenario.sonar_belief.reach_m + 0.1
    assert moment_of(world).rows[0].sonar_m is None
    world.followers[0].sensor.last_range_m = 3.2
    assert moment_of(world).rows[0].sonar_m == 3.2


def test_a_served_world_has_its_page(tmp_path: Path) -> None:
    said = served("sim", "echowing", "--serve", _free_port(), "--web", "0")
    assert said["title"] == "Echowing"
    assert said["code"] == 0


def test_a_recorded_flight_has_its_page() -> None:
    said = served("replay", str(DATA / "leader.BIN"), str(DATA / "follower.BIN"), "--web", "0")
    assert said["lines"][0] == "replay of leader.BIN + follower.BIN"
    assert said["title"] == "Echowing"
    assert said["code"] == 0


def served(*arguments: str) -> dict[str, Any]:
    """Start a verb, read its page, and end it."""
    command = [sys.executable, "-m", "echowing", *arguments]
    lines: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line.strip())
            if line.startswith("page: "):
                break
        body = _read(lines[-1].removeprefix("page: "))
        process.send_signal(signal.SIGTERM)
        process.stdout.read()
        code = process.wait(30.0)
    title = body.partition("<title>")[2].partition("</title>")[0]
    return {"lines": lines, "title": title, "code": code}


def _read(url: str) -> str:
    with urlopen(url, timeout=30.0) as answer:
        return str(answer.read(), "utf-8")


def _free_port() -> str:
    # Ports of three vehicles' ends above it are free too, in all likelihood: nobody serves there.
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return str(min(probe.getsockname()[1], 65_000))


def test_a_page_without_a_flight_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", "echowing", "--web"]) == 2
    assert "--web needs --serve" in capsys.readouterr().err
    assert main(["replay", str(tmp_path)]) == 2
    assert "a folder without" in capsys.readouterr().err
    assert main(["replay", str(tmp_path / "no.csv")]) == 2
    assert "cannot be read" in capsys.readouterr().err
