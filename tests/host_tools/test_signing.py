import hashlib
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.mavlink.links import Address, Link
from echowing.mavlink.seats import parse_seat
from echowing.mavlink.signing import (
    SETUP_LINK_ID,
    SIGNING_EPOCH_UNIX_S,
    SIGNING_TICKS_PER_S,
    LinkSigning,
    Parser,
    is_refused,
    load_key,
)
from echowing.sonar_file import shipped_sonar
from echowing.stopping import StopRequest
from echowing.tool.leader import PUBLISHED_LINK_ID, VEHICLE_LINK_ID
from echowing.tool.run import FollowOptions, FollowTool
from echowing.tool.view import PlainView

KEY = bytes(range(100, 132))
NOW_UNIX_S = SIGNING_EPOCH_UNIX_S + 1000.0


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (bytes(range(200, 232)), bytes(range(200, 232))),
        (KEY.hex().encode(), KEY),
        (KEY.hex().upper().encode() + b"\r\n", KEY),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest()),
        # 32 characters that can be typed are a phrase, not 32 bytes of chance.
        (b"p" * 32, hashlib.sha256(b"p" * 32).digest()),
        ("Flügel".encode(), hashlib.sha256("Flügel".encode()).digest()),
    ],
)
def test_a_key_is_bytes_digits_or_a_phrase(tmp_path: Path, content: bytes, key: bytes) -> None:
    warned: list[str] = []
    assert load_key(key_file(tmp_path, content), warned.append) == key
    assert warned == []


@pytest.mark.parametrize("content", [b"", b"\n", bytes(range(31)), b"\xff\xfe\x00"])
def test_what_is_no_key_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(EchowingError, match="holds no key"):
        load_key(key_file(tmp_path, content), print)


def test_a_missing_key_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="No such file"):
        load_key(tmp_path / "none", print)


def test_a_key_that_others_may_read_is_warned_of(tmp_path: Path) -> None:
    warned: list[str] = []
    load_key(key_file(tmp_path, KEY, 0o640), warned.append)
    (text,) = warned
    assert "open to others" in text
    assert "chmod 600" in text


class Sender:
    """Somebody who signs, or does not."""

    def __init__(
        self, key: bytes | None, unix_s: float = NOW_UNIX_S, system_id: int = 7, link_id: int = 1
    ) -> None:
        self.unix_s = unix_s
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self.signing = None if key is None else LinkSigning(key, link_id, lambda: self.unix_s)
        if self.signing is not None:
            self.signing.apply(self.mav)

    def frame(self, message: Any = None) -> bytes:
        if self.signing is not None:
            self.signing.keep_time()
        beat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3)
        return bytes((message or beat).pack(self.mav))


def time_of(frame: bytes) -> int:
    """Ticks in a signed frame: 6 bytes before the last 6."""
    return int.from_bytes(frame[-12:-6], "little")


def listener(key: bytes = KEY, unix_s: float = NOW_UNIX_S) -> Parser:
    signing = LinkSigning(key, 9, lambda: unix_s)
    signing.keep_time()
    return Parser(signing)


def believed(parser: Parser, frame: bytes) -> bool:
    (message,) = parser.parse_buffer(frame)
    assert (message.get_msgId() >= 0) is not is_refused(message)
    return not is_refused(message)


def test_only_what_is_signed_with_the_key_is_believed() -> None:
    parser = listener()
    assert believed(parser, Sender(KEY).frame())
    assert not believed(parser, Sender(None).frame())
    assert not believed(parser, Sender(bytes(32)).frame())


def test_a_radio_needs_no_signature() -> None:
    status = mavlink.MAVLink_radio_status_message(*(0,) * 7)
    assert believed(listener(), Sender(None).frame(status))


def test_a_recorded_frame_is_not_believed_again() -> None:
    parser, sender = listener(), Sender(KEY)
    first, second = sender.frame(), sender.frame()
    assert believed(parser, first)
    assert believed(parser, second)
    assert not believed(parser, second)
    assert not believed(parser, first)


def test_the_links_of_one_sender_are_told_apart_by_their_ids() -> None:
    parser = listener()
    assert believed(parser, Sender(KEY, NOW_UNIX_S + 5.0, link_id=1).frame())
    assert believed(parser, Sender(KEY, NOW_UNIX_S, link_id=2).frame())


def test_follow_setup_and_leader_sign_with_ids_of_their_own() -> None:
    """Two senders on one link id refuse each other: the later one's stamps look old."""
    made: list[int] = []

    def note(address: Address, signing: LinkSigning | None) -> Link:
        assert signing is not None
        packer = mavlink.MAVLink(None)
        signing.apply(packer)
        made.append(packer.signing.link_id)
        return Link(address)

    seats = [parse_seat("follower", f"udpin:{port}@{port}") for port in range(1, 52)]
    options = FollowOptions(
        seats, [Slot(3.0)] * 50, GuidanceSettings(), shipped_sonar(), signing_key=KEY
    )
    FollowTool(options, PlainView(), StopRequest(), make_link=note)
    ids = [*made, SETUP_LINK_ID, VEHICLE_LINK_ID, PUBLISHED_LINK_ID]
    assert len(made) == 51
    assert len(set(ids)) == len(ids)


def test_a_forged_frame_of_the_future_does_not_silence_its_victim() -> None:
    parser, victim = listener(), Sender(KEY)
    assert believed(parser, victim.frame())
    assert not believed(parser, Sender(bytes(32), NOW_UNIX_S + 1e6).frame())
    assert believed(parser, victim.frame())


def test_times_count_ten_microseconds_from_2015_and_never_go_back() -> None:
    sender = Sender(KEY)
    assert time_of(sender.frame()) == 1000 * SIGNING_TICKS_PER_S
    sender.unix_s += 1.0
    later = time_of(sender.frame())
    assert later == 1001 * SIGNING_TICKS_PER_S
    sender.unix_s -= 500.0  # the computer's clock is set back
    assert time_of(sender.frame()) == later + 1


def test_a_vehicle_whose_clock_is_ahead_takes_ours_along() -> None:
    ahead = Sender(KEY, NOW_UNIX_S + 3600.0)
    signing = LinkSigning(KEY, 1, lambda: NOW_UNIX_S)
    parser, packer = Parser(signing), mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
    signing.apply(packer)
    assert believed(parser, ahead.frame())
    ours = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer))
    assert time_of(ours) >= 4600 * SIGNING_TICKS_PER_S
