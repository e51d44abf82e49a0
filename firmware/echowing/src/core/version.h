// Version of the firmware: raise it with every release.
#pragma once

#include <stdint.h>

namespace echowing {

// Major, minor, patch, release type (255: official), a byte each, as AUTOPILOT_VERSION wants.
constexpr uint32_t kVersion = 0x000100ff;

}  // namespace echowing
