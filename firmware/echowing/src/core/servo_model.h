// Where the servos are by now, as far as their pulses tell.
#pragma once

#include <stdint.h>

#include "ports.h"
#include "timing.h"

namespace echowing {

// A servo gets a new pulse with its next 50 Hz frame.
constexpr Milliseconds kServoFrame = 20;
// From a changed pulse until the servo moves, on average: half a frame, the pulse itself, and some
// milliseconds in the servo.
constexpr Milliseconds kServoDelay = 15;

class ServoModel {
 public:
  ServoModel(Aim at, Milliseconds now) : at_(at), goal_(at), next_(at), at_ms_(now) {}

  // The pulses have changed. `rate`: speed of the servos in microseconds of pulse a second.
  void follow(Milliseconds now, Aim aim, uint16_t rate);
  // Where they are; `now` does not go back.
  Aim at(Milliseconds now, uint16_t rate);

 private:
  void move_until(Milliseconds time, uint16_t rate);

  Aim at_;
  Aim goal_;
  Aim next_;  // the goal from next_ms_ on
  Milliseconds at_ms_;
  Milliseconds next_ms_ = 0;
  bool waiting_ = false;  // for next_ms_
};

}  // namespace echowing
