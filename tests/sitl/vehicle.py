"""An ArduCopter in SITL: its process, its pilot's ground station, and the truth about it.

The ground station is on SERIAL1. A thread of its own listens to it, and does what has to be done
at a pace: heartbeats, the receiver's drift, velocities for a leader that is flown by hand.
"""

import contextlib
import math
import select
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import GlobalPosition, Ned, displace
from echowing.mavlink.messages import command_long, message_interval, position_target
from echowing.mavlink.signing import SIGNING_EPOCH_UNIX_S, SIGNING_TICKS_PER_S, LinkSigning, Parser
from echowing.setup.settings import same

from . import loopback
from .names import SPEED, SPEEDUP, Names, Version
from .relay import LOOPBACK
from .tools import UNDER

# Anywhere will do; heights and distances count from here.
ORIGIN = GlobalPosition(47.0, 8.0, 450.0)
AUTO, GUIDED, LOITER, LAND = 3, 4, 5, 9
GROUND_STATION = 255  # SYSID_MYGCS, MAV_GCS_SYSID: whose RC overrides count
COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER

# SERIAL0, 1 and 2 of instance 0; ten more for each further instance.
PORTS = (5760, 5762, 5763)
TO_COPROCESSOR = "tcp:3"
SIGNING_LINK = 77  # no tool's
ANSWER_S = 0.5  # then it is asked again
PATIENCE_S = 30.0
TEXTS_SHOWN = 12
BOOT_S = 120.0  # until it can be armed, on a busy machine
STREAMS_HZ = {
    "SIM_STATE": 50,
    "SYSTEM_TIME": 5,
    "GLOBAL_POSITION_INT": 5,
    "EKF_STATUS_REPORT": 2,
    "SYS_STATUS": 2,
}
# A stream that does not come is asked for again.
STREAM_LATE_S = 2.0
# What a builder sets and calibrates before anything else, for the copter that SITL simulates. It
# has two accelerometers; offsets of exactly 0 would count as not calibrated. Its compasses are off
# by what is set here; battery, motors and yaw have the values of ArduPilot's own test vehicle.
FACTORY = {
    "FRAME_CLASS": 1.0,
    # SITL's quad is a plus (SIM_Frame.cpp); the default mixes for an X, whose torques are turned by
    # 45 degrees against it. It flies so, but roll and pitch swing at 15 Hz by 94 degrees a second
    # (RATE.P, standard deviation in a hover), with motors that are full or idle; as a plus by 0.1.
    "FRAME_TYPE": 0.0,
    "BATT_MONITOR": 4.0,
    "MOT_BAT_VOLT_MIN": 9.6,
    "MOT_BAT_VOLT_MAX": 12.8,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
    "ATC_RAT_YAW_P": 0.3,
    "ATC_RAT_YAW_I": 0.02,
    **{
        f"COMPASS_OFS{number}_{axis}": value
        for number in ("", 2, 3)
        for axis, value in (("X", 5.0), ("Y", 13.0), ("Z", -18.0))
    },
    **{
        f"INS_ACC{number}{what}_{axis}": value
        for number in ("", 2)
        for what, value in (("OFFS", 0.001), ("SCAL", 1.001))
        for axis in "XYZ"
    },
}


@dataclass(frozen=True, slots=True)
class State:
    """Where a vehicle truly is. time_s: when it was heard, on this machine's clock."""

    time_s: float
    lat_deg: float
    lon_deg: float
    alt_m: float
    velocity_ned_mps: Ned
    roll_rad: float
    pitch_rad: float
    yaw_rad: float

    @property
    def position(self) -> GlobalPosition:
        """On the globe, above sea level."""
        return GlobalPosition(self.lat_deg, self.lon_deg, self.alt_m)


@dataclass(slots=True)
class _Task:
    period_s: float
    do: Callable[[], None]
    due_s: float = 0.0


