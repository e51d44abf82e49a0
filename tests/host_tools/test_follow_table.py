"""The table of `echowing follow --log`, written by the tool's own code and analysed."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.logs import read_flights
from echowing.analysis.metrics import metrics
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowSession
from echowing.geo import GlobalPosition, displace
from echowing.sonar_file import shipped_sonar
from echowing.tool.log import FollowLog
from echowing.tool.panel import Panel
from echowing.tool.track import track

LEADER, FOLLOWER, SECOND = 1, 2, 3
HERE = GlobalPosition(39.34, -86.03, 260.0)
SPEED_MPS = 2.0
START_UNIX_S = 1_800_000_000.0
TICK_S = 0.1


def say(session: FollowSession, panel: Panel, system_id: int, message: Any, now_s: float) -> None:
    packed = message.pack(mavlink.MAVLink(None, system_id, 1))
    received = mavlink.MAVLink(None).decode(bytearray(packed))
    session.receive(received, now_s)
    panel.receive(received, now_s)


def position(north_m: float, boot_s: float) -> Any:
    at = displace(HERE, (north_m, 0.0, 0.0))
    return mavlink.MAVLink_global_position_int_message(
        *(round(boot_s * 1e3), round(at.lat_deg * 1e7), round(at.lon_deg * 1e7)),
        *(round(at.alt_m * 1e3), 10_000, round(SPEED_MPS * 100), 0, 0, 0),
    )


def named(name: str, value: float) -> Any:
    return mavlink.MAVLink_named_value_float_message(0, name.encode(), value)


def write(
    folder: Path,
    *,
    radius_m: float = 4.0,
    angle_deg: float = 0.0,
    behind_m: Callable[[float], float] = lambda now_s: 3.5,
    pilots: tuple[float, float] = (math.inf, math.inf),
    followers: tuple[int, ...] = (FOLLOWER,),
    changed: tuple[float, float] = (math.inf, 0.0),
    learn_offset: bool = False,
    chained: bool = False,
) -> Path:
    """20 s of a leader flying north at 2 m/s; between `pilots` the followers are in Loiter.

    changed: from when on the radius is another, and which. chained: each but the first is behind
    the one before it, and as far from it as that one is from the leader.
    """
    slot = Slot(radius_m, math.radians(angle_deg))
    slots = [replace(slot, behind=n - 1 if chained and n else None) for n in range(len(followers))]
    plans = [
        FollowerPlan(one, its, 10.0, sonar=shipped_sonar())
        for one, its in zip(followers, slots, strict=True)
    ]
    # A relay, radius 0, has no bar.
    settings = GuidanceSettings(
        tow_bar=radius_m > 0.0, learn_offset=learn_offset, feed_forward=False
    )
    session = FollowSession(LEADER, plans, settings)
    panel = Panel([LEADER, *followers])
    log = FollowLog(folder, START_UNIX_S, pytest.fail)
    for tick in range(200):
        now_s = tick * TICK_S
        mode = 5 if pilots[0] <= now_s < pilots[1] else 4
        if now_s >= changed[0]:
            for plan in plans:
                plan.slot = Slot(changed[1])
        if tick % 5 == 0:  # the leader at 2 Hz: its reports are up to half a second old
            say(session, panel, LEADER, position(SPEED_MPS * now_s, now_s + 9.0), now_s)
        for one in followers:
            say(
                session, panel, one, mavlink.MAVLink_heartbeat_message(2, 3, 129, mode, 4, 3), now_s
            )
            place = followers.index(one) + 1 if chained else 1
            at_m = SPEED_MPS * now_s - place * behind_m(now_s)
            say(session, panel, one, position(at_m, now_s + 5.0), now_s)
            say(session, panel, one, named("SNR_PAN", 1_480.0), now_s)
            say(session, panel, one, named("SNR_STATE", 2.0), now_s)
            say(session, panel, one, named("ECHO_SPD", 2.5), now_s)
        session.tick(now_s)
        # 50 ms after the reports, as in the field: what they say is carried on.
        later_s = now_s + TICK_S / 2.0
        everybody = session.followers.values()
        tracks = [track(session, follower, panel, later_s) for follower in everybody]
        log.rows(START_UNIX_S + later_s, panel.rows(session, later_s), tracks)
    log.close()
    (table,) = folder.glob("*.csv")
    return table


def test_a_follower_behind_another_is_measured_from_that_one(tmp_path: Path) -> None:
    """3.5 m behind the one ahead, 7 m behind the leader."""
    table = write(tmp_path, followers=(FOLLOWER, SECOND), chained=True)
    first, second = read_flights([table])
    for flight in (first, second):
        assert metrics(flight).mean_separation_m == pytest.approx(3.5, abs=0.03)
        assert flight.wanted_separation_m == 4.0
        assert np.median(flight.leader_velocity_mps[:, 0]) == pytest.approx(SPEED_MPS)
    assert np.abs(second.leader_ned_m - first.follower_ned_m).max() < 0.01


def test_a_table_says_how_far_the_receivers_are_found_to_wander(tmp_path: Path) -> None:
    """Nothing was heard, so it is what is believed beforehand (`flight.receivers`)."""
    with write(tmp_path, learn_offset=True).open(encoding="utf-8", newline="") as file:
        last = list(csv.DictReader(file))[-1]

    assert float(last["wander_m"]) == pytest.approx(1.21, abs=0.01)
    assert float(last["forgets_s"]) == pytest.approx(0.8 * 90.0 + 0.2 * 25.0)


def test_a_table_gives_the_separation_that_was_flown(tmp_path: Path) -> None:
    table = write(tmp_path)
    (flight,) = read_flights([table])
    # Both are carried on to the same moment, so 1 cm is the resolution of their positions.
    assert flight.separation_m == pytest.approx(3.5, abs=0.02)
    assert flight.wanted_separation_m == 4.0
    assert metrics(flight).mean_abs_error_m == pytest.approx(0.5, abs=0.02)
    assert flight.slot_ned_m[:, 0] == pytest.approx(flight.leader_ned_m[:, 0] - 4.0, abs=1e-6)
    assert flight.start_unix_s == pytest.approx(START_UNIX_S + 0.05)
    assert np.diff(flight.time_s) == pytest.approx(TICK_S, abs=0.002)
    assert flight.follower_velocity_mps[:, 0] == pytest.approx(SPEED_MPS)
    assert flight.speed_command_mps == pytest.approx(2.5)
    assert flight.pan_us == pytest.approx(1_480.0)
    assert np.isnan(flight.tilt_us).all()
    assert flight.sonar_known
    assert np.isnan(flight.sonar_m).all()
    assert flight.warnings == ()


def test_the_wanted_place_may_be_given_and_else_is_the_one_flown(tmp_path: Path) -> None:
    table = write(tmp_path, angle_deg=90.0)
    (told,) = read_flights([table])
    assert told.wanted_angle_rad == pytest.approx(math.pi / 2.0)
    # 90 degrees off the tail is on the leader's right (guidance.Slot).
    assert told.slot_ned_m[:, 1] == pytest.approx(4.0, abs=1e-6)
    (given,) = read_flights([table], slot=Slot(5.0))
    assert (given.wanted_separation_m, given.wanted_angle_rad) == (5.0, 0.0)


def test_of_a_radius_that_was_changed_in_flight_the_longest_is_measured(tmp_path: Path) -> None:
    (flight,) = read_flights([write(tmp_path, radius_m=8.0, changed=(6.0, 4.0))])
    assert flight.wanted_separation_m == 4.0
    assert flight.time_s[-1] == pytest.approx(13.9, abs=0.2)
    assert flight.separation_m - flight.wanted_separation_m == pytest.approx(-0.5, abs=0.02)
    assert flight.warnings == ("the radius was changed in flight; the 14 s at 4.0 m are used",)


def test_a_folder_is_its_tables_and_each_follower_a_flight(tmp_path: Path) -> None:
    table = write(tmp_path, followers=(FOLLOWER, SECOND))
    (tmp_path / "notes.txt").write_text("windy")
    first, second = read_flights([tmp_path])
    assert (first.name, second.name) == (f"{table.name}, system 2", f"{table.name}, system 3")


def test_time_in_the_pilots_hands_is_told_and_what_lies_outside_is_left_out(tmp_path: Path) -> None:
    (flight,) = read_flights([write(tmp_path / "between", pilots=(5.0, 8.0))])
    assert flight.time_s[-1] == pytest.approx(19.9, abs=0.3)
    assert flight.left_out == ("3 s flown by its pilot",)
    (cut,) = read_flights([write(tmp_path / "after", pilots=(10.0, math.inf))])
    assert cut.time_s[-1] == pytest.approx(9.9, abs=0.2)
    assert cut.warnings == ()


def change(table: Path, rows: range, **cells: str) -> None:
    """Other cells in some rows of a table."""
    with table.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        lines = list(reader)
    for number in rows:
        lines[number] |= cells
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, reader.fieldnames or ())
        writer.writeheader()
        writer.writerows(lines)


def test_holds_and_giving_way_are_named_and_count_for_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are flown elsewhere on purpose: 4.0 m are wanted, 3.5 m are flown, 9 m while held."""
    table = write(tmp_path, behind_m=lambda now_s: 9.0 if 10.0 <= now_s < 15.0 else 3.5)
    change(table, range(98, 122), state="holding: stop switch")
    change(table, range(122, 152), state="gives way to leader")
    (flight,) = read_flights([table])
    assert flight.left_out == ("2 s holding", "3 s giving way")
    assert flight.warnings == ()
    assert len(flight.time_s) == 200  # all of it is drawn
    assert metrics(flight).max_separation_m < 4.0
    assert main(["analyze", str(tmp_path), "--settle", "0"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "mean error 0.50 m, RMSD 0.50 m by GPS; left out: 2 s holding, 3 s giving way" in said


def test_the_most_certain_source_leads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Receivers that agree on 3.5 m where it is 3.9 m, as the sonar says: 3.7 m and the inset."""

    def leads() -> tuple[str, str]:
        assert main(["analyze", str(tmp_path), "--settle", "0", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["by_gps"]["mean_separation_m"] == pytest.approx(3.5, abs=0.02)
        return told["source"], f"{told['mean_separation_m']:.1f} m"

    def warnings() -> list[str]:
        (flight,) = read_flights([tmp_path])
        return list(flight.warnings)

    table = write(tmp_path)
    assert leads()[0] == "by GPS"
    change(table, range(200), north_offset_m="-0.3", east_offset_m="0.0")
    assert leads() == ("by estimate", "3.8 m")
    change(table, range(60), sonar_m="3.7")  # a third of the flight
    assert leads()[0] == "by estimate"
    change(table, range(150), sonar_m="3.7")
    assert leads() == ("by sonar", "3.9 m")
    assert warnings() == []
    change(table, range(200), sonar_inset_m="")  # of a former version
    assert leads() == ("by sonar", "3.9 m")
    assert warnings() == ["the sonar's inset is not told; 0.2 m is taken, as mb1202's"]
    change(table, range(200), sonar_inset_m="0.45")  # of the mount that was flown
    assert leads() == ("by sonar", "4.2 m")  # 4.15 m
    assert warnings() == []


def test_a_table_that_only_watched_says_so(tmp_path: Path) -> None:
    (flight,) = read_flights([write(tmp_path, pilots=(-1.0, math.inf))])
    assert flight.warnings == ("never followed; all of the log is used",)  # the flight has a name


def test_a_table_cut_off_in_a_row_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    table = write(tmp_path)
    table.write_bytes(table.read_bytes()[:-60])
    (flight,) = read_flights([table])
    assert len(flight.time_s) == 199
    assert "damaged or cut off" in flight.warnings[0]


def test_the_command_prints_the_table_and_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path)
    assert main(["analyze", str(tmp_path), "--out", str(tmp_path)]) == 0
    assert "3.50" in capsys.readouterr().out
    assert (tmp_path / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "not a table of echowing follow --log: no column unix_time_s"),
        ("", "not a table of echowing follow"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "follow-x.csv"
    path.write_text(text)
    with pytest.raises(EchowingError, match=said):
        read_flights([path])


def test_tables_without_a_flight_in_them_are_refused(tmp_path: Path) -> None:
    table = write(tmp_path)
    whole = table.read_text()
    table.write_text(whole.splitlines()[0] + "\n")
    with pytest.raises(EchowingError, match="holds no rows"):
        read_flights([table])
    table.write_text(whole.replace("1800000000.05", "noon"))
    with pytest.raises(EchowingError, match="column unix_time_s"):
        read_flights([table])
    with pytest.raises(EchowingError, match="of a relay"):
        read_flights([write(tmp_path / "relay", radius_m=0.0)])
    (tmp_path / "empty").mkdir()
    with pytest.raises(EchowingError, match="a folder without"):
        read_flights([tmp_path / "empty"])
