"""Real ground tools connect to simulated vehicles over real sockets."""

import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.commands.follow import options_of
from echowing.errors import EchowingError
from echowing.paths import repository_root
from echowing.sim.scenario import load_scenario
from echowing.sim.serve import HOPELESS_S, STEP_S, Server, open_port
from echowing.sim.serve_flight import say_how_to_go_on
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter

SYSTEM_ID = 3
PATIENCE_S = 60.0  # what is heard ends it early


class Vehicle:
    """A vehicle on the ground, on one thread of its own."""

    def __init__(self) -> None:
        self.copter = Copter((0.0, 0.0, 0.0))
        self.autopilot = Autopilot(self.copter, system_id=SYSTEM_ID)
        for link in ("usb", "telemetry"):
            self.autopilot.add_link(link)
        self.server = Server(self.step)

    def step(self, t_s: float) -> None:
        self.copter.step(STEP_S)
        self.autopilot.step(t_s)


@pytest.fixture
def vehicle() -> Iterator[tuple[Vehicle, str, str]]:
    """A running vehicle with pymavlink's strings for its TCP and its UDP port."""
    made = Vehicle()
    tcp: Any = made.server.connect(made.autopilot, "telemetry", "tcpin:0")
    udp: Any = made.server.connect(made.autopilot, "usb", "udpin:0")
    done = threading.Event()
    thread = threading.Thread(target=made.server.run, args=(done.is_set,))
    thread.start()
    yield made, f"tcp:127.0.0.1:{tcp.port}", f"udpout:127.0.0.1:{udp.port}"
    done.set()
    thread.join()
    made.server.close()


def connect(where: str) -> Any:
    link = mavutil.mavlink_connection(where, source_system=245, dialect="ardupilotmega")
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    assert link.wait_heartbeat(timeout=PATIENCE_S) is not None
    return link


def command(link: Any, number: int, *values: float) -> int:
    link.mav.command_long_send(SYSTEM_ID, 1, number, 0, *values, *(0.0,) * (7 - len(values)))
    answer = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=PATIENCE_S)
    assert answer is not None
    assert answer.command == number
    return int(answer.result)


def fly(link: Any) -> None:
    link.set_mode("GUIDED")
    while link.wait_heartbeat(timeout=PATIENCE_S).custom_mode != 4:
        pass
    while link.recv_match(type="COMMAND_ACK") is not None:
        pass  # of the mode
    assert command(link, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == 0
    assert command(link, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == 0
    assert command(link, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 50_000) == 0


def test_over_tcp_arm_take_off_fly_and_read_parameters(
    vehicle: tuple[Vehicle, str, str],
) -> None:
    link = connect(vehicle[1])
    fly(link)
    link.mav.param_request_list_send(SYSTEM_ID, 1)
    names: set[str] = set()
    rates = []
    last = None
    while True:
        message = link.recv_match(
            type=["PARAM_VALUE", "LOCAL_POSITION_NED"], blocking=True, timeout=PATIENCE_S
        )
        assert message is not None
        if message.get_type() == "LOCAL_POSITION_NED":
            rates.append(message.time_boot_ms)
            last = message
            continue
        names.add(message.param_id)
        if len(names) == message.param_count:
            break
    assert {"WP_SPD", "MAV_SYSID", "RNGFND1_ADDR"} <= names
    periods = [b - a for a, b in pairwise(rates)]
    assert sum(periods) / len(periods) == pytest.approx(50.0, abs=2.0)  # of the vehicle's clock
    assert last is not None
    assert last.z < -1.0  # three seconds later it is on its way up to 2 m
    link.mav.set_position_target_local_ned_send(
        0, SYSTEM_ID, 1, 1, 0x0DF8, 3.0, 0.0, -2.0, *(0.0,) * 8
    )
    while link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=PATIENCE_S).x < 0.5:
        pass
    link.close()


def test_over_udp_and_tcp_at_once(vehicle: tuple[Vehicle, str, str]) -> None:
    by_udp, by_tcp = connect(vehicle[2]), connect(vehicle[1])
    by_udp.mav.param_set_send(SYSTEM_ID, 1, b"WP_SPD", 3.5, 9)
    for link in (by_udp, by_tcp):  # a change is told to everybody
        told = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S)
        assert (told.param_id, told.param_value) == ("WP_SPD", 3.5)
        link.close()


