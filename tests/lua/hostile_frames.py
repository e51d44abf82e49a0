"""Frames as a hostile radio hands them to a script: whole, changed, cut and joined. Seeded."""

from __future__ import annotations

import math
import struct
from random import Random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from echowing.mavlink.messages import POINT_FORMAT, Manner
from echowing.sim.vehicle.framing import Framer
from echowing.sim.world.cutter import ByteLoss, PacketCutter

V1, V2 = 0xFE, 0xFD
HEAD_BYTES = {V1: 6, V2: 10}
LENGTH_AT = 1
MOST_PAYLOAD = 255

POINT, NAMED = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT, 251
METRES_PER_E7 = 0.011131884502145034  # 1e-7 degrees of latitude
HERE = (39.34, -86.03, 260.0)
# Of the point's mask: no acceleration; no velocity; no yaw; no yaw rate.
NO_ACCELERATION, NO_VELOCITY, NO_YAW, NO_YAW_RATE = 0x01C0, 0x0038, 0x0400, 0x0800
RAW_NAME = b"SNR_RAW"
# (system, component) of the ground tool, the co-processor, a pilot's ground station, a stranger.
TOOL, BOARD, STATION, STRANGER = (245, 190), (1, 191), (255, 190), (7, 1)

ODD = [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e9, -1e9, 1e-30, 1001.0, 0.0, -0.0, -1.0]


def odd(rng: Random, low: float, high: float, share: float = 0.2) -> float:
    """A number of a span, or one that no vehicle has; not every one of a message is."""
    if rng.random() >= share:
        return rng.uniform(low, high)
    any_bits: float = struct.unpack("<f", rng.randbytes(4))[0]
    return rng.choice([*ODD, any_bits])


def packed(
    message: Any, sender: tuple[int, int], *, v1: bool = False, signed: bool = False
) -> bytes:
    """A message as bytes on the wire, its checksum right."""
    packer = mavlink.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    if signed and not v1:
        packer.signing.secret_key = bytes(range(32))
        packer.signing.sign_outgoing = True
    return bytes(message.pack(packer, force_mavlink1=v1))


def point(
    t_ms: int,
    north_m: float,
    east_m: float,
    velocity_mps: tuple[float, float] | None,
    *,
    up_m: float = 10.0,
    yaw_rad: float | None = None,
    opens_m: float = 0.0,
    manner: float = 0.0,
    point_format: float = POINT_FORMAT,
    quickens_mps2: float = 0.0,
    mask: int = NO_ACCELERATION | NO_YAW_RATE,
    system: int = 1,
    frame: int = 6,
) -> Any:
    """A guided point, metres from HERE; velocity_mps: (north, east)."""
    scale = METRES_PER_E7 * math.cos(math.radians(HERE[0]))
    mask |= NO_VELOCITY if velocity_mps is None else 0
    mask |= NO_YAW if yaw_rad is None else 0
    return mavlink.MAVLink_set_position_target_global_int_message(
        t_ms & 0xFFFFFFFF,
        *(system, 1, frame, mask),
        round(HERE[0] * 1e7 + north_m / METRES_PER_E7),
        round(HERE[1] * 1e7 + east_m / scale),
        up_m,
        *(velocity_mps or (0.0, 0.0)),
        0.0,
        *(opens_m, manner, point_format),
        *(yaw_rad or 0.0, quickens_mps2),
    )


def reading(board_ms: int, range_m: float, name: bytes = RAW_NAME) -> Any:
    """A single reading of the sonar."""
    return mavlink.MAVLink_named_value_float_message(board_ms & 0xFFFFFFFF, name, range_m)


def _odd_point(rng: Random, t_ms: int) -> Any:
    far_m = rng.choice([3.0, 3.0, 30.0, 300.0, 1e5])
    moves = rng.random() < 0.8
    return point(
        t_ms,
        rng.uniform(-far_m, far_m),
        rng.uniform(-far_m, far_m),
        (odd(rng, -4.0, 4.0), odd(rng, -4.0, 4.0)) if moves else None,
        up_m=odd(rng, 0.0, 30.0),
        yaw_rad=odd(rng, -7.0, 7.0) if rng.random() < 0.6 else None,
        opens_m=odd(rng, 0.0, 8.0),
        manner=rng.choice([*map(float, Manner), odd(rng, 0.0, float(max(Manner)))]),
        point_format=rng.choice([POINT_FORMAT] * 6 + [0.0, 1.0, POINT_FORMAT - 1.0, math.nan]),
        quickens_mps2=odd(rng, -3.0, 3.0),
        mask=rng.choice([NO_ACCELERATION | NO_YAW_RATE] * 6 + [0, 0x0FFF, rng.randrange(1 << 16)]),
        system=rng.choice([1] * 8 + [0, 2]),
        frame=rng.choice([6] * 6 + [0, 3, 5, 11, rng.randrange(256)]),
    )


