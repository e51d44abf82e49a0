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
  // A message to us. One sender at a time: another one's turn comes when the first has been silent
  // for a second, or has ended its order.
  void on_message(const Instant& now, const mavlink_message_t& message);
  // One that has been worked out is young enough.
  bool fresh(const Instant& now) { return freshness_.running(now); }
  // Works out what the newest message means, and takes it; false if there is none. Costly on AVR.
  bool renew();
  // How far the newest one has moved the direction at once.
  Direction moved() const { return moved_; }
  // At a time near now, while the order is fresh.
  Direction at(Microseconds time) const;
  // Standard deviation.
  float deviation_rad() const { return deviation_rad_; }
  // False: who orders does not know it. The mean of what was ordered stays.
  bool has_height() const { return has_height_; }

 private:
  void end();

  struct Told {
    Quaternion rotation;
    Direction rates_rps;
    float deviation_rad;
    bool has_height;
    Instant received;
  };

  Told newest_ = {};
  bool renewing_ = false;
  Direction direction_ = {};
  Direction rates_rps_ = {};
  float deviation_rad_ = 0.0f;
  bool has_height_ = true;
  float height_rad_ = 0.0f;
  Microseconds at_us_ = 0;
  Direction moved_ = {};
  Timeout freshness_;
  uint8_t system_ = 0;
  uint8_t component_ = 0;
};

}  // namespace echowing
