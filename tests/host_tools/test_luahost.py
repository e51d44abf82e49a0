"""The simulated scripting engine behaves as the autopilot's does: numbers, bindings, limits."""

import enum
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lupa import lua53

from echowing.errors import EchowingError
from echowing.sim.vehicle import luahost
from echowing.sim.vehicle.desk import GOOD, DeskVehicle
from echowing.sim.vehicle.luahost import LuaHost, mavlink_structure, read_bindings
from echowing.sim.vehicle.parameters import Generation


class Bench:
    """Runs pieces of Lua on a vehicle on the desk and collects what they say."""

    def __init__(self, folder: Path) -> None:
        self.vehicle = DeskVehicle({"WP_SPD": 10.0})
        self.script = folder / "piece.lua"

    def host(self, source: str, generation: Generation = Generation.V4_8, **limits: Any) -> LuaHost:
        self.script.write_text(source, encoding="utf-8")
        return LuaHost(self.vehicle, self.script, generation=generation, **limits)

    def run(self, source: str, generation: Generation = Generation.V4_8) -> str | None:
        host = self.host(source, generation)
        host.step(self.vehicle.t_ms)
        return host.error

    def value(
        self, expression: str, generation: Generation = Generation.V4_8, *, prefix: str = ""
    ) -> str:
        error = self.run(f"{prefix}gcs:send_text(6, tostring({expression}))", generation)
        assert error is None, error
        return self.vehicle.texts[-1][1]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


# Numbers


def test_numbers_are_32_bits_wide(bench: Bench) -> None:
    assert bench.value("math.maxinteger") == "2147483647"
    assert bench.value("2147483647 + 1") == "-2147483648"
    assert bench.value("16777216.0 + 1.0 == 16777216.0") == "true"


def test_64_bit_lupa_is_refused_with_the_cure() -> None:
    wide = SimpleNamespace(eval=lambda source: 0x7FFFFFFFFFFFFFFF)
    with pytest.raises(EchowingError, match="make setup"):
        luahost._new_runtime(SimpleNamespace(LuaRuntime=lambda **options: wide))


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("type(millis())", "userdata"),
        ("millis()", "4294967290"),
        ("millis() - 5", "4294967285"),
        ("millis() + 10", "4"),  # wraps as unsigned 32 bits do
        ("millis() > 5", "true"),
        ("uint32_t(3) - uint32_t(5) > uint32_t(2000000000)", "true"),
        ("millis() == millis()", "true"),
        ("millis() == 5", "false"),  # different types are never equal in Lua
        ("(millis() - millis()):toint()", "0"),
        ("millis():toint()", "-6"),  # the same bits, signed
        ("math.type(millis():tofloat())", "float"),
        ("uint32_t(4000000000.0) // 10", "400000000"),
        ("uint32_t(4000000000.0) / uint32_t(3000000000.0)", "1"),
        ("uint32_t(4000000256.0) % 1000", "256"),  # 32-bit floats lie 256 apart up there
        ("uint32_t(12) & 10", "8"),
        ("uint32_t()", "0"),
    ],
)
def test_uint32_userdata(bench: Bench, expression: str, value: str) -> None:
    bench.vehicle.t_ms = 4294967290
    assert bench.value(expression) == value


@pytest.mark.parametrize(
    "expression", ["uint32_t(-1)", "millis() + -1", "millis() - 'x'", "-millis()"]
)
def test_uint32_refuses_what_it_cannot_hold(bench: Bench, expression: str) -> None:
    assert bench.run(f"local x = {expression}") is not None


# Bindings


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("gcs:send_text(nil, 'x')", "bad argument #1 to 'send_text' (number expected, got nil)"),
        ("gcs:send_text(6)", "bad argument #1 to 'send_text' (too few arguments)"),
        ("gcs:send_text(6, 'x', 1)", "bad argument #3 to 'send_text' (too many arguments)"),
        ("gcs:send_text(8, 'x')", "bad argument #1 to 'send_text' (argument out of range)"),
        ("gcs:send_text(1.5, 'x')", "number has no integer representation"),
        ("gcs:send_text(6, {})", "bad argument #2 to 'send_text' (string expected, got table)"),
        ("vehicle.set_desired_speed(3)", "calling 'set_desired_speed' on bad self"),
        ("vehicle:set_target_location(Vector3f())", "Location expected, got Vector3f"),
        ("rangefinder:status_orient(44)", "argument out of range"),
        ("vehicle:nothing()", "attempt to call a nil value (method 'nothing')"),
        ("nothing:at_all()", "attempt to index a nil value (global 'nothing')"),
        ("os.exit()", "attempt to index a nil value (global 'os')"),
        ("Parameter('NONE')", "No such parameter: NONE"),
        ("mavlink:receive_chan()", "RX not initialized"),
        (
            "mavlink:init(5, 1) mavlink:register_rx_msgid(86) mavlink:register_rx_msgid(87)",
            "no reg",
        ),
        ("mavlink:send_chan(-1, 284, 'x')", "argument out of range"),
        ("mavlink:send_chan(0, 16777215, 'x')", "Unknown MAVLink message ID (16777215)"),
        ("mavlink:send_chan(0, 284, ('x'):rep(31))", "31 of 32 bytes of message 284"),
        ("Location().lat = 5", "attempt to treat a userdata as a table"),
        ("for _ in pairs(Location()) do end", "attempt to treat a userdata as a table"),
    ],
)
def test_wrong_calls_are_errors_at_their_line(bench: Bench, source: str, error: str) -> None:
    told = bench.run("\n" + source)
    assert told is not None
    assert told.startswith("scripts/piece.lua:2: ")
    assert error in told


