// Where to look, as GIMBAL_DEVICE_SET_ATTITUDE orders it: a direction in the earth frame that moves
// on by its own rates, and how unsure it is.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "rotation.h"
#include "timing.h"

namespace echowing {

class LookOrder {
 public:
  // True if the order was taken. One sender at a time: another one's turn comes when the first has
  // been silent for a second, or has ended its order.
  bool on_message(const Instant& now, const mavlink_message_t& message);
  bool fresh(const Instant& now) { return freshness_.running(now); }
  // At a time near now, while the order is fresh.
  Direction at(Microseconds time) const;
  // Standard deviation.
  float deviation_rad() const { return deviation_rad_; }

 private:
  Direction received_ = {};
  Direction rates_rps_ = {};
  float deviation_rad_ = 0.0f;
  Microseconds received_us_ = 0;
  Timeout freshness_;
  uint8_t system_ = 0;
  uint8_t component_ = 0;
};

}  // namespace echowing
