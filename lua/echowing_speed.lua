--[[
  Echowing, the speed applet: sets the speed of a follower copter by the distance to its leader, as the thesis of 2017
  describes it (R. L. McClanahan, AFIT-ENV-MS-17-M-202), on autopilots with as little memory as the thesis's.

  A ground tool streams guided points without a velocity. This applet reads the forward rangefinder (the co-processor's
  running average, by MAVLink) and sets the speed limit of Guided in steps: slower when too near, faster when too far.
  From the co-processor's single readings (NAMED_VALUE_FLOAT "SNR_RAW") it tells when a stop would come too late, and backs
  off. It holds the vehicle when the points end.

  It acts only while ECHO_ENABLE is 1 and the vehicle is armed and in Guided. The pilot takes over by any change of mode;
  the speed parameter is then the pilot's again.

  echowing.lua, the other applet, holds the distance more exactly, and needs more memory. A card holds one of the two:
  they use the same parameters. Purpose, parameters, and what each message means: echowing_speed.md.

  How it stays small: each name, function and local takes heap for itself, so one table holds the state, a name stands for
  what is alike, and a number that is used once stands where it is used, with its meaning beside it. What runs once comes
  last, in a function of its own. There are fewer than 256 different names, texts and numbers, as the compiler's table of them
  would double, and few enough texts among them for the vehicle's table of texts not to double while it loads (1 kB).
--]]

---@diagnostic disable: need-check-nil

-- Each script gets its own copy of the vehicle's libraries. What this one does not use of them goes: it takes 4 kB.
-- Texts have their functions from another copy.
local abs, cos, max, sin = math.abs, math.cos, math.max, math.sin
io, math, package, require, string, table = nil, nil, nil, nil, nil, nil

-- States, as ECHO_STATE tells them: 0 off, 1 searching, 2 tracking, 3 too close, 4 no sonar data, 5 stream lost, 6 backing
-- off. Severities: 2 critical, 4 warning, 5 notice, 6 info. Mode 4 is Guided.

local function say(severity, text)
    gcs:send_text(severity, 'ECHO: ' .. text)
end

local function clamp(value, low, high)
    return value < high and max(low, value) or high -- NaN: high
end

-- Parameters ---------------------------------------------------------------------------------------------------------

