"""The simulated autopilot's MAVLink: rangefinder, parameters, streams, routing, texts, signing."""

import math
import struct
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.autopilot import AutopilotEndedError
from echowing.sim.vehicle.parameters import Generation, dialect_of, float32

from .autopilot_bench import FORWARD_SONAR, POSITION_VELOCITY, SYSTEM_ID, TOOL, Bench

NO_DATA, LOW, HIGH, GOOD = 1, 2, 3, 4
ACCEPTED, DENIED, FAILED = 0, 2, 4
SET_INTERVAL, REQUEST = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
POSITION_ID = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
COPROCESSOR = (SYSTEM_ID, 191)
BEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def sonar_bench(**parameters: float) -> Bench:
    return Bench(parameters={**FORWARD_SONAR, **parameters})


def status(bench: Bench) -> tuple[int, float]:
    bench.step()
    vehicle = bench.autopilot
    return vehicle.rangefinder_status(0), round(vehicle.rangefinder_distance_m(0), 3)


# ---- rangefinder ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance_cm", "expected"),
    [
        (412, (GOOD, 4.12)),
        (20, (GOOD, 0.20)),
        (19, (LOW, 0.19)),
        (5, (LOW, 0.05)),
        (700, (GOOD, 7.0)),
        (701, (HIGH, 7.01)),
        (4500, (HIGH, 45.0)),
        (0, (LOW, 0.0)),
    ],
)
@pytest.mark.parametrize("generation", list(Generation))
def test_status_by_distance(
    generation: Generation, distance_cm: int, expected: tuple[int, float]
) -> None:
    """The spans of the parameters, 0.2 to 7 m, are narrower than the sensor's 0.2 to 7.65 m."""
    bench = Bench(generation=generation, parameters=FORWARD_SONAR)
    bench.sonar(distance_cm)
    assert status(bench) == expected


def test_seen_in_sitl() -> None:
    """1234 cm -> 4, 12.34 m: with a longer span; 5 -> 2; 4500 -> 3; silence -> 1, 0 m."""
    bench = sonar_bench(RNGFND1_MAX=40.0)
    for distance_cm, code in ((1234, GOOD), (5, LOW), (4500, HIGH)):
        bench.sonar(distance_cm, limits_cm=(20, 4000))
        assert status(bench) == (code, distance_cm / 100.0)
    bench.run(0.6)
    assert status(bench) == (NO_DATA, 0.0)


def test_the_sensor_s_own_span_counts_too_and_none_means_the_parameters() -> None:
    bench = sonar_bench()
    bench.sonar(500, limits_cm=(30, 400))
    assert status(bench)[0] == HIGH
    bench.sonar(25, limits_cm=(30, 400))
    assert status(bench)[0] == LOW
    bench.sonar(650, limits_cm=(0, 0))
    assert status(bench)[0] == GOOD


def test_no_data_before_the_first_message_and_500_ms_after_the_last() -> None:
    bench = sonar_bench()
    assert status(bench) == (NO_DATA, 0.0)
    bench.sonar(300)
    assert status(bench) == (GOOD, 3.0)
    bench.run(0.5)
    assert bench.autopilot.rangefinder_status(0) == GOOD  # 500 ms old, not older
    assert status(bench) == (NO_DATA, 0.0)


def test_a_report_every_450_ms_does_not_flap_but_every_550_ms_does() -> None:
    for period, flaps in ((22, False), (27, True)):  # 0.44 and 0.54 s
        bench = sonar_bench()
        seen = set()
        for step in range(200):
            if step % period == 0:
                bench.sonar(300)
            seen.add(status(bench)[0])
        assert (NO_DATA in seen) is flaps


def test_only_the_configured_orientation_is_heard() -> None:
    bench = sonar_bench()
    bench.sonar(300, orientation=25)
    assert status(bench) == (NO_DATA, 0.0)
    assert bench.autopilot.rangefinder_status(25) == 0  # and no other is there
    assert list(bench.autopilot.rangefinder_orientations()) == [0]


def test_without_a_mavlink_type_there_is_no_rangefinder() -> None:
    bench = Bench(parameters={"RNGFND1_TYPE": 1.0, "RNGFND1_ORIENT": 0.0})
    bench.sonar(300)
    assert status(bench) == (0, 0.0)
    assert list(bench.autopilot.rangefinder_orientations()) == []


