// Which vehicle this is, whether its autopilot reports, and whether it is armed.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "timing.h"

namespace echowing {

// A vehicle forwards the heartbeats of other vehicles to the co-processor's port, in any order.
// Our own system id is therefore fixed by parameter, or learned once: from a vehicle that reports
// several times in a row, with no other between. While our own vehicle does not report, or is not
// known, every vehicle counts as ours: one that is armed is enough for "armed".
class AutopilotWatch {
 public:
  explicit AutopilotWatch(const Instant& now) { grace_.start(now, kSilence); }

  // Our vehicle's system id; 0: not known, learn it.
  void set_own(uint8_t system);
  uint8_t own() const { return own_; }

  // Any message from the autopilot's port; only heartbeats of autopilots count.
  void on_message(const Instant& now, const mavlink_message_t& message);
  // Once a loop turn.
  void step(const Instant& now);

  // True once after our system id was learned.
  bool take_learned();
  // True once in a while, as long as it is not clear which vehicle is ours.
  bool take_conflict(const Instant& now);

  bool heard() const { return own_ != 0 ? own_heard_ : others_heard_; }
  bool armed() const { return own_heard_ ? own_armed_ : others_armed_; }
  // Armed in its last heartbeat: silence may be a broken wire in flight.
  bool maybe_flying() const { return flying_; }

 private:
  // Heartbeats come once a second; five missed in a row are more than a busy port.
  static constexpr Milliseconds kSilence = 5000;

  void on_own(const Instant& now, bool armed);
  void on_other(const Instant& now, uint8_t system, bool armed);

  uint8_t own_ = 0;
  bool own_armed_ = false;  // in the last heartbeat
  bool own_heard_ = false;
  bool others_heard_ = false;
  bool others_armed_ = false;
  bool flying_ = false;
  bool learned_ = false;
  bool several_ = false;   // vehicles report while ours is not known
  uint8_t candidate_ = 0;  // the vehicle of the last heartbeat
  uint8_t beats_ = 0;      // of it, with no other between
  Milliseconds alone_since_ = 0;
  Timeout own_silence_;
  Timeout others_silence_;
  Timeout others_armed_pause_;
  Timeout grace_;  // our autopilot may still be starting
  Timeout notice_pause_;
};

}  // namespace echowing
