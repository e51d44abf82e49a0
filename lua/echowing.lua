--[[
  Echowing: keeps a follower copter at its distance from the leader, by a sonar that looks forward.

  A ground tool streams guided points that keep the follower roughly in its place behind the leader. This applet reads
  the forward rangefinder (the co-processor's running average, by MAVLink) and the co-processor's newest single reading
  (NAMED_VALUE_FLOAT "SNR_RAW"), or a forward rangefinder that the autopilot reads itself, and turns the distance into
  speed: slower when too near, faster when too far. Where the points carry a velocity it moves them along the beam to the
  wanted distance; where they do not it sets the speed limit of Guided.

  It acts only while ECHO_ENABLE is 1, the vehicle is armed and in Guided, and the switch (if ECHO_SWITCH names one) is
  high. The pilot takes over by any change of mode; the speed parameter is then the pilot's again.

  Purpose, wiring, parameters, tests on the bench, in SITL and in the air, and what each message means: echowing.md.
  Laws, guard, measurements: how-it-works.md.

  This file consists of parts: one block each, with constants and helpers that are local to the block, and one table
  with the part's state and the functions that the other parts call. The vehicle's Lua needs this: it allows 100 active
  local variables in one function, and the top level of a file counts as a function.
--]]

---@diagnostic disable: need-check-nil

-- Each script gets its own copy of the vehicle's libraries. What this one does not use of them goes: it takes 2 kB.
local abs, atan, cos, deg, exp, max, min = math.abs, math.atan, math.cos, math.deg, math.exp, math.max, math.min
local pi, sin, sqrt = math.pi, math.sin, math.sqrt
io, math, package, require, table = nil, nil, nil, nil, nil

local boot = millis() -- first: the operators of its class take the largest block of all

-- The vehicle's memory is small: a number that is used once stands where it is used.
local FASTEST_MPS = 30 -- no copter flies faster; WPNAV_SPEED and WP_SPD reach 20

local function say(severity, text) -- MAV_SEVERITY: 2 critical, 3 error, 4 warning, 5 notice, 6 information
    gcs:send_text(severity, 'ECHO: ' .. text)
end

local function clamp(value, low, high)
    return max(low, min(high, value))
end

local function is_within(value, most) -- neither NaN nor beyond, to either side
    return value and value >= -most and value <= most
end

-- What the firmware offers -------------------------------------------------------------------------------------------

-- The speed parameter and how many of its units make 1 m/s: WP_SPD from later 4.7 on, WPNAV_SPEED before.
local SPEED_NAME = param:get('WP_SPD') and 'WP_SPD' or 'WPNAV_SPEED'
local SPEED_UNITS = SPEED_NAME == 'WP_SPD' and 1 or 100
if not (vehicle.set_target_posvelaccel_NED and mavlink and mavlink.receive_chan and param:get(SPEED_NAME)) then
    say(3, 'stopped, this firmware is not Copter 4.5 or newer')
    return
end

local MY_SYSTEM = param:get('MAV_SYSID') or param:get('SYSID_THISMAV')
local yaw_rad = ahrs.get_yaw_rad or ahrs.get_yaw

-- Parameters ---------------------------------------------------------------------------------------------------------

--[[
  // @Param: ECHO_ENABLE
  // @DisplayName: Echowing enable
  // @Description: Lets the applet set the speed in Guided
  // @Values: 0:Disabled,1:Enabled
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
  // @Param: ECHO_TAU
  // @DisplayName: Echowing filter of single readings
  // @Description: Time constant of the filter that computes range and leader speed from the sonar's single readings. The hold and the closing distance use it
  // @Range: 0.1 1
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
  // @Param: ECHO_SPD_LOST
  // @DisplayName: Echowing speed without sonar
  // @Description: Limit of the correction while the distance is not held: the sonar sends no data or detects no target
  // @Range: 0.2 15
  // @Units: m/s
  // @User: Standard
  // @Param: ECHO_LOST_T
  // @DisplayName: Echowing target lost time
  // @Description: The target is lost after this time without a detection
  // @Range: 0.3 10
  // @Units: s
  // @User: Standard
  // @Param: ECHO_NODATA_T
  // @DisplayName: Echowing sonar timeout
  // @Description: The sonar has failed after this time without data from the rangefinder
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
  // @Param: ECHO_STREAM_T
  // @DisplayName: Echowing stream watchdog
  // @Description: The applet holds the vehicle where it is when a stream of guided points stops for this long. 0: no watchdog
  // @Range: 0 10
  // @Units: s
  // @User: Standard
  // @Param: ECHO_SWITCH
  // @DisplayName: Echowing switch
  // @Description: RC option (RCx_OPTION) of the switch that must be high. 0: no switch
  // @Values: 0:None,300:Scripting1,301:Scripting2,302:Scripting3,303:Scripting4,304:Scripting5,305:Scripting6,306:Scripting7,307:Scripting8
  // @User: Standard
  // @Param: ECHO_LOG_HZ
  // @DisplayName: Echowing log rate
  // @Description: Rate of the ECHO messages in the dataflash log. 0: none
  // @Range: 0 20
  // @Units: Hz
  // @User: Advanced
  // @Param: ECHO_ARM_CHK
  // @DisplayName: Echowing arming check
  // @Description: Refuses arming while the applet is enabled and the forward rangefinder is missing, or another script sets the speed
  // @Values: 0:Disabled,1:Enabled
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
  // @Range: 0 5000
  // @ReadOnly: True
  // @User: Advanced
  // @Param: ECHO_FORMAT
  // @DisplayName: Echowing point format
  // @Description: Format of the guided points that the applet understands. For another one update the applet or the ground tool
  // @Range: 4 4
  // @ReadOnly: True
  // @User: Advanced
--]]

-- Name, default, lowest and highest accepted value, and the number by which the autopilot finds what a pilot has saved:
-- the numbers of parameters that are gone stay free. A text takes less of the vehicle's memory than a table.
local PARAMETERS = [[
ENABLE 0 0 1 1
DIST 3 1.5 6 3
DETECT 4.5 2 7.6 4
TAU 0.12 0.05 1 12
SPD_MIN 0.2 0.2 2 13
SPD_MAX 5 1 15 14
SPD_LOST 3 0.2 15 16
LOST_T 1.3 0.3 10 17
NODATA_T 1 0.3 10 18
CLOSE 1.5 0.5 4 19
DELAY 0.6 0.1 2 20
DECEL 2.5 0.5 10 21
STREAM_T 1 0 10 23
SWITCH 0 0 307 24
LOG_HZ 10 0 20 25
ARM_CHK 1 0 1 26
INSET 0.2 0 1 27
MIRROR 0 0 5000 28
FORMAT 4 4 4 29
]]

local C = {} -- values in force: C.DIST, ...
local read_some, mirror -- the mirror is written by part "speed"
do
    local names, least, most, objects = {}, {}, {}, {}
    local complained = {}
    local number = 1

    -- Uses the new value of parameter number i if it is in its range (NaN is not); else keeps the value in use.
    local function read(i)
        local name, value = names[i], objects[i]:get()
        if value and value >= least[i] and value <= most[i] then
            C[name] = value
            complained[name] = nil
        elseif not complained[name] then
            complained[name] = true
            say(4, ('ECHO_%s out of range, using %.2f'):format(name, C[name]))
        end
    end

    -- Three at each update: all of them within half a second in control, two seconds otherwise.
    function read_some()
        for _ = 1, 3 do
            read(number)
            number = number % (#names - 2) + 1 -- all but the last two, which the applet writes
            if number == 1 then C.SPD_MAX = max(C.SPD_MAX, C.SPD_MIN) end
        end
    end

    -- When a script restarts, values that were not saved return to their defaults as the table is added again.
    -- 95 is the table key that no script in ArduPilot's tree uses.
    local left = param:get('ECHO_MIRROR')
    assert(param:add_table(95, 'ECHO_', 29), 'ECHO: parameter table key 95 is taken')
    for name, value, low, high, id in PARAMETERS:gmatch('(%S+) (%S+) (%S+) (%S+) (%S+)') do
        local i = #names + 1
        assert(param:add_param(95, tonumber(id), name, tonumber(value)), 'ECHO: cannot add ECHO_' .. name)
        names[i], C[name], least[i], most[i] = name, tonumber(value), tonumber(low), tonumber(high)
        objects[i] = Parameter('ECHO_' .. name)
    end
    objects[#objects]:set(C.FORMAT)
    for i = 1, #names do read(i) end
    C.SPD_MAX = max(C.SPD_MAX, C.SPD_MIN)
    mirror = objects[#objects - 1]
    if left then mirror:set(left) end
end

-- The parts and their state -------------------------------------------------------------------------------------------

-- Speeds are along the beam, which is at the leader's bearing. Times are in ms; nil is "never".
local own = { mps = 0, north_mps = 0, east_mps = 0, accel_mps2 = 0 } -- this vehicle's motion; at_ms: when
-- Where the sonar looks, a unit vector. It is fixed to the nose, or a gimbal that a link tells turns it.
local look = { north = 1, east = 0, turn_rps = 0 }
local track = { -- what the sonar reads (averages, single readings), and where the leader is by that, and how fast
    board_ms = 0, late_ms = 0, quickest_ms = 0, leader_mps = 0, seen_mps = 0, seen_ms = 0, readings = 0,
    spike_ms = 0, noise_m = 0.0,
}
local hold = { mps = 0 } -- moves points along the beam
local guard = {} -- keeps away from the leader
local stream = { north_mps = 0, east_mps = 0 } -- the ground tool's guided points
local speed = { out_mps = 0, changes = {} } -- the speed parameter: ours, the pilot's, another script's
-- What pilots see: 0 off, 1 searching, 2 tracking, 3 too close, 4 no sonar data, 5 stream lost, 6 backing off, 7
-- holding.
local report = { state = 0 }
local control = {} -- takes control and hands back
local refused = { count = 0 } -- what was heard and not used, or not sent

-- Counts it, and tells the pilot; again only after half a minute without: radios damage messages all the time.
local function refuse(what)
    local last_ms = refused[what]
    refused.count, refused[what] = refused.count + 1, own.at_ms
    if not last_ms or own.at_ms - last_ms > 30000 then say(4, what .. ', not used') end
    return false
end

-- The way out --------------------------------------------------------------------------------------------------------

-- Every target and every speed that leaves the applet passes here: numbers, near, and no more than a copter can. What
-- is not goes nowhere. mps: the speed limit; nil: a target. False: it was not sent, or the autopilot refused it.
local function order(mps, position, velocity, acceleration, nose_rad)
    if mps then
        if not is_within(mps, FASTEST_MPS) or mps <= 0 then return refuse('implausible speed') end
        vehicle:set_desired_speed(mps)
        return true
    end
    local here = ahrs:get_relative_position_NED_origin()
    if not here then return false end
    here:x(position:x() - here:x())
    here:y(position:y() - here:y())
    here:z(position:z() - here:z())
    -- The leader is within the sonar's reach, and its point within a second's flight of it; no copter is 100 km from
    -- where its estimator began, or decelerates harder than the highest ECHO_DECEL. The autopilot takes a yaw of up to
    -- 360 degrees.
    if not (is_within(here:length(), 50) and is_within(position:length(), 1e5)
        and is_within(velocity:length(), FASTEST_MPS) and is_within(acceleration:length(), 10)
        and is_within(nose_rad, 2 * pi)) then
        return refuse('implausible target')
    end
    return vehicle:set_target_posvelaccel_NED(position, velocity, acceleration, true, deg(nose_rad),
        false, 0, false)
end

-- So does every order to the gimbal: to look at what is so far north and east, moves past so fast, and may be so far
-- aside. GIMBAL_DEVICE_SET_ATTITUDE: the rotation from north to there in the earth frame, its height left as the ground
-- tool has ordered it (84), and how fast it turns; a beam has no roll, and the rate of it is the standard deviation.
function look.order(north_m, east_m, north_mps, east_mps, aside_m)
    local far_m = max(1, sqrt(north_m * north_m + east_m * east_m)) -- nearer it turns faster than any gimbal
    local half_rad, unsure_rad = 0.5 * atan(east_m, north_m), atan(aside_m, far_m)
    local turn_rps = (north_m * east_mps - east_m * north_mps) / (far_m * far_m)
    if not (is_within(turn_rps, 4) and is_within(unsure_rad, pi)) then return refuse('implausible look') end
    return mavlink:send_chan(look.link, 284, ('<fffffffI2BB'):pack(cos(half_rad), 0, 0, sin(half_rad), unsure_rad, 0,
        turn_rps, 84, MY_SYSTEM, look.component))
end

-- This vehicle's motion ----------------------------------------------------------------------------------------------

do
    -- Own speed along the beam, 0 while the estimator has none, and how it is changing: smoothed (100 ms), and no more
    -- than the vehicle can. A beam that turns changes the speed along it: that is no acceleration, and to the track it is
    -- as if the leader's had changed by as much, for the range goes on as it did.
    function own.update(t_ms)
        local velocity, north_mps, east_mps = ahrs:get_velocity_NED(), 0, 0
        if velocity and is_within(velocity:length(), FASTEST_MPS) then
            north_mps, east_mps = velocity:x(), velocity:y()
        end
        local dt_ms = own.at_ms and t_ms - own.at_ms or 1000
        look.update(t_ms, dt_ms * 0.001)
        local before_mps = own.north_mps * look.north + own.east_mps * look.east
        local mps = north_mps * look.north + east_mps * look.east
        if dt_ms > 200 then
            own.accel_mps2 = 0 -- too long ago to compare with
        elseif dt_ms > 0 then
            local change_mps2 = clamp((mps - before_mps) * 1000 / dt_ms, -C.DECEL, C.DECEL)
            own.accel_mps2 = own.accel_mps2 + (change_mps2 - own.accel_mps2) * dt_ms / (dt_ms + 100)
        end
        track.turn(before_mps - own.mps, dt_ms * 0.001)
        own.mps, own.north_mps, own.east_mps, own.at_ms = mps, north_mps, east_mps, t_ms
    end

    -- Guided would turn the nose, and with it the sonar, towards a target without a yaw. False: refused.
    local function fly_to(position, north_m, east_m)
        position:x(position:x() + north_m)
        position:y(position:y() + east_m)
        -- With a velocity, as the points: Guided starts another way of flying with the lean of the moment for its
        -- steady part, and a vehicle that brakes or speeds up would swing by metres.
        return order(nil, position, Vector3f(), Vector3f(), yaw_rad(ahrs))
    end

    -- Flies to a place so far straight back from the leader, at this height, its nose where it is now.
    function own.fly_back(back_m)
        local position = ahrs:get_relative_position_NED_origin()
        if not position then return false end
        return fly_to(position, -back_m * look.north, -back_m * look.east)
    end

    -- Whether it has come to rest, but for what the estimator is off: one that still leans only turns round.
    function own.stands()
        local velocity = ahrs:get_velocity_NED()
        if not velocity or abs(own.accel_mps2) > 1 then return false end
        local north_mps, east_mps = velocity:x(), velocity:y()
        return north_mps * north_mps + east_mps * east_mps < 0.3 * 0.3
    end

    -- Stays where it comes to a stop: a place it has to come back to would take longer. Its speed goes on changing
    -- until it leans against its motion. ArduCopter 4.8 stood 2.3 s after a link was lost; with 0.5 s here it crept on
    -- (3.5 s), with 0.35 s and with 0.15 s it swung back (2.6 and 2.4 s).
    function own.stop()
        local LEAN_S = 0.25
        local position, velocity = ahrs:get_relative_position_NED_origin(), ahrs:get_velocity_NED()
        if not (position and velocity) then return false end
        local north_mps, east_mps = velocity:x(), velocity:y()
        local mps = sqrt(north_mps * north_mps + east_mps * east_mps)
        if not is_within(mps, FASTEST_MPS) or mps < 0.01 then return fly_to(position, 0, 0) end
        local then_mps = max(0, mps + own.accel_mps2 * own.mps / mps * LEAN_S)
        local share = (0.5 * (mps + then_mps) * LEAN_S + then_mps * then_mps / (2 * C.DECEL)) / mps
        return fly_to(position, share * north_mps, share * east_mps)
    end
end

-- The beam ----------------------------------------------------------------------------------------------------------

do
    local point_ms -- of the newest point that told the bearing
    local sent_ms -- of the newest order to the gimbal

    -- Through a lost link the applet orders the gimbal, until the leader is lost. The co-processor obeys once the ground
    -- tool has been silent for a second.
    local function carry_on(t_ms, untold_ms, far_m, north_mps, east_mps)
        if untold_ms <= 500 or not (control.active and track.fresh(t_ms) and look.link and mavlink.send_chan)
            or sent_ms and t_ms - sent_ms < 150 then
            return
        end
        sent_ms = t_ms
        -- Heard, it is in the beam; a leader that turns off does it with 1 m/s2.
        local unseen_s = (t_ms - track.seen_ms) * 0.001
        look.order(look.north * far_m, look.east * far_m, north_mps, east_mps, 0.2 + 0.5 * unseen_s * unseen_s)
    end

    -- The leader's bearing is the yaw of each point, and goes on by the point's velocity, which after 2 s tells nothing of
    -- the leader any more, and by the own. Where nothing tells it, the sonar looks ahead.
    function look.update(t_ms, dt_s)
        local nose_rad, untold_ms = yaw_rad(ahrs), stream.at_ms and stream.yaw_rad and t_ms - stream.at_ms
        local look_rad = nose_rad
        if untold_ms and (untold_ms < 1000 or track.fresh(t_ms)) then
            local share = max(0, 1 - untold_ms / 2000)
            local north_mps, east_mps = share * stream.north_mps - own.north_mps, share * stream.east_mps - own.east_mps
            local far_m = max(1, track.range_m or hold.distance_m())
            look_rad = stream.at_ms ~= point_ms and stream.yaw_rad
                or atan(look.east * far_m + east_mps * dt_s, look.north * far_m + north_mps * dt_s)
            point_ms = stream.at_ms
            carry_on(t_ms, untold_ms, far_m, north_mps, east_mps)
        end
        if is_within(look_rad, 2 * pi) then
            -- Smoothed over 0.3 s: points tell the bearing in steps, 8 a second, each a little off. A step of 15 degrees is
            -- a correction.
            local north, east = cos(look_rad), sin(look_rad)
            local turned_rad = look.north * east - look.east * north
            look.turn_rps = (dt_s > 0.2 or abs(turned_rad) > 0.26) and 0
                or look.turn_rps + (turned_rad - look.turn_rps * dt_s) / (dt_s + 0.3)
            look.north, look.east = north, east
        end
        own.ahead = cos(look_rad - nose_rad) > 0.9 -- the nose is within 25 degrees
    end
end

-- Sonar track --------------------------------------------------------------------------------------------------------

do
    local SPEEDS = { 'leader_mps', 'seen_mps', 'own_mps', 'spike_own_mps', 'slowest_mps', 'fastest_mps' }
    local dated = 0 -- so many readings have told the clock in force
    local TRUST_READINGS = 3 -- so many readings in agreement are a target; two wild ones in a row happen
    -- 0.05 s is the age of a single reading as it is sent, and what the wire takes at the least; no copter brakes
    -- harder than with 4 m/s2.

    -- Whether a range, centre to centre, is one of a target.
    function track.is_target(range_m)
        return range_m ~= nil and range_m < C.DETECT + C.INSET
    end

    -- When a reading was taken, by the applet's clock: readings wait for the wire and for the applet, most of them
    -- longer than the quickest, and a speed told from their arrival would be off by metres per second. The quickest of
    -- the last 16 to 32 tells: a board whose clock is 1 % slow is 32 ms off then.
    function track.taken_ms(board_ms, t_ms)
        local late_ms = t_ms - board_ms
        -- No reading waits for a second: the board, or its link, has started anew.
        local goes_on = board_ms > track.board_ms and is_within(late_ms - track.late_ms, 1000)
        track.board_ms = board_ms
        if not goes_on then track.late_ms, track.quickest_ms, dated = late_ms, late_ms, 0 end
        track.quickest_ms, dated = min(track.quickest_ms, late_ms), dated + 1
        local clock_ms = min(track.late_ms, late_ms)
        if dated >= 16 then clock_ms, track.quickest_ms, dated = track.quickest_ms, late_ms, 0 end
        local shift_ms = clock_ms - track.late_ms -- the readings before are dated by it too
        track.late_ms, track.seen_ms, track.spike_ms = clock_ms, track.seen_ms + shift_ms, track.spike_ms + shift_ms
        return board_ms + track.late_ms
    end

    function track.take(value, read_ms, t_ms)
        local range_m = value + C.INSET
        track.raw_ms = read_ms
        -- Stuck: readings stay the same to the centimetre while this vehicle changes its speed, and no leader flies so
        -- exactly alike. Of themselves no more than four in a row are the same.
        if range_m ~= track.same_m then
            track.same_m, track.same, track.slowest_mps, track.fastest_mps = range_m, 0, own.mps, own.mps
        end
        track.same = track.same + 1
        track.slowest_mps, track.fastest_mps = min(track.slowest_mps, own.mps), max(track.fastest_mps, own.mps)
        local target = track.is_target(range_m)
        local stuck = target and track.same >= 8 and track.fastest_mps - track.slowest_mps > 0.3
        if stuck and not track.stuck then say(4, 'sonar stuck, not used') end
        track.stuck = stuck
        if stuck then
            track.range_m, track.readings = nil, 0
        elseif target then
            track.update(range_m, read_ms, t_ms)
        elseif track.readings < TRUST_READINGS then
            track.range_m = nil -- what was seen before was a wild reading
        end
    end

    -- Reads the forward rangefinder: status, and distance, nil where it is no measurement. All distances here are between
    -- the two vehicles' centres. Of type 10, MAVLink, it is the co-processor's running average; a single reading of a
    -- sensor that is fixed to the nose, and that the autopilot reads itself, where it is of another type. Where there
    -- are both, that of the co-processor counts.
    function track.read(t_ms)
        local sensor
        for i = 0, rangefinder:num_sensors() - 1 do
            local one = rangefinder:get_backend(i)
            if one and one:orientation() == 0 and (not sensor or one:type() == 10) then sensor = one end
        end
        if not sensor then return nil, 0 end
        local status, read_ms = sensor:status() -- 1 no data, 2 too low, 3 too high, 4 good
        look.fixed = sensor:type() ~= 10
        if look.fixed then
            -- A MaxBotix sonar (2) is read 0.1 s after its ping, and what it said is there up to 50 ms after its stamp.
            local late_ms = sensor:type() == 2 and 50 or 0
            read_ms = (sensor:get_state():last_reading() - boot):toint() - late_ms
            if t_ms - read_ms > 300 then
                status = 1 -- its driver says no more than it has said
            elseif not own.ahead then
                status = 3 -- it sees something else
            end
            -- It counts 12 times a second at the most: the track reckons with ten, as the co-processor's.
            if t_ms - read_ms < 2 * late_ms or read_ms - (track.raw_ms or 0) < 80 then read_ms = nil end
        end
        local range_m = (status == 4 or status == 2 and not look.fixed) and sensor:distance()
        -- The longest reach of a MaxBotix sonar is 10.7 m.
        if not is_within(range_m, 20) or range_m < 0 or (range_m == 0 and status == 4) then range_m = nil end
        if read_ms and status > 2 then track.take(range_m or 9, read_ms, t_ms) end -- 9 m is no target
        return range_m and range_m + C.INSET, status
    end

    -- Whether a leader was heard that is not lost yet.
    function track.fresh(t_ms)
        return track.range_m and t_ms - track.seen_ms < C.LOST_T * 1000
    end

    function track.trusted(t_ms)
        return track.fresh(t_ms) and track.readings >= TRUST_READINGS
    end

    -- How hard the leader brakes, or speeds up towards this vehicle: 0 or less. Under 0.8 m/s2 it is noise of the sonar
    -- (1 cm; a noisier one is smoothed for longer), and what was seen longer ago than three readings is no more so.
    function track.braking_mps2(t_ms)
        if t_ms - track.seen_ms > 300 or track.leader_mps2 > -0.8 then return 0 end
        return max(-4, track.leader_mps2)
    end

    -- Carries the range on to now. A leader that is not seen speeds up no further; another follower goes back to the speed
    -- of all in its line.
    function track.carry(t_ms)
        if not track.range_m then return end
        local dt_s = (t_ms - track.at_ms) * 0.001
        local leader_mps = t_ms - track.seen_ms <= 150 and track.leader_mps + track.leader_mps2 * dt_s
            or stream.manner == 2 and stream.north_mps * look.north + stream.east_mps * look.east
            or min(track.leader_mps, track.seen_mps)
        track.range_m = track.range_m + 0.5 * (track.leader_mps + leader_mps - track.own_mps - own.mps) * dt_s
        track.leader_mps, track.own_mps, track.at_ms = leader_mps, own.mps, t_ms
    end

    -- The beam has turned: by so much the speeds along it are others. The leader's by more: what passes straight by goes
    -- apart ever faster. Without it the track of one that passed at 3 m with 3 m/s, and was heard once in three pings,
    -- was off by 3 m/s.
    function track.turn(by_mps, dt_s)
        hold.mps = hold.mps + by_mps
        for _, name in ipairs(SPEEDS) do
            if track[name] then track[name] = track[name] + by_mps end
        end
        local apart_mps = (track.range_m or 0) * look.turn_rps * look.turn_rps * dt_s
        track.leader_mps, track.seen_mps = track.leader_mps + apart_mps, track.seen_mps + apart_mps
    end

    -- The track begins anew, with the leader's speed.
    local function begin(range_m, mps, readings, read_ms, t_ms)
        track.leader_mps, track.seen_mps, track.leader_mps2 = mps, mps, 0
        track.range_m = range_m + (mps - own.mps) * (0.05 + (t_ms - read_ms) * 0.001)
        track.own_mps, track.at_ms, track.seen_ms, track.readings = own.mps, t_ms, read_ms, readings
    end

    -- A reading that was not foreseen counts only when the next one is like it: propellers make single wild ones. The
    -- two tell range and rate anew, with the own speed between them. Else it waits for another one, and takes one of six
    -- in agreement off.
    local function unforeseen(range_m, read_ms, t_ms, gate_m, jump_m)
        local doubted_mps, dt_s = track.doubted_mps, (read_ms - track.spike_ms) * 0.001
        local known = track.readings >= TRUST_READINGS
        track.doubted_mps = nil
        -- Like the one that waits: shortly after it, and two vehicles close no faster than 5 m/s.
        if track.spike_m and dt_s > 0 and dt_s < 0.3 and abs(range_m - track.spike_m) < gate_m + 5 * dt_s then
            local mps = clamp((range_m - track.spike_m) / dt_s, -5, 5)
                + 0.5 * (track.spike_own_mps + own.mps) - own.accel_mps2 * 0.05
            -- A known leader does not jump so far (of an exact sonar 0.6 m: a speed wrong by 1 m/s, for about as long as
            -- its track is carried on), and does not change its speed by so much; a noisy one tells both worse. Two alike
            -- may be late echoes of something else, or one that is wild and one that is not. Three are believed, if each
            -- two of them tell the same speed (2 m/s).
            local unseen_s = min(read_ms - track.seen_ms, 700) * 0.001
            local third = doubted_mps and abs(mps - doubted_mps) < 13 * gate_m
            if third or not known or jump_m <= 4 * gate_m + 2 * unseen_s * unseen_s
                and abs(mps - track.seen_mps) <= 7 * gate_m + 4 * unseen_s then
                -- Two alike may still be wild ones, until a third is foreseen.
                begin(range_m, mps, (third or known) and TRUST_READINGS or 2, read_ms, t_ms)
                track.spike_m = nil
                return
            end
            track.doubted_mps = mps
        end
        track.spike_m, track.spike_ms, track.spike_own_mps = range_m, read_ms, own.mps
        if known then track.readings = min(track.readings, 6) - 1 end
    end

    -- Takes a range that was read at read_ms; now it is t_ms. The range of the target, the leader's speed along the
    -- line of sight, and its acceleration: a critically damped observer that knows the own speed, so that own braking
    -- is not taken for the leader's.
    function track.update(range_m, read_ms, t_ms)
        -- Readings 0.1 s apart differ by less than 0.15 m even where both vehicles change their speed at 5 m/s2, but for
        -- the sonar's noise, as it is seen.
        local gate_m = clamp(4 * track.noise_m, 0.15, 0.5)
        if not track.fresh(t_ms) then
            begin(range_m, own.mps, 1, read_ms, t_ms)
            return unforeseen(range_m, read_ms, t_ms, gate_m, 0)
        end
        local dt_s = (read_ms - track.seen_ms) * 0.001
        if dt_s <= 0 then return end
        track.carry(t_ms)
        local aged_s = 0.05 + (t_ms - read_ms) * 0.001
        local residual_m = range_m + (track.leader_mps - own.mps) * aged_s - track.range_m
        local off_m = abs(residual_m)
        if off_m > gate_m then return unforeseen(range_m, read_ms, t_ms, gate_m, off_m) end
        -- Of the last three seconds. Up to 0.02 m it is that of whole centimetres; more is smoothed for longer.
        track.noise_m = track.noise_m + 0.03 * (off_m - track.noise_m)
        local keep = exp(-dt_s / (C.TAU * clamp(track.noise_m / 0.02, 1, 3)))
        local lose = 1 - keep
        -- The first readings count as in a straight line through all of them. A float: the square of the readings of 39
        -- minutes is no 32-bit integer.
        local n = track.readings + 1.0
        local range_share = max(1 - keep * keep * keep, 2 * (2 * n - 1) / (n * (n + 1)))
        local rate_share = max(1.5 * lose * lose * (1 + keep), 6 / (n * (n + 1)))
        local change_mps = rate_share / dt_s * residual_m
        -- The rate is that of the reading's time: the range of now changes with it. Left out, the next reading corrects
        -- for it once more, and the observer swings; from 0.14 s of age on it swings ever wider.
        track.range_m = track.range_m + range_share * residual_m + change_mps * aged_s
        track.leader_mps = track.leader_mps + change_mps
        if n > 5 then -- fewer tell no acceleration
            track.leader_mps2 = track.leader_mps2 + lose * lose * lose / (dt_s * dt_s) * residual_m
        end
        track.seen_mps = track.leader_mps
        track.seen_ms, track.readings, track.spike_m = read_ms, n, nil
    end
end

-- Guard: keeps away from the leader where the distance is not held ----------------------------------------------------

do
    -- Distance still closed at this rate before the vehicle stops. An acceleration that is under way goes on until the
    -- answer begins 0.1 s later, and then dies away at the autopilot's jerk (PSC_JERK_NE, 5 m/s3 as it comes): until
    -- then the closing speed rises.
    local function closing_distance(closing_mps)
        local accel_mps2 = max(0, own.accel_mps2)
        local peak_mps = max(0, closing_mps + accel_mps2 * 0.1 + 0.5 * accel_mps2 * accel_mps2 / 5)
        return peak_mps * C.DELAY + peak_mps * peak_mps / (2 * C.DECEL)
    end

    -- The closing speed from which the vehicle still stops at the close distance: the inverse of the above without
    -- acceleration.
    function guard.stoppable_mps(range_m)
        local lag_mps = C.DECEL * C.DELAY
        return sqrt(lag_mps * lag_mps + 2 * C.DECEL * max(0, range_m - C.CLOSE)) - lag_mps
    end

    -- Whether to fly a target of the applet's own away from the leader: it is still closing (slower than 0.15 m/s is
    -- noise of the tracker), and the point in force does not lead away fast enough (Guided flies about 1 m/s for each
    -- metre to it).
    local function should_back_off(behind_m, near_m, closing_mps)
        local approach_mps = -track.leader_mps
        if guard.evading then return approach_mps > 0.15 or closing_mps > 0 end
        if closing_mps <= 0.15 or behind_m > max(0.5, approach_mps) then return false end
        return approach_mps > 0.15 or near_m < C.CLOSE or near_m - closing_distance(closing_mps) < 1
    end

    -- Too close and the track agrees: the state, and backing off.
    local function too_close(near_m, closing_mps, t_ms)
        guard.too_close = true
        report.state = 3
        -- Half a metre lower than points lead (flight/lowest.py) what is near is most likely the ground.
        local LOWEST_M = 2
        local here = -ahrs:get_relative_position_D_home() > LOWEST_M - 0.5 and vehicle:get_likely_flying()
            and ahrs:get_location()
        -- Metres that the point in force lies behind the vehicle, away from the leader; 0 if it leads towards the
        -- leader.
        local behind_m = 0
        local ahead_m, mps = stream.ahead(here, t_ms)
        if ahead_m and mps <= 0 then behind_m = max(0, -ahead_m) end
        -- Back to the wanted distance, and the leader's approach of one second more, by 0.5 to 5 m.
        local evades = here and should_back_off(behind_m, near_m, closing_mps) and own.fly_back(clamp(
            hold.distance_m() - near_m + max(0, -track.leader_mps), 0.5, 5))
        if evades then
            report.state = 6
            -- Sent at once: the ground tool would call it back to where it held it.
            if not guard.evading then report.named_ms = nil end
        end
        guard.evading = evades
        return (evades or behind_m > 0.5) and C.SPD_MAX or C.SPD_MIN -- free to get away
    end

    -- The distance is kept otherwise: nothing is too close, and no target of the guard's is in force.
    function guard.rest()
        guard.too_close, guard.evading = false, false
    end

    -- The limit to set, by the sonar's status.
    function guard.update(status, t_ms)
        local trusted = track.trusted(t_ms)
        local closing_mps = trusted and own.mps - track.leader_mps or 0
        local near_m = trusted and track.range_m or nil
        local margin_m = guard.too_close and 0.3 or 0 -- it ends so far beyond where it began
        -- From a leader that comes (0.5 m/s) it backs off to the wanted distance: if it stopped as soon as it was as
        -- fast, it would begin anew from nearer, its nose and its sonar down.
        if status == 2 or (near_m and (near_m < 1 + margin_m -- closing or not
            or near_m - closing_distance(closing_mps) < C.CLOSE + margin_m
            or (guard.evading and track.leader_mps < -0.5 and near_m < hold.distance_m()))) then
            return too_close(near_m or 0, closing_mps, t_ms)
        end
        guard.rest()
        return clamp(C.SPD_LOST, C.SPD_MIN, C.SPD_MAX)
    end
end

-- Hold: points that carry a velocity -----------------------------------------------------------------------------------

do
    local LEAN_S = 0.3 -- until this vehicle leans against its motion

    -- The distance to keep, centre to centre: the ground tool opens the slot for a leader that can turn round faster
    -- than the vehicle gets away from ECHO_DIST. Such a leader may turn round faster than one on a mission does.
    function hold.distance_m()
        return max(C.DIST, stream.at_ms and stream.opens_m or 0)
    end

    -- Where the point belongs along the beam (metres ahead of here), and its speed there: at the wanted distance from
    -- the leader and as fast as the leader. ahead_m, mps: the same of the streamed point. While the sonar sees nothing,
    -- of the track and the point whichever is the more cautious (in a line the track: all points of a line go back at
    -- once with the first one's slot). A point is moved little towards the leader, 1 m and 1 m/s, for the ground tool may
    -- know why it is far from it, and further away from the leader, 5 m: a sonar that is stuck then moves the vehicle no
    -- further, and no faster.
    local function along_beam(ahead_m, mps, braking_mps2, t_ms)
        -- From where both will be once this vehicle leans. Of what is missing four tenths are flown back: with all of it
        -- Guided flies further back than it is sent. The gaps of a column swung, by 0.16 m instead of 0.13, and one alone
        -- that had come to 1.6 m was next out of reach, at 4.9 m.
        local wanted_m = track.range_m - hold.distance_m()
            + (track.leader_mps - own.mps + 0.5 * braking_mps2 * LEAN_S) * LEAN_S
        wanted_m = max(wanted_m, 0.4 * wanted_m)
        local unseen_ms = t_ms - track.seen_ms
        if unseen_ms > 300 and stream.manner ~= 2 then
            return max(min(wanted_m, ahead_m), ahead_m - 5), min(track.leader_mps, mps)
        end
        if wanted_m > ahead_m + 1 then return ahead_m + 1, min(mps, track.leader_mps) end
        if wanted_m < ahead_m - 5 then return ahead_m - 5, mps end
        return wanted_m, min(track.leader_mps, mps + 1)
    end

    -- Away from the leader at once, towards it gently. Guided closes a gap with all its acceleration: a leader found 4 m
    -- away was flown at with 4 m/s, lost by 25 degrees of lean, braked for and found again, and met as it turned round
    -- (SITL 4.8, 0.60 m). So a target is hardly ahead, what is left of the gap is flown by speed, 1 m/s for each metre,
    -- and that rises by 3.5 m/s2 (20 degrees of lean): by less a fast leader is caught up later.
    local function gently(t_ms, wanted_m, wanted_mps)
        local mps = (hold.active and hold.mps or own.mps) + 3.5 * min(t_ms - (hold.at_ms or t_ms), 100) * 0.001
        hold.mps, hold.at_ms = min(wanted_mps + clamp(wanted_m - 0.2, 0, 1), mps), t_ms
        return min(wanted_m, 0.2), hold.mps
    end

    -- Sends Guided the streamed point, moved along the beam. False: it was not taken, or there is none.
    local function move(t_ms)
        local here = vehicle:get_likely_flying() and ahrs:get_location()
        local position = here and ahrs:get_relative_position_NED_origin()
        if not position then return false end
        local ahead_m, mps, north_m, east_m = stream.ahead(here, t_ms)
        if not ahead_m then return false end
        -- A leader that brakes is answered with its own deceleration.
        local braking_mps2 = stream.manner == 2 and 0 or track.braking_mps2(t_ms)
        local wanted_m, wanted_mps, least_mps
        if stream.manner == 1 then
            -- The ground tool leads it past another vehicle, which the applet does not know: the point as it is, but
            -- towards the leader no faster than it can still stop. Guided flies 1 m/s for each metre to the point, and
            -- its velocity.
            hold.mps, hold.at_ms = own.mps, t_ms
            wanted_m = ahead_m
            wanted_mps = min(mps, track.leader_mps + guard.stoppable_mps(track.range_m) - ahead_m)
        else
            wanted_m, wanted_mps = along_beam(ahead_m, mps, braking_mps2, t_ms)
            -- In a line, and at its head, back no faster than the point, or than the leader comes, by 0.4 m/s and by
            -- what is missing to the close distance: a retreat that is not needed meets whoever flies behind, who flies
            -- back harder still. How another follower comes the ground tool knows sooner than the track. The place is
            -- moved no further than that, either: over a metre back against a velocity ahead is flown back at first.
            if stream.manner > 1 then
                local comes_mps = stream.manner == 2 and mps or min(mps, track.leader_mps)
                least_mps = min(0, comes_mps) - 0.4 - max(0, C.CLOSE - track.range_m)
                wanted_m = max(wanted_m, least_mps)
            end
            if stream.manner == 2 then
                -- In a line behind another follower: as fast as the point, which is the leader's speed for all of them at
                -- the same moment. Who answers the braking of the one ahead brakes harder than that one, and the next
                -- harder still: a column of five came to 0.2 m. But no faster than it can still stop, as above.
                wanted_mps = min(mps, track.leader_mps + guard.stoppable_mps(track.range_m) - wanted_m)
            end
            wanted_m, wanted_mps = gently(t_ms, wanted_m, wanted_mps)
        end
        -- Its speed is right once it leans. What two points ago told is not so any more.
        local quickens_mps2 = t_ms - stream.at_ms < 300 and stream.quickens_mps2 or 0
        if braking_mps2 < 0 then quickens_mps2 = min(quickens_mps2, braking_mps2) end
        wanted_mps = wanted_mps + quickens_mps2 * LEAN_S
        if least_mps then wanted_mps = max(wanted_mps, least_mps - wanted_m) end
        local by_m, by_mps = wanted_m - ahead_m, wanted_mps - mps
        position:x(position:x() + north_m + by_m * look.north)
        position:y(position:y() + east_m + by_m * look.east)
        position:z(position:z() - stream.up_m - ahrs:get_relative_position_D_home())
        local velocity, acceleration = Vector3f(), Vector3f()
        velocity:x(stream.north_mps + by_mps * look.north)
        velocity:y(stream.east_mps + by_mps * look.east)
        -- What it does not yet decelerate by itself: more than the lean can give, and Guided's own plan would wait.
        local missing_mps2 = max(braking_mps2, min(0, braking_mps2 - own.accel_mps2))
        acceleration:x(missing_mps2 * look.north)
        acceleration:y(missing_mps2 * look.east)
        return order(nil, position, velocity, acceleration, stream.yaw_rad or yaw_rad(ahrs))
    end

    -- A point with no velocity at all is where the ground tool has stopped it: there it stays.
    function hold.is_wanted()
        return stream.north_mps ~= 0 or stream.east_mps ~= 0
    end

    -- Whether the distance is held: points carry a velocity, and there is a leader to hold on to.
    function hold.update(t_ms)
        hold.active = hold.is_wanted() and track.trusted(t_ms) and move(t_ms)
        if not hold.active then return false end
        report.state = 7
        if track.range_m < C.CLOSE then
            report.state = track.leader_mps < own.mps and 6 or 3
        end
        return true
    end
end

-- Stream watch -------------------------------------------------------------------------------------------------------

do
    -- SET_POSITION_TARGET_GLOBAL_INT as `echowing follow` sends it: a position, height above home (frame 6), a
    -- velocity, with a yaw or without. Of the acceleration, which the autopilot is told to ignore: how far the slot has
    -- opened, its manner (1: past another vehicle than the leader, 2: in a line behind another follower, 3: behind the
    -- leader, at the head of a line, 0: else), and the format that says so. Of the rate of the yaw, ignored too: by how
    -- much this vehicle has to speed up towards the leader to keep its distance.
    function stream.take(payload, sender, t_ms)
        local lat, lng, up_m, north_mps, east_mps, _, opens_m, manner, format, yaw, quickens_mps2, mask, system, _,
            frame = ('<i4i4fffffffffI2BBB'):unpack(payload, 5)
        if system ~= 0 and system ~= MY_SYSTEM then return end
        if format ~= C.FORMAT or frame ~= 6 or mask & ~0x0400 ~= 0x09C0 then
            return refuse('points of another format')
        end
        -- The autopilot's greatest latitude and longitude, and more metres than any slot opens to or copter climbs to.
        local looks = mask & 0x0400 == 0
        if not (is_within(lat, 900000000) and is_within(lng, 1800000000) and is_within(up_m, 10000)
            and is_within(north_mps, FASTEST_MPS) and is_within(east_mps, FASTEST_MPS) and is_within(opens_m, 1000)
            and is_within(manner, 3) and is_within(quickens_mps2, 10)
            and (not looks or is_within(yaw, 2 * pi))) then
            return refuse('implausible point')
        end
        -- Points count from one sender until it has been silent for a second: two would pull the vehicle to and fro.
        if sender ~= stream.sender and stream.at_ms and t_ms - stream.at_ms < 1000 then
            return refuse('points of a second sender')
        end
        stream.sender, stream.at_ms = sender, t_ms
        stream.lat, stream.lng, stream.up_m, stream.yaw_rad = lat, lng, up_m, looks and yaw or nil
        stream.north_mps, stream.east_mps = north_mps, east_mps
        stream.opens_m, stream.manner = min(opens_m, 6), manner -- as the highest ECHO_DIST
        stream.quickens_mps2 = quickens_mps2
    end

    -- The point in force now: metres ahead of here (along the beam) and its speed there; the same north and east in
    -- metres. Nil without one: a point older than a second is not the vehicle's target.
    function stream.ahead(here, t_ms)
        if stream.holding or not here or not stream.at_ms or t_ms - stream.at_ms >= 1000 then return nil end
        local target = here:copy()
        target:lat(stream.lat)
        target:lng(stream.lng)
        local offset, dt_s = here:get_distance_NE(target), (t_ms - stream.at_ms) * 0.001
        local north_m, east_m = offset:x() + stream.north_mps * dt_s, offset:y() + stream.east_mps * dt_s
        return north_m * look.north + east_m * look.east,
            stream.north_mps * look.north + stream.east_mps * look.east, north_m, east_m
    end

    -- Holds the vehicle where it is once a stream of guided points has fallen silent.
    function stream.watch(t_ms)
        if not (C.STREAM_T > 0 and stream.at_ms and t_ms - stream.at_ms > C.STREAM_T * 1000) then
            stream.holding = false
            return
        end
        if not guard.too_close then report.state = 5 end
        if guard.evading then
            stream.holding = false -- hold again where the evasion ends
            return
        end
        if stream.holding then
            -- One that was let fly slowly stands before its place, and would go on to it when the pilot's speed is
            -- back.
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
    local CRC_EXTRA = { [86] = 5, [251] = 170 } -- SET_POSITION_TARGET_GLOBAL_INT, NAMED_VALUE_FLOAT

    control.deaf = not pcall(function()
        mavlink:init(10, 2) -- so many messages wait
        for id in pairs(CRC_EXTRA) do mavlink:register_rx_msgid(id) end
    end)

    -- Whether bytes that end with their checksum are whole (X.25, which is then 0): four bytes at a time. Zeros that
    -- follow change nothing.
    local function is_whole(bytes)
        local crc = 0xFFFF
        for i = 1, #bytes - 3, 4 do
            crc = crc ~ ('<i4'):unpack(bytes, i)
            crc = crc ~ crc << 4 ~ crc << 11 ~ crc << 16
            crc = crc ~ crc << 8 ~ crc << 22
            crc = crc ~ crc << 16
            crc = crc >> 16 ~ crc >> 21 ~ crc >> 28
        end
        return crc == 0
    end

    -- Id, sender and payload of a mavlink_message_t, the payload with the zeros that MAVLink 2 leaves out; nil for a
    -- message that is for another script, or damaged. Bytes that the checksum does not cover are not used.
    local function read(message)
        -- A mavlink_message_t has 299 bytes where system ids have 32 bits, 291 where they have 8.
        local wide = #message >= 299 and 3 or 0
        local magic, length, flags = message:byte(3, 5)
        local component, id = ('<BI3'):unpack(message, 9 + wide)
        local extra = CRC_EXTRA[id]
        if not extra then return nil end
        local old = magic == 0xFE -- MAVLink 1
        -- 53 bytes are the longest payload; flag 1, a signature, is the only one that changes nothing before the
        -- checksum.
        if length <= 53 and (old or flags & ~1 == 0) then
            local payload = message:sub(13 + wide, 12 + wide + length)
            -- As on the wire: from the length to one byte of the system's id, its component, one or three bytes of id.
            local sent = message:sub(4, old and 4 or 6) .. message:sub(7, 8)
                .. message:sub(9 + wide, (old and 10 or 12) + wide) .. payload
            if is_whole(sent .. ('B'):pack(extra) .. message:sub(1, 2) .. '\0\0\0') then
                local system = message:byte(8)
                return id, system, system << 8 | component, payload .. ('\0'):rep(53 - length)
            end
        end
        return nil, refuse('damaged message')
    end

    function take_messages(t_ms)
        if control.deaf then
            if C.ENABLE < 1 or (control.told_ms and t_ms - control.told_ms < 10000) then return end
            control.told_ms = t_ms
            return say(3, 'other scripts leave no place to receive')
        end
        for _ = 1, 10 do
            local message, link = mavlink:receive_chan()
            if not message then return end
            local id, system, sender, payload = read(message)
            if id == 86 then
                stream.take(payload, sender, t_ms)
            elseif id and system == MY_SYSTEM then
                local board_ms, value, name = ('<I4fc10'):unpack(payload)
                if name == 'SNR_RAW\0\0\0' and not look.fixed
                    and (is_within(value, 20) and value > 0 or refuse('implausible reading')) then
                    look.component, look.link = sender & 0xFF, link
                    track.take(value, track.taken_ms(board_ms, t_ms), t_ms)
                end
            end
        end
    end
end

-- The speed parameter ------------------------------------------------------------------------------------------------

do
    local parameter = Parameter(SPEED_NAME)

    -- A value of the speed parameter, in its unit, that is a pilot's.
    local function is_speed(units)
        return is_within(units, FASTEST_MPS * SPEED_UNITS) and units > 0
    end

    function speed.is_set()
        return control.active or is_speed(parameter:get())
    end

    function speed.take_over()
        speed.pilot_units, speed.units, speed.changes = parameter:get(), nil, {}
        mirror:set(speed.pilot_units) -- before the speed is touched: a restart must find it
    end

    function speed.write(mps)
        if not order(mps) then return end
        parameter:set(mps * SPEED_UNITS)
        speed.units, speed.out_mps = parameter:get(), mps
    end

    function speed.give_back(units)
        parameter:set(units)
        if vehicle:get_mode() == 4 then order(units / SPEED_UNITS) end
        mirror:set(0)
        speed.units = nil
    end

    -- Outside changes of the speed parameter: one is the pilot's, four in ten seconds are another script's.
    function speed.fought_over(t_ms)
        return speed.changes[4] and t_ms - speed.changes[4] < 10000
    end

    -- The pilot has set the speed parameter while the applet is in control: his value from now on.
    function speed.watch(t_ms)
        local units = parameter:get()
        if speed.units and units ~= speed.units and is_speed(units) then
            local changes = speed.changes
            speed.changes = { t_ms, changes[1], changes[2], changes[3] }
            if control.active then
                speed.pilot_units, speed.conflict = units, speed.fought_over(t_ms)
                mirror:set(units)
            end
        end
        speed.units = units
    end

    -- A script that died in control left the pilot's value in the mirror.
    local left = mirror:get()
    if is_speed(left) then
        speed.give_back(left)
        say(4, ('restarted, %s back to %.2f'):format(SPEED_NAME, left))
    end
end

-- What pilots see ----------------------------------------------------------------------------------------------------

do
    -- Of each state from 1 on: severity, text, and how long it is not announced again, however often it comes and goes.
    local NOTICES = {
        5, 'searching', 10000,
        6, 'tracking', 10000,
        4, 'too close', 3000,
        4, 'no sonar data', 10000,
        2, 'stream lost, holding here', 3000,
        2, 'too close, backing off', 3000,
        6, 'holding the distance', 10000,
    }

    -- One text per change of state.
    function report.announce(t_ms)
        local state = report.state
        if state == report.announced then return end
        local severity, text, gap_ms = NOTICES[3 * state - 2], NOTICES[3 * state - 1], NOTICES[3 * state]
        local last_ms = report.announced_ms[state]
        if last_ms and t_ms - last_ms < gap_ms then return end
        report.announced, report.announced_ms[state] = state, t_ms
        if state == 1 or state == 4 then text = ('%s, %.1f m/s'):format(text, C.SPD_LOST) end
        say(severity, text)
    end

    function report.send(range_m, t_ms)
        if not report.named_ms or t_ms - report.named_ms >= 500 then
            report.named_ms = t_ms
            gcs:send_named_float('ECHO_RNG', range_m or 0)
            gcs:send_named_float('ECHO_SPD', speed.out_mps)
            gcs:send_named_float('ECHO_STATE', report.state)
        end
        if C.LOG_HZ <= 0 or (report.log_ms and t_ms - report.log_ms < 1000 / C.LOG_HZ - 1) then return end
        report.log_ms = t_ms
        logger:write('ECHO', 'Rng,Flt,Err,Spd,St,Ref', 'ffffBI', 'mmmn--', '0000--', range_m or 0.0,
            track.range_m or 0, range_m and range_m - hold.distance_m() or 0, speed.out_mps, report.state,
            refused.count)
    end
end

-- Before arming ------------------------------------------------------------------------------------------------------

local check_arming
do
    local checked_ms
    local id = arming.get_aux_auth_id and arming:get_aux_auth_id()
    if not id then say(4, 'no arming check, all authorisation ids are taken') end

    local function reason_not_to_arm(t_ms, status)
        if control.deaf then return 'other scripts leave no place to receive' end
        if speed.fought_over(t_ms) then return 'another script sets ' .. SPEED_NAME end
        return status == 0 and 'no forward rangefinder' or nil
    end

    function check_arming(t_ms, status)
        if not id or arming:is_armed() then return end
        speed.watch(t_ms)
        if checked_ms and t_ms - checked_ms < 1000 then return end
        checked_ms = t_ms
        local reason = C.ENABLE >= 1 and C.ARM_CHK >= 1 and reason_not_to_arm(t_ms, status) or nil
        if reason then
            arming:set_aux_auth_failed(id, 'ECHO: ' .. reason)
        else
            arming:set_aux_auth_passed(id)
        end
    end
end

-- Control: who flies, and the update ---------------------------------------------------------------------------------

do
    -- Why the applet must not act now, or nil.
    local function reason_not_to_act()
        if C.ENABLE < 1 then return 'disabled' end
        if not arming:is_armed() then
            speed.conflict = false
            return 'disarmed'
        end
        if vehicle:get_mode() ~= 4 then return 'mode' end -- Guided
        if control.deaf then return 'deaf' end
        if not speed.is_set() then return SPEED_NAME .. ' out of range' end
        if speed.conflict then return 'another script sets ' .. SPEED_NAME end
        local switch = C.SWITCH > 0 and rc:find_channel_for_option(C.SWITCH // 1 | 0)
        if C.SWITCH > 0 and not (switch and switch:get_aux_switch_pos() == 2) then return 'switch' end -- high
        return nil
    end

    local function take_control(t_ms)
        speed.take_over()
        control.active = true
        stream.at_ms, stream.holding = nil, false
        guard.evading, guard.seen_ms, guard.data_ms = false, t_ms, t_ms
        report.announced_ms, report.state, report.announced = {}, 2, 2 -- a target is assumed until it is missed
        track.range_m = nil
        say(6, 'in control')
    end

    local function hand_back(reason)
        if not control.active then return end
        speed.watch(own.at_ms) -- the pilot may have set it since the last update
        control.active = false
        speed.give_back(speed.pilot_units)
        report.state = 0
        say(5, ('handed back, %s %.2f (%s)'):format(SPEED_NAME, speed.pilot_units, reason))
    end

    local function act(t_ms, range_m, status)
        if not control.active then take_control(t_ms) end
        speed.watch(t_ms)
        if track.is_target(range_m) and not (track.raw_ms and t_ms - track.raw_ms <= 300) then
            -- No single readings for 3 periods of the slower sonar: the average has to do.
            track.update(range_m, t_ms, t_ms)
        end
        if status > 1 then guard.data_ms = t_ms end
        if track.is_target(range_m) then guard.seen_ms = t_ms end
        report.state = 2
        if t_ms - guard.data_ms >= C.NODATA_T * 1000 then
            report.state = 4
        elseif t_ms - guard.seen_ms >= C.LOST_T * 1000 then
            report.state = 1
        end
        -- The limit of the correction towards the points.
        local limit_mps = C.SPD_MAX
        if hold.update(t_ms) then
            guard.rest()
        elseif hold.is_wanted() and not stream.holding and not track.trusted(t_ms) and status ~= 2 then
            guard.rest()
            limit_mps = clamp(C.SPD_LOST, C.SPD_MIN, C.SPD_MAX)
        else
            limit_mps = guard.update(status, t_ms)
        end
        stream.watch(t_ms)
        speed.write(limit_mps)
        report.announce(t_ms)
        report.send(range_m, t_ms)
        return (guard.evading or hold.active) and 20 or 50
    end

    local function update()
        local t_ms = (millis() - boot):toint() -- since the script started: a plain integer, wraps after 24 days
        read_some()
        own.update(t_ms)
        track.carry(t_ms)
        local range_m, status = track.read(t_ms)
        take_messages(t_ms)
        local reason = reason_not_to_act()
        if not reason then return act(t_ms, range_m, status) end
        hand_back(reason)
        check_arming(t_ms, status)
        return 200
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
            say(2, 'error ' .. tostring(result))
        end
        pcall(hand_back, 'error')
        return control.run, 1000
    end
end

say(6, 'ready')
return control.run, 200
