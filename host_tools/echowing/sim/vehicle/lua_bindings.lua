---@meta
-- ArduCopter's scripting calls that Echowing's applets may use: the one place that says what each takes and gives.
--
-- Read twice: by an EmmyLua type checker (lua-language-server, emmylua_check) as the definition of the globals, and by
-- echowing.sim.vehicle.luahost, which builds the strict bindings of the simulated autopilot from it, so that the checker and the
-- simulator cannot disagree. Signatures follow libraries/AP_Scripting/docs/docs.lua and
-- generator/description/bindings.desc of ArduPilot; the words are ours.
--
-- Beyond the usual tags:
--   -- since: 4.7     the call exists from this ArduCopter version on
-- A `?` after a parameter's name makes it optional; `|nil` in a return says when there may be nothing.
-- luacheck: ignore

---@class uint32_t_ud
local uint32_t_ud = {}

-- a 32-bit unsigned number; 0 without an argument
---@param value? uint32_t_ud|integer|number
---@return uint32_t_ud
function uint32_t(value) end

---@return integer # the same bits as a signed number
function uint32_t_ud:toint() end

---@return number # rounded to 24 significant bits
function uint32_t_ud:tofloat() end

---@return uint32_t_ud # milliseconds since the autopilot started
function millis() end

---@return uint32_t_ud # microseconds since the autopilot started, wraps after 71 minutes
function micros() end

---@class Vector3f_ud
local Vector3f_ud = {}

---@return Vector3f_ud # zeros
function Vector3f() end

---@param value? number
---@return number
function Vector3f_ud:x(value) end

---@param value? number
---@return number
function Vector3f_ud:y(value) end

---@param value? number
---@return number
function Vector3f_ud:z(value) end

---@return number
function Vector3f_ud:length() end

---@class Vector2f_ud
local Vector2f_ud = {}

---@return Vector2f_ud # zeros
function Vector2f() end

---@param value? number
---@return number
function Vector2f_ud:x(value) end

---@param value? number
---@return number
function Vector2f_ud:y(value) end

---@return number
function Vector2f_ud:length() end

---@class Location_ud
local Location_ud = {}

---@return Location_ud # latitude, longitude and altitude 0
function Location() end

---@param value? integer -900000000..900000000 # 1e-7 degrees
---@return integer
function Location_ud:lat(value) end

---@param value? integer -1800000000..1800000000 # 1e-7 degrees
---@return integer
function Location_ud:lng(value) end

---@param value? integer # centimetres above the datum that the three flags below choose
---@return integer
function Location_ud:alt(value) end

---@param value? boolean # altitude is above home
---@return boolean
function Location_ud:relative_alt(value) end

---@param value? boolean # altitude is above the terrain
---@return boolean
function Location_ud:terrain_alt(value) end

---@param value? boolean # altitude is above the estimator's origin
---@return boolean
function Location_ud:origin_alt(value) end

---@param north_m number
---@param east_m number
function Location_ud:offset(north_m, east_m) end

---@param other Location_ud
---@return number # horizontal metres
function Location_ud:get_distance(other) end

---@param other Location_ud
---@return Vector2f_ud # metres north and east from this place to the other
function Location_ud:get_distance_NE(other) end

---@param other Location_ud
---@return Vector3f_ud # metres north, east and down from this place to the other
function Location_ud:get_distance_NED(other) end

---@return Location_ud
function Location_ud:copy() end

---@class Parameter_ud
local Parameter_ud = {}

-- an error where the name is given and no such parameter exists
---@param name? string
---@return Parameter_ud
function Parameter(name) end

---@param name string
---@return boolean # false: no such parameter
function Parameter_ud:init(name) end

---@return number|nil # nil before init
function Parameter_ud:get() end

---@param value number
---@return boolean
function Parameter_ud:set(value) end

---@param value number
---@return boolean
function Parameter_ud:set_and_save(value) end

---@class param
param = {}

---@param name string
---@return number|nil # nil: no such parameter in this version
function param:get(name) end

-- until the next restart only
---@param name string
---@param value number
---@return boolean
function param:set(name, value) end

---@param name string
---@param value number
---@return boolean
function param:set_and_save(name, value) end

---@param key integer 0..200 # one that no other script uses
---@param prefix string
---@param count integer 1..63
---@return boolean
function param:add_table(key, prefix, count) end

---@param key integer 0..200
---@param index integer 1..63
---@param name string # prefix and name: at most 16 characters together
---@param default number
---@return boolean
function param:add_param(key, index, name, default) end

---@class vehicle
vehicle = {}

---@return integer # 4 is Guided
function vehicle:get_mode() end

---@return boolean
function vehicle:get_likely_flying() end

-- the limit of Guided's horizontal speed, until the next change of mode or sub-mode; 0 is no limit
---@param speed_mps number
---@return boolean # false: not in Guided or Auto
function vehicle:set_desired_speed(speed_mps) end

-- a position target for Guided
---@param target Location_ud
---@return boolean # false: not in Guided, or outside a fence
function vehicle:set_target_location(target) end

---@return Location_ud|nil # nil where the sub-mode has no position target of its own (position with velocity too)
function vehicle:get_target_location() end

---@param position Vector3f_ud # metres from the estimator's origin
---@param use_yaw boolean
---@param yaw_deg number -360..360
---@param use_yaw_rate boolean
---@param yaw_rate_degs number
---@param yaw_relative boolean
---@param terrain_alt boolean
---@return boolean
function vehicle:set_target_pos_NED(position, use_yaw, yaw_deg, use_yaw_rate, yaw_rate_degs, yaw_relative, terrain_alt) end

