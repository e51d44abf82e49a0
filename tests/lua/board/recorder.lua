-- Writes down what each binding of the simulated autopilot answers to a script: the record that board/replay.c answers
-- from. Run by tests/lua/heap.py with the script's globals and the names of those that are functions of the autopilot.
-- luacheck: std lua53

local sandbox, is_binding = ...

local CLASSES = { -- as in replay.c
    Vector3f = 1, Vector2f = 2, Location = 3, Parameter = 4, RC_Channel = 5, RangeFinder_State = 16,
    AP_RangeFinder_Backend = 23,
}
local record, names, wrapped = {}, {}, {}
local wrap

local function value_of(value)
    local kind = type(value)
    local meta = kind == 'table' and getmetatable(value)
    if meta then
        if not wrapped[meta] then wrap(meta.__name, meta.__index, meta) end
        if meta.__name == 'uint32_t' then return string.pack('<c1i4', 'u', meta.__index.toint_unseen(value)) end
        return string.pack('<c1B', 'o', CLASSES[meta.__name])
    end
    if kind == 'nil' then return 'n' end
    if kind == 'boolean' then return string.pack('<c1B', 'b', value and 1 or 0) end
    if kind == 'string' then return string.pack('<c1s4', 's', value) end
    return math.type(value) == 'integer' and string.pack('<c1i4', 'i', value) or string.pack('<c1f', 'f', value)
end

local function noted(number, ...)
    local parts = { string.pack('<c1BB', 'C', number, select('#', ...)) }
    for i = 1, select('#', ...) do parts[i + 1] = value_of((select(i, ...))) end
    record[#record + 1] = table.concat(parts)
    return ...
end

local function watched(owner, name, call)
    local number = #names
    names[number + 1] = owner .. '\0' .. name .. '\0'
    return function(...) return noted(number, call(...)) end
end

function wrap(owner, methods, meta)
    wrapped[meta] = true
    local found = {}
    for name, call in pairs(methods) do found[#found + 1] = { name, call } end
    for _, method in ipairs(found) do methods[method[1]] = watched(owner, method[1], method[2]) end
    if owner == 'uint32_t' then
        for _, method in ipairs(found) do
            if method[1] == 'toint' then methods.toint_unseen = method[2] end
        end
    end
end

for name, value in pairs(sandbox) do
    local meta = type(value) == 'table' and getmetatable(value)
    if meta then
        wrap(name, meta.__index, meta)
    elseif type(value) == 'function' and is_binding[name] then
        sandbox[name] = watched('', name, value)
    end
end

local function note_update()
    record[#record + 1] = 'U'
end

local function write(path)
    local file = assert(io.open(path, 'wb'))
    file:write(string.char(#names), table.concat(names), table.concat(record))
    file:close()
end

return note_update, write
