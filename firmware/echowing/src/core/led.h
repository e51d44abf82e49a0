// What the status light says.
#pragma once

#include <stdint.h>

#include "timing.h"

namespace echowing {

enum class LedState : uint8_t {
  kStarting,     // quick flicker
  kSearching,    // slow blink, once a second
  kTracking,     // steady
  kSonarFault,   // three flashes and a pause
  kNoAutopilot,  // two flashes and a pause
};

// Whether the light is on at `uptime_ms`.
bool led_on(LedState state, Milliseconds uptime_ms);

}  // namespace echowing
