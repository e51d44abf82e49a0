// The gimbal looks: its axis held in the earth frame where it is ordered to, against whatever the
// vehicle does; and where it looked at each ping.
#pragma once

#include <stdint.h>

#include "attitude.h"
#include "look_order.h"
#include "parameters.h"
#include "ports.h"
#include "report.h"
#include "servo_model.h"
#include "timing.h"
#include "tracker.h"

namespace echowing {

// The servos' pulses for a direction in the body frame, as far as they reach.
struct Reach {
  Aim aim;
  uint8_t limits;  // GIMBAL_DEVICE_ERROR_FLAGS that say where they do not
};
Reach reach(const Parameters& parameters, Direction body);

// The unit vector of an earth-frame direction of at most some turns.
Vector sight(Direction earth);

// Where the sonar looked at a ping.
struct Axis {
  Quaternion rotation = {1.0f, 0.0f, 0.0f, 0.0f};  // from the earth to the axis, or from the body
  bool in_earth_frame = false;
  uint8_t limits = 0;  // GIMBAL_DEVICE_ERROR_FLAGS
};

class Look {
 public:
  Look(const Parameters& parameters, Aim aim, const Instant& now)
      : parameters_(parameters), servos_(aim, now.ms) {}

  // Of our own autopilot.
  void on_attitude(const Instant& now, const mavlink_message_t& message) {
    attitude_.on_message(now, message);
  }
  // A GIMBAL_DEVICE_SET_ATTITUDE to us.
  void on_order(const Instant& now, const mavlink_message_t& message) {
    order_.on_message(now, message);
  }
  // Whether attitude has to be asked for.
  bool take_request(const Instant& now) { return attitude_.take_request(now); }

  // Both an order and attitude are there.
  bool active(const Instant& now) { return order_.fresh(now) && attitude_.fresh(now); }
  float deviation_rad() const { return order_.deviation_rad(); }

  // The servos were given other pulses.
  void on_aim(const Instant& now, Aim aim) { servos_.follow(now.ms, aim, servo_rate()); }
  void on_ping(const Instant& now);
  void on_reading(const Instant& now, Tracker& tracker);
  // One of the costly steps that are due; true if there was one. Once a turn.
  bool work(const Instant& now, Tracker& tracker);

  // Of the newest reading's ping.
  const Axis& axis() const { return axis_; }

 private:
  // The costly steps: a direction in the earth frame, the same in the body's, and its pulses.
  enum class Step : uint8_t { kNone, kSight, kBody, kAim };

  bool begin_frame(const Instant& now, Tracker& tracker);
  // Turns the axis of the ping to the earth, and looks whether what was ordered lay within reach.
  bool tell_ping();
  void proceed(const Instant& now, Tracker& tracker);
  void finish(const Instant& now, Reach found, Tracker& tracker);

  uint16_t servo_rate() const { return parameters_.whole(Parameter::kServoRate); }

  const Parameters& parameters_;
  Attitude attitude_;
  LookOrder order_;
  ServoModel servos_;
  Microseconds frame_us_ = 0;    // of the newest pulses
  PointingFinder pointing_{{}};  // of the ping
  Microseconds ping_us_ = 0;
  bool ordered_at_ping_ = false;
  bool axis_wanted_ = false;
  bool ping_unfinished_ = false;
  Step next_ = Step::kNone;
  bool for_ping_ = false;
  Microseconds time_us_ = 0;  // for which the step is
  Direction offset_ = {};
  Vector sight_ = {};
  Axis ping_axis_;
  Axis axis_;
};

}  // namespace echowing