--[[
  // @Param: ECHO_ENABLE
  // @DisplayName: Echowing enable
  // @Description: Lets the applet set the speed in Guided
  // @Values: 0:Disabled,1:Enabled
  // @User: Standard
  // @Param: ECHO_LAW
  // @DisplayName: Echowing speed law
  // @Description: How the range sets the speed. Thesis: fixed steps by bands; no change while no target is detected. Bands: the same steps, which stop at the limits; the speed recovers when the target is lost
  // @Values: 0:Thesis,1:Bands
  // @User: Standard
  // @Param: ECHO_DIST
  // @DisplayName: Echowing wanted distance
  // @Description: Distance to the leader, centre to centre
  // @Range: 1.5 6
  // @Units: m
  // @User: Standard
  // @Param: ECHO_DETECT
  // @DisplayName: Echowing detection limit
  // @Description: The applet takes a range of this or more for no target
  // @Range: 2 7.6
  // @Units: m
  // @User: Standard
  // @Param: ECHO_BAND_IN
  // @DisplayName: Echowing monitor band
  // @Description: The speed does not change while the range is within this of the wanted distance
  // @Range: 0.01 0.5
  // @Units: m
  // @User: Advanced
  // @Param: ECHO_BAND_OUT
  // @DisplayName: Echowing small step band
  // @Description: The speed changes by the small step while the range is within this of the wanted distance, else by the big step
  // @Range: 0.05 1.5
  // @Units: m
  // @User: Advanced
  // @Param: ECHO_STEP_SML
  // @DisplayName: Echowing small step
  // @Description: Change of speed per period, near the wanted distance
  // @Range: 0.05 2
  // @Units: m/s
  // @User: Advanced
  // @Param: ECHO_STEP_BIG
  // @DisplayName: Echowing big step
  // @Description: Change of speed per period, far from the wanted distance
  // @Range: 0.05 3
  // @Units: m/s
  // @User: Advanced
  // @Param: ECHO_PERIOD
  // @DisplayName: Echowing law period
  // @Description: Time between two steps
  // @Range: 0.1 2
  // @Units: s
  // @User: Advanced
  // @Param: ECHO_SPD_MIN
  // @DisplayName: Echowing lowest speed
  // @Description: Lowest speed limit. 0 would mean no limit. Below 0.2 the autopilot saves a value of its own
  // @Range: 0.2 2
  // @Units: m/s
  // @User: Standard
  // @Param: ECHO_SPD_MAX
  // @DisplayName: Echowing highest speed
  // @Description: Highest speed limit
  // @Range: 1 15
  // @Units: m/s
  // @User: Standard
  // @Param: ECHO_SPD_INIT
  // @DisplayName: Echowing initial speed
  // @Description: Speed limit when the applet takes control
  // @Range: 0.2 15
  // @Units: m/s
  // @User: Standard
  // @Param: ECHO_SPD_LOST
  // @DisplayName: Echowing speed without sonar
  // @Description: Speed limit while the sonar sends no data or detects no target (law 0 keeps its speed while it detects no target)
  // @Range: 0.2 15
  // @Units: m/s
  // @User: Standard
  // @Param: ECHO_LOST_T
  // @DisplayName: Echowing target lost time
  // @Description: The target is lost after this time without a detection
  // @Range: 0.3 10
  // @Units: s
  // @User: Standard
  // @Param: ECHO_CLOSE
  // @DisplayName: Echowing close distance
  // @Description: Too close: the range minus the distance that still closes before the vehicle stops is under this. Any range under 1 m is too close
  // @Range: 0.5 4
  // @Units: m
  // @User: Standard
  // @Param: ECHO_DELAY
  // @DisplayName: Echowing reaction delay
  // @Description: Time from a reading until the vehicle reacts: sonar, wire and attitude. Used for the closing distance
  // @Range: 0.1 2
  // @Units: s
  // @User: Advanced
  // @Param: ECHO_DECEL
  // @DisplayName: Echowing braking
  // @Description: Deceleration that the vehicle reaches. Used for the closing distance
  // @Range: 0.5 10
  // @Units: m/s/s
  // @User: Advanced
  // @Param: ECHO_RATE
  // @DisplayName: Echowing rate limit
  // @Description: Law 1: highest rate of change of the speed limit, except when too close. 0: no rate limit
  // @Range: 0 20
  // @Units: m/s/s
  // @User: Advanced
  // @Param: ECHO_STREAM_T
  // @DisplayName: Echowing stream watchdog
  // @Description: The applet holds the vehicle where it is when a stream of guided points stops for this long. 0: no watchdog
  // @Range: 0 10
  // @Units: s
  // @User: Standard
  // @Param: ECHO_INSET
  // @DisplayName: Echowing sonar inset
  // @Description: Distance between the two vehicles' centres minus what the sonar reads. The sonar's face is ahead of the follower's centre, and the leader's legs, which reflect, are around its centre
  // @Range: 0 1
  // @Units: m
  // @User: Standard
  // @Param: ECHO_MIRROR
  // @DisplayName: Echowing mirror of the pilot's speed
  // @Description: The pilot's value of the speed parameter, in its own unit, while the applet is in control; 0 otherwise. The applet writes it, so that a restarted script can restore the speed parameter
  // @Range: 0 10000
  // @ReadOnly: True
  // @User: Advanced
--]]

-- Name, default, lowest and highest accepted value, and the number by which the autopilot finds what a pilot has saved: a
-- number belongs to one name for ever, in both applets. A table of them, with an object each, would take 2 kB more.
local PARAMETERS = [[
ENABLE 0 0 1 1
LAW 0 0 1 2
DIST 3 1.5 6 3
DETECT 4.5 2 7.6 4
BAND_IN 0.05 0.01 0.5 5
BAND_OUT 0.25 0.05 1.5 6
STEP_SML 0.5 0.05 2 7
STEP_BIG 1 0.05 3 8
PERIOD 0.45 0.1 2 9
SPD_MIN 0.2 0.2 2 13
SPD_MAX 5 1 15 14
SPD_INIT 2.5 0.2 15 15
SPD_LOST 3 0.2 15 16
LOST_T 1.5 0.3 10 17
CLOSE 1.5 0.5 4 19
DELAY 1.2 0.1 2 20
DECEL 2.5 0.5 10 21
RATE 4 0 20 22
STREAM_T 1 0 10 23
INSET 0.2 0 1 27
MIRROR 0 0 10000 28
]]

