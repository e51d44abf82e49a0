// Time as the core sees it: microseconds handed in by the caller, wrapping every 71.6 minutes.
#pragma once

#include <stdint.h>

namespace echowing {

using Microseconds = uint32_t;

constexpr Microseconds kMillisecond = 1000;
constexpr Microseconds kSecond = 1000000;

constexpr Microseconds milliseconds(uint32_t count) { return count * kMillisecond; }

// True from `due` on. Right across the wrap while the two are less than 35 minutes apart.
constexpr bool reached(Microseconds now, Microseconds due) {
  return static_cast<int32_t>(now - due) >= 0;
}

// A span of time that ends once and stays ended, so that no wrap can bring it back to life.
// `running` has to be asked at least every 35 minutes; the loop asks every turn.
class Timeout {
 public:
  void start(Microseconds now, Microseconds span) {
    due_ = now + span;
    running_ = true;
  }
  void stop() { running_ = false; }
  bool running(Microseconds now) {
    if (running_ && reached(now, due_)) running_ = false;
    return running_;
  }

 private:
  Microseconds due_ = 0;
  bool running_ = false;
};

// Milliseconds since start, wrapping at 49.7 days as MAVLink's time_boot_ms does.
class Uptime {
 public:
  explicit Uptime(Microseconds start, uint32_t ms = 0) : last_(start), ms_(ms) {}
  void advance(Microseconds now) {
    rest_us_ += now - last_;
    last_ = now;
    // A turn is a millisecond or two: this is faster than a 32-bit division on AVR.
    for (; rest_us_ >= kMillisecond; rest_us_ -= kMillisecond) ++ms_;
  }
  uint32_t ms() const { return ms_; }

 private:
  Microseconds last_;
  uint32_t rest_us_ = 0;
  uint32_t ms_;
};

}  // namespace echowing
