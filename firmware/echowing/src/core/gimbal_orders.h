// What the bench has ordered the gimbal to do, in place of what the flight would.
#pragma once

#include <stdint.h>

#include "parameters.h"
#include "ports.h"
#include "tracker.h"

namespace echowing {

class GimbalOrders {
 public:
  // Each returns false, and changes nothing, for what cannot be done.
  // `servo` is 1 for pan, 2 for tilt; the other one stays at `now_at`.
  bool hold_servo(Aim now_at, float servo, float pulse_us);
  bool hold_angles(const Parameters& parameters, float pitch_deg, float yaw_deg);
  // 0: automatic, 1: scan, 2: straight ahead.
  bool choose(float choice);
  void cancel() { order_ = Order::kNone; }

  // The mode ordered, or `automatic`.
  GimbalMode mode(GimbalMode automatic) const;
  // For GimbalMode::kHold.
  Aim aim() const { return hold_; }

 private:
  enum class Order : uint8_t { kNone, kScan, kCentre, kHold };

  bool hold(float pan_us, float tilt_us);

  Order order_ = Order::kNone;
  Aim hold_ = {};
};

}  // namespace echowing