-- What the applet knows. Times are in ms; distances are between the two vehicles' centres, speeds along the nose. All of it
-- from the start, and false where it is not known: a table that grows in flight, as it also does for what was nil, needs a
-- hole of its new size, and small heaps have small holes.
local S = {
    state = 0, row = 1, points = 0, point_ms = 0, sender = 0, update_ms = 0, dt_s = 0, yaw = 0, own_mps = 0,
    near_m = 10, leader_mps = 0, board_ms = 0, seen_ms = 0, wilds = 0, wild_m = 0,
    auth = false, deaf = false, close = false, holding = false, pilot_units = false, units = false, text = false,
    law_mps = 0, wish_mps = 0, speed_mps = 0, data_ms = 0, range_ms = 0, step_ms = 0,
    announced = 0, told_ms = 0, named_ms = 0, strange = 0,
}
local refused = 0 -- messages that were not used. Not in S, which is full: with one more name it takes 640 bytes more
-- Values in force: C.DIST, ... Filled here, where there are large holes still.
local C = {}
S.pilot_units = param:get('ECHO_MIRROR') -- what a script that died in control left there
if not param:add_table(95, 'ECHO_', 50) then error('ECHO: parameter table key 95 is taken') end -- ArduPilot's use others
for name, value, i in PARAMETERS:gmatch('(%S+) (%S+) %S+ %S+ (%S+)') do
    C[name] = value + 0 -- now it is a number
    param:add_param(95, i + 0, name, C[name])
end
if S.pilot_units then param:set('ECHO_MIRROR', S.pilot_units) end -- it is not saved: its default was back

-- Uses the new value of the next parameter, in row S.row of the text, if it is in its range (NaN is not); else keeps the
-- old and tells it once: S.strange has a bit for each, by its number.
local function read()
    local name, low, high, i, row = PARAMETERS:match('(%S+) %S+ (%S+) (%S+) (%S+)()', S.row)
    S.row = row < #PARAMETERS and row or 1
    local value = param:get('ECHO_' .. name)
    i = 1 << i
    if value and value >= low + 0 and value <= high + 0 then
        C[name], S.strange = value, S.strange & ~i
    elseif S.strange & i == 0 then
        S.strange = S.strange | i
        say(4, ('ECHO_%s out of range, using %.2f'):format(name, C[name]))
    end
end

-- This vehicle -------------------------------------------------------------------------------------------------------

-- The speed parameter and how many of its units make 1 m/s: WP_SPD from later 4.7 on, WPNAV_SPEED before.
local SPEED_NAME = param:get('WP_SPD') and 'WP_SPD' or 'WPNAV_SPEED'
local per_mps = SPEED_NAME == 'WP_SPD' and 1 or 100

-- Flies to a place so far back, looking where it looks now: Guided would turn the nose, and with it the sonar, towards a
-- target without a yaw. False: it does not fly, or the target was refused.
local function fly_back(off_m)
    local position, yaw = ahrs:get_relative_position_NED_origin(), S.yaw
    if not (position and vehicle:get_likely_flying()) then return false end
    position:x(position:x() - off_m * cos(yaw))
    position:y(position:y() - off_m * sin(yaw))
    return position:length() < 10000 and abs(yaw) < 6 -- NaN is not, nor is what an estimator that fails tells
        and vehicle:set_target_pos_NED(position, true, yaw * 57.29578, false, 0, false, false) -- degrees
end

-- Sonar --------------------------------------------------------------------------------------------------------------

-- Distance and speed of the target by the single readings: an observer that is damped well at 10 and at 20 Hz. A reading far
-- from what was foreseen is wild, as propellers make them, and late echoes make two alike: the third one is a target, which
-- flies as fast as this vehicle until the next ones show its speed. board_ms: the co-processor's clock.
local function track(range_m, board_ms)
    local dt_s, off_m = (board_ms - S.board_ms) / 1000, range_m - S.near_m
    local known = dt_s > 0 and dt_s < 0.5
    S.board_ms = board_ms
    if known and abs(off_m) < 0.5 then
        S.near_m = range_m - 0.3 * off_m
        S.leader_mps = clamp(S.leader_mps + 0.4 * off_m / dt_s, -C.SPD_MAX, C.SPD_MAX)
    else
        S.wilds = known and abs(range_m - S.wild_m) < 0.5 and S.wilds + 1 or 1
        S.wild_m = range_m
        if S.wilds < 3 then return end
        S.near_m, S.leader_mps = range_m, S.own_mps
    end
    S.seen_ms, S.wilds = S.update_ms, 0