@pytest.mark.parametrize(
    ("generation", "address", "sensor_id", "heard"),
    [
        (Generation.V4_8, 3.0, 3, True),
        (Generation.V4_8, 3.0, 4, False),
        (Generation.V4_8, 0.0, 4, True),
        (Generation.V4_7, 3.0, 4, True),
        (Generation.V4_6, 3.0, 4, True),
    ],
)
def test_address_filters_by_id_from_4_8(
    generation: Generation, address: float, sensor_id: int, heard: bool
) -> None:
    parameters = {**FORWARD_SONAR, "RNGFND1_ADDR": address}
    bench = Bench(generation=generation, parameters=parameters)
    bench.sonar(300, sensor_id=sensor_id)
    assert status(bench)[0] == (GOOD if heard else NO_DATA)
    assert not bench.texts()  # silently


@pytest.mark.parametrize(("wire", "inside"), [(0, -1), (1, 0), (50, 50), (100, 100)])
def test_signal_quality(wire: int, inside: int) -> None:
    bench = sonar_bench()
    bench.sonar(300, quality=wire)
    bench.step()
    assert bench.autopilot.rangefinder_signal_quality(0) == inside
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR) == ACCEPTED
    assert bench.heard("DISTANCE_SENSOR")[-1].signal_quality == wire


def test_own_distance_sensor_out() -> None:
    bench = sonar_bench()
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR) == FAILED  # no data
    bench.sonar(321, sensor_id=9)
    bench.step()
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR) == ACCEPTED
    own = [m for m in bench.heard("DISTANCE_SENSOR") if m.get_srcComponent() == 1][-1]
    assert (own.current_distance, own.min_distance, own.max_distance) == (321, 20, 700)
    assert (own.id, own.orientation) == (0, 0)
    # RANGEFINDER tells of a sensor that looks down only
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_RANGEFINDER) == FAILED
    down = Bench(parameters={**FORWARD_SONAR, "RNGFND1_ORIENT": 25.0})
    down.sonar(321, orientation=25)
    assert down.command(REQUEST, mavlink.MAVLINK_MSG_ID_RANGEFINDER) == ACCEPTED


# ---- parameters -------------------------------------------------------------------------------


@pytest.mark.parametrize("generation", list(Generation))
def test_the_whole_list_paced(generation: Generation) -> None:
    bench = Bench(generation=generation)
    bench.send(mavlink.MAVLink_param_request_list_message(SYSTEM_ID, 1))
    bench.run(1.0)
    # A 57600 baud port gives a list 30 %: about 46 values of 37 bytes a second.
    assert len(bench.heard("PARAM_VALUE")) == pytest.approx(50, abs=1)
    bench.run(5.0)
    values = bench.heard("PARAM_VALUE")
    names = [value.param_id for value in values]
    assert [value.param_index for value in values] == list(range(values[0].param_count))
    assert len(set(names)) == len(names)
    metric = generation in (Generation.V4_7, Generation.V4_8)
    for name, there in {
        "WP_SPD": metric, "WPNAV_SPEED": not metric,
        "MAV_SYSID": metric, "SYSID_THISMAV": not metric,
        "RNGFND1_MAX": metric, "RNGFND1_MAX_CM": not metric, "MAV1_POSITION": metric,
        "SR0_POSITION": not metric, "RTL_SPEED_MS": generation is Generation.V4_8,
    }.items():  # fmt: skip
        assert (name in names) is there, name


def test_defaults_are_the_firmware_s() -> None:
    old, new = Bench(generation=Generation.V4_6).autopilot, Bench().autopilot
    assert old.parameter_get("WPNAV_SPEED") == 1000.0
    assert old.parameter_get("RNGFND1_MAX_CM") == 700.0
    assert new.parameter_get("WP_SPD") == 10.0
    assert new.parameter_get("RNGFND1_MAX") == 7.0
    for vehicle in (old, new):
        assert vehicle.parameter_get("FS_GCS_ENABLE") == 0.0
        assert vehicle.parameter_get("RNGFND1_ORIENT") == 25.0
        assert vehicle.parameter_get("SCR_VM_I_COUNT") == 10000.0
        assert vehicle.parameter_get("NO_SUCH_NAME") is None


def read_parameter(bench: Bench, name: str = "", index: int = -1) -> Any | None:
    before = len(bench.heard("PARAM_VALUE"))
    bench.send(mavlink.MAVLink_param_request_read_message(SYSTEM_ID, 1, name.encode(), index))
    bench.step()
    answers = bench.heard("PARAM_VALUE")[before:]
    return answers[0] if answers else None


def set_parameter(bench: Bench, name: str, value: float) -> None:
    bench.send(mavlink.MAVLink_param_set_message(SYSTEM_ID, 1, name.encode(), value, 9))
    bench.step()


def test_read_by_name_and_by_index() -> None:
    bench = Bench()
    by_name = read_parameter(bench, "RNGFND1_MAX")
    assert by_name is not None
    assert by_name.param_value == 7.0
    by_index = read_parameter(bench, index=by_name.param_index)
    assert by_index is not None
    assert by_index.param_id == "RNGFND1_MAX"
    assert read_parameter(bench, "NO_SUCH_NAME") is None
    assert read_parameter(bench, index=5000) is None


