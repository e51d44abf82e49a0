"""The flashed binary, emulated: MAVLink on both of its ports, and whatever else comes in there."""

import itertools
import random
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink

from echowing.sim.boards.coprocessor import AUTOPILOT_PORT

from .bench import (
    CONSOLE_PORT,
    HAS_USB,
    IS_STM32,
    OUR_COMPONENT,
    OUR_ID,
    PORTS,
    VEHICLE_ID,
    Bench,
    BenchSonar,
)

pytestmark = pytest.mark.seconds(17)

BOOTED_S = 1.2
# What the board's UART takes at its setting for 115200 baud.
LINE_BYTES_A_SECOND = (115_200 if IS_STM32 else 117_647) / 10
ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3


@pytest.fixture
def bench(elf: Path) -> Bench:
    """A board that tracks a target at 2 m."""
    bench = Bench(elf, BenchSonar(2.0))
    bench.run(BOOTED_S)
    return bench


def list_parameters(bench: Bench, port: int = CONSOLE_PORT) -> list[Any]:
    """Everything a PARAM_REQUEST_LIST brings in 4 s."""
    begun_us = bench.t_us
    request = mavlink.MAVLink_param_request_list_message(OUR_ID, OUR_COMPONENT)
    bench.send(request, port)
    bench.run(4.0)
    return [heard.message for heard in bench.messages("PARAM_VALUE", port, begun_us)]


class TestIdentity:
    def test_system_id_is_the_vehicle_s(self, bench: Bench) -> None:
        assert bench.messages("HEARTBEAT")[-1].message.get_srcSystem() == OUR_ID
        bench.armed = False
        bench.run(6.5)  # five heartbeats, and one of its own
        newest = bench.messages("HEARTBEAT")[-1].message
        assert (newest.get_srcSystem(), newest.get_srcComponent()) == (VEHICLE_ID, OUR_COMPONENT)

    def test_others_on_the_wire_are_not_taken_for_it(self, bench: Bench) -> None:
        bench.send_heartbeat(255, 190)  # a ground station
        bench.send_heartbeat(VEHICLE_ID, 100)  # a camera of the vehicle's
        bench.run(1.5)
        assert bench.messages("HEARTBEAT")[-1].message.get_srcSystem() == OUR_ID

    def test_in_flight_it_never_switches_vehicles(self, bench: Bench) -> None:
        bench.armed = True
        bench.run(6.5)
        for _ in range(3):
            bench.send_heartbeat(VEHICLE_ID + 1, 1)
            bench.run(1.0)
        assert bench.messages("HEARTBEAT")[-1].message.get_srcSystem() == VEHICLE_ID


