#include "filter.h"

namespace echowing {
namespace {

// The leader's reflecting parts are spread over some centimetres, and readings are whole ones.
constexpr uint16_t kSpread_cm = 10;
// Readings come up to some milliseconds off their period.
constexpr uint16_t kOffBeat_ms = 10;
// One reading may be missing at the longest SONAR_PERIOD; after a longer gap the average starts
// again.
constexpr uint16_t kLongestGap_ms = 450;

uint16_t apart(uint16_t a, uint16_t b) { return a > b ? a - b : b - a; }

uint16_t elapsed_ms(uint16_t now_ms, uint16_t then_ms) {
  return static_cast<uint16_t>(now_ms - then_ms);
}

}  // namespace

bool RangeFilter::add(Milliseconds now, uint16_t range_cm, const FilterSettings& settings) {
  expire(now);
  const Sample sample = {range_cm, static_cast<uint16_t>(now)};
  const auto is_near = [&](Sample before) {
    const uint32_t span_ms = elapsed_ms(sample.at_ms, before.at_ms);
    return apart(range_cm, before.range_cm) <= kSpread_cm + settings.speed_cmps * span_ms / 1000;
  };
  if (size_ > 0 && is_near(readings_[newest_])) {
    holding_ = false;
    take(sample, settings.window);
    return true;
  }
  if (holding_ && is_near(held_)) {
    const Sample confirmed = held_;
    clear();
    take(confirmed, settings.window);
    take(sample, settings.window);
    return true;
  }
  held_ = sample;
  holding_ = true;
  return false;
}

void RangeFilter::expire(Milliseconds now) {
  const uint16_t now_ms = static_cast<uint16_t>(now);
  if (size_ > 0 && elapsed_ms(now_ms, readings_[newest_].at_ms) > kLongestGap_ms) size_ = 0;
  if (holding_ && elapsed_ms(now_ms, held_.at_ms) > kLongestGap_ms) holding_ = false;
}

void RangeFilter::clear() {
  size_ = 0;
  holding_ = false;
}

void RangeFilter::take(Sample sample, Milliseconds window) {
  newest_ = size_ == 0 ? 0 : static_cast<uint8_t>((newest_ + 1) % kCapacity);
  readings_[newest_] = sample;
  if (size_ < kCapacity) ++size_;
  for (; size_ > 1; --size_) {
    const uint8_t oldest = static_cast<uint8_t>((newest_ + kCapacity - (size_ - 1)) % kCapacity);
    if (elapsed_ms(sample.at_ms, readings_[oldest].at_ms) <= window + kOffBeat_ms) break;
  }
}

uint16_t RangeFilter::average_cm() const {
  uint16_t sum = 0;  // 21 readings of 765 are 16065
  uint8_t place = newest_;
  for (uint8_t left = size_; left > 0; --left) {
    sum = static_cast<uint16_t>(sum + readings_[place].range_cm);
    place = place == 0 ? kCapacity - 1 : static_cast<uint8_t>(place - 1);
  }
  return static_cast<uint16_t>(sum + size_ / 2) / size_;
}

}  // namespace echowing
