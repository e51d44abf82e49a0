"""Keys of the live view: what they order, what asks first, and what becomes of the terminal."""

import io
import math
import os
import pty
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from typing import Any

import pytest
from rich.console import Console

from echowing.cli import main
from echowing.commands.follow import options_of
from echowing.errors import EchowingError
from echowing.flight.orders import Orders
from echowing.flight.shapes import shape
from echowing.terminal import Keyboard
from echowing.tool.background import BackgroundView
from echowing.tool.keys import QUESTION_S, KeyDesk
from echowing.tool.view import LiveView

from ..flight.test_build_up import Field
from ..flight.yard import FOLLOWER
from .test_background import DEADLINE_S, StoppedScreen, Vehicles, read_until
from .test_follow_end import NEVER_S, Flight, Screen
from .test_health import Watched

FOLLOW = [sys.executable, "-m", "echowing", "follow", "--no-log"]


class Desk:
    """A desk at a yard that has flown for a while; keys pressed a tick apart."""

    def __init__(self, *, engaged: bool = True) -> None:
        self.field = Field(engaged=engaged)
        self.field.fly(3.0)
        self.said: list[str] = []
        self.desk = KeyDesk(self.field.orders, lambda _, text: self.said.append(text))

    def press(self, *turns: bytes) -> None:
        for data in turns:
            self.desk.press(data, self.field.now_s)
            self.field.fly(0.125)

    def line(self) -> str:
        return self.desk.line(self.field.now_s)


@pytest.mark.parametrize(
    ("turns", "engaged"),
    [
        ((b"e", b"y"), True),
        ((b"E", b"Y"), True),  # caps lock
        ((b"e",), False),
        ((b"e", b"e"), False),
        ((b"e", b"n", b"y"), False),
        ((b"ey",), False),  # pasted
        ((b"eeee", b"e"), False),  # held down
        ((b"y",), False),
        ((b"\x1b[e", b"y"), False),  # what a function key sends
    ],
)
def test_engage_asks_first(turns: tuple[bytes, ...], engaged: bool) -> None:
    desk = Desk(engaged=False)
    desk.press(*turns)
    assert desk.field.session.engaged is engaged
    assert desk.field.said("engaged by key") is engaged


def test_a_question_is_shown_and_said_and_lapses() -> None:
    desk = Desk(engaged=False)
    desk.press(b"e")
    assert desk.said == ["engage: send points to all in Guided? press y within 5 s"]
    assert desk.line() == "engage: send points to all in Guided? y: yes, any other key: no"
    desk.field.fly(QUESTION_S)
    assert desk.line().startswith("keys: e engage")
    assert desk.said[-1] == "engage: send points to all in Guided? no answer: no"
    desk.press(b"y")
    assert not desk.field.session.engaged


def test_nearer_asks_back_out_does_not_and_the_line_shows_the_radius() -> None:
    desk = Desk()
    assert desk.line() == (
        "keys: e engage  h hold  n nearer  b back out  s stop all  radius 8.0 m, next 5 m"
    )
    assert len(desk.line()) <= 80
    desk.press(b"n")
    assert desk.said == ["nearer, from 8 to 5 m? press y within 5 s"]
    assert desk.field.build_up.target_m == 8.0
    desk.press(b"y")
    assert desk.field.build_up.target_m == 5.0
    desk.press(b"n")
    assert desk.said[-1] == "not nearer: still on the way to 5 m"
    desk.press(b"b")
    assert desk.field.build_up.target_m == 8.0
    assert desk.field.said("back out, to 8 m by key")


def test_another_shape_asks_first_and_the_line_shows_which() -> None:
    """A line abreast of one is beside its leader."""
    desk = Desk()
    shapes = [(name, shape(name, 1, 8.0)) for name in ("column", "abreast")]
    desk.field.orders = Orders(desk.field.session, None, shapes)
    desk.desk = KeyDesk(desk.field.orders, lambda _, text: desk.said.append(text))
    assert desk.line() == "keys: e engage  h hold  f form abreast  s stop all"
    desk.press(b"f")
    assert desk.said == ["form abreast? press y within 5 s"]
    assert not desk.field.session.reshape.moves
    desk.press(b"y")
    assert desk.field.session.reshape.moves
    assert desk.line() == "keys: e engage  h hold  f form column  s stop all"
    desk.press(b"f")
    assert desk.said[-1] == "no other shape: still on the way to abreast"
    desk.press(b"h", b"f")
    assert desk.said[-1] == "no other shape: not engaged"
    desk.press(b"e", b"y")
    desk.field.fly(30.0)
    assert desk.field.said("in abreast")
    assert desk.field.slot(FOLLOWER).angle_rad == pytest.approx(math.pi / 2.0)


