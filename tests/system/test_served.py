"""What `echowing sim --serve` says and does for someone who tries `echowing follow` on it."""

import json
import shlex
import signal
from pathlib import Path

import pytest
from tests.system.field import FOLLOWER, WORLD, Process, World, free_ports, is_followed

pytestmark = pytest.mark.seconds(15)


def test_the_printed_command_flies_and_the_leader_has_waited_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # Slots at another radius than the applet's own ECHO_DIST of 3 m.
    slots = "formation.slots=[{radius_m=4.0, angle_deg=40.0}, {radius_m=4.0, angle_deg=-40.0}]"
    world = World("--set", "leader.start_s=0", "--set", slots)
    sim = world.process
    printed = sim.lines[sim.wait_for(lambda line: line.strip().startswith("echowing follow"))]
    formation = tmp_path / "out" / f"formation-{world.port}.toml"
    assert formation.read_text().count("radius_m") == 2
    _, *arguments = shlex.split(printed)
    tool = Process(*arguments, "--json", "--no-log")
    tool.row(lambda row: is_followed(row) and row["leader_speed_mps"] > 0.3)
    rows = [row for row in map(json.loads, tool.lines) if row.get("leader_speed_mps") is not None]
    assert rows[0]["leader_speed_mps"] < 0.2  # it would have flown off long before
    tool.end(signal.SIGINT)
    assert sim.end() == 0


def test_a_second_tool_on_a_taken_port_is_told_and_the_first_goes_on() -> None:
    port = free_ports()
    sim = Process("sim", *WORLD, "--serve", str(port))
    sim.wait_for(lambda line: f"system {FOLLOWER}" in line)
    ends = ["--leader", f"tcp:127.0.0.1:{port}@1", "--follower", f"tcp:127.0.0.1:{port + 10}@2"]
    first = Process("follow", *ends, "--json", "--no-log")
    first.row(lambda row: row["state"] == "only watched")
    second = Process("follow", *ends, "--json", "--no-log")
    second.event("another may be connected")
    seen = len(first.lines)
    first.row(lambda row: row["age_s"] is not None and row["age_s"] < 1.0, since=seen)
    first.end(signal.SIGINT)
    second.event("follower is system 2")  # the port is free again
    second.end(signal.SIGINT)
    assert sim.end() == 0


def test_parked_vehicles_come_with_the_command_that_sets_them_up() -> None:
    port = free_ports()
    sim = Process("sim", "echowing", "--serve", str(port), "--parked")
    sim.wait_for(lambda line: f"setup apply --vehicle tcp:127.0.0.1:{port + 10}" in line)
    assert sim.end() == 0
