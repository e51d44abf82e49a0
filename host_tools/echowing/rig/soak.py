"""`echowing rig soak`: hours of it, everything counted, a row a minute."""

import contextlib
import csv
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis import plots
from echowing.analysis.tables import Grid, Row
from echowing.errors import EchowingError
from echowing.rig.bench import POLL_S, Bench, add_bench_arguments, perform, positive
from echowing.rig.board import Board, open_board
from echowing.rig.ports import START_AGAIN, PortLostError
from echowing.rig.readings import FAULT, average_m, heard_m, named_value, spread
from echowing.rig.result import Check, Result
from echowing.rig.state import STATE_NAMES

EXAMPLES = """\
examples:
  echowing rig soak --hours 12 --out out/soak
      soak.csv gets one row per minute; you can read it while the test runs
"""

ROW_S = 60.0
HOURS = 1.0
# The firmware tells no range older than this (firmware/README.md): a longer gap is one to be seen.
GAP_MS = 300.0
# ArduPilot shows a rangefinder as gone after this (AP_RangeFinder_MAVLink.cpp).
SILENT_S = 0.5
# A cable of good make loses nothing; one frame in a thousand is one in 20 s.
MOST_LOST_SHARE = 1e-3
# Reports keep to a beat, and a beat without a fresh reading is left out.
LEAST_REPORT_SHARE = 0.95
# Half of Table 6's monitor band: a range that drifts more moves the formation.
MOST_DRIFT_M = 0.05
WRAP_MS = 2**32  # time_boot_ms, after 49.7 days
REOPEN_S = 1.0


@dataclass
class Tally:
    """Counts since the start, or of one row. Times of the board in ms, of the host in s."""

    reports: int = 0
    gaps: int = 0
    readings: int = 0
    misses: int = 0
    damaged: int = 0
    lost: int = 0
    reboots: int = 0
    unplugged: int = 0
    sonar_faults: int = 0
    state_changes: int = 0
    texts: int = 0
    warnings: int = 0
    listened_s: float = 0.0

    def since(self, before: "Tally") -> "Tally":
        """What has been counted since then."""
        return Tally(*(getattr(self, f.name) - getattr(before, f.name) for f in fields(Tally)))


@dataclass
class Minute:
    """One row: when it ended, what was counted in it, and the range while there was one."""

    end_s: float
    tally: Tally
    range_m: float | None
    spread_m: float | None


