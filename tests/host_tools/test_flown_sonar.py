"""A sonar file out of a flight: the log of readings, and what `analyze --sonar` makes of it."""

import json
import math
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.flown_sonar import LEAST_READINGS, flown_by, sonar_from
from echowing.cli import main
from echowing.commands.follow import options_of
from echowing.errors import EchowingError
from echowing.flight.hearing import Reading
from echowing.sim.vehicle.dataflash import DataflashLog, ScriptMessage
from echowing.sonar_file import FlownBy, Legs, load_sonar, write_sonar
from echowing.tool.log import FLOWN_BY, SONAR, FollowLog

from .test_logs import DATA, Tlog

BASE = load_sonar("mb1202")
START_UNIX_S = 1_790_000_000.0


# The ground's clock is ahead of the vehicle's.
AHEAD_S = 100.0


def throttle(t_s: float) -> float:
    """Of a follower that climbs in one minute of three."""
    return 0.7 if t_s % 180.0 >= 120.0 else 0.4


def flown(
    share: float = 0.7,
    half_deg: float = 15.0,
    count: int = 6_000,
    *,
    swings_m: float = 0.6,
    heard_to_m: float = 9.0,
    climbing: float = 1.0,
) -> list[Reading]:
    """Ten minutes at 2.4 to 3.6 m, up to 18 degrees off the axis.

    climbing: what is heard in climbs, as a share of the rest.
    """
    chance = random.Random(6)
    readings = []
    for number in range(count):
        t_s = 0.1 * number
        expected_m = 3.0 + swings_m * math.sin(0.2 * t_s)
        off_deg = 18.0 * abs(math.sin(0.37 * t_s))
        there = share / (1.0 + math.exp((off_deg - half_deg) / 1.5))
        there *= (expected_m < heard_to_m) * (climbing if throttle(t_s) > 0.5 else 1.0)
        range_m = expected_m + chance.gauss(0.0, 0.02) if chance.random() < there else None
        if chance.random() < 0.02:
            range_m = chance.uniform(0.2, 4.5)
        readings.append(Reading(t_s, range_m, expected_m, math.radians(off_deg), 0.05))
    return readings


def logged(
    folder: Path, readings: list[Reading], system_id: int = 2, flown_by: FlownBy | None = None
) -> Path:
    log = FollowLog(folder, START_UNIX_S, pytest.fail, flown_by)
    log.readings(START_UNIX_S, system_id, readings)
    log.close()
    (path,) = folder.glob(f"*{SONAR}")
    return path


def test_a_line_for_each_reading_says_where_the_leader_was(tmp_path: Path) -> None:
    path = logged(tmp_path, [Reading(1.5, None, 2.8, math.radians(3.0), math.radians(1.0))])

    assert json.loads(path.read_text(encoding="utf-8")) == {
        "unix_time_s": START_UNIX_S + 1.5,
        "system_id": 2,
        "range_m": None,
        "expected_m": 2.8,
        "off_deg": 3.0,
        "sure_deg": 1.0,
    }


