"""Writes an ArduPilot dataflash log (.BIN): self-describing messages, each after a magic.

Layout: libraries/AP_Logger (LogStructure.h); numbers and columns are ArduCopter 4.8's.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO, NamedTuple

MAGIC = b"\xa3\x95"
_FMT_ID = 128
_HEADER_BYTES = 3  # magic and message number
_FIRST_SCRIPT_ID = 210  # numbers above ArduCopter's own, counted up
_NAME_CHARACTERS = 4
GPS_EPOCH_UNIX_S = 315_964_800  # 1980-01-06
GPS_LEAP_S = 18  # since 2017
_WEEK_S = 604_800

Value = float | int | str


class ScriptMessage(NamedTuple):
    """A script's own message, without its time stamp; `units` and `multipliers` may be empty."""

    name: str
    labels: str
    letters: str
    units: str
    multipliers: str
    values: Sequence[Value]


# Format letter -> struct letter and the factor the value is stored with (LogStructure.h).
_LETTERS: dict[str, tuple[str, float]] = {
    "b": ("b", 1),
    "B": ("B", 1),
    "h": ("h", 1),
    "H": ("H", 1),
    "i": ("i", 1),
    "I": ("I", 1),
    "f": ("f", 1),
    "d": ("d", 1),
    "n": ("4s", 1),
    "N": ("16s", 1),
    "Z": ("64s", 1),
    "c": ("h", 100),
    "C": ("H", 100),
    "e": ("i", 100),
    "E": ("I", 100),
    "L": ("i", 1e7),
    "M": ("B", 1),
    "q": ("q", 1),
    "Q": ("Q", 1),
}
_WHOLE = set("bBhHiIqQcCeELM")
_TEXT = set("nNZ")

_UNITS = {
    "-": "",
    "?": "UNKNOWN",
    "#": "instance",
    "%": "%",
    "D": "deglatitude",
    "S": "satellites",
    "U": "deglongitude",
    "d": "deg",
    "h": "degheading",
    "m": "m",
    "n": "m/s",
    "o": "m/s/s",
    "r": "rad",
    "s": "s",
    "k": "deg/s",
}
_MULTIPLIERS = {
    "-": 0.0,
    "?": 1.0,
    "0": 1.0,
    "2": 1e2,
    "1": 1e1,
    "A": 1e-1,
    "B": 1e-2,
    "C": 1e-3,
    "F": 1e-6,
    "G": 1e-7,
}


@dataclass(frozen=True)
class _Kind:
    """One message: number, name, format letters, labels, units and multipliers."""

    number: int
    name: str
    letters: str
    labels: str
    units: str
    multipliers: str

    @property
    def layout(self) -> struct.Struct:
        return struct.Struct("<" + "".join(_LETTERS[letter][0] for letter in self.letters))


