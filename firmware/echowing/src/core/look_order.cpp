#include "look_order.h"

#include <math.h>

namespace echowing {
namespace {

constexpr Milliseconds kFresh = 1000;
// The ground tool's orders go round the expected direction in this time (flight/look.py).
constexpr float kRound_s = 2.0f;
// Norm of a quaternion that was meant as one.
constexpr float kLeastNorm = 0.9f;
constexpr float kMostNorm = 1.1f;
// Beyond it the direction would be senseless before the next message.
constexpr float kFastest_rps = 4.0f;

constexpr uint16_t kEnds = GIMBAL_DEVICE_FLAGS_RETRACT | GIMBAL_DEVICE_FLAGS_NEUTRAL;

bool in_earth_frame(uint16_t flags) {
  return (flags & GIMBAL_DEVICE_FLAGS_YAW_LOCK) != 0 &&
         (flags & GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME) == 0;
}

// Not-a-number fails each comparison.
bool is_rotation(const Quaternion& q) {
  const float squared = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
  return squared >= kLeastNorm * kLeastNorm && squared <= kMostNorm * kMostNorm;
}

float rate(float told_rps) { return fabsf(told_rps) <= kFastest_rps ? told_rps : 0.0f; }

float deviation(float told_rad) { return told_rad >= 0.0f ? told_rad : 0.0f; }

}  // namespace

void LookOrder::on_message(const Instant& now, const mavlink_message_t& message) {
  const bool same_sender = message.sysid == system_ && message.compid == component_;
  if (!same_sender && (renewing_ || freshness_.running(now))) return;
  mavlink_gimbal_device_set_attitude_t told;
  mavlink_msg_gimbal_device_set_attitude_decode(&message, &told);
  if ((told.flags & kEnds) != 0) return end();
  const Quaternion q = {told.q[0], told.q[1], told.q[2], told.q[3]};
  if (!in_earth_frame(told.flags) || !is_rotation(q)) return;
  newest_ = {q,
             {rate(told.angular_velocity_z), rate(told.angular_velocity_y)},
             deviation(told.angular_velocity_x),
             (told.flags & GIMBAL_DEVICE_FLAGS_PITCH_LOCK) != 0,
             now};
  renewing_ = true;
  system_ = message.sysid;
  component_ = message.compid;
}

void LookOrder::end() {
  renewing_ = false;
  freshness_.stop();
}

bool LookOrder::renew() {
  if (!renewing_) return false;
  renewing_ = false;
  const bool going_on = freshness_.running(newest_.received);
  const Direction before = at(newest_.received.us);
  direction_ = direction(forward(newest_.rotation));
  rates_rps_ = newest_.rates_rps;
  has_height_ = newest_.has_height;
  if (has_height_) {
    const float since_s = 1e-6f * static_cast<float>(newest_.received.us - at_us_);
    height_rad_ += (direction_.up_rad - height_rad_) * fminf(1.0f, since_s / kRound_s);
  } else {
    direction_.up_rad = height_rad_;
    rates_rps_.up_rad = 0.0f;
  }
  deviation_rad_ = newest_.deviation_rad;
  at_us_ = newest_.received.us;
  freshness_.start(newest_.received, kFresh);
  moved_ = {};
  if (!going_on) return true;
  moved_ = {wrapped(direction_.right_rad - before.right_rad), direction_.up_rad - before.up_rad};
  return true;
}

Direction LookOrder::at(Microseconds time) const {
  const float since_s = 1e-6f * static_cast<float>(static_cast<int32_t>(time - at_us_));
  return {direction_.right_rad + since_s * rates_rps_.right_rad,
          direction_.up_rad + since_s * rates_rps_.up_rad};
}

}  // namespace echowing
