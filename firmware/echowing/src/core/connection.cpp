#include "connection.h"

#include <math.h>
#include <string.h>

#include "version.h"

namespace echowing {
namespace {

constexpr Milliseconds kHeartbeatPeriod = 1000;
// Values that stand still are repeated, for a partner that joins late.
constexpr Milliseconds kRepeat = 1000;
// REPORT_RATE's limits, for SET_MESSAGE_INTERVAL. Values any more often would fill the wire.
constexpr float kShortest_us = 25000.0f;
constexpr float kLongestReport_us = 200000.0f;
constexpr float kLongestValues_us = 60e6f;
constexpr uint16_t kSetMessageInterval = 511;  // MAV_CMD_SET_MESSAGE_INTERVAL
// What an order in the earth frame carries, too.
constexpr uint16_t kEarthFrame = GIMBAL_DEVICE_FLAGS_ROLL_LOCK | GIMBAL_DEVICE_FLAGS_PITCH_LOCK |
                                 GIMBAL_DEVICE_FLAGS_YAW_LOCK |
                                 GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME;
constexpr uint16_t kBodyFrame = GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME;

}  // namespace

bool Connection::send_reading(const Instant& now, const Parameters& parameters,
                              const Telemetry& telemetry) {
  const bool unsent = reading_unsent_ || raw_unsent_ || axis_unsent_;
  if (!unsent && report_clock_.quiet(now.us)) return false;
  if (send_report(now, parameters, telemetry)) return true;
  if (raw_unsent_) return send_raw(now, telemetry);
  return axis_unsent_ && send_axis(telemetry);
}

bool Connection::send_report(const Instant& now, const Parameters& parameters,
                             const Telemetry& telemetry) {
  const Microseconds usual = kSecond / parameters.whole(Parameter::kReportRate);
  const Microseconds period = report_period_ != 0 ? report_period_ : usual;
  const bool due = report_clock_.due(now.us, reading_unsent_, telemetry.reading_soon, period);
  reading_unsent_ = false;
  if (!due || !telemetry.fresh || reports_off_) return false;
  return link_.send(telemetry.identity, distance_report(parameters, telemetry.tracker,
                                                        telemetry.pointing, telemetry.reading_ms));
}

bool Connection::send_raw(const Instant& now, const Telemetry& telemetry) {
  raw_unsent_ = false;
  if (values_off_ || raw_pause_.running(now)) return false;
  if (value_period_ != 0) raw_pause_.start(now, value_period_);
  axis_unsent_ = !axis_off_;
  return send_value(telemetry.identity, telemetry.reading_ms, "SNR_RAW",
                    raw_range_m(telemetry.raw_cm));
}

bool Connection::send_axis(const Telemetry& telemetry) {
  axis_unsent_ = false;
  const Axis& axis = telemetry.axis;
  mavlink_gimbal_device_attitude_status_t message = {};
  message.time_boot_ms = telemetry.reading_ms;
  message.flags = axis.in_earth_frame ? kEarthFrame : kBodyFrame;
  memcpy(message.q, &axis.rotation, sizeof(message.q));
  message.angular_velocity_x = message.angular_velocity_y = message.angular_velocity_z = NAN;
  message.failure_flags = axis.limits;
  return link_.send(telemetry.identity, message);
}

bool Connection::send_other(const Instant& now, const Parameters& parameters,
                            const Telemetry& telemetry, const char* git_hash) {
  // When a reading is due the wire is kept free for it: a range never waits in a queue.
  if (!link_.idle() || telemetry.reading_soon) return false;
  if (!heartbeat_pause_.running(now)) {
    heartbeat_pause_.start(now, kHeartbeatPeriod);
    return send_heartbeat(telemetry);
  }
  if (attitude_wanted_) return send_attitude_request(telemetry);
  if (!notices_.empty()) return send_notice(telemetry);
  if (version_wanted_) return send_version(telemetry, git_hash);
  return send_info(now, parameters, telemetry) || send_next_asked(telemetry, parameters);
}

bool Connection::send_heartbeat(const Telemetry& telemetry) {
  mavlink_heartbeat_t message = {};
  message.type = MAV_TYPE_ONBOARD_CONTROLLER;
  message.autopilot = MAV_AUTOPILOT_INVALID;
  message.system_status = telemetry.faulty ? MAV_STATE_CRITICAL : MAV_STATE_ACTIVE;
  message.mavlink_version = 3;  // MAVLink's own number for the protocol
  return link_.send(telemetry.identity, message);
}

bool Connection::send_attitude_request(const Telemetry& telemetry) {
  mavlink_command_long_t message = {};
  message.target_system = telemetry.identity.system;
  message.target_component = MAV_COMP_ID_AUTOPILOT1;
  message.command = kSetMessageInterval;
  message.param1 = MAVLINK_MSG_ID_ATTITUDE;
  message.param2 = Attitude::kInterval;
  if (!link_.send(telemetry.identity, message)) return false;
  attitude_wanted_ = false;
  return true;
}

bool Connection::send_notice(const Telemetry& telemetry) {
  const NoticeText notice = notice_text(notices_.first());
  mavlink_statustext_t message = {};
  message.severity = notice.severity;
  memcpy(message.text, notice.text, sizeof(message.text));
  if (!link_.send(telemetry.identity, message)) return false;
  notices_.drop_first();
  return true;
}

bool Connection::send_parameter(const Telemetry& telemetry, const Parameters& parameters,
                                uint8_t index) {
  const ParameterInfo info = parameter_info(index);
  mavlink_param_value_t message = {};
  memcpy(message.param_id, info.name, sizeof(message.param_id));
  message.param_value = parameters.at(index);
  message.param_type = MAV_PARAM_TYPE_REAL32;
  message.param_count = kParameterCount;
  message.param_index = index;
  return link_.send(telemetry.identity, message);
}

void Connection::list_parameters() {
  for (uint8_t index = 0; index < kParameterCount; ++index) report_parameter(index);
}

void Connection::report_parameter(uint8_t index) {
  if (!asked_[index]) ++asked_count_;
  asked_[index] = true;
}

// Goes round from where it was, so that no storm of requests can keep a parameter from its turn.
bool Connection::send_next_asked(const Telemetry& telemetry, const Parameters& parameters) {
  if (asked_count_ == 0) return false;
  while (!asked_[next_asked_]) {
    next_asked_ = next_asked_ + 1 < kParameterCount ? static_cast<uint8_t>(next_asked_ + 1) : 0;
  }
  if (!send_parameter(telemetry, parameters, next_asked_)) return false;
  asked_[next_asked_] = false;
  --asked_count_;
  return true;
}

bool Connection::send_version(const Telemetry& telemetry, const char* git_hash) {
  mavlink_autopilot_version_t message = {};
  message.capabilities = MAV_PROTOCOL_CAPABILITY_MAVLINK2 | MAV_PROTOCOL_CAPABILITY_COMMAND_INT |
                         MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST;
  message.flight_sw_version = kVersion;
  for (uint8_t i = 0; i < sizeof(message.flight_custom_version) && git_hash[i] != '\0'; ++i) {
    message.flight_custom_version[i] = static_cast<uint8_t>(git_hash[i]);
  }
  if (!link_.send(telemetry.identity, message)) return false;
  version_wanted_ = false;
  return true;
}

// One of what people look at, and no tool needs: where the gimbal points, and the state.
bool Connection::send_info(const Instant& now, const Parameters& parameters,
                           const Telemetry& telemetry) {
  if (values_off_) return false;
  const uint16_t values[kNamedValues] = {telemetry.aim.pan_us, telemetry.aim.tilt_us,
                                         telemetry.state};
  static const char kNames[kNamedValues][10] = {"SNR_PAN", "SNR_TILT", "SNR_STATE"};
  const bool as_they_change = value_period_ == 0 && !paced_;
  for (uint8_t i = 0; i < kNamedValues; ++i) {
    const bool pausing = value_pause_[i].running(now);
    if (pausing && !(as_they_change && values[i] != value_sent_[i])) continue;
    if (!send_value(telemetry.identity, telemetry.uptime_ms, kNames[i], values[i])) return false;
    value_sent_[i] = values[i];
    value_pause_[i].start(now, info_period(parameters));
    return true;
  }
  return false;
}

Milliseconds Connection::info_period(const Parameters& parameters) const {
  if (value_period_ != 0) return value_period_;
  return paced_ ? 1000 / parameters.whole(Parameter::kInfoRate) : kRepeat;
}

bool Connection::send_value(Identity identity, Milliseconds at, const char* name, float value) {
  mavlink_named_value_float_t message = {};
  message.time_boot_ms = at;
  memcpy(message.name, name, strlen(name));  // all are shorter than the field
  message.value = value;
  return link_.send(identity, message);
}

void Connection::acknowledge(Identity identity, const mavlink_message_t& asked, uint16_t command,
                             uint8_t result) {
  mavlink_command_ack_t message = {};
  message.command = command;
  message.result = result;
  message.target_system = asked.sysid;
  message.target_component = asked.compid;
  link_.send(identity, message);
}

uint8_t Connection::request_message(uint32_t id) {
  if (id == MAVLINK_MSG_ID_AUTOPILOT_VERSION) {
    version_wanted_ = true;
    return MAV_RESULT_ACCEPTED;
  }
  if (id == MAVLINK_MSG_ID_HEARTBEAT) {
    heartbeat_pause_.stop();
    return MAV_RESULT_ACCEPTED;
  }
  return MAV_RESULT_UNSUPPORTED;
}

// MAVLink: 0 asks for the usual rate, -1 switches off.
uint8_t Connection::set_interval(uint32_t id, float interval_us) {
  const bool off = interval_us == -1.0f;
  const bool usual = interval_us == 0.0f;
  const bool reports = id == MAVLINK_MSG_ID_DISTANCE_SENSOR;
  if (id == MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS && (off || usual)) {
    axis_off_ = off;
    return MAV_RESULT_ACCEPTED;
  }
  if (!reports && id != MAVLINK_MSG_ID_NAMED_VALUE_FLOAT) return MAV_RESULT_UNSUPPORTED;
  const float most = reports ? kLongestReport_us : kLongestValues_us;
  if (!off && !usual && !(interval_us >= kShortest_us && interval_us <= most))
    return MAV_RESULT_DENIED;
  const Microseconds period = off || usual ? 0 : static_cast<Microseconds>(interval_us);
  if (reports) {
    reports_off_ = off;
    report_period_ = period;
  } else {
    values_off_ = off;
    value_period_ = period / kMillisecond;
  }
  return MAV_RESULT_ACCEPTED;
}

void Connection::restore_intervals() {
  reports_off_ = values_off_ = axis_off_ = false;
  report_period_ = 0;
  value_period_ = 0;
}

}  // namespace echowing
