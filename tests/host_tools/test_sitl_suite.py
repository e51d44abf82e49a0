"""The SITL suite's own parts that need no ArduCopter: what they compute has to be right, too."""

import math
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from echowing.bench import robust
from echowing.sim import flight
from echowing.sim.hangar import Hangar
from echowing.sim.scenario import load_scenario
from echowing.sim.world import gps

from ..sitl import loopback, truth
from ..sitl.drift import METRES_PER_DEGREE, STEP_S, Drift
from ..sitl.follows import fitted, velocity_leaves
from ..sitl.names import SPEED, Version
from ..sitl.relay import Link, Queue
from ..sitl.table import Entry, Figures, agrees, lines
from ..sitl.vehicle import ORIGIN, State
from ..sitl.worlds import WORLDS

REPOSITORY = Path(__file__).parents[2]
# Generous: a busy machine may take its time.
DEADLINE_S = 60.0


# ---- names and versions ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("packed", "line", "generation"),
    [
        (0x04_08_00_00, "4.8", "4.8"),
        (0x04_06_03_FF, "4.6", "4.6"),
        (0x04_05_07_FF, "4.5", "4.5"),
        (0x04_09_00_40, "4.9", "4.8"),  # the nearest that the simulator has
    ],
)
def test_a_version_as_the_autopilot_says_it(packed: int, line: str, generation: str) -> None:
    version = Version.unpack(packed)
    assert (version.line, version.generation) == (line, generation)


def test_speed_goes_by_either_name_in_its_unit() -> None:
    assert SPEED == {"WP_SPD": 1.0, "WPNAV_SPEED": 100.0}


# ---- drift -------------------------------------------------------------------------------------


def test_drift_has_the_deviation_and_the_memory_of_its_model() -> None:
    drift = Drift(0.8, 6.0, random.Random(4))
    north_m = []
    for _ in range(6_000):
        drift.step(0.5)
        north_m.append(drift.north_m)
    values = np.array(north_m)
    later = round(6.0 / 0.5)
    memory = np.corrcoef(values[:-later], values[later:])[0, 1]
    # 500 times constants: the deviation is known to 1/sqrt(500) or so, the memory likewise.
    assert values.std() == pytest.approx(0.8, rel=0.1)
    assert memory == pytest.approx(math.exp(-1.0), abs=0.1)


def test_drift_is_that_of_the_simulators_receiver() -> None:
    assert flight.STEP_S == STEP_S
    hangar = Hangar(load_scenario("echowing", ["gps.spread=0", "gps.velocity_sigma_mps=0"]), 2)
    simulated = hangar.leader().drift
    settings = hangar.scenario.gps
    drift = Drift.of_receiver(settings.sigma_m, settings.tau_s, 2, "leader")
    # The simulator's has the autopilot's filter behind it.
    north, east = (gps.Filter(settings.follows_s, one) for one in (drift.north_m, drift.east_m))
    for _ in range(500):
        drift.step(STEP_S)
        north.step(drift.north_m, 0.0, STEP_S)
        east.step(drift.east_m, 0.0, STEP_S)
        assert simulated.step(STEP_S)[:2] == pytest.approx((north.error_m, east.error_m))


@pytest.mark.parametrize("later_s", [0.3, 1.5, 4.0])
def test_how_much_later_an_estimate_follows_is_found(later_s: float) -> None:
    receiver, errors_m = Drift(0.8, 60.0, random.Random(1)), np.zeros(2000)
    for k in range(len(errors_m)):
        receiver.step(0.1)
        errors_m[k] = receiver.north_m
    keep, believed_m = math.exp(-0.1 / later_s), errors_m.copy()
    for k in range(1, len(errors_m)):
        believed_m[k] = keep * believed_m[k - 1] + (1.0 - keep) * errors_m[k]

    found = fitted("north", errors_m, believed_m)

    assert found.later_s == pytest.approx(later_s, rel=0.01)
    assert found.left_m < 0.001 < found.of_m


def test_of_no_logs_nothing_is_told() -> None:
    with pytest.raises(ValueError, match="give the logs"):
        velocity_leaves([])


def test_drift_in_degrees_is_the_same_length_north_and_east() -> None:
    drift = Drift(0.0, 60.0, random.Random(1))
    drift.north_m = drift.east_m = 10.0
    north_deg, east_deg = drift.degrees(60.0)
    assert north_deg * METRES_PER_DEGREE == pytest.approx(10.0)
    assert east_deg == pytest.approx(2.0 * north_deg)  # cos 60 degrees


# ---- the late link -----------------------------------------------------------------------------


