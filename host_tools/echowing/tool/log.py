"""What `echowing follow` writes down: a .tlog of all frames, a CSV of all rows, events as text.

And what each sonar has read, with where its leader was then, for `echowing analyze --sonar`; before
that, by which sonar file it is flown.

A log that cannot be opened is refused. If writing fails later, that is reported once and the log
ends: it never stops the flight.
"""

import csv
import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from echowing.errors import EchowingError
from echowing.flight.hearing import Reading
from echowing.sonar_file import FlownBy
from echowing.tool.panel import COLUMNS, Row
from echowing.tool.track import Track

Say = Callable[[str], None]
# What the file of the sonars' readings ends with.
SONAR = "-sonar.jsonl"
# The key of its first line.
FLOWN_BY = "flown_by"


class FollowLog:
    """Logs of one flight in `folder`, named by the UTC time of the start.

    Raises EchowingError if nothing can be written.
    """

    def __init__(
        self, folder: Path, start_unix_s: float, say: Say, flown_by: FlownBy | None = None
    ) -> None:
        self._say = say
        self._tlog: BinaryIO | None = None
        self._table: TextIO | None = None
        self._events: TextIO | None = None
        self._sonar: TextIO | None = None
        stamp = datetime.fromtimestamp(start_unix_s, UTC).strftime("%Y%m%d-%H%M%S")
        self._fault = folder / f"follow-{stamp}-fault.json"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._tlog = (folder / f"follow-{stamp}.tlog").open("wb")
            self._table = (folder / f"follow-{stamp}.csv").open("w", newline="", encoding="utf-8")
            self._events = (folder / f"follow-{stamp}.txt").open("w", encoding="utf-8")
            self._sonar = (folder / f"follow-{stamp}{SONAR}").open("w", encoding="utf-8")
            names = ["unix_time_s", *COLUMNS, *(column.name for column in fields(Track))]
            self._writer = csv.DictWriter(self._table, names)
            self._writer.writeheader()
            self._table.flush()
            if flown_by is not None:
                self._sonar.write(json.dumps({FLOWN_BY: flown_by.as_dict()}) + "\n")
                self._sonar.flush()
        except OSError as error:
            raise EchowingError(
                f"--log {folder}: cannot be written: {error.strerror}; give another folder, "
                "or --no-log"
            ) from error

    def frame(self, unix_s: float, frame: bytes) -> None:
        """A frame received or sent."""
        if self._tlog is None:
            return
        try:
            self._tlog.write(struct.pack(">Q", round(unix_s * 1e6)) + frame)
        except OSError as error:
            self._give_up(error)

    def event(self, unix_s: float, text: str) -> None:
        """An event: one line that begins with its UTC time in seconds."""
        if self._events is None:
            return
        try:
            self._events.write(f"{unix_s:.3f} {' '.join(text.splitlines())}\n")
            self._events.flush()
        except OSError as error:
            self._give_up(error)

    def fault(self, text: str) -> None:
        """A fault of the tool, and what brings it again (see `tool.again`)."""
        try:
            self._fault.write_text(text, encoding="utf-8")
            self._say(f"log: the fault is in {self._fault}; please send us the folder")
        except OSError as error:
            self._give_up(error)

    def rows(self, unix_s: float, rows: Sequence[Row], tracks: Sequence[Track]) -> None:
        """The rows of one moment; then everything written so far is flushed to the disk."""
        if self._tlog is None or self._table is None:
            return
        try:
            for row, track in zip(rows, tracks, strict=True):
                self._writer.writerow(
                    {"unix_time_s": f"{unix_s:.3f}", **row.as_dict(), **track.as_dict()}
                )
            self._table.flush()
            self._tlog.flush()
        except OSError as error:
            self._give_up(error)

    def readings(self, start_unix_s: float, system_id: int, readings: Sequence[Reading]) -> None:
        """What a sonar has read, and where its leader was then; a line of JSON for each."""
        if self._sonar is None:
            return
        try:
            for one in readings:
                self._sonar.write(json.dumps(_line(start_unix_s, system_id, one)) + "\n")
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """End the logs."""
        files = (self._tlog, self._table, self._events, self._sonar)
        self._tlog = self._table = self._events = self._sonar = None
        for file in files:
            try:
                if file is not None:
                    file.close()
            except OSError as error:
                self._say(f"log: the end is missing: {error.strerror}")

    def _give_up(self, error: OSError) -> None:
        self._say(
            f"log: {error.filename or ''} cannot be written ({error.strerror}); flying goes on "
            "without a log"
        )
        self.close()


def _line(start_unix_s: float, system_id: int, one: Reading) -> dict[str, Any]:
    return {
        "unix_time_s": round(start_unix_s + one.time_s, 3),
        "system_id": system_id,
        "range_m": None if one.range_m is None else round(one.range_m, 3),
        "expected_m": round(one.expected_m, 3),
        "off_deg": round(math.degrees(one.off_rad), 1),
        "sure_deg": round(math.degrees(one.sure_rad), 1),
    }
