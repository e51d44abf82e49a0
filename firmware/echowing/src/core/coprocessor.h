// The co-processor: sonar, gimbal, autopilot and memory held together, one loop turn at a time.
#pragma once

#include <stdint.h>

#include "autopilot_watch.h"
#include "commands.h"
#include "connection.h"
#include "led.h"
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

class Coprocessor {
 public:
  // `seed` varies the ping's jitter from device to device. Loads the stored parameters.
  Coprocessor(const Ports& ports, uint32_t seed, Microseconds now, uint32_t uptime_ms = 0);

  // One loop turn. Turns may be any time apart; the finer, the less delay.
  void step(Microseconds now);

  Aim aim() const { return tracker_.aim(); }
  bool led_on() const { return echowing::led_on(led_state(), uptime_.ms()); }
  LedState led_state() const;
  DeviceState state() const;
  const Parameters& parameters() const { return parameters_; }
  // As if the set had come by PARAM_SET, but not stored. False: no such index, or out of range.
  bool set_parameter(uint8_t index, float value);

 private:
  enum class Override : uint8_t { kNone, kScan, kCentre, kHold };
  enum Port : uint8_t { kAutopilotPort, kUsbPort };

  bool listen(Microseconds now);
  bool receive(Microseconds now, Connection& connection, Port port);
  void handle(Microseconds now, Connection& connection, const mavlink_message_t& message);
  void on_parameter_read(Connection& connection, const mavlink_message_t& message);
  void on_parameter_list(Connection& connection, const mavlink_message_t& message);
  void on_parameter_set(Microseconds now, Connection& connection, const mavlink_message_t& message);
  void on_command(Microseconds now, Connection& connection, const mavlink_message_t& message,
                  const Command& command);
  uint8_t execute(Microseconds now, Connection& connection, const Command& command);
  uint8_t execute_on_bench(Microseconds now, const Command& command);
  uint8_t hold(Aim aim);
  uint8_t hold_servo(float servo, float pulse_us);
  uint8_t hold_angles(float pitch_deg, float yaw_deg);
  uint8_t scan_override(float choice);
  uint8_t reboot(Microseconds now, float choice);
  uint8_t restore_defaults(Microseconds now, float choice);
  uint8_t change_sonar_address(float address);
  uint8_t start_self_test(Microseconds now);

  void range(Microseconds now);
  void adopt_new_address(Microseconds now);
  void point(Microseconds now);
  void examine(Microseconds now);
  void tell_test_results();
  bool renew_pointing();
  Telemetry observe(Microseconds now);
  bool tell_reading(Microseconds now, const Telemetry& telemetry);
  void tell_other(Microseconds now, const Telemetry& telemetry);
  void keep(Microseconds now);
  void notify(Notice notice);
  GimbalMode gimbal_mode() const;
  void renew_identity();
  bool is_for_us(uint8_t system, uint8_t component, bool broadcast_too) const;

  Ports ports_;
  Parameters parameters_;
  ParameterStore store_;
  ParameterStore::Loaded loaded_;  // before what follows: it all starts from the stored parameters
  Uptime uptime_;
  AutopilotWatch autopilot_;
  SonarDriver sonar_;
  Tracker tracker_;
  Connection autopilot_connection_;
  Connection usb_connection_;
  SelfTest self_test_;
  Identity identity_ = {};
  Override override_ = Override::kNone;
  Aim pointed_;
  Pointing pointing_;  // of pointed_
  bool pointing_stale_ = false;
  Timeout freshness_;
  uint32_t reading_ms_ = 0;
  bool new_reading_ = false;
  bool heard_sonar_ = false;
  uint8_t asked_address_ = 0;
  Timeout reboot_delay_;
  bool rebooting_ = false;
  bool into_bootloader_ = false;
};

}  // namespace echowing