class FakeClock:
    """Time that moves only when slept."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def test_pace_is_real_time_and_lost_time_is_let_go() -> None:
    clock = FakeClock()
    times: list[float] = []
    server = Server(times.append, clock=clock, sleep=clock.sleep)
    server.run(lambda: clock.now_s >= 102.0)
    assert len(times) == pytest.approx(2.0 / STEP_S, abs=2)
    assert times[0] == pytest.approx(STEP_S)
    clock.now_s += HOPELESS_S / 2  # a hiccup is caught up
    before = len(times)
    server.run(lambda: clock.now_s >= 103.0)
    assert len(times) - before == pytest.approx(1.0 / STEP_S, abs=2)
    clock.now_s += 60.0  # a suspended machine is not
    before = len(times)
    end_s = clock.now_s + 1.0
    server.run(lambda: clock.now_s >= end_s)
    assert len(times) - before == pytest.approx(1.0 / STEP_S, abs=2)


def test_nobody_there_does_no_harm() -> None:
    clock = FakeClock()
    copter = Copter((0.0, 0.0, 0.0))
    autopilot = Autopilot(copter, system_id=1)
    autopilot.add_link("telemetry")
    server = Server(autopilot.step, clock=clock, sleep=clock.sleep)
    wire: Any = server.connect(autopilot, "telemetry", "udpout:127.0.0.1:9")
    assert wire.describe() == "udpout:127.0.0.1:9"
    server.run(lambda: clock.now_s >= 103.0)
    time.sleep(0.01)  # the refusal of a datagram comes back
    server.run(lambda: clock.now_s >= 104.0)
    server.close()


@pytest.mark.parametrize("where", ["udpin:x", "udpout:5000", "udpin:70000", "nonsense:1"])
def test_wrong_ports_say_what_to_write(where: str) -> None:
    with pytest.raises(EchowingError, match="write"):
        open_port(where)


def test_a_taken_port_is_named() -> None:
    first: Any = open_port("udpin:0")
    with pytest.raises(EchowingError, match=str(first.port)):
        open_port(f"udpin:{first.port}")
    first.close()


@pytest.mark.parametrize(
    ("scenario", "changes", "given"),
    [
        ("echowing", [], ""),
        ("thesis", [], "--position-only "),
        ("echowing", ["sonar.file={file}", "leader.target=stock"], "--sonar {file} --legs stock "),
    ],
)
def test_the_printed_command_flies_what_the_scenario_is(
    scenario: str,
    changes: list[str],
    given: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its applet's points, and what is believed of its sonars: else another flight is rehearsed."""
    file = tmp_path / "mine.toml"
    shipped = repository_root() / "host_tools" / "echowing" / "sonars" / "mb1202.toml"
    file.write_bytes(shipped.read_bytes())
    say_how_to_go_on(load_scenario(scenario, [one.format(file=file) for one in changes]), 5760)
    said = capsys.readouterr().out
    assert f"--radius 3 {given.format(file=file)}--engage" in said


LINE_ASTERN = "formation.slots=[{radius_m=4.0}, {radius_m=7.9}]"
FOLLOW_TWO = ["--leader", "udpin:1@1", "--follower", "udpin:1@2", "--follower", "udpin:1@3"]


def test_a_served_formation_does_not_loosen_what_follow_demands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    allowed = "formation.slot_separation_m=2.0"
    say_how_to_go_on(load_scenario("echowing", [LINE_ASTERN, allowed]), 5760)
    said = capsys.readouterr().out
    assert "follow will refuse it: formation: slots 1 and 2 are 3.90 m apart" in said
    with pytest.raises(EchowingError, match=r"3\.90 m apart, less than 4\.83"):
        options_of([*FOLLOW_TWO, "--formation", "out/formation-5760.toml"])


def test_a_served_formation_keeps_a_stricter_demand_of_its_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    say_how_to_go_on(load_scenario("many"), 5760)  # says 5 m
    assert "refuse" not in capsys.readouterr().out
    written = Path("out/formation-5760.toml").read_text(encoding="utf-8")
    assert written.startswith("slot_separation_m = 5.0\n")