def test_booleans_take_anything_as_on_the_vehicle(bench: Bench) -> None:
    bench.run("vehicle:set_target_pos_NED(Vector3f(), 1, 90, false, 0, false, nil)")
    ((kind, target),) = bench.vehicle.targets
    assert kind == "position"
    assert target == pytest.approx((0.0, 0.0, 0.0, math.pi / 2))


def test_nil_cases(bench: Bench) -> None:
    vehicle = bench.vehicle
    vehicle.place = vehicle.position = vehicle.velocity = None
    vehicle.free_auth_ids = 0
    for call in (
        "param:get('NONE')",
        "ahrs:get_location()",
        "ahrs:get_velocity_NED()",
        "ahrs:get_relative_position_NED_origin()",
        "vehicle:get_target_location()",
        "rc:find_channel_for_option(300)",
        "arming:get_aux_auth_id()",
        "Parameter():get()",
    ):
        assert bench.value(call) == "nil", call
    assert bench.value("param:set('NONE', 1)") == "false"


def test_range_is_metres_or_cut_off_centimetres(bench: Bench) -> None:
    bench.vehicle.ranges[0] = (GOOD, 3.059)
    assert bench.value("rangefinder:distance_cm_orient(0)", Generation.V4_6) == "305"
    assert bench.value("string.format('%.3f', rangefinder:distance_orient(0))") == "3.059"


@pytest.mark.parametrize("generation", [Generation.V4_5, Generation.V4_6])
def test_metres_and_radians_calls_came_with_4_7(bench: Bench, generation: Generation) -> None:
    assert bench.value("rangefinder.distance_orient", generation) == "nil"
    assert bench.value("ahrs.get_yaw_rad", generation) == "nil"
    assert bench.value("rangefinder.distance_orient ~= nil", Generation.V4_7) == "true"
    assert bench.value("vehicle.set_desired_speed ~= nil", generation) == "true"


def test_location_offset_and_distance(bench: Bench) -> None:
    bench.vehicle.place = (60.0, 179.99995, 100.0)
    source = """
        local here = ahrs:get_location()
        local there = here:copy()
        there:offset(3, 0)
        there:lng(-1799999500) -- across the antimeridian
        local d = here:get_distance_NE(there)
        gcs:send_text(6, string.format('%.2f %.2f %.2f', d:x(), d:y(), here:get_distance(there)))
    """
    assert bench.run(source) is None
    north, east, distance = map(float, bench.vehicle.texts[-1][1].split())
    assert north == pytest.approx(3.0, abs=0.02)
    assert east == pytest.approx(1e-4 * 111318.845 * math.cos(math.radians(60)), abs=0.02)
    assert distance == pytest.approx(math.hypot(north, east), abs=0.02)


def test_target_keeps_its_altitude_frame(bench: Bench) -> None:
    bench.vehicle.target = (39.0, -86.0, 12.0, "above_home")
    assert bench.run("vehicle:set_target_location(vehicle:get_target_location())") is None
    kind, (lat, lon, alt, frame) = bench.vehicle.targets[-1]
    assert (kind, frame) == ("location", "above_home")
    assert (lat, lon, alt) == pytest.approx((39.0, -86.0, 12.0))


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ("'ECHOW','a','f',1", "Name must be 4 or less chars long"),
        ("'ECHO','a,b','f',1", "label does not match format"),
        ("'ECHO','a','f',1,2", "format does not match No. of arguments"),
        ("'ECHO','a','f','mm','0',1", "units must be same length as format"),
        ("'ECHO','a','d',1", "d unsupported format"),
        ("'ECHO','a','B',256", "argument out of range"),
        ("'ECHO','a','n','12345'", "too long for n format"),
    ],
)
def test_logger_checks(bench: Bench, arguments: str, error: str) -> None:
    assert error in str(bench.run(f"logger:write({arguments})"))