def test_set_saves_answers_and_ignores_what_it_does_not_know() -> None:
    bench = Bench()
    set_parameter(bench, "WP_SPD", 4.5)
    assert bench.heard("PARAM_VALUE")[-1].param_value == 4.5
    assert bench.autopilot.parameters.saved["WP_SPD"] == 4.5
    before = len(bench.heard("PARAM_VALUE"))
    set_parameter(bench, "WPNAV_SPEED", 450.0)  # of another generation
    set_parameter(bench, "WP_SPD", float("nan"))
    assert len(bench.heard("PARAM_VALUE")) == before
    assert bench.autopilot.parameter_get("WP_SPD") == 4.5


def test_whole_numbers_stay_whole_and_within_their_type() -> None:
    bench = Bench()
    set_parameter(bench, "RNGFND1_ORIENT", 3.7)
    assert bench.autopilot.parameter_get("RNGFND1_ORIENT") == 4.0
    assert bench.heard("PARAM_VALUE")[-1].param_type == mavlink.MAV_PARAM_TYPE_INT8
    set_parameter(bench, "RNGFND1_ORIENT", 300.0)
    assert bench.autopilot.parameter_get("RNGFND1_ORIENT") == 127.0


def test_set_only_is_not_saved() -> None:
    autopilot = Bench().autopilot
    assert autopilot.parameter_set("WP_SPD", 3.3)
    assert autopilot.parameter_get("WP_SPD") == float32(3.3)  # kept in 32 bits
    assert "WP_SPD" not in autopilot.parameters.saved
    assert not autopilot.parameter_set("NO_SUCH_NAME", 1.0)


def test_script_parameters() -> None:
    bench = Bench(parameters={"ECHO_DIST": 4.0})
    autopilot = bench.autopilot
    assert autopilot.parameter_get("ECHO_DIST") is None  # ignored until a script adds it
    assert autopilot.parameter_add_table(95, "ECHO_", 2)
    assert autopilot.parameter_add(95, 1, "DIST", 3.0)
    assert autopilot.parameter_get("ECHO_DIST") == 4.0  # the saved value comes back
    assert autopilot.parameter_add(95, 2, "CLOSE", 1.0)
    assert autopilot.parameter_get("ECHO_CLOSE") == 1.0
    assert not autopilot.parameter_add(95, 3, "MORE", 1.0)  # no room
    assert not autopilot.parameter_add(96, 1, "DIST", 1.0)  # no table
    assert not autopilot.parameter_add_table(95, "OTHER_", 2)  # key taken
    assert not autopilot.parameter_add_table(96, "ECHO_", 2)  # prefix taken
    assert not autopilot.parameter_add(95, 1, "A_NAME_TOO_LONG_", 1.0)
    assert read_parameter(bench, "ECHO_DIST") is not None


# ---- streams ----------------------------------------------------------------------------------


def count(bench: Bench, kind: str, seconds: float, link: str = "telemetry") -> int:
    bench.forget()
    bench.run(seconds)
    return len(bench.heard(kind, link))


def test_heartbeat_once_a_second_on_every_link() -> None:
    bench = Bench()
    assert count(bench, "HEARTBEAT", 10.0) == 11  # at 0.02 s, and at 1, 2, … 10 s
    assert len(bench.heard("HEARTBEAT", "coprocessor")) == 11
    beat = bench.heard("HEARTBEAT")[0]
    assert (beat.type, beat.autopilot) == (2, 3)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (SYSTEM_ID, 1)


def test_nothing_else_is_sent_unless_asked_for() -> None:
    bench = Bench()
    bench.run(5.0)
    assert {m.get_type() for m in bench._heard["telemetry"]} == {"HEARTBEAT"}


@pytest.mark.parametrize("rate_hz", [1, 4, 8, 10, 50])
def test_message_interval_on_that_link_only(rate_hz: int) -> None:
    bench = Bench()
    assert bench.command(SET_INTERVAL, POSITION_ID, 1e6 / rate_hz) == ACCEPTED
    assert count(bench, "GLOBAL_POSITION_INT", 10.0) == pytest.approx(10 * rate_hz, abs=1)
    assert not bench.heard("GLOBAL_POSITION_INT", "coprocessor")
    bench.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, POSITION_ID)
    assert bench.heard("MESSAGE_INTERVAL")[-1].interval_us == round(1e6 / rate_hz)
    assert bench.command(SET_INTERVAL, POSITION_ID, -1) == ACCEPTED
    assert count(bench, "GLOBAL_POSITION_INT", 2.0) == 0


