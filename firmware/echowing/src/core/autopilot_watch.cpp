#include "autopilot_watch.h"

namespace echowing {
namespace {

// Heartbeats come once a second; five missed in a row are more than a busy port.
constexpr Microseconds kSilence = 5 * kSecond;

}  // namespace

void AutopilotWatch::on_message(Microseconds now, const mavlink_message_t& message) {
  if (message.msgid != MAVLINK_MSG_ID_HEARTBEAT || !is_ours(message)) return;
  mavlink_heartbeat_t heartbeat;
  mavlink_msg_heartbeat_decode(&message, &heartbeat);
  if (heartbeat.autopilot == MAV_AUTOPILOT_INVALID) return;
  system_id_ = message.sysid;
  armed_ = (heartbeat.base_mode & MAV_MODE_FLAG_SAFETY_ARMED) != 0;
  heard_ = true;
  silence_.start(now, kSilence);
}

// Ground stations and other vehicles are forwarded to this port too. Once learned, the vehicle is
// kept: another one is believed only when ours fell silent on the ground.
bool AutopilotWatch::is_ours(const mavlink_message_t& message) const {
  if (message.compid != MAV_COMP_ID_AUTOPILOT1 || message.sysid == 0) return false;
  return message.sysid == system_id_ || system_id_ == 0 || (!heard_ && !armed_);
}

}  // namespace echowing