def test_logger_writes(bench: Bench) -> None:
    assert bench.run("logger:write('ECHO','a,b,c','fBn','m--','0--',1.5,true,'ab')") is None
    assert bench.vehicle.log == [("ECHO", (1.5, 1, "ab"))]


@pytest.mark.parametrize("fault", [ZeroDivisionError, KeyboardInterrupt])
def test_what_goes_wrong_in_the_simulated_vehicle_is_not_swallowed_by_pcall(
    bench: Bench, fault: type[BaseException]
) -> None:
    """Nor is Ctrl-C: a flight went on to its end, as it came within a call of the script."""

    def broken() -> bool:
        raise fault

    bench.vehicle.armed = broken  # type: ignore[method-assign]
    with pytest.raises(fault):
        bench.run("pcall(arming.is_armed, arming)")


def test_annotations_must_agree_with_their_function() -> None:
    with pytest.raises(EchowingError, match="vehicle:fly"):
        read_bindings("---@param a number\nfunction vehicle:fly(a, b) end\n")


# MAVLink


def frame(message_id: int, payload: bytes, system: int = 7) -> bytes:
    head = bytes([0xFD, len(payload), 0, 0, 9, system, 191])
    return head + message_id.to_bytes(3, "little") + payload + b"\x12\x34"


def test_structure_of_a_message_before_and_with_32_bit_system_ids() -> None:
    narrow = mavlink_structure(frame(251, b"abc"), wide_system_id=False)
    wide = mavlink_structure(frame(251, b"abc"), wide_system_id=True)
    assert (len(narrow), len(wide)) == (291, 299)
    assert narrow[:3] == b"\x12\x34\xfd"
    assert (narrow[7], narrow[9:12], narrow[12:16]) == (7, b"\xfb\0\0", b"abc\0")
    assert (wide[7:11], wide[12:15], wide[15:19]) == (b"\7\0\0\0", b"\xfb\0\0", b"abc\0")


def test_structure_of_a_mavlink_1_message() -> None:
    old = bytes([0xFE, 2, 5, 7, 1, 30]) + b"xy" + b"\x12\x34"
    structure = mavlink_structure(old, wide_system_id=False)
    assert structure[:12] == b"\x12\x34\xfe\x02\0\0\x05\x07\x01\x1e\0\0"
    assert structure[12:15] == b"xy\0"


def test_only_registered_messages_arrive_and_the_queue_has_an_end(bench: Bench) -> None:
    host = bench.host(
        """
        mavlink:init(2, 1)
        gcs:send_text(6, tostring(mavlink:register_rx_msgid(251)))
        gcs:send_text(6, tostring(mavlink:register_rx_msgid(251)))
        local function update()
            local message, link, at = mavlink:receive_chan()
            local first = message and string.byte(message, 16)
            gcs:send_text(6, tostring(first) .. ' ' .. tostring(link) .. ' ' .. tostring(at))
            return update, 10
        end
        return update, 10
        """
    )
    host.step(0)
    vehicle = bench.vehicle
    for number in (1, 2, 3):
        vehicle.inbox.append((frame(251, bytes([number])), 4))
        vehicle.inbox.append((frame(86, b"\0"), 4))
    for t_ms in (10, 20, 30):
        host.step(t_ms)
    assert host.error is None
    assert [text for _, text in vehicle.texts] == [
        "true",
        "false",
        "1 4 10",
        "2 4 10",
        "nil nil nil",
    ]


def test_messages_are_sent_by_a_link_that_is_there_and_has_room(bench: Bench) -> None:
    """Any bytes, also those that are no text; of more than the message has, the first."""
    send = "mavlink:send_chan({}, 251, ('\\xff\\0'):rep(9) .. 'more')"
    assert bench.value(send.format(1)) == "true"
    assert bench.vehicle.sent == [(1, 251, b"\xff\0" * 9)]
    assert bench.value(send.format(2)) == "nil"
    bench.vehicle.has_room = False
    assert bench.value(send.format(0)) == "false"
    assert len(bench.vehicle.sent) == 1


# What the vehicle's Lua refuses and a stock one takes

SECOND = "local function select_second(_, value) return value end\n"


def locals_of(count: int, name: str = "a") -> str:
    """So many declarations, a line each."""
    return "".join(f"local {name}{i} = {i}\n" for i in range(1, count + 1))