def test_what_was_heard_is_in_the_file(tmp_path: Path) -> None:
    logged(tmp_path, flown())
    measured = sonar_from(tmp_path, BASE, "foil")
    file = measured.file

    # Two of a hundred are anything instead; one 90 % interval of ten misses, by a little.
    assert file.heard.least[1] - 0.02 < 0.7 * 0.98 < file.heard.most[1] + 0.02
    assert file.heard.most[1] - file.heard.least[1] < 0.25
    # Beyond what was flown, what is believed.
    assert (file.heard.range_m[-1], file.heard.least[-1]) == (4.0, BASE.heard.least[-1])
    assert file.noise_m[0] < 0.02 < file.noise_m[1]
    assert file.wild_share[0] < 0.02 < file.wild_share[1] + 0.005
    # Near the middle, where all angles were flown.
    narrowest = file.belief().narrowest_rad.at(3.0)
    assert 12.0 < math.degrees(narrowest) <= 15.5
    assert file.belief().widest_rad.at(3.0) == pytest.approx(BASE.belief().widest_rad.at(3.0), 0.01)
    assert (file.foil_to_m, file.inset_m) == (BASE.foil_to_m, BASE.inset_m)
    assert file.source["heard.least"].startswith("measured: flight, ")
    # What a flight does not tell is as it was, and the file says why.
    assert file.source["inset_m"].startswith(f"{BASE.source['inset_m']}; kept: a flight does not ")
    assert "; kept: no end of it was flown to; heard at ranges of 3.5" in file.source["foil_to_m"]
    assert "no log tells the throttle: log " in file.source["throttle.share"]
    assert file.source["rate_hz"].endswith("; kept: a flight does not tell it, as radios lose some")
    assert file.source["shortest_m"].endswith("; kept: nobody flies so near")
    assert file.source["heard.most"].endswith("; kept: from 4 m on")
    assert file.guesses == [
        key for key in BASE.guesses if not file.source[key].startswith("measured")
    ]
    assert [note.partition(" is as it was: ")[0] for note in measured.notes] == [
        *("inset_m", "reach_m", "beam.widest_deg", "foil_to_m", "stock_to_m"),
        "throttle.throttle",
    ]
    # Measured once more with it, the reasons do not pile up.
    again = sonar_from(tmp_path, file, "foil").file
    assert again.source["inset_m"] == file.source["inset_m"]


@pytest.mark.parametrize(("legs", "key"), [("foil", "foil_to_m"), ("stock", "stock_to_m")])
def test_how_far_it_hears_is_told_by_who_flew_further(tmp_path: Path, legs: Legs, key: str) -> None:
    logged(tmp_path, flown(swings_m=1.4, heard_to_m=3.6))
    file = sonar_from(tmp_path, BASE, legs).file

    low_m, high_m = getattr(file, key)
    assert low_m < 3.6 < high_m <= low_m + 1.0
    assert file.source[key].startswith("measured: flight, ")
    other = "stock_to_m" if legs == "foil" else "foil_to_m"
    assert file.source[other].startswith("guess: in the proportion")
    assert "kept" not in file.source["heard.least"]
    assert file.heard.least[-1] < 0.1  # nothing is believed beyond
    # The flight's own distances, whichever legs were flown.
    heard = file.belief(legs).heard
    assert heard.at(3.0) > 0.5
    assert heard.at_m[-1] == pytest.approx(4.5, abs=0.3)


def test_a_flight_with_stock_legs_that_has_no_end_is_believed_as_it_was_flown(
    tmp_path: Path,
) -> None:
    logged(tmp_path, flown())
    as_foil, as_stock = (sonar_from(tmp_path, BASE, legs).file for legs in ("foil", "stock"))

    assert as_stock.stock_to_m == BASE.stock_to_m
    least = as_foil.belief().heard.at(3.0)
    assert as_stock.belief("stock").heard.at(3.0) == pytest.approx(least, abs=0.001)
    assert as_stock.heard.range_m[0] == pytest.approx(as_foil.heard.range_m[0] / 0.7, abs=0.01)


def test_a_place_that_few_readings_tell_is_as_it_was_believed(tmp_path: Path) -> None:
    stray = [Reading(700.0 + 0.1 * n, None, 4.0 + 0.5 * (n % 6), 0.0, 0.05) for n in range(12)]
    logged(tmp_path, flown() + stray)
    heard = sonar_from(tmp_path, BASE, "foil").file.heard

    assert heard.range_m[-1] == BASE.heard.range_m[-1]
    assert heard.least[-1] == BASE.heard.least[-1]


