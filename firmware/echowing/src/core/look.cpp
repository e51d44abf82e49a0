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

Vector sight(Direction earth) {
  return vector({wrapped(earth.right_rad), limited(earth.up_rad, -0.5f * kPi, 0.5f * kPi)});
}

void Look::on_ping(const Instant& now) {
  pointing_.find(servos_.at(now.ms, servo_rate()));
  ping_us_ = now.us;
  ping_axis_.in_earth_frame = attitude_.fresh(now);
  ordered_at_ping_ = active(now);
  ping_unfinished_ = axis_wanted_ = true;
}

// An echo takes many turns: something is left to do only where turns are very long.
void Look::on_reading(const Instant& now, Tracker& tracker) {
  while (ping_unfinished_) work(now, tracker);
  axis_ = ping_axis_;
}

// A turn in which the search has chosen a point has done enough: to begin a frame is cheap.
bool Look::work(const Instant& now, Tracker& tracker) {
  if (next_ != Step::kNone) {
    proceed(now, tracker);
    return true;
  }
  if (order_.renew()) {
    tracker.on_order(order_.moved());
    return true;
  }
  if (!tracker.urgent() && attitude_.renew()) return true;
  return begin_frame(now, tracker) || pointing_.step(parameters_) || tell_ping();
}

bool Look::begin_frame(const Instant& now, Tracker& tracker) {
  const bool due = tracker.urgent() || now.us - frame_us_ >= milliseconds(kServoFrame);
  if (!tracker.looks() || !due) return false;
  frame_us_ = now.us;
  for_ping_ = false;
  time_us_ = now.us + kAhead;
  offset_ = tracker.settle_offset();
  next_ = Step::kSight;
  return true;
}

bool Look::tell_ping() {
  if (!axis_wanted_) return false;
  axis_wanted_ = false;
  ping_axis_.rotation = pointing_.found();
  if (ping_axis_.in_earth_frame) {
    ping_axis_.rotation = normalized(product(attitude_.at(ping_us_), ping_axis_.rotation));
  }
  ping_axis_.limits = 0;
  ping_unfinished_ = ordered_at_ping_;
  if (!ordered_at_ping_) return true;
  for_ping_ = true;
  time_us_ = ping_us_;
  offset_ = {};
  next_ = Step::kSight;
  return true;
}

void Look::proceed(const Instant& now, Tracker& tracker) {
  switch (next_) {
    case Step::kSight: {
      const Direction ordered = order_.at(time_us_);
      sight_ = sight({ordered.right_rad + offset_.right_rad, ordered.up_rad + offset_.up_rad});
      next_ = Step::kBody;
      return;
    }
    case Step::kBody:
      sight_ = turned_back(attitude_.at(time_us_), sight_);
      next_ = Step::kAim;
      return;
    default:
      next_ = Step::kNone;
      return finish(now, reach(parameters_, direction(sight_)), tracker);
  }
}

void Look::finish(const Instant& now, Reach found, Tracker& tracker) {
  if (!for_ping_) return tracker.steady(now, found.aim, order_.has_height());
  ping_axis_.limits = found.limits;
  ping_unfinished_ = false;
}

}  // namespace echowing
