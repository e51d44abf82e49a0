"""The live view: the figure 8, the picture, plain lines and JSON lines."""

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console
from rich.text import Text

from echowing.rig import search
from echowing.rig.board import Board, ScanMode
from echowing.rig.figure import COLUMNS, ROWS, direction, draw, points_at
from echowing.rig.view import JsonView, LiveView, PlainView, bar, picture, snapshot
from echowing.rig.watch import watch

from .rig_desk import (
    CoreWire,
    ScriptedWire,
    Speaker,
    device_heartbeat,
    report,
    text,
    value,
)


class TestFigure:
    def test_points_that_coincide_are_one_place(self) -> None:
        places = {points_at({}, pan, tilt) for pan, tilt in search.scan_pulses_us()}
        assert places == {(1, 7), (2,), (3,), (4,), (5, 11), (6, 12), (8,), (9,), (10,)}
        assert points_at({}, 1385, 1400) == ()

    def test_drawn_as_seen_from_behind(self) -> None:
        rows = draw({}).plain.split("\n")
        assert len(rows) == ROWS
        assert {len(row) for row in rows} == {COLUMNS}
        assert [rows[i].split() for i in (0, 3, 6)] == [
            ["2", "3", "4"],
            ["1·7", "6·12", "5·11"],
            ["8", "9", "10"],
        ]
        # Pan pulses 1330, 1380, 1400: the middle stands five sevenths of the way to the right.
        assert [rows[0].index(point) for point in "234"] == [2, 2 + round(29 * 5 / 7), 31]

    def test_a_reversed_servo_is_drawn_the_way_it_looks(self) -> None:
        rows = draw({"PAN_US_DEG": -10.0}).plain.split("\n")
        assert rows[0].split() == ["4", "3", "2"]

    def test_the_present_point_is_lit(self) -> None:
        assert lit(draw({}, 1380, 1400)) == ["[6·12]"]
        assert lit(draw({}, 1330, 1500)) == ["[2]"]
        assert lit(draw({})) == []

    def test_between_the_points_it_is_a_plus(self) -> None:
        rows = draw({}, 1365, 1450).plain.split("\n")
        row = next(row for row in rows if "+" in row)
        assert rows.index(row) in (1, 2)  # half-way up from level to high
        assert row.index("+") == 2 + round(29 * 35 / 70)

    def test_beyond_the_search_it_is_a_plus_at_the_edge(self) -> None:
        assert draw({}, 2200, 2200).plain.split("\n")[0].index("+") == 31

    @pytest.mark.parametrize(
        "parameters",
        [{"PAN_US_DEG": 0.0}, {"PAN_LEFT": 1380.0, "PAN_RIGHT": 1380.0}],
    )
    def test_a_gimbal_that_only_tilts(self, parameters: dict[str, float]) -> None:
        assert draw(parameters, 1380, 1400).plain.count("\n") == ROWS - 1

    def test_direction(self) -> None:
        aim = direction({"TILT_US_DEG": 8.0}, 1330, 1440)
        assert (aim.right_deg, aim.up_deg) == (-5.0, 5.0)


def lit(figure: Text) -> list[str]:
    """What is drawn on green."""
    characters = [
        (span.start, figure.plain[span.start : span.end])
        for span in figure.spans
        if "green" in str(span.style)
    ]
    joined = "".join(words for _, words in sorted(characters))
    return [joined] if joined else []


class TestBar:
    @pytest.mark.parametrize(
        ("range_m", "length"), [(None, 0), (0.0, 0), (3.825, 20), (7.65, 40), (99.0, 40)]
    )
    def test_length(self, range_m: float | None, length: int) -> None:
        shown = bar(range_m, 4.5, "green").plain
        mark = 24  # 4.5 of 7.65 m, of 40 characters
        assert len(shown) == 40
        assert shown[mark] == "│"
        assert shown.count("█") == length - (length > mark)

    def test_a_threshold_at_full_scale_keeps_its_mark(self) -> None:
        assert bar(1.0, 7.65, "green").plain[39] == "│"


def shown(board: Board, *texts: Text) -> str:
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(picture(board, 12.0, list(texts)))
    return console.export_text()


def scripted(*messages: Any) -> Board:
    """A board that has said this."""
    wire = ScriptedWire((1.0, Speaker().say(*messages)))
    board = Board(wire, (1, 191), name="/dev/ttyACM0", clock=wire.clock)
    board.poll(2.0)
    return board


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_no_number_is_nothing_known(wrong: float) -> None:
    board = scripted(*(value(f"SNR_{name}", wrong) for name in ("RAW", "PAN", "TILT", "STATE")))
    state = board.state
    assert (state.raw_m, state.pan_us, state.tilt_us) == (None, None, None)
    assert "unknown" in shown(board)


