"""`echowing emulator`: a process whose ports other programs open."""

import json
import math
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.belief import Curve
from echowing.flight.sonar import PAN_CENTRE_US, TILT_CENTRE_US
from echowing.sim.boards.avr import AvrBoard
from echowing.sim.boards.desk import Desk, Scene, targets_from
from echowing.sim.boards.wires import PtyWire, TcpServerWire, open_udp, open_wire
from echowing.sim.world.sonar import (
    COMMAND_RANGE,
    DEFAULT_ADDRESS,
    LEVER_ARM_M,
    ON_A_DESK,
    TrueSonar,
)

from .bench import BenchSonar
from .emulator_process import PATIENCE_S, Emulator


def report(link: Any, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
    """The next DISTANCE_SENSOR that satisfies."""
    while True:
        message = link.recv_match(type="DISTANCE_SENSOR", blocking=True, timeout=PATIENCE_S)
        assert message is not None
        if wanted(message):
            return message


class TestProcess:
    @pytest.mark.parametrize("board", ["mega", "native"])
    def test_listens_on_tcp_and_opens_a_terminal(
        self, start: Callable[..., Emulator], board: str
    ) -> None:
        options = ("--link", "tcpin:0", "--usb", "pty", "--range-cm", "321")
        emulator = start("--board", board, *options)
        port = emulator.told(r"autopilot port: tcp 127\.0\.0\.1:(\d+)")
        usb = emulator.told(r"USB port: (/dev/\S+)")
        for where in (f"tcp:127.0.0.1:{port}", usb):
            link = mavutil.mavlink_connection(where, baud=115200)
            assert report(link, lambda m: m.current_distance < 766).current_distance == 321
            link.close()

    def test_connects_to_a_listener_that_comes_late(self, start: Callable[..., Emulator]) -> None:
        with socket.create_server(("127.0.0.1", 0)) as place:
            port = place.getsockname()[1]
        emulator = start("--link", f"tcp:127.0.0.1:{port}", "--range-cm", "200")
        emulator.told(rf"autopilot port: (tcp 127\.0\.0\.1:{port})")
        link = mavutil.mavlink_connection(f"tcpin:127.0.0.1:{port}")
        report(link)
        link.close()

    def test_follows_the_target_told_in_datagrams(self, start: Callable[..., Emulator]) -> None:
        emulator = start("--link", "tcpin:0", "--target", "udp:0")
        port = emulator.told(r"autopilot port: tcp 127\.0\.0\.1:(\d+)")
        target = int(emulator.told(r"target datagrams: udp 127\.0\.0\.1:(\d+)"))
        link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}")
        assert report(link).current_distance == 766
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"nonsense", ("127.0.0.1", target))
            place = b'{"forward_m": 3.2, "right_m": 0.0, "down_m": 0.0}'
            sender.sendto(place, ("127.0.0.1", target))
        # Face of the sonar 0.1 m ahead, legs of the leader 0.1 m nearer than its centre.
        near = report(link, lambda m: m.current_distance < 766)
        assert near.current_distance == pytest.approx(300, abs=5)
        link.close()
        assert "nonsense" in emulator.told("(.*nonsense.*)")

    def test_keeps_its_memory_in_a_file(
        self, start: Callable[..., Emulator], tmp_path: Path
    ) -> None:
        image = tmp_path / "board.eep"
        emulator = start("--eeprom", image, "--duration", "0.05")
        emulator.process.wait(timeout=PATIENCE_S)
        assert image.stat().st_size == 4096

    def test_a_binary_that_is_not_there_is_named(self, tmp_path: Path) -> None:
        emulator = Emulator("--elf", tmp_path / "none.elf")
        assert emulator.process.wait(timeout=PATIENCE_S) == 2
        complaint = emulator.stop()
        assert "none.elf: no such file" in complaint
        assert "Traceback" not in complaint

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--board", "uno"], "no board 'uno': BOARD is one of mega, blackpill_f411"),
            (["--board", "native", "--eeprom", "x"], "runs no --elf and stores nothing"),
            (["--link", "serial"], "write tcp:HOST:PORT, tcpin:PORT or pty"),
            (["--link", "tcp:localhost:http"], "the port has to be a number"),
            (["--range-cm", "-1"], "0 to 10000"),
            (["--eeprom", "/"], "cannot read the memory from /: Is a directory"),
            (["--eeprom", "/no/where", "--duration", "0"], "cannot keep the memory in /no/where"),
            (["--target", "tcp:1"], "write udp:PORT"),
            (["--target", "udp:0", "--sonar", "ear=1"], "sonar.ear: no such key"),
            (["--range-cm", "100", "--target", "udp:1"], "not allowed with"),
        ],
    )
    def test_bad_options(
        self, mega_elf: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        code: object
        try:
            code = main(["emulator", *options])
        except SystemExit as end:  # as argparse ends
            code = end.code
        assert code == 2
        assert words in capsys.readouterr().err


def heard_m(off_deg: float, sonar: TrueSonar) -> float | None:
    """What a scene's sonar reads of a leader 3 m away."""
    off = math.radians(off_deg)
    leader = (LEVER_ARM_M + 3.0 * math.cos(off), 3.0 * math.sin(off), 0.0)
    scene = Scene(watched=lambda: leader, sonar=sonar)
    scene.step(0.02, PAN_CENTRE_US, TILT_CENTRE_US)
    scene.sensor.write(0, DEFAULT_ADDRESS, bytes([COMMAND_RANGE]))
    return scene.sensor.last_range_m


def test_a_scene_hears_as_the_sonar_that_it_is_given() -> None:
    desk = replace(ON_A_DESK, wild_share=0.0)
    narrow = replace(desk, half_rad=Curve((0.0,), (math.radians(6.0),)), inset_m=0.3)

    assert heard_m(12.0, desk) == pytest.approx(3.0 - 0.1, abs=0.05)
    assert heard_m(12.0, narrow) is None
    assert heard_m(0.0, narrow) == pytest.approx(3.0 - 0.2, abs=0.05)


def test_a_sonar_on_a_boom_is_nearer_to_its_leader() -> None:
    """On `mb1202-boom` it reads 0.45 m less than the separation."""
    boom = replace(ON_A_DESK, wild_share=0.0, boom_m=0.33, inset_m=0.45)

    assert heard_m(0.0, boom) == pytest.approx(LEVER_ARM_M + 3.0 - 0.45, abs=0.05)


def test_of_several_told_the_nearest_in_the_beam_is_heard() -> None:
    """One that is nearer but beside the beam hides nobody."""
    scene = Scene(target="udp:0", sonar=replace(ON_A_DESK, wild_share=0.0))
    places = [(1.0, 2.0, 0.0), (4.2, 0.0, 0.0), (3.2, 0.0, 0.0)]
    names = ("forward_m", "right_m", "down_m")
    told = json.dumps([dict(zip(names, place, strict=True)) for place in places])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(told.encode(), ("127.0.0.1", scene.udp_port or 0))
    scene.step(0.02, PAN_CENTRE_US, TILT_CENTRE_US)
    scene.sensor.write(0, DEFAULT_ADDRESS, bytes([COMMAND_RANGE]))
    scene.close()
    assert scene.sensor.last_range_m == pytest.approx(3.2 - ON_A_DESK.inset_m, abs=0.05)


class TestWires:
    def test_terminal_that_nobody_reads_loses_bytes_and_does_not_block(self) -> None:
        wire = PtyWire()
        for _ in range(1000):
            assert wire.exchange(b"x" * 100, 0.0) == b""
        wire.close()

    def test_listener_takes_the_next_after_one_has_gone(self) -> None:
        wire = TcpServerWire(0)
        for _ in range(2):
            with socket.create_connection(("127.0.0.1", wire.port)) as peer:
                peer.sendall(b"hello")
                heard = b""
                while not heard:
                    heard = wire.exchange(b"board", 0.0)
                assert heard == b"hello"
                assert peer.recv(5) == b"board"
            while wire.exchange(b"", 0.0) == b"" and wire.connected:
                pass
        wire.close()

    def test_port_that_is_taken(self) -> None:
        wire = TcpServerWire(0)
        with pytest.raises(EchowingError, match=f"cannot listen on port {wire.port}"):
            open_wire(f"tcpin:{wire.port}")
        with pytest.raises(EchowingError, match="the port has to be a number from 1"):
            open_wire("tcp:localhost:0")
        wire.close()

    def test_udp_port_that_is_taken(self) -> None:
        with open_udp("udp:0") as first, pytest.raises(EchowingError, match="cannot listen"):
            open_udp(f"udp:{first.getsockname()[1]}")


class TestDatagrams:
    def test_place(self) -> None:
        told = b'{"forward_m": 3.5, "right_m": -1, "down_m": 0.25}'
        assert targets_from(told) == [(3.5, -1.0, 0.25)]
        assert targets_from(b"[" + told + b"," + told + b"]") == 2 * [(3.5, -1.0, 0.25)]
        assert targets_from(b"[]") == []

    @pytest.mark.parametrize(
        "told",
        [
            b"",
            b"\xff\xfe",
            b"[1,2,3]",
            b"7",
            b'{"forward_m": 1}',
            b'{"forward_m": NaN, "right_m": 0, "down_m": 0}',
            b'{"forward_m": null, "right_m": 0, "down_m": 0}',
        ],
    )
    def test_nonsense_says_what_is_wanted(self, told: bytes) -> None:
        with pytest.raises(EchowingError, match=r"forward_m.*right_m.*down_m"):
            targets_from(told)


class TestPace:
    """The desk against a clock of its own."""

    def desk(self, probe_elf: Path, speed: float) -> tuple[Desk, list[float]]:
        """A desk on a machine on which a slice takes `speed` ms; and the clock."""
        now = [100.0]

        def clock() -> float:
            now[0] += speed / 1000.0
            return now[0]

        def sleep(seconds: float) -> None:
            now[0] += seconds

        board = AvrBoard(BenchSonar(), board="mega", elf=probe_elf)
        return Desk(board, {}, Scene(), clock=clock, sleep=sleep), now

    def test_keeps_to_the_clock(self, probe_elf: Path) -> None:
        desk, now = self.desk(probe_elf, 0.1)
        desk.run(1.0)
        assert now[0] - 100.0 == pytest.approx(1.0, abs=0.01)

    def test_says_that_a_machine_is_too_slow(
        self, probe_elf: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        desk, now = self.desk(probe_elf, 3.0)
        desk.run(1.0)
        assert now[0] - 100.0 > 2.0
        assert capsys.readouterr().out.count("too slow") == 1
