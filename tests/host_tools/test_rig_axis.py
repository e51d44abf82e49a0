"""`echowing rig axis-test`: the firmware's own core, an autopilot that leans, and a hand."""

import io
import math
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console

from echowing.rig.axis_test import AxisTest
from echowing.rig.bench import Bench, Operator, run_to_result
from echowing.rig.orders import Direction, looked
from echowing.rig.result import Check, Result

from .rig_desk import CoreWire

Attitude = Callable[[float], tuple[float, float, float]]
YAW = math.radians(50.0)
HOST_MS = 20.0


def level(t_s: float) -> tuple[float, float, float]:
    return 0.0, 0.0, YAW


def by_hand(t_s: float) -> tuple[float, float, float]:
    """Some 20 degrees each way, at up to 60 degrees a second; on its feet for the orders."""
    if t_s < TURNS_AT_S:
        return level(t_s)
    angle = math.radians(20.0)
    t_s -= TURNS_AT_S
    return (
        0.3 * angle * math.sin(t_s),
        angle * math.sin(3.0 * t_s),
        YAW + angle * math.sin(2.0 * t_s),
    )


# Two seconds of rest, a round of four orders of two seconds, and one to look ahead again.
TURNS_AT_S = 16.0


def outcome(
    attitude: Attitude | None,
    *,
    still: bool = True,
    armed: bool = False,
    prepare: Callable[[CoreWire], None] = lambda wire: None,
) -> tuple[Result, CoreWire]:
    """The result of one round, and the wire."""
    wire = CoreWire(None)
    wire.armed, wire.attitude = armed, attitude
    wire.read(3.0)
    board = wire.open()
    prepare(wire)
    operator = Operator(Console(file=io.StringIO()), io.StringIO(), yes=True)
    bench = Bench(board, operator, wire.clock, lambda seconds: None)
    result, _ = run_to_result(AxisTest(1, 12.0, HOST_MS, target_m=None, still=still), bench)
    return result, wire


def check(result: Result, what: str) -> Check:
    return next(check for check in result.checks if check.what == what)


def put(wire: CoreWire, name: str, value: float) -> None:
    """Set a parameter of the board's."""
    tool = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
    message = mavlink.MAVLink_param_set_message(
        1, 191, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
    )
    wire.write(message.pack(tool))
    wire.read(0.5)


@pytest.mark.parametrize(
    "direction", [Direction(0.0, 0.0), Direction(30.0, -20.0), Direction(-170.0, 60.0)]
)
def test_a_direction_is_the_same_after_its_rotation(direction: Direction) -> None:
    assert looked(direction.quaternion()).apart_deg(direction) == pytest.approx(0.0, abs=1e-4)


def test_right_angles_are_right_angles() -> None:
    assert Direction(90.0, 0.0).apart_deg(Direction(0.0, 0.0)) == pytest.approx(90.0)
    assert Direction(0.0, -90.0).apart_deg(Direction(123.0, 0.0)) == pytest.approx(90.0)


def test_it_looks_to_each_side_in_time() -> None:
    result, _ = outcome(level)
    assert result.verdict == "PASS", [c for c in result.checks if not c.passed]
    assert [move["name"] for move in result.measured["moves"]] == ["left", "right", "up", "down"]
    for move in result.measured["moves"]:
        assert move["off_deg"] < 0.3
        # 4 ms for the bytes to come in, and up to 50 for the report; both are the core's.
        assert 4.0 <= move["delay_ms"] < 80.0
        assert move["delay_ms"] < move["arrived_ms"] < 330.0
    # 250 degrees a second are SERVO_RATE's; two readings 0.1 s apart show half of it at least.
    assert 125.0 <= result.measured["fastest_dps"] <= 300.0


def test_the_axis_stays_while_a_hand_turns_the_vehicle() -> None:
    result, wire = outcome(by_hand, still=False)
    assert result.verdict == "PASS", [c for c in result.checks if not c.passed]
    assert min(result.measured["turned_deg"]) > 30.0
    assert max(result.measured["off_deg"]) < 3.0
    ends = [m for m in wire.sent if m.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE" and m.flags == 1]
    assert len(ends) == 1


def test_a_vehicle_that_nobody_turns_shows_nothing() -> None:
    result, _ = outcome(level, still=False)
    assert check(result, "axis stays").passed
    assert not check(result, "turned by hand").passed
    assert result.verdict == "FAIL"


def test_servos_that_are_too_slow_for_a_hand_fail() -> None:
    """The slowest SERVO_RATE: ten degrees a second."""
    result, _ = outcome(by_hand, still=False, prepare=lambda wire: put(wire, "SERVO_RATE", 100.0))
    assert not check(result, "axis stays").passed
    assert check(result, "turned by hand").passed


def test_without_attitude_it_says_where_to_look() -> None:
    result, wire = outcome(None)
    attitude = check(result, "attitude")
    assert not attitude.passed
    assert "does the autopilot's TX reach the board" in attitude.found
    assert result.verdict == "FAIL"
    assert not [m for m in wire.sent if m.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE"]


def test_a_firmware_that_tells_no_axis_is_said_to_be_old() -> None:
    def old(wire: CoreWire) -> None:
        wire.drop = lambda message: message.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS"

    result, _ = outcome(level, prepare=old)
    assert "is the firmware from before?" in check(result, "attitude").found


def test_a_servo_that_does_not_reach_fails_by_name() -> None:
    result, _ = outcome(level, prepare=lambda wire: put(wire, "PAN_REACH", 20.0))
    assert not check(result, "left").passed
    assert "10.0 degrees off" in check(result, "left").found
    assert check(result, "up").passed
    assert not check(result, "order to arrival").passed


def test_in_flight_it_does_nothing() -> None:
    result, wire = outcome(level, armed=True)
    assert result.verdict == "INCOMPLETE"
    assert result.incomplete is not None
    assert not [m for m in wire.sent if m.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE"]


def test_the_document_holds_every_move(tmp_path: Any) -> None:
    result, _ = outcome(by_hand, still=False)
    document = result.document()
    assert len(document["measured"]["moves"]) == 4
    assert {"name", "delay_ms", "arrived_ms", "off_deg"} == set(document["measured"]["moves"][0])
    assert "Turned by hand" in result.html()
