-- luacheck's settings for the applets: luacheck --config lua/.luacheckrc lua
std = "vehicle"
max_line_length = 120
max_comment_line_length = false -- a parameter's description is one line, as ArduPilot's tools read it

-- What ArduPilot's Lua has of a stock one (host_tools/echowing/sim/vehicle/lua_prelude.lua, `sandbox`).
stds.vehicle = {
    globals = { -- an applet may give these back
        'package', 'require',
        math = { other_fields = true }, table = { other_fields = true }, io = { other_fields = true },
        string = {
            fields = {
                'byte', 'char', 'find', 'format', 'gmatch', 'gsub', 'len', 'lower', 'match', 'pack', 'packsize', 'rep',
                'reverse', 'sub', 'unpack', 'upper',
            },
        },
    },
    read_globals = {
        'assert', 'error', 'ipairs', 'load', 'next', 'pairs', 'pcall', 'setmetatable', 'tonumber', 'tostring', 'type',
    },
}

-- ArduPilot's bindings in use; their arguments and results: host_tools/echowing/sim/vehicle/lua_bindings.lua
read_globals = {
    "ahrs", "arming", "gcs", "logger", "mavlink", "millis", "param", "Parameter", "rangefinder", "rc", "vehicle",
    "Vector3f",
}
