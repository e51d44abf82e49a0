"""What is known of the board now, from the messages it has sent."""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.plausible import printable

# In the order of the firmware's DeviceState, as SNR_STATE tells it.
STATE_NAMES = ("starting", "searching", "tracking", "sonar fault")
UNKNOWN = "unknown"
# ArduPilot's own patience with a MAVLink rangefinder (firmware/README.md).
STALE_S = 0.5
# Rates are counted over this long: values repeat once per second.
RATE_WINDOW_S = 3.0
# A reading at or beyond what the sonar can tell (7.65 m) is an echo that was not there.
NOTHING_HEARD_M = 7.65

_TEXTS_KEPT = 10_000  # a week of soaking tells far less


@dataclass(frozen=True, slots=True)
class Version:
    """What AUTOPILOT_VERSION tells."""

    firmware: str  # "0.1.0"
    git_hash: str  # its first 8 characters

    @classmethod
    def of(cls, message: Any) -> "Version":
        """Out of an AUTOPILOT_VERSION."""
        number = message.flight_sw_version
        git = bytes(message.flight_custom_version).rstrip(b"\0").decode("ascii", "replace")
        return cls(f"{number >> 24}.{number >> 16 & 255}.{number >> 8 & 255}", printable(git))


@dataclass(slots=True)
class BoardState:
    """The newest that is known; None: not told yet, or nothing there."""

    now_s: float = 0.0
    range_m: float | None = None  # running average; None while there is no target, or no report
    raw_m: float | None = None  # newest single reading; None: nothing heard
    min_m: float | None = None
    max_m: float | None = None
    pan_us: float | None = None
    tilt_us: float | None = None
    state: str = UNKNOWN
    signal_quality: int | None = None  # percent
    critical: bool = False  # by its heartbeat
    report_at_s: float | None = None
    heard_at_s: float | None = None
    restarts: int = 0
    version: Version | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)  # messages by name
    errors: int = 0  # STATUSTEXTs of a warning or worse
    texts: deque[tuple[float, int, str]] = field(
        default_factory=lambda: deque(maxlen=_TEXTS_KEPT)
    )  # time_s, severity, text
    _arrivals: dict[str, deque[float]] = field(default_factory=dict)
    _boot_ms: int = 0
    _since_s: float | None = None

    @property
    def report_age_s(self) -> float | None:
        """How long ago the newest DISTANCE_SENSOR came."""
        return None if self.report_at_s is None else self.now_s - self.report_at_s

    @property
    def silent_s(self) -> float | None:
        """How long nothing at all has come from the board."""
        return None if self.heard_at_s is None else self.now_s - self.heard_at_s

    def rate_hz(self, name: str) -> float:
        """How often a message (or a named value) comes."""
        arrivals = self._arrivals.get(name, deque())
        since_s = self.now_s if self._since_s is None else self._since_s
        window_s = min(RATE_WINDOW_S, self.now_s - since_s)
        return len(arrivals) / window_s if window_s > 0.0 else 0.0

    def tick(self, now_s: float) -> None:
        """Time passes: what is old is no longer so."""
        self.now_s = now_s
        if self._since_s is None:
            self._since_s = now_s
        for arrivals in self._arrivals.values():
            while arrivals and arrivals[0] <= now_s - RATE_WINDOW_S:
                arrivals.popleft()
        age_s = self.report_age_s
        if age_s is not None and age_s > STALE_S:
            self.range_m = self.raw_m = self.signal_quality = None

    def update(self, message: Any, now_s: float) -> None:
        """A message of the board has come."""
        self.tick(now_s)
        self.heard_at_s = now_s
        kind = message.get_type()
        name = str(message.name) if kind == "NAMED_VALUE_FLOAT" else kind
        self.counts[name] += 1
        self._arrivals.setdefault(name, deque()).append(now_s)
        match kind:
            case "HEARTBEAT":
                self.critical = message.system_status >= mavlink.MAV_STATE_CRITICAL
            case "DISTANCE_SENSOR":
                self._on_report(message)
            case "NAMED_VALUE_FLOAT":
                self._on_value(name, message)
            case "PARAM_VALUE":
                self.parameters[str(message.param_id)] = float(message.param_value)
            case "AUTOPILOT_VERSION":
                self.version = Version.of(message)
            case "STATUSTEXT":
                self.texts.append((now_s, int(message.severity), str(message.text)))
                self.errors += message.severity <= mavlink.MAV_SEVERITY_WARNING

    def _on_report(self, message: Any) -> None:
        self.report_at_s = self.now_s
        self.min_m, self.max_m = message.min_distance / 100.0, message.max_distance / 100.0
        seen = message.current_distance <= message.max_distance
        self.range_m = message.current_distance / 100.0 if seen else None
        self.signal_quality = int(message.signal_quality)

    def _on_value(self, name: str, message: Any) -> None:
        # The board's clock goes back only when it starts again (or after 49.7 days).
        self.restarts += message.time_boot_ms < self._boot_ms
        self._boot_ms = int(message.time_boot_ms)
        value = float(message.value)
        match name:
            case "SNR_RAW":
                self.raw_m = round(value, 3) if value < NOTHING_HEARD_M else None
            case "SNR_PAN":
                self.pan_us = value
            case "SNR_TILT":
                self.tilt_us = value
            case "SNR_STATE":
                index = int(value)
                self.state = STATE_NAMES[index] if 0 <= index < len(STATE_NAMES) else UNKNOWN
