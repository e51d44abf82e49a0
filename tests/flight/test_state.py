"""What is known of a vehicle: reports that come twice, late or after a reboot."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowSession
from echowing.sonar_file import shipped_sonar

LEADER, FOLLOWER = 1, 2
MINUTE_MS = 60_000


def flown() -> FollowSession:
    plan = FollowerPlan(FOLLOWER, Slot(3.0), sonar=shipped_sonar())
    return FollowSession(LEADER, [plan], GuidanceSettings())


def report(session: FollowSession, boot_ms: int, speed_cmps: int, now_s: float) -> None:
    """The follower's position at a time of its clock, told apart by its speed."""
    here = (393_400_000, -860_300_000, 260_000, 10_000)
    message: Any = mavlink.MAVLink_global_position_int_message(
        boot_ms, *here, speed_cmps, *(0,) * 3
    )
    packed = message.pack(mavlink.MAVLink(None, FOLLOWER, 1))
    session.receive(mavlink.MAVLink(None).decode(bytearray(packed)), now_s)


@pytest.mark.parametrize("late_ms", [MINUTE_MS, MINUTE_MS - 100, MINUTE_MS - 9_900])
def test_a_followers_double_or_older_report_changes_nothing(late_ms: int) -> None:
    session = flown()
    report(session, MINUTE_MS, 100, 1.0)
    report(session, late_ms, 300, 1.5)
    follower = session.followers[FOLLOWER]
    assert follower.ground_speed_mps == 1.0
    assert follower.position_at_s == 1.0


@pytest.mark.parametrize("boot_ms", [0, MINUTE_MS + 100])
def test_a_followers_newer_report_and_that_after_a_reboot_count(boot_ms: int) -> None:
    session = flown()
    report(session, MINUTE_MS, 100, 1.0)
    report(session, boot_ms, 300, 1.5)
    assert session.followers[FOLLOWER].ground_speed_mps == 3.0


def rates_asked(session: FollowSession, now_s: float) -> bool:
    sent = [message for _, message in session.tick(now_s) if message.get_type() == "COMMAND_LONG"]
    return any(one.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL for one in sent)


def test_rates_are_asked_for_again_as_soon_as_a_vehicle_is_heard() -> None:
    session = flown()
    assert rates_asked(session, 0.0)
    assert not rates_asked(session, 1.0)
    report(session, 1_000, 0, 1.0)
    assert rates_asked(session, 1.1)
    report(session, 1_100, 0, 1.2)
    assert not rates_asked(session, 1.3)
    assert rates_asked(session, 6.2)
