// How mavgen's structs lie on the wire. Their fields are in wire order without gaps, but compilers
// may pad the end: the length is the generated one, never sizeof.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"

namespace echowing {

template <typename Payload>
struct WireFormat;

#define ECHOWING_WIRE_FORMAT(name, NAME)                                     \
  template <>                                                                \
  struct WireFormat<mavlink_##name##_t> {                                    \
    static constexpr uint32_t kId = MAVLINK_MSG_ID_##NAME;                   \
    static constexpr uint8_t kLength = MAVLINK_MSG_ID_##NAME##_LEN;          \
    static constexpr uint8_t kCrcExtra = MAVLINK_MSG_ID_##NAME##_CRC;        \
    static_assert(sizeof(mavlink_##name##_t) >= kLength &&                   \
                      sizeof(mavlink_##name##_t) < kLength + sizeof(double), \
                  "padded in the middle");                                   \
  };

ECHOWING_WIRE_FORMAT(heartbeat, HEARTBEAT)
ECHOWING_WIRE_FORMAT(param_value, PARAM_VALUE)
ECHOWING_WIRE_FORMAT(command_long, COMMAND_LONG)
ECHOWING_WIRE_FORMAT(command_ack, COMMAND_ACK)
ECHOWING_WIRE_FORMAT(distance_sensor, DISTANCE_SENSOR)
ECHOWING_WIRE_FORMAT(autopilot_version, AUTOPILOT_VERSION)
ECHOWING_WIRE_FORMAT(named_value_float, NAMED_VALUE_FLOAT)
ECHOWING_WIRE_FORMAT(statustext, STATUSTEXT)
ECHOWING_WIRE_FORMAT(gimbal_device_attitude_status, GIMBAL_DEVICE_ATTITUDE_STATUS)

#undef ECHOWING_WIRE_FORMAT

}  // namespace echowing
