"""Power, signals and mass: the sums are right and within their limits."""

import pytest

from hwtools import bom, budget, levels, servos, wiring
from hwtools.facts import load
from hwtools.figures import SOURCE, figures

CHECKS = budget.checks()


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: f"{check.board}, {check.what}")
def test_line_holds(check: budget.Check) -> None:
    assert check.holds, f"{check.value:.3g} {check.sense} {check.limit:.3g} {check.unit}"


def test_every_number_has_a_source() -> None:
    table = load(SOURCE)
    numbers = [row for row in table.values() if isinstance(row, dict) and "value" in row]
    assert len(numbers) > 30
    assert all(row["source"] and row["what"] for row in numbers)
    for own in table["board"].values():
        assert own["draw_source"]
        assert own["led_source"]
    assert all(noise["source"] for noise in table["noise"])


def test_assumed_numbers_are_marked_in_the_report() -> None:
    rows = load(SOURCE).values()
    assumed = [row for row in rows if isinstance(row, dict) and row.get("assumed")]
    report = budget.report_text()
    assert assumed
    assert all(f"*assumed*: {row['source']}" in report for row in assumed)


def test_sonar_supply_behind_its_resistor() -> None:
    # 100 ohm x 4.4 mA = 0.44 V
    assert budget.sonar_volts(figures()) == pytest.approx(4.56)


def test_the_boards_or_the_modules_pullups_count() -> None:
    # 4.7 kohm beside 10 kohm: the mega's own, or the shifter module's
    for board in wiring.BOARDS:
        assert budget.bus_pullup_ohm(board, figures()) == pytest.approx(3197.3, abs=0.1)


def test_longest_lead_is_where_the_rise_time_reaches_its_limit() -> None:
    f = figures()
    for board in wiring.BOARDS:
        load_pf = budget.bus_capacitance_pf(board, budget.longest_lead_m(board, f), f)
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


@pytest.mark.parametrize("board", wiring.BOARDS)
def test_every_level_has_its_margin_at_the_worst_supply(board: str) -> None:
    found = levels.levels(board, figures())
    assert len(found) >= 11
    assert [level for level in found if not level.holds] == []
    assert all(level.wanted_v > 0.0 for level in found)


def margin_v(board: str, what: str) -> float:
    """A level's margin at the worst corner."""
    return next(one.margin_v for one in levels.levels(board, figures()) if one.what == what)


@pytest.mark.parametrize(
    ("board", "part", "what", "without_v"),
    [
        # 3.2 V against 0.7 x (5.2 - 0.44) V: the level that had no margin
        ("blackpill_f411", "BUS_SHIFTER", "SDA, SCL high, at the sonar", -0.13),
        # 3.2 - 0.1 V against 3.5 V
        ("bluepill_f103", "BUFFER", "servo's pulse, high", -0.40),
        # 3.2 - 0.1 V against 0.6 x 5.2 V, and 5.2 V on a port for 3.6 V
        ("mega", "SHIFTER", "board's RX, high", -0.02),
        ("mega", "SHIFTER", "board's TX at TELEM2, most", -1.60),
    ],
)
def test_a_level_without_its_part_has_no_margin(
    board: str, part: str, what: str, without_v: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert margin_v(board, what) > 0.0
    compose = wiring.compose

    def without(name: str, harness: str) -> wiring.Sheet:
        sheet = compose(name, harness)
        del sheet["connectors"][part]
        return sheet

    monkeypatch.setattr(wiring, "compose", without)
    assert margin_v(board, what) == pytest.approx(without_v, abs=0.005)


def test_the_worst_corner_is_taken() -> None:
    """Sonar high on its 5 V, board low on its 3.3 V: in no other corner is there less."""
    f = figures()
    assert len(levels.corners(f)) == 16
    worst = next(
        one for one in levels.levels("mega", f) if one.what == "SDA, SCL high, at the board"
    )
    # 4.8 V, behind R1 4.36 V: 4.7 kohm from there, 10 kohm from 4.8 V; 0.7 x 4.8 V
    assert worst.value_v == pytest.approx((4.36 / 4.7 + 4.8 / 10) / (1 / 4.7 + 1 / 10), abs=1e-3)
    assert worst.limit_v == pytest.approx(3.36)


def test_meter_accepts_what_the_levels_are_reckoned_with() -> None:
    f = figures()
    rows = {where: reads for _, where, reads in budget.meter_rows("mega")}
    assert rows["board's 5V"] == f"{f.supply_least:g} to {f.supply_most:g} V"
    assert rows["board's 3V3"] == f"{f.logic_least:g} to {f.logic_most:g} V"
    assert rows["servos' 5V"] == f"{f.bec_least:g} to {f.bec_most:g} V"


def test_servos_that_never_rest_are_in_the_budget() -> None:
    average = {c.what: c for c in CHECKS if c.what.startswith("both servos moving, the whole")}
    assert len(average) == 6
    servo = servos.Servo()
    from_bec = next(c for what, c in average.items() if "from the BEC" in what)
    assert from_bec.value == 2 * servo.moving
    peak = next(c for c in CHECKS if c.what == "both servos starting, or stalled: from the BEC")
    assert peak.value == 2 * servo.stalled > from_bec.value


def test_leads_of_a_boom_cost_voltage() -> None:
    # 0.15 m of 22 AWG for both, 0.30 m of 26 AWG and 0.25 m of 28 AWG for each; there and back
    f = figures()
    by_hand = 2 * (0.15 * 0.053 * 2 + 0.30 * 0.134 + 0.25 * 0.213) * 0.7
    assert budget.servo_volts(700.0, f) == pytest.approx(f.bec_least - by_hand)


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
    assert lengths["30 AWG"] == pytest.approx(4 * budget.cable_length_m("W_SONAR_TAIL"))


def test_every_part_says_what_for_and_what_else() -> None:
    for part in (*bom.parts(), *bom.parts("spare"), *bom.parts("leader")):
        assert part["purpose"]
        assert part["alternatives"]
        assert part["mass_g"] > 0
        assert set(part.get("boards", [])) <= set(wiring.BOARDS)


def test_meter_readings_follow_the_board() -> None:
    def reading(board: str, where: str) -> str:
        return next(reads for _, at, reads in budget.meter_rows(board) if at.startswith(where))

    assert reading("mega", "SDA to") == "about 3.2 kohm"
    assert reading("bluepill_f103", "board's SDA") == "no short"
    assert reading("mega", "board's SDA") == "under 1 ohm"
    assert reading("mega", "SDA and SCL, at the board").startswith("near 5 V")
    assert reading("mega", "board's PAN") == "under 1 ohm"
    assert reading("bluepill_f103", "board's PAN") == "no short"
    assert reading("mega", "board's TX") == "no short"
    assert reading("nucleo_f446", "board's TX") == "under 1 ohm"
    assert reading("nucleo_f446", "sonar's V+") == "4.4 to 4.8 V"


def test_servos_mass_is_the_servo_tables() -> None:
    on_mount = next(part for part in bom.parts() if "servo" in part)
    assert on_mount["mass_g"] == servos.Servo().mass
    assert on_mount["name"].startswith(servos.Servo().title)
