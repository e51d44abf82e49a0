"""How a verb's end holds against signals: mostly in processes of their own, as it ends them."""

import signal
import subprocess
import sys

import pytest

from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.luahost import LuaHost

SECOND = """
import atexit, os, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a suite in the background ignores it
from echowing.stopping import stop_on_signals
with stop_on_signals() as stop:
    os.kill(os.getpid(), signal.{first})
    assert stop.count == 1
os.kill(os.getpid(), signal.{second})
atexit.register(os.kill, os.getpid(), signal.{second})
class Last:
    def __del__(self, kill=os.kill, pid=os.getpid()):
        kill(pid, signal.{second})
last = Last()
raise SystemExit(3)
"""
AFTER = """
import os, signal, sys
from echowing.cli import main
sys.argv = ["echowing", "sim", "--list"]
code = main()
os.kill(os.getpid(), signal.{second})
raise SystemExit(3)
"""
STILL_ITS_OWN = """
import os, signal
from echowing.stopping import stop_on_signals
with stop_on_signals():
    pass
os.kill(os.getpid(), signal.SIGTERM)
"""


def exit_code(code: str, **names: str) -> int:
    run = [sys.executable, "-c", code.format(**names)]
    return subprocess.run(run, capture_output=True, check=False, timeout=120).returncode


@pytest.mark.parametrize("first", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("second", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_after_the_last_word_does_not_change_the_exit_code(
    first: str, second: str
) -> None:
    assert exit_code(SECOND, first=first, second=second) == 3


def test_a_signal_after_a_verb_has_ended_does_not_change_its_exit_code() -> None:
    assert exit_code(AFTER, second="SIGTERM") == 3


def test_where_nothing_was_asked_signals_are_as_they_were() -> None:
    assert exit_code(STILL_ITS_OWN) == -15


def test_ctrl_c_that_comes_within_the_applets_lua_ends_the_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One in three was lost: raised just as a binding began, it was an error the applet caught."""
    asked = Autopilot.armed
    sent: list[float] = []

    def armed(autopilot: Autopilot) -> bool:
        if flight.t_s > 10.0 and not sent:
            sent.append(flight.t_s)
            signal.raise_signal(signal.SIGINT)
        return asked(autopilot)

    monkeypatch.setattr(Autopilot, "armed", armed)
    monkeypatch.setattr(LuaHost, "_guarded", lambda host, binding: binding)  # it has not begun to
    flight = FormationFlight(load_scenario("echowing", ["duration_s=20"]), 1)

    with pytest.raises(KeyboardInterrupt):
        flight.run()

    assert flight.t_s < 10.1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
