"""MAVLink frames out of bytes, cut as ArduPilot cuts them: whole ones and broken ones alike.

ArduPilot's parser (mavlink_frame_char_buffer, mavlink_helpers.h) is a state machine that never goes
back: a frame whose end is missing takes its length from what comes next, and what it has swallowed
is gone. Whether a frame's checksum is right is for others to say.
"""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_V1, _V2 = 0xFE, 0xFD
_V1_AROUND, _V2_AROUND = 8, 12  # bytes of a frame without its payload: header and checksum
_HEAD = 3  # with so many bytes the length of a frame is known
_SIGNED = mavlink.MAVLINK_IFLAG_SIGNED  # the one incompatibility flag there is


class Framer:
    """The parser of one port."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def cut(self, data: bytes) -> list[bytearray]:
        """The frames that end in `data`; what has begun is kept."""
        waiting = self._waiting
        waiting += data
        frames = []
        at = _start(waiting, 0)
        while len(waiting) - at >= _HEAD:
            if waiting[at] == _V2 and waiting[at + 2] & ~_SIGNED:
                at = _start(waiting, at + _HEAD)  # a frame of another kind: seen by its third byte
                continue
            end = at + _length(waiting, at)
            if end > len(waiting):
                break
            frames.append(waiting[at:end])
            at = _start(waiting, end)
        del waiting[:at]
        return frames


def _start(data: bytearray, at: int) -> int:
    """Where the next frame seems to begin; the end of the data: nowhere."""
    while at < len(data) and data[at] not in (_V1, _V2):
        at += 1
    return at


def _length(data: bytearray, at: int) -> int:
    payload = data[at + 1]
    if data[at] == _V1:
        return _V1_AROUND + payload
    signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[at + 2] & _SIGNED else 0
    return _V2_AROUND + payload + int(signature)