class TestParameters:
    @pytest.mark.parametrize("port", PORTS)
    def test_list_is_complete_in_order_and_paced(self, bench: Bench, port: int) -> None:
        begun_us = bench.t_us
        values = list_parameters(bench, port)
        count = values[0].param_count
        assert count > 15
        assert [value.param_index for value in values] == list(range(count))
        assert len({value.param_id for value in values}) == count
        # Paced: reports go on at their rate meanwhile.
        assert len(bench.ranges_cm(begun_us)) == pytest.approx(80, abs=3)

    def test_read_by_name_and_by_index(self, bench: Bench) -> None:
        for name, index in ((b"SCAN_DWELL", -1), (b"", 9)):
            begun_us = bench.t_us
            bench.send(
                mavlink.MAVLink_param_request_read_message(OUR_ID, OUR_COMPONENT, name, index)
            )
            bench.run(0.1)
            (heard,) = bench.messages("PARAM_VALUE", CONSOLE_PORT, begun_us)
            assert heard.message.param_id == "SCAN_DWELL"
            assert heard.message.param_value == 300

    def test_set_answers_with_the_new_value(self, bench: Bench) -> None:
        answer = bench.set_parameter("TRACK_RANGE", 300)
        assert (answer.param_id, answer.param_value) == ("TRACK_RANGE", 300)

    def test_a_change_acts_at_once(self, bench: Bench) -> None:
        bench.set_parameter("TRACK_RANGE", 150)  # the target at 2 m is now too far
        bench.run(0.5)
        assert bench.ranges_cm()[-1] == 766

    @pytest.mark.parametrize("value", [29, 766, float("nan"), float("inf"), 300.5])
    def test_out_of_range_is_refused_with_the_old_value(self, bench: Bench, value: float) -> None:
        assert bench.set_parameter("TRACK_RANGE", value).param_value == 450

    def test_message_for_another_device_is_left_alone(self, bench: Bench) -> None:
        begun_us = bench.t_us
        for system, component in ((OUR_ID, 1), (OUR_ID + 1, OUR_COMPONENT)):
            bench.send(mavlink.MAVLink_param_set_message(system, component, b"TRACK_RANGE", 300, 9))
        bench.run(0.3)
        assert bench.messages("PARAM_VALUE", CONSOLE_PORT, begun_us) == []

    def test_storm_of_requests_leaves_the_reports_alone(self, bench: Bench) -> None:
        begun_us = bench.t_us
        for _ in range(40):
            for port in PORTS:
                bench.send(mavlink.MAVLink_param_request_list_message(0, 0), port)
                bench.send(
                    mavlink.MAVLink_param_set_message(OUR_ID, OUR_COMPONENT, b"SCAN_DWELL", 300, 9),
                    port,
                )
            bench.run(0.1)
        assert len(bench.ranges_cm(begun_us)) == pytest.approx(80, abs=3)
        assert bench.board.meters().restarts == 0


class TestCommands:
    @pytest.mark.parametrize("port", PORTS)
    def test_ack_within_20_ms(self, bench: Bench, port: int) -> None:
        for _ in range(10):
            begun_us = bench.t_us
            bench.command(512, 148, port=port)
            (ack,) = bench.messages("COMMAND_ACK", port, begun_us)
            # From the first bit of the command to the last of the answer.
            assert ack.t_us - begun_us < 20_000
            bench.run(0.013)

    def test_ack_goes_back_to_who_asked(self, bench: Bench) -> None:
        ack = bench.command(512, 148)
        assert (ack.command, ack.result) == (512, ACCEPTED)
        assert (ack.target_system, ack.target_component) == (245, 190)

    def test_unsupported_is_said_as_such(self, bench: Bench) -> None:
        assert bench.command(mavlink.MAV_CMD_NAV_TAKEOFF).result == UNSUPPORTED
        assert bench.command(512, 30).result == UNSUPPORTED  # REQUEST_MESSAGE of ATTITUDE

    def test_command_int_is_understood(self, bench: Bench) -> None:
        begun_us = bench.t_us
        bench.send(
            mavlink.MAVLink_command_int_message(
                OUR_ID, OUR_COMPONENT, 0, 183, 0, 0, 1, 1234.0, 0, 0, 0, 0, 0
            )
        )
        bench.run(0.2)
        (ack,) = bench.messages("COMMAND_ACK", CONSOLE_PORT, begun_us)
        assert (ack.message.command, ack.message.result) == (183, ACCEPTED)
        assert list(bench.aims())[-1][1] == pytest.approx(1234, abs=1)

    def test_version_tells_the_commit(self, bench: Bench) -> None:
        assert bench.command(512, 148).result == ACCEPTED
        version = bench.messages("AUTOPILOT_VERSION", CONSOLE_PORT) or bench.run_until_heard(
            "AUTOPILOT_VERSION", 0.2, CONSOLE_PORT
        )
        message = version[-1].message if isinstance(version, list) else version
        git_hash = bytes(message.flight_custom_version).rstrip(b"\0").decode()
        assert len(git_hash) == 8
        assert int(git_hash, 16) >= 0

    @pytest.mark.usb
    def test_message_interval_is_settable_a_port_at_a_time(self, bench: Bench) -> None:
        assert bench.command(511, 132, 200_000).result == ACCEPTED
        begun_us = bench.t_us
        bench.run(2.0)
        assert len(bench.messages("DISTANCE_SENSOR", CONSOLE_PORT, begun_us)) == pytest.approx(
            10, abs=1
        )
        assert len(bench.messages("DISTANCE_SENSOR", since_us=begun_us)) == pytest.approx(40, abs=1)
        assert bench.command(511, 132, -1).result == ACCEPTED
        begun_us = bench.t_us
        bench.run(1.0)
        assert bench.messages("DISTANCE_SENSOR", CONSOLE_PORT, begun_us) == []

    def test_reboot_restarts_it(self, bench: Bench) -> None:
        sent = len(bench.raw)
        assert bench.command(246, 1).result == ACCEPTED
        bench.run(1.5)
        # A frame that the restart cuts short swallows the next in a receiver that waits for it.
        assert b"Echowing: started, by command" in bench.raw[sent:]
        assert bench.board.meters().restarts == 1
        assert bench.ranges_cm()[-1] == 200

    def test_self_test_sweeps_and_tells(self, bench: Bench) -> None:
        begun_us = bench.t_us
        assert bench.command(31012).result == ACCEPTED
        bench.run(4.0)
        texts = " ".join(bench.texts(CONSOLE_PORT, begun_us))
        for word in ("sonar good", "memory good", "autopilot port", "USB port", "ended"):
            assert word in texts
        swept = {(round(pan), round(tilt)) for _, pan, tilt in bench.aims(begun_us)}
        assert {(1330, 1400), (1400, 1400), (1380, 1300), (1380, 1500)} <= swept

    def test_self_test_feels_a_loop_plug(self, bench: Bench) -> None:
        begun_us = bench.t_us
        bench.command(31012)
        for _ in range(80):
            sent = len(bench.raw)
            bench.run(0.05)
            bench.board.feed(AUTOPILOT_PORT, bytes(bench.raw[sent:]))
        texts = " ".join(bench.texts(CONSOLE_PORT, begun_us))
        assert "autopilot port looped" in texts
        assert "USB port has no loop plug" in texts or not HAS_USB


