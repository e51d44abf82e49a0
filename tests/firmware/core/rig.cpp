#include "rig.h"

#include <algorithm>

namespace rig {
namespace {

std::vector<uint8_t> bytes_of(const mavlink_message_t& message) {
  uint8_t buffer[MAVLINK_MAX_PACKET_LEN];
  const uint16_t length = mavlink_msg_to_send_buffer(buffer, &message);
  return {buffer, buffer + length};
}

std::string text_of(const char* field, size_t size) {
  return {field, field + strnlen(field, size)};
}

Report report_of(const mavlink_message_t& message) {
  mavlink_distance_sensor_t packed;
  mavlink_msg_distance_sensor_decode(&message, &packed);
  Report report = {packed.time_boot_ms,     packed.min_distance, packed.max_distance,
                   packed.current_distance, packed.type,         packed.id,
                   packed.orientation,      packed.covariance,   packed.signal_quality,
                   packed.horizontal_fov,   packed.vertical_fov, {}};
  memcpy(report.quaternion, packed.quaternion, sizeof(report.quaternion));
  return report;
}

}  // namespace

uint8_t FakeSerial::read(uint8_t* bytes, uint8_t capacity) {
  const size_t count = std::min<size_t>(capacity, in.size());
  std::copy_n(in.begin(), count, bytes);
  in.erase(in.begin(), in.begin() + static_cast<std::ptrdiff_t>(count));
  return static_cast<uint8_t>(count);
}

uint8_t FakeSerial::write(const uint8_t* bytes, uint8_t count) {
  if (blocked) return 0;
  out.insert(out.end(), bytes, bytes + count);
  return count;
}

bool FakeSonar::answers(uint8_t asked) {
  ++accesses;
  timed_out = held;
  if (held) return false;
  if (ranging_ && reached(now, busy_until_)) ranging_ = false;
  return plugged && asked == address && !ranging_;
}

bool FakeSonar::write(uint8_t asked, const uint8_t* bytes, uint8_t count) {
  if (!answers(asked)) return false;
  if (count == 1 && bytes[0] == 0x51) {
    pings.push_back(now);
    answer_ = listen(now);
    ranging_ = true;
    busy_until_ = now + ranging_us;
  }
  if (count == 3 && bytes[0] == 0xaa && bytes[1] == 0xa5) address = bytes[2] >> 1;
  return true;
}

bool FakeSonar::read(uint8_t asked, uint8_t* bytes, uint8_t count) {
  if (!answers(asked) || count != 2) return false;
  bytes[0] = static_cast<uint8_t>(answer_ >> 8);
  bytes[1] = static_cast<uint8_t>(answer_ & 0xff);
  return true;
}

void FakeMemory::write(uint8_t slot, uint16_t offset, uint8_t value) {
  if (power_lost_after >= 0 && writes >= power_lost_after) return;
  ++writes;
  if (offset != stuck_at) slots[slot][offset] = value;
}

Rig::Rig(Microseconds start, FakeMemory stored, uint32_t uptime_ms, uint8_t system,
         ResetCause cause)
    : memory(stored),
      board(cause),
      now(start),
      core({serial[0], serial[1], sonar, servos, memory, board}, 1, start, uptime_ms) {
  sonar.now = start;
  if (system != 0) core.set_parameter(static_cast<uint8_t>(Parameter::kSystemId), system);
}

void Rig::run(Microseconds span, Microseconds length) {
  for (Microseconds done = 0; done < span; done += length) turn(length);
}

bool Rig::run_until(const std::function<bool()>& happened, Microseconds limit) {
  for (Microseconds done = 0; done < limit; done += 1000) {
    if (happened()) return true;
    turn(1000);
  }
  return happened();
}

void Rig::turn(Microseconds length) {
  now += length;
  sonar.now = now;
  if (beating_ && reached(now, next_beat_)) {
    autopilot(vehicle_, armed_);
    next_beat_ = now + 1000000;
  }
  core.step(now);
  collect(0);
  collect(1);
}

void Rig::hear_vehicle(uint8_t system, bool armed) {
  mavlink_heartbeat_t heartbeat = {};
  heartbeat.type = 2;       // quadrotor
  heartbeat.autopilot = 3;  // ArduPilot
  heartbeat.base_mode = armed ? MAV_MODE_FLAG_SAFETY_ARMED : 0;
  hear(0, heartbeat, system, 1);
}

void Rig::autopilot(uint8_t system, bool armed) {
  hear_vehicle(system, armed);
  vehicle_ = system;
  armed_ = armed;
  beating_ = true;
  next_beat_ = now + 1000000;
}

void Rig::collect(int port) {
  for (const uint8_t byte : serial[port].out) {
    const uint8_t framing =
        mavlink_frame_char_buffer(&incoming_[port], &parser_[port], byte, nullptr, nullptr);
    ++bytes_[port];
    if (framing != MAVLINK_FRAMING_OK) continue;
    sent_[port].push_back({now, incoming_[port]});
    framed_bytes_[port] += MAVLINK_NUM_NON_PAYLOAD_BYTES + incoming_[port].len;
  }
  serial[port].out.clear();
}

void Rig::set_parameter(const char* name, float value, int port) {
  mavlink_param_set_t message = {};
  message.target_system = 1;
  message.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
  memcpy(message.param_id, name, std::min(strlen(name), sizeof(message.param_id)));
  message.param_value = value;
  message.param_type = MAV_PARAM_TYPE_REAL32;
  hear(port, message);
}

uint8_t Rig::command(uint16_t id, float first, float second, int port) {
  mavlink_command_long_t message = {};
  message.target_system = 1;
  message.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
  message.command = id;
  message.param1 = first;
  message.param2 = second;
  const size_t before = acks(port).size();
  hear(port, message);
  run(20000);
  const std::vector<Ack> all = acks(port);
  return all.size() == before + 1 && all.back().command == id ? all.back().result : 255;
}

std::vector<Range> Rig::ranges(int port) {
  std::vector<Range> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_DISTANCE_SENSOR) continue;
    found.push_back({each.at, report_of(each.message)});
  }
  return found;
}

