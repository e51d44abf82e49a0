// The co-processor: sonar, gimbal, autopilot and memory held together, one loop turn at a time.
#pragma once

#include <stdint.h>

#include "autopilot_watch.h"
#include "connection.h"
#include "gimbal_orders.h"
#include "led.h"
#include "look.h"
#include "parameter_store.h"
#include "parameters.h"
#include "ports.h"
#include "report.h"
#include "self_test.h"
#include "sonar_driver.h"
#include "timing.h"
#include "tracker.h"

namespace echowing {

// SNR_STATE on the wire.
enum class DeviceState : uint8_t {
  kStarting = 0,
  kSearching = 1,
  kTracking = 2,
  kSonarFault = 3,
};

struct Ports {
  SerialPort& autopilot;
  SerialPort& usb;
  I2cBus& bus;
  ServoOutput& servos;
  SlotMemory& memory;
  Board& board;
};

// What COMMAND_LONG and COMMAND_INT have in common and we use.
struct Command {
  uint8_t target_system;
  uint8_t target_component;
  uint16_t number;
  float first;
  float second;
};

class Coprocessor {
 public:
  // `seed` varies the ping's jitter from device to device. Loads the stored parameters.
  Coprocessor(const Ports& ports, uint32_t seed, Microseconds now, Milliseconds uptime = 0);

  // One loop turn. Turns may be any time apart; the finer, the less delay.
  void step(Microseconds now);

  Aim aim() const { return tracker_.aim(); }
  bool led_on() const { return echowing::led_on(led_state(), uptime_.ms()); }
  LedState led_state() const;
  DeviceState state() const;
  const Parameters& parameters() const { return parameters_; }
  // As if the set had come by PARAM_SET on the ground, but not stored. False: no such index, or
  // out of range.
  bool set_parameter(uint8_t index, float value);

  // A command that was sent to us: when, by which connection, and its first parameters.
  struct Order {
    Instant now;
    Connection& connection;
    float first;
    float second;
  };

  // The handlers of command_table.h; each returns a MAV_RESULT.
#define ECHOWING_COMMAND(handler, number, in_flight, text) uint8_t handler(const Order& order);
#include "command_table.h"
#undef ECHOWING_COMMAND

 private:
  enum Port : uint8_t { kAutopilotPort, kUsbPort };

  // The parts of a loop turn.
  void sense(const Instant& now);
  void decide(const Instant& now);
  void act(const Instant& now);
  void tell(const Instant& now);

  void poll_sonar(const Instant& now);
  void adopt_sonar_address(const Instant& now);
  void adopt_system_id(const Instant& now);
  void cancel_bench_orders();
  void run_self_test(const Instant& now);
  void report_self_test();
  void aim_gimbal(const Instant& now);
  void note_pointing(const Instant& now);
  void store_parameters(const Instant& now);
  void restart_if_ordered(const Instant& now);

  Telemetry observe(const Instant& now);
  bool report_reading(const Instant& now, const Telemetry& telemetry);
  bool handle_message(const Instant& now);
  void send_other(const Instant& now, const Telemetry& telemetry);
  void notify(Notice notice);

  bool receive(const Instant& now, Connection& connection, Port port);
  void hear_autopilot(const Instant& now, const mavlink_message_t& message);
  void dispatch(const Instant& now, Connection& connection, const mavlink_message_t& message);
  void on_parameter_read(Connection& connection, const mavlink_message_t& message);
  void on_parameter_list(Connection& connection, const mavlink_message_t& message);
  void on_parameter_set(const Instant& now, Connection& connection,
                        const mavlink_message_t& message);
  void on_look_order(const Instant& now, const mavlink_message_t& message);
  void on_command(const Instant& now, Connection& connection, const mavlink_message_t& message,
                  const Command& command);
  uint8_t execute(uint16_t number, const Order& order);
  bool is_for_us(uint8_t system, uint8_t component, bool broadcast_too) const;

  GimbalMode gimbal_mode(const Instant& now);
  void renew_identity();

  Ports ports_;
  Parameters parameters_;
  ParameterStore store_;
  ParameterStore::Loaded loaded_;  // before what follows: it all starts from the stored parameters
  Uptime uptime_;
  AutopilotWatch autopilot_;
  SonarDriver sonar_;
  Tracker tracker_;
  Look look_;
  Connection autopilot_connection_;
  Connection usb_connection_;
  SelfTest self_test_;
  GimbalOrders orders_;
  Identity identity_ = {};
  Aim pointed_;
  PointingFinder pointing_;  // of pointed_
  Timeout freshness_;
  Milliseconds reading_ms_ = 0;
  bool new_reading_ = false;
  bool heard_sonar_ = false;
  uint8_t asked_address_ = 0;
  Timeout restart_delay_;
  bool restarting_ = false;
  bool into_bootloader_ = false;
};

}  // namespace echowing