def function_with_locals(count: int) -> str:
    return f"local function f()\n{locals_of(count)}end\nf()"


def function_with_upvalues(count: int) -> str:
    """A function in a function: no single one may have more than 100 locals to lend."""
    used = [f"a{i}" for i in range(1, 91)] + [f"b{i}" for i in range(1, count - 89)]
    inner = f"return function()\nreturn {' + '.join(used)}\nend"
    return f"{locals_of(90)}local function f()\n{locals_of(count - 90, 'b')}{inner}\nend\nf()()"


def numeric_loop(count: int) -> str:
    """A numeric loop has three hidden variables besides its own."""
    return f"{locals_of(count - 4)}for i = 1, 2 do uint32_t(i) end"


@pytest.mark.parametrize(
    "source",
    [
        locals_of(100),
        function_with_locals(100),
        f"{locals_of(99)}do local b = 1 end do local c = 2 end",  # one after the other
        function_with_upvalues(127),
        numeric_loop(100),
    ],
)
def test_a_script_at_the_vehicles_limits_runs(bench: Bench, source: str) -> None:
    assert bench.run(source) is None


# The words, lines and tokens are what ArduPilot's own Lua says to these scripts.
@pytest.mark.parametrize(
    ("source", "error"),
    [
        (locals_of(101), "101: too many local variables (limit is 100) in main function near '='"),
        (
            "local " + ", ".join(f"a{i}" for i in range(101)),
            "1: too many local variables (limit is 100) in main function near <eof>",
        ),
        (
            f"{locals_of(100)}local function g()\nend",
            "101: too many local variables (limit is 100) in main function near '('",
        ),
        (
            function_with_locals(101),
            "102: too many local variables (limit is 100) in function at line 1 near '='",
        ),
        (
            f"local function f({', '.join(f'a{i}' for i in range(101))}) end",
            "1: too many local variables (limit is 100) in function at line 1 near ')'",
        ),
        (
            numeric_loop(101),
            "98: too many local variables (limit is 100) in main function near '='",
        ),
        (
            function_with_upvalues(128),
            "132: too many upvalues (limit is 127) in function at line 130 near 'end'",
        ),
    ],
)
def test_a_script_beyond_the_vehicles_limits_does_not_load(
    bench: Bench, source: str, error: str
) -> None:
    assert bench.run(source) == f"Error: scripts/piece.lua:{error}"
    assert bench.vehicle.texts == [(2, f"Lua: Error: scripts/piece.lua:{error}")]


def test_limits_hold_for_what_a_script_loads_and_requires(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "long.lua").write_text(locals_of(101))
    limit = "101: too many local variables (limit is 100) in main function near '='"
    assert bench.value(f"select_second(load([[{locals_of(101)}]], '=long'))", prefix=SECOND) == (
        f"long:{limit}"
    )
    assert f"scripts/modules/long.lua:{limit}" in str(bench.run("require('long')"))


GLOBALS = (
    *("assert", "error", "ipairs", "load", "next", "pairs", "pcall", "setmetatable"),
    *("tonumber", "tostring", "type", "require", "math", "string", "table", "io"),
)
NO_GLOBALS = (
    *("select", "print", "xpcall", "getmetatable", "rawget", "rawset", "rawequal", "rawlen"),
    *("collectgarbage", "loadfile", "_G", "_VERSION", "os", "coroutine", "debug", "utf8"),
    *("package", "dofile", "bit32", "string.dump", "('x').dump", "io.popen", "python"),
)


@pytest.mark.parametrize("name", GLOBALS)
def test_the_vehicles_globals_are_there(bench: Bench, name: str) -> None:
    assert bench.value(f"{name} ~= nil") == "true"


@pytest.mark.parametrize("name", NO_GLOBALS)
def test_other_globals_are_not(bench: Bench, name: str) -> None:
    assert bench.value(name) == "nil"


def test_a_global_the_vehicle_lacks_stops_the_script_with_its_words(bench: Bench) -> None:
    error = bench.run("local n = select('#', 1)")
    assert error == "scripts/piece.lua:1: attempt to call a nil value (global 'select')"


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("load('return 7')()", "7"),
        ("load(7)", "nil"),
        ("load('return math')()", "nil"),  # without an environment it has no globals
        ("load('return math', 'x', 't', {math = 5})()", "5"),
        ("select_second(load('x = = 1', '=x'))", "x:1: unexpected symbol near '='"),
        (
            "select_second(load('return 1', 'x', 'b'))",
            "attempt to load a text chunk (mode is 'b')",
        ),
        (  # bytecode
            r"select_second(load('\27LuaS', '=x'))",
            r"x:1: unexpected symbol near '<\27>'",
        ),
        ("select_second(pcall(load, {})):match('%(.*')", "(function expected, got table)"),
    ],
)
def test_load_takes_text_only(bench: Bench, expression: str, value: str) -> None:
    assert bench.value(expression, prefix=SECOND) == value


