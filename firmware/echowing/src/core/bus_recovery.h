// Frees an I2C bus whose data line a device holds low after a reset in mid-byte: nine clocks let
// it finish its byte, a STOP ends the transfer (I2C specification UM10204, 3.1.16).
#pragma once

#include <stdint.h>

#include "ports.h"

namespace echowing {

// One edge a loop turn, so that nothing waits; any turn is longer than the 5 us half clock.
class BusRecovery {
 public:
  void start() { edge_ = 0; }
  // Makes the next edge; true once the bus has been given back.
  bool step(I2cBus& bus);

 private:
  static constexpr uint8_t kClockEdges = 18;
  void stop_condition(I2cBus& bus);

  uint8_t edge_ = 0;
};

}  // namespace echowing
