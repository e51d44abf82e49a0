"""Power and signal budget: every check is computed from `budget.toml` and from the wiring."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hwtools import levels, servos, wiring
from hwtools.facts import HW, WIRING, load
from hwtools.figures import SOURCE, Figures, figures

REPORT = HW / "BUDGET.md"

METER_STAGES = (
    "1 no power, JP1 out, servos unplugged",
    "2 flight battery on, JP1 out, servos unplugged",
    "3 JP1 in, autopilot powered as in flight, servos unplugged",
)
Sense = Literal["<=", ">="]
ROUNDING = 1e-9  # two ways to the same number may differ in the last bits
RISE_30_TO_70 = math.log(0.7 / 0.3)  # rise from 0.3 to 0.7 of the supply, in time constants


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the budget: a computed value against its limit."""

    board: str
    what: str
    value: float
    sense: Sense
    limit: float
    unit: str
    how: str

    @property
    def holds(self) -> bool:
        """Whether the value is within its limit."""
        over = self.value - self.limit
        return over <= ROUNDING if self.sense == "<=" else over >= -ROUNDING


def cable_length_m(cable: str) -> float:
    """Return a cable's length from the wiring's shared parts."""
    return float(wiring.read_sheet(WIRING / "parts.yml")["cables"][cable]["length"])


def checks() -> list[Check]:
    """Return the whole budget but the levels, common checks first."""
    found = figures()
    return [
        *_servo_supply(found),
        *_sonar_supply(found),
        *(check for board in wiring.BOARDS for check in _board(board, found)),
    ]


def sonar_volts(f: Figures) -> float:
    """Return the sonar's supply behind R1, between bursts."""
    return f.supply - f.filter_resistor * f.sonar_average / 1e3


def bus_pullup_ohm(board: str, f: Figures) -> float:
    """Return the pull-up of one bus line at the sonar: ours, beside it the board's or module's."""
    own = f.board(board).get("onboard_pullup_ohm")
    beside = f.shifter_pullup if levels.wires(board).bus_shifter else own
    return f.pullup if beside is None else 1.0 / (1.0 / f.pullup + 1.0 / float(beside))


def bus_capacitance_pf(board: str, length_m: float, f: Figures) -> float:
    """Return what one bus line has to be charged with, for a sonar lead of this length."""
    shifter = f.shifter_capacitance if levels.wires(board).bus_shifter else 0.0
    return 2 * f.pin_capacitance + f.carrier_capacitance + shifter + f.cable_capacitance * length_m


def sonar_lead_m() -> float:
    """Return the sonar lead's length, its soft end with it."""
    return cable_length_m("W_SONAR") + cable_length_m("W_SONAR_TAIL")


def longest_lead_m(board: str, f: Figures) -> float:
    """Return the longest sonar lead the rise time allows."""
    most_pf = f.bus_rise_limit / (RISE_30_TO_70 * bus_pullup_ohm(board, f)) * 1e3
    return (most_pf - bus_capacitance_pf(board, 0.0, f)) / f.cable_capacitance


def servo_volts(each_ma: float, f: Figures) -> float:
    """Return a servo's supply while both draw this, the BEC's output at its least."""
    own = f.servo_lead * f.wire_resistance_28awg + cable_length_m("W_PAN") * f.wire_resistance_26awg
    shared = cable_length_m("W_BEC") * f.wire_resistance_22awg
    return f.bec_least - 2 * (shared * 2 * each_ma + own * each_ma) / 1e3


def _servo_supply(f: Figures) -> list[Check]:
    servo = servos.Servo()
    moving, stalled = 2 * servo.moving, 2 * servo.stalled
    per_ma = f.supply / (f.battery_nominal * f.bec_efficiency)
    moving_w = moving * f.supply / f.bec_efficiency / 1e3
    lost = f.supply * (1 / f.bec_efficiency - 1) / 1e3  # watts a milliampere
    hover_w = f.battery_charge * f.battery_nominal / (f.flight_time / 60)
    average = "both servos moving, the whole flight"
    peak = "both servos starting, or stalled"
    return [
        Check("all", f"{average}: from the BEC", moving, "<=", f.bec_output / 2, "mA",
              "2 servos; half of what the BEC gives, so that it stays cool"),
        Check("all", f"{peak}: from the BEC", stalled, "<=", f.bec_output, "mA",
              "2 servos: each small move begins with the motor at rest"),
        Check("all", f"{average}: heat in the BEC", moving * lost, "<=", f.bec_output / 2 * lost,
              "W", "output x (1 / efficiency - 1), against half of its rated current"),
        Check("all", f"{average}: heat in a servo", servo.moving * f.supply / 1e3, "<=",
              f.servo_heat, "W", "all that it draws, as nothing is lifted"),
        Check("all", f"{average}: share of the hover power", 100 * moving_w / hover_w, "<=", 1.0,
              "%", f"{moving_w:.1f} W; hover: battery's energy over the flight time of Table 3"),
        Check("all", f"{average}: flight that is lost", f.flight_time * 60 * moving_w / hover_w,
              "<=", 10.0, "s", "that share of the flight time"),
        Check("all", f"{average}: F1", moving * per_ma, "<=", f.fuse / 2, "mA",
              "5 V current x 5 V / (battery x efficiency); a fuse lasts at half its rating"),
        Check("all", f"{peak}: F1", stalled * per_ma, "<=", f.fuse, "mA", "the same"),
        Check("all", "BEC's input, battery full", f.battery_full, "<=", f.bec_most_input, "V",
              "4 cells"),
        Check("all", "voltage at a moving servo", servo_volts(servo.moving, f), ">=",
              servo.least_volts, "V", "BEC's least, less the leads' drop, there and back"),
        Check("all", "voltage at a stalled servo", servo_volts(servo.stalled, f), ">=",
              f.servo_brownout, "V", "the same: its electronics go on"),
    ]  # fmt: skip


def _sonar_supply(f: Figures) -> list[Check]:
    lost = f.filter_resistor * f.sonar_average / 1e3
    dip = f.sonar_peak * f.sonar_burst / f.filter_capacitor
    return [
        Check("all", "sonar's supply at the end of a burst", f.supply_least - lost - dip, ">=",
              f.sonar_least, "V", "least 5V - R1 x average - peak x burst / C1"),
        Check("all", "R1 with the sonar shorted", f.supply_most**2 / f.filter_resistor,
              "<=", f.resistor_rating, "W", "most 5V squared / R1"),
    ]  # fmt: skip


def _board(board: str, f: Figures) -> list[Check]:
    own, wired = f.board(board), levels.wires(board)
    logic = float(wiring.board_sheet(board)["metadata"]["logic_v"])
    pullup, length = bus_pullup_ohm(board, f), sonar_lead_m()
    led = (logic - f.led_forward) / f.led_resistor * 1e3
    # A line that is held low carries both sides' pull-ups.
    low = (sonar_volts(f) - f.bus_low) / pullup * 1e3
    low += f.logic_most / f.shifter_pullup * 1e3 if wired.bus_shifter else 0.0
    burst = (f.supply - sonar_volts(f)) / f.filter_resistor * 1e3 + (
        f.sonar_peak * f.sonar_burst / f.filter_capacitor / f.filter_resistor * 1e3
    )
    link = 4 * logic / f.shifter_pullup * 1e3 if wired.link_shifter else 0.0
    load_pf = bus_capacitance_pf(board, length, f)
    found = [
        Check(board, "drawn from TELEM2", own["draw_ma"] + burst + led + 2 * low + link, "<=",
              f.telem_limit, "mA", "board, sonar through R1 after a burst, LED, bus low, shifter"),
        Check(board, "rise time of SDA and SCL, sonar's side", _rise_ns(pullup, load_pf), "<=",
              f.bus_rise_limit, "ns", f"0.85 x {pullup:.0f} ohm x {load_pf:.0f} pF"),
        Check(board, "sonar lead", length, "<=", longest_lead_m(board, f), "m",
              "the length at which the rise time reaches its limit"),
        Check(board, "sink current of SDA and SCL", low, "<=", f.bus_sink_limit, "mA",
              "(supply - 0.4 V) / pull-up, both sides of a shifter"),
        Check(board, "LED", led, "<=", own["led_limit_ma"], "mA", "(logic supply - LED) / R4"),
    ]  # fmt: skip
    if wired.bus_shifter:
        near_pf = f.pin_capacitance + f.carrier_capacitance + f.shifter_capacitance
        rise = _rise_ns(f.shifter_pullup, near_pf)
        found.append(
            Check(board, "rise time of SDA and SCL, board's side", rise, "<=", f.bus_rise_limit,
                  "ns", f"0.85 x 10 kohm x {near_pf:.0f} pF")
        )  # fmt: skip
    if wired.link_shifter:
        load_pf = f.shifter_capacitance + f.wire_capacitance * cable_length_m("W_TELEM")
        rise = 2.2 * f.shifter_pullup * load_pf / 1e6
        how = f"2.2 x 10 kohm x {load_pf:.0f} pF against half a bit"
        found.append(
            Check(board, "rise time behind the shifter", rise, "<=", 0.5e6 / f.baud, "us", how)
        )
    return found


def _rise_ns(pullup_ohm: float, load_pf: float) -> float:
    return RISE_30_TO_70 * pullup_ohm * load_pf / 1e3


