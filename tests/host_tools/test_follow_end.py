"""What becomes of the followers when the tool itself fails in flight: its screen, or its code."""

import math
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.flown_sonar import flown_by
from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowSession
from echowing.geo import ned_between
from echowing.mavlink.links import Address, Link
from echowing.mavlink.messages import TOOL_SYSTEM_ID
from echowing.mavlink.seats import parse_seat
from echowing.mavlink.signing import LinkSigning
from echowing.sim.vehicle.autopilot import ORIGIN, Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sonar_file import FlownBy, load_sonar, shipped_sonar
from echowing.stopping import NotHeededError, StopRequest, stop_on_signals
from echowing.tool.again import fly_again
from echowing.tool.panel import Row
from echowing.tool.run import FollowOptions, FollowTool, Page

LEADER, FOLLOWER = 1, 2
STEP_S, GLANCE_S = 0.02, 0.005
NEVER_S = 1e9
TELEMETRY = "telemetry"
POINT = "SET_POSITION_TARGET_GLOBAL_INT"


class Clock:
    """Time goes on by being looked at, so that nobody waits."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        self.now_s += GLANCE_S
        return self.now_s


class VehicleLink(Link):
    """A link at whose other end an autopilot flies, in the tool's time."""

    def __init__(
        self, address: Address, autopilot: Autopilot, copter: Copter, show: Callable[[], object]
    ) -> None:
        super().__init__(address)
        self._autopilot, self._copter, self._show = autopilot, copter, show
        self._stepped_s = 0.0
        self._ear = mavlink.MAVLink(None)
        self._always, self._other = os.pipe()
        os.write(self._other, b".")  # there is always something to read

    def open(self) -> None:
        self._autopilot.add_link(TELEMETRY)

    def fileno(self) -> int:
        return self._always

    def receive(self, now_s: float) -> list[Any]:
        while self._stepped_s + STEP_S <= now_s:
            self._stepped_s += STEP_S
            self._copter.step(STEP_S)
            self._autopilot.step(self._stepped_s)
            self._show()
        return self._ear.parse_buffer(self._autopilot.transmit(TELEMETRY)) or []

    def send(self, frame: bytes, now_s: float) -> None:
        self._autopilot.receive(TELEMETRY, frame)

    def close(self) -> None:
        os.close(self._always)
        os.close(self._other)


class Screen:
    """Shows nothing, and fails from a moment on."""

    def __init__(self, fails_at_s: float, error: Exception) -> None:
        self.fails_at_s, self.error = fails_at_s, error
        self.texts: list[str] = []
        self.newest: list[Row] = []
        self.line = ""

    def event(self, time_s: float, text: str) -> None:
        self.rows(time_s, [])
        self.texts.append(text)

    def rows(self, time_s: float, rows: Any) -> None:
        if time_s >= self.fails_at_s:
            raise self.error
        self.newest = list(rows) or self.newest

    def keys(self, text: str) -> None:
        self.line = text

    def close(self) -> None:
        if self.fails_at_s < NEVER_S:
            raise self.error


