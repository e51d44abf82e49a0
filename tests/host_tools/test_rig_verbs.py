"""The rig's verbs: parameter files, the self test, recordings, the command line."""

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.rig import BOARD_VERBS, aim, params, self_test
from echowing.rig.board import Board, await_board
from echowing.rig.parameter_file import read_parameters, write_parameters
from echowing.rig.record import record
from echowing.rig.recording import MAGIC, Recorder, RecordingEnd, ReplayWire, read_recording
from echowing.rig.self_test import FAILED, FINE, UNTESTED
from echowing.rig.view import JsonView
from echowing.rig.watch import watch

from .rig_desk import CoreWire, Speaker


@pytest.fixture
def wire() -> CoreWire:
    return CoreWire()


class TestParameterFile:
    def test_what_is_written_is_read(self, tmp_path: Path) -> None:
        values = {"TRACK_RANGE": 450.0, "PAN_US_DEG": -9.699999809265137}  # a 32-bit -9.7
        path = tmp_path / "board.params"
        write_parameters(path, values, "a board")
        assert read_parameters(path) == values
        assert path.read_text().startswith("# a board\nTRACK_RANGE,450\n")

    def test_as_other_tools_write_them(self, tmp_path: Path) -> None:
        path = tmp_path / "board.params"
        path.write_text("# head\n\nSCAN_DWELL 300\nMISS_LIMIT\t3  # three\nPAN_US_DEG , -9.7\r\n")
        assert read_parameters(path)["MISS_LIMIT"] == 3.0
        assert read_parameters(path)["PAN_US_DEG"] == pytest.approx(-9.7)

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"SCAN_DWELL,many\n", "line 1: a line is NAME,VALUE, not 'SCAN_DWELL many'"),
            (b"# x\nSCAN_DWELL\n", "line 2: a line is NAME,VALUE"),
            (b"A,1,2\n", "line 1: a line is NAME,VALUE"),
            (b"prose " * 40, "not 'prose prose prose prose prose prose prose prose prose …'"),
            (b"A,nan\n", "line 1: A has to be a number, not nan"),
            (b"A,1e99\n", "line 1: A has to be a number"),
            (b"A,1\nA,2\n", "line 2: A is given twice"),
            (b"# nothing\n", "holds no parameters"),
            (b"\xff\xfe\x00", "is not a text file"),
        ],
    )
    def test_nonsense_is_named_with_its_line(
        self, tmp_path: Path, content: bytes, words: str
    ) -> None:
        path = tmp_path / "board.params"
        path.write_bytes(content)
        with pytest.raises(EchowingError, match=words):
            read_parameters(path)

    def test_a_file_that_is_not_there(self, tmp_path: Path) -> None:
        with pytest.raises(EchowingError, match="cannot be read"):
            read_parameters(tmp_path / "none")
        with pytest.raises(EchowingError, match="cannot be written"):
            write_parameters(tmp_path / "no" / "folder", {"A": 1.0}, "")

    def test_a_disk_that_fills_up_leaves_the_old_file(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "board.params"
        write_parameters(path, {"A": 1.0}, "")

        def full(*_: Any, **__: Any) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(Path, "write_text", full)
        with pytest.raises(EchowingError, match="No space left"):
            write_parameters(path, {"A": 2.0}, "")
        assert read_parameters(path) == {"A": 1.0}


class TestLoad:
    def test_sets_what_differs_and_reads_it_back(self, wire: CoreWire) -> None:
        board = wire.open()
        wanted = {"TRACK_RANGE": 400.0, "SCAN_DWELL": 300.0, "PAN_US_DEG": 9.5}
        assert params.load(board, wanted, "f") == {"TRACK_RANGE": 400.0, "PAN_US_DEG": 9.5}
        assert [m.param_id for m in wire.sent if m.get_type() == "PARAM_SET"] == [
            "TRACK_RANGE",
            "PAN_US_DEG",
        ]
        assert board.wait_stored()

    def test_an_unknown_name_changes_nothing(self, wire: CoreWire) -> None:
        with pytest.raises(EchowingError, match="f: the board has no RANGE; it has SYS_ID"):
            params.load(wire.open(), {"TRACK_RANGE": 400.0, "RANGE": 1.0}, "f")
        assert wire.core.parameter("TRACK_RANGE") == 450.0

    def test_what_is_refused_is_told_when_the_others_are_set(self, wire: CoreWire) -> None:
        wanted = {"SCAN_DWELL": 20.0, "TRACK_RANGE": 400.0}
        with pytest.raises(EchowingError, match="others are set, but SCAN_DWELL = 20 is refused"):
            params.load(wire.open(), wanted, "f")
        assert wire.core.parameter("TRACK_RANGE") == 400.0


class TestAim:
    def test_is_believed_when_the_board_tells_it(self, wire: CoreWire) -> None:
        board = wire.open()
        board.aim(1500, 1300)
        aim.await_aim(board, 1500, 1300)
        assert (board.state.pan_us, board.state.tilt_us) == (1500.0, 1300.0)

    def test_a_gimbal_that_somebody_else_moves(self, wire: CoreWire) -> None:
        board = wire.open()
        board.aim(1500, 1300)
        wire.write(Speaker(245, 190).say(set_servo(1, 1600)))
        while board.state.pan_us != 1600.0:
            board.poll(0.1)
        with pytest.raises(EchowingError, match=r"points to 1600\.0, 1300\.0 us instead"):
            aim.await_aim(board, 1500, 1300)


def set_servo(servo: int, pulse_us: float) -> Any:
    return mavlink.MAVLink_command_long_message(
        1, 191, mavlink.MAV_CMD_DO_SET_SERVO, 0, servo, pulse_us, 0, 0, 0, 0, 0
    )


class TestSelfTest:
    def test_all_is_well(self, wire: CoreWire) -> None:
        parts = self_test.judged(self_test.hear_test(wire.open()))
        assert {part.name: part.verdict for part in parts} == {
            "sonar": FINE,
            "memory": FINE,
            "autopilot port": UNTESTED,
            "USB port": UNTESTED,
        }
        assert self_test.passed(parts)

    def test_a_sonar_that_is_not_there(self, wire: CoreWire) -> None:
        wire.sonar.plugged = False
        parts = self_test.judged(self_test.hear_test(wire.open()))
        sonar = next(part for part in parts if part.name == "sonar")
        assert sonar.verdict == FAILED
        assert sonar.remedy.startswith("gives no reading: check its 5 V")
        assert not self_test.passed(parts)

    def test_a_second_test_is_judged_by_its_own_texts(self, wire: CoreWire) -> None:
        board = wire.open()
        self_test.hear_test(board)
        wire.sonar.plugged = False
        verdicts = [part.verdict for part in self_test.judged(self_test.hear_test(board))]
        assert verdicts[0] == FAILED

    def test_a_corrupt_memory_and_a_part_untold(self) -> None:
        told = ["Echowing test: sonar good", "Echowing test: memory corrupt"]
        parts = {part.name: part for part in self_test.judged(told)}
        assert parts["memory"].verdict == FAILED
        assert parts["USB port"].verdict == FAILED
        assert "has not reported" in parts["USB port"].remedy

    def test_a_test_that_does_not_end(self, wire: CoreWire) -> None:
        board = wire.open()
        wire.drop = lambda message: message.get_type() == "STATUSTEXT"
        with pytest.raises(EchowingError, match="has not ended: was the autopilot armed"):
            self_test.hear_test(board)

    @pytest.mark.parametrize(
        ("answer", "swept"), [("y\n", True), ("Yes\n", True), ("n\n", False), ("\n", False)]
    )
    def test_the_servos_are_judged_by_eye(
        self, monkeypatch: pytest.MonkeyPatch, answer: str, swept: bool
    ) -> None:
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        assert self_test.ask_swept(Console(quiet=True)) is swept
        assert self_test.passed([self_test.servos(swept=swept)]) is swept

    def test_nobody_there_to_judge_them(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("sys.stdin", io.StringIO(""))
        with pytest.raises(EchowingError, match="--yes"):
            self_test.ask_swept(Console(quiet=True))

    def test_every_text_of_the_firmware_is_understood(self) -> None:
        source = Path(__file__).parents[2] / "firmware/echowing/src/core/notice_table.h"
        rows = re.findall(r'^ECHOWING_NOTICE\(.*, "(.*)"\)$', source.read_text(), re.MULTILINE)
        texts = [f"Echowing{row}" for row in rows if f"Echowing{row}".startswith(self_test.PREFIX)]
        good = [text for text in texts if text.endswith("good")]
        assert len(texts) == 9
        assert {part.verdict for part in self_test.judged(good)} == {FINE}
        others = self_test.judged(text for text in texts if text not in good)
        assert [part.verdict for part in others] == [FAILED, FAILED, UNTESTED, UNTESTED]
        assert texts[-1].startswith(self_test.ENDED)


class TestRecording:
    def recorded(self, path: Path, seconds: float = 3.0) -> Board:
        wire = CoreWire()
        board = Board(wire, (0, 0), name="desk", clock=wire.clock)
        recorder = Recorder(path, {"port": "desk", "baud": 115_200})
        record(board, recorder, Console(quiet=True), lambda: False, seconds)
        recorder.close()
        return board

    def test_keeps_every_byte_in_time(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        board = self.recorded(path)
        recording = read_recording(path)
        assert recording.about["baud"] == 115_200
        assert sum(len(chunk.data) for chunk in recording.chunks) == board.frames.counts.bytes
        assert 2.8 <= recording.duration_s <= 3.1
        times = [chunk.time_s for chunk in recording.chunks]
        assert times == sorted(times)

    def test_replays_as_it_was(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "bench.ewr"
        self.recorded(path)
        assert main(["rig", "replay", str(path), "--fast", "--json"]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [line["text"] for line in lines if "text" in line] == ["Echowing: started"]
        assert lines[-1]["state"] == "tracking"
        assert lines[-1]["range_m"] == 3.0
        assert lines[-1]["wire"]["damaged"] == lines[-1]["wire"]["lost"] == 0
        assert len(lines) == pytest.approx(30, abs=5)
        main(["rig", "replay", str(path), "--fast", "--json"])
        again = capsys.readouterr().out.splitlines()
        assert [json.loads(line) for line in again] == lines

    def test_the_boards_parameters_are_in_it(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        self.recorded(path)
        wire = ReplayWire(read_recording(path), "bench", sleep=None)
        board = await_board(wire, "bench", 115_200, wire.now_s)
        with pytest.raises(RecordingEnd, match=r"ends after 3\.0 s"):
            watch(board, JsonView())
        assert board.state.parameters["TRACK_RANGE"] == 450.0
        assert board.state.version is not None

    def test_a_recording_too_short_for_a_heartbeat(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = tmp_path / "bench.ewr"
        recorder = Recorder(path, {})
        recorder.add(0.5, b"range")
        recorder.close()
        assert main(["rig", "replay", str(path), "--fast"]) == 2
        assert "no MAVLink in them" in (told := capsys.readouterr().err)
        assert "the recording lasts only 0.5 s" in told

    def test_a_board_that_is_heard_late_in_it(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        early, late = tmp_path / "early.ewr", tmp_path / "late.ewr"
        self.recorded(early)
        recorder = Recorder(late, {})
        recorder.add(9.0, b"\x00\x80")
        for chunk in read_recording(early).chunks:
            recorder.add(15.0 + chunk.time_s, chunk.data)
        recorder.close()
        assert main(["rig", "replay", str(late), "--fast", "--json"]) == 0
        last = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert last["state"] == "tracking"

    def test_at_real_time_it_waits(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        self.recorded(path)
        now = [100.0]

        def sleep(seconds: float) -> None:
            now[0] += seconds

        recording = read_recording(path)
        wire = ReplayWire(recording, "bench", sleep, lambda: now[0])
        with pytest.raises(RecordingEnd):
            while True:
                wire.read(0.1)
        assert now[0] - 100.0 == pytest.approx(recording.duration_s)

    def test_a_crash_loses_the_last_record_at_most(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        self.recorded(path)
        whole = read_recording(path).chunks
        content = path.read_bytes()
        for cut in (1, 5, len(whole[-1].data), len(whole[-1].data) + 11):
            path.write_bytes(content[:-cut])
            assert read_recording(path).chunks == whole[:-1]

    def test_a_record_is_in_the_file_when_add_returns(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        recorder = Recorder(path, {})
        recorder.add(0.5, b"range")
        assert [chunk.data for chunk in read_recording(path).chunks] == [b"range"]
        recorder.close()

    def test_nothing_is_written_over(self, tmp_path: Path) -> None:
        path = tmp_path / "bench.ewr"
        Recorder(path, {}).close()
        with pytest.raises(EchowingError, match="exists already"):
            Recorder(path, {})
        with pytest.raises(EchowingError, match="cannot be written"):
            Recorder(tmp_path / "no" / "folder", {})

    def test_a_full_disk_is_told(self) -> None:
        class Full:
            def write(self, data: bytes) -> int:
                raise OSError(28, "No space left on device")

        recorder = Recorder.__new__(Recorder)
        recorder.path, recorder.bytes = Path("bench.ewr"), 0
        recorder._file = Full()  # type: ignore[assignment]
        with pytest.raises(EchowingError, match=r"bench\.ewr: cannot be written \(No space left"):
            recorder.add(0.0, b"range")

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"", "is not a recording"),
            (b"\xfd" * 5000, "is not a recording"),
            (MAGIC + b"{}", "is not a recording"),  # cut in its first line
            (MAGIC + b"{\n", "first line is damaged"),
            (MAGIC + b"[]\n", "first line is damaged"),
            (MAGIC + b"{}\n" + b"\xff" * 12, "damaged at its byte 0"),
        ],
    )
    def test_what_is_no_recording(self, tmp_path: Path, content: bytes, words: str) -> None:
        path = tmp_path / "bench.ewr"
        path.write_bytes(content)
        with pytest.raises(EchowingError, match=words):
            read_recording(path)

    def test_a_recording_without_a_board_says_so(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = tmp_path / "bench.ewr"
        recorder = Recorder(path, {"baud": 9600})
        for i in range(100):
            recorder.add(i * 0.1, b"\x00\x80" * 10)
        recorder.close()
        assert main(["rig", "replay", str(path), "--fast"]) == 2
        told = capsys.readouterr().err
        assert "no MAVLink in them" in told
        assert "9600" in told


class TestCommandLine:
    @pytest.mark.parametrize("verb", BOARD_VERBS)
    def test_every_verb_helps_with_an_example(
        self, verb: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit) as stopped:
            main(["rig", verb, "--help"])
        assert stopped.value.code == 0
        told = capsys.readouterr().out
        assert f"  echowing rig {verb}" in told
        assert "--json" in told

    @pytest.mark.parametrize("verb", ["get", "set", "save", "load", "diff"])
    def test_so_does_every_verb_of_params(
        self, verb: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit):
            main(["rig", "params", verb, "--help"])
        assert f"  echowing rig params {verb}" in capsys.readouterr().out

    @pytest.mark.parametrize(
        "arguments",
        [
            ["rig", "--port", "/dev/null", "info"],
            ["rig", "info", "--port", "/dev/null"],
            ["rig", "--port", "/dev/zero", "params", "get", "--port", "/dev/null"],
            ["rig", "record", "x.ewr", "--port", "/dev/null"],
        ],
    )
    def test_the_port_is_taken_before_and_after_the_verb(
        self, arguments: list[str], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(arguments) == 2
        assert "echowing rig: /dev/null: is not a serial port" in capsys.readouterr().err
