#include "self_test.h"

#include "scan.h"

namespace echowing {
namespace {

// Left, right, low, high, centre: long enough to be seen.
constexpr uint8_t kStops = 5;
constexpr Milliseconds kPause = 500;

}  // namespace

void SelfTest::start(const Instant& now) {
  *this = SelfTest();
  running_ = true;
  pause_.start(now, kPause);
}

bool SelfTest::step(const Instant& now) {
  if (!running_ || pause_.running(now)) return false;
  pause_.start(now, kPause);
  ++stop_;
  running_ = stop_ < kStops;
  return !running_;
}

Aim SelfTest::aim(const Parameters& parameters) const {
  Aim aim = scan_centre(parameters);
  switch (stop_) {
    case 0: aim.pan_us = parameters.whole(Parameter::kPanLeft); break;
    case 1: aim.pan_us = parameters.whole(Parameter::kPanRight); break;
    case 2: aim.tilt_us = parameters.whole(Parameter::kTiltLow); break;
    case 3: aim.tilt_us = parameters.whole(Parameter::kTiltHigh); break;
    default: break;
  }
  return aim;
}

}  // namespace echowing
