// Gimbal control: search with the figure 8, hold still on a target, search again when it is lost.
// Or all of that round a direction in the earth frame that somebody orders: see look.h, which finds
// the pulses.
#pragma once

#include <stdint.h>

#include "filter.h"
#include "parameters.h"
#include "ports.h"
#include "rotation.h"
#include "sonar_driver.h"
#include "timing.h"

namespace echowing {

// Who decides where the gimbal points.
enum class GimbalMode : uint8_t {
  kCentre,     // straight ahead
  kScan,       // search and track
  kHold,       // where the bench has put it
  kLook,       // in the ordered direction
  kLookRound,  // search and track round it
};

class Tracker {
 public:
  Tracker(const Parameters& parameters, Instant now);

  // Once a loop turn, before the readings of that turn. `deviation_rad`: how unsure the ordered
  // direction is, for GimbalMode::kLookRound.
  void step(const Instant& now, GimbalMode mode, float deviation_rad);
  void on_reading(const Instant& now, const Reading& reading);
  // For GimbalMode::kHold.
  void hold_at(Aim aim) { hold_ = aim; }

  // The pulses come from `steady`, once a servo frame, or at once where that is `urgent`.
  bool looks() const { return mode_ == GimbalMode::kLook || mode_ == GimbalMode::kLookRound; }
  bool urgent() const { return looks() && settling_; }
  // How far off the ordered direction to look.
  Direction settle_offset();
  void steady(const Instant& now, Aim aim, bool has_height);
  // The ordered direction has moved so far at once.
  void on_order(Direction moved);

  Aim aim() const { return aim_; }
  // A target is in the beam; the gimbal holds still.
  bool tracking() const { return tracking_; }
  // A range may be reported: a second reading has confirmed the target.
  bool has_range() const { return tracking_ && filter_.has_average(); }
  uint16_t range_cm() const { return filter_.average_cm(); }
  // Share of good readings among the newest ten, 1 (none) to 100, as MAVLink counts quality.
  uint8_t quality_percent() const;

 private:
  void move(const Instant& now, Aim aim);
  void begin(GimbalMode mode);
  void scan(const Instant& now);
  uint8_t first_point() const;
  bool far_apart(Aim a, Aim b) const;
  float half_beam_rad() const;
  void see();
  void miss();
  void forget();
  void remember(bool good);
  Milliseconds travel_time(Aim aim) const;

  const Parameters& parameters_;
  RangeFilter filter_;
  GimbalMode mode_ = GimbalMode::kCentre;
  Aim aim_;
  Aim hold_;
  Aim last_seen_;
  bool seen_ = false;
  bool tracking_ = false;
  bool confirmed_ = false;  // the target, by a second reading
  bool restart_ = true;
  Direction offset_ = {};
  float deviation_rad_ = 0.0f;
  bool entering_ = false;  // the first pulses of looking are to come
  bool moving_ = false;    // to the offset of another point
  bool settling_ = false;  // pulses for another offset are to come
  bool heard_here_ = false;
  uint8_t point_ = 0;
  uint8_t misses_ = 0;
  uint16_t history_ = 0;
  uint8_t history_size_ = 0;
  Timeout dwell_;
  Milliseconds arrival_ = 0;
};

}  // namespace echowing
