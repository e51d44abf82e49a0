"""Drawing, flying over workers, keeping, shrinking, reporting: the campaign around its flights."""

import json
import math
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from echowing.campaign import workers
from echowing.campaign.draw import draw, flight_seed, load_description, parse_description
from echowing.campaign.files import ROWS, Folder
from echowing.campaign.fly import fly_and_judge, fly_one
from echowing.campaign.properties import Broken, judge
from echowing.campaign.record import fly_recorded
from echowing.campaign.report import write_report
from echowing.campaign.run import finds_of, shrunk_file, write_find_page
from echowing.campaign.shrink import shrink, table_of
from echowing.campaign.workers import WorkersDied, connected, done_by_workers
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.guidance import Slot
from echowing.flight.shapes import SHAPES, shape
from echowing.sim.aircraft import SimFollower
from echowing.sim.scenario import GpsSection, Scenario, load_scenario, scenario_of
from echowing.sim.summary import fly

pytestmark = pytest.mark.seconds(50)

SHORT = """
title = "short flights for tests"
[flight]
duration_s = { uniform = [4.0, 6.0] }
[flight.gps]
sigma_m = { uniform = [0.2, 0.8] }
[formation]
followers = { weighted = { 1 = 3, 2 = 1 } }
spacing_m = 5.0
[[fault]]
share = 0.5
kind = "outage"
vehicle = "leader"
at_s = { uniform = [1.0, 3.0] }
"""


def short(folder: Path, text: str = SHORT) -> str:
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


# ---- drawing ------------------------------------------------------------------------------------


def test_the_shipped_description_draws_every_kind_of_fault_and_every_number_of_followers() -> None:
    drawn = drawn_fields()

    kinds = set(load_description().kinds)
    assert {fault.kind for one in drawn for fault in one.fault} == kinds
    assert {len(one.formation.slots) for one in drawn} == {1, 2, 3, 4}
    assert {one.follower.generation for one in drawn} == {"4.5", "4.6", "4.7", "4.8"}
    assert max(len(one.fault) for one in drawn) >= 3
    speeds = [one.leader.speed_mps for one in drawn]
    assert min(speeds) < 1.0
    assert max(speeds) > 4.5


@pytest.mark.parametrize(
    ("section", "key", "span", "in_share"),
    [
        ("gps", "sigma_m", (0.3, 1.5), 1.0),
        ("gps", "tau_s", (20.0, 120.0), 1.0),
        ("gps", "vertical_sigma_m", (0.2, 1.0), 1.0),
        ("gps", "step_m", (0.5, 3.0), 0.2),
        ("gps", "multipath_m", (0.1, 0.6), 0.3),
        ("sonar", "heard_share", (0.4, 1.0), 0.25),
        ("sonar", "deaf_share", (0.05, 0.35), 0.2),
        ("sonar", "beam_near_deg", (10.0, 25.0), 0.2),
        ("sonar", "beam_far_deg", (6.0, 18.0), 0.2),
        ("sonar", "noise_m", (0.005, 0.06), 0.2),
        ("sonar", "wild_share", (0.0, 0.06), 0.2),
        ("sonar", "tone_share", (0.02, 0.2), 0.1),
        ("sonar", "late_share", (0.0, 0.04), 0.08),
        ("sonar", "heard_to_m", (2.6, 5.0), 0.1),
        ("sonar", "inset_m", (0.1, 0.35), 0.1),
    ],
)
def test_the_field_draws_sonars_and_receivers_within_their_spans(
    section: str, key: str, span: tuple[float, float], in_share: float
) -> None:
    values = [getattr(getattr(one, section), key) for one in drawn_fields()]
    found = [one for one in values if one]

    # Of 300 flights, each half of a span has some, and the share is known to 0.03.
    assert len(found) / len(values) == pytest.approx(in_share, abs=0.08)
    assert span[0] <= min(found) < sum(span) / 2.0 < max(found) <= span[1]


def test_the_field_draws_who_flies_by_a_receivers_height_and_how_wrong_that_is() -> None:
    given = [one.gps.receiver_vertical_sigma_m for one in drawn_fields()]
    drawn = [one for one in given if one != GpsSection().receiver_vertical_sigma_m]
    by_receiver = [one for one in drawn_fields() if one.follower.parameters]

    assert len(drawn) / len(given) == pytest.approx(0.15, abs=0.07)
    assert 0.8 <= min(drawn) < 1.0
    assert 2.4 < max(drawn) <= 3.0
    assert len(by_receiver) / len(given) == pytest.approx(0.08, abs=0.05)
    assert all(one.follower.parameters == {"EK3_SRC1_POSZ": 3.0} for one in by_receiver)