class Flight:
    """A leader that flies away at 2 m/s and a follower that is led after it by a `FollowTool`."""

    def __init__(
        self,
        screen: Screen,
        keys: Callable[[], bytes] | None = None,
        build_up: tuple[float, ...] = (),
        page: Page | None = None,
        stop: StopRequest | None = None,
    ) -> None:
        starts = {LEADER: (0.0, 0.0, -10.0), FOLLOWER: (-5.0, 0.0, -10.0)}
        self.copters = {i: Copter(start, flying=True) for i, start in starts.items()}
        self.autopilots = {i: Autopilot(c, system_id=i) for i, c in self.copters.items()}
        for autopilot in self.autopilots.values():
            assert autopilot.set_mode("GUIDED")
        self.copters[LEADER].set_speed_limit(2.0)
        self.copters[LEADER].guided_position((200.0, 0.0, -10.0))
        seats = [parse_seat("leader", "udpin:1@1"), parse_seat("follower", "udpin:2@2")]
        settings = GuidanceSettings(learn_offset=False)
        options = FollowOptions(
            seats,
            [Slot(build_up[0] if build_up else 3.0)],
            settings,
            shipped_sonar(),
            engage=keys is None,
            duration_s=20.0,
            build_up=build_up,
        )
        self.tool = FollowTool(
            options,
            screen,
            stop or StopRequest(),
            clock=Clock(),
            make_link=self._make_link,
            keys=keys,
            page=page,
        )

    def _make_link(self, address: Address, signing: LinkSigning | None) -> Link:
        """Flown time waits for what the screen's own thread has to show."""
        autopilot, copter = self.autopilots[address.port], self.copters[address.port]
        return VehicleLink(address, autopilot, copter, self._shown)

    def _shown(self) -> None:
        self.tool._view.settle()

    def speed_mps(self) -> float:
        return abs(self.copters[FOLLOWER].vn_mps)


def test_where_all_is_well_it_is_led_and_left_standing() -> None:
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    assert flight.tool.run() == 0
    assert flight.copters[FOLLOWER].north_m > 15.0
    assert flight.speed_mps() < 0.3
    assert ": stopped, " in screen.texts[-1]


@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), OSError(5, "I/O error")])
def test_a_screen_that_is_gone_ends_it_with_the_follower_standing(error: OSError) -> None:
    """`follow | head`, or a terminal that was closed: nobody watches any more."""
    flight = Flight(Screen(8.0, error))
    assert flight.tool.run() == 1
    assert 1.0 < flight.copters[FOLLOWER].north_m < 20.0
    assert flight.speed_mps() < 0.3


def test_a_fault_of_ours_stops_the_follower_before_it_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    monkeypatch.setattr(flight.tool, "_tell", Once(flight, at_north_m=3.0))
    with pytest.raises(ZeroDivisionError):
        flight.tool.run()
    assert flight.speed_mps() < 0.3
    assert ": stopped, " in screen.texts[-1]