class TestFrames:
    def heartbeat_of_the_vehicle(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3)

    def learned(self, bench: Bench, frame: bytes = b"") -> bool:
        """Whether the vehicle is known after five seconds, the frame in each."""
        for _ in range(5):
            bench.board.feed(AUTOPILOT_PORT, frame)
            bench.run(1.0)
        bench.run(1.1)
        return bool(bench.messages("HEARTBEAT")[-1].message.get_srcSystem() == VEHICLE_ID)

    def test_mavlink_1_is_understood(self, bench: Bench) -> None:
        sender = mavlink1.MAVLink(None, srcSystem=VEHICLE_ID, srcComponent=1)
        frame = bytes(mavlink1.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3).pack(sender))
        assert frame[0] == 0xFE
        assert self.learned(bench, frame)

    def test_signed_frames_are_understood(self, bench: Bench) -> None:
        sender = mavlink.MAVLink(None, srcSystem=VEHICLE_ID, srcComponent=1)
        sender.signing.secret_key = bytes(range(32))
        sender.signing.sign_outgoing = True
        sender.signing.timestamp = 1
        frame = bytes(self.heartbeat_of_the_vehicle().pack(sender))
        assert frame[2] == 1  # the signed flag
        assert self.learned(bench, frame)

    def test_every_truncation_is_survived(self, bench: Bench) -> None:
        sender = mavlink.MAVLink(None, srcSystem=VEHICLE_ID, srcComponent=1)
        frame = bytes(self.heartbeat_of_the_vehicle().pack(sender))
        for length in range(len(frame)):
            bench.board.feed(AUTOPILOT_PORT, frame[:length])
        assert not self.learned(bench)
        # The parser may wait for the rest of a frame cut short: two whole ones bring it back.
        assert self.learned(bench, frame * 2)

    def test_a_flipped_bit_spoils_a_frame(self, bench: Bench) -> None:
        sender = mavlink.MAVLink(None, srcSystem=VEHICLE_ID, srcComponent=1)
        frame = self.heartbeat_of_the_vehicle().pack(sender)
        # Not in the length: a longer frame swallows what follows, which the truncations show.
        for place, bit in itertools.product(range(2, len(frame)), range(8)):
            broken = bytearray(frame)
            broken[place] ^= 1 << bit
            bench.board.feed(AUTOPILOT_PORT, bytes(broken) + bytes(30))
        bench.run(2.0)
        assert not self.learned(bench)
        assert bench.board.overruns(AUTOPILOT_PORT) == 0


