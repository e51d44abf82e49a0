"""The sonar file: what is believed of a sonar, read and validated."""

import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.belief import Curve
from echowing.sonar_file import SHIPPED, SonarFile, load_sonar, sonar_of, value_keys


def shipped_table() -> dict[str, Any]:
    path = resources.files("echowing") / "sonars" / f"{SHIPPED}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def changed(**values: Any) -> dict[str, Any]:
    """The shipped file with other values; of a section only those that are given."""
    table = shipped_table()
    for name, value in values.items():
        table[name] = {**table[name], **value} if isinstance(value, dict) else value
    return table


def test_each_value_of_the_shipped_sonar_has_a_source_or_is_called_a_guess() -> None:
    shipped = load_sonar(SHIPPED)

    # Ranges of a curve belong to its values.
    needed = {key for key in value_keys(SonarFile) if key != "beam.range_m"}
    assert shipped.source.keys() == needed
    assert "heard.share" in shipped.guesses
    assert "foil_to_m" not in shipped.guesses


def test_the_belief_is_what_the_file_says() -> None:
    table = changed(
        heard={"range_m": [0.2, 2.0, 4.0], "share": [0.9, 0.7, 0.1]},
        beam={"range_m": [2.0, 4.0], "widest_deg": [20.0, 10.0], "narrowest_deg": [12.0, 6.0]},
        wild_share=0.05,
        late_share=0.01,
        reach_m=4.2,
    )
    sonar = sonar_of(table, "mine.toml").belief()

    assert sonar.heard.at(3.0) == pytest.approx(0.4)
    assert sonar.heard.at(0.0) == pytest.approx(0.9)
    assert sonar.silent_to_m == 4.0
    assert math.degrees(sonar.widest_rad.at(3.0)) == pytest.approx(15.0)
    assert math.degrees(sonar.narrowest_rad.at(9.0)) == pytest.approx(6.0)
    assert sonar.wrong_share == pytest.approx(0.06)
    assert sonar.reach_m == 4.2


def test_a_curve_is_the_same_for_one_range_and_for_many() -> None:
    curve = Curve((1.0, 2.0, 4.0), (0.0, 1.0, 0.5))
    ranges = np.array([0.5, 1.5, 3.0, 9.0])

    assert curve.at(ranges) == pytest.approx([0.0, 0.5, 0.75, 0.5])
    assert [curve.at(float(one)) for one in ranges] == pytest.approx(curve.at(ranges))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"noise_m": -0.01}, "noise_m: "),
        ({"colour": "red"}, "colour: no such key; allowed here: beam, foil_to_m"),
        ({"wild_share": 1.5}, "wild_share: "),
        ({"heard": {"share": [0.5]}}, "heard: as many values as range_m has"),
        ({"heard": {"range_m": [4.0, 0.2]}}, "heard: range_m: the nearest first"),
        ({"beam": {"narrowest_deg": [25.0, 25.0]}}, "beam: narrowest_deg: no more than widest_deg"),
        ({"beam": {"edge_deg": 0.0}}, "beam.edge_deg: "),
        ({"source": {"nose_m": "guess"}}, "source: there is no value nose_m"),
        ({"reach_m": float("inf")}, "reach_m: "),
        ({"inset_m": float("nan")}, "inset_m: "),
    ],
)
def test_a_wrong_value_is_named_with_its_file(change: dict[str, Any], says: str) -> None:
    with pytest.raises(EchowingError) as raised:
        sonar_of(changed(**change), "mine.toml")

    assert f"mine.toml: {says}" in str(raised.value)


def test_a_missing_key_is_named() -> None:
    table = shipped_table()
    del table["rate_hz"]

    with pytest.raises(EchowingError, match=r"mine\.toml: rate_hz: missing"):
        sonar_of(table, "mine.toml")


def test_a_file_that_is_not_there_or_no_toml_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "torn.toml").write_text("title = ", encoding="utf-8")

    with pytest.raises(EchowingError, match="cannot read the sonar"):
        load_sonar(tmp_path / "none.toml")
    with pytest.raises(EchowingError, match="not valid TOML"):
        load_sonar(tmp_path / "torn.toml")
    with pytest.raises(EchowingError, match=f"no sonar 'mb7'; there are {SHIPPED}"):
        load_sonar("mb7")


def test_a_scenario_with_a_wrong_sonar_is_refused_before_it_flies(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["sim", "echowing", "--set", "sonar.file=mb7"]) == 2

    assert "no sonar 'mb7'" in capsys.readouterr().err