def test_bytes_arrive_late_and_in_order() -> None:
    queue = Queue(0.46)
    queue.put(1.0, b"one ")
    queue.put(1.1, b"two")
    assert queue.take(1.45) == b""
    assert queue.due_s() == pytest.approx(1.46)
    assert queue.take(1.46) == b"one "
    assert queue.take(2.0) == b"two"
    assert queue.due_s() is None


@pytest.fixture
def ends() -> Iterator[tuple[Link, socket.socket, socket.socket]]:
    """A link, its tool's end and its vehicle's."""
    with socket.create_server(("127.0.0.1", 0)) as vehicle:
        link = Link(vehicle.getsockname()[1], 0.0)
        with socket.create_connection(("127.0.0.1", link.port)) as tool:
            accepted, _ = vehicle.accept()
            with accepted:
                for end in (tool, accepted):
                    end.settimeout(DEADLINE_S)
                yield link, tool, accepted
        link.close()


def test_a_link_carries_both_ways(ends: tuple[Link, socket.socket, socket.socket]) -> None:
    _, tool, vehicle = ends
    tool.sendall(b"up")
    assert vehicle.recv(10) == b"up"
    vehicle.sendall(b"down")
    assert tool.recv(10) == b"down"


def taken(link: Link, count: int) -> None:
    """Wait until so many bytes have come to the link."""
    until_s = time.monotonic() + DEADLINE_S
    while link.taken_bytes < count:
        assert time.monotonic() < until_s
        time.sleep(0.005)


def test_a_cut_link_loses_what_is_sent_and_stays_connected(
    ends: tuple[Link, socket.socket, socket.socket],
) -> None:
    link, tool, vehicle = ends
    link.cut.set()
    tool.sendall(b"lost")
    taken(link, 4)
    link.cut.clear()
    tool.sendall(b"heard")
    assert vehicle.recv(10) == b"heard"


def test_a_lossy_link_loses_packets_both_ways(
    ends: tuple[Link, socket.socket, socket.socket],
) -> None:
    link, *both = ends
    for sender, receiver in (both, both[::-1]):
        before = link.taken_bytes
        link.lose(0.3)
        sender.sendall(bytes(4000))  # 80 packets or so
        taken(link, before + 4000)
        link.lose(0.0)
        sender.sendall(b"heard")
        arrived = b""
        while not arrived.endswith(b"heard"):
            arrived += receiver.recv(4000)
        assert 2000 < len(arrived) < 3600


# ---- truth -------------------------------------------------------------------------------------


def _track(north_m: list[float], rate_hz: float = 10.0, later_s: float = 0.0) -> list[State]:
    return [
        State(
            number / rate_hz + later_s,
            ORIGIN.lat_deg + metres / METRES_PER_DEGREE,
            ORIGIN.lon_deg,
            ORIGIN.alt_m,
            (0.0, 0.0, 0.0),
            0.0,
            0.0,
            0.0,
        )
        for number, metres in enumerate(north_m)
    ]


def test_separation_is_measured_at_the_same_moment() -> None:
    """Both fly at 2 m/s, 3 m apart; the follower is heard half a period later."""
    leader = _track([3.0 + 0.2 * k for k in range(101)])
    follower = _track([0.2 * k + 0.1 for k in range(101)], later_s=0.05)
    flown = truth.figures(leader, follower, 1.0, 9.0, 3.0)
    # A degree of latitude is not quite the mean one at 47 degrees north: 0.1 %.
    assert flown.mean_separation_m == pytest.approx(3.0, abs=0.01)
    assert flown.mean_abs_error_m < 0.01


def test_the_least_separation_of_a_part_is_of_that_part_only() -> None:
    leader = _track([3.0] * 50 + [1.0] * 51)
    follower = _track([0.0] * 101)
    assert truth.figures(leader, follower, 0.0, 4.5, 3.0).min_separation_m > 2.9
    assert truth.figures(leader, follower, 0.0, 9.0, 3.0).min_separation_m == pytest.approx(
        1.0, abs=0.01
    )


def test_a_gap_in_what_was_heard_is_found() -> None:
    track = [*_track([0.0] * 10), *_track([0.0] * 10, later_s=1.4)]
    assert truth.longest_gap_s(track, 0.0) == pytest.approx(0.5)
    assert truth.longest_gap_s(track, 1.4) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("angles_deg", "body"),
    [
        ((0.0, 0.0, 90.0), (0.0, -1.0, 0.0)),  # nose east: north is to the left
        ((0.0, 30.0, 0.0), (math.cos(math.pi / 6), 0.0, 0.5)),  # nose up: ahead is below the axis
        ((90.0, 0.0, 90.0), (0.0, 0.0, 1.0)),  # nose east, lying on the right side
    ],
)
def test_north_in_the_body_frame(
    angles_deg: tuple[float, float, float], body: tuple[float, float, float]
) -> None:
    roll, pitch, yaw = map(math.radians, angles_deg)
    vector = truth.body_frame(np.array([1.0, 0.0, 0.0]), roll, pitch, yaw)
    assert vector == pytest.approx(body, abs=1e-9)


