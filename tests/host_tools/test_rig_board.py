"""The rig's board against the firmware's own core, over a cable that loses what it is told to."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.rig.board import COMMAND_SELF_TEST, ScanMode, await_board
from echowing.rig.ports import PortLostError
from echowing.sim.boards.coprocessor import parameter_table

from .rig_desk import (
    CoreWire,
    RoutingWire,
    ScriptedWire,
    Speaker,
    autopilot_heartbeat,
    device_heartbeat,
    report,
    value,
)


@pytest.fixture
def wire() -> CoreWire:
    return CoreWire()


def is_kind(kind: str) -> Any:
    return lambda message: message.get_type() == kind


class TestState:
    def test_knows_the_board_and_what_it_hears(self, wire: CoreWire) -> None:
        board = wire.open()
        while wire.t_s < 4.0:
            board.poll(0.1)
        state = board.state
        assert (board.system_id, board.component_id) == (1, 191)
        assert state.state == "tracking"
        assert state.range_m == state.raw_m == 3.0
        assert state.signal_quality == 100
        assert state.rate_hz("DISTANCE_SENSOR") == pytest.approx(20.0, abs=1.0)
        assert state.rate_hz("HEARTBEAT") == pytest.approx(1.0, abs=0.4)
        assert [text for _, _, text in board.texts] == ["Echowing: started"]

    def test_no_target_and_no_echo_are_none(self, wire: CoreWire) -> None:
        wire.sonar.range_m = None
        board = wire.open()
        while wire.t_s < 3.0:
            board.poll(0.1)
        assert (board.state.range_m, board.state.raw_m) == (None, None)
        assert board.state.state == "searching"
        assert board.state.report_age_s is not None
        assert board.state.report_age_s < 0.3

    def test_an_old_range_is_none(self, wire: CoreWire) -> None:
        board = wire.open()
        while board.state.range_m is None:
            board.poll(0.1)
        wire.sonar.plugged = False
        end_s = wire.t_s + 3.0
        while wire.t_s < end_s:
            board.poll(0.1)
        state = board.state
        assert (state.range_m, state.raw_m, state.signal_quality) == (None, None, None)
        assert (state.state, state.critical, state.errors) == ("sonar fault", True, 1)

    def test_the_state_is_waited_for_as_it_comes_once_a_second(self, wire: CoreWire) -> None:
        board = wire.open()
        assert board.state.state == "unknown"
        board.wait_state()
        assert board.state.state in {"starting", "searching", "tracking"}
        wire.drop = is_kind("NAMED_VALUE_FLOAT")
        silent = wire.open()
        begin_s = wire.t_s
        silent.wait_state(1.0)
        assert silent.state.state == "unknown"
        assert wire.t_s - begin_s == pytest.approx(1.0, abs=0.1)

    def test_a_restart_is_counted(self, wire: CoreWire) -> None:
        board = wire.open()
        while wire.t_s < 2.0:
            board.poll(0.1)
        wire.restart()
        while wire.t_s < 4.0:
            board.poll(0.1)
        assert board.state.restarts == 1

    def test_others_on_the_wire_are_heard_and_not_believed(self, wire: CoreWire) -> None:
        board = wire.open()
        wire.sonar.plugged = False
        wire.others = Speaker(1, 1).say(report(111), value("SNR_PAN", 900.0))
        heard = board.poll(0.1)
        assert "DISTANCE_SENSOR" in [message.get_type() for message in heard]
        assert board.state.range_m != 1.11
        assert board.state.pan_us != 900.0
        assert (board.system_id, board.component_id) == (1, 191)

    def test_poll_gives_what_came_while_a_command_was_waited_for(self, wire: CoreWire) -> None:
        board = wire.open()
        board.poll(0.1)
        board.scan(ScanMode.CENTRE)
        acks = [m for m in board.poll(0.1) if m.get_type() == "COMMAND_ACK" and m.command == 31010]
        assert len(acks) == 1
        assert 0.0 < acks[0]._timestamp <= wire.t_s
        assert not [m for m in board.poll(0.1) if m.get_type() == "COMMAND_ACK"]

    def test_a_pulled_cable_ends_the_wait(self, wire: CoreWire) -> None:
        board = wire.open()
        wire.plugged = False
        with pytest.raises(PortLostError):
            board.poll(1.0)


class TestParameters:
    def test_all_of_them_in_order(self, wire: CoreWire) -> None:
        values = wire.open().parameters()
        defaults = {row.name: row.default for row in parameter_table()}
        assert values == {**defaults, "SYS_ID": wire.autopilot_system}
        assert list(values) == [row.name for row in parameter_table()]

    def test_gaps_are_asked_for_again(self, wire: CoreWire) -> None:
        lost = {3, 7, 21}

        def drop(message: Any) -> bool:
            if message.get_type() == "PARAM_VALUE" and message.param_index in lost:
                lost.remove(message.param_index)
                return True
            return False

        wire.drop = drop
        assert len(wire.open().parameters()) == len(parameter_table())
        assert not lost

    def test_a_board_that_tells_none_is_given_up(self, wire: CoreWire) -> None:
        board = wire.open()
        wire.drop = is_kind("PARAM_VALUE")
        with pytest.raises(EchowingError, match="not reported any of its parameters"):
            board.parameters()

    def test_set_acts_at_once_and_is_stored_two_seconds_later(self, wire: CoreWire) -> None:
        board = wire.open()
        assert board.set_parameter("TRACK_RANGE", 400) == 400.0
        assert wire.core.parameter("TRACK_RANGE") == 400.0
        set_at_s = wire.t_s
        assert board.wait_stored()
        assert 1.9 <= wire.t_s - set_at_s <= 3.0

    def test_nothing_changed_is_nothing_to_store(self, wire: CoreWire) -> None:
        board = wire.open()
        board.set_parameter("TRACK_RANGE", 450)
        before_s = wire.t_s
        assert board.wait_stored()
        assert wire.t_s == before_s

    def test_a_change_while_an_earlier_one_is_stored_waits_for_its_own(
        self, wire: CoreWire
    ) -> None:
        board = wire.open()
        board.set_parameter("TRACK_RANGE", 400)
        writing_s = wire.t_s + 2.02  # bytes are burnt from 2.0 s on
        while wire.t_s < writing_s:
            board.poll(writing_s - wire.t_s)
        assert "Echowing: parameters stored" not in [text for _, _, text in board.texts]
        board.set_parameter("MISS_LIMIT", 3)
        set_at_s = wire.t_s
        assert board.wait_stored()
        assert wire.t_s - set_at_s >= 1.9

    def test_armed_it_is_not_stored_until_disarmed(self, wire: CoreWire) -> None:
        wire.armed = True
        board = wire.open()
        while wire.t_s < 2.0:
            board.poll(0.1)
        board.set_parameter("SCAN_DWELL", 400)
        assert not board.wait_stored(5.0)
        wire.armed = False
        assert board.wait_stored(5.0)

    def test_what_is_refused_in_flight_is_said_as_such(self, wire: CoreWire) -> None:
        wire.armed = True
        board = wire.open()
        while wire.t_s < 2.0:
            board.poll(0.1)
        with pytest.raises(EchowingError) as refusal:
            board.set_parameter("TRACK_RANGE", 400)
        assert str(refusal.value) == (
            "TRACK_RANGE = 400 is refused; it stays 450: not while the autopilot is armed"
        )

    def test_a_refusal_names_the_value_in_force_and_the_limits(self, wire: CoreWire) -> None:
        board = wire.open()
        with pytest.raises(EchowingError) as refusal:
            board.set_parameter("SCAN_DWELL", 20)
        assert str(refusal.value) == (
            "SCAN_DWELL = 20 is refused; it stays 300; it takes whole numbers from 50 to 5000 ms"
        )
        for senseless in (1e39, float("nan"), float("-inf"), 60.5):
            with pytest.raises(EchowingError, match="is refused; it stays 300"):
                board.set_parameter("SCAN_DWELL", senseless)
        assert wire.core.parameter("SCAN_DWELL") == 300.0

    def test_an_unknown_name_lists_those_there_are(self, wire: CoreWire) -> None:
        board = wire.open()
        with pytest.raises(EchowingError, match=r"no parameter 'SCAN_DWEL'; it has SYS_ID, .*"):
            board.set_parameter("SCAN_DWEL", 100)

    def test_a_lost_answer_is_asked_for_again(self, wire: CoreWire) -> None:
        board = wire.open()
        before = board.parameter("MISS_LIMIT")
        losses = [True, False]
        wire.drop = lambda m: m.get_type() == "PARAM_VALUE" and losses.pop(0)
        assert board.set_parameter("MISS_LIMIT", before + 1) == before + 1

    def test_a_new_component_id_is_followed(self, wire: CoreWire) -> None:
        board = wire.open()
        assert board.set_parameter("COMP_ID", 150) == 150.0
        assert board.component_id == 150
        assert board.parameter("COMP_ID") == 150.0


class TestIdentity:
    def test_goes_along_when_the_board_learns_its_vehicle(self, wire: CoreWire) -> None:
        board = wire.open()
        assert board.set_parameter("SYS_ID", 0) == 0.0
        assert board.system_id == 250
        wire.autopilot_system, wire.armed = 7, False
        end_s = wire.t_s + 6.0
        while wire.t_s < end_s:
            board.poll(0.1)
        assert (board.system_id, board.component_id) == (7, 191)
        board.scan(ScanMode.AUTO)
        assert board.state.report_age_s is not None
        assert board.state.report_age_s < 0.2

    def test_version(self, wire: CoreWire) -> None:
        version = wire.open().version()
        assert version.firmware == "0.1.0"


class TestCommands:
    def test_aim_holds_both_servos(self, wire: CoreWire) -> None:
        board = wire.open()
        board.aim(1500, 1300)
        board.poll(0.1)
        end_s = wire.t_s + 2.0
        while wire.t_s < end_s:
            board.poll(0.1)
        assert (wire.core.pan_us, wire.core.tilt_us) == (1500.0, 1300.0)
        assert (board.state.pan_us, board.state.tilt_us) == (1500.0, 1300.0)

    @pytest.mark.parametrize(("pan", "tilt", "words"), [(799, 1400, "pan"), (1380, 2201, "tilt")])
    def test_aim_out_of_range_is_not_even_sent(
        self, wire: CoreWire, pan: int, tilt: int, words: str
    ) -> None:
        board = wire.open()
        wire.sent.clear()
        with pytest.raises(EchowingError, match=rf"{words} pulse .* 800 to 2200"):
            board.aim(pan, tilt)
        assert wire.sent == []

    def test_scan_start_stop(self, wire: CoreWire) -> None:
        wire.sonar.range_m = None
        board = wire.open()
        board.scan(ScanMode.CENTRE)
        assert pulses_seen(wire, board, 4.0) == {(1380.0, 1400.0)}
        board.scan(ScanMode.SCAN)
        assert len(pulses_seen(wire, board, 4.0)) == 9  # 12 points, 3 of them twice

    def test_refused_while_armed(self, wire: CoreWire) -> None:
        wire.armed = True
        board = wire.open()
        while wire.t_s < 2.0:
            board.poll(0.1)
        with pytest.raises(EchowingError, match=r"refuses command 31012 now: .* armed"):
            board.command(COMMAND_SELF_TEST)

    def test_refused_for_its_value_or_unknown(self, wire: CoreWire) -> None:
        board = wire.open()
        with pytest.raises(EchowingError, match="a value is out of its range"):
            board.command(mavlink.MAV_CMD_DO_SET_SERVO, 3, 1500)
        with pytest.raises(EchowingError, match="does not know command 31014"):
            board.command(31014)

    def test_unanswered_is_sent_five_times(self, wire: CoreWire) -> None:
        board = wire.open()
        wire.drop = is_kind("COMMAND_ACK")
        wire.sent.clear()
        with pytest.raises(EchowingError, match="has not answered command 31010"):
            board.scan(ScanMode.AUTO)
        asked = [m for m in wire.sent if m.get_type() == "COMMAND_LONG"]
        assert [m.confirmation for m in asked] == [0, 1, 2, 3, 4]
        assert {(m.get_srcSystem(), m.target_system, m.target_component) for m in asked} == {
            (245, 1, 191)  # 245: no ground station's id, so that it masks no fail-safe
        }

    def test_a_lost_acknowledgement_costs_one_try(self, wire: CoreWire) -> None:
        board = wire.open()
        losses = [True, False]
        wire.drop = lambda m: m.get_type() == "COMMAND_ACK" and losses.pop(0)
        board.scan(ScanMode.CENTRE)
        assert not losses


def pulses_seen(wire: CoreWire, board: Any, seconds: float) -> set[tuple[float, float]]:
    """Where the gimbal has pointed, after it has had time to settle."""
    seen = set()
    board.poll(0.1)
    end_s = wire.t_s + seconds
    while wire.t_s < end_s:
        board.poll(0.02)
        seen.add((wire.core.pan_us, wire.core.tilt_us))
    return seen


class TestOpening:
    """What is said when there is no board."""

    def complaint(self, wire: ScriptedWire, name: str = "/dev/ttyX") -> str:
        with pytest.raises(EchowingError) as error:
            await_board(wire, name, 57_600, wire.clock)
        return str(error.value)

    def test_a_silent_port(self) -> None:
        wire = ScriptedWire()
        words = self.complaint(wire)
        assert words.startswith("/dev/ttyX: nothing has come in 8 s")
        assert "make flash" in words

    def test_a_silent_socket(self) -> None:
        words = self.complaint(ScriptedWire(), "udpin:14550")
        assert words.endswith("Does the other end send there, and has the board power?")

    def test_bytes_without_mavlink_are_a_wrong_baud_rate(self) -> None:
        wire = ScriptedWire(*((0.1 * i, b"\xf8\x00\xfe\x80" * 5) for i in range(1000)))
        words = self.complaint(wire)
        assert "no MAVLink in them" in words
        assert "57600" in words
        assert "--baud 115200" in words
        assert wire.t_s < 5.0  # no need to wait for a mega's start: it has begun to talk

    def test_an_autopilot_is_named(self) -> None:
        beat = Speaker(3, 1).say(autopilot_heartbeat())
        words = self.complaint(ScriptedWire(*((float(i), beat) for i in range(9))))
        assert "not the co-processor" in words
        assert "an autopilot (ArduPilot, quadrotor, system 3, component 1)" in words

    def test_the_applets_values_from_an_autopilot_are_no_board(self) -> None:
        says = Speaker(3, 1).say(autopilot_heartbeat(), value("SNR_RAW", 3.0))
        assert "an autopilot" in self.complaint(ScriptedWire((0.1, says)))

    def test_another_computer_is_asked_what_it_is(self) -> None:
        beat = Speaker(3, 191).say(device_heartbeat())
        wire = ScriptedWire(*((float(i), beat) for i in range(9)))
        assert "an onboard controller (system 3, component 191)" in self.complaint(wire)
        asked = {(m.get_type(), m.target_system, m.target_component) for m in wire.sent}
        assert asked == {("PARAM_REQUEST_READ", 3, 191)}

    def test_mavlink_of_nobody(self) -> None:
        words = self.complaint(ScriptedWire((0.1, Speaker(3, 9).say(value("X", 1.0)))))
        assert "MAVLink without a heartbeat" in words

    def test_a_board_behind_an_autopilot_is_found(self) -> None:
        autopilot, board = Speaker(3, 1), Speaker(3, 191)
        wire = ScriptedWire(
            (0.1, autopilot.say(autopilot_heartbeat(), report(222))),
            (0.2, board.say(device_heartbeat())),
            (0.3, board.say(report(333), value("SNR_STATE", 2.0))),
        )
        found = await_board(wire, "x", 57_600, wire.clock)
        assert (found.system_id, found.component_id) == (3, 191)
        assert found.state.range_m == 3.33  # said before it was known who said it
        assert found.state.state == "tracking"

    def test_a_board_behind_an_autopilot_that_passes_it_on_only_to_who_has_spoken(self) -> None:
        router = RoutingWire()
        board = await_board(router, "x", 57_600, router.clock)
        assert (board.system_id, board.component_id) == (2, 191)
        assert router.clock() < 4.0

    def test_a_board_need_not_be_waited_for_until_it_beats(self, wire: CoreWire) -> None:
        wire.read(1.5)  # its first heartbeat has gone by
        while wire.t_s < 1.5:
            wire.read(0.1)
        wire.open()
        assert wire.t_s < 1.7

    def test_a_mega_that_restarts_is_waited_for(self) -> None:
        wire = ScriptedWire((6.0, Speaker().say(device_heartbeat(), value("SNR_RAW", 3.0))))
        assert await_board(wire, "x", 115_200, wire.clock).component_id == 191

    def test_a_board_whose_values_are_off_answers_by_a_parameter(self, wire: CoreWire) -> None:
        wire.drop = is_kind("NAMED_VALUE_FLOAT")
        assert wire.open().component_id == 191
