"""Lets the tests in this folder share the field, and its vehicles."""

import signal
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from .field import World

# A shell starts what it puts in the background with Ctrl-C ignored, and its children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module")
def served() -> Iterator[World]:
    world = World()
    yield world
    world.pilot.close()
    assert world.process.end() == 0
    assert world.process.lines[-1] == "stopped"


@pytest.fixture
def world(served: World) -> Iterator[World]:
    served.pilot.set_mode(mavlink.COPTER_MODE_GUIDED)
    yield served
    served.end_tools()
