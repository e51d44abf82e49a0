"""Power and signal budget: every check is computed from `budget.toml` and from the wiring."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from hwtools import wiring
from hwtools.facts import HW, WIRING, load

SOURCE = HW / "budget.toml"
REPORT = HW / "BUDGET.md"

METER_STAGES = (
    "1 no power, JP1 out, servos unplugged",
    "2 flight battery on, JP1 out, servos unplugged",
    "3 JP1 in, autopilot powered as in flight, servos unplugged",
)
Sense = Literal["<=", ">="]
ROUNDING = 1e-9  # two ways to the same number may differ in the last bits


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


class Figures:
    """The numbers of `budget.toml` by name."""

    def __init__(self, table: dict[str, Any]) -> None:
        self._table = table

    def __getattr__(self, name: str) -> float:
        return float(self._table[name]["value"])

    def board(self, board: str) -> dict[str, Any]:
        """Return a board's own figures."""
        return dict(self._table["board"][board])


def figures() -> Figures:
    """Read `budget.toml`."""
    return Figures(load(SOURCE))


def cable_length_m(cable: str) -> float:
    """Return a cable's length from the wiring's shared parts."""
    return float(wiring.read_sheet(WIRING / "parts.yml")["cables"][cable]["length"])


def checks() -> list[Check]:
    """Return the whole budget, common checks first."""
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
    """Return the pull-up of one bus line: ours, and the board's own in parallel."""
    own = f.board(board).get("onboard_pullup_ohm")
    return f.pullup if own is None else 1.0 / (1.0 / f.pullup + 1.0 / float(own))


def bus_capacitance_pf(length_m: float, f: Figures) -> float:
    """Return what one bus line has to be charged with, for a sonar lead of this length."""
    return 2 * f.pin_capacitance + f.carrier_capacitance + f.cable_capacitance * length_m


def longest_lead_m(board: str, f: Figures) -> float:
    """Return the longest sonar lead the rise time allows."""
    most_pf = f.bus_rise_limit / (RISE_30_TO_70 * bus_pullup_ohm(board, f)) * 1e3
    return (most_pf - bus_capacitance_pf(0.0, f)) / f.cable_capacitance


RISE_30_TO_70 = math.log(0.7 / 0.3)  # rise from 0.3 to 0.7 of the supply, in time constants


def _servo_supply(f: Figures) -> list[Check]:
    stalled = 2 * f.servo_stalled
    from_battery = stalled * f.supply / (f.battery_nominal * f.bec_efficiency)
    drop = (
        2 * cable_length_m("W_BEC") * f.wire_resistance_22awg * stalled
        + 2 * cable_length_m("W_PAN") * f.wire_resistance_28awg * f.servo_stalled
    ) / 1e3
    moving = 2 * f.servo_moving * f.supply / f.bec_efficiency / 1e3
    hover = f.battery_charge * f.battery_nominal / (f.flight_time / 60)
    return [
        Check(
            "all",
            "both servos stalled, from the BEC",
            stalled,
            "<=",
            f.bec_output,
            "mA",
            "2 servos",
        ),
        Check(
            "all",
            "BEC's input, battery full",
            f.battery_full,
            "<=",
            f.bec_most_input,
            "V",
            "4 cells",
        ),
        Check(
            "all",
            "F1 with both servos stalled",
            from_battery,
            "<=",
            f.fuse,
            "mA",
            "5 V current x 5 V / (battery x efficiency)",
        ),
        Check(
            "all",
            "voltage at a stalled servo",
            f.supply - drop,
            ">=",
            f.servo_least,
            "V",
            "5 V less the leads' drop, there and back",
        ),
        Check(
            "all",
            "both servos moving, share of the hover power",
            100 * moving / hover,
            "<=",
            1.0,
            "%",
            "hover: battery's energy over the flight time of Table 3",
        ),
    ]


def _sonar_supply(f: Figures) -> list[Check]:
    steady = sonar_volts(f)
    dip = f.sonar_peak * f.sonar_burst / f.filter_capacitor
    return [
        Check(
            "all",
            "sonar's supply at the end of a burst",
            steady - dip,
            ">=",
            f.sonar_least,
            "V",
            "5 V - R1 x average - peak x burst / C1",
        ),
        Check(
            "all",
            "R1 with the sonar shorted",
            f.supply**2 / f.filter_resistor,
            "<=",
            f.resistor_rating,
            "W",
            "5 V squared / R1",
        ),
    ]


