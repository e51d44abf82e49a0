"""Files on the autopilot's SD card over MAVLink (MAVFTP); works with lost packets.

A client of our own, and not pymavlink's `mavftp`: that one wants a blocking `mavutil` connection
(ours are non-blocking, may be signed and come back by themselves), keeps the checksum it asked for
to its log, and gives up an upload where a session was lost in the middle. What the autopilot does
stands in ArduPilot's libraries/GCS_MAVLink/GCS_FTP.cpp.
"""

import errno
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from echowing.errors import EchowingError
from echowing.mavlink.plausible import printable
from echowing.setup.ftp_format import DATA_BYTES, SEQUENCES, Fault, Op, Packet, next_sequence

# A frame of this fits a telemetry radio's packet of 252 bytes, signed: 12 of MAVLink's header
# and checksum, 3 of the target, 12 of the file transfer's header, 13 of the signature.
BLOCK_BYTES = 200
# ArduPilot keeps five requests waiting (GCS_FTP.h, requests): one is left for others.
BLOCKS_AT_ONCE = 4
# A lost packet is requested again after the first time, then after twice as long, up to the second.
RETRY_S, LONGEST_RETRY_S = 0.6, 1.5
GIVE_UP_S = 15.0
# Shorter than any request, so that numbers by the clock are ahead of the used ones.
SEQUENCE_STEP_S = 1e-4
# A request that the server keeps refusing because another has a session is tried this often.
BUSY_TRIES = 6
# A session lost more often than this in one transfer is not worth opening again.
REOPENINGS = 5

_SESSION_LOST = {Fault.INVALID_SESSION, Fault.FILE_NOT_FOUND}

Progress = Callable[[int, int], None]
"""Told the bytes done and the bytes in all."""


class Wire(Protocol):
    """Sends and receives packets: a `Vehicle`."""

    def now_s(self) -> float:
        """The time."""

    def send_file_request(self, payload: bytes) -> None:
        """Send a request."""

    def file_answers(self, timeout_s: float) -> list[bytes]:
        """New answers; waits at most `timeout_s` for the first."""


class FtpRefusedError(EchowingError):
    """The autopilot has refused a request."""

    def __init__(self, what: str, fault: int, number: int = 0) -> None:
        self.fault, self.number = fault, number
        super().__init__(f"{what}: {_reason(fault, number)}")

    @property
    def not_there(self) -> bool:
        """Whether the reason is that the file or folder does not exist."""
        return self.fault == Fault.FILE_NOT_FOUND


class NoAnswerError(EchowingError):
    """The autopilot does not answer file requests at all."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A file or folder on the card."""

    name: str
    is_folder: bool
    size_bytes: int = 0


@dataclass(slots=True)
class _Sent:
    """When a piece of a file was requested, and how long to wait for the answer."""

    at_s: float
    retry_s: float = RETRY_S


