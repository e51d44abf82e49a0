"""One vehicle's recording, read through pymavlink: `.tlog` (telemetry) and `.BIN` (dataflash).

Every time is UTC, Unix seconds, on the vehicle's own GPS-disciplined clock where it has one. No
message of ArduPilot's simulator is ever read: a real log has none.
"""

import contextlib
import math
import os
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from echowing.analysis.flight import SHIPPED_INSET_M, Floats
from echowing.errors import EchowingError
from echowing.flight.leader_track import VehicleClock

FORWARD = 0  # MAV_SENSOR_ROTATION_NONE, the sonar's mounting
COPTER_GUIDED = 4  # ArduCopter's mode numbers
FIX_3D = 3  # GPS status of a usable fix
RANGE_GOOD = 4  # RFND.Stat: 0 not connected, 1 no data, 2 too near, 3 too far, 4 good
NO_HEADING_CDEG = 65535
AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
NOT_AN_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: heartbeats of co-processors, ground stations
DATAFLASH_START = b"\xa3\x95"
# MAV_TYPE: quadrotor, coaxial, helicopter, hexa-, octo-, tri-, dodeca-, decarotor.
COPTER_TYPES = {2, 3, 4, 13, 14, 15, 29, 35}

# The applet's names first, then those of other speed and sonar scripts, all in m/s or m or us.
SPEED_NAMES = ("ECHO_SPD", "VCMD")
SPEED_PARAMETERS = {"WP_SPD": 1.0, "WPNAV_SPEED": 0.01}  # to m/s
SONAR_NAMES = ("SNR_RAW",)
INSET_NAME = "ECHO_INSET"
PAN_NAME, TILT_NAME = "SNR_PAN", "SNR_TILT"
# What the sonar can tell (MB1202 datasheet): from 7.65 m on it means "no target".
SONAR_NEAREST_M, SONAR_NOTHING_M = 0.20, 7.65
NAMED = {*SPEED_NAMES, *SONAR_NAMES, PAN_NAME, TILT_NAME}

# A .tlog: microseconds in 8 bytes, then a MAVLink frame (header, payload, checksum, signature).
STAMP_BYTES, MAVLINK_1, MAVLINK_2, SIGNATURE_BYTES = 8, 0xFE, 0xFD, 13
FRAME_OVERHEAD = {MAVLINK_1: 6 + 2, MAVLINK_2: 10 + 2}
LONGEST_PAUSE_S = 86_400.0  # within one recording; a greater jump is a damaged time stamp
GPS_EPOCH_UNIX_S = 315_964_800  # 1980-01-06
WEEK_S = 604_800
# GPS time minus UTC from each moment on (IERS Bulletin C), newest first; Unix seconds.
LEAP_SECONDS = (
    (1_483_228_800, 18),  # 2017-01-01
    (1_435_708_800, 17),  # 2015-07-01
    (1_341_100_800, 16),  # 2012-07-01
    (0, 15),
)

TLOG_TYPES = [
    "HEARTBEAT",
    "SYSTEM_TIME",
    "TIMESYNC",
    "GLOBAL_POSITION_INT",
    "DISTANCE_SENSOR",
    "NAMED_VALUE_FLOAT",
    "PARAM_VALUE",
    "VFR_HUD",
]
DATAFLASH_TYPES = [
    *("MSG", "RTC", "GPS", "POS", "XKF1", "NKF1", "ATT", "MODE"),
    *("RFND", "NVF", "ECHO", "PARM", "CTUN"),
]


