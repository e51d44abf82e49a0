// Running average of the newest readings that keeps wild ones out.
//
// A gate, not a median: a reading is taken if it lies within the gate of the one taken before it.
// One that does not is held back, and taken only if the next reading confirms it, which then
// begins a new average. A median of three would delay every reading by one period to reject the
// same single outliers; the gate delays only the first reading of a new target.
#pragma once

#include <stdint.h>

namespace echowing {

class RangeFilter {
 public:
  static constexpr uint8_t kCapacity = 20;  // the most that AVG_COUNT allows

  // Returns whether the reading was taken. Distances in centimetres.
  bool add(uint16_t range_cm, uint8_t count, uint16_t gate_cm);
  void clear();

  // The average in whole centimetres needs at least one taken reading.
  bool has_average() const { return size_ > 0; }
  uint16_t average_cm() const;

 private:
  void take(uint16_t range_cm, uint8_t count);

  uint16_t readings_cm_[kCapacity] = {};
  uint8_t size_ = 0;
  uint8_t newest_ = 0;
  uint16_t held_cm_ = 0;
  bool holding_ = false;
};

}  // namespace echowing
