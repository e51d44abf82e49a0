// The commands understood: MAV_CMD numbers of MAVLink's common set, and what their parameters are.
#pragma once

#include <stdint.h>

namespace echowing {

enum CommandId : uint16_t {
  kCommandSetServo = 183,        // 1: pan, 2: tilt; pulse in us. Holds the gimbal there
  kCommandStorage = 245,         // 2: default parameters
  kCommandReboot = 246,          // 1: restart, 3: into the bootloader
  kCommandSetInterval = 511,     // message id, interval in us (0 usual, -1 off)
  kCommandRequestMessage = 512,  // message id
  kCommandCapabilities = 520,    // 1; older ground stations ask for the version like this
  kCommandGimbalAngles = 1000,   // pitch up, yaw right in degrees. Holds the gimbal there
  kCommandScan = 31010,          // USER_1. 0: automatic, 1: scan, 2: stop, centred
  kCommandSonarAddress = 31011,  // USER_2. new 7-bit address
  kCommandSelfTest = 31012,      // USER_3. results come as STATUSTEXT
};

struct Command {
  uint8_t target_system;
  uint8_t target_component;
  uint16_t id;
  float parameters[2];
};

}  // namespace echowing