@dataclass
class Series:
    """Samples (time, value, …) in order of time, as they come."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.rows)

    def array(self) -> Floats:
        """(n, columns), times rising, repeated times dropped."""
        if not self.rows:
            return np.empty((0, 2))
        table = np.array(sorted(self.rows), dtype=float)
        fresh = np.diff(table[:, 0], prepend=-math.inf) > 0.0
        return np.asarray(table[fresh])


@dataclass
class VehicleLog:
    """What one vehicle recorded, as far as the analysis needs it.

    position: (UTC s, latitude deg, longitude deg, altitude AMSL m); velocity: (s, north, east,
    down m/s); yaw: (s, rad); sonar: (s, m or NaN for "no target"); speed_command: (s, m/s);
    pan, tilt: (s, us); guided: (s, 1 in Guided, else 0); throttle: (s, 0 to 1). clock: "gps";
    without GPS time "ground", the ground computer's by TIMESYNC, or "receive", its time of
    reception.
    """

    path: Path
    kind: str
    system_id: int
    clock: str = "gps"
    position: Series = field(default_factory=Series)
    velocity: Series = field(default_factory=Series)
    yaw: Series = field(default_factory=Series)
    sonar: Series = field(default_factory=Series)
    speed_command: Series = field(default_factory=Series)
    pan: Series = field(default_factory=Series)
    tilt: Series = field(default_factory=Series)
    guided: Series = field(default_factory=Series)
    throttle: Series = field(default_factory=Series)
    sonar_inset_m: float = SHIPPED_INSET_M  # ECHO_INSET, where the log tells it
    to_ground_s: float = math.nan  # what to add to its times for the ground computer's clock
    warnings: list[str] = field(default_factory=list)

    @property
    def label(self) -> str:
        """File and vehicle, for messages."""
        return f"{self.path} (system {self.system_id})"

    def shift(self, seconds: float) -> None:
        """Move every time by `seconds`."""
        for item in vars(self).values():
            if isinstance(item, Series):
                item.rows = [(row[0] + seconds, *row[1:]) for row in item.rows]


def read_vehicles(path: Path) -> list[VehicleLog]:
    """The vehicles in one file: one in a .BIN, one or more in a .tlog.

    Raises EchowingError for a file that cannot be read, is no log, or holds no copter's track.
    """
    try:
        with path.open("rb") as file:
            start = file.read(len(DATAFLASH_START))
    except OSError as error:
        raise EchowingError(f"log {path}: cannot be read: {error.strerror}") from error
    if not start:
        raise EchowingError(f"log {path} is empty")
    return [_dataflash(path)] if start == DATAFLASH_START else _telemetry(path)


def gps_to_unix_s(week: int, milliseconds: float) -> float:
    """GPS week and time of week to UTC, leap seconds taken off."""
    gps_s = GPS_EPOCH_UNIX_S + week * WEEK_S + milliseconds / 1000.0
    return next(gps_s - leap_s for since_s, leap_s in LEAP_SECONDS if gps_s - leap_s >= since_s)


class Reader:
    """The messages of one file; pymavlink's complaints become one warning."""

    def __init__(self, path: Path, kind: str, types: list[str]) -> None:
        self._path, self._kind, self._types = path, kind, types
        self._damaged = False

    def __iter__(self) -> Iterator[Any]:
        with _quiet_stderr() as complaints:
            log = self._guarded(self._open)
            self._damaged = "bad header" in complaints()
        if self._kind == "BIN":
            self._damaged |= not self._guarded(lambda: _ends_whole(log))
        else:
            self._damaged = not _whole(self._path.read_bytes())
        last_s: float | None = None
        while (message := self._guarded(lambda: log.recv_match(type=self._types))) is not None:
            if not self._is_stray(message, last_s):
                last_s = float(message._timestamp)
                yield message

    def _is_stray(self, message: Any, last_s: float | None) -> bool:
        """Whether its time stamp is damaged bytes; a dataflash log has its own times."""
        jump_s = 0.0 if last_s is None else abs(float(message._timestamp) - last_s)
        return self._kind == "tlog" and jump_s > LONGEST_PAUSE_S

    @property
    def damage(self) -> list[str]:
        """A warning, if some of the file could not be read; to be asked at the end."""
        if not self._damaged:
            return []
        return [f"{self._path}: damaged or cut off; the readable part is used"]

    def _open(self) -> Any:
        from pymavlink import DFReader, mavutil  # noqa: PLC0415 (slow to import)

        if self._kind == "BIN":
            return DFReader.DFReader_binary(str(self._path), zero_time_base=False)
        # Not mavlink_connection: that goes by the file's suffix.
        mavutil.set_dialect("ardupilotmega")
        try:
            return mavutil.mavmmaplog(str(self._path))
        except AttributeError as error:  # it looks for the time of a first message
            size = self._path.stat().st_size
            raise EchowingError(
                f"log {self._path}: no whole message in its {size} bytes; download it from the "
                "vehicle again"
            ) from error

    def _guarded(self, read: Callable[[], Any]) -> Any:
        try:
            return read()
        except EchowingError:
            raise
        except Exception as error:  # pymavlink raises whatever damage makes it trip over
            raise EchowingError(
                f"log {self._path}: cannot be read as a {self._kind} file "
                f"({type(error).__name__}); download it from the vehicle again"
            ) from error


