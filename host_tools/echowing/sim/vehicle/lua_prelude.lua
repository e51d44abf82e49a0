-- The Lua half of the simulated autopilot's scripting: what ArduPilot keeps in C.
--
-- Userdata are tables in disguise: they answer "userdata" to the script's type(), and cannot be walked or written to.
-- Number behaviour, coercions and error texts follow libraries/AP_Scripting/lua_boxed_numerics.cpp, lua_bindings.cpp and
-- the code that generator/src/main.c writes. Called by echowing.sim.vehicle.luahost, which passes the vehicle as `py`, a table of
-- functions.
-- luacheck: std lua53

local py, script_source = ...

local KEY = {} -- where a disguised userdata keeps its value; no script can name this key
local TRUE_TYPE, MATH_TYPE, SELECT, META = type, math.type, select, getmetatable
local METRES_PER_LATLNG = 0.011131884502145034 -- 1e-7 degrees of latitude, AP_Common/Location.h

local classes = {} -- class name -> class, metatable -> class

local function class_of(value)
    return classes[META(value)]
end

local function type_name(value)
    local class = class_of(value)
    return class and class.display or TRUE_TYPE(value)
end

-- An error at the script's line that made the call, as luaL_error gives it.
local function fail(text)
    local level = 2
    local info = debug.getinfo(level, 'Sl')
    while info and info.source ~= script_source do
        level = level + 1
        info = debug.getinfo(level, 'Sl')
    end
    error(info and string.format('%s:%d: %s', info.short_src, info.currentline, text) or text, 0)
end

local function refuse()
    fail('attempt to treat a userdata as a table')
end

-- A class of disguised userdata, or the one object of a singleton.
local function new_class(name)
    local class = { display = name, methods = {} }
    local meta = { __index = class.methods, __newindex = refuse, __pairs = refuse, __len = refuse, __name = name }
    class.meta = meta
    class.new = function(value) return setmetatable({ [KEY] = value }, meta) end
    classes[name], classes[meta] = class, class
    return class
end

local function shadow_type(value)
    return class_of(value) and 'userdata' or TRUE_TYPE(value)
end

-- Argument checks
local check = {}

local function bad_argument(position, name, text)
    fail(string.format("bad argument #%d to '%s' (%s)", position, name, text))
end

local function wrong_type(position, name, wanted, value)
    bad_argument(position, name, wanted .. ' expected, got ' .. (value == nil and 'nil' or type_name(value)))
end

function check.arity(given, least, name)
    bad_argument(given, name, given < least and 'too few arguments' or 'too many arguments')
end

function check.self(value, wanted, name)
    if class_of(value) ~= wanted then
        fail(string.format("calling '%s' on bad self", name))
    end
end

local function to_number(value)
    local kind = TRUE_TYPE(value)
    return (kind == 'number' or kind == 'string') and tonumber(value) or nil
end

function check.number(value, position, name, low, high)
    local number = to_number(value)
    if not number then wrong_type(position, name, 'number', value) end
    if low and not (number >= low and number <= high) then bad_argument(position, name, 'argument out of range') end
    return number + 0.0
end

function check.integer(value, position, name, low, high)
    local number = to_number(value)
    if not number then wrong_type(position, name, 'number', value) end
    local integer = math.tointeger(number)
    if not integer then bad_argument(position, name, 'number has no integer representation') end
    if low and (integer < low or integer > high) then bad_argument(position, name, 'argument out of range') end
    return integer
end

function check.string(value, position, name)
    local kind = TRUE_TYPE(value)
    if kind ~= 'string' and kind ~= 'number' then wrong_type(position, name, 'string', value) end
    return tostring(value)
end

function check.boolean(value)
    return not not value -- as lua_toboolean: anything will do
end

function check.any(value)
    return value
end

function check.userdata(value, position, name, class)
    if class_of(value) ~= classes[class] then wrong_type(position, name, class, value) end
    return value
end

-- uint32_t: kept as the 32 bits of a Lua integer.
local u32 = new_class('uint32_t')

