// The figure 8 of twelve points that the gimbal searches (thesis Appendix A).
#pragma once

#include <stdint.h>

#include "parameters.h"
#include "ports.h"

namespace echowing {

constexpr uint8_t kScanPoints = 12;

// Pulses of a point, in Appendix A's order; `index` below kScanPoints.
Aim scan_point(const Parameters& parameters, uint8_t index);

// Straight ahead.
Aim scan_centre(const Parameters& parameters);

// Index of the point nearest to `aim`; the first of equals.
uint8_t nearest_scan_point(const Parameters& parameters, Aim aim);

}  // namespace echowing