class TestPicture:
    def test_tracking(self) -> None:
        board = scripted(
            report(321),
            value("SNR_RAW", 3.2),
            value("SNR_PAN", 1380.0),
            value("SNR_TILT", 1400.0),
            value("SNR_STATE", 2.0),
        )
        words = shown(board, Text("   11.0 s  Echowing: started"))
        assert "Echowing on /dev/ttyACM0" in words
        assert " tracking " in words
        assert "3.21 m" in words
        assert "3.20 m" in words
        assert "6 = 12" in words
        assert "100 %" in words
        assert "5 frames, 0 lost, 0 damaged" in words
        assert "Echowing: started" in words

    def test_searching_has_no_range(self) -> None:
        board = scripted(report(766, quality=1), value("SNR_RAW", 7.66), value("SNR_STATE", 1.0))
        words = shown(board)
        assert " searching " in words
        assert "no target" in words
        assert "no echo" in words

    def test_a_silent_board_is_told_before_all(self) -> None:
        board = scripted(report(321), value("SNR_STATE", 2.0))
        board.poll(4.5)
        words = shown(board)
        assert "nothing from the board for 4 s" in words
        assert " tracking " not in words
        assert "no report" in words

    def test_reports_that_have_stopped_are_told(self) -> None:
        board = scripted(report(321), value("SNR_STATE", 3.0))
        board.poll(1.25)
        assert "sonar fault   no range for 1.2 s" in shown(board)

    def test_a_board_that_has_said_nothing_yet(self) -> None:
        words = shown(scripted())
        assert "unknown" in words
        assert "no report" in words

    def test_warnings_and_restarts_are_counted(self) -> None:
        board = scripted(
            value("SNR_PAN", 1380.0, boot_ms=5000),
            text("Echowing: sonar does not answer", severity=2),
            value("SNR_PAN", 1380.0, boot_ms=100),
        )
        assert "restarts 1, warnings 1" in shown(board)

    def test_live_on_a_terminal(self) -> None:
        console = Console(force_terminal=True, width=100, record=True)
        view = LiveView(console)
        view.event(1.0, 2, "Echowing: sonar does not answer")
        view.show(2.0, scripted(report(321)))
        view.close()
        told = console.export_text()
        assert "1.0 s  Echowing: sonar does not answer" in told
        assert "3.21 m" in told


class TestWatch:
    def test_json_lines(self, capsys: pytest.CaptureFixture[str]) -> None:
        wire = CoreWire()
        board = wire.open()
        board.ask_parameters()
        watch(board, JsonView(), duration_s=3.0)
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        states = [line for line in lines if "state" in line]
        assert [line["text"] for line in lines if "text" in line] == ["Echowing: started"]
        assert len(states) == pytest.approx(30, abs=3)
        assert states[-1]["state"] == "tracking"
        assert states[-1]["range_m"] == states[-1]["raw_m"] == 3.0
        assert states[-1]["wire"]["lost"] == 0
        assert states[-1]["rates_hz"]["range"] == pytest.approx(20.0, abs=1.0)
        assert list(board.state.parameters) == list(search.parameter_defaults())

    def test_each_text_is_told_once(self, capsys: pytest.CaptureFixture[str]) -> None:
        wire = CoreWire()
        board = wire.open()
        watch(board, PlainView(), duration_s=1.0)
        wire.sonar.plugged = False
        watch(board, PlainView(), duration_s=2.5)
        told = capsys.readouterr().out
        assert told.count("Echowing: sonar does not answer") == 1
        assert "sonar fault, range no report, reading no echo" in told

    def test_it_follows_the_scan_through_its_points(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        wire = CoreWire(range_m=None)
        board = wire.open()
        board.scan(ScanMode.SCAN)
        watch(board, JsonView(), duration_s=5.0)
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        seen = {tuple(line["points"]) for line in lines if line.get("points")}
        assert seen == {(1, 7), (2,), (3,), (4,), (5, 11), (6, 12), (8,), (9,), (10,)}

    def test_ends_when_told(self) -> None:
        board = CoreWire().open()
        answers = iter([False, False, True])
        watch(board, PlainView(), lambda: next(answers))
        assert list(answers) == []

    def test_snapshot_before_anything_is_known(self) -> None:
        assert snapshot(scripted())["points"] is None


def test_the_users_page_shows_the_picture_as_it_is() -> None:
    board = a_while_of(report(298), value("SNR_RAW", 3.01))
    told = [Text("    4.2 s  Echowing: parameters stored")]
    page = (Path(__file__).parents[2] / "host_tools" / "RIG.md").read_text(encoding="utf-8")
    assert shown(board, *told) in page, shown(board, *told)


def a_while_of(*messages: Any) -> Board:
    """A tracking board that has said these twenty times a second for twelve seconds."""
    speaker = Speaker()
    pulses = value("SNR_PAN", 1330.0), value("SNR_TILT", 1500.0), value("SNR_STATE", 2.0)
    script = [(0.0, speaker.say(version(), text("Echowing: started"), *pulses))]
    for tick in range(240):
        beat = [device_heartbeat()] if tick % 20 == 0 else []
        script.append((tick * 0.05, speaker.say(*beat, *messages)))
    wire = ScriptedWire(*script)
    board = Board(wire, (1, 191), name="/dev/ttyACM0", clock=wire.clock)
    while wire.t_s < 11.95:
        board.poll(0.05)
    return board


def version() -> Any:
    blank = bytes(8)
    return mavlink.MAVLink_autopilot_version_message(
        0, 0x000100FF, 0, 0, 0, b"1e8003ee", blank, blank, 0, 0, 0
    )
