#include "attitude.h"

#include <math.h>

namespace echowing {
namespace {

constexpr Milliseconds kFresh = 500;
// Its 40 bytes take 3.5 ms on the wire; the rest is the autopilot's loop, 2.5 ms, and our own.
constexpr Microseconds kAge = milliseconds(6);
constexpr Milliseconds kRequestPause = 2000;
// Of the 50 that are wanted in the pause: a busy autopilot sends some late.
constexpr uint8_t kEnough = 40;
static_assert(kEnough * Attitude::kInterval < milliseconds(kRequestPause), "never satisfied");

// A gyro's full scale, 2000 degrees a second.
constexpr float kFastest_rps = 35.0f;
constexpr float kRounding_rad = 0.001f;

// Not-a-number is not within anything.
bool within(float value, float most) { return fabsf(value) <= most; }

bool plausible(const mavlink_attitude_t& told) {
  return within(told.roll, kPi + kRounding_rad) && within(told.pitch, 0.5f * kPi + kRounding_rad) &&
         within(told.yaw, kPi + kRounding_rad) && within(told.rollspeed, kFastest_rps) &&
         within(told.pitchspeed, kFastest_rps) && within(told.yawspeed, kFastest_rps);
}

}  // namespace

void Attitude::on_message(const Instant& now, const mavlink_message_t& message) {
  mavlink_attitude_t told;
  mavlink_msg_attitude_decode(&message, &told);
  if (!plausible(told)) return;
  newest_ = {
      {told.roll, told.pitch, told.yaw}, {told.rollspeed, told.pitchspeed, told.yawspeed}, now};
  steps_left_ = 2;
  if (count_ < kEnough) ++count_;
}

bool Attitude::renew() {
  if (steps_left_ == 0) return false;
  if (steps_left_-- == 2) {
    nose_ = nose(newest_.angles_rad.y, newest_.angles_rad.z);
    return true;
  }
  rotation_ = rolled(nose_, newest_.angles_rad.x);
  rates_rps_ = newest_.rates_rps;
  at_us_ = newest_.received.us - kAge;
  freshness_.start(newest_.received, kFresh);
  return true;
}

Quaternion Attitude::at(Microseconds time) const {
  const float half_s = 0.5e-6f * static_cast<float>(static_cast<int32_t>(time - at_us_));
  return product(rotation_,
                 {1.0f, half_s * rates_rps_.x, half_s * rates_rps_.y, half_s * rates_rps_.z});
}

bool Attitude::take_request(const Instant& now) {
  if (request_pause_.running(now)) return false;
  request_pause_.start(now, kRequestPause);
  const bool enough = count_ == kEnough;
  count_ = 0;
  return !enough;
}

}  // namespace echowing
