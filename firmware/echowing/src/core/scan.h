// The figure 8 of twelve points that the gimbal searches (thesis Appendix A).
#pragma once

#include <stdint.h>

#include "parameters.h"
#include "ports.h"
#include "rotation.h"

namespace echowing {

constexpr uint8_t kScanPoints = 12;

// Pulses of a point, in Appendix A's order; `index` below kScanPoints.
Aim scan_point(const Parameters& parameters, uint8_t index);

// Straight ahead.
Aim scan_centre(const Parameters& parameters);

// Index of the point nearest to `aim`; the first of equals.
uint8_t nearest_scan_point(const Parameters& parameters, Aim aim);

// The same figure laid round a direction that is not sure: how far off it a point is. Its outermost
// points lie two standard deviations off, as far as the servos reach; never less far than their
// pulses say.
Direction scan_offset(const Parameters& parameters, uint8_t index, float deviation_rad);

// Index of the point that `offset` is nearest to by now, having come from the point `index` towards
// the middle; the middle itself of equals.
uint8_t faded_scan_point(const Parameters& parameters, uint8_t index, Direction offset,
                         float deviation_rad);

}  // namespace echowing
