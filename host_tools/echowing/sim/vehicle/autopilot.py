"""One ArduCopter as a MAVLink endpoint: bytes in, bytes out.

The autopilot owns the links, the parameters, the modes and the scripts of one vehicle; the body
moves by itself. What is modelled, and from which file of ArduPilot, stands in the modules used
here. Not modelled: polygon fences, pilot's sticks, battery and estimator fail-safes.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.applets import APPLETS
from echowing.errors import EchowingError
from echowing.geo import Ned
from echowing.sim.vehicle.commands import ACCEPTED, FAILED, Commands, command_of
from echowing.sim.vehicle.dataflash import DataflashLog, ScriptMessage
from echowing.sim.vehicle.flightlog import FlightLog
from echowing.sim.vehicle.ftp import FtpServer
from echowing.sim.vehicle.guided import Body, SubMode
from echowing.sim.vehicle.links import Router, SerialLink
from echowing.sim.vehicle.luahost import AltitudeFrame, LuaHost, Position, RangefinderBackend
from echowing.sim.vehicle.mission import Mission
from echowing.sim.vehicle.modes import GUIDED, MODES, Arming, FlightModes
from echowing.sim.vehicle.parameters import Generation, Parameters
from echowing.sim.vehicle.places import ORIGIN, Places
from echowing.sim.vehicle.rangefinder import MavlinkRangefinder
from echowing.sim.vehicle.streams import START_UNIX_S, STREAM_NUMBERS, STREAMS, Reports, Schedule
from echowing.sim.vehicle.targets import TargetReader

__all__ = ["ORIGIN", "Autopilot", "AutopilotEndedError"]

# Which serial port, and so which stream-rate parameters, a link of this name has.
USB, TELEMETRY, COPROCESSOR = "usb", "telemetry", "coprocessor"
_PORT_NUMBERS = {USB: 0, TELEMETRY: 1, COPROCESSOR: 2}
_FIRST_OTHER_PORT = 3

# Where scripts are on the card (AP_Scripting, SCRIPTING_DIRECTORY); one applet is simulated.
_SCRIPTS_ON_CARD = Path("APM", "scripts")
# Pointers take twice the memory here: tests/lua/heap.py measures what the vehicle's take.
_POINTERS = 2
_SCRIPTS_DISABLED = 2  # SCR_DIR_DISABLE: the card's scripts are not loaded
_NOT_SIGNED = 1  # MAVn_OPTIONS bit 0 (GCS.h, MAVLINK2_SIGNING_DISABLED)
_FTP_DISABLED = 2  # BRD_OPTIONS bit 1 (AP_BoardConfig): no file transfer

# A port gives about 30 % of its 57600 baud to a parameter list: one 37-byte value every 20 ms.
PARAMETER_PERIOD_S = 0.02
TEXT_CHARACTERS = 50
HELD_TEXTS = 30  # texts kept for a link where nobody has been heard yet (GCS_Common.cpp)
# Receiver as SITL's default: sticks in the middle, throttle low, switches as it has them.
_RC_US = (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1800, *(0,) * 8)
# Guided squares what it is given, in 32 bits, and SITL traps what overflows as it traps NaN.
_SQUARE_OVERFLOWS = math.sqrt(3.4028234e38)
_AUX_HIGH_US, _AUX_LOW_US = 1800, 1200  # RC_Channel.h: AUX_SWITCH_PWM_TRIGGER_HIGH, _LOW
_RC_VALID_US = range(801, 2200)
_RC_OPTION_CHANNELS = 16
_MISSION_MESSAGES = (
    mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
)


class AutopilotEndedError(EchowingError):
    """An autopilot's program has ended in flight: the vehicle falls, and so the simulation ends."""

    def __init__(self, system_id: int) -> None:
        super().__init__(
            f"the autopilot of vehicle {system_id} ended (floating point exception): its script "
            "gave Guided a target with a number that cannot be computed with"
        )
        self.system_id = system_id