std::vector<std::string> Rig::texts(int port) {
  std::vector<std::string> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_STATUSTEXT) continue;
    mavlink_statustext_t text;
    mavlink_msg_statustext_decode(&each.message, &text);
    found.push_back(text_of(text.text, sizeof(text.text)));
  }
  return found;
}

std::vector<Ack> Rig::acks(int port) {
  std::vector<Ack> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_COMMAND_ACK) continue;
    mavlink_command_ack_t ack;
    mavlink_msg_command_ack_decode(&each.message, &ack);
    found.push_back({ack.command, ack.result});
  }
  return found;
}

std::vector<Value> Rig::values(int port) {
  std::vector<Value> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_PARAM_VALUE) continue;
    mavlink_param_value_t value;
    mavlink_msg_param_value_decode(&each.message, &value);
    found.push_back({text_of(value.param_id, sizeof(value.param_id)), value.param_value,
                     value.param_type, value.param_count, value.param_index});
  }
  return found;
}

std::vector<mavlink_heartbeat_t> Rig::heartbeats(int port) {
  std::vector<mavlink_heartbeat_t> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_HEARTBEAT) continue;
    mavlink_heartbeat_t heartbeat;
    mavlink_msg_heartbeat_decode(&each.message, &heartbeat);
    found.push_back(heartbeat);
  }
  return found;
}

std::vector<AxisTold> Rig::axes(int port) {
  std::vector<AxisTold> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS) continue;
    mavlink_gimbal_device_attitude_status_t told;
    mavlink_msg_gimbal_device_attitude_status_decode(&each.message, &told);
    found.push_back({each.at,
                     told.time_boot_ms,
                     told.flags,
                     told.failure_flags,
                     {told.q[0], told.q[1], told.q[2], told.q[3]},
                     each.message.len});
  }
  return found;
}

std::vector<float> Rig::named(const char* name, int port) {
  std::vector<float> found;
  for (const Sent& each : sent_[port]) {
    if (each.message.msgid != MAVLINK_MSG_ID_NAMED_VALUE_FLOAT) continue;
    mavlink_named_value_float_t value;
    mavlink_msg_named_value_float_decode(&each.message, &value);
    if (text_of(value.name, sizeof(value.name)) == name) found.push_back(value.value);
  }
  return found;
}

bool Rig::said(const char* part, int port) {
  for (const std::string& text : texts(port)) {
    if (text.find(part) != std::string::npos) return true;
  }
  return false;
}

void Rig::forget() {
  sent_[0].clear();
  sent_[1].clear();
}

#define RIG_FRAME(name)                                                                 \
  std::vector<uint8_t> Rig::frame(const mavlink_##name##_t& payload, uint8_t system,    \
                                  uint8_t component) {                                  \
    mavlink_status_t status = {};                                                       \
    mavlink_message_t message = {};                                                     \
    mavlink_msg_##name##_encode_status(system, component, &status, &message, &payload); \
    return bytes_of(message);                                                           \
  }
RIG_FRAME(heartbeat)
RIG_FRAME(param_set)
RIG_FRAME(param_request_read)
RIG_FRAME(param_request_list)
RIG_FRAME(command_long)
RIG_FRAME(command_int)
RIG_FRAME(attitude)
RIG_FRAME(gimbal_device_set_attitude)

}  // namespace rig