def meter_rows(board: str) -> list[tuple[str, str, str]]:
    """Return what a multimeter shows on this board: (when, where, reading)."""
    f, wired = figures(), levels.wires(board)
    logic = float(wiring.board_sheet(board)["metadata"]["logic_v"])
    link = "no short" if wired.link_shifter else "under 1 ohm"
    pulse = "no short" if wired.buffer else "under 1 ohm"
    pullup = f"about {bus_pullup_ohm(board, f) / 1e3:.1f} kohm"
    least, most = (
        levels.sonar_supply(at, f) for at in (levels.corners(f)[0], levels.corners(f)[-1])
    )
    dead, bec, live = METER_STAGES
    return [
        (dead, "GND of battery, BEC, board, sonar, servos, TELEM2", "joined, under 1 ohm"),
        (dead, "board's 5V to GND", "no short"),
        (dead, "servos' 5V to GND", "no short, once C2 has charged"),
        (dead, "servos' 5V to board's 5V", "open"),
        (dead, "board's 5V to the sonar's V+", f"{f.filter_resistor:.0f} ohm"),
        (dead, "SDA to the sonar's V+, and SCL", pullup),
        (dead, "board's SDA to the sonar's, and SCL", _joined(wired.bus_shifter)),
        (dead, "board's PAN to the servo's signal, and TILT", pulse),
        (dead, "sonar lead's shield to GND", "under 1 ohm"),
        (dead, "board's TX to TELEM2 pin 3, RX to pin 2", link),
        (bec, "servos' 5V", f"{f.bec_least:g} to {f.bec_most:g} V"),
        (live, "board's 5V", f"{f.supply_least:g} to {f.supply_most:g} V"),
        (live, "board's 3V3", f"{f.logic_least:g} to {f.logic_most:g} V"),
        (live, "sonar's V+", f"{least:.1f} to {most:.1f} V"),
        (live, "SDA and SCL, at the sonar", "near the sonar's V+, dipping"),
        (live, "SDA and SCL, at the board", f"near {logic:g} V, dipping"),
        (live, "TELEM2 pins 2 and 3", f"near {f.autopilot_high:g} V, dipping"),
    ]


def _joined(shifter: bool) -> str:
    return "no short" if shifter else "under 1 ohm"


def check_table(found: Sequence[Check], first: str) -> list[str]:
    """Return checks as a Markdown table."""
    return [
        f"| {first} | what | value | limit | how |",
        "|---|---|---|---|---|",
        *(
            f"| {c.board} | {c.what} | {_number(c.value)}{_unit(c.unit)} "
            f"| {c.sense} {_number(c.limit)}{_unit(c.unit)} | {c.how} |"
            for c in found
        ),
    ]


def _meter_table() -> list[str]:
    by_board = {board: meter_rows(board) for board in wiring.BOARDS}
    rows = by_board[wiring.BOARDS[0]]
    return [
        "| when | where | " + " | ".join(wiring.BOARDS) + " |",
        "|---|---|" + "---|" * len(wiring.BOARDS),
        *(
            f"| {when} | {where} | " + " | ".join(by_board[b][i][2] for b in wiring.BOARDS) + " |"
            for i, (when, where, _) in enumerate(rows)
        ),
    ]


def report_text() -> str:
    """Return BUDGET.md."""
    table = load(SOURCE)
    lines = [
        "# Power and signal budget",
        "",
        "Written by `make hw` from `budget.toml` and the wiring's lengths; a test keeps it current",
        "and checks that every line holds.",
        "",
        "## Checks",
        "",
        *check_table(checks(), "board"),
        "",
        "The servos steady the sonar all the time. The lines take them to move under load all the",
        "time, too, which is more. Their figures: [mount/MOTION.md](mount/MOTION.md).",
        "",
        "## Levels",
        "",
        "At the worst of the supplies that the meter's table accepts, everywhere at once.",
        "",
        *levels.table(wiring.BOARDS, figures()),
        "",
        "## What a multimeter shows",
        "",
        "In this order; stop at the first that differs. The sonar's supply tells most: at the",
        "board's 5V the sonar is not connected, far below 4 V something behind R1 is shorted.",
        "",
        *_meter_table(),
        "",
        "## Where noise gets in",
        "",
        "| how | remedy | source |",
        "|---|---|---|",
        *(f"| {n['enters']} | {n['remedy']} | {n['source']} |" for n in table["noise"]),
        "",
        "## Numbers and their sources",
        "",
        "Lines marked *assumed* have no source that we found: measure, then change `budget.toml`.",
        "",
        "| what | value | source |",
        "|---|---|---|",
        *(
            f"| {row['what']} | {_number(row['value'])}{_unit(row['unit'])} | {_sourced(row)} |"
            for row in table.values()
            if isinstance(row, dict) and "value" in row
        ),
        *(line for board in wiring.BOARDS for line in _board_sources(board, table["board"][board])),
        "",
    ]
    return "\n".join(lines)


def _board_sources(board: str, own: dict[str, Any]) -> list[str]:
    lines = [
        f"| {board}: the board itself | {own['draw_ma']} mA | {own['draw_source']} |",
        f"| {board}: LED's pin | {own['led_limit_ma']} mA | {own['led_source']} |",
    ]
    if "onboard_pullup_ohm" in own:
        lines.append(
            f"| {board}: pull-ups on the board | {own['onboard_pullup_ohm']} ohm "
            f"| {own['pullup_source']} |"
        )
    return lines


def _sourced(row: dict[str, Any]) -> str:
    return f"*assumed*: {row['source']}" if row.get("assumed") else str(row["source"])


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
