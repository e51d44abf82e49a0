// Time as the core sees it: an instant handed in by the caller.
#pragma once

#include <stdint.h>

namespace echowing {

// Wraps every 71.6 minutes: for what lasts milliseconds and is looked at every turn.
using Microseconds = uint32_t;
// Wraps every 49.7 days, as MAVLink's time_boot_ms does: for everything slower.
using Milliseconds = uint32_t;

constexpr Microseconds kMillisecond = 1000;
constexpr Microseconds kSecond = 1000000;

constexpr Microseconds milliseconds(uint32_t count) { return count * kMillisecond; }

// The time of a loop turn, on both clocks.
struct Instant {
  Microseconds us;
  Milliseconds ms;
};

// True from `due` on. Right across the wrap while the two are less than half a wrap apart: 35
// minutes on the microsecond clock, 24 days on the millisecond clock.
constexpr bool reached(uint32_t now, uint32_t due) { return static_cast<int32_t>(now - due) >= 0; }

// A span of time that ends once and stays ended. It runs on the millisecond clock, so that it may
// be left alone for as long as a cable is unplugged.
class Timeout {
 public:
  void start(const Instant& now, Milliseconds span) {
    due_ = now.ms + span;
    running_ = true;
  }
  void stop() { running_ = false; }
  bool running(const Instant& now) {
    if (running_ && reached(now.ms, due_)) running_ = false;
    return running_;
  }

 private:
  Milliseconds due_ = 0;
  bool running_ = false;
};

// Milliseconds since start.
class Uptime {
 public:
  explicit Uptime(Microseconds start, Milliseconds ms = 0) : last_(start), ms_(ms) {}
  void advance(Microseconds now) {
    rest_us_ += now - last_;
    last_ = now;
    // A turn is a millisecond or two: this is faster than a 32-bit division on AVR.
    for (; rest_us_ >= kMillisecond; rest_us_ -= kMillisecond) ++ms_;
  }
  Milliseconds ms() const { return ms_; }

 private:
  Microseconds last_;
  uint32_t rest_us_ = 0;
  Milliseconds ms_;
};

}  // namespace echowing
