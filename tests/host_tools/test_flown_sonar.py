"""A sonar file out of a flight: the log of readings, and what `analyze --sonar` makes of it."""

import json
import math
import random
from pathlib import Path
from typing import Any

import pytest

from echowing.analysis.flown_sonar import LEAST_READINGS, sonar_from
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.hearing import Reading
from echowing.sonar_file import load_sonar
from echowing.tool.log import SONAR, FollowLog

BASE = load_sonar("mb1202")
START_UNIX_S = 1_790_000_000.0


def flown(share: float = 0.7, half_deg: float = 15.0, count: int = 6_000) -> list[Reading]:
    """Ten minutes at 2.4 to 3.6 m, up to 18 degrees off the axis."""
    chance = random.Random(6)
    readings = []
    for number in range(count):
        t_s = 0.1 * number
        expected_m = 3.0 + 0.6 * math.sin(0.2 * t_s)
        off_deg = 18.0 * abs(math.sin(0.37 * t_s))
        there = share / (1.0 + math.exp((off_deg - half_deg) / 1.5))
        range_m = expected_m + chance.gauss(0.0, 0.02) if chance.random() < there else None
        if chance.random() < 0.02:
            range_m = chance.uniform(0.2, 4.5)
        readings.append(Reading(t_s, range_m, expected_m, math.radians(off_deg), 0.05))
    return readings


def logged(folder: Path, readings: list[Reading], system_id: int = 2) -> Path:
    log = FollowLog(folder, START_UNIX_S, pytest.fail)
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
    assert file.source["inset_m"] == BASE.source["inset_m"]


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
    assert f"echowing follow --sonar {mine}" in said
    heard = load_sonar(mine).belief().heard.at(2.8)
    assert 0.3 < heard < 0.4

    assert main(["analyze", str(tmp_path), "--sonar", str(mine), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["title"].endswith("(flight)")


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
    assert main(["analyze", "a", "b", "--sonar", "mine.toml"]) == 2
    assert "give one log" in capsys.readouterr().err


def test_a_log_that_cannot_be_written_never_stops_the_flight(tmp_path: Path) -> None:
    said: list[str] = []
    log = FollowLog(tmp_path, START_UNIX_S, said.append)
    full: Any = Path("/dev/full").open("w", encoding="utf-8")  # noqa: SIM115
    log._sonar = full
    for _ in range(200):
        log.readings(START_UNIX_S, 2, flown(count=50))

    assert any("flying goes on" in text for text in said)
