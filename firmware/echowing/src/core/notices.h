// The lines the pilot can get as STATUSTEXT, and the queue of those not sent yet.
#pragma once

#include <stdint.h>

namespace echowing {

enum class Notice : uint8_t {
#define ECHOWING_NOTICE(identifier, severity, text) identifier,
#include "notice_table.h"
#undef ECHOWING_NOTICE
};

// STATUSTEXT.text holds 50 characters, without a null when all are used.
constexpr uint8_t kNoticeLength = 50;

struct NoticeText {
  uint8_t severity;  // MAV_SEVERITY
  char text[kNoticeLength];
};

NoticeText notice_text(Notice notice);

// First in, first out; when full, the newest is dropped, and so is one that says what the last one
// says.
class Notices {
 public:
  void add(Notice notice) {
    if (count_ > 0 && queue_[count_ - 1] == notice) return;
    if (count_ < kCapacity) queue_[count_++] = notice;
  }
  bool empty() const { return count_ == 0; }
  Notice first() const { return queue_[0]; }
  void drop_first() {
    --count_;
    for (uint8_t i = 0; i < count_; ++i) queue_[i] = queue_[i + 1];
  }

 private:
  static constexpr uint8_t kCapacity = 12;
  Notice queue_[kCapacity] = {};
  uint8_t count_ = 0;
};

}  // namespace echowing