def test_message_interval_0_is_the_stream_s_own_and_unknown_ones_are_denied() -> None:
    bench = Bench(parameters={"MAV2_POSITION": 5.0})
    bench.command(SET_INTERVAL, POSITION_ID, 20_000)
    assert count(bench, "GLOBAL_POSITION_INT", 2.0) == pytest.approx(100, abs=1)
    bench.command(SET_INTERVAL, POSITION_ID, 0)
    assert count(bench, "GLOBAL_POSITION_INT", 2.0) == pytest.approx(10, abs=1)
    assert bench.command(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_HIL_SENSOR, 20_000) == DENIED


@pytest.mark.parametrize(
    ("generation", "name"), [(Generation.V4_6, "SR1_EXTRA1"), (Generation.V4_8, "MAV2_EXTRA1")]
)
def test_stream_rate_parameters_take_effect_at_once(generation: Generation, name: str) -> None:
    bench = Bench(generation=generation)
    assert count(bench, "ATTITUDE", 2.0) == 0
    set_parameter(bench, name, 5.0)
    assert count(bench, "ATTITUDE", 4.0) == pytest.approx(20, abs=1)
    assert not bench.heard("ATTITUDE", "coprocessor")


def test_request_data_stream() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_request_data_stream_message(SYSTEM_ID, 1, 0, 4, 1))
    bench.sonar(300)
    bench.step()
    bench.forget()
    bench.run(4.0, lambda: bench.sonar(300))
    for kind in (
        "ATTITUDE", "VFR_HUD", "SYS_STATUS", "RC_CHANNELS", "GPS_RAW_INT", "GLOBAL_POSITION_INT",
        "LOCAL_POSITION_NED", "SYSTEM_TIME", "MISSION_CURRENT",
    ):  # fmt: skip
        assert len(bench.heard(kind)) == pytest.approx(16, abs=1), kind
    bench.send(mavlink.MAVLink_request_data_stream_message(SYSTEM_ID, 1, 10, 4, 0))
    bench.step()
    assert count(bench, "ATTITUDE", 2.0) == 0
    assert bench.autopilot.parameter_get("MAV2_POSITION") == 4.0


def test_other_links_get_streams_without_parameters_of_their_own() -> None:
    bench = Bench()
    bench.add_link("companion")
    bench.send(
        mavlink.MAVLink_request_data_stream_message(SYSTEM_ID, 1, 10, 5, 1), link="companion"
    )
    bench.step()
    assert count(bench, "ATTITUDE", 2.0, "companion") == pytest.approx(10, abs=1)
    assert not bench.heard("ATTITUDE")


def test_what_the_messages_say() -> None:
    bench = sonar_bench(WP_SPD=3.0)
    bench.target(200.0, 0.0, 12.0)
    bench.run(5.0)
    for number in (33, 32, 30, 74, 24, 2, 1, 148, 242):
        assert bench.command(REQUEST, number) == ACCEPTED
    assert bench.command(REQUEST, 9999) == FAILED
    copter = bench.copter  # up to ten steps of 0.06 m ahead of what was told
    here = bench.heard("GLOBAL_POSITION_INT")[-1]
    assert here.vx == pytest.approx(300, abs=10)
    assert here.relative_alt / 1e3 == pytest.approx(-copter.down_m, abs=0.05)
    assert here.alt - here.relative_alt == 250_000
    assert here.hdg in (0, 35999) or here.hdg < 100
    assert (here.lat - 393_400_000) / 1e7 * 111_000 == pytest.approx(copter.north_m, abs=0.8)
    assert bench.heard("LOCAL_POSITION_NED")[-1].x == pytest.approx(copter.north_m, abs=0.8)
    assert bench.heard("ATTITUDE")[-1].pitch == pytest.approx(copter.pitch_rad, abs=0.05)
    assert bench.heard("VFR_HUD")[-1].groundspeed == pytest.approx(3.0, abs=0.1)
    assert bench.heard("GPS_RAW_INT")[-1].vel == pytest.approx(300, abs=10)
    time = bench.heard("SYSTEM_TIME")[-1]
    assert time.time_unix_usec / 1e6 == pytest.approx(1_767_225_600 + bench.t_s, abs=0.2)
    healthy = bench.heard("SYS_STATUS")[-1].onboard_control_sensors_health
    assert not healthy & mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION  # silent rangefinder
    assert bench.heard("AUTOPILOT_VERSION")[-1].flight_sw_version >> 16 == (4 << 8 | 8)
    assert bench.heard("HOME_POSITION")[-1].altitude == 250_000