end

-- Laws ---------------------------------------------------------------------------------------------------------------

-- One step by the range's band, thesis Appendix A and Table 6. Law 0, Appendix A: a step that would reach a limit is
-- refused. Law 1: it stops at the limit.
local function law_step(speed_mps, range_m)
    local wish_mps = speed_mps + (range_m >= C.DIST + C.BAND_OUT and C.STEP_BIG
        or range_m >= C.DIST + C.BAND_IN and C.STEP_SML
        or range_m >= C.DIST - C.BAND_IN and 0
        or range_m >= C.DIST - C.BAND_OUT and -C.STEP_SML
        or -C.STEP_BIG)
    if C.LAW >= 1 then return clamp(wish_mps, C.SPD_MIN, C.SPD_MAX) end
    if wish_mps > speed_mps and wish_mps >= C.SPD_MAX or wish_mps < speed_mps and wish_mps <= C.SPD_MIN then
        return speed_mps
    end
    return wish_mps
end

-- Sets the law's speed by the rangefinder's running average. Gives the distance, nil where it is no measurement or no
-- target, and the status.
local function run_law(t_ms)
    local status = rangefinder:status_orient(0) -- 1 no data, 2 too low, 3 too high, 4 good
    local range_m = rangefinder.distance_orient and rangefinder:distance_orient(0)
        or rangefinder:distance_cm_orient(0) / 100
    range_m = (status == 4 and range_m > 0 or status == 2 and range_m >= 0)
        and range_m < C.DETECT and range_m + C.INSET or nil
    S.state = 2
    if status > 1 then S.data_ms = t_ms end
    if range_m then
        S.range_ms = t_ms
        if t_ms - S.step_ms >= C.PERIOD * 1000 then S.step_ms, S.wish_mps = t_ms, law_step(S.wish_mps, range_m) end
    else
        S.step_ms = t_ms -- the next average begins when the target is back
        if t_ms - S.data_ms >= C.LOST_T * 1000 then
            S.state, S.wish_mps = 4, C.SPD_LOST
        elseif t_ms - S.range_ms >= C.LOST_T * 1000 and not S.close then
            S.state, S.wish_mps = 1, C.LAW >= 1 and C.SPD_LOST or S.wish_mps
        end
    end
    local mps = C.LAW >= 1 and C.RATE > 0 and C.RATE * S.dt_s or C.SPD_MAX
    S.law_mps = clamp(S.law_mps + clamp(S.wish_mps - S.law_mps, -mps, mps), C.SPD_MIN, C.SPD_MAX)
    return range_m, status
end

-- Guard: too close, or too fast to stop before it is, wins over every law. From a leader that comes (0.5 m/s) it backs off to
-- the wanted distance: it would begin anew from nearer, its nose and its sonar down. Gives the speed to set.
local function guard(status, t_ms)
    -- A target lost while too close is taken to be there for 2.5 s: while it backs off the nose is up, and the sonar often
    -- sees nothing.
    local known = t_ms - S.seen_ms <= (S.close and 5 or 1) * 500
    local near_m, mps = known and S.near_m or 10, known and max(0, S.own_mps - S.leader_mps) or 0
    S.close = status == 2 or S.close and near_m < C.DIST and (S.leader_mps < -0.5 or near_m < C.CLOSE + 0.3)
        or near_m - mps * C.DELAY - mps * mps / (2 * C.DECEL) < C.CLOSE
    if not S.close then return S.law_mps end
    if C.LAW >= 1 then S.wish_mps, S.law_mps = C.SPD_MIN, C.SPD_MIN end
    -- Points lead 2 m up and higher (flight/lowest.py). Half a metre below that what is near is most likely the ground.
    if known and -ahrs:get_relative_position_D_home() > 2 - 0.5 and fly_back(clamp(C.DIST - near_m, 0.5, 5)) then
        S.state = 6
        return C.SPD_MAX
    end
    S.state = 3
    return C.SPD_MIN
end

-- MAVLink ------------------------------------------------------------------------------------------------------------

