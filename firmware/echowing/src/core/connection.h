// One partner on one port: what is sent to it and when, and the parameter protocol with it.
#pragma once

#include <stdint.h>

#include "link.h"
#include "notices.h"
#include "parameters.h"
#include "report.h"

namespace echowing {

// The state of the device as it is told on every port; the caller fills it once a turn.
struct Telemetry {
  const Tracker& tracker;
  const Pointing& pointing;
  uint32_t reading_ms;  // uptime at the newest reading
  Identity identity;
  uint32_t uptime_ms;
  bool faulty;
  bool new_reading;   // in this turn
  bool fresh;         // the newest reading is young enough to be reported
  bool reading_soon;  // keep the wire free for it
  float raw_m;
  float pan_us;
  float tilt_us;
  float state;
};

class Connection {
 public:
  explicit Connection(SerialPort& port) : port_(port) {}

  void receive() { link_.receive(port_); }
  const mavlink_message_t* next_message() { return link_.next(); }

  // Queues what is due now and hands it to the port.
  void send(Microseconds now, const Parameters& parameters, const Telemetry& telemetry,
            const char* git_hash);

  void notify(Notice notice) { notices_.add(notice); }
  void acknowledge(Identity identity, const mavlink_message_t& asked, uint16_t command,
                   uint8_t result);

  void list_parameters();
  void tell_parameter(uint8_t index) { asked_[index] = true; }

  // REQUEST_MESSAGE and SET_MESSAGE_INTERVAL; a MAV_RESULT.
  uint8_t request_message(uint32_t id);
  uint8_t set_interval(uint32_t id, float interval_us);

 private:
  static constexpr uint8_t kNamedValues = 3;

  void send_report(Microseconds now, const Parameters& parameters, const Telemetry& telemetry);
  void send_one_more(Microseconds now, const Parameters& parameters, const Telemetry& telemetry,
                     const char* git_hash);
  bool send_heartbeat(const Telemetry& telemetry);
  bool send_notice(const Telemetry& telemetry);
  bool send_parameter(const Telemetry& telemetry, const Parameters& parameters, uint8_t index);
  bool send_next_asked(const Telemetry& telemetry, const Parameters& parameters);
  bool send_version(const Telemetry& telemetry, const char* git_hash);
  bool send_changed_value(Microseconds now, const Telemetry& telemetry);
  bool send_value(const Telemetry& telemetry, const char* name, float value);

  SerialPort& port_;
  Link link_;
  Notices notices_;
  ReportClock report_clock_;
  Timeout heartbeat_pause_;
  Timeout raw_pause_;
  Timeout value_pause_[kNamedValues];
  float value_sent_[kNamedValues] = {};
  Microseconds report_period_ = 0;  // 0: the parameter's
  Microseconds value_period_ = 0;   // 0: as they come
  bool reports_off_ = false;
  bool values_off_ = false;
  bool version_wanted_ = false;
  bool asked_[kParameterCount] = {};  // parameters to be told
  uint8_t next_asked_ = 0;
};

}  // namespace echowing
