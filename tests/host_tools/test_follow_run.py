import io
import json
import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console

from echowing.commands.follow import options_of
from echowing.docs.live_table import SETTLED_S, Photographer, drawn
from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowSession
from echowing.mavlink.seats import LISTEN_S, VehicleFinder, parse_seat
from echowing.sonar_file import load_sonar, shipped_sonar, write_sonar
from echowing.stopping import StopRequest
from echowing.tool.health import health
from echowing.tool.log import FollowLog
from echowing.tool.panel import LINK_WINDOW_S, SONAR_FRESH_S, Panel, Row, VehicleHealth
from echowing.tool.track import Track
from echowing.tool.view import (
    PLAIN_PERIOD_S,
    JsonView,
    LiveView,
    PlainView,
    open_view,
    plain_row,
    scene,
)

LEADER, FOLLOWER, SECOND = 1, 2, 3


def received(system_id: int, message: Any, component: int = 1, sequence: int = 0) -> Any:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
    sender.seq = sequence
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


def beat(system_id: int, *, component: int = 1, autopilot: int = 3) -> Any:
    message = mavlink.MAVLink_heartbeat_message(2, autopilot, 0x81, 4, 4, 3)
    return received(system_id, message, component)


# ---- who is where -----------------------------------------------------------------------------


def test_the_only_vehicle_on_a_link_takes_its_seat() -> None:
    seats = [parse_seat("leader", "udpin:1"), parse_seat("follower", "udpin:2")]
    finder = VehicleFinder(seats)
    everywhere = "(listens on all addresses of this computer)"
    assert finder.waiting() == (
        f"waiting for leader on udpin:1 {everywhere}, follower on udpin:2 {everywhere}"
    )
    finder.heard("udpin:1", beat(11), 0.0)
    finder.heard("udpin:2", beat(12), 0.5)
    finder.heard("udpin:2", beat(245, component=190, autopilot=8), 0.5)  # a ground station
    finder.decide(LISTEN_S - 0.1)
    assert not finder.complete  # another may be there
    finder.decide(LISTEN_S + 0.5)
    assert [seat.system_id for seat in seats] == [11, 12]


def test_several_vehicles_on_a_link_have_to_be_told_apart() -> None:
    seats = [parse_seat("leader", "udpin:1")]
    finder = VehicleFinder(seats)
    finder.heard("udpin:1", beat(11), 0.0)
    finder.heard("udpin:1", beat(7), 1.0)
    with pytest.raises(EchowingError, match=r"systems 7, 11 are on it.*udpin:1@7"):
        finder.decide(LISTEN_S)


def test_a_seat_without_an_id_waits_for_one_whose_heartbeats_are_lost() -> None:
    """Three lost in a row: after 1.5 s another vehicle would have had its seat."""
    finder = VehicleFinder([parse_seat("leader", "udpin:1")])
    for beat_s in (0.0, 1.0, 2.0, 3.0):
        finder.heard("udpin:1", beat(11), beat_s)
        finder.decide(beat_s + 0.9)
        assert not finder.complete
    finder.heard("udpin:1", beat(7), 3.95)
    with pytest.raises(EchowingError, match="systems 7, 11 are on it"):
        finder.decide(4.0)


def test_a_vehicle_with_an_id_leaves_the_other_on_the_link() -> None:
    seats = [parse_seat("leader", "udpin:1@11"), parse_seat("follower", "udpin:1")]
    finder = VehicleFinder(seats)
    for system_id in (11, 12):
        finder.heard("udpin:1", beat(system_id), 0.0)
    finder.decide(LISTEN_S)
    assert seats[1].system_id == 12


def test_a_vehicle_that_was_named_is_waited_for_too() -> None:
    finder = VehicleFinder([parse_seat("leader", "udpin:10.0.0.2:1@7")])
    where = "udpin:10.0.0.2:1 (listens on 10.0.0.2)"
    assert finder.waiting() == f"waiting for leader, system 7, on {where}"
    finder.heard("udpin:10.0.0.2:1", beat(1), 0.0)
    assert not finder.complete
    assert finder.waiting() == f"waiting for leader, system 7, on {where} (on it: 1)"
    finder.heard("udpin:10.0.0.2:1", beat(7), 0.5)
    assert finder.complete


def test_two_vehicles_with_one_id_are_refused() -> None:
    seats = [parse_seat("leader", "udpin:1"), parse_seat("follower", "udpin:2")]
    finder = VehicleFinder(seats)
    finder.heard("udpin:1", beat(1), 0.0)
    finder.heard("udpin:2", beat(1), 0.0)
    with pytest.raises(EchowingError, match="follower on udpin:2 is system 1, as is the leader"):
        finder.decide(LISTEN_S)


