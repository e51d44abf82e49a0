"""The autopilot's SD card over MAVLink: a server of its file transfer protocol over a folder.

Sessions, sequence numbers, answers told twice and refusals as ArduPilot's
(libraries/GCS_MAVLink/GCS_FTP.cpp), files as on its FAT card (libraries/AP_Filesystem): a rename
onto a file that is there is refused, and a full card is an input/output error. Not modelled: the
pauses of a burst, and the special folders (@PARAM, @SYS, @ROMFS).
"""

import errno
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from echowing.setup.ftp_format import DATA_BYTES, Fault, Op, Packet, ardupilot_crc32, next_sequence

SESSIONS = 5  # AP_MAVLINK_FTP_MAX_SESSIONS
# GCS_FTP.cpp: a silent session may be taken over after the first, and is closed after the second.
SESSION_TIMEOUT_S, SESSION_KILL_S = 3.0, 20.0
BURST_PACKETS = 2000

Sender = tuple[str, int, int]
"""Who asks: link, system id, component id."""


class Refusal(Exception):  # noqa: N818 (an answer, not an error)
    """A request is refused, with the data of its NACK."""

    def __init__(self, fault: Fault, number: int = 0) -> None:
        super().__init__(fault, number)
        self.data = bytes([fault, number]) if number else bytes([fault])


@dataclass(slots=True)
class _Session:
    sender: Sender
    number: int
    path: Path | None = None
    writing: bool = False
    sent_s: float | None = None

    def close(self) -> None:
        self.path = None
        self.sent_s = None


