// clang-format off
// Every command understood, once: its handler in the Coprocessor, whether it is allowed in flight,
// and its row in firmware/README.md come from here. Numbers are those of MAVLink's common set.
//
// ECHOWING_COMMAND(handler, MAV_CMD, in_flight, "parameters and what it does")
ECHOWING_COMMAND(set_servo, 183, false, "1: pan, 2: tilt; pulse in us. Holds the gimbal there")
ECHOWING_COMMAND(restore_defaults, 245, false, "2: default parameters; the sonar's address is kept")
ECHOWING_COMMAND(restart, 246, false, "1: restart, 3: into the bootloader")
ECHOWING_COMMAND(set_message_interval, 511, false, "message id, interval in us (0 usual, -1 off). Arming ends it")
ECHOWING_COMMAND(request_message, 512, true, "message id")
ECHOWING_COMMAND(report_capabilities, 520, true, "1; older ground stations request the version like this")
ECHOWING_COMMAND(set_gimbal_angles, 1000, false, "pitch up, yaw right in degrees. Holds the gimbal there")
ECHOWING_COMMAND(set_scan, 31010, false, "USER_1. 0: automatic, 1: scan, 2: stop, centred")
ECHOWING_COMMAND(change_sonar_address, 31011, false, "USER_2. new 7-bit address")
ECHOWING_COMMAND(start_self_test, 31012, false, "USER_3. results come as STATUSTEXT")
