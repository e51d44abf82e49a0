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

// An earth-frame direction as the body sees it. `attitude` need not be of length 1.
Direction in_body(const Quaternion& attitude, Direction earth);

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
  void on_order(const Instant& now, const mavlink_message_t& message, Tracker& tracker);
  // Whether attitude has to be asked for.
  bool take_request(const Instant& now) { return attitude_.take_request(now); }

  // Both an order and attitude are there.
  bool active(const Instant& now) { return order_.fresh(now) && attitude_.fresh(now); }
  float deviation_rad() const { return order_.deviation_rad(); }

  // The servos were given other pulses.
  void on_aim(const Instant& now, Aim aim) { servos_.follow(now.ms, aim, servo_rate()); }
  void on_ping(const Instant& now);
  void on_reading();
  // One of the costly things that are due; true if there was one. Once a turn.
  bool work(const Instant& now, Tracker& tracker);

  // Of the newest reading's ping.
  const Axis& axis() const { return axis_; }

 private:
  void steady(const Instant& now, Tracker& tracker);
  void find_axis();
  void find_limits();
  uint16_t servo_rate() const { return parameters_.whole(Parameter::kServoRate); }

  const Parameters& parameters_;
  Attitude attitude_;
  LookOrder order_;
  ServoModel servos_;
  Microseconds frame_us_ = 0;  // of the newest pulses
  Aim ping_aim_ = {};
  Microseconds ping_us_ = 0;
  bool ordered_at_ping_ = false;
  bool axis_wanted_ = false;
  bool limits_wanted_ = false;
  Axis ping_axis_;
  Axis axis_;
};

}  // namespace echowing