def test_without_another_shape_the_key_says_how_to_give_one() -> None:
    desk = Desk()
    desk.press(b"f")
    assert desk.said == ["no other shape: one shape only was given (--formation column,vee)"]


@pytest.mark.parametrize("key", [b"s", b"S", b" "])
def test_stop_and_hold_ask_nobody_and_work_while_a_question_waits(key: bytes) -> None:
    desk = Desk()
    desk.press(b"n", b"h")
    assert desk.field.orders.held
    desk.press(b"e", key)
    assert desk.field.orders.stopped
    desk.field.fly(1.0)
    assert desk.field.state() == "holding: stopped by the operator"
    assert desk.field.said("hold by key")
    assert desk.field.said("STOP by key: all that were moved hold, for good")


def test_what_would_be_refused_is_not_asked_first() -> None:
    desk = Desk()
    desk.press(b"e")
    assert desk.said == ["engaged already"]
    desk.press(b"s", b"e")
    assert desk.said[1:] == ["all were stopped: end this tool and start it anew to engage"]
    assert desk.line().startswith("keys:")


def test_the_first_line_of_the_live_view_is_what_keys_do() -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=80, _environ={"TERM": "xterm"})
    view = LiveView(console)
    view.event(0.0, "an event")
    view.keys("keys: e engage")
    assert output.getvalue().rindex("keys: e engage") < output.getvalue().rindex("an event")
    output.seek(0)
    output.truncate()
    view.close()
    assert "keys:" not in output.getvalue()  # they do nothing any more


def test_on_a_low_screen_the_keys_and_the_newest_events_are_seen() -> None:
    output = io.StringIO()
    size: dict[str, Any] = {"width": 80, "height": 14, "_environ": {"TERM": "xterm"}}
    view = LiveView(Console(file=output, force_terminal=True, **size))
    yard = Watched()
    yard.fly(2.0)
    view.keys("keys: e engage")
    view.rows(0.0, [yard.row()])
    for number in range(8):
        output.seek(0)
        output.truncate()
        view.event(float(number), f"event {number} {'and more ' * 9}")  # two lines each
        view.rows(float(number + 1), [yard.row()])
    shown = output.getvalue()
    assert "keys: e engage" in shown
    assert "event 7" in shown
    assert "event 0" not in shown
    assert "…" not in shown.partition("event")[0]  # as Rich shows what it cuts off
    view.close()


def test_a_stopped_terminal_holds_up_no_key_and_what_they_do_is_shown_once() -> None:
    screen = StoppedScreen()
    view = BackgroundView(screen)
    for _ in range(1000):
        view.keys("keys: e engage")
    screen.goes.set()
    view.settle(DEADLINE_S)
    assert screen.shown == ["keys: e engage"]
    view.close()


# ---- a whole flight, its time is the tool's ------------------------------------------------------


class Operator:
    """Presses each key once what it waits for has been said, or is a row's state."""

    def __init__(self, screen: Screen, script: list[tuple[str, bytes]]) -> None:
        self._screen, self._script = screen, script

    def __call__(self) -> bytes:
        shown = [*self._screen.texts, *(row.state for row in self._screen.newest)]
        if self._script and any(self._script[0][0] in text for text in shown):
            return self._script.pop(0)[1]
        return b""


def fly(script: list[tuple[str, bytes]]) -> tuple[Screen, Flight, int]:
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen, Operator(screen, script), build_up=(6.0, 4.0))
    parameters = flight.autopilots[2].parameters
    assert parameters.add_table(95, "ECHO_", 1)
    assert parameters.add(95, 1, "DIST", 3.0)
    return screen, flight, flight.tool.run()


def test_a_flight_by_keys_from_engaging_to_the_next_radius_and_back_to_what_was_set() -> None:
    screen, flight, code = fly(
        [
            ("press e, or give --engage", b"e"),
            ("engage: send points to all", b"y"),
            ("engaged by key", b"n"),  # too early
            ("following", b"n"),
            ("nearer, from 6 to 4 m?", b"y"),
        ]
    )
    assert code == 0
    said = "\n".join(screen.texts)
    assert "not nearer: nobody is led yet" in said
    assert "radius 4 m" in said
    assert "follower 2: ECHO_DIST put back to 3" in said
    assert flight.autopilots[2].parameters.value("ECHO_DIST") == 3.0
    assert "radius 4.0 m" in screen.line


def test_stop_all_stops_it_and_the_tool_goes_on_until_it_is_ended() -> None:
    screen, flight, code = fly(
        [
            ("press e, or give --engage", b"e"),
            ("engage: send points to all", b"y"),
            ("engaged by key", b" "),
        ]
    )
    assert code == 0
    assert screen.newest[0].time_s > 19.0
    assert flight.copters[2].north_m < 0.0  # it stands behind where it was engaged
    assert flight.speed_mps() < 0.3


# ---- what was asked for --------------------------------------------------------------------------