-- Takes a point for this vehicle, or a single reading. Frames whose checksum is wrong reach scripts too: it is computed.
-- Points count from one sender until it has been silent for a second. What is not used gives a number that no parameter
-- has, and a text.
local function take_message(message, t_ms)
    if not message then return end
    local head = #message >= 299 and 15 or 12 -- bytes before the payload: mavlink_message_t has ids of 32 bits, or 24
    local old, length = message:byte(3, 4)
    local point = message:byte(head - 2) == 86
    old = old & 1 == 0 -- 0xFE is MAVLink 1, 0xFD is 2
    if length > 53 or not (old or message:byte(5) < 2) then -- 1: signed; more changes the frame
        return 10, 'damaged or impossible message, not used'
    end
    -- As on the wire from the length on; one or three bytes of message id. The byte that follows is the message's
    -- CRC_EXTRA.
    local bytes = message:sub(4, old and 4 or 6) .. message:sub(7, 8)
        .. message:sub(head - 3, old and head - 2 or head) .. message:sub(head + 1, head + length)
        .. (point and '\5' or '\170') .. message:sub(1, 2) .. '\0\0\0'
    local crc = 0xFFFF -- X.25, four bytes at a time; 0 at the end, and zeros that follow change nothing
    for i = 1, #bytes - 3, 4 do
        crc = crc ~ ('<i4'):unpack(bytes, i)
        crc = crc ~ crc << 4 ~ crc << 11 ~ crc << 16
        crc = crc ~ crc << 8 ~ crc << 22
        crc = crc ~ crc << 16
        crc = crc >> 16 ~ crc >> 21 ~ crc >> 28
    end
    if crc ~= 0 then return 10, 'damaged or impossible message, not used' end
    local own, sender = param:get('MAV_SYSID') or param:get('SYSID_THISMAV'), message:byte(8)
    if not point then
        local board_ms, range_m, name = ('<i4fc7'):unpack(message, head + 1)
        if sender ~= own or name ~= 'SNR_RAW' then return end
        if range_m > 0 then -- NaN is not
            if range_m < C.DETECT then track(range_m + C.INSET, board_ms) end
            return
        end
        return 10, 'damaged or impossible message, not used'
    end
    local system = length > 50 and message:byte(head + 51) or 0
    if system ~= 0 and system ~= own then return end
    if t_ms - S.point_ms > 1000 then S.points, S.sender = 0, sender end
    if sender ~= S.sender then return 12, 'points of a second sender, not used' end
    S.points, S.point_ms = S.points + 1, t_ms
end

-- The speed parameter ------------------------------------------------------------------------------------------------

-- An outside change while in control is the pilot's: his value from now on.
local function watch_speed()
    local value = param:get(SPEED_NAME)
    if value ~= S.units and value > 0 and value < 50 * per_mps then -- NaN is not; no copter flies faster
        S.pilot_units = value
        param:set('ECHO_MIRROR', value)
    end
end

local function hand_back(text)
    if not S.pilot_units then return end
    watch_speed()
    local value = S.pilot_units
    param:set(SPEED_NAME, value)
    if vehicle:get_mode() == 4 then vehicle:set_desired_speed(value / per_mps) end
    param:set('ECHO_MIRROR', 0)
    say(5, ('handed back, %s %.2f (%s)'):format(SPEED_NAME, value, text))
    S.pilot_units, S.units, S.state = false, false, 0
end

-- What pilots see ----------------------------------------------------------------------------------------------------

-- One text per change of state, but what comes and goes at most each 10 s; the named floats each half second, and at once
-- when it backs off: the ground tool would call it back.
local function report(range_m, t_ms)
    local state = S.state
    if state ~= S.announced and (state > 2 or t_ms - S.told_ms >= 10000) then
        S.announced, S.told_ms, S.named_ms = state, t_ms, t_ms - 500
        say(state > 4 and 2 or 4, ({
            'searching', 'tracking', 'too close', 'no sonar data', 'stream lost, holding here',
            'too close, backing off',
        })[state])
    end
    if t_ms - S.named_ms < 500 then return end
    S.named_ms = t_ms
    gcs:send_named_float('ECHO_RNG', range_m or 0)
    gcs:send_named_float('ECHO_SPD', S.speed_mps)
    gcs:send_named_float('ECHO_STATE', state)
    gcs:send_named_float('ECHO_REF', refused)
end

-- Control: who flies, and the update ---------------------------------------------------------------------------------

