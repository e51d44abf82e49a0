"""The sonar file: what is believed of a sonar, read and validated."""

import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.belief import Curve
from echowing.paths import SHIPPED_SONAR
from echowing.sim.boards.coprocessor import parameter_table
from echowing.sonar_file import Legs, SonarFile, load_sonar, sonar_names, sonar_of, value_keys


def shipped_table() -> dict[str, Any]:
    path = resources.files("echowing") / "sonars" / f"{SHIPPED_SONAR}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def changed(**values: Any) -> dict[str, Any]:
    """The shipped file with other values; of a section only those that are given."""
    table = shipped_table()
    for name, value in values.items():
        table[name] = {**table.get(name, {}), **value} if isinstance(value, dict) else value
    return table


@pytest.mark.parametrize("name", sonar_names())
def test_each_value_of_a_shipped_sensor_has_a_source_or_is_called_a_guess(name: str) -> None:
    file = load_sonar(name)
    needed = {key for key in value_keys(SonarFile) if not key.startswith("throttle.")}
    assert file.source.keys() == needed - (set() if file.boom_m else {"boom_m"})


@pytest.mark.parametrize("name", ["mb1202", "mb1202-boom"])
def test_a_sonar_on_the_co_processor_reads_as_often_as_its_firmware_pings(name: str) -> None:
    file = load_sonar(name)
    (period_ms,) = (row.default for row in parameter_table() if row.name == "SONAR_PERIOD")

    assert file.rate_hz == pytest.approx(1000.0 / period_ms)
    assert f"every {period_ms:g} ms" in file.source["rate_hz"]


def test_what_is_guessed_of_the_shipped_sonar_is_said() -> None:
    shipped = load_sonar(SHIPPED_SONAR)
    assert "heard.least" in shipped.guesses
    assert "reach_m" not in shipped.guesses


def test_the_belief_is_the_worse_of_what_the_file_says() -> None:
    table = changed(
        heard={"range_m": [0.2, 2.0, 4.0], "least": [0.9, 0.7, 0.1], "most": [1.0, 1.0, 0.2]},
        beam={"range_m": [2.0, 4.0], "widest_deg": [20.0, 10.0], "narrowest_deg": [12.0, 6.0]},
        wild_share=[0.01, 0.05],
        late_share=[0.0, 0.01],
        noise_m=[0.01, 0.04],
        inset_m=[0.1, 0.2],
        reach_m=4.2,
    )
    sonar = sonar_of(table, "mine.toml").belief()

    assert sonar.heard.at(3.0) == pytest.approx(0.4)
    assert sonar.heard.at(0.0) == pytest.approx(0.9)
    assert sonar.silent_to_m == 4.0
    assert math.degrees(sonar.widest_rad.at(3.0)) == pytest.approx(15.0)
    assert math.degrees(sonar.narrowest_rad.at(9.0)) == pytest.approx(6.0)
    assert sonar.wrong_share == pytest.approx(0.06)
    assert sonar.noise_m == 0.04
    assert sonar.inset_m == pytest.approx(0.15)
    assert sonar.reach_m == 4.2


def test_stock_legs_are_heard_less_far_and_as_foil_that_is_further_away() -> None:
    sonar = sonar_of(changed(foil_to_m=[4.0, 4.8], stock_to_m=[3.0, 3.4]), "mine.toml")
    foil, stock = sonar.belief("foil"), sonar.belief("stock")

    assert (foil.heard_to_m, stock.heard_to_m) == (4.0, 3.0)
    # One that is said to have foil may have none; one without may have still worse legs.
    assert (foil.surely_to_m, stock.surely_to_m) == (3.0, 2.25)
    assert load_sonar("radio").belief().surely_to_m == 7.4
    assert stock.silent_to_m == pytest.approx(0.75 * foil.silent_to_m)
    assert stock.heard.at(1.5) == pytest.approx(foil.heard.at(2.0))
    assert stock.narrowest_rad.at(3.0) == pytest.approx(foil.narrowest_rad.at(4.0))
    # Nobody knows that it hears less far aside.
    assert stock.widest_rad == foil.widest_rad


