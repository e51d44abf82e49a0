// What is reported of the range, and when.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "parameters.h"
#include "ports.h"
#include "rotation.h"
#include "sonar_driver.h"
#include "timing.h"
#include "tracker.h"

namespace echowing {

// On the wire a range above the longest measurable says that there is no target.
constexpr uint16_t kNoTargetCm = kFarthestCm + 1;

// A range older than this is not reported any more: the autopilot then sees "no data".
constexpr Milliseconds kStale = 300;

// Rotation from straight ahead to where the gimbal points, body frame.
Quaternion pointing(const Parameters& parameters, Aim aim);

// The same, found in two steps: each is costly on AVR.
class PointingFinder {
 public:
  explicit PointingFinder(const Quaternion& start) : found_(start) {}

  void find(Aim aim) {
    aim_ = aim;
    steps_left_ = 2;
  }
  // Makes a step; false if there was none to make.
  bool step(const Parameters& parameters);
  // The newest that was found to the end.
  const Quaternion& found() const { return found_; }

 private:
  Aim aim_ = {};
  SineCosine half_pan_ = {};
  uint8_t steps_left_ = 0;
  Quaternion found_;
};

mavlink_distance_sensor_t distance_report(const Parameters& parameters, const Tracker& tracker,
                                          const Quaternion& direction, Milliseconds reading_ms);

// The newest single reading in metres, as SNR_RAW carries it.
float raw_range_m(uint16_t range_cm);

// When to report: a steady beat that locks on to the readings where they come regularly, so that
// a report leaves in the turn of its reading.
class ReportClock {
 public:
  // True when `due` would be false, were it asked without a new reading: a quick answer for the
  // many turns in between.
  bool quiet(Microseconds now) const { return started_ && !reached(now, next_); }
  // True when a report is due; call once a turn. With `reading_soon` it waits a little for it.
  bool due(Microseconds now, bool new_reading, bool reading_soon, Microseconds period);

 private:
  // A reading this near to its beat, before or after, takes it with it.
  static constexpr Microseconds kGrace = milliseconds(2);

  void lean(Microseconds now, Microseconds period);

  Microseconds next_ = 0;
  bool started_ = false;
};

}  // namespace echowing