# ---- what is asked for ------------------------------------------------------------------------


@pytest.mark.parametrize("step", ["-9.5", "-30.0", "nan", "600.0"])
def test_a_slot_in_the_ground_or_out_of_sight_is_refused(step: str, tmp_path: Path) -> None:
    """Altitude steps add to --altitude, and a copter flies where it is told to: into the ground."""
    formation = tmp_path / "low.toml"
    formation.write_text(f"[[slots]]\nradius_m = 4.0\naltitude_step_m = {step}\n", encoding="utf-8")
    ends = ["--leader", "udpin:1", "--follower", "udpin:2", "--formation", str(formation)]
    with pytest.raises(EchowingError, match=r"slot 1 would be flown at .* give 2 to 500"):
        options_of([*ends, "--altitude", "10"])
    if step in ("nan", "600.0"):  # whatever the leader's height
        with pytest.raises(EchowingError, match=r"slot 1 would be flown at .* give 2 to 500"):
            options_of(ends)


def test_a_flight_is_logged_unless_told_otherwise() -> None:
    ends = ["--leader", "udpin:1", "--follower", "udpin:2"]
    log = options_of(ends).log
    assert log is not None
    assert log.parent == Path("out/flights")
    assert re.fullmatch(r"\d{8}-\d{6}", log.name)
    assert options_of([*ends, "--log", "here"]).log == Path("here")
    assert options_of([*ends, "--no-log"]).log is None


# ---- what is shown ----------------------------------------------------------------------------


def session(belief: SonarBelief | None = None) -> FollowSession:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), sonar=belief or shipped_sonar())
    return FollowSession(LEADER, [plan], GuidanceSettings())


def sonar(range_cm: int, system_id: int = FOLLOWER) -> Any:
    message = mavlink.MAVLink_distance_sensor_message(0, 20, 765, range_cm, 1, 0, 0, 0)
    return received(system_id, message, component=191)


def test_the_sonar_that_is_believed_is_the_files_before_these_legs(tmp_path: Path) -> None:
    ends = ["--leader", "udpin:1", "--follower", "udpin:2"]
    mine = tmp_path / "mine.toml"
    write_sonar(mine, load_sonar("mb1202").model_copy(update={"reach_m": 4.2}))

    assert options_of(ends).sonar == shipped_sonar()
    assert options_of([*ends, "--sonar", str(mine)]).sonar.reach_m == 4.2
    assert options_of([*ends, "--legs", "stock"]).sonar.heard_to_m < shipped_sonar().heard_to_m
    with pytest.raises(EchowingError, match="no sonar 'mb7'"):
        options_of([*ends, "--sonar", "mb7"])


def test_a_sonar_reading_is_shown_while_fresh_and_nothing_is_not_a_range() -> None:
    panel, follow = Panel([LEADER, FOLLOWER]), session()
    panel.receive(sonar(312), 1.0)
    assert panel.rows(follow, 1.0)[0].sonar_m == pytest.approx(3.12)
    assert panel.rows(follow, 1.1 + SONAR_FRESH_S)[0].sonar_m is None
    panel.receive(sonar(766), 2.0)
    assert panel.rows(follow, 2.0)[0].sonar_m is None


def test_a_sonar_that_reaches_further_is_shown_further() -> None:
    """What is no target is what its file says."""
    panel = Panel([LEADER, FOLLOWER])
    panel.receive(sonar(650), 1.0)
    assert panel.rows(session(), 1.0)[0].sonar_m is None
    far = session(replace(shipped_sonar(), reach_m=7.0))
    assert panel.rows(far, 1.0)[0].sonar_m == pytest.approx(6.5)


def test_a_sonar_that_hears_something_else_is_told_of_once() -> None:
    panel, follow = Panel([LEADER, FOLLOWER]), session()
    for tenth in range(100):
        now_s = tenth / 10
        for system_id, north_e7 in ((LEADER, 0), (FOLLOWER, -400)):  # 4.4 m apart
            here = mavlink.MAVLink_global_position_int_message(
                round(now_s * 1e3) + 1, 393400000 + north_e7, -860300000, 260_000, 10_000, *(0,) * 4
            )
            follow.receive(received(system_id, here), now_s)
        panel.receive(sonar(120 if tenth < 80 else 400), now_s)
        panel.rows(follow, now_s)
    assert panel.texts == [
        (FOLLOWER, "the sonar detects something at 1.2 m, the leader should be 4.4 m away")
    ]