def test_timesync_is_answered_and_answers_are_left_alone() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.send(mavlink.MAVLink_timesync_message(0, 987654321))
    bench.step()
    answer = bench.heard("TIMESYNC")[-1]
    assert answer.ts1 == 987654321
    assert answer.tc1 == pytest.approx(bench.t_s * 1e9, abs=1e6)
    bench.send(mavlink.MAVLink_timesync_message(5, 6))
    bench.step()
    assert len(bench.heard("TIMESYNC")) == 1


# ---- routing ----------------------------------------------------------------------------------


def test_the_coprocessor_reaches_the_ground_once_somebody_listens_there() -> None:
    bench = sonar_bench()
    raw = mavlink.MAVLink_named_value_float_message(0, b"SNR_RAW", 3.21)
    bench.send(raw, link="coprocessor", source=COPROCESSOR)
    bench.step()
    assert not bench.heard("NAMED_VALUE_FLOAT")  # nobody has been heard on telemetry
    bench.send(BEAT)
    bench.step()
    text = mavlink.MAVLink_statustext_message(6, b"sonar found")
    for message in (raw, text, mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)):
        bench.send(message, link="coprocessor", source=COPROCESSOR)
    bench.sonar(300)
    bench.step()
    for kind in ("NAMED_VALUE_FLOAT", "STATUSTEXT", "DISTANCE_SENSOR"):
        told = bench.heard(kind)[-1]
        assert (told.get_srcSystem(), told.get_srcComponent()) == COPROCESSOR, kind
    assert any(m.get_srcComponent() == 191 for m in bench.heard("HEARTBEAT"))
    assert bench.autopilot.rangefinder_status(0) == GOOD  # and it is taken here too


def test_the_ground_reaches_the_coprocessor() -> None:
    bench = Bench()
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)
    bench.step()
    bench.send(mavlink.MAVLink_param_request_read_message(SYSTEM_ID, 191, b"SNR_RATE", -1))
    bench.send(BEAT)
    bench.step()
    assert bench.heard("PARAM_REQUEST_READ", "coprocessor")
    assert any(m.get_srcSystem() == TOOL[0] for m in bench.heard("HEARTBEAT", "coprocessor"))
    assert not bench.heard("PARAM_VALUE")  # not the autopilot's to answer


def test_what_is_for_the_autopilot_is_not_forwarded() -> None:
    bench = Bench()
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)
    bench.command(REQUEST, POSITION_ID)
    assert not bench.heard("COMMAND_LONG", "coprocessor")


def test_a_component_never_heard_of_is_the_autopilot_s_business() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_param_request_read_message(SYSTEM_ID, 99, b"WP_SPD", -1))
    bench.step()
    assert bench.heard("PARAM_VALUE")


def test_another_vehicle_s_messages_are_forwarded_not_obeyed() -> None:
    bench = Bench()
    bench.send(BEAT, link="coprocessor", source=(9, 1))
    bench.step()
    land = mavlink.MAVLink_command_long_message(9, 1, mavlink.MAV_CMD_NAV_LAND, 0, *(0.0,) * 7)
    bench.send(land)
    bench.step()
    assert bench.heard("COMMAND_LONG", "coprocessor")
    assert bench.autopilot.mode_number() == 4


def test_radio_status_is_not_forwarded_and_nothing_returns_where_it_came_from() -> None:
    bench = Bench()
    bench.send(BEAT)
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)
    bench.step()
    bench.forget()
    bench.send(mavlink.MAVLink_radio_status_message(*(0,) * 7))
    bench.send(mavlink.MAVLink_named_value_float_message(0, b"X", 1.0))
    bench.step()
    assert not bench.heard("RADIO_STATUS", "coprocessor")
    assert bench.heard("NAMED_VALUE_FLOAT", "coprocessor")
    assert not bench.heard("NAMED_VALUE_FLOAT")


def test_garbage_and_broken_frames_are_skipped() -> None:
    bench = sonar_bench()
    frame = bytes(BEAT.pack(mavlink.MAVLink(None, *TOOL)))
    broken = frame[:-1] + bytes([frame[-1] ^ 1])
    bench.autopilot.receive("telemetry", b"ArduPilot Ready\r\n" + broken + frame[:7])
    bench.step()
    bench.autopilot.receive("telemetry", frame[7:])
    bench.step()
    assert bench.autopilot.links["telemetry"].active


# A script that says what it hears, and flies where a point says, as one that checks nothing does.
LISTENS = """
    mavlink:init(10, 3)
    mavlink:register_rx_msgid(86)
    mavlink:register_rx_msgid(251)
    mavlink:register_rx_msgid(285)
    local function update()
      local message = mavlink:receive_chan()
      while message do
        local shift = #message >= 299 and 3 or 0
        local id = string.unpack('<I3', message, 10 + shift)
        local first = string.unpack('<f', message, 29 + shift) -- of a point's velocity
        gcs:send_text(6, string.format('heard %d', id))
        if id == 86 then
          local at, velocity, still = Vector3f(), Vector3f(), Vector3f()
          velocity:x(first)
          vehicle:set_target_posvelaccel_NED(at, velocity, still, false, 0, false, 0, false)
        end
        message = mavlink:receive_chan()
      end
      return update, 100
    end
    return update()
"""


