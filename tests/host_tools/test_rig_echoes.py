"""axis-test's echoes: the firmware's core turns servos that are sound, stuck, reversed or late."""

import io
import math
import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
from rich.console import Console

from echowing.flight.belief import Curve
from echowing.flight.sonar import PAN_CENTRE_US, TILT_CENTRE_US
from echowing.geo import Ned
from echowing.rig.axis_echoes import Ping, found_span
from echowing.rig.axis_test import AxisTest
from echowing.rig.bench import Bench, Operator, run_to_result
from echowing.rig.result import Check, Result
from echowing.sim.world.sonar import (
    ON_A_DESK,
    Ear,
    Gimbal,
    Pose,
    Target,
    TrueSonar,
)

from .rig_desk import SLICE_S, CoreWire

pytestmark = pytest.mark.seconds(13)
Pulses = tuple[float, float]
Fault = Callable[[Pulses], Pulses]
DISTANCE_M = 2.0
MIDDLE = PAN_CENTRE_US, TILT_CENTRE_US


def sound(pulses: Pulses) -> Pulses:
    return pulses


def stuck(servo: int, at_us: float | None = None) -> Fault:
    """It stays where it is, whatever is sent."""
    kept = MIDDLE[servo] if at_us is None else at_us
    return lambda pulses: (kept, pulses[1]) if servo == 0 else (pulses[0], kept)


def geared(servo: int, ratio: float) -> Fault:
    """It turns so much for each degree sent; -1: the other way."""

    def turned(pulses: Pulses) -> Pulses:
        us = [pulses[0], pulses[1]]
        us[servo] = MIDDLE[servo] + ratio * (us[servo] - MIDDLE[servo])
        return us[0], us[1]

    return turned


def moved(servo: int, by_us: float) -> Fault:
    """Its horn is on another tooth."""

    def turned(pulses: Pulses) -> Pulses:
        us = [pulses[0], pulses[1]]
        us[servo] += by_us
        return us[0], us[1]

    return turned


def late(by_s: float) -> Fault:
    """Both come to know of their pulses so much later."""
    waiting = [MIDDLE] * round(by_s / SLICE_S)

    def turned(pulses: Pulses) -> Pulses:
        waiting.append(pulses)
        return waiting.pop(0)

    return turned


@dataclass
class Bay:
    """A vehicle on its stand, its servos with their fault, and a target that a helper moves."""

    fault: Fault = sound
    sonar: TrueSonar = ON_A_DESK
    others_m: tuple[Ned, ...] = ()
    helps: bool = True
    asked: list[str] = field(default_factory=list)
    target_m: Ned | None = None

    def __post_init__(self) -> None:
        self.wire = CoreWire(None)
        self.wire.armed, self.wire.attitude = False, lambda t_s: (0.0, 0.0, 0.7)
        self.wire.scene = self._turn
        self._gimbal = Gimbal()
        self._ear = Ear(lambda name: random.Random(f"1 {name}"), self.sonar)
        self.wire.sonar.range_m = self._listen

    def _turn(self, pan_us: float, tilt_us: float) -> None:
        self._gimbal.step(SLICE_S, *self.fault((pan_us, tilt_us)))

    def _listen(self, t_s: float) -> float | None:
        there = (*self.others_m, self.target_m) if self.target_m else self.others_m
        targets = [Target(at_m, self.sonar.foil_m) for at_m in there]
        pose = Pose((0.0, 0.0, 0.0), self._gimbal.axis_body())
        return self._ear.ping(t_s, pose, targets, surfaces=())

    def ask(self, text: str, *_: object) -> None:
        """Play the helper."""
        self.asked.append(text)
        if not self.helps:
            return
        found = re.search(r"target (?:(\d\.\d+) m (to the right|up)|\d)", text)
        if found is None:
            return
        away_m = float(found[1] or 0.0)
        out_m = DISTANCE_M
        forward_m = math.sqrt(out_m**2 - away_m**2)
        aside = {"to the right": (away_m, 0.0), "up": (0.0, -away_m)}.get(found[2], (0.0, 0.0))
        self.target_m = (forward_m, *aside)


def outcome(bay: Bay, rounds: int = 2) -> Result:
    bay.wire.read(3.0)
    operator = Operator(Console(file=io.StringIO()), io.StringIO(), yes=True)
    operator.ask = bay.ask  # type: ignore[assignment, method-assign]
    bench = Bench(bay.wire.open(), operator, bay.wire.clock, lambda seconds: None)
    procedure = AxisTest(rounds, 1.0, 20.0, target_m=DISTANCE_M, still=True)
    return run_to_result(procedure, bench)[0]


def failed(result: Result) -> dict[str, str]:
    return {check.what: check.found for check in result.checks if not check.passed}


def check(result: Result, what: str) -> Check:
    return next(check for check in result.checks if check.what == what)


