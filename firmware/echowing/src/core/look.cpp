#include "look.h"

#include <math.h>

#include "scan.h"

namespace echowing {
namespace {

// Steady is the axis in the middle of the frame for which a pulse is in force.
constexpr Microseconds kAhead = milliseconds(kServoDelay) + milliseconds(kServoFrame) / 2;

float limited(float value, float least, float most) { return fmaxf(least, fminf(value, most)); }

struct Servo {
  uint16_t pulse_us;
  bool limited;
};

Servo servo(float angle_rad, uint16_t centre_us, float us_per_deg, uint16_t reach_deg) {
  const float most_deg = reach_deg;
  const float angle_deg = angle_rad / kRadiansPerDegree;
  const float reached_deg = limited(angle_deg, -most_deg, most_deg);
  const float wanted_us = centre_us + reached_deg * us_per_deg;
  const float pulse_us = limited(wanted_us, kShortestPulse_us, kLongestPulse_us);
  return {static_cast<uint16_t>(pulse_us + 0.5f),
          reached_deg != angle_deg || pulse_us != wanted_us};
}

}  // namespace

Reach reach(const Parameters& parameters, Direction body) {
  const Aim centre = scan_centre(parameters);
  const Servo pan = servo(body.right_rad, centre.pan_us, parameters.get(Parameter::kPanScale),
                          parameters.whole(Parameter::kPanReach));
  const Servo tilt = servo(body.up_rad, centre.tilt_us, parameters.get(Parameter::kTiltScale),
                           parameters.whole(Parameter::kTiltReach));
  uint8_t limits = 0;
  if (pan.limited) limits |= GIMBAL_DEVICE_ERROR_FLAGS_AT_YAW_LIMIT;
  if (tilt.limited) limits |= GIMBAL_DEVICE_ERROR_FLAGS_AT_PITCH_LIMIT;
  return {{pan.pulse_us, tilt.pulse_us}, limits};
}

Direction in_body(const Quaternion& attitude, Direction earth) {
  const Direction told = {wrapped(earth.right_rad), limited(earth.up_rad, -0.5f * kPi, 0.5f * kPi)};
  return direction(turned_back(attitude, vector(told)));
}

void Look::on_order(const Instant& now, const mavlink_message_t& message, Tracker& tracker) {
  const bool had_order = order_.fresh(now);
  const Direction before = order_.at(now.us);
  if (!order_.on_message(now, message) || !had_order) return;
  const Direction after = order_.at(now.us);
  tracker.on_order({wrapped(after.right_rad - before.right_rad), after.up_rad - before.up_rad});
}

void Look::on_ping(const Instant& now) {
  ping_aim_ = servos_.at(now.ms, servo_rate());
  ping_us_ = now.us;
  ping_axis_.in_earth_frame = attitude_.fresh(now);
  ordered_at_ping_ = active(now);
  axis_wanted_ = true;
}

void Look::on_reading() {
  // An echo takes many turns: this finds something left only where turns are very long.
  if (axis_wanted_) find_axis();
  if (limits_wanted_) find_limits();
  axis_ = ping_axis_;
}

bool Look::work(const Instant& now, Tracker& tracker) {
  const bool frame_due = tracker.urgent() || now.us - frame_us_ >= milliseconds(kServoFrame);
  if (tracker.looks() && frame_due) {
    frame_us_ = now.us;
    steady(now, tracker);
  } else if (axis_wanted_) {
    find_axis();
  } else if (limits_wanted_) {
    find_limits();
  } else {
    return false;
  }
  return true;
}

void Look::steady(const Instant& now, Tracker& tracker) {
  const Microseconds then = now.us + kAhead;
  const Direction ordered = order_.at(then);
  const Direction offset = tracker.offset();
  const Direction wanted = {ordered.right_rad + offset.right_rad, ordered.up_rad + offset.up_rad};
  tracker.steady(now, reach(parameters_, in_body(attitude_.at(then), wanted)).aim);
}

void Look::find_axis() {
  axis_wanted_ = false;
  limits_wanted_ = ordered_at_ping_;
  ping_axis_.limits = 0;
  const Quaternion body = pointing(parameters_, ping_aim_);
  ping_axis_.rotation =
      ping_axis_.in_earth_frame ? normalized(product(attitude_.at(ping_us_), body)) : body;
}

void Look::find_limits() {
  limits_wanted_ = false;
  const Direction body = in_body(attitude_.at(ping_us_), order_.at(ping_us_));
  ping_axis_.limits = reach(parameters_, body).limits;
}

}  // namespace echowing
