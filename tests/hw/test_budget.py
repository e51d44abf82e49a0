"""Power, signals and mass: the sums are right and within their limits."""

import pytest

from hwtools import bom, budget, wiring
from hwtools.facts import load

CHECKS = budget.checks()


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: f"{check.board}, {check.what}")
def test_line_holds(check: budget.Check) -> None:
    assert check.holds, f"{check.value:.3g} {check.sense} {check.limit:.3g} {check.unit}"


def test_every_number_has_a_source() -> None:
    table = load(budget.SOURCE)
    numbers = [row for row in table.values() if isinstance(row, dict) and "value" in row]
    assert len(numbers) > 30
    assert all(row["source"] and row["what"] for row in numbers)
    for own in table["board"].values():
        assert own["draw_source"]
        assert own["led_source"]
    assert all(noise["source"] for noise in table["noise"])


def test_assumed_numbers_are_marked_in_the_report() -> None:
    rows = load(budget.SOURCE).values()
    assumed = [row for row in rows if isinstance(row, dict) and row.get("assumed")]
    report = budget.report_text()
    assert assumed
    assert all(f"*assumed*: {row['source']}" in report for row in assumed)


def test_sonar_supply_behind_its_resistor() -> None:
    # 100 ohm x 4.4 mA = 0.44 V
    assert budget.sonar_volts(budget.figures()) == pytest.approx(4.56)


def test_megas_own_pullups_count() -> None:
    # 4.7 kohm beside 10 kohm
    assert budget.bus_pullup_ohm("mega", budget.figures()) == pytest.approx(3197.3, abs=0.1)
    assert budget.bus_pullup_ohm("bluepill_f103", budget.figures()) == 4700


def test_longest_lead_is_where_the_rise_time_reaches_its_limit() -> None:
    f = budget.figures()
    for board in wiring.BOARDS:
        load_pf = budget.bus_capacitance_pf(budget.longest_lead_m(board, f), f)
        rise_ns = budget.RISE_30_TO_70 * budget.bus_pullup_ohm(board, f) * load_pf / 1e3
        assert rise_ns == pytest.approx(f.bus_rise_limit)


def test_check_is_strict_both_ways() -> None:
    def check(value: float, sense: budget.Sense) -> bool:
        return budget.Check("all", "", value, sense, 1.0, "", "").holds

    assert (check(1.0, "<="), check(1.001, "<="), check(1.0, ">="), check(0.999, ">=")) == (
        True,
        False,
        True,
        False,
    )


def test_mega_needs_its_shifter() -> None:
    straight = [c for c in CHECKS if c.board == "mega" and "RX, high" in c.what]
    assert "straight from the autopilot: 0.3 V" in straight[0].how


@pytest.mark.parametrize("board", wiring.BOARDS)
def test_build_is_lighter_than_the_payload_limit(board: str) -> None:
    # thesis Table 3: less than 2 lb
    assert bom.payload_limit_g() == pytest.approx(907.2, abs=0.1)
    assert sum(bom.masses_g(board).values()) < bom.payload_limit_g()


def test_mass_adds_up_the_parts_of_the_board_only() -> None:
    names = [part["name"] for part in bom.parts_for("bluepill_f103")]
    assert "Blue Pill F103C8" in names
    assert "Arduino Mega 2560" not in names
    by_hand = sum(p["quantity"] * p["mass_g"] for p in bom.parts_for("bluepill_f103"))
    assert bom.masses_g("bluepill_f103")["parts"] == pytest.approx(by_hand)


def test_wire_is_counted_from_the_drawings() -> None:
    # 22 AWG: battery 2 x 0.20, BEC 2 x 0.15, star ground 0.05 metres
    lengths = bom.wire_lengths_m("mega")
    assert lengths["22 AWG"] == pytest.approx(0.75)
    assert lengths["0.14 mm²"] == pytest.approx(budget.cable_length_m("W_SONAR"))


def test_every_part_says_what_for_and_what_else() -> None:
    for part in load(bom.SOURCE)["part"]:
        assert part["purpose"]
        assert part["alternatives"]
        assert part["mass_g"] > 0
        assert set(part.get("boards", [])) <= set(wiring.BOARDS)


def test_meter_readings_follow_the_board() -> None:
    def reading(board: str, where: str) -> str:
        return next(reads for _, at, reads in budget.meter_rows(board) if at.startswith(where))

    assert reading("mega", "SDA to") == "about 3.2 kohm"
    assert reading("bluepill_f103", "SDA to") == "about 4.7 kohm"
    assert reading("mega", "SDA and SCL").startswith("near 5 V")
    assert reading("mega", "board's TX") == "no short"
    assert reading("nucleo_f446", "board's TX") == "under 1 ohm"
    assert reading("nucleo_f446", "sonar's V+") == "about 4.56 V"
