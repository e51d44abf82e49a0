#include "filter.h"

namespace echowing {
namespace {

bool near(uint16_t a, uint16_t b, uint16_t gate) { return (a > b ? a - b : b - a) <= gate; }

}  // namespace

bool RangeFilter::add(uint16_t range_cm, uint8_t count, uint16_t gate_cm) {
  if (size_ > 0 && near(range_cm, readings_cm_[newest_], gate_cm)) {
    holding_ = false;
    take(range_cm, count);
    return true;
  }
  if (holding_ && near(range_cm, held_cm_, gate_cm)) {
    const uint16_t confirmed_cm = held_cm_;
    clear();
    take(confirmed_cm, count);
    take(range_cm, count);
    return true;
  }
  held_cm_ = range_cm;
  holding_ = true;
  return false;
}

void RangeFilter::clear() {
  size_ = 0;
  newest_ = 0;
  holding_ = false;
}

void RangeFilter::take(uint16_t range_cm, uint8_t count) {
  newest_ = size_ == 0 ? 0 : static_cast<uint8_t>((newest_ + 1) % kCapacity);
  readings_cm_[newest_] = range_cm;
  size_ = size_ < count ? size_ + 1 : count;
}

uint16_t RangeFilter::average_cm() const {
  uint16_t sum = 0;  // 20 readings of 765 are 15300
  uint8_t place = newest_;
  for (uint8_t left = size_; left > 0; --left) {
    sum = static_cast<uint16_t>(sum + readings_cm_[place]);
    place = place == 0 ? kCapacity - 1 : static_cast<uint8_t>(place - 1);
  }
  return static_cast<uint16_t>(sum + size_ / 2) / size_;
}

}  // namespace echowing
