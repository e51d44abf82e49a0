#include "led.h"

#include "flash_table.h"

namespace echowing {
namespace {

constexpr uint32_t kStepMs = 125;  // one bit; a pattern of sixteen repeats every two seconds

// Low bit first, in the order of the enumeration.
const uint16_t kPatterns[] ECHOWING_FLASH = {
    0x5555,  // starting
    0x0f0f,  // searching
    0xffff,  // tracking
    0x0015,  // sonar fault
    0x0005,  // no autopilot
};

}  // namespace

bool led_on(LedState state, Milliseconds uptime_ms) {
  const uint16_t pattern = from_flash(kPatterns[static_cast<uint8_t>(state)]);
  return (pattern >> uptime_ms / kStepMs % 16 & 1) != 0;
}

}  // namespace echowing
