"""The co-processor as the simulator drives it: through Python, over its MAVLink bytes."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.sim.boards import coprocessor
from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, USB_PORT, NativeCoprocessor

STEP_US = 20_000  # the simulator's step
US = 191  # our component id


class FakeSonar:
    """A sonar that hears `range_cm(t_us)` and ranges for 40 ms."""

    def __init__(self, range_cm: Callable[[int], int]) -> None:
        self.range_cm = range_cm
        self.plugged = True
        self.pings_us: list[int] = []
        self._busy_until_us = 0
        self._answer = b"\x12\x02"

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        if not self._answers(t_us, address):
            return False
        assert data == b"\x51"
        self.pings_us.append(t_us)
        self._answer = self.range_cm(t_us).to_bytes(2, "big")
        self._busy_until_us = t_us + 40_000
        return True

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        assert count == 2
        return self._answer if self._answers(t_us, address) else None

    def _answers(self, t_us: int, address: int) -> bool:
        return self.plugged and address == 0x70 and t_us >= self._busy_until_us


class Bench:
    """A co-processor, its sonar, and what it has said on each port."""

    def __init__(
        self,
        range_cm: Callable[[int], int] = lambda _: 300,
        *,
        seed: int = 0,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.sonar = FakeSonar(range_cm)
        settings = {"SYS_ID": 1.0, **(parameters or {})}
        self.device = NativeCoprocessor(self.sonar, seed=seed, parameters=settings)
        self.t_us = 0
        self.bytes: list[bytes] = [b"", b""]
        self.said: list[list[mavlink.MAVLink_message]] = [[], []]
        self._parsers = [mavlink.MAVLink(None), mavlink.MAVLink(None)]
        self.station = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self.t_us += STEP_US
            self.device.run_until(self.t_us)
            for port in (AUTOPILOT_PORT, USB_PORT):
                data = self.device.take(port)
                self.bytes[port] += data
                self.said[port] += self._parsers[port].parse_buffer(data) or []

    def tell(self, message: mavlink.MAVLink_message, port: int = AUTOPILOT_PORT) -> None:
        self.device.feed(port, message.pack(self.station))

    def heard(self, kind: str, port: int = AUTOPILOT_PORT) -> list[mavlink.MAVLink_message]:
        return [message for message in self.said[port] if message.get_type() == kind]

    def named(self, name: str) -> list[float]:
        return [m.value for m in self.heard("NAMED_VALUE_FLOAT") if m.name == name]


def heartbeat(armed: bool) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0,
        0,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )


def test_a_target_is_found_and_reported_at_20_hz() -> None:
    bench = Bench()
    bench.run(3.0)
    reports = [m for m in bench.heard("DISTANCE_SENSOR") if m.time_boot_ms >= 1000]
    assert len(reports) == pytest.approx(40, abs=1)
    assert {m.current_distance for m in reports} == {300}
    assert {m.orientation for m in reports} == {mavlink.MAV_SENSOR_ROTATION_NONE}
    assert bench.named("SNR_RAW")[-1] == pytest.approx(3.0)
    assert bench.named("SNR_STATE")[-1] == 2


def test_nothing_in_sight_goes_round_the_figure_eight() -> None:
    bench = Bench(lambda _: 765)
    pulses: list[tuple[float, float]] = []
    while len(pulses) < 12:
        bench.run(STEP_US / 1e6)
        aim = (bench.device.pan_us, bench.device.tilt_us)
        if not pulses or pulses[-1] != aim:
            pulses.append(aim)
    low, level, high = 1300, 1400, 1500
    assert pulses == [
        *((1330, level), (1330, high), (1380, high), (1400, high), (1400, level), (1380, level)),
        *((1330, level), (1330, low), (1380, low), (1400, low), (1400, level), (1380, level)),
    ]
    assert bench.heard("DISTANCE_SENSOR")[-1].current_distance > 765


def test_the_vehicle_is_learned_and_the_gimbal_waits_disarmed() -> None:
    bench = Bench(lambda _: 765, parameters={"SYS_ID": 0})
    for _ in range(6):
        bench.device.feed(
            AUTOPILOT_PORT,
            heartbeat(armed=False).pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1)),
        )
        bench.run(1.0)
    assert {m.get_srcSystem() for m in bench.said[AUTOPILOT_PORT][-20:]} == {7}
    assert (bench.device.pan_us, bench.device.tilt_us) == (1380, 1400)


def test_parameters_are_read_and_set_over_mavlink() -> None:
    bench = Bench()
    bench.tell(mavlink.MAVLink_param_request_list_message(1, US), USB_PORT)
    bench.run(1.0)
    listed = bench.heard("PARAM_VALUE", USB_PORT)
    defaults = {row.name: row.default for row in coprocessor.parameter_table()}
    assert {m.param_id: m.param_value for m in listed} == {**defaults, "SYS_ID": 1.0}
    assert [m.param_id for m in listed] == list(defaults)
    bench.tell(
        mavlink.MAVLink_param_set_message(
            1, US, b"SCAN_DWELL", 450.0, mavlink.MAV_PARAM_TYPE_REAL32
        )
    )
    bench.run(0.1)
    assert bench.heard("PARAM_VALUE")[-1].param_value == 450.0
    assert bench.device.parameter("SCAN_DWELL") == 450.0


def test_a_command_is_acknowledged_within_one_step() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.tell(
        mavlink.MAVLink_command_long_message(
            1, US, mavlink.MAV_CMD_DO_SET_SERVO, 0, 2, 1550, 0, 0, 0, 0, 0
        )
    )
    bench.run(STEP_US / 1e6)
    ack = bench.heard("COMMAND_ACK")[-1]
    assert (ack.command, ack.result) == (mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == (245, 190)
    assert bench.device.tilt_us == 1550


def test_command_numbers_are_mavlinks() -> None:
    bench = Bench()
    for command, parameters in (
        (mavlink.MAV_CMD_DO_SET_SERVO, (1, 1400)),
        (mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (0, 0)),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (132, 50000)),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (148, 0)),
        (mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, (1, 0)),
        (mavlink.MAV_CMD_USER_1, (0, 0)),
        (mavlink.MAV_CMD_USER_2, (0x70, 0)),
        (mavlink.MAV_CMD_USER_3, (0, 0)),
        (mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1, 0)),
        (mavlink.MAV_CMD_PREFLIGHT_STORAGE, (2, 0)),
    ):
        bench.tell(
            mavlink.MAVLink_command_long_message(1, US, command, 0, *parameters, 0, 0, 0, 0, 0)
        )
        bench.run(STEP_US / 1e6)
        ack = bench.heard("COMMAND_ACK")[-1]
        assert (ack.command, ack.result) == (command, mavlink.MAV_RESULT_ACCEPTED)
        bench.sonar.plugged = False  # the change of address shall not reach the fake
    bench.run(0.5)
    assert bench.device.restarts == 1


def test_an_unplugged_sonar_is_told() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.sonar.plugged = False
    bench.run(2.0)
    assert "does not answer" in bench.heard("STATUSTEXT")[-1].text
    assert bench.heard("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_CRITICAL


def test_same_seed_same_bytes_other_seed_other_pings() -> None:
    first, second, other = Bench(seed=5), Bench(seed=5), Bench(seed=6)
    for bench in (first, second, other):
        bench.run(5.0)
    assert first.bytes == second.bytes
    assert first.sonar.pings_us != other.sonar.pings_us


def test_parameters_at_the_start_and_their_errors() -> None:
    assert Bench(parameters={"SONAR_PERIOD": 100}).device.parameter("SONAR_PERIOD") == 100
    with pytest.raises(EchowingError, match=r"no parameter 'DWELL'; it has SYS_ID.* SCAN_DWELL$"):
        Bench(parameters={"DWELL": 3})
    with pytest.raises(EchowingError, match="whole numbers from 50 to 5000 ms"):
        Bench(parameters={"SCAN_DWELL": 3})


def test_an_error_in_the_sonar_model_comes_out_where_it_can_be_seen() -> None:
    def broken(_: int) -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        Bench(broken).run(1.0)


def test_a_missing_library_names_the_target_to_make(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(coprocessor, "LIBRARY", tmp_path / "none.so")
    coprocessor._library.cache_clear()
    try:
        with pytest.raises(EchowingError, match="make core"):
            Bench()
    finally:
        coprocessor._library.cache_clear()
