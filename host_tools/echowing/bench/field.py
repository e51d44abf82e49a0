"""What the follow tool costs and how quick it is, against a simulated fleet: for `echowing bench`.

The tool runs in this process, whole: links, session, guard, live table, logs; the fleet in one of
its own, both over loopback. *Telemetry to wire* is the tool's own share of a point's age: from the
moment when it turns to its links, with the points due, until the datagram is the kernel's. Reading
and taking in what has come, the leader's newest report too, is in it, as are working out, packing
and logging of the points; the wait for the next point to be due (100 ms at 10 Hz) is not. The
points of one turn leave together, so one point's share is the turn's time over its points.
"""

import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console

from echowing.bench.fleet import FIRST_FOLLOWER_ID, HEIGHT_M, LEADER_ID
from echowing.errors import EchowingError
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings
from echowing.mavlink.links import Address, Link, parse_address
from echowing.mavlink.seats import Seat
from echowing.mavlink.signing import LinkSigning
from echowing.sim.scenario import load_scenario
from echowing.sonar_file import shipped_sonar
from echowing.stopping import StopRequest
from echowing.tool.panel import Row
from echowing.tool.run import FollowOptions, FollowTool
from echowing.tool.view import LiveView
from echowing.web.live import LivePage
from echowing.web.options import PageAddress

MANY = 50
SETTLE_S = 3.0
GIVE_UP_S = 30.0
DEFINITION = (
    "Telemetry to wire: from the tool's turn to its links, with points due, until the datagram is "
    "the kernel's. What has come is read and taken in, points are worked out, packed and sent; the "
    "wait for a point to be due is not in it. A point: the turn's time over its points. The tool "
    "with its live table and logs; the fleet, all on one link, is a process of its own."
)
POINT_ID = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT


class FieldFigure(NamedTuple):
    """One measured figure; goal: what it should be, in words."""

    what: str
    value: float
    unit: str
    goal: str


def field_figures(seconds: float = 20.0) -> Iterator[FieldFigure]:
    """Fly one follower at 20 Hz, fifty at 10 Hz, and those with the page; 1.5 minutes in all."""
    alone = fly(1, 20.0, seconds)
    yield FieldFigure(
        "telemetry to wire, 1 follower, 99th percentile", 1e3 * alone.point_s(99), "ms", "under 1"
    )
    many = fly(MANY, 10.0, seconds)
    name = f"{MANY} followers"
    yield FieldFigure(
        f"{name}: telemetry to wire a point, median", 1e3 * many.point_s(50), "ms", ""
    )
    yield FieldFigure(
        f"{name}: telemetry to wire a point, 99th percentile",
        1e3 * many.point_s(99),
        "ms",
        "under 1",
    )
    yield FieldFigure(
        f"{name}: until a turn's last point, 99th percentile",
        1e3 * many.turn_s(99),
        "ms",
        "under 100",
    )
    yield FieldFigure(f"{name} asked for at 10 Hz: points to each", many.rate_hz, "Hz", "10")
    yield FieldFigure(f"{name} at 10 Hz: share of one core", 100.0 * many.share, "%", "under 100")
    yield from _watched_figures(name, fly(MANY, 10.0, seconds, watched=True))


def _watched_figures(name: str, flown: "Flown") -> Iterator[FieldFigure]:
    """The same with the page in a browser that reads it all, and in one that reads nothing."""
    name = f"{name} and the page"
    yield FieldFigure(
        f"{name}: telemetry to wire a point, 99th percentile",
        1e3 * flown.point_s(99),
        "ms",
        "under 1",
    )
    yield FieldFigure(
        f"{name}: until a turn's last point, 99th percentile",
        1e3 * flown.turn_s(99),
        "ms",
        "under 100",
    )
    yield FieldFigure(f"{name}: points to each", flown.rate_hz, "Hz", "10")
    yield FieldFigure(f"{name}: frames to the browser", flown.frames_hz, "Hz", "10")
    yield FieldFigure(f"{name}: share of one core", 100.0 * flown.share, "%", "under 100")


@dataclass(frozen=True)
class Flown:
    """What was measured: turns that sent points, how long each took and how many it sent.

    frames_hz: of the page, to the browser that reads.
    """

    turns: Sequence[tuple[float, int]]
    followers: int
    wall_s: float
    cpu_s: float
    frames_hz: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Points to each follower, a second."""
        return sum(points for _, points in self.turns) / self.followers / self.wall_s

    @property
    def share(self) -> float:
        """Of one core."""
        return self.cpu_s / self.wall_s

    def turn_s(self, percent: int) -> float:
        """A percentile of the turns' times."""
        return _percentile([spent_s for spent_s, _ in self.turns], percent)

    def point_s(self, percent: int) -> float:
        """A percentile of a point's share of its turn."""
        return _percentile([spent_s / points for spent_s, points in self.turns], percent)