def test_a_follower_behind_another_is_shown_with_the_gap_to_that_one() -> None:
    """A column of two, each 3.3 m behind the one ahead: its sonar watches that one."""
    plans = [
        FollowerPlan(FOLLOWER, Slot(3.0), sonar=shipped_sonar()),
        FollowerPlan(SECOND, Slot(3.0, behind=0), sonar=shipped_sonar()),
    ]
    settings = GuidanceSettings(learn_offset=False)
    panel, follow = Panel([LEADER, FOLLOWER, SECOND]), FollowSession(LEADER, plans, settings)
    for tenth in range(40):
        now_s = tenth / 10
        for system_id, north_e7 in ((LEADER, 0), (FOLLOWER, -300), (SECOND, -600)):
            here = mavlink.MAVLink_global_position_int_message(
                round(now_s * 1e3) + 1, 393400000 + north_e7, -860300000, 260_000, 10_000, *(0,) * 4
            )
            follow.receive(received(system_id, here), now_s)
        panel.receive(sonar(60, SECOND), now_s)
        first, second = panel.rows(follow, now_s)
    assert (first.watches, second.watches) == (None, FOLLOWER)
    assert first.separation_m == pytest.approx(3.33, abs=0.01)
    assert second.separation_m == pytest.approx(3.33, abs=0.01)
    assert second.error_m == pytest.approx(0.33, abs=0.01)
    assert panel.texts == [
        (SECOND, "the sonar detects something at 0.6 m, follower 2 should be 3.3 m away")
    ]


def test_whom_a_row_tells_the_separation_from_is_said_where_it_is_not_the_leader() -> None:
    chained = row(system_id=SECOND, watches=FOLLOWER, separation_m=3.02)
    assert "separation from 2 3.02 m" in plain_row(chained)
    assert "3: separation from 2" in lines_of([row(), chained], 120)
    assert "separation 3.02 m" in plain_row(row(separation_m=3.02))
    assert "separation from" not in "".join(lines_of([row()], 120))


def test_the_link_is_the_share_of_frames_that_came() -> None:
    panel = Panel([FOLLOWER])
    for step in range(51):
        if step % 5:  # every fifth is lost
            message = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 5, 4, 3)
            now_s = step * LINK_WINDOW_S / 45
            panel.receive(received(FOLLOWER, message, sequence=(250 + step) % 256), now_s)
    (row,) = panel.rows(session(), LINK_WINDOW_S)
    assert row.link_percent == pytest.approx(80.0, abs=2.0)
    assert row.own.mode == "LOITER"


def test_warnings_of_the_vehicles_are_passed_on_and_chatter_is_not() -> None:
    panel = Panel([FOLLOWER])
    for severity, text in ((4, b"too close"), (6, b"tracking")):
        message = mavlink.MAVLink_statustext_message(severity, text)
        panel.receive(received(FOLLOWER, message), 0.0)
    assert panel.texts == [(FOLLOWER, "too close")]


OWN = VehicleHealth(mode="GUIDED", altitude_m=10.0)


def row(**changes: Any) -> Row:
    known: dict[str, Any] = {
        **{"time_s": 1.0, "system_id": 2, "state": "following"},
        **{"separation_m": 3.214, "error_m": 0.214, "slot_error_m": 0.3, "sonar_m": 3.05},
        **{"gimbal": "tracking", "leader_age_s": 0.24, "age_s": 0.06, "command_mps": 1.9},
        **{"speed_mps": 2.0, "leader_speed_mps": 2.0, "link_percent": 97.0},
        **{"north_offset_m": 0.1, "east_offset_m": -0.1, "own": OWN},
    }
    return Row(**{**known, **changes})


LEADERS = VehicleHealth(
    mode="GUIDED", altitude_m=12.3, gps="3D 14", battery_percent=77.0, battery_v=11.9, clock_s=0.05
)

# Rich draws by the terminal it is told of, and not by the one that the tests run in.
XTERM: dict[str, Any] = {"_environ": {"TERM": "xterm"}}


