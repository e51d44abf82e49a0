// One partner on one port: what is sent to it and when, and the parameter protocol with it.
#pragma once

#include <stdint.h>

#include "link.h"
#include "look.h"
#include "notices.h"
#include "parameters.h"
#include "report.h"

namespace echowing {

// The state of the device as every port reports it; the caller fills it once a turn.
struct Telemetry {
  const Tracker& tracker;
  const Quaternion& pointing;
  const Axis& axis;         // of the newest reading's ping
  Milliseconds reading_ms;  // uptime at the newest reading
  Identity identity;
  Milliseconds uptime_ms;
  bool faulty;
  bool fresh;         // the newest reading is young enough to be reported
  bool reading_soon;  // keep the wire free for it
  uint16_t raw_cm;
  Aim aim;
  uint8_t state;
};

class Connection {
 public:
  // `paced`: state, pan and tilt go at INFO_RATE, not whenever they change: the partner passes them
  // on to a slow radio.
  Connection(SerialPort& port, bool paced) : port_(port), paced_(paced) {}

  const mavlink_message_t* receive() { return link_.receive(port_); }

  // A new reading is ready to be sent.
  void on_reading() { reading_unsent_ = raw_unsent_ = true; }

  // Queues the report, the raw reading, or its axis, if it is due; true if so. Once a turn, unless
  // that turn has been filled by another connection.
  bool send_reading(const Instant& now, const Parameters& parameters, const Telemetry& telemetry);
  // Queues one of the other messages; true if there was one to send and the wire was free for it.
  bool send_other(const Instant& now, const Parameters& parameters, const Telemetry& telemetry,
                  const char* git_hash);
  // Hands what is queued to the port, as far as budget and port take it; returns the budget's rest.
  uint8_t flush(uint8_t budget) { return link_.flush(port_, budget); }

  // The partner is our autopilot, and is to send its attitude.
  void ask_for_attitude() { attitude_wanted_ = true; }
  void notify(Notice notice) { notices_.add(notice); }
  void acknowledge(Identity identity, const mavlink_message_t& asked, uint16_t command,
                   uint8_t result);

  void list_parameters();
  void report_parameter(uint8_t index);

  // REQUEST_MESSAGE and SET_MESSAGE_INTERVAL; a MAV_RESULT.
  uint8_t request_message(uint32_t id);
  uint8_t set_interval(uint32_t id, float interval_us);
  // Every message at its usual rate again.
  void restore_intervals();

 private:
  static constexpr uint8_t kNamedValues = 3;

  bool send_report(const Instant& now, const Parameters& parameters, const Telemetry& telemetry);
  bool send_raw(const Instant& now, const Telemetry& telemetry);
  bool send_axis(const Telemetry& telemetry);
  bool send_heartbeat(const Telemetry& telemetry);
  bool send_attitude_request(const Telemetry& telemetry);
  bool send_notice(const Telemetry& telemetry);
  bool send_parameter(const Telemetry& telemetry, const Parameters& parameters, uint8_t index);
  bool send_next_asked(const Telemetry& telemetry, const Parameters& parameters);
  bool send_version(const Telemetry& telemetry, const char* git_hash);
  bool send_info(const Instant& now, const Parameters& parameters, const Telemetry& telemetry);
  Milliseconds info_period(const Parameters& parameters) const;
  bool send_value(Identity identity, Milliseconds at, const char* name, float value);

  SerialPort& port_;
  bool paced_;
  Link link_;
  Notices notices_;
  ReportClock report_clock_;
  Timeout heartbeat_pause_;
  Timeout raw_pause_;
  Timeout value_pause_[kNamedValues];
  uint16_t value_sent_[kNamedValues] = {};
  Microseconds report_period_ = 0;  // 0: the parameter's
  Milliseconds value_period_ = 0;   // 0: the usual
  bool reading_unsent_ = false;
  bool raw_unsent_ = false;
  bool axis_unsent_ = false;
  bool reports_off_ = false;
  bool values_off_ = false;
  bool axis_off_ = false;
  bool attitude_wanted_ = false;
  bool version_wanted_ = false;
  bool asked_[kParameterCount] = {};  // parameters to be sent
  uint8_t asked_count_ = 0;           // how many of them are true
  uint8_t next_asked_ = 0;
};

}  // namespace echowing
