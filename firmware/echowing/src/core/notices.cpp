#include "notices.h"

#include "flash_table.h"
#include "mavlink_headers.h"

namespace echowing {
namespace {

// In the order of the enumeration.
const NoticeText kTexts[] ECHOWING_FLASH = {
    {MAV_SEVERITY_INFO, "Echowing: started"},
    {MAV_SEVERITY_CRITICAL, "Echowing: sonar does not answer"},
    {MAV_SEVERITY_INFO, "Echowing: sonar answers again"},
    {MAV_SEVERITY_INFO, "Echowing: sonar address changed"},
    {MAV_SEVERITY_WARNING, "Echowing: memory corrupt, default parameters"},
    {MAV_SEVERITY_INFO, "Echowing: parameters stored"},
    {MAV_SEVERITY_INFO, "Echowing: default parameters"},
};

}  // namespace

NoticeText notice_text(Notice notice) { return from_flash(kTexts[static_cast<uint8_t>(notice)]); }

}  // namespace echowing