@pytest.mark.parametrize(
    ("term", "terminal", "kind"),
    [
        ("xterm", True, LiveView),
        ("", True, LiveView),
        ("dumb", True, PlainView),  # a live table is not shown there before the end
        ("xterm", False, PlainView),
    ],
)
def test_a_live_table_only_where_it_can_be_drawn(
    term: str, terminal: bool, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    stdout = io.StringIO()
    monkeypatch.setattr(stdout, "isatty", lambda: terminal)
    monkeypatch.setattr("sys.stdout", stdout)
    monkeypatch.setenv("TERM", term)
    assert type(open_view(as_json=False)) is kind


def test_the_live_view_shows_a_row_a_vehicle_and_the_last_events() -> None:
    output = io.StringIO()
    view = LiveView(Console(file=output, force_terminal=True, width=200, **XTERM))
    view.rows(1.0, [row(), row(system_id=3, sonar_m=None)])
    view.event(1.0, "follower 3: left Guided for LOITER, pilot has control")
    view.close()
    shown = output.getvalue()
    for text in ("3.21", "+0.21", "3.05", "1.9", "97", "left Guided for LOITER"):
        assert text in shown
    assert "leader: 2.0 m/s, last report 0.24 s ago" in shown


def lines_of(rows: list[Row], width: int) -> list[str]:
    console = Console(file=io.StringIO(), force_terminal=True, width=width, **XTERM)
    with console.capture() as shown:
        console.print(scene(rows, []))
    return re.sub(r"\x1b\[[0-9;]*m", "", shown.get()).splitlines()


# The widest that each can be in the air, and more: a separation in another country.
WIDE = row(
    **{"system_id": 255, "state": "holding: the leader's telemetry is stale"},
    **{"separation_m": 123.46, "error_m": -120.46},
    **{"sonar_m": 7.65, "gimbal": "sonar fault", "age_s": 61.234, "speed_mps": 12.3},
    **{"command_mps": 12.5, "link_percent": 100.0},
    own=VehicleHealth(mode="GUIDED_NOGPS, not flying", altitude_m=4810.2, switch="not seen"),
)
FAR = row(
    system_id=3, separation_m=8_765_432.1, error_m=-8_765_432.1, own=replace(OWN, altitude_m=-3.2)
)


@pytest.mark.parametrize(("width", "lines"), [(200, 1), (120, 1), (80, 1), (79, 2), (60, 2)])
def test_the_table_fits_the_terminal_and_cuts_no_number(width: int, lines: int) -> None:
    shown = lines_of([row(), WIDE, FAR], width)
    assert all(len(line) <= width for line in shown)
    assert "…" not in "".join(shown)
    numbers = [line.split() for line in shown if re.search(r" (97|100)\s*$", line)]
    usual, wide, far = ([word for word in words if word[-1].isdigit()] for words in numbers)
    quiet = ["3.21", "+0.21", "3.05", "0.06", "2.0", "1.9", "10.0", "97"]
    assert usual[-8:] == quiet
    assert wide[-8:] == ["123.46", "-120.5", "7.65", "61.23", "12.3", "12.5", "4810.2", "100"]
    assert far[-8:-6] == ["9e+06", "-9e+06"]
    # The vehicle's id stands in the same line as its numbers, or in the one before.
    assert (usual[0] == "2") is (lines == 1)
    assert any(re.match(r"255 +holding", line) for line in shown)


def test_a_long_event_goes_on_under_its_text() -> None:
    said = "follower 2: its slot is 2 m from the leader, and 4.6 m is the least at which it turns"
    console = Console(file=io.StringIO(), force_terminal=True, width=60, **XTERM)
    with console.capture() as shown:
        console.print(scene([], [f"{12.3:7.1f} s  {said}", f"{12.4:7.1f} s  engaged"]))
    first, second, third = shown.get().splitlines()
    assert first.startswith("   12.3 s  follower 2: ")
    assert second.startswith(" " * 11 + "4.6 m is")
    assert third == "   12.4 s  engaged"
    assert f"{first.strip()[8:]} {second.strip()}" == said
    assert max(map(len, (first, second))) <= 60


def test_what_a_sonar_has_heard_stands_in_the_lines_of_health() -> None:
    well, badly, unknown = (
        health([row(**told)]).plain
        for told in (
            {"heard_percent": 74.2, "scatter_m": 0.018, "wrong_percent": 1.6},
            {"heard_percent": 31.0, "worse": "sonar hears 31%, 50% is believed"},
            {},
        )
    )
    assert "hears 74 % ± 2 cm 2 % wrong" in well
    assert "sonar hears 31%, 50% is believed" in badly
    assert "hears" not in unknown


def test_reasons_stand_under_the_table_and_the_switch_in_the_lines_of_health() -> None:
    shown = lines_of([row(own=replace(OWN, switch="off"), leader=OWN), WIDE], 80)
    reason = shown.index("255: the leader's telemetry is stale, not flying")
    assert shown[reason + 1].startswith("leader: ")
    assert shown[reason + 2].endswith("switch off")
    assert shown[reason + 3].endswith("switch not seen")


def test_many_rows_and_events_are_drawn_seldom_and_the_last_of_them_at_the_end() -> None:
    """Drawing holds up the points: fifty rows are drawn every 1.25 s, events along with them."""
    drawings: list[str] = []
    console = Console(file=io.StringIO(), force_terminal=True, width=200, height=80, **XTERM)
    view = LiveView(console)
    many = [row(system_id=number) for number in range(2, 52)]
    for tenth in range(26):
        console.file = io.StringIO()
        view.rows(tenth / 10, many)
        view.event(tenth / 10, f"event {tenth}")
        drawings += [console.file.getvalue()] if console.file.getvalue() else []
    assert len(drawings) == 2
    console.file = io.StringIO()
    view.close()
    assert "event 25" in console.file.getvalue()


def test_the_picture_of_the_view_asks_nobody_for_fonts_and_knows_no_paths() -> None:
    svg = drawn([row(), row(system_id=3)], ["    1.0 s  follower 2: in Guided, following"])
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert "in&#160;Guided" in svg
    assert "+0.21" in svg
    assert "font-face" not in svg
    assert "url(http" not in svg
    assert str(Path.cwd()) not in svg


def test_the_picture_is_taken_once_all_have_been_in_place_for_a_while() -> None:
    stop = StopRequest()
    photographer = Photographer(stop)
    there, away = row(error_m=0.2), row(error_m=2.0)
    photographer.event(0.5, "in Guided")
    for second in range(60):
        photographer.rows(float(second), [there, away if second < 20 else there])
        assert stop() is (second >= 20 + SETTLED_S)
    photographer.event(70.0, "the tool ends")
    assert photographer.taken == [there, there]
    assert photographer.events == ["    0.5 s  in Guided"]


def test_plain_lines_come_now_and_then_and_events_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    view = PlainView()
    for tenth in range(round(2 * PLAIN_PERIOD_S * 10)):
        view.rows(tenth / 10, [row(link_percent=None, leader=LEADERS)])
    view.event(10.0, "stands")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert "leader: GUIDED, 12.3 m up, GPS 3D 14, battery 77 % 11.9 V" in lines[0]
    assert "separation 3.21 m (+0.21 m)" in lines[1]
    assert "link -, GPS not known, battery not known, clock not known" in lines[1]
    assert lines[4].endswith("stands")


def test_before_the_first_report_a_row_says_just_that() -> None:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 10.0, sonar=shipped_sonar())
    session = FollowSession(LEADER, [plan], GuidanceSettings())
    (silent,) = Panel([LEADER, FOLLOWER]).rows(session, 1.0)
    assert plain_row(silent) == "follower 2: no report yet"
    assert "?" not in "".join(lines_of([silent], 80))