@pytest.fixture(scope="module")
def good() -> tuple[Bay, Result]:
    bay = Bay()
    return bay, outcome(bay)


def test_sound_servos_pass(good: tuple[Bay, Result]) -> None:
    bay, result = good
    assert result.verdict == "PASS", failed(result)
    assert len(bay.asked) == 4  # the vehicle's stand, and three places of the target
    for sweep in result.measured["echoes"]:  # the beam is of 20 degrees to each side
        assert sweep["from_deg"] == pytest.approx(sweep["target_deg"] - 18.0, abs=3.0)
        assert abs(sweep["late_ms"]) < 25.0


@pytest.mark.parametrize(
    ("half_deg", "edge_deg", "heard", "aside_deg"), [(14.0, 5.0, 0.8, 4.0), (24.0, 3.0, 1.0, -4.0)]
)
def test_a_soft_and_a_wide_beam_pass_too(
    half_deg: float, edge_deg: float, heard: float, aside_deg: float
) -> None:
    """The target is put by eye."""
    sonar = replace(
        ON_A_DESK,
        heard=Curve((0.0,), (heard,)),
        half_rad=Curve((0.0,), (math.radians(half_deg),)),
        edge_rad=math.radians(edge_deg),
    )
    result = outcome(Bay(moved(0, 10.0 * aside_deg), sonar), rounds=3)
    assert result.verdict == "PASS", failed(result)


@pytest.mark.parametrize(("servo", "name"), [(0, "pan"), (1, "tilt")])
def test_a_stuck_servo_fails_by_name(servo: int, name: str) -> None:
    """The board sends it, and tells so: all that does not listen passes."""
    result = outcome(Bay(stuck(servo)))
    what = f"{name} really moves"
    assert list(failed(result)) == [what]
    assert f"the {name} servo does not turn" in check(result, what).found
    assert check(result, "left").passed


def test_servos_that_look_elsewhere_hear_nothing() -> None:
    result = outcome(Bay(stuck(0, PAN_CENTRE_US + 400.0)))
    assert set(failed(result)) == {"pan really moves", "tilt really moves"}
    assert "or the target is not there" in check(result, "pan really moves").found


def test_without_a_target_nothing_is_shown() -> None:
    bay = Bay(helps=False)
    assert set(failed(outcome(bay))) == {"pan really moves", "tilt really moves"}
    assert len(bay.asked) == 2  # nobody is asked to move what is not heard


@pytest.mark.parametrize(
    ("servo", "what"), [(0, "pan really turns right"), (1, "tilt really turns up")]
)
def test_a_reversed_servo_is_found_by_the_target_aside(servo: int, what: str) -> None:
    result = outcome(Bay(geared(servo, -1.0)))
    assert list(failed(result)) == [what]
    scale = ("PAN_US_DEG", "TILT_US_DEG")[servo]
    assert f"turns the other way, {scale} needs the other sign" in failed(result)[what]


def test_a_servo_of_half_the_angle_fails() -> None:
    """To a target 20 degrees aside it is sent 40."""
    found = failed(outcome(Bay(geared(0, 0.5))))
    assert list(found) == ["pan really turns right"]
    told = re.search(r"heard (\S+) degrees right", found["pan really turns right"])
    assert told is not None
    assert float(told[1]) == pytest.approx(40.0, abs=4.0)


def test_a_horn_on_the_next_tooth_fails() -> None:
    found = failed(outcome(Bay(moved(0, 170.0))))
    assert list(found) == ["pan really looks ahead"]
    assert "degrees left" in found["pan really looks ahead"]


def test_servos_that_are_late_fail() -> None:
    result = outcome(Bay(late(0.15)))
    assert list(failed(result)) == ["pan really in time", "tilt really in time"]
    for sweep in result.measured["echoes"]:
        assert sweep["late_ms"] == pytest.approx(155.0, abs=25.0)


def test_echoes_of_a_wall_are_not_the_target() -> None:
    """A metre behind it, and heard from everywhere."""
    wall = tuple((3.2 * math.cos(a), 3.2 * math.sin(a), 0.0) for a in (-1.0, -0.5, 0.0, 0.5, 1.0))
    result = outcome(Bay(others_m=wall))
    assert result.verdict == "PASS", failed(result)


def test_the_page_shows_each_sweep(good: tuple[Bay, Result]) -> None:
    _, result = good
    assert "Heard, over the angle told" in result.html()
    assert len(result.document()["measured"]["echoes"]) == 4
    assert "its echoes tell" in result.notes[0]


def test_a_sonar_that_hears_here_and_there_shows_no_edge() -> None:
    chance = random.Random(2)
    pings = [Ping(-60.0 + k, 1, chance.random() < 0.5) for k in range(120)]
    assert found_span(pings, 0.0) is None