@pytest.mark.parametrize(
    ("key", "span", "in_share"), [("step_m", (0.5, 3.0), 0.2), ("multipath_m", (0.1, 0.6), 0.3)]
)
def test_receivers_of_formations_step_and_have_multipath(
    key: str, span: tuple[float, float], in_share: float
) -> None:
    values = [getattr(one.gps, key) for one in drawn_formations()]
    found = [one for one in values if one]

    assert len(found) / len(values) == pytest.approx(in_share, abs=0.09)
    assert span[0] <= min(found) < sum(span) / 2.0 < max(found) <= span[1]


@cache
def drawn_fields() -> list[Scenario]:
    description = load_description()
    return [draw(description, 1, index) for index in range(300)]


@cache
def drawn_formations() -> list[Scenario]:
    description = load_description("formations")
    return [draw(description, 1, index) for index in range(200)]


def test_formations_are_drawn_as_they_are_flown_by_name() -> None:
    drawn = drawn_formations()
    assert {len(one.formation.slots) for one in drawn} == {2, 3, 4}
    assert {one.formation.close_gaps for one in drawn} == {True, False}
    shapes = {
        tuple((round(slot.angle_deg), slot.behind) for slot in one.formation.slots)
        for one in drawn
        if len(one.formation.slots) == 3
    }
    assert shapes == {
        tuple(
            (round(math.degrees(slot.angle_rad)), behind_of(slot)) for slot in shape(name, 3, 3.0)
        )
        for name in SHAPES
    }
    spacings_m = [one.formation.slots[0].radius_m for one in drawn]
    assert 3.0 <= min(spacings_m) < 3.2
    assert 3.8 < max(spacings_m) <= 4.0


def test_sonars_of_formations_are_drawn_as_those_of_the_field() -> None:
    drawn = [one.sonar for one in drawn_formations()]
    assert drawn == [one.sonar for one in drawn_fields()[: len(drawn)]]


def behind_of(slot: Slot) -> int | None:
    return None if slot.behind is None else slot.behind + 1


def test_a_flight_is_drawn_the_same_wherever_it_is_drawn() -> None:
    description = load_description()

    assert draw(description, 1, 17) == draw(load_description(), 1, 17)
    assert draw(description, 1, 17) != draw(description, 2, 17)
    assert flight_seed(1, 17) != flight_seed(1, 18)


def test_a_value_that_is_added_changes_no_other() -> None:
    more = SHORT.replace("[flight.gps]", "[flight.wind]\nspeed_mps = 1.0\n[flight.gps]")
    one, other = (draw(parse_description(text, "test"), 1, 5) for text in (SHORT, more))

    assert other.gps == one.gps
    assert other.fault == one.fault
    assert (one.wind.speed_mps, other.wind.speed_mps) == (0.0, 1.0)


def test_distributions_give_what_they_say() -> None:
    text = """
[flight.gps]
sigma_m = { one_of = [0.1, 0.2] }
tau_s = { log_uniform = [10.0, 1000.0] }
[flight.wind]
speed_mps = { share = 0.25, then = 5.0, else = 1.0 }
direction_deg = { normal = [90.0, 10.0] }
[flight.leader]
path = { weighted = { circle = 3, rectangle = 1 } }
"""
    description = parse_description(text, "test")
    drawn = [draw(description, 1, index) for index in range(400)]

    assert {one.gps.sigma_m for one in drawn} == {0.1, 0.2}
    # 400 draws: 25 % is 100 with a deviation of 9, 75 % is 300.
    assert 70 < sum(one.wind.speed_mps == 5.0 for one in drawn) < 130
    assert 260 < sum(one.leader.path == "circle" for one in drawn) < 340
    assert np.median([one.gps.tau_s for one in drawn]) == pytest.approx(100.0, rel=0.3)
    assert np.mean([one.wind.direction_deg for one in drawn]) == pytest.approx(90.0, abs=2.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "[flight]\nduration_s = { uniform = [5.0] }",
            r"flight\.duration_s: uniform = \[5\.0\] is",
        ),
        ("[flight]\nduration_s = { uniform = [1.0, 2.0], one_of = [1] }", "beside uniform: remove"),
        ("[flight.gps]\nsigma = 1.0", r"gps\.sigma: no such key; allowed here: .* sigma_m"),
        ("[flights]\nx = 1", "flights: no such key"),
        (
            "[formation]\nshape = 'ring'",
            "formation.shape: one of column, vee, echelon, abreast, diamond, wedge, not ring",
        ),
        ("[flight]\nsonar = 'sea'", "flight.sonar: field or many or formations, not 'sea'"),
        ("[formation]\nsize = 2", "formation.size: no such key"),
        ("[[fault]]\nkind = 'sonar_dead'", r"needs `kind` and `share`"),
        ("[[fault]]\nshare = 0.001\nkind = 'sonar_deaf'\nvehicle = 'follower'", "'sonar_dead'"),
        ("[[fault]]\nshare = 1.0\nkind = 'sonar_dead'", "sonar_dead needs `vehicle`"),
        ("[flight", "not valid TOML"),
    ],
)
def test_a_description_that_makes_no_sense_is_refused_before_anything_flies(
    text: str, says: str
) -> None:
    with pytest.raises(EchowingError, match=says):
        parse_description(text, "mine.toml")