def telemetry(folder: Path, *, hud: bool, hud_ends_s: float = 600.0) -> Path:
    """What `follow` has of the vehicle beside the readings; writes the vehicle's own log, too."""
    tlog, own = Tlog(2), DataflashLog((folder / "follower.BIN").open("wb"))
    tlog.fly(lambda t_s: 2.0 * t_s, seconds=600.0, start_unix_s=START_UNIX_S, delay_s=AHEAD_S)
    for t_s in range(round(-AHEAD_S), 600):
        # The readings' clock is the ground's.
        thrust = throttle(t_s + AHEAD_S)
        if hud and t_s + AHEAD_S < hud_ends_s:
            said = mavlink.MAVLink_vfr_hud_message(2, 2, 0, round(100 * thrust), 10, 0)
            tlog.put(START_UNIX_S + t_s + AHEAD_S, said)
        place = (36.0, -86.0, 260.0)
        own.gps(t_s + AHEAD_S, START_UNIX_S + t_s, place, (2.0, 0.0, 0.0))
        own.write("POS", t_s + AHEAD_S, *place, 10.0, 10.0)
        own.write_script(ScriptMessage("CTUN", "ThO", "f", "", "", (thrust,)), t_s + AHEAD_S)
    own.close()
    (empty,) = folder.glob("*.tlog")
    empty.write_bytes(tlog.data)
    return folder / "follower.BIN"


@pytest.mark.parametrize("hud", [True, False])
def test_what_the_throttle_takes_is_told_by_telemetry_or_the_autopilots_log(
    tmp_path: Path, hud: bool
) -> None:
    logged(tmp_path, flown(climbing=0.5))
    own = telemetry(tmp_path, hud=hud)
    measured = sonar_from(tmp_path, BASE, "foil", None if hud else own)

    told = dict(zip(measured.file.throttle.throttle, measured.file.throttle.share, strict=True))
    assert told == {0.0: 1.0, 0.4: 1.0, 0.7: pytest.approx(0.5, abs=0.07)}
    assert re.fullmatch(
        "measured: flight, .*; kept: under 40% and over 70%", measured.file.source["throttle.share"]
    )
    assert not any(note.startswith("throttle") for note in measured.notes)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda data: b"", r"\.tlog is empty"),
        (lambda data: data[:20], "no whole message in its 20 bytes"),
        (lambda data: Tlog(3).fly(lambda t_s: t_s).data[:-9], "no track of vehicle 2; .*damaged"),
        (lambda data: data, r"\.tlog has no VFR_HUD; give the follower's \.BIN, too"),
    ],
)
def test_why_no_throttle_is_known_is_said(
    tmp_path: Path, damage: Callable[[bytes], bytes], says: str
) -> None:
    logged(tmp_path, flown(count=1_200))
    telemetry(tmp_path, hud=False)
    (log,) = tmp_path.glob("*.tlog")
    log.write_bytes(damage(log.read_bytes()))
    measured = sonar_from(tmp_path, BASE, "foil")

    assert re.search(says, measured.file.source["throttle.share"])
    assert any(re.search(says, note) for note in measured.notes)


def test_a_log_that_is_cut_off_tells_the_throttle_only_up_to_there(tmp_path: Path) -> None:
    """Or all that was flown afterwards would count as of its last throttle."""
    logged(tmp_path, flown(climbing=0.5))
    telemetry(tmp_path, hud=True, hud_ends_s=360.0)  # at 70 %; then come 40 %
    (log,) = tmp_path.glob("*.tlog")
    log.write_bytes(log.read_bytes()[:-5])
    measured = sonar_from(tmp_path, BASE, "foil")

    told = dict(zip(measured.file.throttle.throttle, measured.file.throttle.share, strict=True))
    assert told[0.7] == pytest.approx(0.5, abs=0.07)
    assert any(
        note.endswith("damaged or cut off; the readable part is used") for note in measured.notes
    )


