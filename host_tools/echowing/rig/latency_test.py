"""`echowing rig latency-test`: command to acknowledgement, reading to report."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.mavlink.messages import command_long
from echowing.rig.bench import Bench, add_bench_arguments, perform, positive, whole
from echowing.rig.readings import average_m, named_value, percentile
from echowing.rig.result import Check, Result

EXAMPLES = """\
examples:
  echowing rig latency-test --commands 200
"""

COMMANDS = 100
SECONDS = 20.0
# What the firmware keeps at its own pins (`echowing bench` measures it on the binary).
ACK_LIMIT_MS = 20.0
REPORT_LIMIT_MS = 10.0
# What lies between the board's pins and this program: a USB serial chip holds bytes back for up to
# 16 ms (FTDI's default latency timer; CH340 and CDC are quicker), the system some 4 ms.
HOST_MS = 20.0
# Of a hundred waits one may be this computer's own.
SHARE = 0.95
ANSWER_S = 1.0  # later than this is no answer
# A stamp is whole milliseconds, cut off: on average half of one too early.
HALF_STAMP_MS = 0.5
# A NAMED_VALUE_FLOAT on a wire of 10 bits a byte: header, payload of 18 bytes, checksum.
VALUE_BITS = (10 + 18 + 2) * 10

QUESTION = mavlink.MAV_CMD_REQUEST_MESSAGE
ASKED_FOR = mavlink.MAVLINK_MSG_ID_HEARTBEAT


@dataclass
class Clocks:
    """The board's clock against ours, by the fastest message that carries its time of sending.

    The firmware answers no TIMESYNC. Its NAMED_VALUE_FLOATs carry the time of their sending: of the
    one that came soonest after its stamp, all that is left is its own time on the wire. Times in
    ms; wire_ms: what such a message takes on the serial line. Reports count while there is a
    range: a sonar that detects nothing takes longer than a report's period, and a reading may wait.
    """

    wire_ms: float
    _sent: list[tuple[float, float]] = field(default_factory=list)
    _reports: list[tuple[float, float]] = field(default_factory=list)
    _reading_ms: int | None = None

    def hear(self, message: Any) -> None:
        """Take any message of the board."""
        arrival_ms = message._timestamp * 1000.0
        if named_value(message) is not None:
            self._sent.append((arrival_ms, message.time_boot_ms + HALF_STAMP_MS))
        elif message.get_type() == "DISTANCE_SENSOR" and average_m(message) is not None:
            self._hear_report(arrival_ms, int(message.time_boot_ms))

    def _hear_report(self, arrival_ms: float, reading_ms: int) -> None:
        """The first report of a reading counts: between readings it is repeated."""
        if reading_ms != self._reading_ms:
            self._reports.append((arrival_ms, reading_ms + HALF_STAMP_MS))
        self._reading_ms = reading_ms

    @property
    def offset_ms(self) -> float | None:
        """Our clock minus the board's; None before the first message."""
        if not self._sent:
            return None
        return min(arrival - stamp for arrival, stamp in self._sent) - self.wire_ms

    def report_ages_ms(self) -> list[float]:
        """Age of the newest reading in each report on arrival."""
        offset_ms = self.offset_ms
        if offset_ms is None:
            return []
        return [arrival - stamp - offset_ms for arrival, stamp in self._reports]


