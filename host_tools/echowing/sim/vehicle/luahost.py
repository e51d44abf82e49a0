"""ArduPilot's scripting engine, simulated: runs an applet's file unedited and just as strictly.

Lua 5.3 with 32-bit integers and floats, ArduPilot's bindings by name with their argument checks,
nil cases and userdata, its sandbox, its limits of locals, upvalues, instructions and heap. Which
calls exist and what they take is written once, in `lua_bindings.lua`. Sources: ArduPilot
libraries/AP_Scripting (lua_scripts.cpp, lua_bindings.cpp, lua_boxed_numerics.cpp, lua/src).

Two globals of the vehicle are refused, as no applet needs them: `print`, which writes where no
pilot looks, and `package`.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Sequence
from ctypes import c_float
from dataclasses import dataclass
from functools import cache
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from lupa import lua53
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.sim.vehicle import lua_limits
from echowing.sim.vehicle.dataflash import ScriptMessage

if TYPE_CHECKING:
    from echowing.sim.vehicle.parameters import Generation

Ned = tuple[float, float, float]
AltitudeFrame = Literal["absolute", "above_home", "above_origin", "above_terrain"]
Position = tuple[float, float, float, AltitudeFrame]
"""Latitude and longitude in degrees, altitude in metres above what the frame says."""

BINDINGS = Path(__file__).with_name("lua_bindings.lua")
PRELUDE = Path(__file__).with_name("lua_prelude.lua")

SEVERITY_CRITICAL = 2  # MAV_SEVERITY
MINIMUM_INSTRUCTIONS = 1000  # lua_scripts.cpp takes no less for SCR_VM_I_COUNT
WIDE_SYSTEM_ID_SINCE = (4, 8)  # mavlink_message_t grew from 291 to 299 bytes for 32-bit system ids


class RangefinderBackend(NamedTuple):
    """One sensor of a vehicle: RNGFNDn_ORIENT and _TYPE, status, and the newest reading.

    read_ms: when its driver took that, as `millis`.
    """

    orientation: int
    type: int
    status: int
    distance_m: float
    read_ms: int


class VehicleApi(Protocol):
    """What a script sees of its vehicle. Metres, seconds, radians; places in degrees."""

    def millis(self) -> int:
        """Milliseconds since the autopilot started."""

    def armed(self) -> bool:
        """Motors armed."""

    def mode_number(self) -> int:
        """Copter's mode: 0 Stabilize, 3 Auto, 4 Guided, 5 Loiter, 6 RTL."""

    def flying(self) -> bool:
        """Likely flying."""

    def parameter_get(self, name: str) -> float | None:
        """Value, or None where this version has no such parameter."""

    def parameter_set(self, name: str, value: float) -> bool:
        """Set until the next restart; False: no such parameter."""

    def parameter_save(self, name: str, value: float) -> bool:
        """Set and keep; False: no such parameter."""

    def parameter_add_table(self, key: int, prefix: str, count: int) -> bool:
        """Room for `count` script parameters; False: key or prefix taken."""

    def parameter_add(self, key: int, index: int, name: str, default: float) -> bool:
        """Add one (`name` without the prefix); a saved value comes back instead of the default."""

    def rangefinder_orientations(self) -> Sequence[int]:
        """Orientation of each configured sensor (0 forward, 25 down)."""

    def rangefinder_status(self, orientation: int) -> int:
        """0 not connected, 1 no data, 2 too low, 3 too high, 4 good."""

    def rangefinder_distance_m(self, orientation: int) -> float:
        """Handed out in every state; 0 without data."""

    def rangefinder_signal_quality(self, orientation: int) -> int:
        """Per cent, -1 unknown."""

    def rangefinder_backend(self, number: int) -> RangefinderBackend | None:
        """The sensor of RNGFND`number + 1`; None: there is none."""

    def set_desired_speed(self, speed_mps: float) -> bool:
        """Limit of Guided's horizontal speed; 0 is no limit."""

    def set_target_location(
        self, lat_deg: float, lon_deg: float, alt_m: float, frame: AltitudeFrame
    ) -> bool:
        """Guided position target; False: refused."""

    def get_target_location(self) -> Position | None:
        """Position target in force; None in sub-modes that keep none (posvel is one)."""

    def set_target_position_ned(self, position_ned_m: Ned, yaw_rad: float | None) -> bool:
        """Guided position target from the estimator's origin."""

    def set_target_posvel_ned(
        self,
        position_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> bool:
        """Guided position and velocity target, and how the velocity and the yaw change."""

    def set_target_velocity_ned(self, velocity_ned_mps: Ned) -> bool:
        """Guided velocity target; times out after 3 s."""

    def position_ned_m(self) -> Ned | None:
        """Estimated position from the estimator's origin."""

    def height_above_home_m(self) -> float:
        """Estimated height above home."""

    def velocity_ned_mps(self) -> Ned | None:
        """Estimated velocity."""

    def location(self) -> tuple[float, float, float] | None:
        """Estimated latitude and longitude in degrees, altitude in metres above mean sea level."""

    def yaw_rad(self) -> float:
        """Heading, -pi to pi, 0 north, clockwise."""

    def rc_option_position(self, option: int) -> int | None:
        """Switch with this RC option: 0 low, 1 middle, 2 high; None: not assigned."""

    def send_text(self, severity: int, text: str) -> None:
        """STATUSTEXT to the ground."""

    def send_named_float(self, name: str, value: float) -> None:
        """NAMED_VALUE_FLOAT to the ground."""

    def log_write(self, message: ScriptMessage) -> None:
        """One message in the dataflash log."""

    def aux_auth_id(self) -> int | None:
        """Reserve one of the three pre-arm authorisation ids; None: all taken."""

    def aux_auth_passed(self, auth_id: int) -> None:
        """Let the vehicle arm as far as this id goes."""

    def aux_auth_failed(self, auth_id: int, reason: str) -> None:
        """Refuse arming with a reason."""

    def next_mavlink(self) -> tuple[bytes, int] | None:
        """Oldest frame not yet handed to scripting (bytes as on the wire), its link's number."""

    def send_mavlink(self, link: int, message_id: int, payload: bytes) -> bool | None:
        """Send a message by a link; False: it has no room, None: no such link."""


@dataclass(frozen=True)
class Parameter:
    """One argument of a binding as annotated."""

    kind: str
    optional: bool
    span: tuple[int, int] | None


@dataclass(frozen=True)
class Binding:
    """One call: `owner` is a singleton, a userdata class or "" for a global function."""

    owner: str
    name: str
    parameters: tuple[Parameter, ...]
    variadic: bool
    since: tuple[int, int]


_FUNCTION = re.compile(r"function (?:(\w+):)?(\w+)\(([^)]*)\) end")
_PARAM = re.compile(r"---@param (\w+|\.\.\.)(\?)? (\S+)(?: (-?\d+)\.\.(-?\d+))?")
_SINCE = re.compile(r"-- since: (\d+)\.(\d+)")


def read_bindings(text: str) -> list[Binding]:
    """Bindings in an annotations file (see the head of `lua_bindings.lua`).

    Raises EchowingError where a function's arguments and its @param lines differ.
    """
    bindings = []
    block: list[str] = []
    for line in text.splitlines():
        if line.startswith("--"):
            block.append(line)
            continue
        if match := _FUNCTION.match(line):
            bindings.append(_binding(match, block))
        block = []
    return bindings


def _binding(match: re.Match[str], block: list[str]) -> Binding:
    owner, name, arguments = match.group(1) or "", match.group(2), match.group(3)
    found = [m for line in block if (m := _PARAM.match(line))]
    if [m.group(1) for m in found] != [a.strip() for a in arguments.split(",") if a.strip()]:
        raise EchowingError(
            f"{BINDINGS.name}: @param lines of {owner}:{name} do not match its list"
        )
    since = next((m for line in block if (m := _SINCE.match(line))), None)
    return Binding(
        owner,
        name,
        tuple(_parameter(m) for m in found if m.group(1) != "..."),
        any(m.group(1) == "..." for m in found),
        (int(since.group(1)), int(since.group(2))) if since else (0, 0),
    )


def _parameter(match: re.Match[str]) -> Parameter:
    span = (int(match.group(4)), int(match.group(5))) if match.group(4) else None
    return Parameter(match.group(3), match.group(2) == "?", span)


def _checked_source(binding: Binding) -> str:
    """Lua source of the function that checks a call's arguments and then makes it.

    What is right in the first place is seen here; `check` coerces, or fails.
    """
    names = [f"a{i}" for i, _ in enumerate(binding.parameters, 1)]
    least = sum(not p.optional for p in binding.parameters)
    of_userdata = binding.owner.endswith("_ud")
    lines = [
        "local call, check, class = ...",
        "local math_type, meta, select, type, classes = math_type, meta, select, type, classes",
        "local own = class and class.meta",
        "return function(" + ("self, ..." if binding.owner else "...") + ")",
    ]
    if binding.owner:
        wrong = "meta(self) ~= own" if of_userdata else "self ~= class.only"
        lines.append(f"  if {wrong} then check.self(self, class, '{binding.name}') end")
    lines.append("  local given = select('#', ...)")
    too_few = [f"given < {least}"] if least else []
    too_many = [] if binding.variadic else [f"given > {len(names)}"]
    bound = " or ".join(too_few + too_many)
    lines.append(f"  if {bound} then check.arity(given, {least}, '{binding.name}') end")
    if names:
        lines.append(f"  local {', '.join(names)} = ...")
    for position, (name, parameter) in enumerate(zip(names, binding.parameters, strict=True), 1):
        lines.append(_check_line(name, parameter, position, binding.name))
    passed = (["self"] if of_userdata else []) + names
    if binding.variadic:
        passed.append(f"select({len(names) + 1}, ...)")
    return "\n".join([*lines, f"  return call({', '.join(passed)})", "end"])


# What is right in the first place, by kind; a float is taken as it is.
_RIGHT = {
    "number": "math_type({0}) == 'float'",
    "integer": "math_type({0}) == 'integer'",
    "string": "type({0}) == 'string'",
    "boolean": "type({0}) == 'boolean'",
}


def _check_line(name: str, parameter: Parameter, position: int, function: str) -> str:
    kind, extra = parameter.kind, ""
    if kind in _RIGHT:
        right = _RIGHT[kind].format(name)
        if parameter.span:
            least, most = parameter.span
            right += f" and {name} >= {least} and {name} <= {most}"
            extra = f", {least}, {most}"
    elif "|" not in kind and kind.endswith("_ud"):
        userdata = kind.removesuffix("_ud")
        right, extra, kind = (
            f"meta({name}) == classes.{userdata}.meta",
            f", '{userdata}'",
            "userdata",
        )
    else:
        return f"  -- {name}: anything"
    unless = f"{name} == nil or ({right})" if parameter.optional else right
    check = f"{name} = check.{kind}({name}, {position}, '{function}'{extra})"
    return f"  if not ({unless}) then {check} end"


@cache
def _binding_sources() -> tuple[tuple[Binding, str], ...]:
    found = read_bindings(BINDINGS.read_text(encoding="utf-8"))
    return tuple((binding, _checked_source(binding)) for binding in found)


def mavlink_structure(frame: bytes, *, wide_system_id: bool) -> bytes:
    """A frame from the wire as the C structure `mavlink_message_t`: how scripts get it.

    Layout (little endian): checksum u16, magic u8, length u8, incompat u8, compat u8, sequence u8,
    system id u8 (u32 when `wide_system_id`), component id u8, message id u24, payload in 264 bytes,
    checksum bytes 2, signature 13; with the wide id, 5 bytes of extended target follow.
    """
    length = frame[1]
    if frame[0] == 0xFE:  # MAVLink 1
        flags, sequence, system, component = b"\0\0", frame[2], frame[3], frame[4]
        message_id, start = bytes([frame[5], 0, 0]), 6
    else:
        flags, sequence, system, component = frame[2:4], frame[4], frame[5], frame[6]
        message_id, start = frame[7:10], 10
    payload = frame[start : start + length]
    checksum = frame[start + length : start + length + 2]
    head = checksum + bytes([frame[0], length]) + flags + bytes([sequence])
    head += system.to_bytes(4 if wide_system_id else 1, "little") + bytes([component]) + message_id
    body = payload.ljust(264, b"\0") + checksum + b"\0" * (13 + (5 if wide_system_id else 0))
    return head + body


def message_id(frame: bytes) -> int:
    """MAVLink message id of a frame from the wire."""
    return frame[5] if frame[0] == 0xFE else int.from_bytes(frame[7:10], "little")


class _Inbox:
    """The receive queue behind `mavlink:init`: what does not fit is dropped, newest first."""

    def __init__(self, *, wide_system_id: bool) -> None:
        self._wide = wide_system_id
        self._depth: int | None = None
        self._places = 0
        self._ids: set[int] = set()
        self._queue: deque[tuple[bytes, int, int]] = deque()

    def init(self, depth: int, places: int) -> None:
        if self._depth is None:
            self._depth, self._places = depth, places

    def register(self, wanted: int) -> bool | None:
        if wanted in self._ids:
            return False
        if len(self._ids) >= self._places:
            return None
        self._ids.add(wanted)
        return True

    def offer(self, frame: bytes, link: int, time_ms: int) -> None:
        if self._depth is None or message_id(frame) not in self._ids:
            return
        if len(self._queue) < self._depth:
            self._queue.append((frame, link, time_ms))

    def receive(self) -> tuple[bytes, int, int] | bool | None:
        if self._depth is None:
            return False
        if not self._queue:
            return None
        frame, link, time_ms = self._queue.popleft()
        return mavlink_structure(frame, wide_system_id=self._wide), link, _signed(time_ms)


def _signed(value: int) -> int:
    """32 bits of an unsigned number as the signed one that Lua keeps."""
    value &= 0xFFFFFFFF
    return value - (1 << 32) if value >= 1 << 31 else value


def _new_runtime(lua_module: Any = lua53) -> Any:
    runtime = lua_module.LuaRuntime(
        register_eval=False,
        register_builtins=False,
        unpack_returned_tuples=True,
        max_memory=1 << 30,  # a limit can only be lowered later if there was one from the start
    )
    if runtime.eval("math.maxinteger") != 0x7FFFFFFF:
        raise EchowingError(
            "lupa's Lua has 64-bit numbers; the autopilot's has 32-bit ones. `make setup` in a "
            "clone of the repository builds it"
        )
    return runtime


class LuaHost:
    """One script on one simulated autopilot."""

    def __init__(
        self,
        vehicle: VehicleApi,
        script: Path,
        *,
        generation: Generation,
        instruction_limit: int = 10000,
        heap_bytes: int = 204800,
        count_instructions: bool = False,
    ) -> None:
        """Load `script`; it first runs in the first `step`.

        `instruction_limit` is SCR_VM_I_COUNT and `heap_bytes` SCR_HEAP_SIZE, which here covers the
        script alone, but with 64-bit pointers. `count_instructions` measures instead of limiting.

        Raises EchowingError where the file is missing or lupa was built with 64-bit numbers.
        """
        self.error: str | None = None
        self.running = True
        self.next_run_ms = 0
        self.instructions = 0
        """Instructions of the last run, own code only (with `count_instructions`)."""
        self._vehicle = vehicle
        self._fault: BaseException | None = None
        version = tuple(int(n) for n in generation.name.removeprefix("V").split("_"))
        self._inbox = _Inbox(wide_system_id=version >= WIDE_SYSTEM_ID_SINCE)
        self._name = f"scripts/{script.name}"
        self._folder = script.parent
        self._lua = _new_runtime()
        self._pcall = self._lua.globals().pcall
        self._sethook = self._lua.globals().debug.sethook
        self._host = self._prelude(version)
        self._base_bytes = self._collect()
        self._heap_bytes = heap_bytes
        self._function = self._load(script)
        self._lua.set_max_memory(self._base_bytes + heap_bytes)
        chunk = "@" + self._name
        self._hook, self._reset, self._tell = (
            self._host.new_counter(chunk) if count_instructions else self._host.new_limit()
        )
        self._usual_limit = (
            1 if count_instructions else max(instruction_limit, MINIMUM_INSTRUCTIONS)
        )
        self._limit = self._usual_limit
        self._counting = count_instructions

    def step(self, t_ms: int) -> None:
        """Run the script's function once if it is due at `t_ms`."""
        while (received := self._vehicle.next_mavlink()) is not None:
            self._inbox.offer(received[0], received[1], t_ms)
        if self.running and t_ms >= self.next_run_ms:
            self._run(t_ms)

    def kill_after(self, instructions: int) -> None:
        """Let the next run exceed its limit after so few instructions: death in mid-update."""
        self._limit = instructions

    def local_value(self, name: str) -> Any:
        """A local of the script by name (a pure function, a table), for tests; None: not found."""
        return self._host.find(self._function, name)

    def heap_bytes(self) -> int:
        """Heap in use by the script after a full collection (64-bit pointers)."""
        return self._collect() - self._base_bytes

    def _prelude(self, version: tuple[int, ...]) -> Any:
        source = PRELUDE.read_text(encoding="utf-8")
        functions = {name: self._guarded(f) for name, f in self._functions().items()}
        host = self._lua.execute(source, self._lua.table_from(functions), "@" + self._name)
        for binding, text in _binding_sources():
            if version >= binding.since:
                host.bind(binding.owner, binding.name, text)
        return host

    def _load(self, script: Path) -> Any:
        try:
            source = script.read_bytes()
        except OSError as problem:
            raise EchowingError(f"cannot read the script {script}: {problem.strerror}") from problem
        # The vehicle reads the text piece by piece; here all of it is in the memory while it loads.
        self._lua.set_max_memory(self._base_bytes + self._heap_bytes + len(source))
        loaded = self._host.load(source, "@" + self._name)
        if not isinstance(loaded, tuple):
            return loaded
        self._stop(f"Error: {_text(loaded[1])}")
        return None

    def _module(self, name: str) -> tuple[str, str | None]:
        """Where `require` looks for a module, and its text; None: it is not there."""
        file = Path("modules", f"{name.replace('.', '/')}.lua")
        try:
            text = (self._folder / file).read_text(encoding="utf-8")
        except OSError:
            text = None
        return f"scripts/{file}", text

    def _collect(self) -> int:
        self._lua.gccollect()
        return int(self._lua.get_memory_used())

    def _run(self, t_ms: int) -> None:
        self._reset()
        self._sethook(self._hook, "", self._limit)
        self._limit = self._usual_limit
        try:
            result = self._pcall(self._function)
        except lua53.LuaError as problem:  # memory may run out in the call itself
            result = (False, str(problem))
        finally:
            self._sethook()
        if self._fault is not None:
            raise self._fault
        if self._counting:
            self.instructions = int(self._tell())
        values = result if isinstance(result, tuple) else (result,)
        if not values[0]:
            over = not self._counting and self._tell()
            self._stop(f"{self._name} exceeded time limit" if over else _text(values[1]))
            return
        self._reschedule(values[1:], t_ms)

    def _reschedule(self, returned: tuple[Any, ...], t_ms: int) -> None:
        if not returned:
            self.running = False
        elif len(returned) != 2:
            self._stop(f"{self._name} returned bad result count ({len(returned)})")
        elif isinstance(returned[1], bool) or not isinstance(returned[1], int | float):
            self._stop(f"{self._name} did not return a delay")
        elif lua53.lua_type(returned[0]) != "function":
            self._stop(f"{self._name} did not return a function")
        else:
            self._function = returned[0]
            self.next_run_ms = t_ms + int(returned[1])

    def _stop(self, reason: str) -> None:
        self.running = False
        self.error = reason
        self._vehicle.send_text(SEVERITY_CRITICAL, f"Lua: {reason}")

    def _guarded(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Keep a fault of the simulated vehicle, or Ctrl-C, from passing for a script's error."""

        def guarded(*arguments: Any) -> Any:
            try:
                return function(*arguments)
            except BaseException as fault:
                self._fault = self._fault or fault
                raise

        return guarded

    def _functions(self) -> dict[str, Callable[..., Any]]:
        """The vehicle's functions as the prelude wants them: places in 1e-7 degrees and cm."""
        vehicle = self._vehicle
        inbox = self._inbox

        def location() -> tuple[int, int, int] | None:
            here = vehicle.location()
            return here and _to_e7(*here)

        def get_target_location() -> tuple[int, int, int, str] | None:
            target = vehicle.get_target_location()
            return target and (*_to_e7(*target[:3]), target[3])

        def set_target_location(lat: int, lng: int, alt: int, frame: AltitudeFrame) -> bool:
            return vehicle.set_target_location(lat * 1e-7, lng * 1e-7, alt * 0.01, frame)

        def set_target_posvel(
            n: float,
            e: float,
            d: float,
            vn: float,
            ve: float,
            vd: float,
            yaw_rad: float | None = None,
            yaw_rate_rps: float = 0.0,
            *acceleration: float,
        ) -> bool:
            an, ae, ad = acceleration or (0.0, 0.0, 0.0)
            return vehicle.set_target_posvel_ned(
                (n, e, d), (vn, ve, vd), yaw_rad, (an, ae, ad), yaw_rate_rps
            )

        def rangefinder_backend(number: int) -> tuple[float, ...] | None:
            one = vehicle.rangefinder_backend(number)
            return one and (*one[:3], float(one.distance_m), _signed(one.read_ms))

        def mavlink_send(
            link: int, message_id: int, *payload: int
        ) -> tuple[bool | None, str | None]:
            kind = mavlink.mavlink_map.get(message_id)
            if kind is None:
                return None, f"Unknown MAVLink message ID ({message_id})"
            whole_bytes = kind.unpacker.size
            if len(payload) < whole_bytes:  # the vehicle would send what lies behind in its memory
                return None, f"{len(payload)} of {whole_bytes} bytes of message {message_id}"
            return vehicle.send_mavlink(link, message_id, bytes(payload[:whole_bytes])), None

        def log_write(*described: Any) -> None:
            *texts, values = described
            vehicle.log_write(ScriptMessage._make((*texts, list(values.values()))))

        return {
            "millis": lambda: _signed(vehicle.millis()),
            "micros": lambda: _signed(vehicle.millis() * 1000),
            "refusal": lambda text, name: lua_limits.refusal(text.encode(), name),
            "module": self._module,
            "armed": vehicle.armed,
            "mode_number": vehicle.mode_number,
            "flying": vehicle.flying,
            "parameter_get": lambda name: _float(vehicle.parameter_get(name)),
            "parameter_set": vehicle.parameter_set,
            "parameter_save": vehicle.parameter_save,
            "parameter_add_table": vehicle.parameter_add_table,
            "parameter_add": vehicle.parameter_add,
            "rangefinder_count": lambda: len(vehicle.rangefinder_orientations()),
            "rangefinder_has": lambda o: o in vehicle.rangefinder_orientations(),
            "rangefinder_status": vehicle.rangefinder_status,
            "rangefinder_distance_m": lambda o: float(vehicle.rangefinder_distance_m(o)),
            "rangefinder_distance_cm": lambda o: _centimetres(vehicle.rangefinder_distance_m(o)),
            "rangefinder_quality": vehicle.rangefinder_signal_quality,
            "rangefinder_backend": rangefinder_backend,
            "set_desired_speed": vehicle.set_desired_speed,
            "set_target_location": set_target_location,
            "get_target_location": get_target_location,
            "set_target_position_ned": lambda n, e, d, yaw: vehicle.set_target_position_ned(
                (n, e, d), yaw
            ),
            "set_target_posvel_ned": set_target_posvel,
            "set_target_velocity_ned": lambda n, e, d: vehicle.set_target_velocity_ned((n, e, d)),
            "position_ned": vehicle.position_ned_m,
            "height_above_home": vehicle.height_above_home_m,
            "velocity_ned": vehicle.velocity_ned_mps,
            "location": location,
            "yaw_rad": lambda: float(vehicle.yaw_rad()),
            "rc_option_position": vehicle.rc_option_position,
            "send_text": vehicle.send_text,
            "send_named_float": vehicle.send_named_float,
            "log_write": log_write,
            "aux_auth_id": vehicle.aux_auth_id,
            "aux_auth_passed": vehicle.aux_auth_passed,
            "aux_auth_failed": vehicle.aux_auth_failed,
            "mavlink_init": inbox.init,
            "mavlink_register": inbox.register,
            "mavlink_receive": inbox.receive,
            "mavlink_send": mavlink_send,
        }


def _float(value: float | None) -> float | None:
    return None if value is None else float(value)


def _text(value: object) -> str:
    return value if isinstance(value, str) else "<error>"


def _to_e7(lat_deg: float, lon_deg: float, alt_m: float) -> tuple[int, int, int]:
    return round(lat_deg * 1e7), round(lon_deg * 1e7), round(alt_m * 100)


def _centimetres(distance_m: float) -> int:
    """Metres as `distance_cm_orient` gives them: float32 times 100, cut off, into 16 bits.

    The autopilot's processor saturates what does not fit and makes 0 of NaN.
    """
    centimetres = c_float(c_float(distance_m).value * 100.0).value
    return 0 if isnan(centimetres) else int(min(max(centimetres, 0.0), 65535.0))
