"""Recorded flights as moments, and a browser's time line through them."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from echowing.analysis.logs import read_flights
from echowing.commands import replay
from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.sonar_file import FlownBy, load_sonar, shipped_sonar
from echowing.tool.log import FollowLog
from echowing.tool.panel import VehicleHealth
from echowing.web.recording import TableRecording, index_at, open_recording
from echowing.web.replay import ReplayFeed, TimeLine
from echowing.web.snapshot import snapshot

from .flights import HERE, row, track

SONAR = shipped_sonar()
DATA = Path(__file__).parent / "data"
START_UNIX_S = 1_790_000_000.0
FROM_S, TO_S = 10.0, 110.0


def logged(folder: Path, moments: int = 20, flown_by: FlownBy | None = None) -> Path:
    """What `follow` writes of two followers, 10 Hz; its CSV."""
    log = FollowLog(folder, START_UNIX_S, print, flown_by)
    for tenth in range(moments):
        time_s = 0.5 + tenth / 10.0
        rows = [
            row(2, time_s=time_s, sonar_m=None),
            row(
                3,
                time_s=time_s,
                state="pilot has control",
                leader=VehicleHealth(mode="GUIDED, not flying"),
            ),
        ]
        tracks = [track(-3.0 + time_s), track(-6.0)]
        log.rows(START_UNIX_S + time_s, rows, tracks)
    log.event(START_UNIX_S + 0.75, "follower 2:\ngives way")
    log.close()
    return next(folder.glob("*.csv"))


def test_it_is_shown_by_the_sonar_file_that_was_flown(tmp_path: Path) -> None:
    def believed(*options: str) -> SonarBelief:
        parser = argparse.ArgumentParser()
        replay.add_arguments(parser)
        return replay._sonar(parser.parse_args([str(tmp_path), *options]))

    assert believed() == SONAR
    lidar = load_sonar("lidar")
    logged(tmp_path, flown_by=FlownBy("gone.toml", lidar, "stock"))
    assert believed() == lidar.belief("stock")
    assert believed("--sonar", "mb1202") == SONAR


def test_what_was_logged_is_what_is_replayed(tmp_path: Path) -> None:
    logged(tmp_path)
    recording = open_recording([tmp_path], SONAR)
    assert len(recording.times_s) == 20
    assert recording.times_s[3] == pytest.approx(0.8)
    ((time_s, text),) = recording.events
    assert time_s == pytest.approx(0.75, abs=1e-3)
    assert text == "follower 2: gives way"
    moment = recording.moment(3)
    assert [one.system_id for one in moment.rows] == [2, 3]
    assert moment.rows[0] == row(2, time_s=0.8, sonar_m=None)
    assert moment.rows[1].state == "pilot has control"
    assert moment.rows[1].leader == VehicleHealth(mode="GUIDED, not flying")
    # To the 1e-7 deg of the log.
    frame = snapshot(moment, HERE)
    assert frame["followers"][0]["at"] == pytest.approx([-2.2, 0.0], abs=0.02)
    assert frame["leader"]["battery"] == "70 %"
    assert frame["health"]["alone"] == []  # both are near the leader or one another


def test_a_table_that_was_cut_off_ends_before_that(tmp_path: Path) -> None:
    table = logged(tmp_path)
    whole = table.read_bytes()
    table.write_bytes(whole[: -len(whole.splitlines()[-1]) // 2])
    recording = TableRecording(table, SONAR)
    last = recording.moment(len(recording.times_s) - 1)
    assert [one.system_id for one in last.rows] == [2]  # the other's line is the cut one
    assert recording.times_s[-1] == pytest.approx(2.4)


def test_a_table_of_a_former_version_is_shown_without_what_it_lacks(tmp_path: Path) -> None:
    table = logged(tmp_path)
    table.with_suffix(".txt").unlink()
    lines = table.read_text(encoding="utf-8").splitlines()
    columns = lines[0].split(",")
    kept = columns.index("leader_id")
    cut = [",".join(line.split(",")[:kept]) for line in lines]
    table.write_text("\n".join(cut) + "\n", encoding="utf-8")
    recording = open_recording([table], SONAR)
    frame = snapshot(recording.moment(0), HERE)
    assert recording.events == []
    assert frame["followers"][0]["seen"] is None
    assert frame["followers"][0]["separation"] == 3.0


def test_a_damaged_moment_is_said_and_the_rest_is_shown(tmp_path: Path) -> None:
    table = logged(tmp_path)
    lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
    lines[5] = lines[5].replace(",3.0,", ",three,", 1)
    table.write_text("".join(lines), encoding="utf-8")
    feed = ReplayFeed(open_recording([table], SONAR))
    frames = [feed._frame(index) for index in range(4)]
    assert [frame is None for frame in frames] == [False, False, True, False]
    assert feed._damaged[2].endswith("damaged at 0.7 s: could not convert string to float: 'three'")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a,b\n1,2\n", "not a table of echowing follow --log"),
        ("", "not a table of echowing follow --log"),
        ("unix_time_s,time_s,system_id\n", "holds no rows"),
        ("unix_time_s,time_s,system_id\n1,x,2\n", "'x' is not a time"),
    ],
)
def test_what_is_no_log_is_refused(content: str, words: str, tmp_path: Path) -> None:
    table = tmp_path / "follow-1.csv"
    table.write_text(content, encoding="utf-8")
    with pytest.raises(EchowingError, match=words):
        open_recording([tmp_path], SONAR)


def test_two_flights_are_not_mixed(tmp_path: Path) -> None:
    for name in ("follow-1.csv", "follow-2.csv"):
        (tmp_path / name).touch()
    with pytest.raises(EchowingError, match=r"2 flights \(.*follow-2.csv\): give one"):
        open_recording([tmp_path], SONAR)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="cannot be read"):
        open_recording([tmp_path / "follow-1.csv"], SONAR)
    with pytest.raises(EchowingError, match="a folder without"):
        open_recording([tmp_path], SONAR)


def test_a_range_beyond_the_sonars_reach_is_none_in_a_replay() -> None:
    """How far that is, the file says of the sonar that was flown."""
    paths = [DATA / "leader.BIN", DATA / "follower.BIN"]

    def longest_m(reach_m: float) -> float:
        recording = open_recording(paths, replace(SONAR, reach_m=reach_m))
        rows = (recording.moment(at).rows[0] for at in range(0, len(recording.times_s), 20))
        return max((row.sonar_m for row in rows if row.sonar_m is not None), default=0.0)

    assert longest_m(2.9) < 2.9 < longest_m(3.4) < 3.4 < longest_m(4.5)


def test_vehicles_own_logs_are_replayed_as_they_are_analysed() -> None:
    paths = [DATA / "leader.BIN", DATA / "follower.BIN"]
    recording = open_recording(paths, SONAR)
    (flight,) = read_flights(paths)
    assert list(recording.times_s) == flight.time_s.tolist()
    middle = len(recording.times_s) // 2
    moment = recording.moment(middle)
    assert moment.rows[0].separation_m == pytest.approx(float(flight.separation_m[middle]))
    frame = snapshot(moment, moment.origin or HERE)
    leader, follower = frame["leader"]["at"], frame["followers"][0]["at"]
    apart_m = [a - b for a, b in zip(follower, leader, strict=True)]
    expected_m = flight.follower_ned_m[middle] - flight.leader_ned_m[middle]
    # Nothing carries them on: these are places of one moment.
    assert apart_m == pytest.approx(expected_m[:2].tolist(), abs=0.02)


def test_the_moment_of_a_time() -> None:
    times_s = [1.0, 1.1, 1.2]
    assert [index_at(times_s, time_s) for time_s in (0.0, 1.0, 1.15, 9.0)] == [0, 0, 1, 2]


# ---- the time line ----------------------------------------------------------------------------


def line() -> TimeLine:
    made = TimeLine(FROM_S, TO_S)
    made.begin(1000.0)
    return made


def test_it_plays_at_any_speed_and_stays_at_the_end() -> None:
    one = line()
    assert one.place_s(1002.0) == 12.0
    one.wish({"speed": 10}, 1002.0)
    assert one.place_s(1003.0) == 22.0  # no jump at the change
    assert one.place_s(2000.0) == TO_S


def test_it_is_paused_and_goes_on_where_it_was() -> None:
    one = line()
    one.wish({"paused": True}, 1005.0)
    assert one.place_s(1999.0) == 15.0
    one.wish({"paused": False}, 2000.0)
    assert one.place_s(2001.0) == 16.0


def test_it_goes_to_a_place_within_the_flight() -> None:
    one = line()
    assert one.wish({"seek": 50.0}, 1001.0)
    assert one.place_s(1002.0) == 51.0
    one.wish({"seek": 999.0}, 1002.0)
    assert one.place_s(1003.0) == TO_S
    one.wish({"seek": -5}, 1003.0)
    assert one.place_s(1003.0) == FROM_S


def test_play_at_the_end_plays_once_more() -> None:
    one = line()
    one.wish({"paused": True}, 5000.0)
    assert one.wish({"paused": False}, 5001.0)
    assert one.place_s(5001.0) == FROM_S


@pytest.mark.parametrize(
    "wish",
    [None, 3, "x", [], {}, {"speed": "fast"}, {"seek": None}, {"paused": 1}, {"speed": True}],
)
def test_what_is_no_wish_changes_nothing(wish: Any) -> None:
    one = line()
    assert not one.wish(wish, 1001.0)
    assert (one.speed, one.paused, one.place_s(1002.0)) == (1.0, False, 12.0)


def test_no_speed_is_too_much() -> None:
    one = line()
    one.wish({"speed": float("nan")}, 1001.0)
    assert one.speed == 1.0
    one.wish({"speed": -4}, 1001.0)
    assert one.speed == pytest.approx(0.01)
    one.wish({"speed": 1e9}, 1001.0)
    assert one.speed == pytest.approx(1000.0)