def test_load_takes_a_function_that_returns_pieces(bench: Bench) -> None:
    pieces = "local n = 0\nlocal function piece() n = n + 1 return ({'ret', 'urn 7'})[n] end\n"
    assert bench.value("load(piece)()", prefix=pieces) == "7"


def test_require_runs_a_module_once(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "one.lua").write_text("gcs:send_text(6, 'once') return {5}")
    assert bench.value("require('one')[1] + require('one')[1]") == "10"
    assert [text for _, text in bench.vehicle.texts] == ["once", "10"]
    assert "module 'two' not found" in str(bench.run("require('two')"))


def test_a_script_need_not_be_utf_8(bench: Bench) -> None:
    host = bench.host("")
    bench.script.write_bytes(b"gcs:send_text(6, 'ready') -- 20 \xb0C")
    host = LuaHost(bench.vehicle, bench.script, generation=Generation.V4_8)
    host.step(0)
    assert (host.error, bench.vehicle.texts) == (None, [(6, "ready")])


# Life and death of a script


def test_runs_when_due_counted_from_the_start_of_the_run(bench: Bench) -> None:
    host = bench.host(
        "function u() gcs:send_text(6, tostring(millis())) return u, 45 end return u()"
    )
    for t_ms in range(0, 200, 20):
        bench.vehicle.t_ms = t_ms
        host.step(t_ms)
    assert [text for _, text in bench.vehicle.texts] == ["0", "60", "120", "180"]


def test_a_script_may_end_itself(bench: Bench) -> None:
    host = bench.host("gcs:send_text(6, 'once')")
    host.step(0)
    host.step(1000)
    assert (host.running, host.error, len(bench.vehicle.texts)) == (False, None, 1)


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("local x = nil x.y = 1", "attempt to index a nil value"),
        ("error({})", "<error>"),
        ("x = = 1", "unexpected symbol"),
        ("return 1, 2, 3", "returned bad result count (3)"),
        ("return function() end, 'soon'", "did not return a delay"),
        ("return function() end, true", "did not return a delay"),
        ("return 5, 5", "did not return a function"),
        ("while true do end", "exceeded time limit"),
        ("while true do pcall(function() while true do end end) end", "exceeded time limit"),
    ],
)
def test_an_error_stops_the_script_and_is_told(bench: Bench, source: str, error: str) -> None:
    host = bench.host(source)
    host.step(0)
    host.step(1000)
    assert not host.running
    assert error in str(host.error)
    assert bench.vehicle.texts == [(2, f"Lua: {host.error}")]


def test_running_out_of_heap_is_beyond_pcall(bench: Bench) -> None:
    source = """
        local kept = {}
        while true do
            pcall(function()
                for i = 1, 100000 do kept[#kept + 1] = tostring(i) .. string.rep('x', 50) end
            end)
            gcs:send_text(6, 'survived')
        end
    """
    host = bench.host(source, instruction_limit=1_000_000_000)
    host.step(0)
    assert host.error == "not enough memory"
    assert bench.vehicle.texts == [(2, "Lua: not enough memory")]


def test_instruction_limit_counts_anew_each_run(bench: Bench) -> None:
    host = bench.host("function u() for _ = 1, 4000 do end return u, 10 end return u, 10")
    for t_ms in range(0, 100, 10):
        host.step(t_ms)
    assert host.error is None


def test_instructions_are_counted_exactly(bench: Bench) -> None:
    host = bench.host(
        "function u() for _ = 1, N do end return u, 10 end N = 10 return u, 10",
        count_instructions=True,
    )
    counts = []
    for t_ms in (0, 10):
        host.step(t_ms)
        counts.append(host.instructions)
    # ten turns of the loop, what sets it up, and the return of two values
    assert 10 < counts[1] < 30
    assert counts[1] != counts[0]


def test_a_missing_script_says_so(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match=r"nowhere\.lua"):
        LuaHost(bench.vehicle, tmp_path / "nowhere.lua", generation=Generation.V4_8)


def test_generation_names_are_versions() -> None:
    assert issubclass(Generation, enum.Enum)
    assert {g.name for g in Generation} >= {"V4_5", "V4_6", "V4_7", "V4_8"}
    assert lua53.LuaRuntime().lua_version == (5, 3)