@dataclass(slots=True)
class Heard:
    """What the ground station has heard."""

    newest: dict[str, Any] = field(default_factory=dict)
    at_s: dict[str, float] = field(default_factory=dict)  # when, by our clock
    texts: list[tuple[float, str]] = field(default_factory=list)
    truth: list[State] = field(default_factory=list)
    clock: list[tuple[float, float]] = field(default_factory=list)  # ours, since its start, s
    utc: list[tuple[float, float]] = field(default_factory=list)  # ours, its receiver's UTC, s
    named: dict[str, float] = field(default_factory=dict)
    components: set[int] = field(default_factory=set)  # who speaks under its system id
    parameters: dict[str, float] = field(default_factory=dict)


class Vehicle:
    """One copter. Made, it is starting; `until_ready` waits until it can be armed.

    Its folder holds what an autopilot keeps: parameters, logs, and the card's scripts. `fresh`
    wipes the parameters; `factory` are those that it starts with where none are kept. serial2: what
    its SERIAL2 is, as SITL takes it.
    """

    def __init__(
        self,
        binary: Path,
        system_id: int,
        folder: Path,
        *,
        fresh: bool = True,
        at_ned_m: Ned = (0.0, 0.0, 0.0),
        speedup: float = 1.0,
        factory: Mapping[str, float] | None = None,
        serial2: str = TO_COPROCESSOR,
    ) -> None:
        self.system_id, self.folder = system_id, folder
        self.usb, self.telemetry, self.coprocessor = (port + 10 * (system_id - 1) for port in PORTS)
        self.heard = Heard()
        self.on_truth: Callable[[State], None] | None = None
        self._news = threading.Condition()
        self._packer = mavlink.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=COMPONENT)
        self._signing: LinkSigning | None = None
        self._parser = Parser(None)
        self._sending = threading.Lock()
        self._socket: socket.socket | None = None
        self._tasks: dict[str, _Task] = {"beat": _Task(1.0, self._beat)}
        self._done = threading.Event()
        self._process = self._start(
            binary, fresh, at_ned_m, speedup, {**FACTORY, **(factory or {})}, serial2
        )
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"vehicle {system_id}")
        self._thread.start()

    def _start(
        self,
        binary: Path,
        fresh: bool,
        at_ned_m: Ned,
        speedup: float,
        factory: Mapping[str, float],
        serial2: str,
    ) -> "subprocess.Popen[bytes]":
        self.folder.mkdir(parents=True, exist_ok=True)
        defaults = self.folder / "factory.parm"
        defaults.write_text("".join(f"{name} {value:.10g}\n" for name, value in factory.items()))
        home = displace(ORIGIN, at_ned_m)
        with (self.folder / "console.txt").open("ab") as console:
            return subprocess.Popen(
                [
                    *UNDER,
                    str(binary),
                    *("--model", "quad", "--speedup", f"{speedup:g}"),
                    *("--home", f"{home.lat_deg:.8f},{home.lon_deg:.8f},{home.alt_m:.2f},0"),
                    *("-I", str(self.system_id - 1), "--sysid", str(self.system_id)),
                    # None waits for a client before it boots.
                    *("--serial0", "tcp:0", "--serial1", "tcp:2", "--serial2", serial2),
                    *("--defaults", str(defaults)),
                    *(("-w",) if fresh else ()),
                ],
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for the suite, which ends it in good order
            )

    def link(self, port: int | None = None) -> str:
        """The connection string of one of its ports, SERIAL0 if none is named."""
        return f"tcp:{LOOPBACK}:{port or self.usb}@{self.system_id}"

    def close(self) -> None:
        """End it."""
        self._done.set()
        self._thread.join()
        if self._socket is not None:
            self._socket.close()
        self._process.kill()
        self._process.wait()

    # ---- the ground station's thread -----------------------------------------------------------

    def _run(self) -> None:
        while not self._done.is_set():
            if self._socket is None:
                self._parser = Parser(self._signing)
                self._connect()
                continue
            if select.select([self._socket], [], [], 0.005)[0]:
                self._receive()
            now_s = time.monotonic()
            for task in list(self._tasks.values()):
                if now_s >= task.due_s:
                    task.due_s = max(task.due_s + task.period_s, now_s - task.period_s)
                    task.do()

    def _connect(self) -> None:
        time.sleep(0.05)
        with contextlib.suppress(OSError):
            opened = socket.create_connection((LOOPBACK, self.telemetry), timeout=1.0)
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket = opened

    def _receive(self) -> None:
        assert self._socket is not None
        try:
            data = self._socket.recv(65_536)
        except OSError:
            data = b""
        if not data:  # it restarts
            self._socket.close()
            self._socket = None
            return
        with self._news:
            for message in self._parser.parse_buffer(data) or ():
                self._take(message)
            self._news.notify_all()

    def _take(self, message: Any) -> None:
        if message.get_srcSystem() != self.system_id or message.get_msgId() < 0:
            return
        now_s, kind = time.monotonic(), message.get_type()
        self.heard.components.add(message.get_srcComponent())
        if kind == "NAMED_VALUE_FLOAT":
            self.heard.named[message.name] = message.value
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return
        self.heard.newest[kind] = message
        self.heard.at_s[kind] = now_s
        if kind == "PARAM_VALUE":
            self.heard.parameters[message.param_id] = message.param_value
        elif kind == "STATUSTEXT":
            self.heard.texts.append((now_s, message.text))
        elif kind == "SIM_STATE":
            self.heard.truth.append(_state(now_s, message))
            if self.on_truth is not None:
                self.on_truth(self.heard.truth[-1])
        elif kind == "SYSTEM_TIME":
            self.heard.clock.append((now_s, message.time_boot_ms / 1000.0))
            self.heard.utc.append((now_s, message.time_unix_usec / 1e6))

    def _beat(self) -> None:
        """Be a ground station, and ask for what is not streamed yet (it forgets at a restart)."""
        self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
            )
        )
        late_s = time.monotonic() - STREAM_LATE_S
        for kind, rate_hz in STREAMS_HZ.items():
            if self.heard.at_s.get(kind, -math.inf) < late_s:
                message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
                self.send(message_interval(self.system_id, message_id, 1_000_000 // rate_hz))

    def every(self, name: str, period_s: float, do: Callable[[], None]) -> None:
        """From now on do this at a pace, under a name by which it is replaced or ended."""
        self._tasks[name] = _Task(period_s, do)

    def no_more(self, name: str) -> None:
        """End what `every` began."""
        self._tasks.pop(name, None)

    def send(self, message: Any) -> None:
        """Send a message; lost while it restarts."""
        with self._sending:
            if self._signing is not None:
                self._signing.keep_time()
            self._write(bytes(message.pack(self._packer)))
            self._packer.seq = (self._packer.seq + 1) % 256

    def send_bytes(self, frame: bytes) -> None:
        """Send bytes as they are, on the ground station's link."""
        with self._sending:
            self._write(frame)

    def _write(self, frame: bytes) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendall(frame)

    # ---- waiting -------------------------------------------------------------------------------

    def until(
        self,
        what: str,
        fits: Callable[[], bool],
        within_s: float = PATIENCE_S,
        asking: Callable[[], None] | None = None,
    ) -> None:
        """Wait for a condition, asking again and again; fails the test where it never comes."""
        until_s, ask_s = time.monotonic() + within_s, 0.0
        while not fits():
            now_s = time.monotonic()
            if now_s > until_s:
                said = list(dict.fromkeys(self.said()))[-TEXTS_SHOWN:]
                pytest.fail(f"vehicle {self.system_id}: never {what}; it said: {said}")
            self.check_alive()
            if asking is not None and now_s >= ask_s:
                ask_s = now_s + ANSWER_S
                asking()
            with self._news:
                self._news.wait(0.05)

    def check_alive(self) -> None:
        """Fail the test where the autopilot has ended."""
        if self._process.poll() is not None:
            pytest.fail(f"vehicle {self.system_id} has ended: {self.console()}")

    def said(self, since_s: float = -math.inf) -> list[str]:
        """Its status texts since a moment of our clock."""
        return [text for time_s, text in list(self.heard.texts) if time_s >= since_s]

    def until_said(self, text: str, since_s: float, within_s: float = PATIENCE_S) -> None:
        """Wait for a status text."""
        self.until(f"said {text!r}", lambda: any(text in t for t in self.said(since_s)), within_s)

    def newest_log(self) -> Path:
        """The log that it has written last, or writes."""
        return max((self.folder / "logs").glob("*.BIN"))

    def console(self) -> str:
        """The end of what its process has printed."""
        return (self.folder / "console.txt").read_text(errors="replace")[-2000:]

    def newest(self, kind: str) -> Any | None:
        """The newest message of a kind."""
        return self.heard.newest.get(kind)

    # ---- starting ------------------------------------------------------------------------------

    def until_heard(self) -> None:
        """Wait for the autopilot, and see that only this machine reaches it."""
        self.until("heard", lambda: self.newest("HEARTBEAT") is not None, BOOT_S)
        loopback.require(self._process.pid)

    def listening(self) -> list[str]:
        """The addresses on which its process listens."""
        return loopback.require(self._process.pid)

    def version(self) -> Version:
        """What it says of itself."""
        ask = command_long(
            self.system_id,
            mavlink.MAV_CMD_REQUEST_MESSAGE,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        )
        kind = "AUTOPILOT_VERSION"
        self.until(
            "told its version", lambda: self.newest(kind) is not None, asking=lambda: self.send(ask)
        )
        return Version.unpack(self.heard.newest[kind].flight_sw_version)

    def until_positioned(self) -> None:
        """Wait until it knows where it is and how fast it moves."""
        wanted = (
            mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_PRED_POS_HORIZ_ABS
        )

        def knows() -> bool:
            report = self.newest("EKF_STATUS_REPORT")
            return report is not None and report.flags & wanted == wanted

        self.until("knew its position", knows, BOOT_S)

    def utc_ahead_s(self) -> float:
        """How far its receiver's UTC is ahead of our clock, over its last answers."""
        return float(np.mean([its - ours for ours, its in self.heard.utc[-5:]]))

    def pace(self, since_s: float) -> float:
        """Simulated seconds a second since a moment of our clock; 1 is real time."""
        clock = [row for row in list(self.heard.clock) if row[0] >= since_s]
        if len(clock) < 2:
            return math.nan
        return (clock[-1][1] - clock[0][1]) / (clock[-1][0] - clock[0][0])

    def restart(self) -> None:
        """Reboot it, as by its pilot's ground station."""
        reboot = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
        started_s = self.heard.clock[-1][1]
        self.heard.clock.clear()
        self.heard.newest.clear()

        def restarted() -> bool:
            return bool(self.heard.clock) and self.heard.clock[-1][1] < started_s

        self.until(
            "restarted",
            restarted,
            BOOT_S,
            lambda: None if restarted() else self.send(command_long(self.system_id, reboot, 1)),
        )
        self.until_heard()

    # ---- parameters ----------------------------------------------------------------------------

    def _find(self, names: Sequence[str]) -> tuple[str, float]:
        known = self.heard.parameters
        for name in names:
            known.pop(name, None)

        def ask() -> None:
            for name in names:
                self.send(
                    mavlink.MAVLink_param_request_read_message(self.system_id, 1, name.encode(), -1)
                )

        self.until(
            f"told {' or '.join(names)}", lambda: not known.keys().isdisjoint(names), asking=ask
        )
        return next((name, known[name]) for name in names if name in known)

    def get(self, names: Names | str) -> float:
        """A parameter in SI units; of several names the one that this version has."""
        if isinstance(names, str):
            return self._find([names])[1]
        name, value = self._find(list(names))
        return value / names[name]

    def set(self, names: Names | str, value: float) -> None:
        """Set a parameter and see it set."""
        table = {names: 1.0} if isinstance(names, str) else names
        name, _ = self._find(list(table))
        wanted = value * table[name]
        change = mavlink.MAVLink_param_set_message(
            self.system_id, 1, name.encode(), wanted, mavlink.MAV_PARAM_TYPE_REAL32
        )

        def fits() -> bool:
            return same(self.heard.parameters.get(name, math.nan), wanted)

        self.until(f"had {name} {wanted:g}", fits, asking=lambda: self.send(change))

    def put(self, name: str, value: float) -> None:
        """Set a parameter without waiting, from the ground station's own thread."""
        self.send(
            mavlink.MAVLink_param_set_message(
                self.system_id, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
            )
        )

    def name_of(self, names: Names) -> str:
        """The name that this version has."""
        return self._find(list(names))[0]

    # ---- flying --------------------------------------------------------------------------------

    @property
    def mode(self) -> int:
        """Copter's mode number."""
        return int(self.heard.newest["HEARTBEAT"].custom_mode)

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return bool(self.heard.newest["HEARTBEAT"].base_mode & armed)

    @property
    def state(self) -> State:
        """The newest truth."""
        return self.heard.truth[-1]

    @property
    def height_m(self) -> float:
        """Above where it started, in truth."""
        return self.state.alt_m - ORIGIN.alt_m

    @property
    def speed_mps(self) -> float:
        """Over the ground, in truth."""
        return math.hypot(*self.state.velocity_ned_mps[:2])

    def set_mode(self, mode: int) -> None:
        """As the pilot, by his ground station."""
        change = command_long(self.system_id, mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
        self.until(f"in mode {mode}", lambda: self.mode == mode, asking=lambda: self.send(change))

    def try_to_arm(self, within_s: float = 5.0) -> list[str]:
        """Ask to arm, once; what it objects, nothing where it is armed."""
        self.heard.newest.pop("COMMAND_ACK", None)
        asked_s = time.monotonic()
        self.send(command_long(self.system_id, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1))

        def answered() -> bool:
            ack = self.newest("COMMAND_ACK")
            arming = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
            return self.armed or (ack is not None and ack.command == arming)

        self.until("answered a request to arm", answered, within_s)
        time.sleep(0.5)  # its reasons come with its answer or right after it
        return [] if self.armed else self.said(asked_s)

    def arm(self, within_s: float = BOOT_S) -> None:
        """Arm in Guided, as soon as it can be armed."""
        self.set_mode(GUIDED)
        arm = command_long(self.system_id, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.until("armed", lambda: self.armed, within_s, lambda: self.send(arm))

    def take_off(self, height_m: float) -> None:
        """Climb in Guided."""
        rise = command_long(self.system_id, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        self.until(
            f"{height_m:g} m up",
            lambda: self.height_m > height_m - 0.5,
            60.0,
            lambda: self.send(rise) if self.height_m < 0.3 else None,
        )

    def fly(self, velocity_ned_mps: Ned) -> None:
        """Fly at a velocity until told something else: Guided, ten targets a second."""
        mask = (
            mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
            | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
        )
        target = mavlink.MAVLink_set_position_target_local_ned_message(
            0,
            self.system_id,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
            mavlink.MAV_FRAME_LOCAL_NED,
            mask,
            *(0.0, 0.0, 0.0),
            *velocity_ned_mps,
            *(0.0,) * 5,
        )
        self.every("fly", 0.1, lambda: self.send(target))

    def go_to(self, point: GlobalPosition, height_m: float, yaw_rad: float | None = None) -> None:
        """Fly to a point and stay there: the same target eight times a second."""
        target = position_target(self.system_id, point, height_m, yaw_rad, 0.0)
        self.every("fly", 0.125, lambda: self.send(target))

    def hands_off(self) -> None:
        """No more targets from us."""
        self.no_more("fly")

    def upload(self, points: Sequence[GlobalPosition], height_m: float) -> None:
        """Store an Auto mission of waypoints; item 0 is home."""
        items = [
            self._item(number, point, height_m) for number, point in enumerate([ORIGIN, *points])
        ]
        count = mavlink.MAVLink_mission_count_message(self.system_id, 1, len(items))
        self.heard.newest.pop("MISSION_ACK", None)

        for kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            self.heard.newest.pop(kind, None)
        sent: set[int] = set()

        def fits() -> bool:
            request = self.newest("MISSION_REQUEST_INT") or self.newest("MISSION_REQUEST")
            if request is not None and request.seq not in sent:
                sent.add(request.seq)
                self.send(items[request.seq])
            return self.newest("MISSION_ACK") is not None

        self.until("took a mission", fits, asking=lambda: None if sent else self.send(count))
        assert self.heard.newest["MISSION_ACK"].type == mavlink.MAV_MISSION_ACCEPTED

    def _item(self, number: int, point: GlobalPosition, height_m: float) -> Any:
        return mavlink.MAVLink_mission_item_int_message(
            *(self.system_id, 1, number),
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            mavlink.MAV_CMD_NAV_WAYPOINT,
            *(0, 1, 0.0, 0.0, 0.0, 0.0),
            round(point.lat_deg * 1e7),
            round(point.lon_deg * 1e7),
            height_m,
        )

    def fly_mission(self, speed_mps: float) -> None:
        """Auto, in the air, at a speed."""
        self.hands_off()
        self.set(SPEED, speed_mps)
        self.set_mode(AUTO)

    def override(self, channels: Mapping[int, int]) -> None:
        """Hold transmitter channels, 1 to 16, at pulses in us; the others stay as they are."""
        pulses = [channels.get(number, 65_535) for number in range(1, 9)]
        more = [channels.get(number, 65_534) for number in range(9, 19)]
        message = mavlink.MAVLink_rc_channels_override_message(self.system_id, 1, *pulses, *more)
        self.every("override", 0.2, lambda: self.send(message))

    def restart_scripts(self) -> None:
        """Stop the scripts and load them anew."""
        self.send(
            mavlink.MAVLink_command_int_message(
                *(self.system_id, 1, mavlink.MAV_FRAME_GLOBAL),
                mavlink.MAV_CMD_SCRIPTING,
                *(0, 0, mavlink.SCRIPTING_CMD_STOP_AND_RESTART, 0, 0, 0, 0, 0, 0),
            )
        )

    def sign(self, key: bytes) -> None:
        """Have it sign and believe only what is signed, as its ground station from now on does."""
        now = round((time.time() - SIGNING_EPOCH_UNIX_S) * SIGNING_TICKS_PER_S)
        self.send(mavlink.MAVLink_setup_signing_message(self.system_id, 1, list(key), now))
        self._signing = LinkSigning(key, SIGNING_LINK)
        self._signing.apply(self._packer)
        # What it says moves our time on: after a restart its own is up to two minutes ahead.
        self._parser = Parser(self._signing)

    def speed_up(self, factor: float) -> None:
        """How fast its time passes."""
        self.set(SPEEDUP, factor)


def _state(now_s: float, message: Any) -> State:
    if message.lat_int == 0 and message.lon_int == 0:
        raise ValueError("SIM_STATE without lat_int: this firmware's truth is too coarse")
    return State(
        now_s,
        message.lat_int * 1e-7,
        message.lon_int * 1e-7,
        message.alt,
        (message.vn, message.ve, message.vd),
        message.roll,
        message.pitch,
        message.yaw,
    )
