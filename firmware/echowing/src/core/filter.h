// Running average of the newest readings that keeps wild ones out. Both work in time, so that they
// mean the same at any sonar period.
//
// A gate, not a median: a reading is taken if the target can have moved there since the one taken
// before it. One that is farther off is held back, and taken only if the next reading confirms it,
// which then begins a new average. A median of three would delay every reading by one period to
// reject the same single outliers; the gate delays only the first reading of a new target.
#pragma once

#include <stdint.h>

#include "timing.h"

namespace echowing {

// How a RangeFilter is set.
struct FilterSettings {
  Milliseconds window;  // span of the readings in the average, at most kLongestWindow
  uint16_t speed_cmps;  // a target does not come or go faster
};

class RangeFilter {
 public:
  static constexpr Milliseconds kLongestWindow = 500;
  // So many come in the longest window at the shortest period, 25 ms.
  static constexpr uint8_t kCapacity = 21;

  // Returns whether the reading was taken. `now`: when it came.
  bool add(Milliseconds now, uint16_t range_cm, const FilterSettings& settings);
  // Forgets readings that are too old to say anything of now. At least once a minute.
  void expire(Milliseconds now);
  void clear();

  // The average in whole centimetres needs at least one taken reading.
  bool has_average() const { return size_ > 0; }
  uint16_t average_cm() const;

 private:
  struct Sample {
    uint16_t range_cm;
    uint16_t at_ms;  // low bits: the readings kept are less than a minute apart
  };

  void take(Sample sample, Milliseconds window);

  Sample readings_[kCapacity] = {};
  uint8_t size_ = 0;
  uint8_t newest_ = 0;
  Sample held_ = {};
  bool holding_ = false;
};

}  // namespace echowing