def with_script(text: str, folder: Path, generation: Generation = Generation.V4_8) -> Bench:
    bench = Bench(generation=generation)
    script = folder / "probe.lua"
    script.write_text(text)
    bench.autopilot.load_script(script)
    bench.send(BEAT)
    bench.step()
    return bench


def look_order() -> mavlink.MAVLink_message:
    return mavlink.MAVLink_gimbal_device_set_attitude_message(
        *COPROCESSOR, 4 | 8 | 16 | 64, [1.0, 0.0, 0.0, 0.0], 0.1, 0.0, 0.0
    )


def test_an_order_where_to_look_goes_to_the_co_processor_alone() -> None:
    bench = Bench()
    bench.add_link("usb")
    bench.send(BEAT, link="usb", source=(255, 190))
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)
    bench.step()
    bench.send(look_order())
    bench.step()
    assert len(bench.heard("GIMBAL_DEVICE_SET_ATTITUDE", "coprocessor")) == 1
    assert not bench.heard("GIMBAL_DEVICE_SET_ATTITUDE", "usb")


def test_the_axis_of_a_reading_goes_to_everybody_and_to_scripts(tmp_path: Path) -> None:
    bench = with_script(LISTENS, tmp_path)
    bench.add_link("usb")
    bench.send(BEAT, link="usb", source=(255, 190))
    bench.step()
    axis = mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, 1234, 92, [1.0, 0.0, 0.0, 0.0], math.nan, math.nan, math.nan, 4
    )
    bench.send(axis, link="coprocessor", source=COPROCESSOR)
    bench.run(0.2)
    for link in ("telemetry", "usb"):
        (told,) = bench.heard("GIMBAL_DEVICE_ATTITUDE_STATUS", link)
        assert (told.get_srcComponent(), told.time_boot_ms) == (191, 1234)
    assert not bench.heard("GIMBAL_DEVICE_ATTITUDE_STATUS", "coprocessor")
    assert bench.texts().count("heard 285") == 1


def test_attitude_comes_as_often_as_the_co_processor_asks_on_its_own_port() -> None:
    bench = Bench()
    ask = mavlink.MAVLink_command_long_message(
        SYSTEM_ID, 1, SET_INTERVAL, 0, mavlink.MAVLINK_MSG_ID_ATTITUDE, 40_000.0, *(0.0,) * 5
    )
    bench.send(ask, link="coprocessor", source=COPROCESSOR)
    bench.run(2.0)
    assert len(bench.heard("ATTITUDE", "coprocessor")) == pytest.approx(50, abs=1)
    assert [m.result for m in bench.heard("COMMAND_ACK", "coprocessor")] == [ACCEPTED]
    assert not bench.heard("ATTITUDE")


def named_float(*, whole: bool) -> bytes:
    frame = mavlink.MAVLink_named_value_float_message(0, b"X", 1.5).pack(
        mavlink.MAVLink(None, 9, 1)
    )
    return bytes(frame) if whole else bytes(frame[:-1]) + bytes([frame[-1] ^ 1])


@pytest.mark.parametrize("generation", list(Generation))
def test_scripts_hear_frames_with_a_wrong_checksum_from_4_6_on(
    tmp_path: Path, generation: Generation
) -> None:
    """And nobody else: they are not forwarded, and who sent them is not known here by them."""
    bench = with_script(LISTENS, tmp_path, generation)
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)
    bench.step()
    bench.forget()
    bench.autopilot.receive("telemetry", named_float(whole=False))
    bench.run(0.2)
    heard = 0 if generation is Generation.V4_5 else 1
    assert bench.texts().count("heard 251") == heard
    assert not bench.heard("NAMED_VALUE_FLOAT", "coprocessor")
    assert (9, 1) not in bench.autopilot.links["telemetry"].routes

    bench.autopilot.receive("telemetry", named_float(whole=True))
    bench.run(0.2)
    assert bench.texts().count("heard 251") == heard + 1
    assert bench.heard("NAMED_VALUE_FLOAT", "coprocessor")


def test_scripts_hear_frames_with_a_wrong_checksum_on_a_signed_link_too(tmp_path: Path) -> None:
    bench = with_script(LISTENS, tmp_path)
    bench.autopilot.sign_link("telemetry", b"k" * 32)
    bench.autopilot.receive("telemetry", named_float(whole=True))
    bench.run(0.2)
    assert "heard 251" not in bench.texts()
    bench.autopilot.receive("telemetry", named_float(whole=False))
    bench.run(0.2)
    assert bench.texts().count("heard 251") == 1