def test_no_leader_is_heard_where_a_range_counts_as_none() -> None:
    """Who enters that a sensor sees further, and forgets its `reach_m`, is told of it."""
    far = {"foil_to_m": [6.5, 7.2], "stock_to_m": [5.5, 6.0]}
    short = sonar_of(changed(**far, heard={"range_m": [0.2, 6.5]}, reach_m=4.5), "mine.toml")
    long = sonar_of(changed(**far, heard={"range_m": [0.2, 6.5]}, reach_m=7.0), "mine.toml")

    assert long.belief().objection(5.0) is None
    for legs in get_args(Legs):
        belief = short.belief(legs)
        assert belief.heard_to_m == 4.5
        assert str(belief.objection(5.0)).startswith("a leader is certain to be heard up to 4.7 m")
        assert belief.heard == long.belief(legs).heard


def test_what_propellers_take_is_believed_at_their_worst() -> None:
    loud = changed(throttle={"throttle": [0.0, 0.4, 0.8], "share": [1.0, 0.8, 0.5]})
    quiet = shipped_table()

    heard = [sonar_of(one, "mine.toml").belief().heard.at(2.0) for one in (quiet, loud)]
    assert heard[1] == pytest.approx(0.5 * heard[0])


def test_a_curve_is_the_same_for_one_range_and_for_many() -> None:
    curve = Curve((1.0, 2.0, 4.0), (0.0, 1.0, 0.5))
    ranges = np.array([0.5, 1.5, 3.0, 9.0])

    assert curve.at(ranges) == pytest.approx([0.0, 0.5, 0.75, 0.5])
    assert [curve.at(float(one)) for one in ranges] == pytest.approx(curve.at(ranges))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"shortest_m": -0.01}, "shortest_m: "),
        ({"colour": "red"}, "colour: no such key; allowed here: beam, boom_m, foil_to_m"),
        ({"wild_share": [0.0, 1.5]}, "wild_share.1: "),
        ({"boom_m": 0.3}, "boom_m: no more than the least inset_m, 0.15"),
        ({"noise_m": 0.05}, "noise_m: "),
        ({"noise_m": [0.05, 0.01]}, "noise_m: the least first, then the most"),
        ({"foil_to_m": [4.0]}, "foil_to_m.1: "),
        ({"heard": {"least": [0.5]}}, "heard: least: as many values as range_m has"),
        ({"heard": {"most": [0.6, 0.4]}}, "heard: least: no more than most"),
        ({"heard": {"range_m": [4.0, 0.2]}}, "heard: range_m: the least first"),
        ({"beam": {"narrowest_deg": [25.0, 9.0]}}, "beam: narrowest_deg: no more than widest_deg"),
        ({"beam": {"edge_deg": [0.0, 1.0]}}, "beam.edge_deg.0: "),
        ({"throttle": {"throttle": [0.5, 0.5]}}, "throttle: throttle: the least first"),
        ({"throttle": {"throttle": [0.1, 0.5]}}, "throttle: share: as many values as throttle"),
        ({"source": {"nose_m": "guess"}}, "source: there is no value nose_m"),
        ({"reach_m": float("inf")}, "reach_m: "),
        ({"shortest_m": float("nan")}, "shortest_m: "),
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
    with pytest.raises(
        EchowingError, match="there are lidar, mb1202, mb1202-boom, mb1202-fixed, radio"
    ):
        load_sonar("mb7")


@pytest.mark.parametrize(
    ("name", "why"), [("radio", "may scatter by 0.10 m"), ("lidar", "as narrow as 3 degrees")]
)
def test_a_sensor_for_comparison_is_said_to_carry_no_slot(name: str, why: str) -> None:
    assert why in (load_sonar(name).belief().objection(3.0) or "")


def test_a_scenario_with_a_wrong_sonar_is_refused_before_it_flies(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["sim", "echowing", "--set", "sonar.file=mb7"]) == 2

    assert "no sonar 'mb7'" in capsys.readouterr().err


@given(
    points_mm=st.dictionaries(st.integers(0, 8000), st.floats(0.0, 1.0), min_size=1, max_size=6),
    range_m=st.floats(-1.0, 9.0),
)
def test_a_curve_is_at_one_range_what_it_is_at_many(
    points_mm: dict[int, float], range_m: float
) -> None:
    """Its points are ranges that somebody has measured: no two within a millimetre."""
    at_mm, values = zip(*sorted(points_mm.items()), strict=True)
    curve = Curve(tuple(one_mm / 1e3 for one_mm in at_mm), values)
    asked_m = [range_m, *curve.at_m]
    assert [curve.at(one_m) for one_m in asked_m] == curve.at(np.array(asked_m)).tolist()