class FtpServer:
    """Answers file transfer requests on the folder `card`; None: there is no card.

    `capacity_bytes` is the size of the card, for what all its files hold together.
    """

    def __init__(self, card: Path | None, capacity_bytes: int | None = None) -> None:
        self.card = card
        self._capacity_bytes = capacity_bytes
        self._sessions: list[_Session] = []
        self._next_session = 1
        self._last: tuple[Sender, Packet] | None = None
        self._table: dict[int, Callable[[_Session, Packet], Packet]] = {
            Op.NONE: _acknowledged,
            Op.TERMINATE_SESSION: self._terminate,
            Op.LIST_DIRECTORY: self._list,
            Op.OPEN_FILE_RO: self._open_to_read,
            Op.READ_FILE: self._read,
            Op.CREATE_FILE: self._create,
            Op.OPEN_FILE_WO: self._open_to_write,
            Op.WRITE_FILE: self._write,
            Op.REMOVE_FILE: self._remove,
            Op.REMOVE_DIRECTORY: self._remove,
            Op.CREATE_DIRECTORY: self._make_folder,
            Op.RENAME: self._rename,
            Op.CALC_FILE_CRC32: self._checksum,
        }

    def answer(self, sender: Sender, payload: bytes, t_s: float) -> Iterator[bytes]:
        """The answers to a request, as messages' payloads."""
        request = Packet.unpacked(payload)
        for session in self._sessions:
            if session.sent_s is not None and t_s - session.sent_s > SESSION_KILL_S:
                session.close()
        if request.operation in (Op.ACK, Op.NACK):
            return
        for packet in self._answers(sender, request, t_s):
            self._last = (sender, packet)
            yield packet.packed()

    def _answers(self, sender: Sender, request: Packet, t_s: float) -> Iterator[Packet]:
        if request.operation == Op.RESET_SESSIONS:
            for session in self._sessions:
                if session.sender == sender:
                    session.close()
            yield _reply(request)
            return
        found = self._session(sender, request, t_s)
        if found is None:
            yield _reply(request, Op.NACK, bytes([Fault.NO_SESSIONS_AVAILABLE]))
            return
        repeated = self._repeated(sender, request, found)
        asked = _in_session(request, found.number)
        found.sent_s = None if request.operation == Op.TERMINATE_SESSION else t_s
        if repeated is not None:
            yield repeated
        elif request.operation == Op.BURST_READ_FILE:
            yield from self._burst(found, asked)
        else:
            yield self._one(found, asked)

    def _session(self, sender: Sender, request: Packet, t_s: float) -> _Session | None:
        for session in self._sessions:
            if (session.sender, session.number) == (sender, request.session):
                return session
        if len(self._sessions) == SESSIONS:
            oldest = min(self._sessions, key=lambda one: one.sent_s or 0.0)
            if oldest.sent_s is not None and t_s - oldest.sent_s < SESSION_TIMEOUT_S:
                return None
            self._sessions.remove(oldest)
        number = request.session
        if number == 0:
            number, self._next_session = self._next_session, self._next_session % 255 + 1
        self._sessions.append(_Session(sender, number))
        return self._sessions[-1]

    def _repeated(self, sender: Sender, request: Packet, session: _Session) -> Packet | None:
        """The last answer, where this is its request again."""
        if self._last is None:
            return None
        last_sender, packet = self._last
        same = (sender, session.number, next_sequence(request.sequence))
        return packet if same == (last_sender, packet.session, packet.sequence) else None

    def _one(self, session: _Session, request: Packet) -> Packet:
        act = self._table.get(request.operation)
        if act is None:
            return _reply(request, Op.NACK, bytes([Fault.UNKNOWN_COMMAND]))
        try:
            return act(session, request)
        except Refusal as refusal:
            return _reply(request, Op.NACK, refusal.data)
        except OSError as error:
            return _reply(request, Op.NACK, _errno_data(error.errno or errno.EIO))

    # ---- places ---------------------------------------------------------------------------------

    def _path(self, data: bytes) -> Path:
        """Where a name on the card is on this computer."""
        if not data:
            raise Refusal(Fault.INVALID_DATA_SIZE)
        if self.card is None:
            raise Refusal(Fault.FAIL_ERRNO, errno.EBUSY)  # FatFS: drive not ready
        name = PurePosixPath(data.split(b"\0")[0].decode("ascii", "replace").lstrip("/"))
        if ".." in name.parts:
            raise Refusal(Fault.FAIL_ERRNO, errno.EINVAL)
        return self.card / name

    def _free_bytes(self, without: Path) -> float:
        if self._capacity_bytes is None or self.card is None:
            return float("inf")
        files = (one for one in self.card.rglob("*") if one.is_file() and one != without)
        return self._capacity_bytes - sum(one.stat().st_size for one in files)

    # ---- operations -----------------------------------------------------------------------------

    def _terminate(self, session: _Session, request: Packet) -> Packet:
        session.close()
        return _reply(request)

    def _list(self, session: _Session, request: Packet) -> Packet:
        folder = self._path(request.data)
        entries = [_entry(one) for one in sorted(folder.iterdir())][request.offset :]
        listed = b""
        for entry in entries:
            if len(listed) + len(entry) >= DATA_BYTES:
                break
            listed += entry
        if not listed:
            raise Refusal(Fault.END_OF_FILE)
        return _reply(request, data=listed, offset=request.offset)

    def _open_to_read(self, session: _Session, request: Packet) -> Packet:
        path = self._opened(session, request)
        size = path.stat().st_size
        session.path, session.writing = path, False
        return _reply(request, data=size.to_bytes(4, "little"))

    def _create(self, session: _Session, request: Packet) -> Packet:
        path = self._opened(session, request)
        path.write_bytes(b"")
        session.path, session.writing = path, True
        return _reply(request)

    def _open_to_write(self, session: _Session, request: Packet) -> Packet:
        path = self._opened(session, request)
        path.touch()
        session.path, session.writing = path, True
        return _reply(request)

    def _opened(self, session: _Session, request: Packet) -> Path:
        if session.path is not None:
            raise Refusal(Fault.FAIL)
        return self._path(request.data)

    def _file(self, session: _Session, *, writing: bool) -> Path:
        if session.path is None:
            raise Refusal(Fault.FILE_NOT_FOUND)
        if session.writing != writing:
            raise Refusal(Fault.FAIL)
        return session.path

    def _read(self, session: _Session, request: Packet) -> Packet:
        content = self._file(session, writing=False).read_bytes()
        end = request.offset + min(request.size or 0, DATA_BYTES)
        if request.offset >= len(content):
            raise Refusal(Fault.END_OF_FILE)
        return _reply(request, data=content[request.offset : end], offset=request.offset)

    def _burst(self, session: _Session, request: Packet) -> Iterator[Packet]:
        """One packet after the other to the end of the file, each with the next number."""
        offset = request.offset
        for count in range(BURST_PACKETS):
            step = Packet(
                (request.sequence + count) % 0x10000,
                request.session,
                Op.READ_FILE,
                offset=offset,
                size=request.size or DATA_BYTES,
            )
            reply = self._one(session, step)
            last = reply.operation == Op.NACK or count == BURST_PACKETS - 1
            yield Packet(
                reply.sequence,
                reply.session,
                reply.operation,
                reply.data,
                offset,
                answered=Op.BURST_READ_FILE,
                burst_complete=last,
            )
            if last:
                return
            offset += len(reply.data)

    def _write(self, session: _Session, request: Packet) -> Packet:
        path = self._file(session, writing=True)
        if request.offset + len(request.data) > self._free_bytes(path):
            raise Refusal(Fault.FAIL_ERRNO, errno.EIO)
        with path.open("r+b") as file:
            file.seek(request.offset)
            file.write(request.data)
        return _reply(request, offset=request.offset)

    def _remove(self, session: _Session, request: Packet) -> Packet:
        path = self._path(request.data)
        if path.is_dir():
            path.rmdir()
        else:
            path.unlink()
        return _reply(request)

    def _make_folder(self, session: _Session, request: Packet) -> Packet:
        self._path(request.data).mkdir()
        return _reply(request)

    def _rename(self, session: _Session, request: Packet) -> Packet:
        before, between, after = request.data.partition(b"\0")
        if not between or not after:
            raise Refusal(Fault.INVALID_DATA_SIZE)
        source, target = self._path(before), self._path(after)
        if target.exists():
            raise Refusal(Fault.FILE_EXISTS)
        source.rename(target)
        return _reply(request)

    def _checksum(self, session: _Session, request: Packet) -> Packet:
        checksum = ardupilot_crc32(self._path(request.data).read_bytes())
        return _reply(request, data=checksum.to_bytes(4, "little"))


def _acknowledged(session: _Session, request: Packet) -> Packet:
    return _reply(request)


def _reply(request: Packet, operation: Op = Op.ACK, data: bytes = b"", offset: int = 0) -> Packet:
    sequence = next_sequence(request.sequence)
    return Packet(sequence, request.session, operation, data, offset, answered=request.operation)


def _in_session(request: Packet, number: int) -> Packet:
    return Packet(
        request.sequence, number, request.operation, request.data, request.offset, request.size
    )


def _errno_data(number: int) -> bytes:
    """A system's error as GCS_FTP.cpp tells it: two of them have names."""
    named = {errno.EEXIST: Fault.FILE_EXISTS, errno.ENOENT: Fault.FILE_NOT_FOUND}
    if number in named:
        return bytes([named[number]])
    return bytes([Fault.FAIL_ERRNO, number])


def _entry(path: Path) -> bytes:
    if path.is_dir():
        return f"D{path.name}\0".encode()
    return f"F{path.name}\t{path.stat().st_size}\0".encode()