@pytest.mark.parametrize("velocity_mps", [math.nan, math.inf, -1e30])
def test_a_number_that_is_none_ends_the_autopilot_if_a_script_hands_it_to_guided(
    tmp_path: Path, velocity_mps: float
) -> None:
    bench = with_script(LISTENS, tmp_path)
    bench.target(5.0, mask=POSITION_VELOCITY, velocity=(1.0, 0.0, 0.0))
    bench.run(0.5)

    bench.target(5.0, mask=POSITION_VELOCITY, velocity=(velocity_mps, 0.0, 0.0))
    with pytest.raises(AutopilotEndedError, match="vehicle 7 ended"):
        bench.run(0.2)


def test_a_place_that_is_none_is_an_error_of_the_script(tmp_path: Path) -> None:
    bench = with_script("local place = Location() place:lat(900000001)", tmp_path)
    script = bench.autopilot.script
    assert script is not None
    assert "bad argument #1 to 'lat' (argument out of range)" in str(script.error)


def test_mavlink_1_is_understood_too() -> None:
    bench = Bench()
    sender = mavlink.MAVLink(None, *TOOL)
    ask = mavlink.MAVLink_param_request_read_message(SYSTEM_ID, 1, b"WP_SPD", -1)
    bench.autopilot.receive("telemetry", ask.pack(sender, force_mavlink1=True))
    bench.step()
    assert bench.heard("PARAM_VALUE")
    assert bench.raw["telemetry"][0] == 0xFD  # answers are MAVLink 2


# ---- texts and floats -------------------------------------------------------------------------


def test_texts_wait_for_a_listener_and_long_ones_go_in_pieces() -> None:
    bench = Bench()
    bench.autopilot.send_text(4, "before anybody listens")
    bench.run(1.0)
    assert not bench.texts()
    bench.send(BEAT)
    bench.step()
    assert bench.texts() == ["before anybody listens"]
    long = "x" * 50 + "y" * 50 + "z" * 7
    bench.autopilot.send_text(4, long)
    bench.step()
    pieces = bench.heard("STATUSTEXT")[1:]
    assert "".join(piece.text for piece in pieces) == long
    assert [piece.chunk_seq for piece in pieces] == [0, 1, 2]
    assert len({piece.id for piece in pieces}) == 1
    assert pieces[0].id != 0


def test_named_floats_go_to_listeners() -> None:
    bench = Bench()
    bench.send(BEAT)
    bench.step()
    bench.autopilot.send_named_float("ECHO_STATE", 2.0)
    bench.step()
    told = bench.heard("NAMED_VALUE_FLOAT")[-1]
    assert (told.name, told.value) == ("ECHO_STATE", 2.0)
    assert not bench.heard("NAMED_VALUE_FLOAT", "coprocessor")


# ---- signing, determinism, identity -----------------------------------------------------------


def test_a_signed_link_hears_only_what_is_signed() -> None:
    bench = Bench()
    key = bytes(range(32))
    bench.autopilot.sign_link("telemetry", key)
    ask = mavlink.MAVLink_param_request_read_message(SYSTEM_ID, 1, b"WP_SPD", -1)
    listener = mavlink.MAVLink(None)
    listener.signing.secret_key = key
    listener.robust_parsing = True  # what is forwarded unsigned is none of the autopilot's signing
    bench._parsers["telemetry"] = listener
    bench.send(ask)
    bench.step()
    assert not bench.heard("PARAM_VALUE")
    signer = mavlink.MAVLink(None, *TOOL)
    signer.signing.secret_key = key
    signer.signing.sign_outgoing = True
    signer.signing.link_id = 3
    signer.signing.timestamp = 10**14
    bench.autopilot.receive("telemetry", ask.pack(signer))
    bench.step()
    assert bench.heard("PARAM_VALUE")[0].get_signed()
    bench.send(BEAT, link="coprocessor", source=COPROCESSOR)  # a wired port stays unsigned
    bench.step()
    assert bench.autopilot.links["coprocessor"].active


def test_same_inputs_same_bytes() -> None:
    def fly() -> tuple[bytes, bytes]:
        bench = sonar_bench(MAV2_EXTRA1=10.0, MAV2_POSITION=4.0)

        def each() -> None:
            if bench.steps % 5 == 0:
                bench.sonar(300 + bench.steps % 50)
                bench.target(bench.t_s)

        bench.run(5.0, each)
        return bytes(bench.raw["telemetry"]), bytes(bench.raw["coprocessor"])

    first = fly()
    assert len(first[0]) > 2000
    assert first == fly()


