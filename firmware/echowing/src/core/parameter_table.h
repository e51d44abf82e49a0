// clang-format off
// Every tunable of the co-processor, once: the code, the parameter protocol and the table in
// firmware/README.md come from here. Order is the index on the wire and in memory.
//
// ECHOWING_PARAMETER(identifier, "NAME", default, least, most, whole, in_flight, "unit", "what it does")
//
// in_flight: may be changed while the autopilot is armed. False for all that could blind the sonar,
// turn it away from the leader, or change who we are.
ECHOWING_PARAMETER(kSystemId, "SYS_ID", 0, 0, 255, true, false, "", "MAVLink system id of the vehicle; 0: learn it from the autopilot and store it here")
ECHOWING_PARAMETER(kComponentId, "COMP_ID", 191, 2, 250, true, false, "", "MAVLink component id (191: onboard computer)")
ECHOWING_PARAMETER(kSonarAddress, "SONAR_ADDR", 112, 8, 119, true, false, "", "7-bit I2C address of the sonar (112 = 0x70, as delivered)")
ECHOWING_PARAMETER(kSonarPeriod, "SONAR_PERIOD", 100, 25, 200, true, false, "ms", "time between readings; under 100 late echoes read as near ones")
ECHOWING_PARAMETER(kSonarJitter, "SONAR_JITTER", 5, 0, 20, true, true, "ms", "random delay of each ping: late echoes then show as jumping readings")
ECHOWING_PARAMETER(kTrackRange, "TRACK_RANGE", 450, 30, 765, true, false, "cm", "a reading nearer than this is the leader; others are misses")
ECHOWING_PARAMETER(kMissLimit, "MISS_LIMIT", 2, 1, 20, true, true, "", "misses in a row that start a search")
ECHOWING_PARAMETER(kAverageWindow, "AVG_WINDOW", 450, 0, 500, true, true, "ms", "span of the readings in the running average; 0: the newest reading alone")
ECHOWING_PARAMETER(kGateSpeed, "GATE_SPEED", 8, 2, 50, true, false, "m/s", "a reading that means a faster target is left out of the average")
ECHOWING_PARAMETER(kDwell, "SCAN_DWELL", 300, 50, 5000, true, true, "ms", "time at each point of the search")
ECHOWING_PARAMETER(kPanLeft, "PAN_LEFT", 1330, 800, 2200, true, false, "us", "pan pulse at the left of the search")
ECHOWING_PARAMETER(kPanMiddle, "PAN_MIDDLE", 1380, 800, 2200, true, false, "us", "pan pulse straight ahead")
ECHOWING_PARAMETER(kPanRight, "PAN_RIGHT", 1400, 800, 2200, true, false, "us", "pan pulse at the right of the search")
ECHOWING_PARAMETER(kTiltLow, "TILT_LOW", 1300, 800, 2200, true, false, "us", "tilt pulse at the bottom of the search")
ECHOWING_PARAMETER(kTiltMiddle, "TILT_MIDDLE", 1400, 800, 2200, true, false, "us", "tilt pulse level")
ECHOWING_PARAMETER(kTiltHigh, "TILT_HIGH", 1500, 800, 2200, true, false, "us", "tilt pulse at the top of the search")
ECHOWING_PARAMETER(kPanScale, "PAN_US_DEG", 10, -30, 30, false, false, "us/deg", "pulse per degree to the right; negative for a reversed servo")
ECHOWING_PARAMETER(kTiltScale, "TILT_US_DEG", 10, -30, 30, false, false, "us/deg", "pulse per degree upwards; negative for a reversed servo")
ECHOWING_PARAMETER(kServoRate, "SERVO_RATE", 2500, 100, 20000, true, false, "us/s", "least speed of the servos: half of the usual 60 degrees in 0.12 s")
ECHOWING_PARAMETER(kBeamWidth, "BEAM_WIDTH", 40, 1, 120, false, true, "deg", "full width of the sonar's beam, reported as its field of view")
ECHOWING_PARAMETER(kReportRate, "REPORT_RATE", 20, 5, 40, true, false, "Hz", "DISTANCE_SENSOR messages per second")
ECHOWING_PARAMETER(kSensorId, "SENSOR_ID", 0, 0, 255, true, false, "", "id in DISTANCE_SENSOR, to match the autopilot's RNGFNDx_ADDR where that is set")
ECHOWING_PARAMETER(kInfoRate, "INFO_RATE", 2, 1, 20, true, true, "Hz", "state, pan and tilt for display, on the autopilot's port; the autopilot passes them on to its radios")
ECHOWING_PARAMETER(kPanReach, "PAN_REACH", 60, 0, 90, true, false, "deg", "most that the gimbal pans to each side when it looks where it is told")
ECHOWING_PARAMETER(kTiltReach, "TILT_REACH", 30, 0, 90, true, false, "deg", "most that it tilts up and down then")