---@param position Vector3f_ud # metres from the estimator's origin
---@param velocity Vector3f_ud
---@return boolean
function vehicle:set_target_posvel_NED(position, velocity) end

---@param position Vector3f_ud # metres from the estimator's origin
---@param velocity Vector3f_ud
---@param acceleration Vector3f_ud
---@param use_yaw boolean
---@param yaw_deg number -360..360
---@param use_yaw_rate boolean
---@param yaw_rate_degs number
---@param yaw_relative boolean
---@return boolean
function vehicle:set_target_posvelaccel_NED(position, velocity, acceleration, use_yaw, yaw_deg, use_yaw_rate, yaw_rate_degs, yaw_relative) end

---@param velocity Vector3f_ud
---@return boolean
function vehicle:set_target_velocity_NED(velocity) end

---@class ahrs
ahrs = {}

---@return Location_ud|nil
function ahrs:get_location() end

---@return number # radians, -pi to pi; later versions prefer get_yaw_rad
function ahrs:get_yaw() end

-- since: 4.7
---@return number # radians, -pi to pi
function ahrs:get_yaw_rad() end

---@return Vector3f_ud|nil
function ahrs:get_velocity_NED() end

---@return Vector2f_ud
function ahrs:groundspeed_vector() end

---@return Vector3f_ud|nil # metres from the estimator's origin
function ahrs:get_relative_position_NED_origin() end

---@return number # metres below home
function ahrs:get_relative_position_D_home() end

---@class rangefinder
rangefinder = {}

---@return integer
function rangefinder:num_sensors() end

---@param orientation integer 0..43 # 0 is forward
---@return boolean
function rangefinder:has_orientation(orientation) end

---@param orientation integer 0..43
---@return integer # 0 not connected, 1 no data, 2 too low, 3 too high, 4 good
function rangefinder:status_orient(orientation) end

---@param orientation integer 0..43
---@return boolean
function rangefinder:has_data_orient(orientation) end

-- superseded by distance_orient where that exists
---@param orientation integer 0..43
---@return integer # centimetres, cut off, not rounded
function rangefinder:distance_cm_orient(orientation) end

-- since: 4.7
---@param orientation integer 0..43
---@return number # metres
function rangefinder:distance_orient(orientation) end

---@param orientation integer 0..43
---@return integer # per cent; -1 unknown
function rangefinder:signal_quality_pct_orient(orientation) end

---@class RangeFinder_State_ud
local RangeFinder_State_ud = {}

---@return uint32_t_ud # when the driver took its newest reading, as millis()
function RangeFinder_State_ud:last_reading() end

---@class AP_RangeFinder_Backend_ud
local AP_RangeFinder_Backend_ud = {}

---@return number # metres
function AP_RangeFinder_Backend_ud:distance() end

---@return integer # 0 is forward
function AP_RangeFinder_Backend_ud:orientation() end

---@return integer # as RNGFNDn_TYPE; 10 is MAVLink
function AP_RangeFinder_Backend_ud:type() end

---@return integer # as status_orient
function AP_RangeFinder_Backend_ud:status() end

---@return RangeFinder_State_ud # a copy
function AP_RangeFinder_Backend_ud:get_state() end

---@param number integer 0..255
---@return AP_RangeFinder_Backend_ud|nil # nil: there is none
function rangefinder:get_backend(number) end

---@class RC_Channel_ud
local RC_Channel_ud = {}

---@return integer # 0 low, 1 middle, 2 high
function RC_Channel_ud:get_aux_switch_pos() end

---@class rc
rc = {}

---@param option integer 0..65535 # 300 to 307 are the scripts' own
---@return RC_Channel_ud|nil # nil: no channel has this option
function rc:find_channel_for_option(option) end

---@param option integer 0..65535
---@return integer|nil # nil: never seen
function rc:get_aux_cached(option) end

---@class arming
arming = {}

---@return boolean
function arming:is_armed() end

---@return integer|nil # nil: all three ids are taken
function arming:get_aux_auth_id() end

---@param id integer 0..255
function arming:set_aux_auth_passed(id) end

---@param id integer 0..255
---@param reason string
function arming:set_aux_auth_failed(id, reason) end

---@class gcs
gcs = {}

---@param severity integer 0..7 # 0 emergency … 7 debug
---@param text string
function gcs:send_text(severity, text) end

---@param name string # at most 10 characters
---@param value number
function gcs:send_named_float(name, value) end

---@class mavlink
mavlink = {}

---@param queue_depth integer 0..25
---@param message_ids integer 0..25 # how many ids may be registered
function mavlink:init(queue_depth, message_ids) end

-- an error where no place is left
---@param message_id integer 0..16777215
---@return boolean # false: registered already
function mavlink:register_rx_msgid(message_id) end

-- an error before init
---@return string|nil # the C structure mavlink_message_t; nothing when the queue is empty
---@return integer|nil # link
---@return uint32_t_ud|nil # milliseconds when it arrived
function mavlink:receive_chan() end

-- an error where the message is not in the autopilot's dialect
---@param link integer 0..15
---@param message_id integer 0..16777215
---@param payload string # as on the wire, with the zeros at its end
---@return boolean|nil # false: no room in the link's buffer; nil: no such link
function mavlink:send_chan(link, message_id, payload) end

---@class logger
logger = {}

-- units and multipliers come both or not at all
---@param name string # at most 4 characters
---@param labels string # comma separated, at most 57 characters
---@param format string
---@param ... any
function logger:write(name, labels, format, ...) end
