"""Every logic level at the worst of the accepted supplies, with its margin.

What stands between two pins is read from the wiring: take a shifter or the buffer out of a harness,
and its level has no margin here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

from hwtools import servos, wiring
from hwtools.figures import Figures

Volts = Callable[["Corner"], float]


@dataclass(frozen=True, slots=True)
class Corner:
    """One set of supplies, volts: board's 5V, its 3V3, the autopilot's 3.3 V, the servos' 5 V."""

    five: float
    three: float
    autopilot: float
    bec: float


@dataclass(frozen=True, slots=True)
class Level:
    """A level at its worst corner; the margin counts from the limit to its good side."""

    board: str
    what: str
    value_v: float
    limit_v: float
    margin_v: float
    wanted_v: float

    @property
    def holds(self) -> bool:
        """Whether the margin is as wanted."""
        return self.margin_v >= self.wanted_v


@dataclass(frozen=True, slots=True)
class Wires:
    """What a board's wiring puts between the pins."""

    board: str
    logic_5v: bool
    bus_shifter: bool
    buffer: bool
    link_shifter: bool

    def logic(self, at: Corner) -> float:
        """The board's logic supply."""
        return at.five if self.logic_5v else at.three


def wires(board: str) -> Wires:
    """Return what stands in a board's harnesses."""
    parts = wiring.compose(board, wiring.OVERVIEW)["connectors"]
    logic_v = float(wiring.board_sheet(board)["metadata"]["logic_v"])
    return Wires(board, logic_v == 5.0, *(name in parts for name in STANDING))


STANDING = ("BUS_SHIFTER", "BUFFER", "SHIFTER")


def sonar_supply(at: Corner, f: Figures) -> float:
    """Return the sonar's supply behind R1, between bursts."""
    return at.five - f.filter_resistor * f.sonar_average / 1e3


def levels(board: str, f: Figures) -> list[Level]:
    """Return every level of a board's wiring."""
    w = wires(board)
    return [*_bus(w, f), *_pulses(w, f), *_link(w, f)]


def _bus(w: Wires, f: Figures) -> list[Level]:
    """SDA and SCL, at the sonar and at the board."""

    def supply(at: Corner) -> float:
        return sonar_supply(at, f)

    def pulled(at: Corner) -> float:
        """Where R2 and R3, and the pull-ups of board or module beside them, hold the bus."""
        own = f.board(w.board).get("onboard_pullup_ohm")
        ours, theirs = 1 / f.pullup, 0.0 if own is None else 1 / float(own)
        return (supply(at) * ours + w.logic(at) * theirs) / (ours + theirs)

    # Without a shifter one pull-up voltage must do for both: the board's own.
    straight = w.logic if not (w.bus_shifter or w.logic_5v) else pulled
    at_board = w.logic if w.bus_shifter else straight
    low = f.bus_low + (f.shifter_drop if w.bus_shifter else 0.0)
    high, lows = f.bus_high_share, f.bus_low_share
    found = [
        _high(w, "SDA, SCL high, at the sonar", straight, lambda at: high * supply(at),
              lambda at: f.bus_high_margin * supply(at), f),
        _high(w, "SDA, SCL high, at the board", at_board, lambda at: high * w.logic(at),
              lambda at: f.bus_high_margin * w.logic(at), f),
        _low(w, "SDA, SCL low, at the sonar", lambda _: low, lambda at: lows * supply(at),
             lambda at: f.bus_low_margin * supply(at), f),
        _low(w, "SDA, SCL low, at the board", lambda _: low, lambda at: lows * w.logic(at),
             lambda at: f.bus_low_margin * w.logic(at), f),
        _low(w, "SDA, SCL high, above the sonar's supply", straight,
             lambda at: supply(at) + f.above_supply, lambda _: f.over_margin, f),
    ]  # fmt: skip
    return [*found, *([_gate(w, "bus shifter's gate", f)] if w.bus_shifter else [])]