class LatencyTest:
    """The procedure: send a hundred commands, and listen for a while."""

    def __init__(self, commands: int, seconds: float, host_ms: float, baud: int) -> None:
        self._commands = commands
        self._seconds = seconds
        self._host_ms = host_ms
        self.acks_ms: list[float] = []
        self.lost = 0
        self.clocks = Clocks(wire_ms=VALUE_BITS / baud * 1000.0)

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        bench.ask("Put a target one to four metres in front of it, and leave it alone.")
        bench.centre()
        with bench.operator.progress("asking", self._commands, "commands") as show:
            for number in range(self._commands):
                show(number, "")
                self._ask(bench)
                # Out of step with reports every 50 ms, so that every phase of them is met.
                self._wait(bench, 0.013 + 0.029 * (number % 3))
        for message in bench.listen("listening to reports", self._seconds):
            self.clocks.hear(message)

    def _ask(self, bench: Bench) -> None:
        board = bench.board
        asked_s = bench.clock()
        board.send(
            command_long(board.system_id, QUESTION, ASKED_FOR, component_id=board.component_id)
        )
        while bench.clock() - asked_s < ANSWER_S:
            for message in bench.heard(0.05):
                self.clocks.hear(message)
                if message.get_type() == "COMMAND_ACK" and message.command == QUESTION:
                    self.acks_ms.append((message._timestamp - asked_s) * 1000.0)
                    return
        self.lost += 1

    def _wait(self, bench: Bench, duration_s: float) -> None:
        end_s = bench.clock() + duration_s
        while (left_s := end_s - bench.clock()) > 0.0:
            for message in bench.heard(left_s):
                self.clocks.hear(message)

    def result(self) -> Result:
        """As `Procedure`."""
        ages_ms = self.clocks.report_ages_ms()
        asked = len(self.acks_ms) + self.lost
        answered = Check(
            "commands answered", f"{len(self.acks_ms)} of {asked}", "all of them", self.lost == 0
        )
        checks = [
            answered,
            self._limit("command to acknowledgement", self.acks_ms, ACK_LIMIT_MS),
            self._limit("reading to report", ages_ms, REPORT_LIMIT_MS),
        ]
        named = {"command to acknowledgement": self.acks_ms, "reading to report": ages_ms}
        return Result(
            "latency-test",
            "Latency test",
            checks=checks,
            measured={
                "clock_offset_ms": self.clocks.offset_ms,
                "host_ms": self._host_ms,
                "unanswered": self.lost,
                "ack_ms": [round(value, 2) for value in self.acks_ms],
                "report_ms": [round(value, 2) for value in ages_ms],
            },
            grids=[_grid(named)],
            terminal_grids=[
                histogram_grid(name, values) for name, values in named.items() if values
            ],
            figures={
                "ack": histogram_figure(
                    "Command to acknowledgement", self.acks_ms, ACK_LIMIT_MS + self._host_ms
                ),
                "report": histogram_figure(
                    "Reading to report", ages_ms, REPORT_LIMIT_MS + self._host_ms
                ),
            },
            notes=[
                "The board's clock against this computer's: by the least delay of messages that "
                "are stamped as they are sent, less their time on the wire (the firmware answers "
                "no TIMESYNC). A line that holds every byte back adds that delay unseen."
            ],
        )

    def _limit(self, what: str, values_ms: Sequence[float], board_ms: float) -> Check:
        """Nearly all of them within the board's limit and the host's share."""
        limit_ms = board_ms + self._host_ms
        most_ms = percentile(values_ms, SHARE)
        found = (
            f"{SHARE:.0%} within {most_ms:.1f} ms" if values_ms else "no report of a target came"
        )
        asked = (
            f"under {limit_ms:g} ms: {board_ms:g} ms at the board's pins, "
            f"{self._host_ms:g} ms for the USB serial chip and this computer"
        )
        return Check(what, found, asked, bool(values_ms) and most_ms < limit_ms)


def _grid(named: dict[str, list[float]]) -> Grid:
    head = ("ms", "count", "least", "median", "95 %", "99 %", "most")
    rows = [
        Row((name, str(len(values)), *(f"{percentile(values, s):.1f}" for s in _SHARES)))
        for name, values in named.items()
        if values
    ]
    return Grid("Delays", head, tuple(rows))


_SHARES = (0.0, 0.5, 0.95, 0.99, 1.0)
_BINS = 12
_BAR = 40  # characters


def bins(values: Sequence[float], count: int = _BINS) -> list[tuple[float, float, int]]:
    """Histogram: (from, to, how many) in equal steps over the central 99 %.

    The last one also holds all beyond it.
    """
    low, high = min(values), percentile(values, 0.99)
    width = (high - low) / count or 1.0
    found = [0] * count
    for value in values:
        found[min(count - 1, int((value - low) / width))] += 1
    return [(low + i * width, low + (i + 1) * width, number) for i, number in enumerate(found)]


def histogram_grid(title: str, values: Sequence[float]) -> Grid:
    """The histogram in characters."""
    found = bins(values)
    most = max(number for _, _, number in found)
    rows = [
        Row(
            (
                f"{low:5.1f} to {high:5.1f}",
                str(number),
                ("█" * round(_BAR * number / most)).ljust(_BAR),
            )
        )
        for low, high, number in found
    ]
    return Grid(f"{title}, ms", ("from, to", "count", ""), tuple(rows))


def histogram_figure(title: str, values: Sequence[float], limit_ms: float) -> plots.Figure:
    """The histogram as a figure, the limit as an upright line."""
    trace = {
        "type": "histogram",
        "name": "",
        "x": [round(value, 2) for value in values],
        "nbinsx": 60,
        "marker": {"color": plots.FOLLOWER_COLOUR},
    }
    figure = plots.chart(title, "ms", "how many", [trace])
    figure["layout"]["xaxis"]["range"] = [0, 1.15 * max([limit_ms, *values])]
    label = f"limit {limit_ms:g} ms"
    return plots.with_upright(figure, limit_ms, label, plots.GOOD_COLOUR)


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    parser.add_argument("--commands", type=whole, default=COMMANDS, metavar="N", help="asked (100)")
    parser.add_argument(
        "--seconds",
        type=positive,
        default=SECONDS,
        metavar="S",
        help="seconds to listen for reports (20)",
    )
    parser.add_argument(
        "--host-ms",
        type=positive,
        default=HOST_MS,
        metavar="MS",
        help=f"what USB and this computer may add to the board's own limits ({HOST_MS:g})",
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""
    return perform(LatencyTest(args.commands, args.seconds, args.host_ms, args.baud), args)