class TestGarbage:
    @pytest.mark.parametrize(
        "noise_bytes", [150_000, pytest.param(1_000_000, marks=pytest.mark.long)]
    )
    def test_noise_at_full_rate(self, elf: Path, noise_bytes: int) -> None:
        bench = Bench(elf, BenchSonar(2.0), armed=True)
        bench.run(BOOTED_S)
        begun_us = bench.t_us
        noise = random.Random(1)
        seconds = 0
        while seconds * LINE_BYTES_A_SECOND < noise_bytes:
            # As much as the line carries: the vehicle's own heartbeat is in the middle of it.
            bench.board.feed(AUTOPILOT_PORT, noise.randbytes(int(LINE_BYTES_A_SECOND) - 30))
            bench.run(1.0)
            seconds += 1
        reports = bench.messages("DISTANCE_SENSOR", since_us=begun_us)
        assert len(reports) == pytest.approx(20 * seconds, abs=2)
        assert {m.message.current_distance for m in reports} == {200}
        assert bench.board.meters().restarts == 0
        # It still listens, once what the noise announced as a frame (280 bytes at most) is over.
        bench.board.feed(AUTOPILOT_PORT, bytes(280))
        bench.run(0.1)
        assert bench.command(512, 148, port=AUTOPILOT_PORT).result == ACCEPTED

    def test_silence_after_half_a_frame(self, bench: Bench) -> None:
        bench.board.feed(AUTOPILOT_PORT, b"\xfd\xff")  # announces 255 bytes
        bench.run(1.0)
        for _ in range(3):
            bench.send_heartbeat(VEHICLE_ID, 1)
            bench.run(1.0)
        # 21 bytes a heartbeat: the swallowed frame is over after 13 of them at the latest.
        for _ in range(10):
            bench.send_heartbeat(VEHICLE_ID, 1)
        for _ in range(6):
            bench.send_heartbeat(VEHICLE_ID, 1)
            bench.run(1.0)
        bench.run(1.1)
        assert bench.messages("HEARTBEAT")[-1].message.get_srcSystem() == VEHICLE_ID


class TestLoad:
    """Turns, stack and jitter while everything happens at once."""

    def test_limits_hold_under_load(self, elf: Path) -> None:
        # On the ground the STM32 would store what is set: a turn as long as erasing its flash.
        bench = Bench(elf, BenchSonar(2.0), armed=IS_STM32)
        bench.run(BOOTED_S)
        bench.board.clear_meters()
        begun_us = bench.t_us
        noise = random.Random(2)
        for turn in range(8):
            for port in PORTS:
                bench.send(mavlink.MAVLink_param_request_list_message(0, 0), port)
                bench.send(
                    mavlink.MAVLink_param_set_message(
                        bench.system, OUR_COMPONENT, b"SCAN_DWELL", 300 + turn % 2, 9
                    ),
                    port,
                )
                bench.board.feed(port, noise.randbytes(2_000))
            bench.sonar.range_m = 2.0 if turn % 4 else None
            bench.run(1.0)
        meters = bench.board.meters()
        assert meters.longest_turn_us < 2_000
        assert meters.stack_headroom_bytes > 1_024
        assert bench.board.overruns(AUTOPILOT_PORT) == bench.board.overruns(CONSOLE_PORT) == 0
        times = [m.t_us for m in bench.messages("DISTANCE_SENSOR", since_us=begun_us)]
        tracked = [b - a for a, b in itertools.pairwise(times)]
        assert sorted(tracked)[len(tracked) // 2] == pytest.approx(50_000, abs=2_000)