local function act(t_ms)
    local units = S.pilot_units
    watch_speed() -- before the speed is touched: a restart must find the pilot's
    if not S.pilot_units then return 100 end -- it is no speed, and could not be given back
    if not units then
        S.points, S.close, S.holding = 0, false, false
        S.step_ms, S.data_ms, S.range_ms, S.told_ms = t_ms, t_ms, t_ms, t_ms - 10000
        S.named_ms, S.announced = t_ms - 500, 2
        S.law_mps = clamp(C.SPD_INIT, C.SPD_MIN, C.SPD_MAX)
        S.wish_mps = S.law_mps
        say(6, ('in control, law %.0f, %.1f m/s'):format(C.LAW // 1, S.law_mps))
    end
    local range_m, status = run_law(t_ms)
    S.speed_mps = guard(status, t_ms)
    -- Holds the vehicle where it is once a stream of guided points has fallen silent. Three points are a stream; one alone
    -- may be a pilot's click on the map.
    if C.STREAM_T == 0 or S.points < 3 or t_ms - S.point_ms <= C.STREAM_T * 1000 or S.close then
        S.holding = false -- hold again where the evasion ends
    else
        S.state, S.holding = 5, S.holding or fly_back(0)
    end
    param:set(SPEED_NAME, S.speed_mps * per_mps)
    S.units = param:get(SPEED_NAME)
    vehicle:set_desired_speed(S.speed_mps)
    report(range_m, t_ms)
    return S.state == 6 and 20 or 50
end

-- Gives the pause before the next update, ms.
local function update()
    local t_ms = millis():toint()
    for _ = 1, 3 do read() end -- each of them within half a second in control
    C.SPD_MAX = max(C.SPD_MAX, C.SPD_MIN)
    -- The target's distance is carried on to now: this vehicle knows its own motion, also while its sonar sees nothing.
    local velocity, yaw = ahrs:get_velocity_NED(), (ahrs.get_yaw_rad or ahrs.get_yaw)(ahrs)
    local mps = velocity and velocity:x() * cos(yaw) + velocity:y() * sin(yaw) or 0
    S.own_mps = abs(mps) < 50 and mps or 0 -- no copter flies faster, and NaN is not
    S.yaw, S.dt_s, S.update_ms = yaw, (t_ms - S.update_ms) / 1000, t_ms
    S.near_m = S.near_m + (S.leader_mps - S.own_mps) * S.dt_s
    for _ = 1, 5 do
        local i, text = take_message(mavlink:receive_chan(), t_ms)
        if i then
            i, refused = 1 << i, refused + 1
            if S.strange & i == 0 then say(4, text) end
            S.strange = S.strange | i
        end
    end
    local text = (C.ENABLE < 1 or S.deaf) and 'disabled' or not arming:is_armed() and 'disarmed'
        or vehicle:get_mode() ~= 4 and 'mode'
    if not text then return act(t_ms) end
    hand_back(text)
    if S.auth and C.ENABLE >= 1 and (S.deaf or not rangefinder:has_orientation(0)) then
        arming:set_aux_auth_failed(S.auth, 'ECHO: ' .. (S.deaf or 'no forward rangefinder'))
    elseif S.auth then
        arming:set_aux_auth_passed(S.auth)
    end
    return 100
end

-- An error is reported once with its place. The speed is handed back, and the next try is slower.
local function run()
    local status, value = pcall(update)
    if not status then
        if value ~= S.text then say(2, 'error ' .. value) end
        S.text, value = value, 1000
        pcall(hand_back, 'error')
    end
    return run, value
end

-- Start --------------------------------------------------------------------------------------------------------------

-- What takes memory once: the vehicle forgets the main function, and then this one, as soon as they have ended.
local function start()
    for _ = 1, 21 do read() end
    -- SET_POSITION_TARGET_GLOBAL_INT and NAMED_VALUE_FLOAT. An error where other scripts have taken the places.
    S.auth = arming:get_aux_auth_id()
    S.deaf = not pcall(function()
        mavlink:init(5, 2)
        mavlink:register_rx_msgid(86)
        mavlink:register_rx_msgid(251)
    end) and 'other scripts leave no place to receive'
    if C.MIRROR > 0 then
        S.units = param:get(SPEED_NAME)
        hand_back('restarted')
    end
    S.pilot_units = false
    say(S.deaf and 4 or 6, S.deaf or 'ready')
    return run, 100
end

return start, 0
