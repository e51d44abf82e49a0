--[[
  Echowing: keeps a follower copter at its distance from the leader, by a sonar that looks forward.

  A ground tool streams guided points that keep the follower roughly in its place behind the leader. This applet reads
  the forward rangefinder (the co-processor's running average, by MAVLink) and the co-processor's newest single reading
  (NAMED_VALUE_FLOAT "SNR_RAW") and turns the distance into speed: slower when too near, faster when too far. Where the
  points carry a velocity it moves them along the beam to the wanted distance; where they do not it sets the speed limit
  of Guided.

  It acts only while ECHO_ENABLE is 1, the vehicle is armed and in Guided, and the switch (if ECHO_SWITCH names one) is
  high. The pilot takes over by any change of mode; the speed parameter is then the pilot's again.

  Purpose, wiring, parameters, tests on the bench, in SITL and in the air, and what each message means: echowing.md.
  Laws, guard, measurements: how-it-works.md.

  This file consists of parts: one block each, with constants and helpers that are local to the block, and one table
  with the part's state and the functions that the other parts call. The vehicle's Lua needs this: it allows 100 active
  local variables in one function, and the top level of a file counts as a function.
--]]

---@diagnostic disable: need-check-nil

local TEXT = 'ECHO: '
local SEVERITY = { CRITICAL = 2, ERROR = 3, WARNING = 4, NOTICE = 5, INFO = 6 }
local GUIDED = 4 -- Copter's mode number
local FORWARD = 0 -- orientation of the rangefinder
local STATUS_NO_DATA, STATUS_LOW, STATUS_GOOD = 1, 2, 4 -- RangeFinder::Status
local STATE = {
    OFF = 0, SEARCHING = 1, TRACKING = 2, TOO_CLOSE = 3, NO_SONAR = 4, STREAM_LOST = 5, BACKING_OFF = 6, HOLDING = 7,
}

local QUICK_MS = 20 -- pause between updates while the applet flies targets of its own
local IDLE_MS = 200 -- pause before the next update while not in control
local BLIND_MS = 2500 -- a target lost while too close is taken to be there for this time: no speed without sonar yet
local SPEED_FLOOR_MPS = 0.2 -- below this the autopilot saves its own least value over the pilot's; 0 means no limit
local POINT_FORMAT = 2 -- how points carry more than a point: POINT_FORMAT of the ground tool, ECHO_FORMAT here
local FASTEST_MPS = 30.0 -- no copter flies faster; WPNAV_SPEED and WP_SPD reach 20
local FURTHEST_M = 20.0 -- no sonar reads further; the longest reach of the MaxBotix kind is 10.7 m

local function say(severity, text)
    gcs:send_text(severity, TEXT .. text)
end

local function clamp(value, low, high)
    return math.max(low, math.min(high, value))
end

local function is_within(value, most) -- neither NaN nor beyond, to either side
    return value and value >= -most and value <= most
end

-- What the firmware offers -------------------------------------------------------------------------------------------

-- What the applet needs of the autopilot; the name of the first thing missing, or nil.
local function missing_call()
    local needs = {
        { 'vehicle', vehicle, { 'set_desired_speed', 'set_target_pos_NED', 'set_target_posvelaccel_NED',
            'get_target_location', 'get_mode' } },
        { 'rangefinder', rangefinder, { 'status_orient', 'has_orientation' } },
        { 'ahrs', ahrs, { 'get_location', 'get_velocity_NED', 'get_relative_position_NED_origin',
            'get_relative_position_D_home' } },
        { 'mavlink', mavlink, { 'init', 'register_rx_msgid', 'receive_chan' } },
        { 'param', param, { 'add_table', 'add_param' } },
        { 'arming', arming, { 'is_armed' } },
        { 'rc', rc, { 'find_channel_for_option' } },
        { 'logger', logger, { 'write' } },
    }
    for _, need in ipairs(needs) do
        if not need[2] then return need[1] end
        for _, call in ipairs(need[3]) do
            if not need[2][call] then return need[1] .. ':' .. call end
        end
    end
    if not (rangefinder.distance_orient or rangefinder.distance_cm_orient) then return 'rangefinder:distance_orient' end
    return nil
end

local missing = missing_call()
if missing then
    say(SEVERITY.ERROR, 'stopped, this firmware lacks ' .. missing)
    return
end

-- The speed parameter and how many of its units make 1 m/s: WP_SPD from later 4.7 on, WPNAV_SPEED before.
local SPEED_NAME = param:get('WP_SPD') and 'WP_SPD' or 'WPNAV_SPEED'
local SPEED_UNITS = SPEED_NAME == 'WP_SPD' and 1.0 or 100.0
if not param:get(SPEED_NAME) then
    say(SEVERITY.ERROR, 'stopped, no parameter WP_SPD or WPNAV_SPEED')
    return
end

local MY_SYSTEM = param:get('MAV_SYSID') or param:get('SYSID_THISMAV')
local yaw_rad = ahrs.get_yaw_rad or ahrs.get_yaw

-- Parameters ---------------------------------------------------------------------------------------------------------

-- Name, default, lowest and highest accepted value of each parameter, in the order of their numbers.
local PARAMETERS = {
    --[[
      // @Param: ECHO_ENABLE
      // @DisplayName: Echowing enable
      // @Description: Lets the applet set the speed in Guided
      // @Values: 0:Disabled,1:Enabled
      // @User: Standard
    --]]
    { 'ENABLE', 0, 0, 1 },
    --[[
      // @Param: ECHO_LAW
      // @DisplayName: Echowing speed law
      // @Description: How the range sets the speed. Thesis: fixed steps by bands; no change while no target is detected. Bands: the same steps; the speed recovers when the target is lost. Continuous: the leader's speed, from the range rate, plus a share of the range error
      // @Values: 0:Thesis,1:Bands,2:Continuous
      // @User: Standard
    --]]
    { 'LAW', 2, 0, 2 },
    --[[
      // @Param: ECHO_DIST
      // @DisplayName: Echowing wanted distance
      // @Description: Distance to the leader, centre to centre
      // @Range: 1.5 6
      // @Units: m
      // @User: Standard
    --]]
    { 'DIST', 3.0, 1.5, 6.0 },
    --[[
      // @Param: ECHO_DETECT
      // @DisplayName: Echowing detection limit
      // @Description: The applet takes a range of this or more for no target
      // @Range: 2 7.6
      // @Units: m
      // @User: Standard
    --]]
    { 'DETECT', 4.5, 2.0, 7.6 },
    --[[
      // @Param: ECHO_BAND_IN
      // @DisplayName: Echowing monitor band
      // @Description: Laws 0 and 1: the speed does not change while the range is within this of the wanted distance
      // @Range: 0.01 0.5
      // @Units: m
      // @User: Advanced
    --]]
    { 'BAND_IN', 0.05, 0.01, 0.5 },
    --[[
      // @Param: ECHO_BAND_OUT
      // @DisplayName: Echowing small step band
      // @Description: Laws 0 and 1: the speed changes by the small step while the range is within this of the wanted distance, else by the big step
      // @Range: 0.05 1.5
      // @Units: m
      // @User: Advanced
    --]]
    { 'BAND_OUT', 0.25, 0.05, 1.5 },
    --[[
      // @Param: ECHO_STEP_SML
      // @DisplayName: Echowing small step
      // @Description: Laws 0 and 1: change of speed per period, near the wanted distance
      // @Range: 0.05 2
      // @Units: m/s
      // @User: Advanced
    --]]
    { 'STEP_SML', 0.5, 0.05, 2.0 },
    --[[
      // @Param: ECHO_STEP_BIG
      // @DisplayName: Echowing big step
      // @Description: Laws 0 and 1: change of speed per period, far from the wanted distance
      // @Range: 0.05 3
      // @Units: m/s
      // @User: Advanced
    --]]
    { 'STEP_BIG', 1.0, 0.05, 3.0 },
    --[[
      // @Param: ECHO_PERIOD
      // @DisplayName: Echowing law period
      // @Description: Laws 0 and 1: time between two steps
      // @Range: 0.1 2
      // @Units: s
      // @User: Advanced
    --]]
    { 'PERIOD', 0.45, 0.1, 2.0 },
    --[[
      // @Param: ECHO_GAIN_P
      // @DisplayName: Echowing range gain
      // @Description: Law 2: speed towards the leader for each metre of range error
      // @Range: 0.1 1.2
      // @Units: 1/s
      // @User: Advanced
    --]]
    { 'GAIN_P', 0.7, 0.1, 1.2 },
    --[[
      // @Param: ECHO_GAIN_D
      // @DisplayName: Echowing rate gain
      // @Description: Law 2: speed for each m/s of range rate
      // @Range: 0 1
      // @User: Advanced
    --]]
    { 'GAIN_D', 0.3, 0.0, 1.0 },
    --[[
      // @Param: ECHO_TAU
      // @DisplayName: Echowing filter of single readings
      // @Description: Time constant of the filter that computes range and leader speed from the sonar's single readings. Law 2 and the closing distance use it
      // @Range: 0.1 1
      // @Units: s
      // @User: Advanced
    --]]
    { 'TAU', 0.12, 0.05, 1.0 },
    --[[
      // @Param: ECHO_SPD_MIN
      // @DisplayName: Echowing lowest speed
      // @Description: Lowest speed limit. 0 would mean no limit. Below 0.2 the autopilot saves a value of its own
      // @Range: 0.2 2
      // @Units: m/s
      // @User: Standard
    --]]
    { 'SPD_MIN', 0.2, SPEED_FLOOR_MPS, 2.0 },
    --[[
      // @Param: ECHO_SPD_MAX
      // @DisplayName: Echowing highest speed
      // @Description: Highest speed limit
      // @Range: 1 15
      // @Units: m/s
      // @User: Standard
    --]]
    { 'SPD_MAX', 5.0, 1.0, 15.0 },
    --[[
      // @Param: ECHO_SPD_INIT
      // @DisplayName: Echowing initial speed
      // @Description: Speed limit when the applet takes control
      // @Range: 0.2 15
      // @Units: m/s
      // @User: Standard
    --]]
    { 'SPD_INIT', 2.5, SPEED_FLOOR_MPS, 15.0 },
    --[[
      // @Param: ECHO_SPD_LOST
      // @DisplayName: Echowing speed without sonar
      // @Description: Speed limit while the sonar sends no data or detects no target (law 0 keeps its speed while it detects no target)
      // @Range: 0.2 15
      // @Units: m/s
      // @User: Standard
    --]]
    { 'SPD_LOST', 3.0, SPEED_FLOOR_MPS, 15.0 },
    --[[
      // @Param: ECHO_LOST_T
      // @DisplayName: Echowing target lost time
      // @Description: The target is lost after this time without a detection
      // @Range: 0.3 10
      // @Units: s
      // @User: Standard
    --]]
    { 'LOST_T', 1.3, 0.3, 10.0 },
    --[[
      // @Param: ECHO_NODATA_T
      // @DisplayName: Echowing sonar timeout
      // @Description: The sonar has failed after this time without data from the rangefinder
      // @Range: 0.3 10
      // @Units: s
      // @User: Standard
    --]]
    { 'NODATA_T', 1.0, 0.3, 10.0 },
    --[[
      // @Param: ECHO_CLOSE
      // @DisplayName: Echowing close distance
      // @Description: Too close: the range minus the distance that still closes before the vehicle stops is under this. Any range under 1 m is too close
      // @Range: 0.5 4
      // @Units: m
      // @User: Standard
    --]]
    { 'CLOSE', 1.5, 0.5, 4.0 },
    --[[
      // @Param: ECHO_DELAY
      // @DisplayName: Echowing reaction delay
      // @Description: Time from a reading until the vehicle reacts: sonar, wire and attitude. Used for the closing distance
      // @Range: 0.1 2
      // @Units: s
      // @User: Advanced
    --]]
    { 'DELAY', 0.6, 0.1, 2.0 },
    --[[
      // @Param: ECHO_DECEL
      // @DisplayName: Echowing braking
      // @Description: Deceleration that the vehicle reaches. Used for the closing distance
      // @Range: 0.5 10
      // @Units: m/s/s
      // @User: Advanced
    --]]
    { 'DECEL', 2.5, 0.5, 10.0 },
    --[[
      // @Param: ECHO_RATE
      // @DisplayName: Echowing rate limit
      // @Description: Laws 1 and 2: highest rate of change of the speed limit, except when too close. 0: no rate limit
      // @Range: 0 20
      // @Units: m/s/s
      // @User: Advanced
    --]]
    { 'RATE', 4.0, 0.0, 20.0 },
    --[[
      // @Param: ECHO_STREAM_T
      // @DisplayName: Echowing stream watchdog
      // @Description: The applet holds the vehicle where it is when a stream of guided points stops for this long. 0: no watchdog
      // @Range: 0 10
      // @Units: s
      // @User: Standard
    --]]
    { 'STREAM_T', 1.0, 0.0, 10.0 },
    --[[
      // @Param: ECHO_SWITCH
      // @DisplayName: Echowing switch
      // @Description: RC option (RCx_OPTION) of the switch that must be high. 0: no switch
      // @Values: 0:None,300:Scripting1,301:Scripting2,302:Scripting3,303:Scripting4,304:Scripting5,305:Scripting6,306:Scripting7,307:Scripting8
      // @User: Standard
    --]]
    { 'SWITCH', 0, 0, 307 },
    --[[
      // @Param: ECHO_LOG_HZ
      // @DisplayName: Echowing log rate
      // @Description: Rate of the ECHO messages in the dataflash log. 0: none
      // @Range: 0 20
      // @Units: Hz
      // @User: Advanced
    --]]
    { 'LOG_HZ', 10, 0, 20 },
    --[[
      // @Param: ECHO_ARM_CHK
      // @DisplayName: Echowing arming check
      // @Description: Refuses arming while the applet is enabled and the forward rangefinder is missing or is not a MAVLink rangefinder, or another script sets the speed
      // @Values: 0:Disabled,1:Enabled
      // @User: Standard
    --]]
    { 'ARM_CHK', 1, 0, 1 },
    --[[
      // @Param: ECHO_INSET
      // @DisplayName: Echowing sonar inset
      // @Description: Distance between the two vehicles' centres minus what the sonar reads. The sonar's face is ahead of the follower's centre, and the leader's legs, which reflect, are around its centre
      // @Range: 0 1
      // @Units: m
      // @User: Standard
    --]]
    { 'INSET', 0.2, 0.0, 1.0 },
    --[[
      // @Param: ECHO_MIRROR
      // @DisplayName: Echowing mirror of the pilot's speed
      // @Description: The pilot's value of the speed parameter, in its own unit, while the applet is in control; 0 otherwise. The applet writes it, so that a restarted script can restore the speed parameter
      // @Range: 0 5000
      // @ReadOnly: True
      // @User: Advanced
    --]]
    { 'MIRROR', 0, 0, 5000 },
    --[[
      // @Param: ECHO_FORMAT
      // @DisplayName: Echowing point format
      // @Description: Format of the guided points that the applet understands. For another one update the applet or the ground tool
      // @Range: 2 2
      // @ReadOnly: True
      // @User: Advanced
    --]]
    { 'FORMAT', 2, 2, 2 },
}

local C = {} -- values in force: C.DIST, ...
local parameters = { mirror = nil } -- the mirror is written by part "speed"
do
    local TABLE_KEY = 95 -- used by no script in ArduPilot's tree
    local PREFIX = 'ECHO_'
    local A_TURN = 3 -- read at each update: all of them within half a second in control, two seconds otherwise

    -- Columns of the table above. They take less heap than its rows, which are dropped after the start.
    local names, lowest, highest, objects = {}, {}, {}, {}
    local complained = {}
    local next_number = 1

    -- Uses the new value of parameter number i if it is in its range (NaN is not); else keeps the value in use.
    local function read(i)
        local name, value = names[i], objects[i]:get()
        if value and value >= lowest[i] and value <= highest[i] then
            C[name] = value
            complained[name] = nil
        elseif not complained[name] then
            complained[name] = true
            say(SEVERITY.WARNING, string.format('%s%s out of range, using %.2f', PREFIX, name, C[name]))
        end
    end

    function parameters.read_some()
        for _ = 1, A_TURN do
            read(next_number)
            next_number = next_number % (#names - 2) + 1 -- all but the last two, which the applet writes
            if next_number == 1 then C.SPD_MAX = math.max(C.SPD_MAX, C.SPD_MIN) end
        end
    end

    -- When a script restarts, values that were not saved return to their defaults as the table is added again.
    local left_in_mirror = param:get(PREFIX .. 'MIRROR')
    local taken = TEXT .. 'parameter table key ' .. TABLE_KEY .. ' is taken'
    assert(param:add_table(TABLE_KEY, PREFIX, #PARAMETERS), taken)
    for i, row in ipairs(PARAMETERS) do
        assert(param:add_param(TABLE_KEY, i, row[1], row[2]), TEXT .. 'cannot add ' .. PREFIX .. row[1])
        names[i], C[row[1]], lowest[i], highest[i] = table.unpack(row)
        objects[i] = Parameter(PREFIX .. row[1])
    end
    objects[#objects]:set(POINT_FORMAT)
    for i = 1, #names do read(i) end
    C.SPD_MAX = math.max(C.SPD_MAX, C.SPD_MIN)
    parameters.mirror = objects[#objects - 1]
    if left_in_mirror then parameters.mirror:set(left_in_mirror) end
end

-- The parts and their state -------------------------------------------------------------------------------------------

-- Speeds are along the nose, where the sonar looks. Times are in ms; nil is "never".
local own = { mps = 0.0, accel_mps2 = 0.0, at_ms = nil } -- this vehicle's motion
local track = { -- what the sonar reads (averages, single readings), and where the leader is by that, and how fast
    raw_m = nil, raw_ms = nil, board_ms = 0, late_ms = 0, quickest_ms = 0, dated = 0,
    range_m = nil, leader_mps = 0.0, seen_mps = 0.0, leader_mps2 = 0.0, own_mps = 0.0, at_ms = 0,
    seen_ms = 0, readings = 0, spike_m = nil, spike_ms = 0, spike_own_mps = 0.0, doubted = false,
    same_m = nil, same = 0, slowest_mps = 0.0, fastest_mps = 0.0, stuck = false,
}
local laws = { -- the range becomes a speed: the law's wish, and the same after the rate limit
    wish_mps = 0.0, speed_mps = 0.0, step_ms = 0, update_ms = 0, seen_ms = 0, data_ms = 0,
}
local hold = { active = false, mps = 0.0, at_ms = nil } -- moves points that carry a velocity along the beam
local guard = { too_close = false, evading = false, close_ms = 0 } -- keeps away from the leader
local stream = { -- the ground tool's guided points, and what happens when they end
    at_ms = nil, points = 0, sender = nil, heard_ms = nil, holding = false, stands = false, lat = nil, lng = nil,
    up_m = nil, north_mps = 0.0, east_mps = 0.0, yaw_rad = nil, yaw_rps = 0.0, moving = false, opens_m = 0.0,
    makes_way = false,
}
local speed = { -- the speed parameter: ours, the pilot's, another script's
    out_mps = 0.0, written = nil, pilot_units = nil, ground_units = nil, changes = {}, conflict = false,
}
local report = { -- what pilots see
    state = STATE.OFF, announced = STATE.OFF, announced_ms = {}, named_ms = nil, log_ms = nil,
}
local control = { -- takes control and hands back
    active = false, error = nil, deaf = false, NO_PLACE = 'other scripts leave no place to receive',
}
local refused = { count = 0, last_ms = {} } -- what was heard and not used, or not sent

-- Counts it, and tells the pilot; again only after a while without: radios damage messages all the time.
local AGAIN_MS = 30000
local function refuse(what)
    local last_ms = refused.last_ms[what]
    refused.count, refused.last_ms[what] = refused.count + 1, own.at_ms
    if not last_ms or own.at_ms - last_ms > AGAIN_MS then say(SEVERITY.WARNING, what .. ', not used') end
    return false
end

-- The way out --------------------------------------------------------------------------------------------------------

-- Every target and every speed that leaves the applet passes here: numbers, near, and no more than a copter can. What is
-- not goes nowhere. mps: the speed limit; nil: a target, with its velocity and acceleration or without either. False: it
-- was not sent, or the autopilot refused it.
local order
do
    local NEAR_M = 50.0 -- the leader is within the sonar's reach, and its point within a second's flight of it
    local ORIGIN_M = 1e5 -- no copter flies further from where its estimator began
    local HARDEST_MPS2, FASTEST_RPS = 10.0, 4.0 -- as the highest ECHO_DECEL; no copter's nose turns faster
    local TURN_RAD = 2.0 * math.pi -- the autopilot takes a yaw of up to 360 degrees

    local function is_near(position)
        local here = ahrs:get_relative_position_NED_origin()
        if not here then return false end
        here:x(position:x() - here:x())
        here:y(position:y() - here:y())
        here:z(position:z() - here:z())
        return is_within(here:length(), NEAR_M) and is_within(position:length(), ORIGIN_M)
    end

    function order(mps, position, velocity, acceleration, look_rad, turn_rps)
        if mps then
            if not is_within(mps, FASTEST_MPS) or mps <= 0.0 then return refuse('implausible speed') end
            vehicle:set_desired_speed(mps)
            return true
        end
        if not (is_near(position) and is_within(look_rad, TURN_RAD)) then return refuse('implausible target') end
        local yaw_deg = math.deg(look_rad)
        if not velocity then return vehicle:set_target_pos_NED(position, true, yaw_deg, false, 0.0, false, false) end
        if not (is_within(velocity:length(), FASTEST_MPS) and is_within(acceleration:length(), HARDEST_MPS2)
            and is_within(turn_rps, FASTEST_RPS)) then return refuse('implausible target') end
        return vehicle:set_target_posvelaccel_NED(position, velocity, acceleration, true, yaw_deg, turn_rps ~= 0.0,
            math.deg(turn_rps), false)
    end
end

-- This vehicle's motion ----------------------------------------------------------------------------------------------

do
    local ACCEL_MS = 100 -- smooths the estimator's change of speed
    local STANDS_MPS, STANDS_MPS2 = 0.3, 1.0 -- below both, it stands
    -- Until it leans against its motion. ArduCopter 4.8 stood 2.3 s after a link was lost; with 0.5 s here it crept on
    -- (3.5 s), with 0.35 s and with 0.15 s it swung back (2.6 and 2.4 s).
    local LEAN_S = 0.25

    -- Own speed along the heading; 0 while the estimator has none.
    local function forward_speed()
        local velocity = ahrs:get_velocity_NED()
        if not velocity then return 0.0 end
        local yaw = yaw_rad(ahrs)
        local forward_mps = velocity:x() * math.cos(yaw) + velocity:y() * math.sin(yaw)
        return is_within(forward_mps, FASTEST_MPS) and forward_mps or 0.0
    end

    -- Own speed and how it is changing: smoothed, and no more than the vehicle can.
    function own.update(t_ms)
        local mps = forward_speed()
        local dt_ms = own.at_ms and t_ms - own.at_ms or math.maxinteger
        if dt_ms > IDLE_MS then
            own.accel_mps2 = 0.0 -- too long ago to compare with
        elseif dt_ms > 0 then
            local change_mps2 = clamp((mps - own.mps) * 1000.0 / dt_ms, -C.DECEL, C.DECEL)
            own.accel_mps2 = own.accel_mps2 + (change_mps2 - own.accel_mps2) * dt_ms / (dt_ms + ACCEL_MS)
        end
        own.mps, own.at_ms = mps, t_ms
    end

    -- Guided would turn the nose, and with it the sonar, towards a target without a yaw. False: refused.
    local function fly_to(position, north_m, east_m)
        position:x(position:x() + north_m)
        position:y(position:y() + east_m)
        -- In the way that it is flown: Guided starts another with the lean of the moment for its steady part, and a
        -- vehicle that brakes or speeds up would swing by metres.
        if stream.moving then return order(nil, position, Vector3f(), Vector3f(), yaw_rad(ahrs), 0.0) end
        return order(nil, position, nil, nil, yaw_rad(ahrs))
    end

    -- Flies to a place so far straight back, at this height, looking where it looks now.
    function own.fly_back(back_m)
        local position = ahrs:get_relative_position_NED_origin()
        if not position then return false end
        local yaw = yaw_rad(ahrs)
        return fly_to(position, -back_m * math.cos(yaw), -back_m * math.sin(yaw))
    end

    -- Whether it has come to rest, but for what the estimator is off: one that still leans only turns round.
    function own.stands()
        if math.abs(own.accel_mps2) > STANDS_MPS2 then return false end
        local velocity = ahrs:get_velocity_NED()
        if not velocity then return false end
        local north_mps, east_mps = velocity:x(), velocity:y()
        return north_mps * north_mps + east_mps * east_mps < STANDS_MPS * STANDS_MPS
    end

    -- Metres to a stop from a speed, which goes on changing at a rate until the vehicle leans against its motion.
    local function stopping_m(mps, mps2)
        local then_mps = math.max(0.0, mps + mps2 * LEAN_S)
        return 0.5 * (mps + then_mps) * LEAN_S + then_mps * then_mps / (2.0 * C.DECEL)
    end

    -- Stays where it comes to a stop: a place it has to come back to would take longer.
    function own.stop()
        local position, velocity = ahrs:get_relative_position_NED_origin(), ahrs:get_velocity_NED()
        if not (position and velocity) then return false end
        local north_mps, east_mps = velocity:x(), velocity:y()
        local mps = math.sqrt(north_mps * north_mps + east_mps * east_mps)
        if not is_within(mps, FASTEST_MPS) or mps < 0.01 then return fly_to(position, 0.0, 0.0) end
        local share = stopping_m(mps, own.accel_mps2 * own.mps / mps) / mps
        return fly_to(position, share * north_mps, share * east_mps)
    end
end

-- Sonar track --------------------------------------------------------------------------------------------------------

do
    local RAW_FRESH_MS = 300 -- an older single reading is not "the newest": 3 periods of the slower sonar rate
    local RAW_NAME = 'SNR_RAW\0\0\0' -- ten characters on the wire
    local SAME_READINGS, SAME_MPS = 8, 0.3 -- so many readings that are the same, and a change of the own speed meanwhile
    local DATED_READINGS = 16 -- so many tell what the board's clock differs by
    local LATEST_MS = 1000 -- no reading waits so long: the board, or its link, has started anew
    -- A single reading this far from the prediction, or after so long without one, waits for a second one like it:
    -- readings 0.1 s apart differ by less even where both vehicles change their speed at 5 m/s2.
    local SPIKE_M, SPIKE_MS = 0.15, 300
    local MOST_MPS = 5.0 -- two vehicles close no faster
    local JUMP_M = 0.6 -- a leader's speed wrong by 1 m/s, for about as long as its track is carried on
    -- So many readings in agreement are a target; one that did not agree takes one of them off, of so many at the most.
    local TRUST_READINGS, KNOWN_READINGS = 3, 6
    local TRACK_GAP_MS = 700 -- after a gap this long the tracker starts again
    local READING_S = 0.05 -- age of a single reading as it is sent, and what the wire takes at the least
    -- The leader's acceleration is noise of the sonar (1 cm) within the first, and no copter brakes harder than the
    -- second. It needs readings enough.
    local NOISE_MPS2, HARDEST_MPS2, SETTLED_READINGS = 0.8, 4.0, 5
    -- A leader for which the slot was opened, near and braking when it was lost, goes on braking until it stands, or to
    -- this speed if it flew back already, for as long as the ground tool does not know of it yet (1 s of radio). Braking is
    -- more than what a corner takes of the speed along the beam (1 m/s2 at 2 m/s). Without the opened slot the leader is
    -- on a mission, or slow, and most likely flies round a corner.
    local UNSEEN_MS, KNOWN_MS, BACK_MPS, CORNER_MPS2 = 150, 1000, -2.0, 1.5

    -- Distance by the rangefinder's running average, nil where it is no measurement; and the status. All distances here
    -- are between the two vehicles' centres.
    function track.average()
        local status = rangefinder:status_orient(FORWARD)
        if status ~= STATUS_GOOD and status ~= STATUS_LOW then return nil, status end
        local range_m
        if rangefinder.distance_orient then
            range_m = rangefinder:distance_orient(FORWARD)
        else
            range_m = rangefinder:distance_cm_orient(FORWARD) / 100.0
        end
        if not is_within(range_m, FURTHEST_M) or range_m < 0.0 or (range_m == 0.0 and status == STATUS_GOOD) then
            return nil, status
        end
        return range_m + C.INSET, status
    end

    -- Whether a range, centre to centre, is one of a target.
    function track.is_target(range_m)
        return range_m ~= nil and range_m < C.DETECT + C.INSET
    end

    -- The newest single reading, nil if it is old.
    function track.newest(t_ms)
        return track.raw_ms and t_ms - track.raw_ms <= RAW_FRESH_MS and track.raw_m or nil
    end

    -- What the two clocks differ by, told anew: the readings before are dated by it too.
    local function set_clock(late_ms)
        local shift_ms = late_ms - track.late_ms
        track.late_ms, track.seen_ms, track.spike_ms = late_ms, track.seen_ms + shift_ms, track.spike_ms + shift_ms
    end

    -- When a reading was taken, by the applet's clock: readings wait for the wire and for the applet, most of them longer
    -- than the quickest, and a speed told from their arrival would be off by metres per second. The quickest of the last
    -- 16 to 32 tells: a board whose clock is 1 % slow is 32 ms off then.
    local function taken_ms(board_ms, t_ms)
        local late_ms = t_ms - board_ms
        local goes_on = board_ms > track.board_ms and is_within(late_ms - track.late_ms, LATEST_MS)
        track.board_ms = board_ms
        if not goes_on then track.late_ms, track.quickest_ms, track.dated = late_ms, late_ms, 0 end
        track.quickest_ms, track.dated = math.min(track.quickest_ms, late_ms), track.dated + 1
        if late_ms < track.late_ms then set_clock(late_ms) end
        if track.dated >= DATED_READINGS then
            set_clock(track.quickest_ms)
            track.quickest_ms, track.dated = late_ms, 0
        end
        return board_ms + track.late_ms
    end

    -- Whether the sonar is stuck: readings stay the same to the centimetre while this vehicle changes its speed, and no
    -- leader flies so exactly alike. Of themselves no more than four in a row are the same.
    local function is_stuck(range_m)
        if range_m ~= track.same_m then
            track.same_m, track.same, track.slowest_mps, track.fastest_mps = range_m, 0, own.mps, own.mps
        end
        track.same = track.same + 1
        track.slowest_mps = math.min(track.slowest_mps, own.mps)
        track.fastest_mps = math.max(track.fastest_mps, own.mps)
        return track.same >= SAME_READINGS and track.fastest_mps - track.slowest_mps > SAME_MPS
    end

    function track.take(payload, t_ms)
        local board_ms, value, name = string.unpack('<I4fc10', payload)
        if name ~= RAW_NAME then return end
        if not is_within(value, FURTHEST_M) or value <= 0.0 then return refuse('implausible reading') end
        track.raw_m, track.raw_ms = value + C.INSET, taken_ms(board_ms, t_ms)
        local stuck = is_stuck(track.raw_m) and track.is_target(track.raw_m)
        if stuck and not track.stuck then say(SEVERITY.WARNING, 'sonar stuck, not used') end
        track.stuck = stuck
        if stuck then
            track.range_m, track.readings = nil, 0
        elseif track.is_target(track.raw_m) then
            track.update(track.raw_m, track.raw_ms, t_ms)
        elseif track.readings < TRUST_READINGS then
            track.range_m = nil -- what was seen before was a wild reading
        end
    end

    -- Range of the target, the leader's speed along the line of sight, and its acceleration: a critically damped observer
    -- that knows the own speed, so that own braking is not taken for the leader's.
    local function start(range_m, read_ms, t_ms)
        track.range_m, track.leader_mps, track.own_mps, track.at_ms = range_m, own.mps, own.mps, t_ms
        track.seen_ms, track.readings = read_ms, 1
        track.seen_mps, track.leader_mps2 = own.mps, 0.0
    end

    -- While it backs off the nose is up and the sonar often sees nothing: a leader lost while near is near until the
    -- sonar shows otherwise, for as long as the track can be carried on.
    local function fresh(t_ms)
        if not track.range_m then return false end
        local near = guard.evading or (hold.active and track.range_m < stream.distance_m())
        return t_ms - track.seen_ms <= (near and BLIND_MS or TRACK_GAP_MS)
    end

    -- Two wild readings in a row happen; three that agree are a target.
    function track.trusted(t_ms)
        return fresh(t_ms) and track.readings >= TRUST_READINGS
    end

    -- How hard the leader brakes, or speeds up towards this vehicle, by what was seen last: 0 or less.
    function track.braking_mps2(t_ms)
        local counts_ms = stream.is_opened() and KNOWN_MS or RAW_FRESH_MS
        if t_ms - track.seen_ms > counts_ms or track.leader_mps2 > -NOISE_MPS2 then return 0.0 end
        return math.max(-HARDEST_MPS2, track.leader_mps2)
    end

    -- The leader's speed, carried on over dt_s to a moment that long after a reading. Not seen, it speeds up no further.
    local function carried_mps(unseen_ms, t_ms, dt_s)
        if unseen_ms <= UNSEEN_MS then return track.leader_mps + track.leader_mps2 * dt_s end
        if unseen_ms > KNOWN_MS then return track.seen_mps end
        local least_mps = track.seen_mps > 0.0 and 0.0 or BACK_MPS
        local near = track.range_m < stream.distance_m() and track.leader_mps > least_mps
        if not near or track.braking_mps2(t_ms) > -CORNER_MPS2 then
            return math.min(track.leader_mps, track.seen_mps)
        end
        return math.max(least_mps, track.leader_mps + track.braking_mps2(t_ms) * dt_s)
    end

    -- The leader is not seen, and flies so fast by what the ground tool knows.
    function track.told(leader_mps)
        track.leader_mps, track.seen_mps = leader_mps, leader_mps
    end

    -- Carries the range on to now.
    function track.carry(t_ms)
        if not track.range_m then return end
        local dt_s = (t_ms - track.at_ms) * 0.001
        local leader_mps = carried_mps(t_ms - track.seen_ms, t_ms, dt_s)
        track.range_m = track.range_m + 0.5 * (track.leader_mps + leader_mps - track.own_mps - own.mps) * dt_s
        track.leader_mps, track.own_mps, track.at_ms = leader_mps, own.mps, t_ms
    end

    -- How old a reading is now.
    local function age_s(read_ms, t_ms)
        return READING_S + (t_ms - read_ms) * 0.001
    end

    -- A reading that was not foreseen waits for another one like it.
    local function wait(range_m, read_ms)
        track.spike_m, track.spike_ms, track.spike_own_mps = range_m, read_ms, own.mps
        if track.readings >= TRUST_READINGS then track.readings = math.min(track.readings, KNOWN_READINGS) - 1 end
    end

    -- Whether it is like the one that waits, nearly the same range shortly after it; and the time between them.
    local function is_second(range_m, read_ms)
        if not track.spike_m then return false end
        local dt_s = (read_ms - track.spike_ms) * 0.001
        return dt_s > 0.0 and dt_s < SPIKE_MS * 0.001 and
            math.abs(range_m - track.spike_m) < SPIKE_M + MOST_MPS * dt_s, dt_s
    end

    -- A known leader does not jump so far: two alike may be late echoes of something else, and three are believed.
    local function is_doubtful(jump_m, read_ms)
        local unseen_s = math.min(read_ms - track.seen_ms, TRACK_GAP_MS) * 0.001
        return not track.doubted and track.readings >= TRUST_READINGS and
            jump_m > JUMP_M + 0.5 * HARDEST_MPS2 * unseen_s * unseen_s
    end

    -- A reading that was not foreseen counts only when the next one is like it: propellers make single wild ones. The two
    -- tell range and rate anew, with the own speed between them.
    local function unforeseen(range_m, read_ms, t_ms, jump_m)
        local second, dt_s = is_second(range_m, read_ms)
        local third = track.doubted
        track.doubted = second and is_doubtful(jump_m, read_ms)
        if track.doubted or not second then return wait(range_m, read_ms) end
        local rate_mps = clamp((range_m - track.spike_m) / dt_s, -MOST_MPS, MOST_MPS)
        track.leader_mps = rate_mps + 0.5 * (track.spike_own_mps + own.mps) - own.accel_mps2 * READING_S
        track.range_m = range_m + (track.leader_mps - own.mps) * age_s(read_ms, t_ms)
        track.own_mps, track.at_ms, track.seen_ms = own.mps, t_ms, read_ms
        track.seen_mps, track.leader_mps2 = track.leader_mps, 0.0
        -- Two alike may still be wild ones, until a third is foreseen.
        local trusted = third or track.readings >= TRUST_READINGS
        track.readings, track.spike_m = trusted and TRUST_READINGS or 2, nil
    end

    -- Takes a range that was read at read_ms; now it is t_ms.
    function track.update(range_m, read_ms, t_ms)
        if not fresh(t_ms) then
            local second = is_second(range_m, read_ms)
            start(range_m, read_ms, t_ms)
            return (second and unforeseen or wait)(range_m, read_ms, t_ms, 0.0)
        end
        local dt_s = (read_ms - track.seen_ms) * 0.001
        if dt_s <= 0.0 then return end
        track.carry(t_ms)
        local aged_s = age_s(read_ms, t_ms)
        local residual_m = range_m + (track.leader_mps - own.mps) * aged_s - track.range_m
        if math.abs(residual_m) > SPIKE_M or dt_s > SPIKE_MS * 0.001 then
            return unforeseen(range_m, read_ms, t_ms, math.abs(residual_m))
        end
        local keep = math.exp(-dt_s / C.TAU)
        local lose = 1.0 - keep
        local n = track.readings + 1 -- the first readings count as in a straight line through all of them
        local range_share = math.max(1.0 - keep * keep * keep, 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)))
        local rate_share = math.max(1.5 * lose * lose * (1.0 + keep), 6.0 / (n * (n + 1.0)))
        local change_mps = rate_share / dt_s * residual_m
        -- The rate is that of the reading's time: the range of now changes with it. Left out, the next reading corrects for
        -- it once more, and the observer swings; from 0.14 s of age on it swings ever wider.
        track.range_m = track.range_m + range_share * residual_m + change_mps * aged_s
        track.leader_mps = track.leader_mps + change_mps
        if n > SETTLED_READINGS then
            track.leader_mps2 = track.leader_mps2 + lose * lose * lose / (dt_s * dt_s) * residual_m
        end
        track.seen_mps = track.leader_mps
        track.seen_ms, track.readings, track.spike_m = read_ms, n, nil
    end
end

-- Laws ---------------------------------------------------------------------------------------------------------------

do
    -- Change of speed for a range, thesis Appendix A and Table 6.
    local function band_change(range_m)
        if range_m >= C.DIST + C.BAND_OUT then return C.STEP_BIG end
        if range_m >= C.DIST + C.BAND_IN then return C.STEP_SML end
        if range_m >= C.DIST - C.BAND_IN then return 0.0 end
        if range_m >= C.DIST - C.BAND_OUT then return -C.STEP_SML end
        return -C.STEP_BIG
    end

    -- Law 0, Appendix A: one step. A step that would reach a limit is refused.
    local function thesis_step(speed_mps, range_m)
        local change_mps = band_change(range_m)
        local new_mps = speed_mps + change_mps
        if change_mps > 0.0 and new_mps >= C.SPD_MAX then return speed_mps end
        if change_mps < 0.0 and new_mps <= C.SPD_MIN then return speed_mps end
        return new_mps
    end

    -- Law 1: the same step, which stops at the limits instead of being refused.
    local function band_step(speed_mps, range_m)
        return clamp(speed_mps + band_change(range_m), C.SPD_MIN, C.SPD_MAX)
    end

    -- Law 2: the leader's speed along the line of sight, a share of the range error, and a share of its rate, which
    -- stands for where the error will be once the vehicle has answered.
    local function continuous_speed(range_m, rate_mps, leader_mps)
        local wanted_m = stream.distance_m()
        return clamp(leader_mps + C.GAIN_P * (range_m - wanted_m) + C.GAIN_D * rate_mps, C.SPD_MIN, C.SPD_MAX)
    end

    -- The law's wish for this update.
    local function run(range_m, t_ms)
        if C.LAW >= 2 then
            if not track.trusted(t_ms) then return end
            laws.wish_mps = continuous_speed(track.range_m, track.leader_mps - own.mps, track.leader_mps)
            return
        end
        if t_ms - laws.step_ms < C.PERIOD * 1000.0 then return end
        laws.step_ms = t_ms
        laws.wish_mps = C.LAW < 1 and thesis_step(laws.wish_mps, range_m) or band_step(laws.wish_mps, range_m)
    end

    -- Detection gate: a range at or beyond the limit is no target; what a lost target or a silent sonar means.
    local function gate(range_m, status, t_ms)
        if status > STATUS_NO_DATA then laws.data_ms = t_ms end
        report.state = STATE.TRACKING
        if track.is_target(range_m) then
            laws.seen_ms = t_ms
            run(range_m, t_ms)
            return
        end
        laws.step_ms = t_ms -- the next average begins when the target is back
        if t_ms - laws.data_ms >= C.NODATA_T * 1000.0 then
            laws.wish_mps = C.SPD_LOST
            report.state = STATE.NO_SONAR
        elseif t_ms - laws.seen_ms >= C.LOST_T * 1000.0 and t_ms - guard.close_ms >= BLIND_MS then
            if C.LAW >= 1 then laws.wish_mps = C.SPD_LOST end
            report.state = STATE.SEARCHING
        end
    end

    local function limit_rate(t_ms)
        laws.wish_mps = clamp(laws.wish_mps, C.SPD_MIN, C.SPD_MAX)
        local most_mps = C.RATE * (t_ms - laws.update_ms) * 0.001
        if C.LAW < 1 or C.RATE <= 0.0 then
            laws.speed_mps = laws.wish_mps
        else
            laws.speed_mps = laws.speed_mps + clamp(laws.wish_mps - laws.speed_mps, -most_mps, most_mps)
        end
        laws.speed_mps = clamp(laws.speed_mps, C.SPD_MIN, C.SPD_MAX)
    end

    function laws.begin(t_ms)
        laws.step_ms, laws.update_ms, laws.seen_ms, laws.data_ms = t_ms, t_ms, t_ms, t_ms
        laws.speed_mps = clamp(C.SPD_INIT, C.SPD_MIN, C.SPD_MAX)
        laws.wish_mps = laws.speed_mps
    end

    -- Computes the speed from the average and its status.
    function laws.update(range_m, status, t_ms)
        gate(range_m, status, t_ms)
        limit_rate(t_ms)
        laws.update_ms = t_ms
    end
end

-- Guard: too close wins over every law -------------------------------------------------------------------------------

do
    local HARD_CLOSE_M = 1.0 -- under this it is too close, closing or not
    local CLEAR_M = 0.3 -- too close ends this far beyond where it began
    local CLOSING_MPS = 0.15 -- slower is noise of the tracker (1 cm steps at 10 Hz)
    local EVADE_LEAST_M, EVADE_MOST_M = 0.5, 5.0 -- how far back a target away from the leader lies
    local ANSWER_S = 0.1 -- so long a lean takes to follow its command
    local JERK_MPS3 = 5.0 -- PSC_JERK_NE (PSC_JERK_XY) as it comes

    -- Distance still closed at this rate before the vehicle stops. An acceleration that is under way goes on until the
    -- answer begins, and then dies away at the autopilot's jerk: until then the closing speed rises by
    -- a * ANSWER_S + a^2 / (2 JERK).
    local function closing_distance(closing_mps)
        local a = math.max(0.0, own.accel_mps2)
        local peak_mps = math.max(0.0, closing_mps + a * ANSWER_S + 0.5 * a * a / JERK_MPS3)
        return peak_mps * C.DELAY + peak_mps * peak_mps / (2.0 * C.DECEL)
    end

    -- The closing speed from which the vehicle still stops at the close distance: the inverse of the above without
    -- acceleration.
    function guard.stoppable_mps(range_m)
        local lag_mps = C.DECEL * C.DELAY
        return math.sqrt(lag_mps * lag_mps + 2.0 * C.DECEL * math.max(0.0, range_m - C.CLOSE)) - lag_mps
    end

    -- Metres that a place lies ahead (along the heading) of the vehicle, and how far away it is.
    local function ahead_m(here, lat, lng)
        local target = here:copy()
        target:lat(lat)
        target:lng(lng)
        local offset = here:get_distance_NE(target)
        local yaw = yaw_rad(ahrs)
        return offset:x() * math.cos(yaw) + offset:y() * math.sin(yaw), here:get_distance(target)
    end

    -- Metres that the target in force lies behind the vehicle, away from the leader; 0 if it leads towards the leader.
    local function target_behind_m(here, t_ms)
        if stream.in_force(t_ms) then
            local yaw = yaw_rad(ahrs)
            if stream.north_mps * math.cos(yaw) + stream.east_mps * math.sin(yaw) > 0.0 then return 0.0 end
            return math.max(0.0, -ahead_m(here, stream.lat, stream.lng))
        end
        local target = vehicle:get_target_location()
        return target and math.max(0.0, -ahead_m(here, target:lat(), target:lng())) or 0.0
    end

    -- Whether the streamed target leads clear of the leader: back, or more than 60 degrees to the side of where the
    -- sonar looks. The limit is against coming nearer, never against getting away.
    local function leads_clear(t_ms)
        if not stream.in_force(t_ms) then return false end
        local here = vehicle:get_likely_flying() and ahrs:get_location()
        if not here then return false end
        local to_m, distance_m = ahead_m(here, stream.lat, stream.lng)
        return distance_m > EVADE_LEAST_M and to_m < 0.5 * distance_m
    end

    -- The shorter of the newest single reading and the average.
    local function nearest(range_m, t_ms)
        local raw_m = track.newest(t_ms)
        if not track.is_target(raw_m) then raw_m = nil end
        if raw_m and range_m then return math.min(raw_m, range_m) end
        return raw_m or range_m
    end

    -- The law's speed is not beyond this, and the wish is not kept for later.
    local function allow_no_more(speed_mps)
        laws.wish_mps, laws.speed_mps = math.min(laws.wish_mps, speed_mps), math.min(laws.speed_mps, speed_mps)
    end

    local function is_too_close(near_m, closing_mps, margin_m)
        if near_m < HARD_CLOSE_M + margin_m then return true end
        return near_m - closing_distance(closing_mps) < C.CLOSE + margin_m
    end

    -- Whether to fly a target of the applet's own away from the leader: it is still closing, and the target in force
    -- does not lead away fast enough (Guided flies about 1 m/s for each metre to its target).
    local function should_back_off(behind_m, near_m, closing_mps)
        local approach_mps = -track.leader_mps
        if guard.evading then return approach_mps > CLOSING_MPS or closing_mps > 0.0 end
        if closing_mps <= CLOSING_MPS or behind_m > math.max(EVADE_LEAST_M, approach_mps) then return false end
        return approach_mps > CLOSING_MPS or near_m < C.CLOSE or near_m - closing_distance(closing_mps) < HARD_CLOSE_M
    end

    -- Too close and the track agrees: the state, backing off, and the law starts again from the bottom.
    local function too_close(near_m, closing_mps, t_ms)
        guard.too_close, guard.close_ms = true, t_ms
        report.state = STATE.TOO_CLOSE
        if C.LAW >= 1 then allow_no_more(C.SPD_MIN) end
        -- Half a metre lower than points lead (flight/lowest.py) what is near is most likely the ground.
        local LOWEST_M = 2.0
        local up = vehicle:get_likely_flying() and -ahrs:get_relative_position_D_home() > LOWEST_M - 0.5
        local here = up and ahrs:get_location()
        local behind_m = here and target_behind_m(here, t_ms) or 0.0
        -- Back to the wanted distance, and the leader's approach of one second more.
        local evaded = guard.evading
        guard.evading = here and should_back_off(behind_m, near_m, closing_mps) and own.fly_back(clamp(
            stream.distance_m() - near_m + math.max(0.0, -track.leader_mps), EVADE_LEAST_M, EVADE_MOST_M))
        if guard.evading then
            report.state = STATE.BACKING_OFF
            -- Sent at once: the ground tool would call it back to where it held it.
            if not evaded then report.named_ms = nil end
        end
        if guard.evading or behind_m > EVADE_LEAST_M then return C.SPD_MAX end -- free to get away
        return C.SPD_MIN
    end

    function guard.begin(t_ms)
        guard.evading, guard.close_ms = false, t_ms - BLIND_MS
    end

    -- The distance is kept otherwise: nothing is too close, and no target of the guard's is in force.
    function guard.rest()
        guard.too_close, guard.evading = false, false
    end

    -- The speed to set, from the average and its status.
    function guard.update(range_m, status, t_ms)
        local trusted = track.trusted(t_ms)
        local closing_mps = trusted and own.mps - track.leader_mps or 0.0
        local tracked_m = trusted and track.range_m or nil
        local margin_m = guard.too_close and CLEAR_M or 0.0
        -- From a leader that comes (0.5 m/s) it backs off to the wanted distance: if it stopped as soon as it was as fast,
        -- it would begin anew from nearer, its nose and its sonar down.
        if status == STATUS_LOW or (tracked_m and (is_too_close(tracked_m, closing_mps, margin_m)
            or (guard.evading and track.leader_mps < -0.5 and tracked_m < stream.distance_m()))) then
            return too_close(tracked_m or 0.0, closing_mps, t_ms)
        end
        guard.rest()
        if C.LAW >= 1 and leads_clear(t_ms) then return C.SPD_MAX end
        local near_m = nearest(range_m, t_ms)
        -- Readings that are not yet trusted slow the vehicle, no more.
        if near_m and is_too_close(near_m, closing_mps, 0.0) then return C.SPD_MIN end
        -- Law 1 adds step to step for as long as the leader is far. Law 2 never wishes for so much, and law 0 is the
        -- thesis's.
        if tracked_m and C.LAW == 1 then
            allow_no_more(math.max(C.SPD_MIN, track.leader_mps + guard.stoppable_mps(tracked_m)))
        end
        return laws.speed_mps
    end
end

-- Hold: points that carry a velocity -----------------------------------------------------------------------------------

do
    -- How far the applet moves a point: little towards the leader, for the ground tool may know why the point is far
    -- from it; more away from the leader. A sonar that is stuck then moves the vehicle no further. The first also in m/s:
    -- one with a stuck sonar takes its own speed for its leader's.
    local FORWARD_M, BACK_M = 1.0, 5.0
    -- A leader on a mission that is lost in a corner: after the second time the tool's reports are newer than what was
    -- seen last. From then on it is carried on, from the place where it was seen, at the speed that the tool gives.
    local UNSEEN_MS, TOLD_MS = 300, 900
    local NOSE_LATE_S = 0.2 -- so much later than its attitude's target the nose turns (SITL 4.6 0.2 s, 4.8 0.25 s)
    -- Towards the leader: 8 degrees of lean, and what the air takes. Guided closes a gap of 0.4 m with all its acceleration
    -- (4.8, 5 m/s2), so a target is hardly ahead; what is left of the gap is flown by speed, 1 m/s for each metre.
    local GENTLE_MPS2, NEARER_M, CATCH_UP_PER_S, CATCH_UP_M = 1.4, 0.2, 1.0, 1.0
    local LEAD_S = 0.3 -- until this vehicle leans against its motion
    -- Too near to a leader for which the slot was not opened, and that does not fly back faster than this, a share of
    -- the distance is flown back: at a corner in full the vehicle would fly back from a leader that only turns, lean by
    -- it, and lose it.
    local EASE, TURNS_MPS = 0.4, -0.5

    -- Whether the leader most likely goes on with its mission.
    local function flies_on()
        return not stream.is_opened() and track.leader_mps > TURNS_MPS
    end

    local function eased(wanted_m)
        local in_full = not flies_on() or track.range_m < C.CLOSE
        return in_full and wanted_m or math.max(wanted_m, EASE * wanted_m)
    end

    -- Where the point belongs along the beam (metres ahead of here), and its speed there: at the wanted distance from
    -- the leader and as fast as the leader. ahead_m, mps: the same of the streamed point. While the sonar sees nothing,
    -- of the track and the point whichever is the more cautious.
    local function along_beam(ahead_m, mps, braking_mps2, t_ms)
        -- From where both will be once this vehicle leans.
        local wanted_m = track.range_m + 0.5 * braking_mps2 * LEAD_S * LEAD_S - stream.distance_m()
        local unseen_ms = t_ms - track.seen_ms
        if flies_on() and unseen_ms > TOLD_MS then track.told(mps) end
        if unseen_ms > UNSEEN_MS then
            wanted_m = math.max(math.min(wanted_m, ahead_m), ahead_m - BACK_M)
            return math.min(eased(wanted_m), ahead_m + FORWARD_M), math.min(track.leader_mps, mps)
        end
        wanted_m = eased(wanted_m)
        if wanted_m > ahead_m + FORWARD_M then return ahead_m + FORWARD_M, math.min(mps, track.leader_mps) end
        if wanted_m < ahead_m - BACK_M then return ahead_m - BACK_M, mps end
        return wanted_m, math.min(track.leader_mps, mps + FORWARD_M)
    end

    -- Towards the leader no faster than keeps it in the beam: a copter leans as it speeds up, and its sonar with it. Away
    -- from it at once.
    local function gently(t_ms, wanted_m, wanted_mps)
        local from_mps = hold.active and hold.mps or own.mps
        local most_mps = from_mps + GENTLE_MPS2 * math.min(t_ms - (hold.at_ms or t_ms), QUICK_MS * 5) * 0.001
        local catch_up_mps = CATCH_UP_PER_S * clamp(wanted_m - NEARER_M, 0.0, CATCH_UP_M)
        hold.mps, hold.at_ms = math.min(wanted_mps + catch_up_mps, most_mps), t_ms
        return math.min(wanted_m, NEARER_M), hold.mps
    end

    -- The ground tool leads it past another vehicle, which the applet does not know: the point as it is, but towards the
    -- leader no faster than it can still stop. Guided flies 1 m/s for each metre to the point, and its velocity.
    local function past_another(t_ms, ahead_m, mps)
        hold.mps, hold.at_ms = own.mps, t_ms
        return ahead_m, math.min(mps, track.leader_mps + guard.stoppable_mps(track.range_m) - ahead_m)
    end

    -- Sends Guided the streamed point, moved along the beam. False: it was not taken, or there is none.
    local function move(t_ms)
        local here = vehicle:get_likely_flying() and ahrs:get_location()
        local position = here and ahrs:get_relative_position_NED_origin()
        if not position then return false end
        local north_m, east_m = stream.offset(here, t_ms)
        if not north_m then return false end
        local yaw = yaw_rad(ahrs)
        local cos, sin = math.cos(yaw), math.sin(yaw)
        local ahead_m, mps = north_m * cos + east_m * sin, stream.north_mps * cos + stream.east_mps * sin
        -- A leader that brakes is answered with its own deceleration.
        local braking_mps2 = track.braking_mps2(t_ms)
        local wanted_m, wanted_mps
        if stream.makes_way then
            wanted_m, wanted_mps = past_another(t_ms, ahead_m, mps)
        else
            wanted_m, wanted_mps = gently(t_ms, along_beam(ahead_m, mps, braking_mps2, t_ms))
        end
        wanted_mps = wanted_mps + braking_mps2 * LEAD_S
        local by_m, by_mps = wanted_m - ahead_m, wanted_mps - mps
        position:x(position:x() + north_m + by_m * cos)
        position:y(position:y() + east_m + by_m * sin)
        if stream.up_m then position:z(position:z() - stream.up_m - ahrs:get_relative_position_D_home()) end
        local velocity, acceleration = Vector3f(), Vector3f()
        velocity:x(stream.north_mps + by_mps * cos)
        velocity:y(stream.east_mps + by_mps * sin)
        -- What it does not yet decelerate by itself: more than the lean can give, and Guided's own plan would wait.
        local missing_mps2 = math.max(braking_mps2, math.min(0.0, braking_mps2 - own.accel_mps2))
        acceleration:x(missing_mps2 * cos)
        acceleration:y(missing_mps2 * sin)
        -- After a leader that turns a corner with the rate, too: after a yaw alone Guided turns by ATC_INPUT_TC later, 0.15 s,
        -- 6 of the 20 degrees to the edge of the beam. One that flies back is too near for a rate from its estimated bearing.
        local yaw_rps = stream.yaw_rad and flies_on() and stream.yaw_rps or 0.0
        local look_rad = (stream.yaw_rad or yaw) + yaw_rps * ((t_ms - stream.at_ms) * 0.001 + NOSE_LATE_S)
        return order(nil, position, velocity, acceleration, look_rad, yaw_rps)
    end

    -- A point with no velocity at all is where the ground tool has stopped it: there it stays.
    function hold.is_wanted()
        return stream.moving and C.LAW >= 2 and (stream.north_mps ~= 0.0 or stream.east_mps ~= 0.0)
    end

    -- Whether the distance is held: points carry a velocity, and there is a leader to hold on to.
    function hold.update(t_ms)
        hold.active = hold.is_wanted() and track.trusted(t_ms) and move(t_ms)
        if not hold.active then return false end
        report.state = STATE.HOLDING
        if track.range_m < C.CLOSE then
            report.state = track.leader_mps < own.mps and STATE.BACKING_OFF or STATE.TOO_CLOSE
            guard.close_ms = t_ms
        end
        return true
    end
end

-- Stream watch -------------------------------------------------------------------------------------------------------

do
    local TARGET_FRESH_MS = 1000 -- an older streamed point is not the target in force
    local ABOVE_HOME = { [3] = true, [6] = true } -- MAV_FRAME_GLOBAL_RELATIVE_ALT and its _INT
    local MOST_OPEN_M = 6.0 -- as the highest ECHO_DIST
    -- What a point can say: degrees of latitude in 1e-7, metres above home, yaw from -pi to pi or from 0 to 2 pi, and a
    -- slot that opens for a vehicle that hardly brakes.
    local MOST_LAT, HIGHEST_M, MOST_YAW_RAD, MOST_OPENED_M = 900000000, 10000.0, 2.0 * math.pi, 1000.0
    local SILENT_MS = 1000 -- a sender of points that is silent for so long is gone
    local SOON_S, LATE_S = 0.05, 0.4 -- points nearer in time, or further, do not tell how fast the yaw turns
    local TURN_RPS = 1.0 -- as ATC_RATE_WPY_MAX, 60 deg/s
    local LENGTH = 3 -- so many points without a gap are a stream; one alone may be a pilot's click on the map

    -- How fast the streamed yaw turns: half of what was, for the leader's bearing is estimated.
    local function turned(before_rad, before_ms)
        local dt_s = before_ms and (stream.at_ms - before_ms) * 0.001 or 0.0
        local rate_rps = 0.0
        if stream.yaw_rad and before_rad and dt_s > SOON_S and dt_s < LATE_S then
            local turn_rad = (stream.yaw_rad - before_rad + math.pi) % (2.0 * math.pi) - math.pi
            rate_rps = clamp(turn_rad / dt_s, -TURN_RPS, TURN_RPS)
        end
        stream.yaw_rps = 0.5 * (stream.yaw_rps + rate_rps)
    end

    -- Whether a field that counts is one of a copter's: a number, and not beyond what there is.
    local function fits(counts, value, most)
        return not counts or is_within(value, most)
    end

    -- Points count from one sender until it has been silent: those of two would pull the vehicle to and fro.
    local function is_other(sender, t_ms)
        local other = sender ~= stream.sender and stream.heard_ms and t_ms - stream.heard_ms < SILENT_MS
        if not other then stream.sender, stream.heard_ms = sender, t_ms end
        return other
    end

    function stream.take(payload, sender, t_ms)
        local lat, lng, up_m, vn, ve, _, opens_m, makes_way, format, yaw, _, mask, system, _, frame =
            string.unpack('<i4i4fffffffffI2BBB', payload, 5)
        if system ~= 0 and system ~= MY_SYSTEM then return end
        local placed, moving, looks = mask & 0x0003 == 0, mask & 0x0018 == 0, mask & 0x0400 == 0
        local raised = mask & 0x0004 == 0 and ABOVE_HOME[frame]
        -- Of the acceleration, which the autopilot is told to ignore: how far the slot has opened, whether the tool leads
        -- it past another vehicle than the leader, and the format that says so.
        if moving and not (mask & 0x01C0 == 0x01C0 and format == POINT_FORMAT) then
            return refuse('points of another version of the tool')
        end
        if not (fits(placed, lat, MOST_LAT) and fits(placed, lng, 2 * MOST_LAT) and fits(raised, up_m, HIGHEST_M)
            and fits(moving, vn, FASTEST_MPS) and fits(moving, ve, FASTEST_MPS) and fits(looks, yaw, MOST_YAW_RAD)
            and fits(moving, opens_m, MOST_OPENED_M) and fits(moving, makes_way, 1.0)) then
            return refuse('implausible point')
        end
        if is_other(sender, t_ms) then return refuse('points of a second sender') end
        if stream.points < LENGTH then
            local gap = not stream.at_ms or t_ms - stream.at_ms > TARGET_FRESH_MS
            stream.points = gap and 1 or stream.points + 1
        end
        local before_ms, before_rad = stream.at_ms, stream.yaw_rad
        stream.at_ms = t_ms
        stream.lat, stream.lng = placed and lat or nil, placed and lng or nil
        stream.up_m, stream.yaw_rad = raised and up_m or nil, looks and yaw or nil
        turned(before_rad, before_ms)
        stream.moving = moving
        stream.opens_m = moving and math.min(opens_m, MOST_OPEN_M) or 0.0
        stream.makes_way = moving and makes_way == 1.0
        stream.north_mps, stream.east_mps = moving and vn or 0.0, moving and ve or 0.0
    end

    -- Whether the newest streamed point is the vehicle's target, and a place.
    function stream.in_force(t_ms)
        return not stream.holding and stream.at_ms and t_ms - stream.at_ms < TARGET_FRESH_MS and stream.lat
    end

    -- Whether the ground tool has opened the slot: the leader may turn round faster than one on a mission does.
    function stream.is_opened()
        return stream.distance_m() > C.DIST
    end

    -- The distance to keep, centre to centre: the ground tool opens the slot for a leader that can turn round faster than
    -- the vehicle gets away from ECHO_DIST.
    function stream.distance_m()
        return math.max(C.DIST, stream.at_ms and stream.opens_m or 0.0)
    end

    -- Where the point in force is now, seen from here: north and east in metres; nil without one.
    function stream.offset(here, t_ms)
        if not stream.in_force(t_ms) then return nil end
        local target = here:copy()
        target:lat(stream.lat)
        target:lng(stream.lng)
        local offset, age_s = here:get_distance_NE(target), (t_ms - stream.at_ms) * 0.001
        return offset:x() + stream.north_mps * age_s, offset:y() + stream.east_mps * age_s
    end

    function stream.begin()
        stream.at_ms, stream.points, stream.holding, stream.yaw_rps = nil, 0, false, 0.0
    end

    -- Holds the vehicle where it is once a stream of guided points has fallen silent.
    function stream.watch(t_ms)
        local silent = C.STREAM_T > 0.0 and stream.points >= LENGTH and t_ms - stream.at_ms > C.STREAM_T * 1000.0
        if not silent then
            stream.holding = false
            return
        end
        if not guard.too_close then report.state = STATE.STREAM_LOST end
        if guard.evading then
            stream.holding = false -- hold again where the evasion ends
            return
        end
        if stream.holding then
            -- One that was let fly slowly stands before its place, and would go on to it when the pilot's speed is back.
            if not stream.stands and own.stands() then stream.stands = own.stop() end
            return
        end
        stream.stands = own.stands()
        stream.holding = vehicle:get_likely_flying() and own.stop()
    end
end

-- MAVLink: points for the stream watch, single readings for the sonar track ------------------------------------------

-- Frames whose checksum is wrong reach scripts too, and the autopilot does not say which they are.
local take_messages
do
    local POINT, FLOAT = 86, 251 -- SET_POSITION_TARGET_GLOBAL_INT, NAMED_VALUE_FLOAT
    local CRC_EXTRA = { [POINT] = 5, [FLOAT] = 170 }
    local LONGEST = 53 -- bytes of the longer payload
    local WIDE_STRUCTURE = 299 -- bytes of mavlink_message_t where system ids have 32 bits; 291 where they have 8
    local MAVLINK_1, SIGNED = 0xFE, 1 -- the first byte on the wire; the one flag that changes nothing before the checksum
    local QUEUE = 10
    local REPEAT_MS = 10000

    local told_ms
    control.deaf = not pcall(function()
        mavlink:init(QUEUE, 2)
        mavlink:register_rx_msgid(POINT)
        mavlink:register_rx_msgid(FLOAT)
    end)

    -- Whether bytes that end with their checksum are whole (X.25, which is then 0): four bytes at a time. Zeros that follow
    -- change nothing.
    local function is_whole(bytes)
        local unpack, crc = string.unpack, 0xFFFF
        for i = 1, #bytes - 3, 4 do
            local q = unpack('<i4', bytes, i) ~ crc
            q = q ~ q << 4 ~ q << 11 ~ q << 16
            q = q ~ q << 8 ~ q << 22
            q = q ~ q << 16
            crc = q >> 16 ~ q >> 21 ~ q >> 28
        end
        return crc == 0
    end

    -- Id, sender and payload of a mavlink_message_t, the payload with the zeros that MAVLink 2 leaves out; nil for a message
    -- that is for another script, or damaged. Bytes that the checksum does not cover are not used.
    local function read(message)
        local sub, wide = string.sub, #message >= WIDE_STRUCTURE and 3 or 0
        local magic, length, flags = string.unpack('BBB', message, 3)
        local component, id = string.unpack('<BI3', message, 9 + wide)
        local extra = CRC_EXTRA[id]
        if not extra then return nil end
        local old = magic == MAVLINK_1
        if length > LONGEST or not (old or flags & ~SIGNED == 0) then return nil, refuse('damaged message') end
        local payload = sub(message, 13 + wide, 12 + wide + length)
        -- As on the wire: from the length to one byte of the system's id, its component, one or three bytes of message id.
        local sent = sub(message, 4, old and 4 or 6) .. sub(message, 7, 8)
            .. sub(message, 9 + wide, (old and 10 or 12) + wide) .. payload
        if not is_whole(sent .. string.char(extra) .. sub(message, 1, 2) .. '\0\0\0') then
            return nil, refuse('damaged message')
        end
        local system = string.byte(message, 8)
        return id, system, system << 8 | component, payload .. string.rep('\0', LONGEST - length)
    end

    -- No place was left: scripts that were there first have them all.
    local function tell(t_ms)
        if C.ENABLE < 1 or (told_ms and t_ms - told_ms < REPEAT_MS) then return end
        told_ms = t_ms
        say(SEVERITY.ERROR, control.NO_PLACE)
    end

    function take_messages(t_ms)
        if control.deaf then return tell(t_ms) end
        for _ = 1, QUEUE do
            local message = mavlink:receive_chan()
            if not message then return end
            local id, system, sender, payload = read(message)
            if id == POINT then
                stream.take(payload, sender, t_ms)
            elseif id and system == MY_SYSTEM then
                track.take(payload, t_ms)
            end
        end
    end
end

-- The speed parameter ------------------------------------------------------------------------------------------------

do
    local CONFLICT_CHANGES, CONFLICT_MS = 4, 10000 -- so many outside changes of the speed in this time: another script

    local parameter, mirror = Parameter(SPEED_NAME), parameters.mirror

    -- A value of the speed parameter, in its unit, that is a pilot's.
    local function is_speed(units)
        return is_within(units, FASTEST_MPS * SPEED_UNITS) and units > 0.0
    end

    function speed.is_set()
        return control.active or is_speed(parameter:get())
    end

    function speed.take_over()
        speed.pilot_units = parameter:get()
        mirror:set(speed.pilot_units) -- before the speed is touched: a restart must find it
        speed.changes = {}
    end

    function speed.write(mps)
        if not order(mps) then return end
        parameter:set(mps * SPEED_UNITS)
        speed.written = parameter:get()
        speed.out_mps = mps
    end

    function speed.give_back(units)
        parameter:set(units)
        if vehicle:get_mode() == GUIDED then order(units / SPEED_UNITS) end
        mirror:set(0)
        speed.written = nil
    end

    -- A script that died in control left the pilot's value in the mirror.
    function speed.repair()
        local units = mirror:get()
        if not is_speed(units) then return end
        speed.give_back(units)
        say(SEVERITY.WARNING, string.format('restarted, %s back to %.2f', SPEED_NAME, units))
    end

    -- Outside changes of the speed parameter: one is the pilot's, many in a short time are another script's.
    local function note_change(t_ms)
        speed.changes[#speed.changes + 1] = t_ms
        if #speed.changes > CONFLICT_CHANGES then table.remove(speed.changes, 1) end
    end

    function speed.fought_over(t_ms)
        return #speed.changes == CONFLICT_CHANGES and t_ms - speed.changes[1] < CONFLICT_MS
    end

    -- The pilot has set the speed parameter while the applet is in control: his value from now on.
    function speed.watch(t_ms)
        local units = parameter:get()
        if not speed.written or units == speed.written or not is_speed(units) then return end
        speed.pilot_units = units
        mirror:set(units)
        note_change(t_ms)
        speed.conflict = speed.fought_over(t_ms)
    end

    function speed.watch_on_ground(t_ms)
        local units = parameter:get()
        if speed.ground_units and units ~= speed.ground_units then note_change(t_ms) end
        speed.ground_units = units
    end
end

-- What pilots see ----------------------------------------------------------------------------------------------------

do
    local NAMED_MS = 500 -- pace of the named floats
    -- Of each state from 1 on: severity, text, and how long it is not announced again, however often it comes and goes.
    local NOTICES = {
        { SEVERITY.NOTICE, 'searching', 10000 },
        { SEVERITY.INFO, 'tracking', 10000 },
        { SEVERITY.WARNING, 'too close', 3000 },
        { SEVERITY.WARNING, 'no sonar data', 10000 },
        { SEVERITY.CRITICAL, 'stream lost, holding here', 3000 },
        { SEVERITY.CRITICAL, 'too close, backing off', 3000 },
        { SEVERITY.INFO, 'holding the distance', 10000 },
    }

    function report.begin()
        report.announced_ms = {}
        report.state, report.announced = STATE.TRACKING, STATE.TRACKING -- a target is assumed until it is missed
    end

    -- One text per change of state.
    function report.announce(t_ms)
        local state = report.state
        if state == report.announced then return end
        local severity, text, gap_ms = table.unpack(NOTICES[state])
        local last_ms = report.announced_ms[state]
        if last_ms and t_ms - last_ms < gap_ms then return end
        report.announced, report.announced_ms[state] = state, t_ms
        if state == STATE.SEARCHING or state == STATE.NO_SONAR then
            text = string.format('%s, %.1f m/s', text, laws.wish_mps)
        end
        say(severity, text)
    end

    local function send_named(range_m, t_ms)
        if report.named_ms and t_ms - report.named_ms < NAMED_MS then return end
        report.named_ms = t_ms
        gcs:send_named_float('ECHO_RNG', range_m or 0.0)
        gcs:send_named_float('ECHO_SPD', speed.out_mps)
        gcs:send_named_float('ECHO_STATE', report.state)
    end

    local function write_log(range_m, t_ms)
        if C.LOG_HZ <= 0.0 or (report.log_ms and t_ms - report.log_ms < 1000.0 / C.LOG_HZ - 1.0) then return end
        report.log_ms = t_ms
        local error_m = range_m and range_m - stream.distance_m() or 0.0
        logger:write('ECHO', 'Rng,Flt,Err,Law,Spd,St,Ref', 'fffffBI', 'mmmnn--', '00000--', range_m or 0.0,
            track.range_m or 0.0, error_m, laws.wish_mps, speed.out_mps, report.state, refused.count)
    end

    function report.send(range_m, t_ms)
        send_named(range_m, t_ms)
        write_log(range_m, t_ms)
    end
end

-- Before arming ------------------------------------------------------------------------------------------------------

local check_arming
do
    local MAVLINK_RANGEFINDER = 10 -- RNGFNDx_TYPE
    local CHECK_MS = 1000 -- pace

    local checked_ms
    local id = arming.get_aux_auth_id and arming:get_aux_auth_id()
    if not id then say(SEVERITY.WARNING, 'no arming check, all authorisation ids are taken') end

    -- RNGFNDx_TYPE of the forward rangefinder, nil if none is set up.
    local function forward_type()
        for i = 1, 9 do
            if param:get('RNGFND' .. i .. '_ORIENT') == FORWARD then
                local kind = param:get('RNGFND' .. i .. '_TYPE')
                if kind and kind > 0 then return kind end
            end
        end
        return nil
    end

    local function reason_not_to_arm(t_ms)
        if control.deaf then return control.NO_PLACE end
        local kind = forward_type()
        if not kind or not rangefinder:has_orientation(FORWARD) then return 'no forward rangefinder' end
        if kind ~= MAVLINK_RANGEFINDER then return 'forward rangefinder is not MAVLink' end
        if speed.fought_over(t_ms) then return 'another script sets ' .. SPEED_NAME end
        return nil
    end

    function check_arming(t_ms)
        if not id or arming:is_armed() then return end
        speed.watch_on_ground(t_ms)
        if checked_ms and t_ms - checked_ms < CHECK_MS then return end
        checked_ms = t_ms
        local reason = C.ENABLE >= 1 and C.ARM_CHK >= 1 and reason_not_to_arm(t_ms) or nil
        if reason then
            arming:set_aux_auth_failed(id, TEXT .. reason)
        else
            arming:set_aux_auth_passed(id)
        end
    end
end

-- Control: who flies, and the update ---------------------------------------------------------------------------------

do
    local SWITCH_HIGH = 2
    local ACTIVE_MS, REPAIR_MS = 50, 1000 -- pause before the next update

    -- Milliseconds since the script started, a plain integer (wraps after 24 days).
    local boot = millis()
    local function now_ms()
        return (millis() - boot):toint()
    end

    local function switch_is_high()
        local channel = rc:find_channel_for_option(math.tointeger(C.SWITCH // 1))
        return channel ~= nil and channel:get_aux_switch_pos() == SWITCH_HIGH
    end

    -- Why the applet must not act now, or nil.
    local function reason_not_to_act()
        if C.ENABLE < 1 then return 'disabled' end
        if not arming:is_armed() then
            speed.conflict = false
            return 'disarmed'
        end
        if vehicle:get_mode() ~= GUIDED then return 'mode' end
        if control.deaf then return 'deaf' end
        if not speed.is_set() then return SPEED_NAME .. ' out of range' end
        if speed.conflict then return 'another script sets ' .. SPEED_NAME end
        if C.SWITCH > 0 and not switch_is_high() then return 'switch' end
        return nil
    end

    local function take_control(t_ms)
        speed.take_over()
        control.active = true
        stream.begin()
        laws.begin(t_ms)
        guard.begin(t_ms)
        report.begin()
        track.range_m = nil
        say(SEVERITY.INFO, string.format('in control, law %.0f, %.1f m/s', C.LAW // 1, laws.speed_mps))
    end

    local function hand_back(reason)
        if not control.active then return end
        speed.watch(own.at_ms) -- the pilot may have set it since the last update
        control.active = false
        speed.give_back(speed.pilot_units)
        report.state = STATE.OFF
        say(SEVERITY.NOTICE, string.format('handed back, %s %.2f (%s)', SPEED_NAME, speed.pilot_units, reason))
    end

    -- The limit of the total speed; where points carry a velocity, of the correction towards them.
    local function limit(range_m, status, t_ms)
        if hold.update(t_ms) then
            guard.rest()
            return C.SPD_MAX
        end
        if hold.is_wanted() and not stream.holding and not track.trusted(t_ms) and status ~= STATUS_LOW then
            guard.rest()
            return clamp(C.SPD_LOST, C.SPD_MIN, C.SPD_MAX)
        end
        return guard.update(range_m, status, t_ms)
    end

    local function act(t_ms)
        if not control.active then take_control(t_ms) end
        speed.watch(t_ms)
        local range_m, status = track.average()
        if track.is_target(range_m) and not track.newest(t_ms) then
            track.update(range_m, t_ms, t_ms) -- no single readings: the average has to do
        end
        laws.update(range_m, status, t_ms)
        local limit_mps = limit(range_m, status, t_ms)
        stream.watch(t_ms)
        speed.write(limit_mps)
        report.announce(t_ms)
        report.send(range_m, t_ms)
        return (guard.evading or hold.active) and QUICK_MS or ACTIVE_MS
    end

    local function update()
        local t_ms = now_ms()
        parameters.read_some()
        own.update(t_ms)
        track.carry(t_ms)
        take_messages(t_ms)
        local reason = reason_not_to_act()
        if not reason then return act(t_ms) end
        hand_back(reason)
        check_arming(t_ms)
        return IDLE_MS
    end

    -- An error is reported once with its place. The speed is handed back, and the next try is slower.
    function control.run()
        local ok, result = pcall(update)
        if ok then
            control.error = nil
            return control.run, result
        end
        if result ~= control.error then
            control.error = result
            say(SEVERITY.CRITICAL, 'error ' .. tostring(result))
        end
        pcall(hand_back, 'error')
        return control.run, REPAIR_MS
    end
end

speed.repair()
say(SEVERITY.INFO, 'ready')
return control.run, IDLE_MS
