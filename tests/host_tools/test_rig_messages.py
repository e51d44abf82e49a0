"""The books of the wire: what came whole, damaged, or not at all; and who is who."""

import pytest

from echowing.rig.messages import Counts, Frames, Roster, describe

from .rig_desk import (
    Speaker,
    autopilot_heartbeat,
    device_heartbeat,
    report,
    text,
    value,
)


def test_whole_frames_are_counted_and_stamped() -> None:
    frames, board = Frames(), Speaker()
    heard = frames.parse(board.say(report(300), value("SNR_RAW", 3.0)), 12.5)
    assert [m.get_type() for m in heard] == ["DISTANCE_SENSOR", "NAMED_VALUE_FLOAT"]
    assert {m._timestamp for m in heard} == {12.5}
    assert (frames.counts.frames, frames.counts.lost, frames.counts.damaged) == (2, 0, 0)


def test_a_frame_in_two_pieces_is_one() -> None:
    frames = Frames()
    data = Speaker().say(report(300))
    assert frames.parse(data[:7], 1.0) == []
    assert len(frames.parse(data[7:], 2.0)) == 1


def test_what_never_came_shows_in_the_sequence() -> None:
    frames, board = Frames(), Speaker()
    frames.parse(board.say(report(300)), 0.0)
    board.skip(3)
    frames.parse(board.say(report(300)), 0.1)
    assert frames.counts.lost == 3


def test_each_sender_counts_for_himself_and_numbers_go_round() -> None:
    frames, board, pilot = Frames(), Speaker(1, 191), Speaker(1, 1)
    pilot.skip(100)
    for _ in range(300):
        frames.parse(board.say(report(300)) + pilot.say(autopilot_heartbeat()), 0.0)
    assert frames.counts == Counts(bytes=frames.counts.bytes, frames=600)


def test_a_damaged_frame_counts_as_damaged_and_as_lost() -> None:
    frames, board = Frames(), Speaker()
    frames.parse(board.say(report(300)), 0.0)
    broken = bytearray(board.say(report(300)))
    broken[20] ^= 0x40
    frames.parse(bytes(broken) + board.say(report(301)), 0.1)
    assert (frames.counts.frames, frames.counts.damaged, frames.counts.lost) == (2, 1, 1)


def test_bytes_between_frames_are_garbage() -> None:
    frames, board = Frames(), Speaker()
    frames.parse(board.say(report(300)) + b"\x00\x01\x02\x03" + board.say(report(300)), 0.0)
    assert (frames.counts.garbage_bytes, frames.counts.damaged, frames.counts.lost) == (4, 0, 0)


def test_the_rest_of_a_frame_at_the_beginning_is_nobodys_fault() -> None:
    frames, board = Frames(), Speaker()
    frames.parse(board.say(report(300))[9:] + board.say(report(300)), 0.0)
    assert (frames.counts.frames, frames.counts.garbage_bytes, frames.counts.damaged) == (1, 0, 0)


@pytest.mark.parametrize(
    ("speaker", "beat", "other", "is_board"),
    [
        (Speaker(1, 191), device_heartbeat(), value("SNR_RAW", 3.0), True),
        (Speaker(9, 150), device_heartbeat(), value("SNR_STATE", 1.0), True),
        (Speaker(1, 1), autopilot_heartbeat(), value("SNR_RAW", 3.0), False),
        (Speaker(1, 191), device_heartbeat(), value("TEMP", 3.0), False),
        (Speaker(1, 191), device_heartbeat(), text("Echowing: not me"), False),
    ],
)
def test_who_is_a_board(speaker: Speaker, beat: object, other: object, is_board: bool) -> None:
    roster = Roster()
    roster.note(Frames().parse(speaker.say(other), 0.0))
    assert roster.boards() == []  # not before it beats
    roster.note(Frames().parse(speaker.say(beat), 0.0))
    assert bool(roster.boards()) == is_board
    assert bool(roster.others()) == (not is_board)


def test_a_heartbeat_in_words() -> None:
    words = describe((3, 1), autopilot_heartbeat())
    assert words == "an autopilot (ArduPilot, quadrotor, system 3, component 1)"
    beat = autopilot_heartbeat()
    beat.autopilot, beat.type = 4, 222  # one without a name of ours, and a number of the future
    assert describe((3, 1), beat).startswith("an autopilot (openpilot, mav type 222")