def test_json_lines_are_objects(capsys: pytest.CaptureFixture[str]) -> None:
    view = JsonView()
    view.event(0.5, "in Guided")
    view.rows(1.0, [row(separation_m=math.pi)])
    event, shown = map(json.loads, capsys.readouterr().out.splitlines())
    assert event == {"time_s": 0.5, "event": "in Guided"}
    assert shown["separation_m"] == 3.142


# ---- what is written --------------------------------------------------------------------------


def placed(lat_deg: float = 39.1234567) -> Track:
    unknown: dict[str, Any] = {column.name: None for column in fields(Track)}
    speeds = {"north_mps": 1.2344, "east_mps": 0.0, "heading_deg": 12.0}
    wanted = {"wanted_radius_m": 3.0, "wanted_angle_deg": 0.0, "wanted_step_m": 0.0}
    return Track(**{**unknown, **speeds, **wanted, "lat_deg": lat_deg})


def test_logs_are_on_the_disk_after_every_row(tmp_path: Path) -> None:
    said: list[str] = []
    log = FollowLog(tmp_path / "new" / "folder", 1_767_225_600.0, said.append)
    log.frame(1_767_225_601.5, b"\xfdframe")
    log.rows(1_767_225_601.6, [row()], [placed()])

    folder = tmp_path / "new" / "folder"
    stamped = (folder / "follow-20260101-000000.tlog").read_bytes()
    assert stamped == (1_767_225_601_500_000).to_bytes(8, "big") + b"\xfdframe"
    header, line = (folder / "follow-20260101-000000.csv").read_text().splitlines()
    written = dict(zip(header.split(","), line.split(","), strict=True))
    assert written["separation_m"] == "3.214"
    assert (written["lat_deg"], written["north_mps"]) == ("39.1234567", "1.234")
    assert written["leader_lat_deg"] == ""
    log.close()
    assert said == []


def test_a_log_that_cannot_be_begun_is_refused_before_anything_moves(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    with pytest.raises(EchowingError, match=r"file: cannot be written: .* another folder"):
        FollowLog(blocked, 0.0, print)
