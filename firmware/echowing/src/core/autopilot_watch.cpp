#include "autopilot_watch.h"

namespace echowing {
namespace {

// Our own autopilot is on a wire and sends a heartbeat every second. If only one vehicle reports
// for four seconds, it is ours. Five heartbeats, because a burst from a radio's buffer does not
// show who else is there.
constexpr uint8_t kBeatsToLearn = 5;
constexpr Milliseconds kTimeToLearn = 3800;  // four beats' time, less what a busy port shifts them
constexpr Milliseconds kNoticePeriod = 30000;

}  // namespace

void AutopilotWatch::set_own(uint8_t system) {
  if (system == own_) return;
  // What was ours is one of the others now, until the next heartbeats sort it out.
  if (own_heard_) {
    others_silence_ = own_silence_;
    others_heard_ = true;
  }
  own_ = system;
  own_heard_ = own_armed_ = several_ = false;
  own_silence_.stop();
  candidate_ = beats_ = 0;
}

void AutopilotWatch::on_message(const Instant& now, const mavlink_message_t& message) {
  if (message.msgid != MAVLINK_MSG_ID_HEARTBEAT) return;
  if (message.compid != MAV_COMP_ID_AUTOPILOT1 || message.sysid == 0) return;
  mavlink_heartbeat_t heartbeat;
  mavlink_msg_heartbeat_decode(&message, &heartbeat);
  if (heartbeat.autopilot == MAV_AUTOPILOT_INVALID) return;
  const bool armed = (heartbeat.base_mode & MAV_MODE_FLAG_SAFETY_ARMED) != 0;
  if (message.sysid == own_) return on_own(now, armed);
  on_other(now, message.sysid, armed);
}

void AutopilotWatch::on_own(const Instant& now, bool armed) {
  own_armed_ = armed;
  own_heard_ = true;
  own_silence_.start(now, kSilence);
}

void AutopilotWatch::on_other(const Instant& now, uint8_t system, bool armed) {
  const bool another = system != candidate_;
  if (another || !others_silence_.running(now)) {
    beats_ = 0;
    alone_since_ = now.ms;
  }
  several_ = another && candidate_ != 0 && others_silence_.running(now);
  others_heard_ = true;
  others_silence_.start(now, kSilence);
  if (armed) others_armed_pause_.start(now, kSilence);
  candidate_ = system;
  if (beats_ < kBeatsToLearn) ++beats_;
  const bool alone = beats_ == kBeatsToLearn && now.ms - alone_since_ >= kTimeToLearn;
  if (own_ != 0 || !alone) return;
  own_ = system;
  learned_ = true;
  several_ = false;
  on_own(now, armed);
}

void AutopilotWatch::step(const Instant& now) {
  own_heard_ = own_silence_.running(now);
  others_heard_ = others_silence_.running(now);
  others_armed_ = others_armed_pause_.running(now);
  if (own_heard_) {
    flying_ = own_armed_;
  } else if (others_heard_) {
    flying_ = own_armed_ || others_armed_;
  }
}

bool AutopilotWatch::take_learned() {
  const bool learned = learned_;
  learned_ = false;
  return learned;
}

// Either several vehicles report and ours is not known, or only others report.
bool AutopilotWatch::take_conflict(const Instant& now) {
  const bool waiting = grace_.running(now);
  const bool only_others = own_ != 0 && !own_heard_ && others_heard_ && !waiting;
  const bool unclear = own_ == 0 && several_ && others_heard_;
  if (!(only_others || unclear) || notice_pause_.running(now)) return false;
  notice_pause_.start(now, kNoticePeriod);
  return true;
}

}  // namespace echowing
