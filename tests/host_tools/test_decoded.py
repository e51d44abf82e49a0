"""A frame is decoded once, and everybody who gets it has a message of its own."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle import links
from echowing.sim.vehicle.links import SerialLink, decoded

LEADER, TOOL = (1, 1), (255, 190)
KEY = bytes(range(32))
MESSAGES = (
    mavlink.MAVLink_attitude_message(7, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    mavlink.MAVLink_statustext_message(4, b"tracking"),
    mavlink.MAVLink_distance_sensor_message(7, 20, 765, 300, 0, 1, 0, 255),
)


def framed(message: Any, sender: tuple[int, int] = LEADER, *, signed: bool = False) -> bytes:
    mav = mavlink.MAVLink(None, *sender)
    if signed:
        mav.signing.secret_key, mav.signing.sign_outgoing = KEY, True
    return bytes(message.pack(mav))


def all_of(message: Any) -> tuple[Any, ...]:
    """Whatever a receiver may ask of it."""
    sender = message.get_srcSystem(), message.get_srcComponent(), message.get_seq()
    return (type(message), message.to_dict(), *sender, message.get_signed(), message.get_msgbuf())


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.get_type())
def test_it_is_the_message_as_it_came_however_often(message: Any, signed: bool) -> None:
    frame = framed(message, signed=signed)
    fresh = all_of(mavlink.MAVLink(None).decode(bytearray(frame)))
    assert [all_of(decoded(frame)) for _ in range(2)] == [fresh, fresh]


def test_who_sends_one_on_or_writes_into_it_changes_it_for_nobody_else() -> None:
    frame = framed(MESSAGES[0])
    before, written = decoded(frame), decoded(frame)
    was = all_of(before)
    written.roll = 9.0
    framed(written, TOOL)
    assert (written.get_srcSystem(), written.roll) == (255, 9.0)
    assert all_of(before) == was
    assert all_of(decoded(frame)) == was


def test_two_ports_that_receive_the_same_frame_hand_on_two_messages() -> None:
    frame = framed(MESSAGES[0])
    ports = [SerialLink(name, number, 2) for number, name in enumerate(("telemetry", "usb"))]
    for port in ports:
        port.feed(frame)
    (first,), (second,) = (list(port.received()) for port in ports)
    framed(first[1], TOOL)
    assert (first[1].get_srcSystem(), second[1].get_srcSystem()) == (255, 1)


def test_a_frame_is_decoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bytes] = []
    decode = links._DECODER.decode

    def counting(frame: bytearray) -> Any:
        seen.append(bytes(frame))
        return decode(frame)

    monkeypatch.setattr(links._DECODER, "decode", counting)
    links._decoded.cache_clear()
    frames = [framed(message) for message in MESSAGES]
    for frame in (*frames, *frames):
        decoded(frame)
    assert seen == frames
