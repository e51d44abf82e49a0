-- luacheck's settings for the applets: luacheck --config lua/.luacheckrc lua
std = "lua53"
max_line_length = 120
max_comment_line_length = false -- a parameter's description is one line, as ArduPilot's tools read it

-- ArduPilot's bindings in use; their arguments and results: host_tools/echowing/sim/lua_bindings.lua
read_globals = {
    "ahrs", "arming", "gcs", "logger", "mavlink", "millis", "param", "Parameter", "rangefinder", "rc", "vehicle",
    "Vector3f",
}