def test_a_served_shape_is_flown_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    two = "formation.followers=2"
    say_how_to_go_on(load_scenario("vee", [two]), 5760)
    said = capsys.readouterr().out
    assert "--formation vee --spacing 3 --engage" in said
    assert "refuse" not in said
    # A stricter demand of the scenario is one more key, and so there is a file.
    say_how_to_go_on(load_scenario("vee", [two, "formation.slot_separation_m=5", FIVE_M]), 5761)
    assert "--formation out/formation-5761.toml" in capsys.readouterr().out
    options_of([*FOLLOW_TWO, "--formation", "out/formation-5761.toml"])


def test_a_served_column_is_flown_as_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    say_how_to_go_on(load_scenario("column", ["formation.followers=2"]), 5760)
    said = capsys.readouterr().out
    assert "--formation column --spacing 3 --simulated --engage" in said
    assert "refuse" not in said
    options_of([*FOLLOW_TWO, "--formation", "column", "--simulated"])


def test_gaps_close_as_the_command_or_the_file_asks(tmp_path: Path) -> None:
    column = [*FOLLOW_TWO, "--simulated", "--formation"]
    assert not options_of([*column, "column"]).settings.close_gaps
    assert options_of([*column, "column", "--close-gaps"]).settings.close_gaps
    path = tmp_path / "formation.toml"
    slots = "close_gaps = true\n[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = {}\nbehind = 1\n"
    path.write_text(slots.format(3.0), encoding="utf-8")
    assert options_of([*column, str(path)]).settings.close_gaps
    path.write_text(slots.format(4.0), encoding="utf-8")
    with pytest.raises(EchowingError, match="gaps cannot close: slot 2 and slot 1"):
        options_of([*column, str(path)])


def test_a_served_formation_that_closes_gaps_is_flown_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say_how_to_go_on(load_scenario("column", ["formation.close_gaps=true"]), 5760)
    assert "--formation column --spacing 3 --close-gaps" in capsys.readouterr().out


def test_shapes_to_take_later_are_flown_as_the_command_or_the_file_asks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    column = [*FOLLOW_TWO, "--simulated", "--formation"]
    assert not options_of([*column, "column"]).shapes
    assert [name for name, _ in options_of([*column, "column,vee"]).shapes] == ["column", "vee"]
    changed = "formation.changes=[{shape='vee', at_s=60}]"
    say_how_to_go_on(load_scenario("column", ["formation.followers=2", changed]), 5760)
    assert "--formation column,vee --spacing 3 --simulated" in capsys.readouterr().out
    path = tmp_path / "formation.toml"
    path.write_text(
        'shape = "column"\nfollowers = 2\nspacing_m = 3\n[[changes]]\nshape = "vee"\nat_s = 60\n',
        encoding="utf-8",
    )
    assert [name for name, _ in options_of([*column, str(path)]).shapes] == ["column", "vee"]
    with pytest.raises(EchowingError, match="no shape 'vea'"):
        options_of([*column, "column,vea"])
    assert [name for name, _ in options_of([*column, "column, vee"]).shapes] == ["column", "vee"]
    with pytest.raises(EchowingError, match="--build-up takes one shape"):
        options_of([*column, "column,vee", "--build-up", "8,4"])
    path.write_text("[[slots]]\nradius_m = 3\n[[changes]]\nshape = 'vee'\nat_s = 60\n")
    with pytest.raises(EchowingError, match="changes are from a shape"):
        options_of([*column, str(path)])
    falls = "formation.changes=[{shape='vee', at_s=60}, {shape='column', at_s=20}]"
    with pytest.raises(EchowingError, match="at_s has to rise"):
        load_scenario("column", ["formation.followers=2", falls])


def test_shapes_whose_slots_meet_on_the_way_are_refused() -> None:
    near = ["formation.shape=vee", "formation.followers=2", "formation.spacing_m=1.8"]
    allowed = "formation.slot_separation_m=1"
    changed = "formation.changes=[{shape='column', at_s=60}]"
    with pytest.raises(EchowingError, match="from vee to column two slots come to"):
        load_scenario("column", [*near, allowed, changed])


FIVE_M = "formation.spacing_m=5"