# ---- the table ---------------------------------------------------------------------------------


def test_the_table_has_the_simulators_figures_beside() -> None:
    flown, simulated = Figures(3.5, 0.5, 0.6, 2.2), Figures(3.47, 0.5, 0.54, 2.3)
    text = lines([Entry("4.8", "rectangle", flown, simulated), Entry("4.6", "wall", Figures())])
    assert [cell.strip() for cell in text[2].split("|")[1:-1]] == [
        *("4.8", "rectangle", "3.50", "0.50", "0.60", "2.20", "3.47", "0.50", "0.54", "2.30", ""),
    ]
    assert len({len(line) for line in text}) == 1
    assert {line.count("|") for line in text} == {12}  # more would be cells of Markdown


@pytest.mark.parametrize(
    ("flown", "simulated", "fine"),
    [(0.59, 0.50, True), (0.61, 0.50, False), (1.14, 1.0, True), (1.16, 1.0, False)],
)
def test_within_a_distance_or_a_share(flown: float, simulated: float, fine: bool) -> None:
    assert agrees(flown, simulated, within_m=0.10, within_share=0.15) is fine


# ---- worlds that are worse than believed -------------------------------------------------------


def test_a_world_is_that_of_a_row_of_the_bench() -> None:
    worlds = {
        case: (list(one.sonar), one.height_sigma_m, one.sigma_m) for case, one in WORLDS.items()
    }
    assert worlds == {
        "as shipped": (["spread=1"], 0.5, 0.8),
        "narrow": (["beam_near_deg=20", "beam_far_deg=6"], 0.5, 0.8),
        "four of ten": (["heard_share=0.4"], 0.5, 0.8),
        "heights": (["spread=1"], 1.0, 0.8),
        "receivers": (["spread=1"], 0.5, 1.5),
    }


@pytest.mark.parametrize("case", WORLDS)
def test_a_world_is_judged_by_the_goals_of_its_row(case: str) -> None:
    goal = WORLDS[case].goal
    kept = goal.mean_error_m, goal.rmsd_m, goal.least_m
    assert goal in {row.goal for row in robust.ROWS}
    assert goal.missed(*kept) == ()
    worse = kept[0] + 0.01, kept[1] + 0.01, kept[2] - 0.01
    assert goal.missed(*worse) == ("mean error", "RMSD", "least")


# ---- loopback only -----------------------------------------------------------------------------


def test_addresses_as_the_kernel_writes_them() -> None:
    assert loopback.address_from("0100007F:1680") == "127.0.0.1:5760"
    assert loopback.address_from("00000000:157D") == "0.0.0.0:5501"
    assert loopback.address_from(f"{'0' * 24}01000000:0050") == "::1:80"


def test_a_process_that_listens_on_loopback_is_let_be() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        assert address in loopback.require(os.getpid())


def test_an_open_port_is_refused_where_there_is_a_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loopback, "reachable_interfaces", lambda: ["eth0"])
    monkeypatch.setattr(loopback, "listening", lambda pid: ["0.0.0.0:5760", "127.0.0.1:5762"])
    with pytest.raises(loopback.NotOnLoopbackError, match=r"0\.0\.0\.0:5760.*eth0"):
        loopback.require(os.getpid())


def test_the_suite_leaves_the_network_or_says_why_it_cannot() -> None:
    """Not every system lets its users: then nothing may be started."""
    program = (
        "from tests.sitl import loopback\n"
        "try:\n"
        "    loopback.enter()\n"
        "    print('alone', loopback.reachable_interfaces())\n"
        "except loopback.NotOnLoopbackError as error:\n"
        "    print('refused', error)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    alone = ended.stdout == "alone []\n"
    assert alone or "let users make namespaces" in ended.stdout


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "no ArduCopter binary was given"),
        (["/no/such/arducopter"], "/no/such/arducopter: not a program that can be run"),
        (["README.md"], "README.md: not a program that can be run"),
    ],
)
def test_what_was_given_wrong_is_said(arguments: list[str], complaint: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.sitl", *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stderr.startswith(complaint)
    assert "make test-sitl" in ended.stderr


def test_flights_are_not_collected_with_the_other_tests() -> None:
    folder = REPOSITORY / "tests" / "sitl"
    assert not list(folder.glob("test_*.py"))
    assert not (folder / "conftest.py").exists()
