"""The real tools and the board's real binary over links that lose bytes: nothing crashes."""

import json
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from echowing.geo import displace
from echowing.setup.applet import applet_path
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.sim.world.cutter import ByteLoss

from .field import FOLLOWER, LEADER, Bridge, Process, World, free_ports, in_slot, is_followed

pytestmark = pytest.mark.seconds(50)
# Of a radio at the edge of its reach; the wire to the co-processor beside a motor's cables.
LOSSY = (
    *("--set", "radio.leader.byte_loss=0.05", "--set", "radio.follower.byte_loss=0.05"),
    *("--set", "wire.byte_loss=0.05", "--set", "wire.flip=0.02"),
)
# In which a verb that asks again and again has got its answers.
PATIENCE_S = 400.0


@pytest.fixture(scope="module")
def air() -> Iterator[World]:
    """Vehicles in the air whose telemetry loses bytes; that they fly to the end is tested, too."""
    world = World(*LOSSY)
    yield world
    world.pilot.close()
    assert world.process.end() == 0  # an autopilot that has ended ends it with an error
    assert world.process.lines[-1] == "stopped"


def ended(tool: Process, code: int = 0) -> list[str]:
    """Its words, once it has ended by itself and not by a fault of its own."""
    assert tool.exit_code(PATIENCE_S) == code, tool.lines
    assert not any("Traceback" in line for line in tool.lines)
    return tool.lines


def test_follow_leads_its_follower(air: World) -> None:
    tool = air.follow()
    there = tool.row(in_slot)
    for _ in range(8):  # a row comes once a second
        there = tool.row(lambda row: True, there + 1)
    tool.row(in_slot, there)

    assert tool.end(signal.SIGTERM) == 0
    assert "stopped" in tool.lines[-1]
    rows = [one for one in map(json.loads, tool.lines[:-1]) if "state" in one]
    # It is believed to be where it is: nowhere else in any row.
    assert max(row["separation_m"] or 0.0 for row in rows) < 30.0


def test_a_leader_is_published(air: World) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    where = f"udp:127.0.0.1:{port}"
    publisher = Process("leader", "--vehicle", air.link(LEADER), "--publish", where)
    publisher.wait_for(lambda line: "published to" in line)
    tool = Process(
        *("follow", "--leader-from", where, "--follower", air.link(FOLLOWER)),
        *("--engage", "--json", "--no-log"),
    )
    tool.row(in_slot)

    tool.kill()
    assert publisher.end(signal.SIGINT) == 0
    assert publisher.lines[-1].endswith("ended")


def test_a_relay_flies(air: World) -> None:
    ground = displace(ORIGIN, (-16.0, 0.0, 0.0))
    ends = ("--remote", air.link(LEADER), "--vehicle", air.link(FOLLOWER))
    tool = Process(
        *("relay", *ends, "--ground", f"{ground.lat_deg:.7f},{ground.lon_deg:.7f}"),
        *("--altitude", "10", "--min-separation", "1.5", "--engage", "--json", "--no-log"),
    )
    tool.row(lambda row: is_followed(row) and row["slot_error_m"] < 2.0)

    assert tool.end(signal.SIGTERM) in (0, 1)
    assert not any("Traceback" in line for line in tool.lines)


# Piece by piece it is `test_ftp`'s and `test_setup_vehicle`'s, which lose more.
@pytest.mark.long
def test_a_vehicle_is_set_up(tmp_path: Path) -> None:
    """What is written is read back, and the applet arrives byte by byte.

    Of 700 pieces of the applet and their answers one in twelve is lost, and waited for.
    """
    port, cards = free_ports(), tmp_path / "cards"
    served = Process(
        *("sim", "echowing", "--serve", str(port), "--parked", "--card", str(cards)),
        *("--set", "radio.follower.byte_loss=0.01"),
    )
    served.wait_for(lambda line: f"system {FOLLOWER}" in line)
    vehicle = ("--vehicle", f"tcp:127.0.0.1:{port + 10}@{FOLLOWER}")

    saved = ("--save", str(tmp_path / "old.json"))
    tool = Process("setup", "apply", "--serial", "2", "--restart", *saved, *vehicle, stdin="y\n")
    assert any("all is set" in line for line in ended(tool))
    script = cards / str(FOLLOWER) / "APM" / "scripts" / "echowing.lua"
    assert script.read_bytes() == applet_path().read_bytes()

    assert served.end() == 0


@pytest.fixture(scope="module")
def board() -> Iterator[str]:
    """The emulated board behind a link that loses bytes: where `rig` finds it."""
    port = free_ports()
    emulated = Process("emulator", "--link", f"tcpin:{port}", "--range-cm", "321")
    emulated.wait_for(lambda line: f":{port}" in line)
    bridge = Bridge(port, ByteLoss(byte_loss=0.05, flip=0.02))
    yield f"tcp:127.0.0.1:{bridge.port}"
    bridge.close()
    emulated.kill()


def rig(board: str, *verb: str) -> Any:
    return json.loads("\n".join(ended(Process("rig", "--port", board, *verb, "--json"))))


def test_rig_reads_and_commands_a_board(board: str) -> None:
    told = rig(board, "info")
    assert told["component_id"] == 191
    assert told["parameters"]["SONAR_ADDR"] == 112.0
    assert rig(board, "aim", "1500", "1300") == {"pan_us": 1500, "tilt_us": 1300}
    rig(board, "scan", "start")


def test_rig_shows_only_what_is_whole(board: str) -> None:
    """The sonar reads 3.21 m all the time: any other number is a damaged one that was believed."""
    tool = Process("rig", "--port", board, "watch", "--json")
    damaged = tool.wait_for(lambda line: json.loads(line)["wire"]["damaged"] >= 5)
    tool.end(signal.SIGINT)

    seen = {json.loads(line)["range_m"] for line in tool.lines[: damaged + 1]}
    assert seen <= {None, 3.21}
    assert 3.21 in seen
