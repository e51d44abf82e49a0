"""A law of the user's own: an applet's file in place of ours, in a scenario and in the table."""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from echowing.applets import HOLD, SPEED, Applet
from echowing.bench.laws import fly_law, rows
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.setup.applet import applet_path
from echowing.sim.scenario import load_scenario

# What the page tells to change in a copy of the speed applet.
BANDS = "    local wish_mps = speed_mps + (range_m >= C.DIST + C.BAND_OUT and C.STEP_BIG\n"


def copy(folder: Path, applet: Applet = SPEED, **changes: str) -> Path:
    """An applet of the user's, with each of `changes` before the thesis's bands."""
    text = applet_path(applet).read_text(encoding="utf-8")
    for line in changes.values():
        assert BANDS in text
        text = text.replace(BANDS, f"    {line}\n{BANDS}")
    file = folder / "my_law.lua"
    file.write_text(text, encoding="utf-8")
    return file


def flown(capsys: pytest.CaptureFixture[str], law: Path) -> dict[str, Any]:
    assert main(["sim", "echowing", "--law", str(law), "--duration", "40", "--json"]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


@pytest.mark.parametrize(("applet", "velocity"), [(HOLD, True), (SPEED, False)])
def test_a_copy_gets_the_points_of_what_it_was_copied_from(
    applet: Applet, velocity: bool, tmp_path: Path
) -> None:
    scenario = load_scenario("echowing", [f'law="{copy(tmp_path, applet)}"'])
    assert scenario.guidance_settings().feed_forward is velocity
    assert scenario.law_name == "my_law.lua"


def test_what_stands_in_the_file_is_flown_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_ours = flown(capsys, copy(tmp_path))
    assert as_ours["law"] == "my_law.lua"
    creeping = flown(capsys, copy(tmp_path, law="range_m = C.DIST - 2 * C.BAND_OUT"))
    # It only ever slows down, and is left behind.
    assert creeping["mean_separation_m"] > as_ours["mean_separation_m"] + 1.0


def test_its_parameters_are_those_of_its_table(tmp_path: Path) -> None:
    law = f'law="{copy(tmp_path)}"'
    assert load_scenario("echowing", [law, "applet.ECHO_PERIOD=0.3"]).applet
    with pytest.raises(EchowingError, match=r"my_law\.lua has no such parameter; .* ECHO_PERIOD"):
        load_scenario("echowing", [law, "applet.ECHO_PERIODE=0.3"])


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("nothing()", r"my_law\.lua: failed after .* s: ECHO: error .*nothing"),
        ("return = 3", r"my_law\.lua: failed after .* s: Lua: Error: .*my_law\.lua:\d+: "),
    ],
)
def test_a_law_that_fails_is_no_flight(
    line: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The vehicle would go on with the speed that it had, and nobody would be told."""
    monkeypatch.setattr("echowing.bench.laws.DURATION_S", 15.0)
    law = copy(tmp_path, law=line)
    with pytest.raises(EchowingError, match=says):
        fly_law(str(law), "rectangle", 1)


def test_it_stands_in_the_table_beside_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("echowing.bench.laws.DURATION_S", 15.0)
    mine = fly_law(str(copy(tmp_path)), "rectangle", 1)
    flights = [replace(mine, law="hold"), mine]
    assert [row.law for row in islice(rows(flights), 2)] == ["hold", "my_law.lua"]


@pytest.mark.parametrize(
    ("text", "says"), [(None, "cannot read the applet"), ("x = 1\n", "no table of parameters")]
)
def test_a_file_that_is_no_applet_is_named_before_anything_flies(
    text: str | None, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my_law.lua"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    assert main(["bench", "--only", "laws", "--law", str(file)]) == 2
    assert says in capsys.readouterr().err