class _Port:
    """One link of the autopilot, with its streams and its parameter list."""

    def __init__(self, autopilot: "Autopilot", link: SerialLink) -> None:
        self.link = link
        self.schedule = Schedule()
        self.rates_hz: dict[str, float] = {}
        """Rates asked for by REQUEST_DATA_STREAM, where the port has no parameters for them."""
        self.list_next: int | None = None
        self.list_due_s = 0.0
        self.held: deque[Any] = deque(maxlen=HELD_TEXTS)
        self._autopilot = autopilot

    def send(self, message: Any) -> None:
        self.link.send(message)

    def report(self, message_id: int) -> bool:
        message = self._autopilot.reports.build(message_id)
        if message is not None:
            self.link.send(message)
        return message is not None

    def set_interval(self, message_id: int, interval_us: int) -> bool:
        if message_id not in self._autopilot.reports.builders:
            return False
        self.schedule.set_interval(message_id, interval_us)
        self._autopilot.plan_streams(self)
        return True

    def interval_us(self, message_id: int) -> int:
        return self.schedule.interval_us(message_id)


class Autopilot:
    """ArduCopter on one vehicle; implements `VehicleApi` for its scripts.

    `body` is a `Copter`, or anything with its sensed attributes that moves by itself. A body in the
    air starts armed and in Guided. `parameters` are the values saved by former flights; names that
    this firmware does not know are kept for scripts. Times are seconds from the flight's start,
    which is when the autopilot boots. `seed` is taken for symmetry with other parts: nothing
    here is random.
    """

    def __init__(
        self,
        copter: Body,
        *,
        system_id: int,
        generation: Generation = Generation.V4_8,
        parameters: Mapping[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        self.copter = copter
        self.generation = generation
        # From 4.6 on scripts get frames with a wrong checksum as they get others
        # (GCS_MAVLINK::update_receive): signing and routing have not seen them.
        self._hands_on_broken = generation is not Generation.V4_5
        self.seed = seed
        self.links: dict[str, SerialLink] = {}
        self.rc_us = list(_RC_US)
        self.dataflash: DataflashLog | None = None
        self.texts: list[tuple[float, str]] = []
        """What it has said, with the flight's time: for whoever judges a flight."""
        self.named_floats: dict[str, float] = {}
        self.script: LuaHost | None = None
        self._script_path: Path | None = None
        self._files = FtpServer(None)
        self._ports: dict[str, _Port] = {}
        self._boot_s = 0.0
        self._unix_s = float(START_UNIX_S)
        self._t_s = 0.0
        self._text_id = 0
        self._reboot_wanted = False
        self._signing_key: bytes | None = None
        identity = {"MAV_SYSID": float(system_id), "SYSID_THISMAV": float(system_id)}
        self._boot({**identity, **(parameters or {})})
        self._router = Router(self.links, lambda: self.system_id)

    def _boot(self, saved: Mapping[str, float]) -> None:
        """Everything that a restart forgets."""
        self.parameters = Parameters(self.generation, saved)
        self.rangefinder = MavlinkRangefinder(self.parameters)
        self.rangefinder.update(self.millis())
        self.arming = Arming(self.parameters, self.rangefinder)
        self.places = Places(self.copter, self.parameters)
        self._inbox: deque[tuple[bytes, int]] = deque()
        self._flight_log: FlightLog | None = None
        self.modes = FlightModes(
            self.copter,
            self.parameters,
            self.places,
            self.arming,
            say=self.send_text,
            on_change=self._mode_changed,
            log_target=self._log_target,
        )
        self.reports = Reports(
            self.copter, self.parameters, self.places, self.modes, self.rangefinder, self.rc_us
        )
        self._targets = TargetReader(self.copter, self.places, self.modes.guided)
        self._commands = Commands(
            self.modes,
            self.parameters,
            self.places,
            reboot=self._want_reboot,
            restart_scripting=self._restart_scripting,
        )
        self._mission = Mission(self.modes, self.places)
        self._handlers = dict.fromkeys(_MISSION_MESSAGES, self._mission_message) | {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance_sensor,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._command,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._set_mode,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._target,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._target,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._param_request_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._param_request_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._param_set,
            mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._request_data_stream,
            mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._file_transfer,
            mavlink.MAVLINK_MSG_ID_SETUP_SIGNING: self._setup_signing,
        }

    # ---- set-up ---------------------------------------------------------------------------------

    @property
    def system_id(self) -> int:
        """Its MAVLink system id, from the parameter."""
        return int(self.parameters.value(self.parameters.dialect.system_id))

    def add_link(self, name: str) -> None:
        """Add a MAVLink port. usb, telemetry and coprocessor are SERIAL0, 1 and 2."""
        taken = {link.number for link in self.links.values()}
        number = _PORT_NUMBERS.get(name, _FIRST_OTHER_PORT)
        while number in taken:
            number += 1
        link = SerialLink(name, number, self.system_id)
        self.links[name] = link
        self._ports[name] = _Port(self, link)
        self.plan_streams(self._ports[name])

    def sign_link(self, name: str, key: bytes) -> None:
        """Sign a link with a 32-byte key: only what carries its signature is heard there."""
        self.links[name].sign(key, self._unix_s)

    def _setup_signing(self, port: _Port, message: Any) -> None:
        """A key for all links (GCS_Signing.cpp): the first, which is USB, goes on believing all.

        From 4.7 on a port is left out by its MAVn_OPTIONS (bit 0), which counts at the start.
        """
        if not self.modes.armed:
            self._signing_key = bytes(message.secret_key)
            self._sign_all(self._signing_key)

    def _sign_all(self, key: bytes) -> None:
        for link in self.links.values():
            if int(self.parameters.value(f"MAV{link.number + 1}_OPTIONS")) & _NOT_SIGNED:
                link.unsign()
            else:
                link.sign(key, self._unix_s, accept_unsigned=link.number == 0)

    def receive(self, link: str, data: bytes) -> None:
        """Bytes off the wire; they are looked at in the next step."""
        self.links[link].feed(data)

    def transmit(self, link: str) -> bytes:
        """What it wants to send, whole frames."""
        return self.links[link].drain()

    def set_errors(
        self, offset_ned_m: Ned, velocity_mps: tuple[float, float], receiver_down_m: float
    ) -> None:
        """Estimated minus true position, velocity (north, east), and the receiver's own height."""
        self.copter.set_estimate_offset(offset_ned_m, velocity_mps)
        self.reports.receiver_down_m = receiver_down_m

    def set_rc(self, channel: int, pwm: int) -> None:
        """Move a channel of the pilot's transmitter (1 to 16), microseconds."""
        self.rc_us[channel - 1] = pwm

    def set_mode(self, name: str) -> bool:
        """Change the mode as by the pilot's switch: GUIDED, LOITER, …; False: refused."""
        return self.modes.set_mode(MODES[name])

    def arm_and_fly(self, altitude_m: float) -> bool:
        """Arm whatever the checks say, and take off in Guided; False: cannot."""
        return (
            self.modes.set_mode(GUIDED)
            and self.modes.arm(force=True)
            and self.modes.take_off(altitude_m)
        )

    def start_mission(self, waypoints_ned_m: Sequence[Ned], speed_mps: float | None = None) -> None:
        """Fly waypoints (NED metres) in Auto; without a speed, at the speed parameter."""
        self.modes.start_mission(waypoints_ned_m, speed_mps)

    def load_script(self, path: Path) -> None:
        """Put a script on the SD card and start it, unless SCR_ENABLE is 0."""
        self._script_path = path
        self._start_script(path)

    def kill_script(self) -> None:
        """The script that runs is gone, as scripting out of memory leaves it; nothing else is."""
        self.script = None
        self._inbox.clear()

    def restart_scripting(self) -> None:
        """Start the script on the card again, as the scripting engine's restart does."""
        self._restart_scripting()

    def insert_card(self, card: Path, capacity_bytes: int | None = None) -> None:
        """Use a folder as SD card: files over MAVLink go there, and its Echowing applet runs.

        Other scripts on it are not started. `capacity_bytes`: see `FtpServer`.
        """
        self._files = FtpServer(card, capacity_bytes)
        self._restart_scripting()

    def _restart_scripting(self) -> None:
        """Forget the script that runs, and start what is on the card now."""
        self.script = None
        self._inbox.clear()
        self.arming.forget_scripts()
        card = self._files.card
        if card is None:
            if self._script_path is not None:
                self._start_script(self._script_path)
            return
        disabled = int(self.parameters.value("SCR_DIR_DISABLE")) & _SCRIPTS_DISABLED
        on_card = (card / _SCRIPTS_ON_CARD / applet.file for applet in APPLETS)
        script = next((path for path in on_card if path.is_file()), None)
        if script is not None and not disabled:
            self._start_script(script)

    def _start_script(self, path: Path) -> None:
        if self.parameters.value("SCR_ENABLE") == 0.0:
            return
        self.script = LuaHost(
            self,
            path,
            generation=self.generation,
            instruction_limit=int(self.parameters.value("SCR_VM_I_COUNT")),
            heap_bytes=_POINTERS * int(self.parameters.value("SCR_HEAP_SIZE")),
        )

    def start_log(self, path: Path) -> DataflashLog:
        """Write a dataflash log (.BIN) from now on; `dataflash.close()` ends it."""
        self.dataflash = DataflashLog(path.open("wb"), self._t_s)
        self._begin_log()
        return self.dataflash

    def reboot(self) -> None:
        """Restart the autopilot: what was only set is lost, its clock begins again."""
        self._boot_s += self._t_s
        self._t_s = 0.0
        self._boot(self.parameters.saved)
        if self._signing_key is not None:
            self._sign_all(self._signing_key)
        for port in self._ports.values():
            port.list_next = None
            port.link.routes.clear()
            port.schedule = Schedule()
            port.rates_hz.clear()
            self.plan_streams(port)
        self._restart_scripting()
        if self.dataflash is not None:
            self._begin_log()

    def _want_reboot(self) -> None:
        self._reboot_wanted = True  # after this step, so that the command is acknowledged

    # ---- one step -------------------------------------------------------------------------------

    def step(self, t_s: float) -> None:
        """Work at `t_s`, after the body has moved: input, checks, script, output, log."""
        self._unix_s = START_UNIX_S + t_s
        self._t_s = t_s = t_s - self._boot_s
        self.reports.t_s = t_s
        self.reports.unix_s = self._unix_s
        for port in self._ports.values():
            if port.link.waiting:
                self._listen(port)
        self.rangefinder.update(self.millis())
        self.modes.step(t_s)
        if self.script is not None:
            self.script.step(self.millis())
            self.arming.script_error = self.script.error
        for port in self._ports.values():
            self._speak(port, t_s)
        if self._flight_log is not None:
            self._flight_log.step(t_s, self._unix_s)
        if self._reboot_wanted:
            self._reboot_wanted = False
            self.reboot()

    def _listen(self, port: _Port) -> None:
        for frame, message in port.link.received():
            if message is None:
                if self._hands_on_broken:
                    self._hand_on(frame, port)
                continue
            if not self._router.accept(port.link, message):
                continue
            self._hand_on(frame, port)
            handler = self._handlers.get(message.get_msgId())
            if handler is not None:
                handler(port, message)

    def _hand_on(self, frame: bytes, port: _Port) -> None:
        if self.script is not None:
            self._inbox.append((frame, port.link.number))

    def _speak(self, port: _Port, t_s: float) -> None:
        if port.held and port.link.active:
            for text in port.held:
                port.link.send(text)
            port.held.clear()
        for message_id in port.schedule.due(t_s):
            port.report(message_id)
        if port.list_next is not None and t_s >= port.list_due_s:
            self._send_listed(port, t_s)

    # ---- messages in ----------------------------------------------------------------------------

    def _heartbeat(self, port: _Port, message: Any) -> None:
        names = self.parameters.dialect
        if message.get_srcSystem() == self.parameters.value(names.ground_station_id):
            self.modes.heard_ground_station(self._t_s)

    def _distance_sensor(self, port: _Port, message: Any) -> None:
        self.rangefinder.receive(message, self.millis())

    def _timesync(self, port: _Port, message: Any) -> None:
        if message.tc1 != 0:
            return  # an answer, and it asked nothing
        boot_ns = max(1, round(self._t_s * 1e9))  # 0 would make it a question
        port.send(mavlink.MAVLink_timesync_message(boot_ns, message.ts1))

    def _command(self, port: _Port, message: Any) -> None:
        result = self._commands.run(command_of(message), port)
        self._acknowledge(port, message, message.command, result)

    def _set_mode(self, port: _Port, message: Any) -> None:
        custom = message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        done = custom and self.modes.set_mode(message.custom_mode)
        result = ACCEPTED if done else FAILED
        self._acknowledge(port, message, mavlink.MAVLINK_MSG_ID_SET_MODE, result)

    def _acknowledge(self, port: _Port, message: Any, command: int, result: int) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        port.send(mavlink.MAVLink_command_ack_message(command, result, 0, 0, *source))

    def _target(self, port: _Port, message: Any) -> None:
        if self.modes.mode != GUIDED:
            return
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
            self._targets.read_global(message)
        else:
            self._targets.read_local(message)

    def _file_transfer(self, port: _Port, message: Any) -> None:
        if int(self.parameters.value("BRD_OPTIONS")) & _FTP_DISABLED:
            self.send_text(mavlink.MAV_SEVERITY_INFO, "FTP disabled")
            return
        system, component = message.get_srcSystem(), message.get_srcComponent()
        sender = (port.link.name, system, component)
        for payload in self._files.answer(sender, bytes(message.payload), self._t_s):
            port.send(mavlink.MAVLink_file_transfer_protocol_message(0, system, component, payload))

    def _mission_message(self, port: _Port, message: Any) -> None:
        self._mission.receive(message, port.send)

    def _request_data_stream(self, port: _Port, message: Any) -> None:
        rate_hz = message.req_message_rate if message.start_stop else 0
        for stream in STREAM_NUMBERS.get(message.req_stream_id, ()):
            self.parameters.set(self._rate_name(port, stream), rate_hz)
            port.rates_hz[stream] = rate_hz
        self.plan_streams(port)

    # ---- parameters -----------------------------------------------------------------------------

    def _param_request_list(self, port: _Port, message: Any) -> None:
        port.list_next = 0
        port.list_due_s = self._t_s

    def _send_listed(self, port: _Port, t_s: float) -> None:
        index = port.list_next or 0
        name = self.parameters.name(index)
        if name is None:
            port.list_next = None
            return
        port.send(self._param_value(name, index))
        port.list_next = index + 1
        port.list_due_s = t_s + PARAMETER_PERIOD_S - 1e-6  # sums of steps are rounded

    def _param_value(self, name: str, index: int) -> Any:
        parameters = self.parameters
        return mavlink.MAVLink_param_value_message(
            name.encode(),
            parameters.value(name),
            parameters.mavlink_type(name),
            len(parameters),
            index,
        )

    def _param_request_read(self, port: _Port, message: Any) -> None:
        if message.param_index >= 0:
            name = self.parameters.name(message.param_index)
        else:
            name = message.param_id
        if name is not None and self.parameters.get(name) is not None:
            port.send(self._param_value(name, self.parameters.index(name)))

    def _param_set(self, port: _Port, message: Any) -> None:
        name = message.param_id
        if not self.parameters.save(name, message.param_value):
            return
        self._parameter_changed(name)
        for other in self._ports.values():
            if other is port or other.link.active:
                other.send(self._param_value(name, self.parameters.index(name)))

    def _parameter_changed(self, name: str) -> None:
        names = self.parameters.dialect
        if name == names.system_id:
            for link in self.links.values():
                link.set_system_id(self.system_id)
        if name.startswith(names.stream_prefix):
            for port in self._ports.values():
                port.rates_hz.clear()
                self.plan_streams(port)
        if self._flight_log is not None:
            self._flight_log.parameter(self._t_s, name)

    def _rate_name(self, port: _Port, stream: str) -> str:
        names = self.parameters.dialect
        return f"{names.stream_prefix}{port.link.number + names.first_stream}_{stream}"

    def plan_streams(self, port: _Port) -> None:
        """Work out a port's message rates anew, from parameters and requests."""
        rates_hz = {
            stream: port.rates_hz.get(stream, self.parameters.value(self._rate_name(port, stream)))
            for stream in STREAMS
        }
        port.schedule.plan(rates_hz, self._t_s)

    # ---- the log --------------------------------------------------------------------------------

    def _begin_log(self) -> None:
        if self.dataflash is None:
            return
        self._flight_log = FlightLog(self.dataflash, self)
        self._flight_log.begin(self._t_s)

    def _mode_changed(self) -> None:
        if self._flight_log is not None:
            self._flight_log.mode(self._t_s)

    def _log_target(self, sub_mode: SubMode, position: Ned, velocity: Ned) -> None:
        if self._flight_log is not None:
            self._flight_log.target(self._t_s, sub_mode, position, velocity)

    # ---- VehicleApi: what scripts see -----------------------------------------------------------

    def millis(self) -> int:
        """Milliseconds since the autopilot started."""
        return int(self._t_s * 1000.0 + 0.5)

    def armed(self) -> bool:
        """Motors armed."""
        return self.modes.armed

    def mode_number(self) -> int:
        """Copter's mode number."""
        return self.modes.mode

    def flying(self) -> bool:
        """Armed and off the ground."""
        return self.modes.flying

    def parameter_get(self, name: str) -> float | None:
        """Value in force, or None where this firmware has no such parameter."""
        return self.parameters.get(name)

    def parameter_set(self, name: str, value: float) -> bool:
        """Set until the next restart."""
        done = self.parameters.set(name, value)
        if done:
            self._parameter_changed(name)
        return done

    def parameter_save(self, name: str, value: float) -> bool:
        """Set and keep."""
        done = self.parameters.save(name, value)
        if done:
            self._parameter_changed(name)
        return done

    def parameter_add_table(self, key: int, prefix: str, count: int) -> bool:
        """Room for a script's parameters."""
        return self.parameters.add_table(key, prefix, count)

    def parameter_add(self, key: int, index: int, name: str, default: float) -> bool:
        """Add one parameter of a script."""
        return self.parameters.add(key, index, name, default)

    def rangefinder_orientations(self) -> Sequence[int]:
        """Orientation of each configured sensor."""
        return [self.rangefinder.orientation] if self.rangefinder.configured else []

    def rangefinder_status(self, orientation: int) -> int:
        """0 not connected, 1 no data, 2 too low, 3 too high, 4 good."""
        return self.rangefinder.status if self._looks(orientation) else 0

    def rangefinder_distance_m(self, orientation: int) -> float:
        """Handed out in every state; 0 without data."""
        return self.rangefinder.distance_m if self._looks(orientation) else 0.0

    def rangefinder_signal_quality(self, orientation: int) -> int:
        """Per cent, -1 unknown."""
        return self.rangefinder.quality if self._looks(orientation) else -1

    def rangefinder_backend(self, number: int) -> RangefinderBackend | None:
        """The only sensor, of RNGFND1."""
        one = self.rangefinder
        if number > 0 or not one.configured:
            return None
        return RangefinderBackend(
            one.orientation, one.type, one.status, one.distance_m, one.read_ms
        )

    def _looks(self, orientation: int) -> bool:
        return self.rangefinder.configured and self.rangefinder.orientation == orientation

    def set_desired_speed(self, speed_mps: float) -> bool:
        """Speed limit in Guided or Auto; 0 is no limit."""
        return self.modes.set_speed(speed_mps)

    def set_target_location(
        self, lat_deg: float, lon_deg: float, alt_m: float, frame: AltitudeFrame
    ) -> bool:
        """Guided position target; False: not in Guided, or outside the fence."""
        if self.modes.mode != GUIDED:
            return False
        return self.modes.guided.position(self.places.ned(lat_deg, lon_deg, alt_m, frame))

    def get_target_location(self) -> Position | None:
        """Position target in force, None where there is none."""
        target = self.modes.position_target()
        if target is None:
            return None
        place = self.places.place(target)
        return place.lat_deg, place.lon_deg, -target[2], "above_origin"

    def set_target_position_ned(self, position_ned_m: Ned, yaw_rad: float | None) -> bool:
        """Guided position target from the estimator's origin."""
        if self.modes.mode != GUIDED:
            return False
        self._must_be_finite((*position_ned_m, yaw_rad or 0.0))
        return self.modes.guided.position(position_ned_m, yaw_rad)

    def set_target_posvel_ned(
        self,
        position_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> bool:
        """Guided position and velocity target, and how the velocity and the yaw change."""
        if self.modes.mode != GUIDED:
            return False
        turns = (yaw_rad or 0.0, yaw_rate_rps)
        self._must_be_finite((*position_ned_m, *velocity_ned_mps, *acceleration_ned_mps2, *turns))
        return self.modes.guided.position_velocity(
            position_ned_m, velocity_ned_mps, yaw_rad, acceleration_ned_mps2, yaw_rate_rps
        )

    def set_target_velocity_ned(self, velocity_ned_mps: Ned) -> bool:
        """Guided velocity target; times out after 3 s."""
        if self.modes.mode != GUIDED:
            return False
        self._must_be_finite(velocity_ned_mps)
        self.modes.guided.velocity(velocity_ned_mps)
        return True

    def _must_be_finite(self, numbers: Sequence[float]) -> None:
        """Guided computes with what a script gives it, and its arithmetic traps what is no number.

        What MAVLink brings it checks (sane_vel_or_acc_vector); the Lua bindings do not.
        """
        if not all(abs(number) < _SQUARE_OVERFLOWS for number in numbers):  # nor is NaN
            raise AutopilotEndedError(self.system_id)

    def position_ned_m(self) -> Ned | None:
        """Estimated position from the estimator's origin."""
        return self.places.here_ned_m()

    def height_above_home_m(self) -> float:
        """Estimated height above home."""
        return self.places.height_m()

    def velocity_ned_mps(self) -> Ned | None:
        """Estimated velocity."""
        return self.copter.est_vn_mps, self.copter.est_ve_mps, self.copter.vd_mps

    def location(self) -> tuple[float, float, float] | None:
        """Estimated latitude, longitude (degrees) and altitude above mean sea level."""
        return self.reports.here()

    def yaw_rad(self) -> float:
        """Heading, -pi to pi."""
        return self.copter.yaw_rad

    def rc_option_position(self, option: int) -> int | None:
        """Switch with this RC option: 0 low, 1 middle, 2 high; None: not assigned or no signal."""
        for channel in range(1, _RC_OPTION_CHANNELS + 1):
            if self.parameters.get(f"RC{channel}_OPTION") == option:
                pwm = self.rc_us[channel - 1]
                if pwm not in _RC_VALID_US:
                    return None
                return 2 if pwm > _AUX_HIGH_US else 0 if pwm < _AUX_LOW_US else 1
        return None

    def send_text(self, severity: int, text: str) -> None:
        """STATUSTEXT on every link (kept for links where nobody has been heard yet), and MSG."""
        self.texts.append((self._boot_s + self._t_s, text))
        for message in self._text_messages(severity, text):
            for port in self._ports.values():
                port.held.append(message)
        if self._flight_log is not None:
            self._flight_log.text(self._t_s, text)

    def _text_messages(self, severity: int, text: str) -> list[Any]:
        """A long text goes in pieces of 50 characters under one id."""
        data = text.encode("utf-8", "replace")
        pieces = [data[i : i + TEXT_CHARACTERS] for i in range(0, len(data), TEXT_CHARACTERS)]
        number = 0
        if len(pieces) > 1:
            self._text_id = number = self._text_id % 0xFFFF + 1
        return [
            mavlink.MAVLink_statustext_message(severity, piece, number, sequence)
            for sequence, piece in enumerate(pieces)
        ]

    def send_named_float(self, name: str, value: float) -> None:
        """NAMED_VALUE_FLOAT on the links where somebody has been heard."""
        self.named_floats[name] = value
        message = mavlink.MAVLink_named_value_float_message(
            self.millis() & 0xFFFFFFFF, name[:10].encode(), value
        )
        for link in self.links.values():
            if link.active:
                link.send(message)

    def log_write(self, message: ScriptMessage) -> None:
        """One message of a script in the dataflash log, if one is written."""
        if self.dataflash is not None:
            self.dataflash.write_script(message, self._t_s)

    def aux_auth_id(self) -> int | None:
        """Reserve one of the three pre-arm authorisation ids."""
        return self.arming.new_id()

    def aux_auth_passed(self, auth_id: int) -> None:
        """Let the vehicle arm as far as this id goes."""
        self.arming.passed(auth_id)

    def aux_auth_failed(self, auth_id: int, reason: str) -> None:
        """Refuse arming with a reason."""
        self.arming.failed(auth_id, reason)

    def next_mavlink(self) -> tuple[bytes, int] | None:
        """Oldest frame not yet handed to scripting, and its link's number."""
        return self._inbox.popleft() if self._inbox else None

    def send_mavlink(self, link: int, message_id: int, payload: bytes) -> bool | None:
        """Send a script's message by a link; False: it has no room, None: no such link."""
        port = next((one for one in self.links.values() if one.number == link), None)
        return None if port is None else port.send_packed(message_id, payload)
