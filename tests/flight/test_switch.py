"""The stop switch: what it stops, for how long, and over what its mode is never sent."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.switch import MODE_PERIOD_S, SWITCH_FRESH_S, StopSwitch, Switches

LEADER, FOLLOWER, SECOND = 1, 2, 3
ON, OFF = 1900, 1100
ROUND_TRIP_S = 0.4
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE


def channels(pulse_us: int, boot_ms: int) -> Any:
    pulses = [1500] * 18
    pulses[6] = pulse_us
    return mavlink.MAVLink_rc_channels_message(boot_ms, 18, *pulses, 255)


def switches(mode: str | None = None) -> Switches:
    return Switches(StopSwitch(7, 1700, mode), LEADER, [FOLLOWER, SECOND])


def asked(held: Switches, heartbeat_at_s: float, now_s: float) -> int | None:
    message = held.message(FOLLOWER, heartbeat_at_s, ROUND_TRIP_S, now_s)
    return None if message is None else int(message.command)


@pytest.mark.parametrize("who", [FOLLOWER, LEADER])
def test_it_stays_stopped_until_guided_is_left(who: int) -> None:
    held = switches()
    held.receive(who, channels(ON, 1000), 1.0)
    held.receive(who, channels(OFF, 1250), 1.25)
    assert held.stops(FOLLOWER)
    assert held.stops(SECOND) is (who == LEADER)
    held.entered_guided(FOLLOWER, 2.0)
    assert not held.stops(FOLLOWER)
    held.receive(who, channels(ON, 2500), 2.5)
    held.entered_guided(FOLLOWER, 3.0)  # with the switch still on
    assert held.stops(FOLLOWER)


def test_an_older_report_changes_nothing_and_a_restart_begins_anew() -> None:
    held = switches()
    held.receive(FOLLOWER, channels(OFF, 20_000), 1.0)
    held.receive(FOLLOWER, channels(ON, 19_900), 1.1)
    assert not held.stops(FOLLOWER)
    held.receive(FOLLOWER, channels(ON, 20_250), 1.2)
    held.receive(FOLLOWER, channels(OFF, 20_000), 1.3)
    assert held.shown(FOLLOWER, 1.4) == "on"
    held.receive(FOLLOWER, channels(OFF, 500), 30.0)
    assert held.shown(FOLLOWER, 30.0) == "was on"


def test_it_is_shown_as_what_is_known_of_it() -> None:
    held = switches()
    assert held.shown(FOLLOWER, 0.0) == "not seen"
    held.receive(FOLLOWER, channels(OFF, 1000), 1.0)
    held.receive(FOLLOWER, channels(0, 1250), 1.25)  # no receiver: says nothing
    assert held.shown(FOLLOWER, 1.0) == "off"
    assert held.shown(FOLLOWER, 1.1 + SWITCH_FRESH_S) == "not seen"
    assert Switches(None, LEADER, [FOLLOWER]).shown(FOLLOWER, 0.0) is None


def test_its_mode_waits_for_a_heartbeat_that_still_says_guided() -> None:
    """A fail-safe may have come since the last one: nobody writes over it."""
    held = switches("LOITER")
    assert asked(held, 1.0, 1.0) is None
    held.receive(FOLLOWER, channels(ON, 2000), 2.0)
    assert asked(held, 1.9, 2.0) == mavlink.MAV_CMD_REQUEST_MESSAGE
    assert asked(held, 1.9, 2.1) is None  # asked for only now and then
    assert asked(held, 1.9, 2.1 + MODE_PERIOD_S) == mavlink.MAV_CMD_REQUEST_MESSAGE
    assert asked(held, 2.7, 2.8) == SET_MODE
    # Until one comes that the vehicle has sent after that, the same holds again.
    assert asked(held, 2.8 + ROUND_TRIP_S - 0.01, 3.9) != SET_MODE
    assert asked(held, 2.8 + ROUND_TRIP_S + 0.01, 3.9) == SET_MODE


@pytest.mark.parametrize(
    ("command", "result", "counts"),
    [
        (SET_MODE, mavlink.MAV_RESULT_ACCEPTED, True),
        (SET_MODE, mavlink.MAV_RESULT_DENIED, False),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_RESULT_ACCEPTED, False),
    ],
)
def test_only_a_mode_that_was_taken_is_not_asked_for_again(
    command: int, result: int, counts: bool
) -> None:
    held = switches("LAND")
    held.receive(FOLLOWER, channels(ON, 1000), 1.0)
    assert asked(held, 1.1, 1.1) == SET_MODE
    held.mode_answered(FOLLOWER, mavlink.MAVLink_command_ack_message(command, result), 1.7)
    assert asked(held, 1.6, 1.8) == (mavlink.MAV_CMD_REQUEST_MESSAGE if counts else SET_MODE)
    assert asked(held, 2.3, 2.4) == SET_MODE
