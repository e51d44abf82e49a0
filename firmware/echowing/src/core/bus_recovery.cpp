#include "bus_recovery.h"

namespace echowing {

bool BusRecovery::step(I2cBus& bus) {
  if (edge_ == 0) bus.take_lines();
  if (edge_ < kClockEdges) {
    bus.drive_clock(edge_ % 2 != 0);
  } else {
    stop_condition(bus);
  }
  ++edge_;
  return edge_ > kClockEdges + 4;
}

// Data falls while the clock is low, the clock rises, then data rises while it is high.
void BusRecovery::stop_condition(I2cBus& bus) {
  switch (edge_ - kClockEdges) {
    case 0: return bus.drive_clock(false);
    case 1: return bus.drive_data(false);
    case 2: return bus.drive_clock(true);
    case 3: return bus.drive_data(true);
    default: return bus.return_lines();
  }
}

}  // namespace echowing
