#include "gimbal_orders.h"

#include "scan.h"

namespace echowing {
namespace {

bool is_pulse(float pulse_us) {
  return pulse_us >= kShortestPulse_us && pulse_us <= kLongestPulse_us;
}

uint16_t rounded(float pulse_us) { return static_cast<uint16_t>(pulse_us + 0.5f); }

}  // namespace

bool GimbalOrders::hold(float pan_us, float tilt_us) {
  if (!is_pulse(pan_us) || !is_pulse(tilt_us)) return false;
  hold_ = {rounded(pan_us), rounded(tilt_us)};
  order_ = Order::kHold;
  return true;
}

bool GimbalOrders::hold_servo(Aim now_at, float servo, float pulse_us) {
  if (servo == 1.0f) return hold(pulse_us, now_at.tilt_us);
  if (servo == 2.0f) return hold(now_at.pan_us, pulse_us);
  return false;
}

bool GimbalOrders::hold_angles(const Parameters& parameters, float pitch_deg, float yaw_deg) {
  const Aim centre = scan_centre(parameters);
  return hold(centre.pan_us + yaw_deg * parameters.get(Parameter::kPanScale),
              centre.tilt_us + pitch_deg * parameters.get(Parameter::kTiltScale));
}

bool GimbalOrders::choose(float choice) {
  if (choice == 0.0f) {
    order_ = Order::kNone;
  } else if (choice == 1.0f) {
    order_ = Order::kScan;
  } else if (choice == 2.0f) {
    order_ = Order::kCentre;
  } else {
    return false;
  }
  return true;
}

GimbalMode GimbalOrders::mode(GimbalMode automatic) const {
  switch (order_) {
    case Order::kScan: return GimbalMode::kScan;
    case Order::kCentre: return GimbalMode::kCentre;
    case Order::kHold: return GimbalMode::kHold;
    default: return automatic;
  }
}

}  // namespace echowing
