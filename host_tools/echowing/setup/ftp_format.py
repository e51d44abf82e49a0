"""MAVLink's file transfer (FILE_TRANSFER_PROTOCOL): what is in its 251 bytes.

Layout and numbers from MAVLink's page on the file transfer protocol; the checksum as ArduPilot
makes it (libraries/AP_Filesystem/AP_Filesystem.cpp, crc32).
"""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

_HEADER = struct.Struct("<HBBBBBxI")
PAYLOAD_BYTES = 251
DATA_BYTES = PAYLOAD_BYTES - _HEADER.size  # 239
SEQUENCES = 0x10000


class Op(IntEnum):
    """What is asked, and the two answers."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    REMOVE_DIRECTORY = 10
    OPEN_FILE_WO = 11
    TRUNCATE_FILE = 12
    RENAME = 13
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15
    ACK = 128
    NACK = 129


class Fault(IntEnum):
    """Why something was refused: the first byte of a NACK's data."""

    FAIL = 1
    FAIL_ERRNO = 2  # the second byte is the system's error number
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


@dataclass(frozen=True, slots=True)
class Packet:
    """One request or one answer.

    size: of the data that counts; where a read is asked for, the bytes wanted. answered: in an
    answer, the request's operation. offset: bytes into the file, or entries into a folder.
    """

    sequence: int
    session: int
    operation: int
    data: bytes = b""
    offset: int = 0
    size: int | None = None
    answered: int = 0
    burst_complete: bool = False

    def packed(self) -> bytes:
        """The 251 bytes of the message."""
        size = len(self.data) if self.size is None else self.size
        head = _HEADER.pack(
            self.sequence,
            self.session,
            self.operation,
            size,
            self.answered,
            self.burst_complete,
            self.offset,
        )
        return (head + self.data).ljust(PAYLOAD_BYTES, b"\0")

    @classmethod
    def unpacked(cls, payload: bytes) -> "Packet":
        """The packet in a message's bytes (as many as came: zeros at the end are not sent)."""
        payload = payload.ljust(PAYLOAD_BYTES, b"\0")
        sequence, session, operation, size, answered, burst, offset = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)]
        return cls(sequence, session, operation, data, offset, size, answered, bool(burst))


def next_sequence(sequence: int) -> int:
    """The number after this one; an answer bears the one after its request's."""
    return (sequence + 1) % SEQUENCES


def ardupilot_crc32(content: bytes) -> int:
    """CRC-32 of a file as ArduPilot computes it: begun at 0 and not inverted, unlike zlib's."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF
