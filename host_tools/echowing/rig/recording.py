"""A recording: every byte from the board, with its time of arrival.

The file: one line of text, `echowing-recording 1 ` and a JSON object (port, baud, started); then
records, each of a 64-bit time in microseconds since the start, a 32-bit number of bytes (both
little endian), and the bytes. Records are flushed as they are written: a crash can cut only
the last record, and a reader stops before it.
"""

import json
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from echowing.errors import EchowingError

MAGIC = b"echowing-recording 1 "

_RECORD = struct.Struct("<QI")
_LONGEST_RECORD = 1 << 20  # a read gives a few kilobytes: more is no record
_LONGEST_HEADER = 4096


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that arrived together. time_s: since the start of the recording."""

    time_s: float
    data: bytes


class Recorder:
    """Writes a recording. Raises EchowingError where the file cannot be written."""

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        self.path = path
        self.bytes = 0
        try:
            # Unbuffered: each record is one write, and out of our hands when it returns.
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise EchowingError(f"{path}: exists already; give another name") from error
        except OSError as error:
            raise EchowingError(f"{path}: cannot be written ({error.strerror})") from error
        self._write(MAGIC + json.dumps(about).encode() + b"\n")

    def add(self, time_s: float, data: bytes) -> None:
        """Bytes have come, `time_s` after the start."""
        self._write(_RECORD.pack(round(time_s * 1e6), len(data)) + data)
        self.bytes += len(data)

    def _write(self, record: bytes) -> None:
        try:
            written = self._file.write(record)
        except OSError as error:
            raise EchowingError(f"{self.path}: cannot be written ({error.strerror})") from error
        if written != len(record):
            raise EchowingError(f"{self.path}: cannot be written (the disk is full)")

    def close(self) -> None:
        """The end."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording as it was read."""

    about: dict[str, Any]
    chunks: tuple[Chunk, ...]

    @property
    def duration_s(self) -> float:
        """Until the last byte."""
        return self.chunks[-1].time_s if self.chunks else 0.0


def read_recording(path: Path) -> Recording:
    """Read a recording; a last record that was cut short is left out.

    Raises EchowingError when the file cannot be read or is none.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise EchowingError(f"{path}: cannot be read ({error.strerror})") from error
    header, newline, _ = content[:_LONGEST_HEADER].partition(b"\n")
    if not header.startswith(MAGIC) or not newline:
        raise EchowingError(f"{path}: is not a recording of `echowing rig record`")
    try:
        about = dict(json.loads(header.removeprefix(MAGIC)).items())
    except (ValueError, AttributeError) as error:
        raise EchowingError(f"{path}: the recording's first line is damaged") from error
    return Recording(about, tuple(_chunks(content[len(header) + 1 :], path)))


def _chunks(records: bytes, path: Path) -> Iterator[Chunk]:
    at, before_us = 0, 0
    while at + _RECORD.size <= len(records):
        time_us, length = _RECORD.unpack_from(records, at)
        if length > _LONGEST_RECORD or time_us < before_us:
            raise EchowingError(f"{path}: the recording is damaged at its byte {at} of records")
        at += _RECORD.size
        if at + length > len(records):
            return
        yield Chunk(time_us / 1e6, records[at : at + length])
        at, before_us = at + length, time_us


class RecordingEnd(EchowingError):  # noqa: N818 (an end, not an error, unless nothing was in it)
    """The recording is over."""


class ReplayWire:
    """A recording in the place of the cable (`ports.Wire`), and the clock that goes with it.

    `sleep` is what makes it last as long as it did: none, and it is as fast as it goes.
    """

    def __init__(
        self,
        recording: Recording,
        name: str,
        sleep: Callable[[float], None] | None = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._chunks = iter(recording.chunks)
        self._next = next(self._chunks, None)
        self._name = name
        self._sleep = sleep
        self._clock = clock
        self._start_s = clock()
        self._now_s = 0.0

    def now_s(self) -> float:
        """Time in the recording, seconds since its start."""
        return self._now_s

    def read(self, timeout_s: float) -> bytes:
        """As `Wire`. Raises RecordingEnd."""
        if self._next is None:
            raise RecordingEnd(f"{self._name}: the recording ends after {self._now_s:.1f} s")
        due_s = min(self._next.time_s, self._now_s + max(0.0, timeout_s))
        self._advance(due_s)
        if self._next.time_s > due_s:
            return b""
        data, self._next = self._next.data, next(self._chunks, None)
        return data

    def _advance(self, to_s: float) -> None:
        self._now_s = max(self._now_s, to_s)
        if self._sleep is not None:
            self._sleep(max(0.0, self._start_s + self._now_s - self._clock()))

    def write(self, data: bytes) -> None:
        """As `Wire`: nobody hears it."""

    def understood(self) -> None:
        """As `Wire`."""

    def close(self) -> None:
        """As `Wire`."""
