"""Frames out of bytes as ArduPilot cuts them: compared with MAVLink's own C parser."""

import random
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.sim.vehicle.framing import Framer
from echowing.sim.world.cutter import ByteLoss, PacketCutter

pytestmark = pytest.mark.seconds(5)
ROOT = Path(__file__).resolve().parents[2]
BEAT = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
ATTITUDE = mavlink.MAVLink_attitude_message(7, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def packed(message: object, **options: bool) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, 2, 1), **options))  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def c_parser(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MAVLink's C parser with the dialect of the firmware, as a program."""
    folder = tmp_path_factory.mktemp("parser")
    dialect = ROOT / "firmware" / "dialect" / "echowing.xml"
    made_by = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang", "C"]
    made_by += ["--wire-protocol", "2.0", "--output", str(folder), str(dialect)]
    subprocess.run(made_by, check=True, capture_output=True)
    program, source = folder / "cut", Path(__file__).with_name("cut_frames.c")
    subprocess.run(["cc", "-w", "-I", folder, "-o", program, source], check=True)
    return program


def told(frame: bytearray) -> str:
    """A frame in the words of the C program."""
    old = frame[0] == 0xFE
    head = 6 if old else 10
    sequence = frame[2] if old else frame[4]
    number = frame[5] if old else int.from_bytes(frame[7:10], "little")
    checksum = int.from_bytes(frame[head + frame[1] : head + frame[1] + 2], "little")
    return f"{frame[0]} {frame[1]} {sequence} {number} {checksum}"


def stream(chance: random.Random, *, signed: bool, old: bool) -> bytes:
    """Frames of all lengths with garbage between some, and a radio that loses a tenth of it."""
    sender = mavlink.MAVLink(None, 2, 1)
    if signed:
        sender.signing.secret_key, sender.signing.sign_outgoing = b"k" * 32, True
    data = bytearray()
    for _ in range(400):
        text = bytes(chance.randrange(32, 127) for _ in range(chance.randrange(50)))
        file = [chance.randrange(256) for _ in range(251)]
        message = chance.choice(
            [
                BEAT,
                ATTITUDE,
                mavlink.MAVLink_statustext_message(3, text, 0, 0),
                mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, file),
            ]
        )
        data += message.pack(sender, force_mavlink1=old)
        sender.seq = (sender.seq + 1) % 256
        if chance.random() < 0.05:
            data += chance.randbytes(chance.randrange(300))
    return PacketCutter(ByteLoss(0.1, (20, 80), 0.1), chance).carry(bytes(data))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("signed", "old"), [(False, False), (True, False), (False, True)])
def test_frames_are_cut_as_mavlinks_own_parser_cuts_them(
    c_parser: Path, seed: int, signed: bool, old: bool
) -> None:
    chance = random.Random(seed)
    data = stream(chance, signed=signed, old=old)
    framer, found, at = Framer(), [], 0
    while at < len(data):
        piece = data[at : at + chance.randrange(1, 200)]
        found += [told(frame) for frame in framer.cut(piece)]
        at += len(piece)

    done = subprocess.run([c_parser], input=data, capture_output=True, check=True)
    assert found == done.stdout.decode().splitlines()
    assert len(found) > 200


def test_the_head_of_a_frame_takes_the_tail_of_another() -> None:
    """Its length counts from its head: here all of the next frame but the last bytes is gone."""
    long, short = packed(ATTITUDE), packed(BEAT)
    framer = Framer()

    frames = framer.cut(long[:20] + short + short + short)

    assert frames[0] == (long[:20] + short + short)[: len(long)]
    assert frames[-1] == short


def test_a_frame_with_an_unknown_flag_is_left_at_its_third_byte() -> None:
    assert Framer().cut(b"\xfd\x09\x02" + packed(BEAT)) == [packed(BEAT)]


def test_garbage_alone_is_not_kept() -> None:
    framer = Framer()

    assert framer.cut(b"ArduPilot Ready\r\n" * 1000) == []
    assert len(framer._waiting) == 0