def test_one_throttle_tells_nothing_of_others(tmp_path: Path) -> None:
    logged(tmp_path, flown(count=1_200))
    telemetry(tmp_path, hud=True)
    file = sonar_from(tmp_path, BASE, "foil").file

    assert file.throttle == BASE.throttle
    assert file.source["throttle.share"].startswith("kept: ")
    assert "too little was heard at other throttles than 40%" in file.source["throttle.share"]


def test_an_autopilots_log_without_its_clock_or_throttle_is_named(tmp_path: Path) -> None:
    logged(tmp_path, flown())
    with pytest.raises(EchowingError, match=r"tlog is empty; without vehicle 2's clock the "):
        sonar_from(tmp_path, BASE, "foil", DATA / "follower.BIN")
    telemetry(tmp_path, hud=False)
    with pytest.raises(EchowingError, match=r"follower\.BIN: tells no throttle \(CTUN"):
        sonar_from(tmp_path, BASE, "foil", DATA / "follower.BIN")
    with pytest.raises(EchowingError, match=r"leader\.BIN: is of vehicle 1, the readings of 2"):
        sonar_from(tmp_path, BASE, "foil", DATA / "leader.BIN")


def test_analyze_writes_it_and_says_what_it_heard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logged(tmp_path, flown(share=0.4))
    mine = tmp_path / "mine.toml"

    assert main(["analyze", str(tmp_path), "--sonar", str(mine)]) == 0
    said = capsys.readouterr().out
    assert "m: hears 4" in said or "m: hears 3" in said
    # Beside what was believed.
    assert "measured: ranges scatter 1.8 to 2.9 cm, 1.4% to 1.9% are wild, " in said
    assert "mb1202: ranges scatter 0.5 to 3.0 cm, 0.0% to 2.0% are wild, 0.0% to 1.0% late" in said
    assert "inset_m is as it was: a flight does not tell it" in said
    assert f"echowing follow --sonar {mine}" in said
    heard = load_sonar(mine).belief().heard.at(2.8)
    assert 0.3 < heard < 0.4

    assert main(["analyze", str(tmp_path), "--sonar", str(mine), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["title"].endswith("(flight)")


def flown_with_boom(folder: Path) -> FlownBy:
    """A flight by a file that is gone, before a leader with stock legs."""
    told = FlownBy("gone.toml", load_sonar("mb1202-boom"), "stock")
    logged(folder, flown(count=1_200), flown_by=told)
    return told


def test_the_log_says_by_which_file_and_before_which_legs_it_was_flown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = flown_with_boom(tmp_path)
    assert flown_by(tmp_path) == told
    mine = tmp_path / "mine.toml"

    assert main(["analyze", str(tmp_path), "--sonar", str(mine)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "gone.toml: ranges scatter 0.5 to 3.0 cm" in said.out
    assert f"echowing follow --sonar {mine} --legs stock" in said.out
    file = load_sonar(mine)
    assert (file.inset_m, file.boom_m) == (told.file.inset_m, told.file.boom_m)
    assert file.source["wild_share"].endswith("pings at stock legs")
    # Whoever says otherwise knows better.
    assert main(["analyze", str(tmp_path), "--sonar", str(mine), "--base", "mb1202"]) == 0
    assert load_sonar(mine).inset_m == BASE.inset_m
    assert main(["analyze", str(tmp_path), "--sonar", str(mine), "--legs", "foil"]) == 0
    assert load_sonar(mine).source["wild_share"].endswith("pings at foil legs")


def test_what_neither_log_nor_options_say_is_said_to_be_assumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logged(tmp_path, flown(count=1_200))
    mine = tmp_path / "mine.toml"
    analyze = ["analyze", str(tmp_path), "--sonar", str(mine)]

    assert flown_by(tmp_path) is None
    assert main([*analyze, "--json"]) == 0
    assert capsys.readouterr().err.splitlines() == [
        f"{tmp_path} names no sonar file: taken to be flown by mb1202 (--base)",
        f"{tmp_path} tells nothing of legs: taken to be foil (--legs)",
    ]
    assert load_sonar(mine).source["wild_share"].endswith("pings at foil legs (assumed)")
    assert main([*analyze, "--base", "mb1202", "--legs", "foil"]) == 0
    assert capsys.readouterr().err == ""
    assert load_sonar(mine).source["wild_share"].endswith("pings at foil legs")


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({}, "line 1: does not say by which sonar file it was flown"),
        ({"legs": "bare", "file": {}}, "line 1: does not say by which sonar file"),
        ({"legs": "foil", "file": {"title": "x"}}, "line 1: shortest_m: "),
    ],
)
def test_a_log_that_says_it_wrongly_is_named(
    tmp_path: Path, told: dict[str, Any], says: str
) -> None:
    path = logged(tmp_path, flown(count=400))
    path.write_text(json.dumps({FLOWN_BY: told}) + "\n" + path.read_text("utf-8"), "utf-8")

    with pytest.raises(EchowingError, match=says):
        flown_by(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"range_m": 3.0}'])
def test_a_log_of_an_older_tool_says_nothing_of_it(tmp_path: Path, text: str) -> None:
    path = tmp_path / f"follow{SONAR}"
    path.write_text(text, encoding="utf-8")
    assert flown_by(path) is None
    assert flown_by(tmp_path / "follower.BIN") is None


def test_what_follow_is_told_is_what_it_logs(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    write_sonar(mine, load_sonar("lidar"))
    ends = ["--leader", "udpin:14550", "--follower", "udpin:14560"]
    options = options_of([*ends, "--sonar", str(mine), "--legs", "stock"])

    assert options.flown_by == FlownBy(str(mine), load_sonar("lidar"), "stock")
    assert options.flown_by.file.belief("stock") == options.sonar


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["{"], "0 readings of a leader whose place was known"),  # cut off as the tool was killed
        (["{", "{}"], "line 1: is no reading"),
        (['{"range_m": "far"}', "{}"], "line 1: is no reading"),
        (["[]", "{}"], "line 1: is no reading"),
    ],
)
def test_a_log_that_is_none_is_named(tmp_path: Path, lines: list[str], says: str) -> None:
    path = tmp_path / f"follow{SONAR}"
    path.write_text("\n".join(lines), encoding="utf-8")

    with pytest.raises(EchowingError, match=says):
        sonar_from(path, BASE, "foil")