def _ends_whole(log: Any) -> bool:
    """Whether an indexed .BIN ends with the end of a message; pymavlink says nothing of a rest."""
    last = max((int(places[-1]) for places in log.offsets if len(places)), default=0)
    return bool(last + log.formats[log.data_map[last + 2]].len == log.data_len)


def _whole(data: bytes) -> bool:
    """Whether a .tlog is nothing but time stamps and frames, one after the other, to its end.

    pymavlink skips damage without a message.
    """
    at = 0
    while at < len(data):
        head = data[at + STAMP_BYTES : at + STAMP_BYTES + 3]
        if len(head) < 3 or head[0] not in FRAME_OVERHEAD:
            return False
        signed = head[0] == MAVLINK_2 and head[2] & 1
        at += STAMP_BYTES + FRAME_OVERHEAD[head[0]] + head[1] + (SIGNATURE_BYTES if signed else 0)
    return at == len(data)


@contextlib.contextmanager
def _quiet_stderr() -> Iterator[Callable[[], str]]:
    """Keep what is written to stderr, also by C code: pymavlink's indexer complains there."""
    with tempfile.TemporaryFile() as kept:
        before = os.dup(2)
        os.dup2(kept.fileno(), 2)
        try:
            yield lambda: _text(kept)
        finally:
            os.dup2(before, 2)
            os.close(before)


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


# --- telemetry -----------------------------------------------------------------------------


@dataclass
class _Telemetry:
    """What one system sent, on the clocks as they were: boot seconds and receive seconds."""

    types: set[int] = field(default_factory=set)
    guided: Series = field(default_factory=Series)
    throttle: Series = field(default_factory=Series)
    unix_minus_boot_s: list[float] = field(default_factory=list)
    fixes: list[tuple[float, float, Any]] = field(default_factory=list)  # boot, received, message
    named: dict[str, Series] = field(default_factory=lambda: defaultdict(Series))
    parameter: Series = field(default_factory=Series)
    ranges: dict[int, Series] = field(default_factory=lambda: defaultdict(Series))
    ground_clock: VehicleClock = field(default_factory=VehicleClock)
    rebooted: bool = False
    inset_m: float = SHIPPED_INSET_M

    def take(self, message: Any, asked_s: dict[int, float]) -> None:
        """Take one message. asked_s: when the ground sent the TIMESYNC of that stamp."""
        received_s = float(message._timestamp)
        own = message.get_srcComponent() == AUTOPILOT_COMPONENT
        kind = message.get_type()
        if kind == "NAMED_VALUE_FLOAT" and message.name in NAMED:
            value = _heard_m(message.value) if message.name in SONAR_NAMES else message.value
            self.named[message.name].rows.append((received_s, value))
        elif kind == "DISTANCE_SENSOR" and message.orientation == FORWARD:
            self.ranges[message.get_srcComponent()].rows.append((received_s, _range_m(message)))
        elif kind == "HEARTBEAT" and message.autopilot != NOT_AN_AUTOPILOT:
            self.types.add(message.type)
            self.guided.rows.append((received_s, float(message.custom_mode == COPTER_GUIDED)))
        elif kind == "SYSTEM_TIME" and own and message.time_unix_usec > 0:
            boot_s = message.time_boot_ms / 1000.0
            self.unix_minus_boot_s.append(message.time_unix_usec / 1e6 - boot_s)
        elif kind == "TIMESYNC" and own and message.tc1 and message.ts1 in asked_s:
            self.ground_clock.answered(asked_s[message.ts1], message.tc1 / 1e9, received_s)
        elif kind == "GLOBAL_POSITION_INT" and own:
            self._fix(message, received_s)
        elif kind == "VFR_HUD" and own:
            self.throttle.rows.append((received_s, message.throttle / 100.0))
        elif kind == "PARAM_VALUE" and message.param_id == INSET_NAME:
            self.inset_m = message.param_value
        elif kind == "PARAM_VALUE" and message.param_id in SPEED_PARAMETERS:
            factor = SPEED_PARAMETERS[message.param_id]
            self.parameter.rows.append((received_s, message.param_value * factor))

    def _fix(self, message: Any, received_s: float) -> None:
        boot_s = message.time_boot_ms / 1000.0
        if self.fixes and boot_s < self.fixes[-1][0] - 1.0:
            # Rebooted: its boot clock began again, and what came before is another flight.
            self.rebooted = True
            self.fixes.clear()
            self.unix_minus_boot_s.clear()
            self.ground_clock = VehicleClock()
        if message.lat or message.lon:
            self.fixes.append((boot_s, received_s, message))