def _board(board: str, f: Figures) -> list[Check]:
    own = f.board(board)
    logic = float(wiring.board_sheet(board)["metadata"]["logic_v"])
    pullup = bus_pullup_ohm(board, f)
    length = cable_length_m("W_SONAR")
    led = (logic - f.led_forward) / f.led_resistor * 1e3
    bus = 2 * (logic - f.bus_low) / pullup * 1e3
    burst = (f.supply - sonar_volts(f)) / f.filter_resistor * 1e3 + (
        f.sonar_peak * f.sonar_burst / f.filter_capacitor / f.filter_resistor * 1e3
    )
    shifter = 4 * logic / f.shifter_pullup * 1e3 if logic > f.autopilot_high else 0.0
    return [
        Check(
            board,
            "drawn from TELEM2",
            own["draw_ma"] + burst + led + bus + shifter,
            "<=",
            f.telem_limit,
            "mA",
            "board, sonar through R1 after a burst, LED, bus low, shifter",
        ),
        Check(
            board,
            "rise time of SDA and SCL",
            RISE_30_TO_70 * pullup * bus_capacitance_pf(length, f) / 1e3,
            "<=",
            f.bus_rise_limit,
            "ns",
            f"0.85 x {pullup:.0f} ohm x {bus_capacitance_pf(length, f):.0f} pF",
        ),
        Check(
            board,
            "sonar lead",
            length,
            "<=",
            longest_lead_m(board, f),
            "m",
            "the length at which the rise time reaches its limit",
        ),
        Check(
            board,
            "sink current of SDA and SCL",
            (logic - f.bus_low) / pullup * 1e3,
            "<=",
            f.bus_sink_limit,
            "mA",
            "(logic supply - 0.4 V) / pull-up",
        ),
        Check(
            board,
            "bus high, as the sonar wants it",
            logic,
            ">=",
            f.bus_high_share * sonar_volts(f),
            "V",
            "0.7 of its supply behind R1 (UM10204; PD11848 gives none)",
        ),
        Check(board, "servo signal, high", logic, ">=", f.servo_signal, "V", "an unloaded output"),
        Check(board, "LED", led, "<=", own["led_limit_ma"], "mA", "(logic supply - LED) / R4"),
        *_link(board, logic, f),
    ]


def _link(board: str, logic: float, f: Figures) -> list[Check]:
    """Return the autopilot link's levels: behind a shifter on a 5 V board, else straight."""
    if logic <= f.autopilot_high:
        return [
            Check(
                board, "board's TX into TELEM2", logic, "<=", f.autopilot_high, "V", "same levels"
            ),
        ]
    wants = f.mega_high_share * logic
    load_pf = f.shifter_capacitance + f.wire_capacitance * cable_length_m("W_TELEM")
    return [
        Check(
            board,
            "board's RX, high, behind the shifter",
            logic,
            ">=",
            wants + 1.0,
            "V",
            f"{wants:g} V wanted, 1 V of margin; straight from the autopilot: "
            f"{f.autopilot_high - wants:.1f} V",
        ),
        Check(
            board,
            "board's TX into TELEM2, behind the shifter",
            f.autopilot_high,
            "<=",
            f.autopilot_high,
            "V",
            f"without it: {logic:g} V",
        ),
        Check(
            board,
            "rise time behind the shifter",
            2.2 * f.shifter_pullup * load_pf / 1e6,
            "<=",
            0.5e6 / f.baud,
            "us",
            f"2.2 x 10 kohm x {load_pf:.0f} pF against half a bit",
        ),
    ]


def meter_rows(board: str) -> list[tuple[str, str, str]]:
    """Return what a multimeter shows on this board: (when, where, reading)."""
    f = figures()
    logic = float(wiring.board_sheet(board)["metadata"]["logic_v"])
    pullup = bus_pullup_ohm(board, f)
    link = "no short" if logic > f.autopilot_high else "under 1 ohm"
    dead, bec, live = METER_STAGES
    return [
        (dead, "GND of battery, BEC, board, sonar, servos, TELEM2", "joined, under 1 ohm"),
        (dead, "board's 5V to GND", "no short"),
        (dead, "servos' 5V to GND", "no short, once C2 has charged"),
        (dead, "servos' 5V to board's 5V", "open"),
        (dead, "board's 5V to the sonar's V+", f"{f.filter_resistor:.0f} ohm"),
        (dead, "SDA to the pull-ups' rail, and SCL", f"about {pullup / 1e3:.1f} kohm"),
        (dead, "sonar lead's shield to GND", "under 1 ohm"),
        (dead, "board's TX to TELEM2 pin 3, RX to pin 2", link),
        (bec, "servos' 5V", "4.9 to 5.1 V"),
        (live, "board's 5V", "4.8 to 5.2 V"),
        (live, "board's 3V3", "3.2 to 3.4 V"),
        (live, "sonar's V+", f"about {sonar_volts(f):.2f} V"),
        (live, "SDA and SCL, at the sonar", f"near {logic:g} V, dipping"),
        (live, "TELEM2 pins 2 and 3", f"near {f.autopilot_high:g} V, dipping"),
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
        "| board | what | value | limit | how |",
        "|---|---|---|---|---|",
        *(
            f"| {c.board} | {c.what} | {_number(c.value)} {c.unit} "
            f"| {c.sense} {_number(c.limit)} {c.unit} | {c.how} |"
            for c in checks()
        ),
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
