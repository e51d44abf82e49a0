#include "tracker.h"

#include <math.h>

#include "scan.h"
#include "servo_model.h"

namespace echowing {
namespace {

constexpr uint8_t kQualityReadings = 10;
// The part of its offset that a held target loses each servo frame: 1/e is left after a second.
constexpr float kFade = kServoFrame * 0.001f;

uint16_t apart(uint16_t a, uint16_t b) { return a > b ? a - b : b - a; }

bool same(Aim a, Aim b) { return a.pan_us == b.pan_us && a.tilt_us == b.tilt_us; }

// An order that moves to where the target was heard has learned of it: what it has moved is no
// offset any more.
float left_of(float offset, float moved) {
  if (offset * moved <= 0.0f) return offset;
  return fabsf(moved) < fabsf(offset) ? offset - moved : 0.0f;
}

}  // namespace

Tracker::Tracker(const Parameters& parameters, Instant now)
    : parameters_(parameters),
      aim_(scan_centre(parameters)),
      hold_(aim_),
      last_seen_(aim_),
      arrival_(now.ms) {}

void Tracker::step(const Instant& now, GimbalMode mode, float deviation_rad) {
  if (mode != mode_) begin(mode);
  deviation_rad_ = deviation_rad;
  filter_.expire(now.ms);
  const bool scans = mode == GimbalMode::kScan || mode == GimbalMode::kLookRound;
  if (mode == GimbalMode::kCentre) move(now, scan_centre(parameters_));
  if (mode == GimbalMode::kHold) move(now, hold_);
  if (scans && !tracking_) scan(now);
}

void Tracker::begin(GimbalMode mode) {
  const bool looked = looks();
  mode_ = mode;
  restart_ = true;
  if (!looks()) return;
  offset_ = {};
  settling_ = true;
  moving_ = false;
  entering_ = entering_ || !looked;
}

// The ordered direction is the best guess where nothing has been heard.
uint8_t Tracker::first_point() const {
  if (looks()) return faded_scan_point(parameters_, point_, offset_, deviation_rad_);
  return seen_ ? nearest_scan_point(parameters_, last_seen_) : 0;
}

void Tracker::scan(const Instant& now) {
  if (restart_) {
    restart_ = false;
    point_ = first_point();
  } else if (heard_here_ && !dwell_.running(now)) {
    point_ = static_cast<uint8_t>((point_ + 1) % kScanPoints);
  } else {
    return;
  }
  heard_here_ = false;
  arrival_ = now.ms;
  dwell_.start(now, parameters_.whole(Parameter::kDwell));
  if (!looks()) return move(now, scan_point(parameters_, point_));
  moving_ = settling_ = true;
  forget();
}

Direction Tracker::settle_offset() {
  if (moving_) offset_ = scan_offset(parameters_, point_, deviation_rad_);
  moving_ = false;
  return offset_;
}

// Who knows no height only carries on: the ear knows better, and its offset stays.
void Tracker::steady(const Instant& now, Aim aim, bool has_height) {
  if (!looks()) return;
  if (settling_) arrival_ = now.ms + travel_time(aim);
  if (entering_ && far_apart(aim, aim_)) forget();
  settling_ = entering_ = false;
  aim_ = aim;
  if (!tracking_ || !has_height) return;
  offset_.right_rad -= kFade * offset_.right_rad;
  offset_.up_rad -= kFade * offset_.up_rad;
}

// An echo from a slightly moved axis is of the same target.
void Tracker::on_order(Direction moved) {
  const Direction before = offset_;
  if (tracking_) {
    offset_ = {left_of(offset_.right_rad, moved.right_rad), left_of(offset_.up_rad, moved.up_rad)};
  }
  const float right_rad = fabsf(moved.right_rad + offset_.right_rad - before.right_rad);
  const float up_rad = fabsf(moved.up_rad + offset_.up_rad - before.up_rad);
  if (fmaxf(right_rad, up_rad) <= half_beam_rad()) return;
  settling_ = true;
  if (!tracking_) return;  // the search goes on round the new direction
  offset_ = {};
  moving_ = false;
  restart_ = true;
  forget();
}

bool Tracker::far_apart(Aim a, Aim b) const {
  const float pan_us =
      fabsf(half_beam_rad() / kRadiansPerDegree * parameters_.get(Parameter::kPanScale));
  const float tilt_us =
      fabsf(half_beam_rad() / kRadiansPerDegree * parameters_.get(Parameter::kTiltScale));
  return apart(a.pan_us, b.pan_us) > pan_us || apart(a.tilt_us, b.tilt_us) > tilt_us;
}

float Tracker::half_beam_rad() const {
  return 0.5f * kRadiansPerDegree * parameters_.get(Parameter::kBeamWidth);
}

void Tracker::move(const Instant& now, Aim aim) {
  if (same(aim, aim_)) return;
  // An echo from another direction is of another target until it proves to be the same.
  forget();
  arrival_ = now.ms + travel_time(aim);
  aim_ = aim;
}

// Rounded up: a ping in the millisecond of the arrival may have come just before it.
Milliseconds Tracker::travel_time(Aim aim) const {
  const uint16_t pan_us = apart(aim.pan_us, aim_.pan_us);
  const uint16_t tilt_us = apart(aim.tilt_us, aim_.tilt_us);
  const uint32_t farther_us = pan_us > tilt_us ? pan_us : tilt_us;
  return kServoFrame + 1 + farther_us * UINT32_C(1000) / parameters_.whole(Parameter::kServoRate);
}

void Tracker::on_reading(const Instant& now, const Reading& reading) {
  if (reached(reading.triggered.ms, arrival_)) heard_here_ = true;
  if (reading.range_cm >= parameters_.whole(Parameter::kTrackRange)) {
    remember(false);
    return miss();
  }
  const bool acquired = !tracking_;
  tracking_ = true;
  const FilterSettings settings = {
      parameters_.whole(Parameter::kAverageWindow),
      static_cast<uint16_t>(100 * parameters_.whole(Parameter::kGateSpeed)),
  };
  const bool taken = filter_.add(now.ms, reading.range_cm, settings);
  remember(taken || acquired);
  if (taken) return see();
  // A reading that nothing confirms is as good as none, or a stream of wild ones would keep an
  // old average alive.
  if (!acquired) miss();
}

void Tracker::see() {
  confirmed_ = true;
  misses_ = 0;
  seen_ = true;
  last_seen_ = aim_;
}

void Tracker::miss() {
  if (!tracking_) return;
  ++misses_;
  if (misses_ < parameters_.whole(Parameter::kMissLimit)) return;
  // One wild reading stops the search for a moment; it must not send it back to where it began.
  if (confirmed_) restart_ = true;
  forget();
}

void Tracker::forget() {
  tracking_ = confirmed_ = false;
  misses_ = 0;
  filter_.clear();
}

void Tracker::remember(bool good) {
  history_ = static_cast<uint16_t>(history_ << 1 | (good ? 1 : 0));
  if (history_size_ < kQualityReadings) ++history_size_;
}

uint8_t Tracker::quality_percent() const {
  uint8_t good = 0;
  for (uint8_t age = 0; age < history_size_; ++age) good += history_ >> age & 1;
  return good == 0 ? 1 : static_cast<uint8_t>(100 * good / history_size_);
}

}  // namespace echowing
