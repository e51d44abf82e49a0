"""The ground tools' parser on links that lose bytes: all that is whole, and nothing else."""

import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.signing import LinkSigning, Parser, is_refused
from echowing.sim.world.cutter import ByteLoss, PacketCutter

LONGEST = 280  # bytes of a MAVLink 2 frame


def packed(*messages: Any, sender: Any = None, old: bool = False) -> list[bytes]:
    sender = sender or mavlink.MAVLink(None, 2, 1)
    frames = []
    for message in messages:
        frames.append(bytes(message.pack(sender, force_mavlink1=old)))
        sender.seq = (sender.seq + 1) % 256
    return frames


def beats(count: int, **options: Any) -> list[bytes]:
    return packed(
        *(mavlink.MAVLink_heartbeat_message(2, 3, 0, n, 4, 3) for n in range(count)), **options
    )


def attitudes(count: int) -> list[bytes]:
    chance = random.Random(1)
    numbers = ([chance.uniform(-1.0, 1.0) for _ in range(6)] for _ in range(count))
    return packed(*(mavlink.MAVLink_attitude_message(n, *six) for n, six in enumerate(numbers)))


def parsed(data: bytes, parser: Parser | None = None) -> list[bytes]:
    found = (parser or Parser()).parse_buffer(data)
    return [bytes(one.get_msgbuf()) for one in found if one.get_type() != "BAD_DATA"]


@pytest.mark.parametrize("old", [False, True])
def test_the_frames_behind_the_head_of_a_lost_one_arrive(old: bool) -> None:
    """Its length takes in what follows; once that has come it is seen that it was none."""
    [long] = attitudes(1)
    whole = beats(4, old=old)

    assert parsed(long[:15] + b"".join(whole)) == whole


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xfd\xff\xff",  # a velocity of -3 and -1 cm/s: flags that do not exist
        b"\xfd\xff\x00\x00\x00\x00\x00\xff\xff\xff",  # a message that does not exist
        b"\xfe\xff\x00\x00\x00\xee",
        b"ArduPilot Ready\r\n",
    ],
)
def test_what_cannot_be_a_head_delays_nothing(garbage: bytes) -> None:
    whole = beats(1)

    assert parsed(garbage + whole[0]) == whole


def test_it_does_not_matter_in_what_pieces_the_bytes_come() -> None:
    cutter = PacketCutter(ByteLoss(0.1, flip=0.1), random.Random(3))
    data = cutter.carry(b"".join(attitudes(300) + beats(300)))
    one_by_one = Parser()

    pieces = [parsed(data[at : at + 1], one_by_one) for at in range(len(data))]
    assert [frame for piece in pieces for frame in piece] == parsed(data)


def test_of_a_lossy_link_more_arrives_than_by_pymavlinks_parser_and_nothing_that_was_not_sent() -> (
    None
):
    sent = [frame for pair in zip(attitudes(3000), beats(3000), strict=True) for frame in pair]
    data = PacketCutter(ByteLoss(0.1), random.Random(4)).carry(b"".join(sent))
    theirs = mavlink.MAVLink(None)
    theirs.robust_parsing = True

    ours = parsed(data)
    others = [m for m in theirs.parse_buffer(data) if m.get_msgId() >= 0]
    assert set(ours) <= set(sent)
    # A frame lies in 1.4 to 1.8 packets of 50 bytes: 15 % of them are hit. What is behind a head
    # without a tail, pymavlink loses, too.
    assert 1.0 - len(ours) / len(sent) == pytest.approx(0.15, abs=0.02)
    assert len(others) < 0.97 * len(ours)


def test_what_is_damaged_and_what_is_garbage_is_told() -> None:
    broken = bytearray(beats(1)[0])
    broken[-1] ^= 1

    found = Parser().parse_buffer(bytes(broken) + b"\0\1\2\3" + beats(1)[0])
    assert [one.get_type() for one in found] == ["BAD_DATA", "BAD_DATA", "HEARTBEAT"]
    assert bytes(found[0].data) == broken
    assert bytes(found[1].data) == b"\0\1\2\3"


def test_a_frame_that_signing_refuses_is_told_of_as_one() -> None:
    sender = mavlink.MAVLink(None, 2, 1)
    sender.signing.secret_key, sender.signing.sign_outgoing = b"x" * 32, True
    parser = Parser(LinkSigning(b"k" * 32, 1, lambda: 1.7e9))

    found = parser.parse_buffer(b"".join(beats(2, sender=sender) + beats(1)))
    assert [is_refused(one) for one in found] == [True, True, True]


def test_of_garbage_no_more_is_kept_than_a_frame_is_long() -> None:
    parser = Parser()
    for _ in range(20):
        assert parsed(b"\xfd\xff\x00" * 200, parser) == []
        assert parser.buf_len() <= LONGEST
