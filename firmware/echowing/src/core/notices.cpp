#include "notices.h"

#include "flash_table.h"
#include "mavlink_headers.h"

namespace echowing {
namespace {

#define ECHOWING_CRITICAL "\2"
#define ECHOWING_WARNING "\4"
#define ECHOWING_INFO "\6"
static_assert(MAV_SEVERITY_CRITICAL == 2 && MAV_SEVERITY_WARNING == 4 && MAV_SEVERITY_INFO == 6,
              "the severities are MAVLink's");

constexpr char kBrand[] = {'E', 'c', 'h', 'o', 'w', 'i', 'n', 'g'};

// One after the other, each a severity, a text and a null: rows of the longest one's length would
// take half as much again.
const char kTexts[] ECHOWING_FLASH =
#define ECHOWING_NOTICE(identifier, severity, text) severity text "\0"
#include "notice_table.h"
#undef ECHOWING_NOTICE
    ;

#define ECHOWING_NOTICE(identifier, severity, text) \
  static_assert(sizeof(kBrand) + sizeof(text) - 1 <= kNoticeLength, "too long: " text);
#include "notice_table.h"
#undef ECHOWING_NOTICE

}  // namespace

NoticeText notice_text(Notice notice) {
  const char* next = kTexts;
  for (uint8_t before = static_cast<uint8_t>(notice); before > 0; --before) {
    next += length_in_flash(next) + 1;
  }
  NoticeText line = {};
  line.severity = static_cast<uint8_t>(from_flash(*next++));
  char* to = line.text;
  for (const char letter : kBrand) *to++ = letter;
  while ((*to = from_flash(*next++)) != '\0') ++to;
  return line;
}

}  // namespace echowing
