"""Lets the tests in this folder share the field, and its vehicles."""

from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from .field import World


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
