"""What the follow tool rings the bell for, and what it tells a pilot at the end."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.tool.run import TAKE_OVER

from .test_follow_end import FOLLOWER, NEVER_S, Flight, Screen, VehicleLink


@pytest.fixture
def rings(monkeypatch: pytest.MonkeyPatch) -> list[None]:
    rung: list[None] = []
    monkeypatch.setattr("echowing.tool.background.ring", lambda: rung.append(None))
    return rung


def test_a_quiet_flight_rings_no_bell(rings: list[None]) -> None:
    assert Flight(Screen(NEVER_S, OSError())).tool.run() == 0
    assert rings == []


def test_a_vehicles_warning_rings_the_bell(
    rings: list[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Screen(NEVER_S, OSError())
    flight = Flight(screen)
    receive, warnings = VehicleLink.receive, ["Battery 1 is low"]

    def warn(link: VehicleLink, now_s: float) -> list[Any]:
        if now_s > 15.0 and warnings:
            autopilot = flight.autopilots[FOLLOWER]
            autopilot.send_text(mavlink.MAV_SEVERITY_WARNING, warnings.pop())
        return receive(link, now_s)

    monkeypatch.setattr(VehicleLink, "receive", warn)
    assert flight.tool.run() == 0
    assert "system 2 warns: Battery 1 is low" in screen.texts
    assert len(rings) == 1


def test_one_that_is_not_known_to_stand_is_told_to_its_pilot_and_rings_the_bell(
    rings: list[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []
    receive, send = VehicleLink.receive, VehicleLink.send

    def deaf(link: VehicleLink, now_s: float) -> list[Any]:
        heard = receive(link, now_s)
        return [] if now_s > 15.0 and link.address.port == FOLLOWER else heard

    def note(link: VehicleLink, frame: bytes, now_s: float) -> None:
        sent.append((link.address.port, mavlink.MAVLink(None).decode(bytearray(frame))))
        send(link, frame, now_s)

    monkeypatch.setattr(VehicleLink, "receive", deaf)
    monkeypatch.setattr(VehicleLink, "send", note)
    screen = Screen(NEVER_S, OSError())
    assert Flight(screen).tool.run() == 1
    assert "not confirmed stopped" in screen.texts[-1]
    assert len(rings) == 1
    texts = [(who, m.text, m.severity) for who, m in sent if m.get_type() == "STATUSTEXT"]
    assert texts == [(FOLLOWER, TAKE_OVER, mavlink.MAV_SEVERITY_CRITICAL)]