@dataclass
class Soak:
    """Counts everything the board says. Pure: messages and times in.

    row_s: length of a row; `rows` are those that have ended.
    """

    start_s: float
    row_s: float = ROW_S
    total: Tally = field(default_factory=Tally)
    rows: list[Minute] = field(default_factory=list)
    words: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    boards_ms: float = 0.0  # time that passed on the board's clock
    _before: Tally = field(default_factory=Tally)
    _ranges_m: list[float] = field(default_factory=list)
    _state: float | None = None
    _newest_ms: int | None = None
    _report_ms: int | None = None

    def hear(self, message: Any) -> None:
        """Take any message of the board's."""
        kind = message.get_type()
        if kind == "DISTANCE_SENSOR":
            self._hear_report(message)
        elif kind == "NAMED_VALUE_FLOAT":
            self._hear_clock(int(message.time_boot_ms))
            self._hear_value(message)
        elif kind == "STATUSTEXT":
            self.total.texts += 1
            self.total.warnings += message.severity <= mavlink.MAV_SEVERITY_WARNING
            self.words[str(message.text)] += 1

    def _hear_report(self, report: Any) -> None:
        self.total.reports += 1
        at_ms = int(report.time_boot_ms)
        passed_ms = (at_ms - self._report_ms) % WRAP_MS if self._report_ms is not None else 0
        self.total.gaps += GAP_MS < passed_ms < WRAP_MS / 2
        self._report_ms = at_ms
        range_m = average_m(report)
        if range_m is not None:
            self._ranges_m.append(range_m)

    def _hear_clock(self, at_ms: int) -> None:
        """The values are stamped as they are sent: back means a restart, unless it has wrapped."""
        if self._newest_ms is not None:
            passed_ms = (at_ms - self._newest_ms) % WRAP_MS
            rebooted = passed_ms > WRAP_MS / 2
            self.total.reboots += rebooted
            self.boards_ms += at_ms if rebooted else passed_ms
            self._report_ms = None if rebooted else self._report_ms
        self._newest_ms = at_ms

    def _hear_value(self, message: Any) -> None:
        name, value = named_value(message) or ("", 0.0)
        if name == "SNR_RAW":
            self.total.readings += 1
            self.total.misses += heard_m(value) is None
        if name != "SNR_STATE" or value == self._state:
            return
        known = 0 <= int(value) < len(STATE_NAMES)
        self.states[STATE_NAMES[int(value)] if known else f"state {value:g}"] += 1
        self.total.sonar_faults += value == FAULT
        self.total.state_changes += self._state is not None
        self._state = value

    def unplugged(self) -> None:
        """The connection has gone. What is missed meanwhile is no gap, and no reboot unseen."""
        self.total.unplugged += 1
        self._report_ms = None

    def replugged(self) -> None:
        """It is back: plugging in may have restarted the board, which is no fault of its own."""
        self._newest_ms = self._report_ms = self._state = None

    def pass_time(self, now_s: float, damaged: int, lost: int, listened_s: float) -> list[Minute]:
        """Time goes on; returns the rows that have ended. damaged, lost: since the start."""
        self.total.damaged, self.total.lost = damaged, lost
        self.total.listened_s += listened_s
        ended = []
        while now_s >= self.start_s + (len(self.rows) + 1) * self.row_s:
            ended.append(self._end_row())
        return ended

    def _end_row(self) -> Minute:
        found = spread(self._ranges_m)
        known = bool(self._ranges_m)
        row = Minute(
            (len(self.rows) + 1) * self.row_s,
            self.total.since(self._before),
            found.mean if known else None,
            found.std if len(self._ranges_m) > 1 else None,
        )
        self.rows.append(row)
        self._before = Tally(**vars(self.total))
        self._ranges_m.clear()
        return row

    @property
    def drift_m(self) -> float | None:
        """The farthest that a row's mean range got from the first row's; None without two."""
        ranges_m = [row.range_m for row in self.rows if row.range_m is not None]
        if len(ranges_m) < 2:
            return None
        return max((r - ranges_m[0] for r in ranges_m), key=abs)


COLUMNS = ("end_s", *(f.name for f in fields(Tally)), "range_m", "spread_m")