def test_an_unknown_description_and_a_missing_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="no description 'sea'"):
        load_description("sea")
    with pytest.raises(EchowingError, match=r"absent\.toml: cannot read"):
        load_description(str(tmp_path / "absent.toml"))


# ---- workers ------------------------------------------------------------------------------------


def slow_square() -> Callable[[str, int], int]:
    """A call that goes to the workers whole: they cannot import a test."""

    def call(folder: str, number: int) -> int:
        """The first try of number 5 kills its worker."""
        time.sleep(0.05)
        marker = Path(folder) / f"tried-{number}"
        if number == 5 and not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number * number

    return call


def always_dies() -> Callable[[None, int], int]:
    def call(_: None, number: int) -> int:
        if number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    return call


def test_a_worker_that_is_killed_loses_no_call_and_counts_none_twice(tmp_path: Path) -> None:
    with connected(2, None) as client:
        done = list(done_by_workers(client, slow_square(), str(tmp_path), range(20)))

    assert (tmp_path / "tried-5").exists()
    assert sorted(done) == [(number, number * number) for number in range(20)]


def test_a_call_that_kills_every_worker_is_told_and_the_others_are_done() -> None:
    with connected(1, None) as client:
        done = dict(done_by_workers(client, always_dies(), None, range(4)))

    assert isinstance(done.pop(1), WorkersDied)
    assert done == {0: 0, 2: 2, 3: 3}


def test_stopping_ends_soon_and_keeps_what_is_done(tmp_path: Path) -> None:
    done: list[int] = []
    with connected(1, None) as client:
        work = done_by_workers(
            client, slow_square(), str(tmp_path), range(1000, 2000), lambda: len(done) >= 5
        )
        for key, _ in work:
            done.append(key)

    assert len(done) == 5


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "CONNECT_S", 0.5)  # nobody listens there: no answer will come
    with (
        pytest.raises(EchowingError, match=r"tcp://127\.0\.0\.1:1: no Dask scheduler answers"),
        connected(1, "tcp://127.0.0.1:1"),
    ):
        pass


# ---- the verb -----------------------------------------------------------------------------------


def campaign(folder: Path, out: str, *options: str) -> int:
    return main(["campaign", short(folder), "--out", str(folder / out), "--json", *options])