def _range_m(message: Any) -> float:
    """A DISTANCE_SENSOR's metres; NaN out of its limits (its way to say "no target")."""
    inside = message.min_distance <= message.current_distance < message.max_distance
    return message.current_distance / 100.0 if inside else math.nan


def _heard_m(value_m: float) -> float:
    return value_m if SONAR_NEAREST_M <= value_m < SONAR_NOTHING_M else math.nan


def _telemetry(path: Path) -> list[VehicleLog]:
    systems: dict[int, _Telemetry] = defaultdict(_Telemetry)
    reader = Reader(path, "tlog", TLOG_TYPES)
    asked_s: dict[int, float] = {}
    for message in reader:
        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
            asked_s[message.ts1] = float(message._timestamp)
        systems[message.get_srcSystem()].take(message, asked_s)
    if not systems:
        raise EchowingError(f"log {path}: holds no MAVLink messages; is it a .tlog or .BIN file?")
    found = {number: system for number, system in systems.items() if system.fixes}
    if not found:
        raise EchowingError(f"log {path}: no GLOBAL_POSITION_INT in it, so no track to analyse")
    for number, system in found.items():
        if system.types and not system.types & COPTER_TYPES:
            raise EchowingError(
                f"log {path}: system {number} is not a copter (MAV_TYPE {min(system.types)})"
            )
    logs = [_from_telemetry(path, number, system) for number, system in found.items()]
    for log in logs:
        log.warnings += reader.damage
    return logs


def _from_telemetry(path: Path, number: int, heard: _Telemetry) -> VehicleLog:
    log = VehicleLog(path, "tlog", number)
    boot = np.array([boot_s for boot_s, _, _ in heard.fixes])
    received = np.array([received_s for _, received_s, _ in heard.fixes])
    # A backlog may come late, nothing comes early: the typical fix tells the delay of the link.
    receive_minus_boot_s = float(np.median(received - boot))
    ground_minus_boot_s = receive_minus_boot_s
    if heard.ground_clock.known:
        ground_minus_boot_s = heard.ground_clock.to_ours(0.0, math.inf)
    if heard.unix_minus_boot_s:
        own_minus_boot_s = float(np.median(heard.unix_minus_boot_s))
    else:
        own_minus_boot_s = ground_minus_boot_s
        log.clock = "ground" if heard.ground_clock.known else "receive"
    if heard.rebooted:
        log.warnings.append(f"{log.label}: rebooted; only the part after the last boot is used")
    log.to_ground_s = ground_minus_boot_s - own_minus_boot_s
    delay_s = receive_minus_boot_s - own_minus_boot_s
    for boot_s, _, message in heard.fixes:
        _add_fix(log, boot_s + own_minus_boot_s, message)
    for mine, theirs in (
        (log.sonar, _first(heard.named, SONAR_NAMES) or _nearest_source(heard.ranges)),
        (log.speed_command, _first(heard.named, SPEED_NAMES) or heard.parameter),
        (log.pan, heard.named[PAN_NAME]),
        (log.tilt, heard.named[TILT_NAME]),
        (log.guided, heard.guided),
        (log.throttle, heard.throttle),
    ):
        mine.rows = [(row[0] - delay_s, *row[1:]) for row in theirs.rows]
    log.sonar_inset_m = heard.inset_m
    return log


def _add_fix(log: VehicleLog, time_s: float, message: Any) -> None:
    log.position.rows.append((time_s, message.lat / 1e7, message.lon / 1e7, message.alt / 1e3))
    log.velocity.rows.append((time_s, message.vx / 100, message.vy / 100, message.vz / 100))
    if message.hdg != NO_HEADING_CDEG:
        log.yaw.rows.append((time_s, math.radians(message.hdg / 100)))


def _first(named: dict[str, Series], names: tuple[str, ...]) -> Series:
    return next((named[name] for name in names if named[name]), Series())


def _nearest_source(ranges: dict[int, Series]) -> Series:
    """The sonar's own reports before the autopilot's copy of them."""
    others = [series for component, series in ranges.items() if component != AUTOPILOT_COMPONENT]
    return next(iter(others), ranges.get(AUTOPILOT_COMPONENT, Series()))


