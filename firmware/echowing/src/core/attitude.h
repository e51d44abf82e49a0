// How the vehicle is turned, from the ATTITUDE of our own autopilot.
#pragma once

#include <stdint.h>

#include "mavlink_headers.h"
#include "rotation.h"
#include "timing.h"

namespace echowing {

class Attitude {
 public:
  // A copter's attitude accelerates by some 10 rad/s^2 at the most. Carried on by its rates for 40
  // ms it is then 0.5 degrees off, half of a servo's backlash. 1000 bytes a second.
  static constexpr Microseconds kInterval = milliseconds(40);

  // `message` is an ATTITUDE; one that is not finite and plausible is ignored.
  void on_message(const Instant& now, const mavlink_message_t& message);
  // One that has been worked out is young enough.
  bool fresh(const Instant& now) { return freshness_.running(now); }
  // Works out what the newest message means, in two steps that are costly on AVR; false if there
  // was none to make.
  bool renew();
  // Rotation from the earth to the body at a time near now, by the body's rates.
  Quaternion at(Microseconds time) const;
  // True once in a while, as long as it does not come as often as wanted.
  bool take_request(const Instant& now);

 private:
  struct Told {
    Vector angles_rad;
    Vector rates_rps;
    Instant received;
  };

  Told newest_ = {};
  uint8_t steps_left_ = 0;
  Quaternion nose_ = {};  // of the newest, before it rolls
  Quaternion rotation_ = {1.0f, 0.0f, 0.0f, 0.0f};
  Vector rates_rps_ = {};
  Microseconds at_us_ = 0;
  Timeout freshness_;
  Timeout request_pause_;
  uint8_t count_ = 0;  // since the last look at it
};

}  // namespace echowing