def _odd_reading(rng: Random, t_ms: int) -> Any:
    board_ms = rng.choice([t_ms, t_ms, t_ms - 40, t_ms - 5000, 0, rng.randrange(1 << 32)])
    name = rng.choice([RAW_NAME] * 8 + [b"SNR_PAN", b"", b"SNR_RAWxyz"])
    return reading(board_ms, odd(rng, 0.2, 8.0, 0.3), name)


def _other(rng: Random) -> Any:
    return rng.choice(
        [
            mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
            mavlink.MAVLink_statustext_message(2, rng.randbytes(20)),
            mavlink.MAVLink_attitude_message(0, *(odd(rng, -3.0, 3.0) for _ in range(6))),
        ]
    )


def whole(rng: Random, t_ms: int) -> bytes:
    """A frame with its right checksum, whatever it says."""
    kind = rng.random()
    message = (
        _odd_point(rng, t_ms)
        if kind < 0.6
        else _odd_reading(rng, t_ms)
        if kind < 0.95
        else _other(rng)
    )
    usual = TOOL if kind < 0.6 else BOARD
    sender = rng.choice([usual] * 5 + [STATION, STRANGER, BOARD, TOOL])
    return packed(message, sender, v1=rng.random() < 0.3, signed=rng.random() < 0.15)


def span(frame: bytes) -> tuple[int, int]:
    """Where the payload begins and ends."""
    start = HEAD_BYTES[frame[0]]
    return start, start + frame[LENGTH_AT]


def message_id(frame: bytes) -> int:
    return frame[5] if frame[0] == V1 else int.from_bytes(frame[7:10], "little")


def checksum(frame: bytes) -> int:
    """X.25 of what the frame covers, with the message's seed."""
    kind = mavlink.mavlink_map.get(message_id(frame))
    crc = x25crc(frame[1 : span(frame)[1]])
    crc.accumulate(bytes([kind.crc_extra if kind else 0]))
    return int(crc.crc)


def is_whole(frame: bytes) -> bool:
    """Whether its checksum is right."""
    end = span(frame)[1]
    return int.from_bytes(frame[end : end + 2], "little") == checksum(frame)


def sealed(frame: bytes) -> bytes:
    """The same with the checksum that its bytes ask for."""
    end = span(frame)[1]
    return frame[:end] + checksum(frame).to_bytes(2, "little") + frame[end + 2 :]


def spoiled(rng: Random, frame: bytes) -> bytes:
    """The same with a checksum that is wrong, and perhaps with another payload too."""
    start, end = span(frame)
    changed = bytearray(frame)
    for _ in range(rng.choice([0, 1, 1, 2, 8])):
        if end > start:
            changed[rng.randrange(start, end)] = rng.randrange(256)
    wrong = checksum(bytes(changed)) ^ rng.randrange(1, 1 << 16)
    changed[end : end + 2] = wrong.to_bytes(2, "little")
    return bytes(changed)


def _with_payload(frame: bytes, payload: bytes) -> bytes:
    start, end = span(frame)
    head = bytearray(frame[:start])
    head[LENGTH_AT] = len(payload)
    return bytes(head) + payload + frame[end:]


def mutated(rng: Random, frame: bytes) -> bytes:
    """A whole frame, changed as no sender would: payload, length, header."""
    start, end = span(frame)
    changed = bytearray(frame)
    how = rng.randrange(5)
    if how == 0 and end > start:
        for _ in range(rng.randrange(1, 6)):
            changed[rng.randrange(start, end)] ^= 1 << rng.randrange(8)
    elif how == 1:
        changed = bytearray(_with_payload(frame, frame[start : rng.randrange(start, end + 1)]))
    elif how == 2:
        more = rng.randbytes(rng.randrange(MOST_PAYLOAD - (end - start)))
        changed = bytearray(_with_payload(frame, frame[start:end] + more))
    elif how == 3:
        changed = bytearray(_with_payload(frame, rng.randbytes(rng.randrange(1, 60))))
    else:
        changed[rng.randrange(2 if frame[0] == V1 else 4, start)] = rng.randrange(256)
    return sealed(bytes(changed)) if rng.random() < 0.7 else bytes(changed)


def spliced(rng: Random, head: bytes, tail: bytes) -> bytes:
    """The head of one frame and the tail of another, as after a lost packet between them."""
    start, end = span(head)
    at = rng.randrange(start, end + 1)
    joined = (head[:at] + tail[rng.randrange(len(tail)) :] + tail)[: len(head)]
    return joined.ljust(len(head), b"\0")


def through_radio(rng: Random, stream: bytes, lost: float) -> list[bytes]:
    """The frames that a parser makes of what a radio leaves of a stream, whole or not."""
    cutter = PacketCutter(ByteLoss(byte_loss=lost, flip=lost / 2), rng)
    return [bytes(frame) for frame in Framer().cut(cutter.carry(stream))]