class SoakTest:
    """The procedure: listen, through everything."""

    def __init__(
        self,
        duration_s: float,
        row_s: float,
        out: Path,
        reopen: Callable[[str], Board],
        *,
        still: bool,
    ) -> None:
        self._duration_s = duration_s
        self._row_s = row_s
        self._out = out
        self._reopen = reopen
        self._still = still
        self._rate_hz = 0.0
        self._counted_before = (0, 0)  # damaged and lost on connections that have gone
        self.soak: Soak | None = None

    def run(self, bench: Bench) -> None:
        """As `Procedure`."""
        self._rate_hz = bench.board.parameters()["REPORT_RATE"]
        bench.ask("Put a target that stands still in front of it, or leave it open.")
        self._start_counting(bench.board)
        start_s = bench.clock()
        self.soak = soak = Soak(start_s, self._row_s)
        with self._table() as write, bench.operator.progress("soaking", self._duration_s) as show:
            then_s, end_s = start_s, start_s + self._duration_s
            while (now_s := bench.clock()) < end_s:
                listening = self._listen(bench, soak, then_s)
                damaged, lost = self._counted(bench.board)
                now_s = bench.clock()
                heard_s = now_s - then_s if listening else 0.0
                # A machine that stood still ends later than by this, but with as many rows.
                in_time_s = min(now_s, end_s + POLL_S)
                write(soak.pass_time(in_time_s, damaged, lost, heard_s))
                show(now_s - start_s, _brief(soak.total))
                then_s = now_s

    def _listen(self, bench: Bench, soak: Soak, then_s: float) -> bool:
        """A moment of listening; False: there was nothing to listen to."""
        try:
            for message in bench.heard(POLL_S):
                soak.hear(message)
        except PortLostError as error:
            soak.unplugged()
            words = str(error).removesuffix(START_AGAIN)
            bench.operator.tell(f"{words}; waiting for the board")
            self._await(bench, soak)
            return False
        return True

    def _await(self, bench: Bench, soak: Soak) -> None:
        """Open it again as soon as it can be; until the time is over."""
        damaged, lost = self._counted(bench.board)
        self._counted_before = (damaged, lost)
        bench.connected = False
        bench.board.close()
        end_s = soak.start_s + self._duration_s
        while bench.clock() < end_s:
            try:
                bench.board = self._reopen(bench.board.name)
            except EchowingError:
                bench.pause(REOPEN_S)
                continue
            bench.connected = True
            counts = bench.board.frames.counts
            self._counted_before = (damaged - counts.damaged, lost - counts.lost)
            soak.replugged()
            bench.operator.tell("the board is connected again")
            return
        raise EchowingError("the board was unplugged and not connected again")

    def _start_counting(self, board: Board) -> None:
        """What was damaged while the port was opened does not count."""
        counts = board.frames.counts
        self._counted_before = (-counts.damaged, -counts.lost)

    def _counted(self, board: Board) -> tuple[int, int]:
        counts = board.frames.counts
        return self._counted_before[0] + counts.damaged, self._counted_before[1] + counts.lost

    @contextlib.contextmanager
    def _table(self) -> Iterator[Callable[[Sequence[Minute]], None]]:
        """Takes rows into soak.csv, each flushed as it comes."""
        path = self._out / "soak.csv"
        try:
            with path.open("w", newline="", encoding="utf-8") as file:
                table = csv.writer(file)
                table.writerow(COLUMNS)
                file.flush()

                def write(rows: Sequence[Minute]) -> None:
                    table.writerows(map(_csv_row, rows))
                    if rows:
                        file.flush()

                yield write
        except OSError as error:
            raise EchowingError(f"{path}: cannot be written: {error.strerror}") from error

    def result(self) -> Result:
        """As `Procedure`."""
        result = Result("soak", "Soak test")
        soak = self.soak
        if soak is None:
            result.checks = [Check("soak", "nothing was counted", "reports", passed=False)]
            return result
        total = soak.total
        result.checks = [
            _none("reboots", total.reboots, "time_boot_ms never goes back"),
            _none("sonar faults", total.sonar_faults, "the sonar answers all the time"),
            self._reports_check(soak),
            _none("gaps in the reports", total.gaps, f"no reading older than {GAP_MS:g} ms"),
            _share_check("lost frames", total.lost, total),
            _share_check("damaged frames", total.damaged, total),
            *self._drift_checks(soak),
        ]
        result.measured = {
            **vars(total),
            "board_s": soak.boards_ms / 1000.0,
            "states": dict(soak.states),
            "texts_by_word": dict(soak.words),
            "range_drift_m": soak.drift_m,
            "rows": [_row_dict(row) for row in soak.rows],
        }
        result.grids = [_totals(total), _words(soak)]
        result.figures = {"range": _range_figure(soak.rows), "counts": _counts_figure(soak.rows)}
        result.notes = [
            "Unplugging is counted and is no fault: what is missed meanwhile is neither a gap nor "
            "lost, and a restart on plugging in is no reboot. Gaps and rates go by the board's "
            "own clock. Drift: the farthest a row's mean range got from the first row's."
        ]
        return result

    def _reports_check(self, soak: Soak) -> Check:
        expected = soak.boards_ms / 1000.0 * self._rate_hz
        share = soak.total.reports / expected if expected else 0.0
        found = f"{soak.total.reports}, {share:.1%} of those due"
        asked = f"at least {LEAST_REPORT_SHARE:.0%} of REPORT_RATE {self._rate_hz:g} Hz"
        return Check("reports", found, asked, share >= LEAST_REPORT_SHARE)

    def _drift_checks(self, soak: Soak) -> list[Check]:
        if not self._still:
            return []
        drift_m = soak.drift_m
        found = "not two rows with a range" if drift_m is None else f"{drift_m:+.3f} m"
        asked = f"at most {MOST_DRIFT_M:g} m either way: half of Table 6's monitor band"
        stands = drift_m is not None and abs(drift_m) <= MOST_DRIFT_M
        return [Check("range drift", found, asked, stands)]


