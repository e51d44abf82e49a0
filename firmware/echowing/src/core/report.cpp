#include "report.h"

#include <math.h>
#include <string.h>

#include "scan.h"

namespace echowing {
namespace {

constexpr uint8_t kCovarianceUnknown = 255;

// A reading that is too far off to take the beat with it moves it its way a little; one as far as
// this from a beat belongs to none, as readings are usually twice this apart.
constexpr Microseconds kLean = 1500;
constexpr Microseconds kCapture = milliseconds(25);

// Half the angle of a servo, at most a quarter turn either way: no gimbal looks farther than
// straight back.
SineCosine half_turn(uint16_t pulse_us, uint16_t centre_us, float us_per_deg) {
  if (us_per_deg == 0.0f) return {0.0f, 1.0f};
  const float offset_us = static_cast<float>(pulse_us) - static_cast<float>(centre_us);
  const float half_rad = 0.5f * offset_us / us_per_deg * kRadiansPerDegree;
  return sine_cosine(fmaxf(-0.5f * kPi, fminf(half_rad, 0.5f * kPi)));
}

SineCosine half_pan(const Parameters& parameters, Aim aim) {
  return half_turn(aim.pan_us, scan_centre(parameters).pan_us,
                   parameters.get(Parameter::kPanScale));
}

SineCosine half_tilt(const Parameters& parameters, Aim aim) {
  return half_turn(aim.tilt_us, scan_centre(parameters).tilt_us,
                   parameters.get(Parameter::kTiltScale));
}

}  // namespace

// Pan about the down axis, then tilt about the right axis.
Quaternion pointing(const Parameters& parameters, Aim aim) {
  return from_halves(half_pan(parameters, aim), half_tilt(parameters, aim));
}

bool PointingFinder::step(const Parameters& parameters) {
  if (steps_left_ == 0) return false;
  if (steps_left_ == 2) {
    half_pan_ = half_pan(parameters, aim_);
  } else {
    found_ = from_halves(half_pan_, half_tilt(parameters, aim_));
  }
  --steps_left_;
  return true;
}

mavlink_distance_sensor_t distance_report(const Parameters& parameters, const Tracker& tracker,
                                          const Quaternion& direction, Milliseconds reading_ms) {
  mavlink_distance_sensor_t report = {};
  report.time_boot_ms = reading_ms;
  report.min_distance = kNearestCm;
  report.max_distance = kFarthestCm;
  report.current_distance = tracker.has_range() ? tracker.range_cm() : kNoTargetCm;
  report.type = MAV_DISTANCE_SENSOR_ULTRASOUND;
  report.id = static_cast<uint8_t>(parameters.whole(Parameter::kSensorId));
  report.orientation = MAV_SENSOR_ROTATION_NONE;
  report.covariance = kCovarianceUnknown;
  report.horizontal_fov = parameters.get(Parameter::kBeamWidth) * kRadiansPerDegree;
  report.vertical_fov = report.horizontal_fov;
  memcpy(report.quaternion, &direction, sizeof(report.quaternion));
  report.signal_quality = tracker.quality_percent();
  return report;
}

float raw_range_m(uint16_t range_cm) {
  const uint16_t told_cm = range_cm < kFarthestCm ? range_cm : kNoTargetCm;
  return static_cast<float>(told_cm) * 0.01f;
}

bool ReportClock::due(Microseconds now, bool new_reading, bool reading_soon, Microseconds period) {
  if (!started_) {
    started_ = true;
    next_ = now;
  }
  const bool on_the_beat = new_reading && reached(now + kGrace, next_);
  if (!on_the_beat && !reached(now, reading_soon ? next_ + kGrace : next_)) {
    if (new_reading) lean(now, period);
    return false;
  }
  next_ = on_the_beat ? now + period : next_ + period;
  if (reached(now, next_)) next_ = now + period;  // no catching up after a gap
  return true;
}

void ReportClock::lean(Microseconds now, Microseconds period) {
  const Microseconds before_beat = next_ - now;
  if (before_beat <= kCapture) {
    next_ -= kLean;
  } else if (before_beat + kCapture > period) {
    next_ += kLean;
  }
}

}  // namespace echowing