class FtpClient:
    """Sends one request after the other; a transfer keeps a few blocks in flight.

    `session` is a number from 1 to 255 of our own: 0, which leaves the choice to the autopilot,
    makes newer ones open a session for every request. `give_up_s`: of silence, ends the work.
    """

    def __init__(self, wire: Wire, session: int = 0xEC, give_up_s: float = GIVE_UP_S) -> None:
        self._wire = wire
        self._give_up_s = give_up_s
        self._session = session
        # The autopilot repeats its last answer to a number it has just had (GCS_FTP.cpp): a new
        # client must not begin where a former one did, so it begins with the time.
        self._sequence = int(wire.now_s() / SEQUENCE_STEP_S) % SEQUENCES

    def reset(self) -> None:
        """Close what an earlier run may have left open."""
        self._request("file transfer", Op.RESET_SESSIONS)

    def entries(self, folder: str) -> list[Entry]:
        """The contents of a folder. Raises FtpRefusedError."""
        found: list[Entry] = []
        while True:
            try:
                data = self._request(folder, Op.LIST_DIRECTORY, folder.encode(), len(found)).data
            except FtpRefusedError as refusal:
                if refusal.fault == Fault.END_OF_FILE:
                    return found
                raise
            found += [_entry(text) for text in data.split(b"\0") if text]

    def make_folder(self, folder: str) -> None:
        """Make a folder; it may exist already."""
        try:
            self._request(folder, Op.CREATE_DIRECTORY, folder.encode())
        except FtpRefusedError as refusal:
            if refusal.fault != Fault.FILE_EXISTS:
                raise

    def remove(self, path: str) -> None:
        """Remove a file; it need not exist."""
        try:
            self._request(path, Op.REMOVE_FILE, path.encode())
        except FtpRefusedError as refusal:
            if not refusal.not_there:
                raise

    def rename(self, before: str, after: str) -> None:
        """Rename a file; FAT refuses to rename onto an existing file."""
        self._request(after, Op.RENAME, before.encode() + b"\0" + after.encode())

    def checksum(self, path: str) -> int | None:
        """CRC-32 as `ardupilot_crc32`; None if the autopilot cannot compute it."""
        try:
            reply = self._request(path, Op.CALC_FILE_CRC32, path.encode())
        except FtpRefusedError as refusal:
            if refusal.fault == Fault.UNKNOWN_COMMAND:
                return None
            raise
        return int.from_bytes(reply.data[:4], "little")

    def upload(self, path: str, content: bytes, progress: Progress) -> None:
        """Write a file. The old content of `path` is lost, also if writing fails."""
        self._request(path, Op.CREATE_FILE, path.encode())
        offsets = range(0, len(content), BLOCK_BYTES)

        def request(offset: int) -> Packet:
            data = content[offset : offset + BLOCK_BYTES]
            return self._packet(Op.WRITE_FILE, data, offset)

        def take(offset: int, data: bytes, done: int) -> None:
            progress(min(done * BLOCK_BYTES, len(content)), len(content))

        self._transfer(path, offsets, Op.OPEN_FILE_WO, request, take)
        self._request(path, Op.TERMINATE_SESSION)

    def download(self, path: str, progress: Progress) -> bytes:
        """Read a file; some boards return less at a time than was requested."""
        content = _Patchwork(self._open_to_read(path))

        def request(offset: int) -> Packet:
            return self._packet(Op.READ_FILE, b"", offset, wanted[offset])

        def take(offset: int, data: bytes, done: int) -> None:
            content.pieces[offset] = data
            progress(content.known_bytes, content.size)

        while wanted := content.holes():
            before = content.known_bytes
            self._transfer(path, wanted, Op.OPEN_FILE_RO, request, take)
            if content.known_bytes == before:
                raise EchowingError(f"{path}: the autopilot returns empty pieces of it")
        self._request(path, Op.TERMINATE_SESSION)
        return content.joined()

    def _open_to_read(self, path: str) -> int:
        return int.from_bytes(
            self._request(path, Op.OPEN_FILE_RO, path.encode()).data[:4], "little"
        )

    # ---- one request ----------------------------------------------------------------------------

    def _packet(
        self, operation: Op, data: bytes = b"", offset: int = 0, size: int | None = None
    ) -> Packet:
        self._sequence = next_sequence(self._sequence)
        return Packet(self._sequence, self._session, operation, data, offset, size)

    def _request(self, what: str, operation: Op, data: bytes = b"", offset: int = 0) -> Packet:
        """Repeat the request until it is answered. Raises FtpRefusedError or NoAnswerError."""
        if len(data) > DATA_BYTES:
            raise EchowingError(f"{what}: the name is longer than {DATA_BYTES} characters")
        for _ in range(BUSY_TRIES):
            answer = self._answer_to(self._packet(operation, data, offset), what)
            if _fault(answer) != Fault.NO_SESSIONS_AVAILABLE:
                break
            self._pause(LONGEST_RETRY_S)
        self._check(what, answer)
        return answer

    def _answer_to(self, packet: Packet, what: str) -> Packet:
        """The same request, with the same number, until its answer comes."""
        give_up_s = self._wire.now_s() + self._give_up_s
        retry_s = RETRY_S
        while self._wire.now_s() < give_up_s:
            self._wire.send_file_request(packet.packed())
            again_s = self._wire.now_s() + retry_s
            retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
            while (left_s := again_s - self._wire.now_s()) > 0.0:
                for answer in self._answers(left_s):
                    if _answers_to(answer, packet):
                        self._session = answer.session or self._session
                        return answer
        raise NoAnswerError(
            f"{what}: no answer to file requests for {self._give_up_s:g} s; this autopilot has no "
            "MAVFTP (BRD_OPTIONS bit 1 switches it off), or the link does not carry MAVLink 2"
        )

    def _answers(self, timeout_s: float) -> list[Packet]:
        return [Packet.unpacked(payload) for payload in self._wire.file_answers(timeout_s)]

    def _pause(self, seconds: float) -> None:
        until_s = self._wire.now_s() + seconds
        while (left_s := until_s - self._wire.now_s()) > 0.0:
            self._wire.file_answers(left_s)

    def _check(self, what: str, answer: Packet) -> None:
        fault = _fault(answer)
        if fault is not None:
            raise FtpRefusedError(what, fault, answer.data[1] if len(answer.data) > 1 else 0)

    # ---- many blocks ----------------------------------------------------------------------------

    def _transfer(
        self,
        path: str,
        offsets: Iterable[int],
        reopen: Op,
        request: Callable[[int], Packet],
        take: Callable[[int, bytes, int], None],
    ) -> None:
        """Carry out `request` for every offset, a few at a time, each until it is answered.

        `take` gets the offset, the answer's data and how many are done. A session that the
        autopilot has lost is opened again with `reopen`.
        """
        blocks = _Blocks(offsets, request)
        openings_left = REOPENINGS
        heard_s = self._wire.now_s()
        while blocks.unfinished:
            for packet in blocks.due(self._wire.now_s()):
                self._wire.send_file_request(packet.packed())
            for answer in self._answers(RETRY_S / 4.0):
                offset = blocks.asked_with(answer.sequence)
                if offset is None:
                    continue
                heard_s = self._wire.now_s()
                if openings_left and _fault(answer) in _SESSION_LOST:
                    openings_left -= 1
                    blocks.ask_all_again()
                    self._request(path, reopen, path.encode())
                    break
                self._check(path, answer)
                take(offset, answer.data, blocks.finish(offset))
            if self._wire.now_s() - heard_s > self._give_up_s:
                raise NoAnswerError(f"{path}: the autopilot stopped answering in the middle")