def test_links_that_cannot_be_waited_for_stop_the_follower(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As `select` fails on a link that has just gone."""
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    fails = Once(flight, at_north_m=3.0)
    monkeypatch.setattr("echowing.tool.run.wait", lambda *_: fails())
    with pytest.raises(ZeroDivisionError):
        flight.tool.run()
    assert flight.speed_mps() < 0.3
    assert any("fault of this tool, all followers hold" in text for text in screen.texts)


@pytest.fixture
def _fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The session's tick fails from the moment on at which the follower is 3 m north of its home.

    The fault is in the session's own state: it comes again with the same messages.
    """
    tick = FollowSession.tick

    def failing(session: FollowSession, now_s: float) -> list[tuple[int, Any]]:
        place = session.followers[FOLLOWER].position
        if place is not None and ned_between(ORIGIN, place)[0] > 3.0:
            raise ZeroDivisionError(f"at {now_s:.3f} s")
        return tick(session, now_s)

    monkeypatch.setattr(FollowSession, "tick", failing)


def test_its_log_says_by_which_sonar_file_it_is_flown(tmp_path: Path) -> None:
    flight = Flight(Screen(NEVER_S, OSError()))
    told = FlownBy("mine.toml", load_sonar("mb1202-boom"), "stock")
    flight.tool._options.log, flight.tool._options.flown_by = tmp_path, told
    assert flight.tool.run() == 0
    assert flown_by(tmp_path) == told


@pytest.mark.usefixtures("_fails")
def test_a_tick_that_fails_for_good_stops_the_follower_and_tells_everybody(tmp_path: Path) -> None:
    """The way of stopping ran through the same tick: the follower was left to its watchdog."""
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    flight.tool._options.log = tmp_path
    with pytest.raises(ZeroDivisionError) as fault:
        flight.tool.run()
    assert 3.0 < flight.copters[FOLLOWER].north_m < 8.0
    assert flight.speed_mps() < 0.3
    assert any("fault of this tool, all followers hold" in text for text in screen.texts)
    assert any(": stopped, " in text for text in screen.texts)
    (tlog,) = tmp_path.glob("follow-*.tlog")
    assert tlog.read_bytes().count(b"Echowing: ground tool failed, holding") == 2
    points = [one for one in sent(tlog) if one.get_type() == POINT]
    holds = [one for one in points if (one.vx, one.vy) == (0.0, 0.0)]
    assert len(holds) > 8  # a second of standing, at 8 Hz
    assert holds == points[-len(holds) :]
    assert len({(one.lat_int, one.lon_int, one.alt) for one in holds}) == 1
    (told,) = tmp_path.glob("follow-*-fault.json")
    assert "raise ZeroDivisionError" in told.read_text()
    again = a_session()
    with pytest.raises(ZeroDivisionError) as once_more:
        fly_again(tmp_path, again.receive, again.tick)
    assert str(once_more.value) == str(fault.value)


def a_session() -> FollowSession:
    plans = [FollowerPlan(FOLLOWER, Slot(3.0), sonar=shipped_sonar())]
    return FollowSession(LEADER, plans, GuidanceSettings(learn_offset=False), limits=Limits())


def sent(tlog: Path) -> Iterator[Any]:
    """What the tool has sent."""
    data, ear, start = tlog.read_bytes(), mavlink.MAVLink(None), 0
    while start < len(data):
        length = 12 + data[start + 9]
        message = ear.decode(bytearray(data[start + 8 : start + 8 + length]))
        start += 8 + length
        if message.get_srcSystem() == TOOL_SYSTEM_ID:
            yield message


def test_a_message_that_cannot_be_taken_stops_the_follower(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    take = FollowSession.receive

    def failing(session: FollowSession, message: Any, now_s: float) -> None:
        if now_s > 12.0 and message.get_type() == "HEARTBEAT":
            raise KeyError("mode")
        take(session, message, now_s)

    monkeypatch.setattr(FollowSession, "receive", failing)
    with pytest.raises(KeyError):
        flight.tool.run()
    assert flight.speed_mps() < 0.3
    assert ": stopped, " in screen.texts[-1]


@pytest.mark.usefixtures("_handlers")
def test_ctrl_c_ends_a_tick_that_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal only counted, and a tick that hung never looked: the process had to be killed."""
    screen = Screen(NEVER_S, OSError())
    with stop_on_signals(0.2) as stop:
        flight = Flight(screen, stop=stop)
        tick = FollowSession.tick

        def hanging(session: FollowSession, now_s: float) -> list[tuple[int, Any]]:
            if now_s > 12.0:
                threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
                while True:
                    pass
            return tick(session, now_s)

        monkeypatch.setattr(FollowSession, "tick", hanging)
        with pytest.raises(NotHeededError, match="no answer to Ctrl-C"):
            flight.tool.run()
    assert flight.speed_mps() < 0.3
    assert ": stopped, " in screen.texts[-1]


class Once:
    """Fails once, when the follower has come so far."""

    def __init__(self, flight: Flight, at_north_m: float) -> None:
        self.flight, self.at_north_m = flight, at_north_m

    def __call__(self) -> None:
        if self.flight.copters[FOLLOWER].north_m > self.at_north_m:
            self.at_north_m = math.inf
            raise ZeroDivisionError


@pytest.fixture
def _handlers() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
def test_a_closed_terminal_is_a_request_to_end_unless_it_was_to_be_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with stop_on_signals() as stop:
        signal.raise_signal(signal.SIGHUP)
        assert stop.count == 1
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    with stop_on_signals() as stop:
        signal.raise_signal(signal.SIGHUP)
        assert stop.count == 0