def _pulses(w: Wires, f: Figures) -> list[Level]:
    """The servos' pulses."""
    wanted = servos.Servo().signal
    if not w.buffer:
        return [_plain(w, "servo's pulse, high", lambda at: w.logic(at) - f.output_drop, wanted, f)]
    return [
        _plain(w, "buffer's input, high", lambda at: at.three - f.output_drop, f.buffer_high, f),
        _plain(w, "servo's pulse, high", lambda at: at.bec - f.output_drop, wanted, f),
    ]


def _link(w: Wires, f: Figures) -> list[Level]:
    """The autopilot's port: behind a shifter, or straight."""
    shifted, margin = w.link_shifter, lambda _: f.level_margin

    def to_autopilot(at: Corner) -> float:
        return at.three if shifted else w.logic(at) - f.output_drop

    def to_board(at: Corner) -> float:
        return at.five if shifted else at.autopilot - f.output_drop

    share = f.mega_high_share if w.logic_5v else f.cmos_high_share
    low = f.output_low + (f.shifter_drop if shifted else 0.0)
    found = [
        _high(w, "board's TX at TELEM2, high", to_autopilot,
              lambda at: f.cmos_high_share * at.autopilot, margin, f),
        _low(w, "board's TX at TELEM2, most",
             lambda at: at.three if shifted else w.logic(at), lambda _: f.port_most,
             lambda _: f.over_margin, f),
        _low(w, "board's TX at TELEM2, low", lambda _: low,
             lambda at: f.cmos_low_share * at.autopilot, margin, f),
        _high(w, "board's RX, high", to_board, lambda at: share * w.logic(at), margin, f),
        _low(w, "board's RX, low", lambda _: low, lambda at: f.cmos_low_share * w.logic(at),
             margin, f),
    ]  # fmt: skip
    return [*found, *([_gate(w, "link shifter's gate", f)] if shifted else [])]


def _gate(w: Wires, what: str, f: Figures) -> Level:
    """A shifter's transistor must be on while a low level passes."""
    on = f.shifter_threshold + f.output_low
    return _plain(w, what, lambda at: at.three, on, f)


def _plain(w: Wires, what: str, value: Volts, least: float, f: Figures) -> Level:
    return _high(w, what, value, lambda _: least, lambda _: f.level_margin, f)


def _high(w: Wires, what: str, value: Volts, least: Volts, wanted: Volts, f: Figures) -> Level:
    return _worst(w, what, value, least, wanted, 1.0, f)


def _low(w: Wires, what: str, value: Volts, most: Volts, wanted: Volts, f: Figures) -> Level:
    return _worst(w, what, value, most, wanted, -1.0, f)


def _worst(
    w: Wires, what: str, value: Volts, limit: Volts, wanted: Volts, sign: float, f: Figures
) -> Level:
    """Return the level at the corner where least is left over what is wanted."""
    at_corners = [
        Level(w.board, what, value(at), limit(at), sign * (value(at) - limit(at)), wanted(at))
        for at in corners(f)
    ]
    return min(at_corners, key=lambda level: level.margin_v - level.wanted_v)


def corners(f: Figures) -> list[Corner]:
    """Return every set of least and most accepted supplies."""
    return [
        Corner(*supplies)
        for supplies in product(
            (f.supply_least, f.supply_most),
            (f.logic_least, f.logic_most),
            (f.logic_least, f.logic_most),
            (f.bec_least, f.bec_most),
        )
    ]


def table(boards: tuple[str, ...], f: Figures) -> list[str]:
    """Return all boards' levels as a Markdown table."""
    return [
        "| board | level | at the worst, V | limit, V | margin, V | wanted, V |",
        "|---|---|---|---|---|---|",
        *(
            f"| {one.board} | {one.what} | {one.value_v:.2f} | {one.limit_v:.2f} "
            f"| {one.margin_v:.2f} | {one.wanted_v:.2f} |"
            for board in boards
            for one in levels(board, f)
        ),
    ]