def rows(folder: Path, out: str) -> list[Any]:
    text = (folder / out / ROWS).read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five flights by one worker."""
    folder = tmp_path_factory.mktemp("campaign")
    assert campaign(folder, "one", "--flights", "5", "--workers", "1") == 0
    return folder


def test_the_result_does_not_depend_on_the_number_of_workers(flown: Path) -> None:
    assert campaign(flown, "two", "--flights", "5", "--workers", "2") == 0

    one, two = ((flown / name / ROWS).read_bytes() for name in ("one", "two"))
    assert one == two


def test_a_row_is_what_the_flight_alone_gives(flown: Path) -> None:
    description = load_description(short(flown))

    assert rows(flown, "one")[3] == json.loads(json.dumps(fly_one(description, 1, 3)))


def test_a_campaign_is_gone_on_with_where_it_was_cut_off(
    flown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (flown / "one" / ROWS).read_text(encoding="utf-8")
    lines = whole.splitlines(keepends=True)
    cut = flown / "cut"
    cut.mkdir()
    (cut / "campaign.json").write_bytes((flown / "one" / "campaign.json").read_bytes())
    # Three flights, in the order in which they came, and a fourth that was being written.
    (cut / ROWS).write_text(lines[4] + lines[0] + lines[2] + lines[1][:40], encoding="utf-8")
    assert campaign(flown, "cut", "--flights", "5", "--workers", "1", "--resume") == 0

    assert (cut / ROWS).read_text(encoding="utf-8") == whole
    assert json.loads(capsys.readouterr().out)["flights"] == 5


def test_another_campaigns_folder_is_not_written_over(
    flown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert campaign(flown, "one", "--flights", "5") == 2
    assert "holds a campaign: go on with --resume" in capsys.readouterr().err
    assert campaign(flown, "one", "--flights", "5", "--resume", "--seed", "2") == 2
    assert "holds a campaign of another seed (1)" in capsys.readouterr().err


def test_ctrl_c_keeps_what_is_done(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "echowing", "campaign", short(tmp_path), "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--flights", "10000", "--workers", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until_s = time.monotonic() + 120.0
    while not (out / ROWS).exists() and time.monotonic() < until_s:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    told, errors = process.communicate(timeout=120.0)

    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    kept = rows(tmp_path, "out")
    assert 0 < len(kept) < 10000
    assert f"{10000 - len(kept)} flights are left: go on with --resume" in told
    assert (out / "report.html").exists()


def test_a_folder_that_is_gone_or_full_is_named(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "gone")
    row: dict[str, Any] = {"index": 0, "in_force_s": {}, "states_s": {}}
    with pytest.raises(EchowingError, match=r"--out .*gone: cannot be written: No such file"):
        folder.add(row)
    with pytest.raises(EchowingError, match=r"--out .*gone: cannot be written: No such file"):
        folder.sort([row])
    with pytest.raises(EchowingError, match=r"--out .*gone: cannot be written: "):
        folder.write_parquet([row])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--flights", "0"), "--flights 0: give 1 or more"),
        (("--workers", "0"), "--workers 0: give 1 or more"),
    ],
)
def test_numbers_that_make_no_sense(
    options: tuple[str, str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", "--out", str(tmp_path), *options]) == 2
    assert says in capsys.readouterr().err


# ---- what is kept -------------------------------------------------------------------------------


def test_parquet_has_a_row_a_flight(flown: Path) -> None:
    table = parquet.read_table(flown / "one" / "flights.parquet")

    assert table.column("index").to_pylist() == list(range(5))
    assert table.column("closest_m").to_pylist() == [row["closest_m"] for row in rows(flown, "one")]
    assert table.column("in_force_s").to_pylist() is not None


def test_the_report_names_faults_coverage_and_the_worst(flown: Path) -> None:
    text = (flown / "one" / "report.html").read_text(encoding="utf-8")

    for heading in ("Properties", "Each fault", "Worst flights", "Minutes in force", "Pairs"):
        assert heading in text
    assert "Campaign: 5 flights, seed 1" in text


def broken_row(index: int, value: float, name: str = "separation") -> dict[str, Any]:
    found = {"name": name, "time_s": 1.0, "vehicle": 2, "value": value, "text": f"{value} m"}
    return {"index": index, "seed": 1, "broken": [found]}


def test_an_autopilot_that_ends_in_flight_is_a_find(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As ArduPilot ends where a script gives Guided a number that is none."""
    script = tmp_path / "careless.lua"
    script.write_text("""
        local nowhere = Vector3f()
        nowhere:x(0.0 / 0.0)
        local function update()
          if millis():toint() > 3000 then
            vehicle:set_target_pos_NED(nowhere, false, 0, false, 0, false, false)
          end
          return update, 100
        end
        return update()
    """)
    monkeypatch.setattr(
        SimFollower, "load_applet", lambda one, _: one.autopilot.load_script(script)
    )

    judged = fly_and_judge(load_scenario("echowing", ["duration_s=10"]), 3)

    assert judged.record is None
    [broken] = judged.broken
    assert (broken.name, broken.vehicle) == ("no error", 2)
    assert broken.time_s == pytest.approx(3.1, abs=0.11)
    assert "floating point exception" in broken.text
    assert main(["sim", "echowing", "--set", "duration_s=10"]) == 2


def test_the_worst_find_comes_first() -> None:
    found = finds_of([broken_row(2, 0.5), broken_row(1, 0.2), broken_row(0, 3.0, "stopped")])

    assert [row["index"] for row, _ in found["separation"]] == [1, 2]
    assert list(found) == ["separation", "stopped"]


def test_a_flight_that_could_not_be_flown_is_in_the_report(tmp_path: Path, flown: Path) -> None:
    crashed = broken_row(5, 0.0, "no error")
    path = write_report(tmp_path, [*rows(flown, "one"), crashed], 1, ["outage"])

    assert "6 flights" in path.read_text(encoding="utf-8")
    Folder(tmp_path).write_parquet([*rows(flown, "one"), crashed])


