#include "servo_model.h"

namespace echowing {
namespace {

// The slowest servo is anywhere within this: 1400 us at 100 us a second.
constexpr Milliseconds kLongestWay = 14000;

uint16_t approach(uint16_t from, uint16_t to, uint32_t most) {
  const uint16_t way = to > from ? to - from : from - to;
  if (way <= most) return to;
  const uint16_t step = static_cast<uint16_t>(most);
  return static_cast<uint16_t>(to > from ? from + step : from - step);
}

}  // namespace

void ServoModel::follow(Milliseconds now, Aim aim, uint16_t rate) {
  at(now, rate);
  goal_ = next_;  // what came less than the delay ago begins a little early
  next_ = aim;
  next_ms_ = now + kServoDelay;
  waiting_ = true;
}

Aim ServoModel::at(Milliseconds now, uint16_t rate) {
  if (waiting_ && reached(now, next_ms_)) {
    move_until(next_ms_, rate);
    goal_ = next_;
    waiting_ = false;
  }
  move_until(now, rate);
  return at_;
}

void ServoModel::move_until(Milliseconds time, uint16_t rate) {
  const Milliseconds span = time - at_ms_;
  const uint32_t most = (span < kLongestWay ? span : kLongestWay) * rate / 1000;
  at_ = {approach(at_.pan_us, goal_.pan_us, most), approach(at_.tilt_us, goal_.tilt_us, most)};
  at_ms_ = time;
}

}  // namespace echowing