def _percentile(values: Sequence[float], percent: int) -> float:
    return statistics.quantiles(values, n=100, method="inclusive")[percent - 1]


class _TimedLink(Link):
    """A link that notes when the tool turns to it, and when each point is the kernel's."""

    def __init__(self, address: Address, signing: LinkSigning | None = None) -> None:
        super().__init__(address, signing)
        self.turns: dict[float, list[float]] = {}
        self._turned_at_s = 0.0

    def receive(self, now_s: float) -> list[object]:
        """As `Link`."""
        self._turned_at_s = time.perf_counter()
        return super().receive(now_s)

    def send(self, frame: bytes, now_s: float) -> None:
        """As `Link`."""
        super().send(frame, now_s)
        if int.from_bytes(frame[7:10], "little") == POINT_ID:
            self.turns.setdefault(self._turned_at_s, []).append(time.perf_counter())


class _Measure(LiveView):
    """The live table; ends the flight when it has been measured long enough."""

    def __init__(self, stop: StopRequest, seconds: float) -> None:
        # Drawn as on a large terminal, and thrown away.
        super().__init__(Console(file=StringIO(), force_terminal=True, width=160, height=60))
        self._stop, self._seconds = stop, seconds
        self._opened_s = time.perf_counter()
        self._all_since_s: float | None = None
        self.begin: tuple[float, float] | None = None
        self.end: tuple[float, float] | None = None

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        super().rows(time_s, rows)
        now_s = time.perf_counter()
        if self._all_since_s is None and all(
            row.state.startswith(("following", "holding", "gives way")) for row in rows
        ):
            self._all_since_s = now_s
        if self._all_since_s is None:
            if now_s - self._opened_s > GIVE_UP_S:
                self._stop.count += 1
        elif self.begin is None and now_s - self._all_since_s > SETTLE_S:
            self.begin = now_s, time.process_time()
        elif self.begin and self.end is None and now_s - self.begin[0] > self._seconds:
            self.end = now_s, time.process_time()
            self._stop.count += 1


def fly(followers: int, rate_hz: float, seconds: float, *, watched: bool = False) -> Flown:
    """Fly a fleet with the follow tool and measure it. Raises EchowingError where it will not.

    watched: with the page, in a browser that reads all of it and in one that reads nothing.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "echowing.bench.fleet", str(port), str(followers)]
    with tempfile.TemporaryDirectory() as folder, subprocess.Popen(command) as fleet:
        try:
            options = _options(followers, rate_hz, port, Path(folder))
            return _watched(options, seconds) if watched else _measured(options, seconds)
        finally:
            fleet.kill()


def _watched(options: FollowOptions, seconds: float) -> Flown:
    """With the page; who watches is a process of its own, as a browser is."""
    page = LivePage(PageAddress(port=0), "follow")
    command = [sys.executable, "-m", "echowing.bench.watcher", str(page.port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as watcher:
        try:
            flown = _measured(options, seconds, page)
            told, _ = watcher.communicate(b"", GIVE_UP_S)  # its input ends, and so it does
        finally:
            watcher.kill()
            page.close()
    return replace(flown, frames_hz=float(told))


def _measured(options: FollowOptions, seconds: float, page: LivePage | None = None) -> Flown:
    links: list[_TimedLink] = []

    def timed(address: Address, signing: LinkSigning | None) -> Link:
        links.append(_TimedLink(address, signing))
        return links[-1]

    stop, followers = StopRequest(), len(options.slots)
    view = _Measure(stop, seconds)
    FollowTool(options, view, stop, make_link=timed, page=page).run()
    if view.begin is None or view.end is None:
        raise EchowingError(f"bench: {followers} followers were not all followed")
    (begin_s, begin_cpu_s), (end_s, end_cpu_s) = view.begin, view.end
    turns = [
        (sent_s[-1] - turned_s, len(sent_s))
        for turned_s, sent_s in links[0].turns.items()
        if begin_s <= turned_s <= end_s
    ]
    return Flown(turns, followers, end_s - begin_s, end_cpu_s - begin_cpu_s)


def _options(followers: int, rate_hz: float, port: int, folder: Path) -> FollowOptions:
    link = parse_address(f"udpin:127.0.0.1:{port}")
    roles = [("leader", LEADER_ID)]
    roles += [("follower", FIRST_FOLLOWER_ID + number) for number in range(followers)]
    return FollowOptions(
        seats=[Seat(role, link, system_id) for role, system_id in roles],
        slots=load_scenario("many").slots()[:followers],
        settings=GuidanceSettings(),
        sonar=shipped_sonar(),
        altitude_m=HEIGHT_M,
        rate_hz=rate_hz,
        limits=Limits(max_distance_m=100.0, min_separation_m=1.5, home_difference_m=5.0),
        engage=True,
        log=folder,
    )