def test_system_id_follows_its_parameter() -> None:
    bench = Bench()
    set_parameter(bench, "MAV_SYSID", 42.0)
    bench.run(1.1)
    assert bench.heard("HEARTBEAT")[-1].get_srcSystem() == 42
    assert bench.autopilot.system_id == 42


def test_every_generation_has_a_dialect() -> None:
    for generation in Generation:
        assert dialect_of(generation).version == tuple(map(int, generation.value.split(".")))


# ---- scripts ----------------------------------------------------------------------------------


def test_a_script_flies_with_the_vehicle(tmp_path: Path) -> None:
    script = tmp_path / "probe.lua"
    script.write_text(
        """
        mavlink:init(5, 1)
        mavlink:register_rx_msgid(86)
        assert(param:add_table(95, 'PRB_', 1))
        assert(param:add_param(95, 1, 'A', 1.5))
        local function update()
          local message = mavlink:receive_chan()
          if message then gcs:send_text(6, 'target seen') end
          gcs:send_named_float('PROBE', rangefinder:distance_orient(0))
          vehicle:set_desired_speed(1.0)
          return update, 100
        end
        return update()
        """
    )
    bench = sonar_bench(PRB_A=2.5)
    bench.autopilot.load_script(script)
    bench.send(BEAT)
    bench.run(0.1)
    bench.target(200.0)
    bench.run(6.0, lambda: bench.sonar(333))
    assert bench.autopilot.script is not None
    assert bench.autopilot.script.error is None
    assert "target seen" in bench.texts()
    floats = [m for m in bench.heard("NAMED_VALUE_FLOAT") if m.name == "PROBE"]
    assert len(floats) == pytest.approx(60, abs=3)
    assert floats[-1].value == pytest.approx(3.33)
    assert bench.autopilot.parameter_get("PRB_A") == 2.5
    assert bench.speed_mps == pytest.approx(1.0, abs=0.05)


def test_scripting_can_be_off(tmp_path: Path) -> None:
    script = tmp_path / "probe.lua"
    script.write_text("gcs:send_text(6, 'alive')")
    bench = Bench(parameters={"SCR_ENABLE": 0.0})
    bench.autopilot.load_script(script)
    assert bench.autopilot.script is None


SENDS = """
local function update()
    local payload = ('<I4fc10'):pack(5, 2.5, 'X')
    gcs:send_text(6, tostring(mavlink:send_chan(%d, 251, payload)))
    return update, 1000
end
return update, 100
"""


def test_a_scripts_message_goes_by_the_link_that_it_names(tmp_path: Path) -> None:
    """As the vehicle's own; the co-processor's port is the third."""
    bench = with_script(SENDS % 2, tmp_path)
    bench.run(0.5)
    (message,) = bench.heard("NAMED_VALUE_FLOAT", "coprocessor")
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM_ID, 1)
    assert (message.time_boot_ms, message.value, message.name) == (5, 2.5, "X")
    assert bench.heard("NAMED_VALUE_FLOAT") == []
    assert bench.texts() == ["true"]


@pytest.mark.parametrize(("signed", "takes"), [(False, 18 + 12), (True, 18 + 12 + 13)])
def test_a_scripts_message_needs_room_for_all_of_it(
    signed: bool, takes: int, tmp_path: Path
) -> None:
    """256 bytes may wait for a port; a frame takes 12 beside its payload, a signature 13."""
    link = with_script("", tmp_path).autopilot.links["coprocessor"]
    if signed:
        link.sign(b"k" * 32, 2e9)
    link.drain()
    link._outgoing += bytes(256 - takes + 1)
    assert not link.send_packed(251, bytes(18))
    del link._outgoing[0]
    assert link.send_packed(251, b"x" * 18)
    assert len(link.drain()) == 256


def test_a_script_is_told_that_there_is_no_such_link(tmp_path: Path) -> None:
    bench = with_script(SENDS % 3, tmp_path)
    bench.run(0.5)
    assert bench.texts() == ["nil"]


def test_frames_for_scripts_are_whole() -> None:
    bench = Bench()
    bench.autopilot.script = object()  # type: ignore[assignment]
    link = bench.autopilot.links["telemetry"]
    bench.send(mavlink.MAVLink_named_value_float_message(0, b"X", 1.5))
    bench.autopilot._listen(bench.autopilot._ports["telemetry"])
    frame, number = bench.autopilot.next_mavlink() or (b"", -1)
    assert number == link.number == 1
    assert frame[0] == 0xFD
    assert struct.unpack_from("<f", frame, 14)[0] == 1.5
    assert bench.autopilot.next_mavlink() is None