def _none(what: str, count: int, why: str) -> Check:
    return Check(what, str(count), f"none: {why}", count == 0)


def _share_check(what: str, count: int, total: Tally) -> Check:
    messages = total.reports + total.readings
    most = MOST_LOST_SHARE * messages
    return Check(what, str(count), f"at most {MOST_LOST_SHARE:.1%}: {most:.1f}", count <= most)


def _brief(total: Tally) -> str:
    return (
        f"{total.reports} reports, {total.gaps} gaps, {total.lost} lost, {total.reboots} reboots, "
        f"{total.sonar_faults} faults, {total.unplugged} unplugged"
    )


def _csv_row(row: Minute) -> list[Any]:
    return list(_row_dict(row).values())


def _row_dict(row: Minute) -> dict[str, Any]:
    counts = {**vars(row.tally), "listened_s": round(row.tally.listened_s, 1)}
    range_m = None if row.range_m is None else round(row.range_m, 4)
    spread_m = None if row.spread_m is None else round(row.spread_m, 4)
    return {"end_s": row.end_s, **counts, "range_m": range_m, "spread_m": spread_m}


def _totals(total: Tally) -> Grid:
    rows = tuple(
        Row((name.replace("_", " "), f"{value:.0f}")) for name, value in vars(total).items()
    )
    return Grid("Counted", ("what", "how many"), rows)


def _words(soak: Soak) -> Grid:
    said = [Row((text, str(count))) for text, count in soak.words.most_common()]
    been = [Row((f"state {name}", str(count))) for name, count in soak.states.most_common()]
    return Grid("Status texts and states", ("what", "times"), tuple(said + been))


def _range_figure(rows: Sequence[Minute]) -> plots.Figure:
    trace = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "mean range of each row",
        "x": [round(row.end_s / 60.0, 3) for row in rows],
        "y": [None if row.range_m is None else round(row.range_m, 4) for row in rows],
        "line": {"color": plots.FOLLOWER_COLOUR, "width": 1.8},
    }
    return plots.chart("Range", "time, min", "m", [trace])


def _counts_figure(rows: Sequence[Minute]) -> plots.Figure:
    shown = ("gaps", "lost", "damaged", "reboots", "sonar_faults", "unplugged", "warnings")
    data = [
        {
            "type": "bar",
            "name": name.replace("_", " "),
            "x": [round(row.end_s / 60.0, 3) for row in rows],
            "y": [getattr(row.tally, name) for row in rows],
        }
        for name in shown
    ]
    figure = plots.chart("Faults per row", "time, min", "how many", data)
    figure["layout"]["barmode"] = "stack"
    return figure


def add_arguments(parser: ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    add_bench_arguments(parser)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--hours", type=positive, metavar="H", help=f"hours ({HOURS:g})")
    length.add_argument("--duration", type=positive, metavar="S", help="seconds, instead of hours")
    parser.add_argument(
        "--row", type=positive, default=ROW_S, metavar="S", help="seconds per row (60)"
    )
    parser.add_argument(
        "--still",
        action="store_true",
        help="the target stands still: a drift of the range is a fault",
    )


def run(args: Namespace) -> int:
    """Measure, judge, write the result."""
    duration_s = args.duration if args.duration is not None else 3600.0 * (args.hours or HOURS)

    def reopen(port: str) -> Board:
        return open_board(port, args.baud)

    return perform(SoakTest(duration_s, args.row, args.out, reopen, still=args.still), args)