# ---- shrinking ----------------------------------------------------------------------------------


def needs(*kinds: str) -> Callable[[dict[str, Any]], Broken | None]:
    """Fails as long as these faults are there; the table has to be a scenario too."""

    def fails(table: dict[str, Any]) -> Broken | None:
        scenario_of(table, "test")
        there = {fault["kind"] for fault in table.get("fault", [])}
        return Broken("separation", 12.0, 2, 0.5, "near") if set(kinds) <= there else None

    return fails


def test_what_a_find_does_not_need_is_taken_out() -> None:
    table: dict[str, Any] = {
        "title": "t",
        "duration_s": 80.0,
        "wind": {"speed_mps": 5.0},
        "formation": {"slots": [{"radius_m": 3.0}, {"radius_m": 8.0}, {"radius_m": 13.0}]},
        "radio": {"leader": {"loss": 0.1}, "follower": {"loss": 0.1}},
        "fault": [
            {"kind": "sonar_dead", "vehicle": 2, "at_s": 3.3, "for_s": 8.0},
            {"kind": "outage", "vehicle": 4, "at_s": 5.0},
            {"kind": "sonar_wild", "vehicle": 3, "at_s": 50.0},
        ],
    }
    smallest, broken = shrink(table, needs("sonar_dead"))

    assert smallest["fault"] == [{"kind": "sonar_dead", "vehicle": 2, "at_s": 3.0, "for_s": 1.0}]
    assert len(smallest["formation"]["slots"]) == 1
    assert "wind" not in smallest
    assert smallest["radio"] == {}
    # Five seconds after what broke it, at 12 s.
    assert smallest["duration_s"] == 17.0
    assert broken.time_s == 12.0


def test_a_follower_that_goes_takes_its_number_with_it() -> None:
    table: dict[str, Any] = {
        "title": "t",
        "duration_s": 17.0,
        "formation": {"slots": [{"radius_m": 3.0}, {"radius_m": 8.0}]},
        "fault": [{"kind": "sonar_dead", "vehicle": 3, "at_s": 3.0}],
    }
    smallest, _ = shrink(table, needs("sonar_dead"))

    assert smallest["fault"][0]["vehicle"] == 2
    assert smallest["formation"]["slots"] == [{"radius_m": 8.0}]


def test_what_does_not_fail_is_not_shrunk() -> None:
    with pytest.raises(ValueError, match="does not fail"):
        shrink({"title": "t"}, needs("sonar_dead"))


def test_a_find_is_a_file_that_flies_again_to_the_same_bytes(tmp_path: Path) -> None:
    """A height that jumps down by 12 m of 10: for a second it is below two, by its own word."""
    text = """
[flight]
duration_s = 12.0
[formation]
radius_m = 3.0
[[fault]]
share = 1.0
kind = "gps_jump"
vehicle = "follower"
at_s = 6.0
jump_ned_m = [0.0, 0.0, 12.0]
[[fault]]
share = 1.0
kind = "late_echoes"
vehicle = "follower"
range_m = 9.0
"""
    (tmp_path / "jump.toml").write_text(text, encoding="utf-8")
    description = load_description(str(tmp_path / "jump.toml"))
    work = ((description, 1), ("not too low", 0))
    folder = tmp_path / "finds"
    folder.mkdir()
    path = folder / "not-too-low-0.toml"
    path.write_text(shrunk_file(*work), encoding="utf-8")
    write_find_page(path, "not too low")

    text = path.read_text(encoding="utf-8")
    seed = int(text.partition("--seed ")[2].split()[0])
    scenario = load_scenario(str(path))
    assert [fault.kind for fault in scenario.fault] == ["gps_jump"]
    record, again = fly_recorded(scenario, seed), fly(scenario, seed)
    assert np.array_equal(record.flights[0].follower_ned_m, again.flights[0].follower_ned_m)
    assert [one.name for one in judge(record)] == ["not too low"]
    assert tomllib.loads(text)["title"].startswith("Find: follower 2 was led to")
    page = path.with_suffix(".html").read_text(encoding="utf-8")
    assert "BROKEN, not too low" in page
    assert "fault begins: follower 2: gps jump" in page


def test_a_drawn_flight_written_as_a_file_is_the_same_flight() -> None:
    drawn = draw(load_description(), 1, 4)

    assert scenario_of(table_of(drawn), "file") == drawn