# --- dataflash -----------------------------------------------------------------------------


def _dataflash(path: Path) -> VehicleLog:
    log = VehicleLog(path, "BIN", 0)
    clock = _DataflashClock()
    named: dict[str, Series] = defaultdict(Series)
    parameter, gps_velocity = Series(), Series()
    reader = Reader(path, "BIN", DATAFLASH_TYPES)
    for message in reader:
        kind, time_s = message.get_type(), message.TimeUS / 1e6
        if kind == "MSG":
            _check_copter(path, message.Message)
        elif kind == "RTC":
            clock.rtc = message.Epoch / 1e6 - time_s
        elif kind == "GPS" and message.Status >= FIX_3D and message.GWk > 0:
            clock.gps.append(gps_to_unix_s(message.GWk, message.GMS) - time_s)
            gps_velocity.rows.append(_gps_velocity(time_s, message))
        elif kind == "POS" and (message.Lat or message.Lng):
            log.position.rows.append((time_s, message.Lat, message.Lng, message.Alt))
        elif kind in ("XKF1", "NKF1") and getattr(message, "C", 0) == 0:
            log.velocity.rows.append((time_s, message.VN, message.VE, message.VD))
        elif kind in ("ATT", "MODE", "CTUN"):
            _flown(log, kind, time_s, message)
        elif kind == "RFND" and message.Orient == FORWARD and message.Stat > 0:
            good = message.Stat == RANGE_GOOD
            log.sonar.rows.append((time_s, message.Dist if good else math.nan))
        elif kind == "NVF" and message.Name in NAMED:
            value = _heard_m(message.Value) if message.Name in SONAR_NAMES else message.Value
            named[message.Name].rows.append((time_s, value))
        elif kind == "ECHO":
            named[SPEED_NAMES[0]].rows.append((time_s, message.Spd))
        elif kind == "PARM":
            _parameter(log, parameter, time_s, message)
    log.sonar = _first(named, SONAR_NAMES) or log.sonar
    log.speed_command = _first(named, SPEED_NAMES) or parameter
    log.pan, log.tilt = named[PAN_NAME], named[TILT_NAME]
    log.velocity = log.velocity or gps_velocity
    _check_track(log, clock)
    log.shift(clock.unix_minus_boot_s)
    log.warnings += reader.damage
    return log


def _flown(log: VehicleLog, kind: str, time_s: float, message: Any) -> None:
    """How it was flown: heading, mode, throttle."""
    if kind == "ATT":
        log.yaw.rows.append((time_s, math.radians(message.Yaw)))
    elif kind == "MODE":
        log.guided.rows.append((time_s, float(message.ModeNum == COPTER_GUIDED)))
    else:
        log.throttle.rows.append((time_s, message.ThO))


@dataclass
class _DataflashClock:
    """From TimeUS to UTC. RTC is the autopilot's own conversion; GPS carries the receiver's lag."""

    rtc: float | None = None
    gps: list[float] = field(default_factory=list)

    @property
    def unix_minus_boot_s(self) -> float:
        return self.rtc if self.rtc is not None else float(np.median(self.gps))


def _check_copter(path: Path, text: str) -> None:
    kinds = ("ArduPlane", "ArduRover", "ArduSub", "AntennaTracker", "Blimp")
    if text.startswith(kinds):
        raise EchowingError(f"log {path}: not a copter's: {text!r}")


def _check_track(log: VehicleLog, clock: _DataflashClock) -> None:
    if not log.position:
        raise EchowingError(f"log {log.path}: no POS message in it, so no track to analyse")
    if clock.rtc is None and not clock.gps:
        raise EchowingError(
            f"log {log.path}: no RTC and no GPS time in it, so it cannot be matched with "
            "another log"
        )


def _gps_velocity(time_s: float, message: Any) -> tuple[float, ...]:
    course_rad = math.radians(message.GCrs)
    north, east = message.Spd * math.cos(course_rad), message.Spd * math.sin(course_rad)
    return time_s, north, east, message.VZ


def _parameter(log: VehicleLog, series: Series, time_s: float, message: Any) -> None:
    if message.Name in ("MAV_SYSID", "SYSID_THISMAV"):
        log.system_id = int(message.Value)
    elif message.Name == INSET_NAME:
        log.sonar_inset_m = message.Value
    elif message.Name in SPEED_PARAMETERS:
        series.rows.append((time_s, message.Value * SPEED_PARAMETERS[message.Name]))
