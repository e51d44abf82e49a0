// The bench's self test: the servos go through their corners; then what was received meanwhile.
#pragma once

#include <stdint.h>

#include "parameters.h"
#include "ports.h"
#include "timing.h"

namespace echowing {

class SelfTest {
 public:
  static constexpr uint8_t kPorts = 2;

  void start(const Instant& now);
  void abort() { running_ = false; }
  bool running() const { return running_; }
  // Once a loop turn; true in the turn in which the test has ended.
  bool step(const Instant& now);

  // Where the gimbal points while the test runs.
  Aim aim(const Parameters& parameters) const;

  void on_reading() { sonar_heard_ = true; }
  // A message of our own came back in: a plug joins the port's two data lines.
  void on_own_message(uint8_t port) { looped_[port] = true; }

  bool sonar_heard() const { return sonar_heard_; }
  bool looped(uint8_t port) const { return looped_[port]; }

 private:
  bool running_ = false;
  uint8_t stop_ = 0;
  Timeout pause_;
  bool sonar_heard_ = false;
  bool looped_[kPorts] = {};
};

}  // namespace echowing