class _Patchwork:
    """A file of known size, put together from pieces by their offsets."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.pieces: dict[int, bytes] = {}

    @property
    def known_bytes(self) -> int:
        """How much of it there is."""
        return sum(map(len, self.pieces.values()))

    def holes(self) -> dict[int, int]:
        """What is missing: offsets, and how many bytes to ask for there."""
        found: dict[int, int] = {}
        end = 0
        for offset in [*sorted(self.pieces), self.size]:
            for start in range(end, offset, BLOCK_BYTES):
                found[start] = min(BLOCK_BYTES, offset - start)
            end = offset + len(self.pieces.get(offset, b""))
        return found

    def joined(self) -> bytes:
        """All of it, once there are no holes."""
        return b"".join(self.pieces[offset] for offset in sorted(self.pieces))


class _Blocks:
    """The pieces of a file: which are to come, which are on their way, and when to ask again."""

    def __init__(self, offsets: Iterable[int], request: Callable[[int], Packet]) -> None:
        self._left = deque(offsets)
        self._total = len(self._left)
        self._request = request
        self._on_the_way: dict[int, _Sent] = {}
        self._numbers: dict[int, int] = {}  # of answers, also of late ones, and their offsets

    @property
    def unfinished(self) -> int:
        """How many are not answered."""
        return len(self._left) + len(self._on_the_way)

    def due(self, now_s: float) -> Iterator[Packet]:
        """Requests to send now: for what was lost, and for as much more as may be on its way."""
        for offset, sent in self._on_the_way.items():
            if now_s - sent.at_s >= sent.retry_s:
                sent.at_s, sent.retry_s = now_s, min(2.0 * sent.retry_s, LONGEST_RETRY_S)
                yield self._packet(offset)
        while self._left and len(self._on_the_way) < BLOCKS_AT_ONCE:
            offset = self._left.popleft()
            self._on_the_way[offset] = _Sent(now_s)
            yield self._packet(offset)

    def _packet(self, offset: int) -> Packet:
        packet = self._request(offset)
        self._numbers[next_sequence(packet.sequence)] = offset
        return packet

    def asked_with(self, number: int) -> int | None:
        """The offset that this answer is to; None: to none that is waited for."""
        offset = self._numbers.get(number)
        return offset if offset in self._on_the_way else None

    def finish(self, offset: int) -> int:
        """It is answered; returns how many are."""
        del self._on_the_way[offset]
        return self._total - self.unfinished

    def ask_all_again(self) -> None:
        """Nothing of what is on its way will be answered."""
        self._left.extendleft(sorted(self._on_the_way, reverse=True))
        self._on_the_way.clear()


def _answers_to(answer: Packet, request: Packet) -> bool:
    return (
        answer.sequence == next_sequence(request.sequence)
        and answer.answered == request.operation
        and answer.operation in (Op.ACK, Op.NACK)
    )


def _fault(answer: Packet) -> int | None:
    """Why it was refused; None: it was not."""
    if answer.operation == Op.ACK:
        return None
    return answer.data[0] if answer.data else int(Fault.FAIL)


def _entry(text: bytes) -> Entry:
    kind, rest = text[:1], text[1:].decode("utf-8", "replace")
    if kind == b"D":
        return Entry(printable(rest), is_folder=True)
    name, _, size = rest.partition("\t")
    return Entry(printable(name), is_folder=False, size_bytes=int(size) if size.isdecimal() else 0)


# FatFS returns this if the card is missing or broken (AP_Filesystem_FATFS.cpp, fatfs_to_errno).
_NO_CARD = {errno.EBUSY, errno.ENODEV, errno.ENXIO}
_REASONS = {
    Fault.FAIL: "refused; is the file open elsewhere?",
    Fault.INVALID_DATA_SIZE: "the autopilot does not accept a name of that length",
    Fault.INVALID_SESSION: "another tool has a file open; end it and try again",
    Fault.NO_SESSIONS_AVAILABLE: "other tools have all file sessions open; end them and try again",
    Fault.END_OF_FILE: "the file is shorter than it should be",
    Fault.UNKNOWN_COMMAND: "this firmware cannot do that; update to ArduCopter 4.5 or later",
    Fault.FILE_EXISTS: "the file exists already",
    Fault.FILE_PROTECTED: "the file is write-protected",
    Fault.FILE_NOT_FOUND: "not there",
}


def _reason(fault: int, number: int) -> str:
    if fault == Fault.FAIL_ERRNO and number in _NO_CARD:
        return "the autopilot has no SD card, or cannot use it"
    if fault == Fault.FAIL_ERRNO and number in (errno.EIO, errno.ENOSPC):
        return "the card cannot be written or read: full or broken"
    if fault == Fault.FAIL_ERRNO:
        return f"refused: {os.strerror(number)}"
    return _REASONS.get(Fault(fault), "refused") if fault in list(Fault) else f"refused ({fault})"
