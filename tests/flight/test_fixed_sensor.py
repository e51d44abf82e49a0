"""`follow` with a sensor that the followers' autopilots read themselves, fixed to their noses."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FIXED_HZ, FollowSession
from echowing.mavlink.messages import FORWARD, PROXIMITY_IDS_FROM
from echowing.sonar_file import load_sonar

from .test_session import FOLLOWER, FOLLOWER_AT, HERE, LEADER, heartbeat, position, sonar_reading
from .yard import Yard

AUTOPILOT, CO_PROCESSOR = 1, 191
DOWN = mavlink.MAV_SENSOR_ROTATION_PITCH_270
FIXED = load_sonar("mb1202-fixed").belief()


def told(message: Any, system_id: int = FOLLOWER, component: int = AUTOPILOT) -> Any:
    """The message as received."""
    packed = message.pack(mavlink.MAVLink(None, system_id, component))
    return mavlink.MAVLink(None).decode(bytearray(packed))


def reading(t_s: float, range_m: float, orientation: int = FORWARD, sensor_id: int = 0) -> Any:
    boot_ms, centimetres = round(t_s * 1e3), round(range_m * 100.0)
    return mavlink.MAVLink_distance_sensor_message(
        boot_ms, 20, 700, centimetres, 1, sensor_id, orientation, 0
    )


def nose(t_s: float, yaw_rad: float = 0.0, pitch_rad: float = 0.0) -> Any:
    return mavlink.MAVLink_attitude_message(round(t_s * 1e3), 0.0, pitch_rad, yaw_rad, *(0.0,) * 3)


def listened(
    range_m: float,
    *,
    orientation: int = FORWARD,
    component: int = AUTOPILOT,
    sensor_id: int = 0,
    yaw_rad: float = 0.0,
    pitch_rad: float = 0.0,
) -> FollowerState:
    """A still leader, a follower that believes to be 4 m south of it, and 20 s of readings."""
    follow = session()
    for number in range(200):
        t_s = 10.0 + number * 0.1
        follow.receive(told(position(t_s, HERE), LEADER), t_s)
        follow.receive(told(position(t_s, FOLLOWER_AT)), t_s)
        follow.receive(told(nose(t_s, yaw_rad, pitch_rad)), t_s)
        swaying_m = range_m + 0.01 * (number // 5 % 2)
        message = reading(t_s, swaying_m, orientation, sensor_id)
        follow.receive(told(message, component=component), t_s)
    return follow.followers[FOLLOWER]


def session(limits: Limits | None = None) -> FollowSession:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), 12.0, sonar=FIXED)
    follow = FollowSession(LEADER, [plan], GuidanceSettings(), limits=limits)
    follow.receive(told(heartbeat()), 0.0)
    follow.receive(told(position(0.1, FOLLOWER_AT)), 0.0)
    return follow


def test_the_autopilots_readings_teach_what_the_receivers_disagree_by() -> None:
    # 2.8 m + 0.2 m to the centres: the follower is 1 m nearer than the two receivers say.
    assert listened(2.8).estimate.offset.north_m == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "strange",
    [{"orientation": DOWN}, {"component": CO_PROCESSOR}, {"sensor_id": PROXIMITY_IDS_FROM}],
    ids=["down", "co-processor", "proximity"],
)
def test_only_its_own_forward_sensor_counts(strange: dict[str, int]) -> None:
    assert listened(2.8, **strange).estimate.offset.north_m == pytest.approx(0.0, abs=1e-6)


def test_single_readings_of_a_co_processor_do_not_count() -> None:
    follow = session()
    follow.receive(told(sonar_reading(10.0, 2.8), component=CO_PROCESSOR), 10.0)

    follower = follow.followers[FOLLOWER]
    assert follower.readings.sender_id is None  # nor does a gimbal get orders
    assert not follower.estimate.listens(10.0)


@pytest.mark.parametrize("read_by_board", [False, True])
def test_a_follower_whose_co_processor_reads_its_sonar_is_not_engaged(read_by_board: bool) -> None:
    """Its autopilot would send the co-processor's running average on as a reading of its own."""
    yard = Yard(sonar=FIXED)
    if read_by_board:
        yard.tell(FOLLOWER, sonar_reading(0.1, 2.8), CO_PROCESSOR)
    assert bool(yard.fly(5.0)) is not read_by_board
    assert yard.said("its sonar is read by a co-processor") is read_by_board


def test_nearer_than_the_sensor_measures_is_no_reading() -> None:
    assert not listened(0.1).estimate.listens(30.0)


def test_a_reading_is_taken_along_the_nose() -> None:
    """Where that points past the leader, silence is none of it; on it, it is believed off."""
    ahead, past = listened(7.0), listened(7.0, yaw_rad=math.radians(90.0))
    assert ahead.estimate.offset.north_m < -0.2
    assert past.estimate.offset.north_m == pytest.approx(0.0, abs=0.05)


def test_a_nose_that_is_down_is_known_to_be() -> None:
    """A copter that flies ahead looks under its leader."""
    level, down = listened(7.0), listened(7.0, pitch_rad=math.radians(-45.0))
    assert level.estimate.offset.north_m < -0.2
    assert down.estimate.offset.north_m == pytest.approx(0.0, abs=0.05)


def test_the_nose_looks_for_the_leader_as_there_is_no_gimbal() -> None:
    follow = session()
    for number in range(100):
        t_s = 10.0 + number * 0.1
        follow.receive(told(position(t_s, HERE), LEADER), t_s)
        follow.receive(told(position(t_s, FOLLOWER_AT)), t_s)
        follow.receive(told(nose(t_s)), t_s)
        follow.receive(told(reading(t_s, 7.0)), t_s)
    assert not follow.followers[FOLLOWER].estimate.points(20.0)
    sent = [message for _, message in follow.tick(20.0)]
    assert not [one for one in sent if one.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE"]
    assert "sonar axis unknown" not in str(follow.events)


def test_readings_and_the_nose_are_asked_for_ten_times_a_second() -> None:
    follow = session(Limits())
    asked = {
        (message.param1, message.param2)
        for _, message in follow.tick(0.1)
        if message.get_type() == "COMMAND_LONG"
        and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    }
    period_us = 1e6 / FIXED_HZ
    assert (mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, period_us) in asked
    assert (mavlink.MAVLINK_MSG_ID_ATTITUDE, period_us) in asked
