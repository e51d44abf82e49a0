// Which vehicle this is, whether its autopilot is heard, and whether it is armed.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "timing.h"

namespace echowing {

class AutopilotWatch {
 public:
  // Any message from the autopilot's port; only the vehicle's own heartbeats count.
  void on_message(Microseconds now, const mavlink_message_t& message);
  // Once a loop turn.
  void step(Microseconds now) { heard_ = silence_.running(now); }

  bool heard() const { return heard_; }
  bool armed() const { return heard_ && armed_; }
  // Armed when last heard: silence may be a broken wire in flight.
  bool maybe_flying() const { return armed_; }
  // The vehicle's system id once learned, else `before`.
  uint8_t system_id(uint8_t before) const { return system_id_ != 0 ? system_id_ : before; }

 private:
  bool is_ours(const mavlink_message_t& message) const;

  Timeout silence_;
  uint8_t system_id_ = 0;
  bool heard_ = false;
  bool armed_ = false;
};

}  // namespace echowing