def test_too_little_says_how_much_is_needed(tmp_path: Path) -> None:
    path = logged(tmp_path, flown(count=LEAST_READINGS - 1))

    with pytest.raises(EchowingError, match=f"{LEAST_READINGS} are needed: fly longer"):
        sonar_from(path, BASE, "foil")


def test_two_followers_are_two_sonars(tmp_path: Path) -> None:
    log = FollowLog(tmp_path, START_UNIX_S, pytest.fail)
    for system_id in (2, 3):
        log.readings(START_UNIX_S, system_id, flown(count=10))
    log.close()

    with pytest.raises(EchowingError, match="is of 2 followers"):
        sonar_from(tmp_path, BASE, "foil")


def test_a_folder_without_readings_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match=f"0 files \\*{SONAR}"):
        sonar_from(tmp_path, BASE, "foil")


def test_two_logs_at_once_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", "a", "b", "c", "--sonar", "mine.toml"]) == 2
    assert "give one log" in capsys.readouterr().err


def test_a_log_that_cannot_be_written_never_stops_the_flight(tmp_path: Path) -> None:
    said: list[str] = []
    log = FollowLog(tmp_path, START_UNIX_S, said.append)
    full: Any = Path("/dev/full").open("w", encoding="utf-8")  # noqa: SIM115
    log._sonar = full
    for _ in range(200):
        log.readings(START_UNIX_S, 2, flown(count=50))

    assert any("flying goes on" in text for text in said)
