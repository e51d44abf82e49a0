#include "notices.h"

#include "flash_table.h"
#include "mavlink_headers.h"

namespace echowing {
namespace {

// In the order of the enumeration.
const NoticeText kTexts[static_cast<uint8_t>(Notice::kCount)] ECHOWING_FLASH = {
    {MAV_SEVERITY_INFO, "Echowing: started"},
    {MAV_SEVERITY_CRITICAL, "Echowing: sonar does not answer"},
    {MAV_SEVERITY_INFO, "Echowing: sonar answers again"},
    {MAV_SEVERITY_INFO, "Echowing: sonar address changed"},
    {MAV_SEVERITY_WARNING, "Echowing: memory corrupt, default parameters"},
    {MAV_SEVERITY_INFO, "Echowing: parameters stored"},
    {MAV_SEVERITY_INFO, "Echowing: default parameters"},
    {MAV_SEVERITY_INFO, "Echowing test: sonar good"},
    {MAV_SEVERITY_WARNING, "Echowing test: sonar gives no reading"},
    {MAV_SEVERITY_INFO, "Echowing test: memory good"},
    {MAV_SEVERITY_WARNING, "Echowing test: memory corrupt"},
    {MAV_SEVERITY_INFO, "Echowing test: autopilot port looped, good"},
    {MAV_SEVERITY_INFO, "Echowing test: autopilot port has no loop plug"},
    {MAV_SEVERITY_INFO, "Echowing test: USB port looped, good"},
    {MAV_SEVERITY_INFO, "Echowing test: USB port has no loop plug"},
    {MAV_SEVERITY_INFO, "Echowing test: ended; did the servos sweep?"},
};

}  // namespace

NoticeText notice_text(Notice notice) { return from_flash(kTexts[static_cast<uint8_t>(notice)]); }

}  // namespace echowing