local function to_u32(value, position)
    if META(value) == u32.meta then return value[KEY] end
    local number = to_number(value)
    local integer = number and math.tointeger(number)
    if integer and integer >= 0 then return integer end
    if number and number >= 0 and number <= 4294967295.0 then
        number = number // 1
        return math.tointeger(number < 2147483648.0 and number or number - 4294967296.0) or 0
    end
    fail(string.format('bad argument #%d (Unable to coerce to uint32_t)', position))
end

local function u32_operator(event, operate)
    u32.meta[event] = function(a, b) return u32.new(operate(to_u32(a, 1), to_u32(b, 2))) end
end

local function unsigned_divide(a, b)
    if b == 0 then fail("attempt to perform 'n//0'") end
    if b < 0 then return math.ult(a, b) and 0 or 1 end
    if a >= 0 then return a // b end
    local quotient = ((a >> 1) // b) << 1
    return math.ult(a - quotient * b, b) and quotient or quotient + 1
end

u32_operator('__add', function(a, b) return a + b end)
u32_operator('__sub', function(a, b) return a - b end)
u32_operator('__mul', function(a, b) return a * b end)
u32_operator('__div', unsigned_divide)
u32_operator('__idiv', unsigned_divide)
u32_operator('__mod', function(a, b) return a - unsigned_divide(a, b) * b end)
u32_operator('__band', function(a, b) return a & b end)
u32_operator('__bor', function(a, b) return a | b end)
u32_operator('__bxor', function(a, b) return a ~ b end)
u32_operator('__shl', function(a, b) return a << b end)
u32_operator('__shr', function(a, b) return a >> b end)
u32.meta.__bnot = function(a) return u32.new(~to_u32(a, 1)) end
u32.meta.__eq = function(a, b) return to_u32(a, 1) == to_u32(b, 2) end
u32.meta.__lt = function(a, b) return math.ult(to_u32(a, 1), to_u32(b, 2)) end
u32.meta.__le = function(a, b) return not math.ult(to_u32(b, 2), to_u32(a, 1)) end

local function u32_float(bits)
    return bits >= 0 and bits + 0.0 or bits + 4294967296.0
end

u32.meta.__tostring = function(a)
    local bits = a[KEY]
    if bits >= 0 then return tostring(bits) end
    local tens = unsigned_divide(bits, 10)
    return tostring(tens) .. tostring(bits - tens * 10)
end

-- raw[owner][name]: what a call does once its arguments are checked. Methods of userdata get the object first.
local raw = { [''] = {}, uint32_t_ud = {}, Vector3f_ud = {}, Vector2f_ud = {}, Location_ud = {}, Parameter_ud = {},
    RC_Channel_ud = {}, RangeFinder_State_ud = {}, AP_RangeFinder_Backend_ud = {}, param = {}, vehicle = {}, ahrs = {},
    rangefinder = {}, rc = {}, arming = {}, gcs = {},
    mavlink = {}, logger = {} }

raw[''].uint32_t = function(value) return u32.new(value == nil and 0 or to_u32(value, 1)) end
raw[''].millis = function() return u32.new(py.millis()) end
raw[''].micros = function() return u32.new(py.micros()) end
raw.uint32_t_ud.toint = function(self) return self[KEY] end
raw.uint32_t_ud.tofloat = function(self) return u32_float(self[KEY]) end

-- Vectors and places: the value is a table of fields.
local function field(owner, name)
    raw[owner][name] = function(self, value)
        if value == nil then return self[KEY][name] end
        self[KEY][name] = value
    end
end

local function add_fields(owner, names)
    for _, name in ipairs(names) do field(owner, name) end
end

local v3, v2 = new_class('Vector3f'), new_class('Vector2f')
add_fields('Vector3f_ud', { 'x', 'y', 'z' })
add_fields('Vector2f_ud', { 'x', 'y' })

local function vector3(x, y, z) return v3.new({ x = x + 0.0, y = y + 0.0, z = z + 0.0 }) end
local function vector2(x, y) return v2.new({ x = x + 0.0, y = y + 0.0 }) end

raw[''].Vector3f = function() return vector3(0, 0, 0) end
raw[''].Vector2f = function() return vector2(0, 0) end
raw.Vector3f_ud.length = function(self)
    local v = self[KEY]
    return (v.x * v.x + v.y * v.y + v.z * v.z) ^ 0.5
end
raw.Vector2f_ud.length = function(self)
    local v = self[KEY]
    return (v.x * v.x + v.y * v.y) ^ 0.5
end

local place = new_class('Location')
add_fields('Location_ud', { 'lat', 'lng', 'alt', 'relative_alt', 'terrain_alt', 'origin_alt' })

-- frame: 'absolute', 'above_home', 'above_origin' or 'above_terrain'
local function location(lat, lng, alt, frame)
    return place.new({
        lat = lat, lng = lng, alt = alt, relative_alt = frame ~= 'absolute', terrain_alt = frame == 'above_terrain',
        origin_alt = frame == 'above_origin',
    })
end

local function frame_of(p)
    if p.terrain_alt then return 'above_terrain' end
    if p.origin_alt then return 'above_origin' end
    return p.relative_alt and 'above_home' or 'absolute'
end

local function longitude_scale(lat)
    return math.max(math.cos(math.rad(lat * 1e-7)), 0.01)
end

-- The short way round, without leaving 32 bits: near the antimeridian both are counted from there.
local function longitude_difference(from, to)
    if math.abs(from) < 900000000 then return to - from end
    local function turned(lng) return lng > 0 and lng - 1800000000 or lng + 1800000000 end
    return turned(to) - turned(from)
end

local function distance_ne(from, to)
    local middle = from.lat + (to.lat - from.lat) // 2
    local east = longitude_difference(from.lng, to.lng)
    return (to.lat - from.lat) * METRES_PER_LATLNG, east * METRES_PER_LATLNG * longitude_scale(middle)
end

raw[''].Location = function() return location(0, 0, 0, 'absolute') end
raw.Location_ud.offset = function(self, north_m, east_m)
    local p = self[KEY]
    local middle = p.lat
    p.lat = p.lat + math.tointeger((north_m / METRES_PER_LATLNG + 0.5) // 1)
    p.lng = p.lng + math.tointeger((east_m / (METRES_PER_LATLNG * longitude_scale(middle)) + 0.5) // 1)
end
raw.Location_ud.get_distance_NE = function(self, other) return vector2(distance_ne(self[KEY], other[KEY])) end
raw.Location_ud.get_distance_NED = function(self, other)
    local north, east = distance_ne(self[KEY], other[KEY])
    return vector3(north, east, (self[KEY].alt - other[KEY].alt) * 0.01)
end
raw.Location_ud.get_distance = function(self, other)
    local north, east = distance_ne(self[KEY], other[KEY])
    return (north * north + east * east) ^ 0.5
end
raw.Location_ud.copy = function(self)
    local copy = {}
    for key, value in pairs(self[KEY]) do copy[key] = value end
    return place.new(copy)
end

-- Parameters
local parameter = new_class('Parameter')
raw[''].Parameter = function(name)
    if name and py.parameter_get(name) == nil then fail('No such parameter: ' .. name) end
    return parameter.new({ name = name })
end
raw.Parameter_ud.init = function(self, name)
    if py.parameter_get(name) == nil then return false end
    self[KEY].name = name
    return true
end
raw.Parameter_ud.get = function(self)
    local name = self[KEY].name
    if name then return py.parameter_get(name) end
    return nil
end
raw.Parameter_ud.set = function(self, value)
    local name = self[KEY].name
    return name ~= nil and py.parameter_set(name, value)
end
raw.Parameter_ud.set_and_save = function(self, value)
    local name = self[KEY].name
    return name ~= nil and py.parameter_save(name, value)
end
raw.param.get, raw.param.set, raw.param.set_and_save = py.parameter_get, py.parameter_set, py.parameter_save
raw.param.add_table, raw.param.add_param = py.parameter_add_table, py.parameter_add

-- The vehicle and its estimate
local function position_ned(vector) return vector[KEY].x, vector[KEY].y, vector[KEY].z end

raw.vehicle.get_mode, raw.vehicle.get_likely_flying = py.mode_number, py.flying
raw.vehicle.set_desired_speed = py.set_desired_speed
raw.vehicle.set_target_location = function(target)
    local p = target[KEY]
    return py.set_target_location(p.lat, p.lng, p.alt, frame_of(p))
end
raw.vehicle.get_target_location = function()
    local lat, lng, alt, frame = py.get_target_location()
    return lat and location(lat, lng, alt, frame)
end
raw.vehicle.set_target_pos_NED = function(position, use_yaw, yaw_deg)
    local n, e, d = position_ned(position)
    return py.set_target_position_ned(n, e, d, use_yaw and math.rad(yaw_deg) or nil)
end
raw.vehicle.set_target_posvel_NED = function(position, velocity)
    local n, e, d = position_ned(position)
    return py.set_target_posvel_ned(n, e, d, position_ned(velocity))
end
raw.vehicle.set_target_posvelaccel_NED = function(position, velocity, acceleration, use_yaw, yaw_deg, use_rate, degs)
    local n, e, d = position_ned(position)
    local vn, ve, vd = position_ned(velocity)
    local an, ae, ad = position_ned(acceleration)
    local yaw, rate = use_yaw and math.rad(yaw_deg) or nil, use_yaw and use_rate and math.rad(degs) or 0.0
    return py.set_target_posvel_ned(n, e, d, vn, ve, vd, yaw, rate, an, ae, ad)
end
raw.vehicle.set_target_velocity_NED = function(velocity)
    return py.set_target_velocity_ned(position_ned(velocity))
end

local function optional_vector3(x, y, z) return x and vector3(x, y, z) end

raw.ahrs.get_location = function()
    local lat, lng, alt = py.location()
    return lat and location(lat, lng, alt, 'absolute')
end
raw.ahrs.get_yaw, raw.ahrs.get_yaw_rad = py.yaw_rad, py.yaw_rad
raw.ahrs.get_velocity_NED = function() return optional_vector3(py.velocity_ned()) end
raw.ahrs.groundspeed_vector = function()
    local n, e = py.velocity_ned()
    return vector2(n or 0, e or 0)
end
raw.ahrs.get_relative_position_D_home = function() return -py.height_above_home() end
raw.ahrs.get_relative_position_NED_origin = function() return optional_vector3(py.position_ned()) end

raw.rangefinder.num_sensors, raw.rangefinder.has_orientation = py.rangefinder_count, py.rangefinder_has
raw.rangefinder.status_orient = py.rangefinder_status
raw.rangefinder.has_data_orient = function(orientation) return py.rangefinder_status(orientation) > 1 end
raw.rangefinder.distance_orient = py.rangefinder_distance_m
raw.rangefinder.distance_cm_orient = py.rangefinder_distance_cm
raw.rangefinder.signal_quality_pct_orient = py.rangefinder_quality

-- A backend keeps the number of its sensor. py.rangefinder_backend: orientation, type, status, distance, time read.
local backend, range_state = new_class('AP_RangeFinder_Backend'), new_class('RangeFinder_State')
raw.rangefinder.get_backend = function(number)
    return py.rangefinder_backend(number) and backend.new(number)
end
for nth, name in ipairs({ 'orientation', 'type', 'status', 'distance' }) do
    raw.AP_RangeFinder_Backend_ud[name] = function(self)
        return (SELECT(nth, py.rangefinder_backend(self[KEY])))
    end
end
raw.AP_RangeFinder_Backend_ud.get_state = function(self)
    return range_state.new((SELECT(5, py.rangefinder_backend(self[KEY]))))
end
raw.RangeFinder_State_ud.last_reading = function(self) return u32.new(self[KEY]) end

local channel = new_class('RC_Channel')
raw.rc.find_channel_for_option = function(option)
    return py.rc_option_position(option) and channel.new({ option = option })
end
raw.RC_Channel_ud.get_aux_switch_pos = function(self) return py.rc_option_position(self[KEY].option) or 0 end
raw.rc.get_aux_cached = py.rc_option_position

raw.arming.is_armed, raw.arming.get_aux_auth_id = py.armed, py.aux_auth_id
raw.arming.set_aux_auth_passed, raw.arming.set_aux_auth_failed = py.aux_auth_passed, py.aux_auth_failed
raw.gcs.send_text, raw.gcs.send_named_float = py.send_text, py.send_named_float

raw.mavlink.init = py.mavlink_init
raw.mavlink.register_rx_msgid = function(message_id)
    local done = py.mavlink_register(message_id)
    if done == nil then fail('no registrations free') end
    return done
end
raw.mavlink.receive_chan = function()
    local message, link, time_ms = py.mavlink_receive()
    if message == false then fail('RX not initialized') end
    if message then return message, link, u32.new(time_ms) end
end
raw.mavlink.send_chan = function(link, message_id, payload)
    local sent, trouble = py.mavlink_send(link, message_id, payload:byte(1, -1))
    if trouble then fail(trouble) end
    return sent
end

-- logger: the one call with a free number of arguments. `width` by format letter; nil: scripts may not write it.
local INTEGER_SPAN = { b = { -128, 127 }, h = { -32768, 32767 }, c = { -32768, 32767 }, H = { 0, 65535 },
    C = { 0, 65535 }, B = { 0, 255 }, M = { 0, 255 }, i = {}, L = {}, e = {} }
local TEXT_WIDTH = { n = 4, N = 16, Z = 64 }

local function log_value(letter, value, position)
    local span = INTEGER_SPAN[letter]
    if TRUE_TYPE(value) == 'boolean' and (letter == 'B' or letter == 'M') then return value and 1 or 0 end
    if span then return check.integer(value, position, 'write', span[1], span[2]) end
    if letter == 'f' then return check.number(value, position, 'write') end
    if letter == 'I' or letter == 'E' or letter == 'Q' then return u32_float(to_u32(value, position)) end
    local width = TEXT_WIDTH[letter]
    if not width then fail(letter .. ' unsupported format') end
    local text = check.string(value, position, 'write')
    if #text > width then fail(string.format('arg %d too long for %s format', position, letter)) end
    return text
end

raw.logger.write = function(name, labels, format, ...)
    if #name > 4 then fail('Name must be 4 or less chars long') end
    if #labels > 57 then fail('labels must be less than 58 chars long') end
    if #format > 14 then fail('format must be less than 15 chars long') end
    local _, commas = labels:gsub(',', '')
    local rest = { ... }
    local given = SELECT('#', ...)
    if commas + 1 ~= #format then fail('label does not match format') end
    local units, multipliers, first
    if given == #format + 2 then
        units, multipliers, first = check.string(rest[1], 4, 'write'), check.string(rest[2], 5, 'write'), 2
        if #units ~= #format then fail('units must be same length as format') end
        if #multipliers ~= #format then fail('multipliers must be same length as format') end
    elseif given == #format then
        first = 0
    else
        fail('format does not match No. of arguments')
    end
    local values = {}
    for i = 1, #format do values[i] = log_value(format:sub(i, i), rest[first + i], first + i + 3) end
    py.log_write(name, labels, format, units or '', multipliers or '', values)
end

-- Script-side globals: ArduPilot's sandbox (create_sandbox in lua_scripts.cpp, base_funcs in lua/src/lbaselib.c).
local exhausted = false

-- Running out of heap ends a script on the vehicle whatever it wraps itself in.
local function survive(ok, first, ...)
    if not ok and first == 'not enough memory' then
        exhausted = true
        debug.sethook(function() error('not enough memory', 0) end, '', 1)
        error('not enough memory', 0)
    end
    return ok, first, ...
end

rawset(string, 'dump', nil) -- from what strings themselves offer, too

local sandbox = {
    assert = assert, error = error, ipairs = ipairs, next = next, pairs = pairs, setmetatable = setmetatable,
    tonumber = tonumber, tostring = tostring, type = shadow_type,
    pcall = function(...) return survive(pcall(...)) end,
    math = math, string = string, table = table,
    io = {
        close = io.close, flush = io.flush, input = io.input, lines = io.lines, open = io.open, output = io.output,
        read = io.read, type = io.type, write = io.write,
    },
}

-- A text that keeps to the vehicle's limits as a function; nil and the error as the vehicle's compiler words it.
local function compile(source, chunk_name, environment)
    if source:byte() == 27 then -- the vehicle's Lua knows no bytecode: to it, that is a text with a strange first sign
        source = '\1' .. source:sub(2)
    end
    local chunk, problem = load(source, chunk_name, 't', environment)
    if not chunk then return nil, (problem:gsub("near '<\\1>'", "near '<\\27>'", 1)) end
    if source:find('[\128-\255]') then source = source:gsub('[\128-\255]', '?') end -- other signs count nowhere
    local excess = py.refusal(source, debug.getinfo(chunk, 'S').short_src)
    if excess then return nil, excess end
    return chunk
end

-- The pieces of a text that a function returns one by one.
local function joined(reader)
    local pieces = {}
    for piece in reader do
        if piece == '' then break end
        pieces[#pieces + 1] = piece
    end
    return table.concat(pieces)
end

local NO_GLOBALS = {} -- where a chunk runs that is given no environment: not the script's, as on the vehicle

function sandbox.load(source, chunk_name, mode, ...)
    if TRUE_TYPE(source) == 'function' then
        source, chunk_name = joined(source), chunk_name or '=(load)'
    elseif TRUE_TYPE(source) == 'string' or TRUE_TYPE(source) == 'number' then
        source = tostring(source)
    else
        bad_argument(1, 'load', 'function expected, got ' .. type_name(source))
    end
    if mode and not mode:find('t', 1, true) then
        return nil, string.format("attempt to load a text chunk (mode is '%s')", mode)
    end
    local environment = NO_GLOBALS
    if SELECT('#', ...) > 0 then environment = ... end
    return compile(source, chunk_name or source, environment)
end

local modules = {}

-- A file of the folder "modules" beside the script, run once, with the script's globals.
function sandbox.require(name)
    check.string(name, 1, 'require')
    if modules[name] then return modules[name] end
    local path, source = py.module(name)
    if not source then fail(string.format("module '%s' not found:\n\tno file '%s'", name, path)) end
    local chunk, problem = compile(source, '@' .. path, sandbox)
    if not chunk then fail(string.format("error loading module '%s' from file '%s':\n\t%s", name, path, problem)) end
    local value = chunk(name, path)
    modules[name] = value == nil or value
    return modules[name]
end

local function owner_table(owner)
    if owner == '' then return sandbox, nil end
    local class = classes[owner:match('^(.*)_ud$')] or classes[owner]
    if class then return class.methods, class end
    class = new_class(owner)
    class.only = class.new({})
    sandbox[owner] = class.only
    return class.methods, class
end

-- Adds one checked call. `source` is what luahost wrote from the annotations.
local host = {}
local offered = { math_type = MATH_TYPE, meta = META, select = SELECT, type = TRUE_TYPE, classes = classes }

function host.bind(owner, name, source)
    local methods, class = owner_table(owner)
    local call = raw[owner] and raw[owner][name]
    if not call then error('no implementation of ' .. owner .. ':' .. name) end
    methods[name] = load(source, '=bindings', 't', offered)(call, check, class)
end

function host.load(source, chunk_name)
    return compile(source, chunk_name, sandbox)
end

function host.out_of_memory() return exhausted end

-- The count hook: once over the limit every further instruction fails, so no pcall of the script can swallow it.
function host.new_limit()
    local over = false
    local function stop()
        over = true
        debug.sethook(stop, '', 1)
        error('Exceeded CPU time', 0)
    end
    return stop, function() over = false end, function() return over end
end

-- A local of the script by its name, reached through the functions that use it and the tables that hold them.
function host.find(start, name)
    local seen, queue = { [sandbox] = true }, { start }
    local function later(value)
        local kind = TRUE_TYPE(value)
        if (kind == 'function' or kind == 'table') and not seen[value] then
            seen[value], queue[#queue + 1] = true, value
        end
    end
    while #queue > 0 do
        local one = table.remove(queue)
        if TRUE_TYPE(one) == 'table' then
            for _, value in next, one do later(value) end
        else
            local i, upvalue_name, upvalue = 1, debug.getupvalue(one, 1)
            while upvalue_name do
                if upvalue_name == name then return upvalue end
                later(upvalue)
                i = i + 1
                upvalue_name, upvalue = debug.getupvalue(one, i)
            end
        end
    end
end

-- Counts the script's own instructions, one by one: slow, for measuring only.
function host.new_counter(chunk_name)
    local count = 0
    local function tick()
        if debug.getinfo(2, 'S').source == chunk_name then count = count + 1 end
    end
    return tick, function() count = 0 end, function() return count end
end

return host