ENDS = ["--leader", "udpin:1", "--follower", "udpin:2"]


def test_a_build_up_begins_at_its_widest() -> None:
    options = options_of([*ENDS, "--build-up", "8,5,4,3"])
    assert options.build_up == (8.0, 5.0, 4.0, 3.0)
    assert [slot.radius_m for slot in options.slots] == [8.0]
    assert [slot.radius_m for slot in options_of(ENDS).slots] == [3.0]


@pytest.mark.parametrize("radii", ["8", "3,4", "8,x", "8,8", "", "nan,3", "8,0.5"])
def test_radii_that_do_not_come_nearer_are_refused(radii: str) -> None:
    with pytest.raises(
        EchowingError, match=r"give two radii or more, each smaller than the one before"
    ):
        options_of([*ENDS, "--build-up", radii])


def test_a_build_up_inside_the_least_separation_is_refused() -> None:
    with pytest.raises(EchowingError, match=r"2 m from the leader is inside --min-separation"):
        options_of([*ENDS, "--build-up", "8,2", "--min-separation", "2.5"])


def test_a_build_up_without_a_terminal_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["follow", *ENDS, "--build-up", "8,3", "--duration", "0", "--no-log"]) == 2
    assert "--build-up needs keys: run it on a terminal" in capsys.readouterr().err


# ---- the terminal --------------------------------------------------------------------------------


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    master, slave = pty.openpty()
    yield master, slave
    os.close(master)
    os.close(slave)


def is_raw(slave: int) -> bool:
    return not termios.tcgetattr(slave)[3] & (termios.ICANON | termios.ECHO)


def test_keys_come_without_enter_and_the_terminal_is_put_back(terminal: tuple[int, int]) -> None:
    master, slave = terminal
    before = termios.tcgetattr(slave)
    os.write(master, b"typed before\n")
    keyboard = Keyboard(slave)
    assert keyboard.read() == b""
    with pytest.raises(RuntimeError), keyboard:
        assert is_raw(slave)
        assert keyboard.read() == b""  # what was typed before is nobody's order
        os.write(master, b"e")
        assert keyboard.read() == b"e"
        assert keyboard.read() == b""  # returns at once
        raise RuntimeError
    assert termios.tcgetattr(slave) == before
    assert keyboard.read() == b""


def test_after_fg_the_terminal_is_taken_again_and_in_the_background_left_alone(
    terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    master, slave = terminal
    shells = termios.tcgetattr(slave)
    handler = signal.getsignal(signal.SIGCONT)
    with Keyboard(slave) as keyboard:
        termios.tcsetattr(slave, termios.TCSANOW, shells)  # as a shell does after kill -STOP
        monkeypatch.setattr("echowing.terminal._in_foreground", lambda _: False)
        os.kill(os.getpid(), signal.SIGCONT)  # bg
        assert not is_raw(slave)
        os.write(master, b"s\n")
        assert keyboard.read() == b""
        monkeypatch.setattr("echowing.terminal._in_foreground", lambda _: True)
        os.kill(os.getpid(), signal.SIGCONT)  # fg
        assert is_raw(slave)
        assert not termios.tcgetattr(slave)[0] & termios.IXON
        assert keyboard.read() == b""  # what was typed meanwhile was the shell's
    assert termios.tcgetattr(slave) == shells
    assert signal.getsignal(signal.SIGCONT) is handler


def test_what_is_no_terminal_has_no_keys() -> None:
    unread, written = os.pipe()
    with Keyboard(unread) as keyboard:
        assert not keyboard.is_there
        assert keyboard.read() == b""
    os.close(unread)
    os.close(written)


@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGHUP])
def test_keys_work_in_the_tool_and_a_signal_puts_the_terminal_back(
    number: signal.Signals, terminal: tuple[int, int]
) -> None:
    master, slave = terminal
    before = termios.tcgetattr(slave)
    vehicles = Vehicles()
    environment = {**os.environ, "TERM": "xterm"}
    command = [*FOLLOW, *vehicles.ends]
    # Under `nohup` the tool would ignore a hang-up: what is ignored stays ignored.
    ours = signal.signal(number, signal.SIG_DFL)
    with subprocess.Popen(command, stdin=slave, stdout=slave, env=environment) as tool:
        signal.signal(number, ours)
        try:
            read_until(master, b"waiting for")
            vehicles.until_heard(2)
            read_until(master, b"keys: e engage")
            assert is_raw(slave)
            os.write(master, b"h")
            read_until(master, b"no hold: not engaged")
            os.write(master, b"s")
            read_until(master, b"STOP by key")
            tool.send_signal(number)
            read_until(master, b"left to its pilot")
            assert tool.wait(DEADLINE_S) == 0
        finally:
            tool.kill()
    assert termios.tcgetattr(slave) == before