_KINDS = (
    _Kind(_FMT_ID, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----"),
    _Kind(118, "UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--"),
    _Kind(119, "MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--"),
    _Kind(117, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
    _Kind(32, "PARM", "QNff", "TimeUS,Name,Value,Default", "s---", "F---"),
    _Kind(59, "MSG", "QBBZ", "TimeUS,ID,Seq,Message", "s---", "F---"),
    _Kind(122, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---"),
    _Kind(
        94,
        "GPS",
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
        "s#-s-S-DUmnhnh-",
        "F--C-0BGGB000--",
    ),
    _Kind(74, "POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "sDUmmm", "FGG000"),
    _Kind(
        72,
        "ATT",
        "QffffffB",
        "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF",
        "sddddhh-",
        "F000000-",
    ),
    _Kind(
        44,
        "XKF1",
        "QBccCfffffffccce",
        "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH",
        "s#ddhnnnnmmmkkkm",
        "F-BBB0000000BBBB",
    ),
    _Kind(115, "RFND", "QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality", "s#m--%", "F-0---"),
    _Kind(
        8,
        "GUIP",
        "QBfffbffffff",
        "TimeUS,Type,pX,pY,pZ,Terrain,vX,vY,vZ,aX,aY,aZ",
        "s-mmm-nnnooo",
        "F-000-000000",
    ),
)


class DataflashLog:
    """Messages of one flight, written to a binary file as they come.

    Times are seconds since the autopilot started. Values are in the units the columns name.
    """

    def __init__(self, file: BinaryIO, t_s: float = 0.0) -> None:
        self._file = file
        self._kinds: dict[str, _Kind] = {}
        self._layouts: dict[str, struct.Struct] = {}
        self._next_id = _FIRST_SCRIPT_ID
        self._messages = 0
        for kind in _KINDS:
            self._describe(kind)
        for letter, label in _UNITS.items():
            self.write("UNIT", t_s, ord(letter), label)
        for letter, factor in _MULTIPLIERS.items():
            self.write("MULT", t_s, ord(letter), factor)
        for kind in _KINDS:
            self._unit_line(kind, t_s)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def write(self, name: str, t_s: float, *values: Value) -> None:
        """One message of a known kind; its time stamp first, then `values`."""
        kind = self._kinds[name]
        stored = [_stored(kind.letters[0], t_s * 1e6)]
        stored += [_stored(letter, v) for letter, v in zip(kind.letters[1:], values, strict=True)]
        self._file.write(MAGIC + bytes([kind.number]) + self._layouts[name].pack(*stored))

    def message(self, t_s: float, text: str) -> None:
        """MSG: a text as it went to the ground."""
        self._messages = (self._messages + 1) & 0xFF
        self.write("MSG", t_s, self._messages, 0, text)

    def gps(
        self,
        t_s: float,
        unix_s: float,
        place: tuple[float, float, float],
        velocity: tuple[float, float, float],
    ) -> None:
        """GPS: UTC seconds; degrees, degrees, metres; ground speed m/s, course deg, down m/s."""
        gps_s = unix_s - GPS_EPOCH_UNIX_S + GPS_LEAP_S
        week, week_s = divmod(gps_s, _WEEK_S)
        fix_3d, satellites, hdop = 3, 10, 1.21  # SITL's receiver
        lat_deg, lon_deg, alt_m = place
        in_use = 1
        self.write(
            "GPS",
            t_s,
            0,
            fix_3d,
            round(week_s * 1000.0),
            int(week),
            satellites,
            hdop,
            lat_deg,
            lon_deg,
            alt_m,
            *velocity,
            0.0,
            in_use,
        )

    def write_script(self, message: ScriptMessage, t_s: float) -> None:
        """A script's own message (`logger:write`); described at its first use."""
        name, labels, letters, units, multipliers, values = message
        if name not in self._kinds:
            kind = _Kind(
                self._next_id,
                name[:_NAME_CHARACTERS],
                "Q" + letters,
                "TimeUS," + labels,
                "s" + (units or "-" * len(letters)),
                "F" + (multipliers or "-" * len(letters)),
            )
            self._next_id += 1
            self._describe(kind)
            self._unit_line(kind, t_s)
        self.write(name, t_s, *values)

    def _describe(self, kind: _Kind) -> None:
        self._kinds[kind.name] = kind
        layout = self._layouts[kind.name] = kind.layout
        self._file.write(
            MAGIC
            + bytes([_FMT_ID])
            + struct.pack(
                "<BB4s16s64s",
                kind.number,
                layout.size + _HEADER_BYTES,
                kind.name.encode(),
                kind.letters.encode(),
                kind.labels.encode(),
            )
        )

    def _unit_line(self, kind: _Kind, t_s: float) -> None:
        self.write("FMTU", t_s, kind.number, kind.units, kind.multipliers)


def _stored(letter: str, value: Value) -> Value | bytes:
    if letter in _TEXT:
        return str(value).encode("ascii", "replace")
    if letter in _WHOLE:
        return round(float(value) * _LETTERS[letter][1])
    return float(value)
