#include "scan.h"

#include <math.h>

#include "flash_table.h"

namespace echowing {
namespace {

struct Cell {
  Parameter pan;
  Parameter tilt;
};

constexpr Parameter kLeft = Parameter::kPanLeft;
constexpr Parameter kMiddle = Parameter::kPanMiddle;
constexpr Parameter kRight = Parameter::kPanRight;
constexpr Parameter kLow = Parameter::kTiltLow;
constexpr Parameter kLevel = Parameter::kTiltMiddle;
constexpr Parameter kHigh = Parameter::kTiltHigh;

// The order of thesis Appendix A: over the top to the right, then under the bottom.
const Cell kCells[kScanPoints] ECHOWING_FLASH = {
    {kLeft, kLevel},  {kLeft, kHigh},    {kMiddle, kHigh}, {kRight, kHigh},
    {kRight, kLevel}, {kMiddle, kLevel}, {kLeft, kLevel},  {kLeft, kLow},
    {kMiddle, kLow},  {kRight, kLow},    {kRight, kLevel}, {kMiddle, kLevel},
};

uint32_t distance_squared(Aim a, Aim b) {
  const int32_t pan = static_cast<int32_t>(a.pan_us) - b.pan_us;
  const int32_t tilt = static_cast<int32_t>(a.tilt_us) - b.tilt_us;
  return static_cast<uint32_t>(pan * pan + tilt * tilt);
}

// An angle of the figure as its pulse says it, or farther out to `least_rad`; the middle stays.
float stretched(uint16_t pulse_us, uint16_t centre_us, float us_per_deg, float least_rad) {
  if (pulse_us == centre_us || us_per_deg == 0.0f) return 0.0f;
  const float offset_us = static_cast<float>(pulse_us) - static_cast<float>(centre_us);
  const float angle_rad = offset_us / us_per_deg * kRadiansPerDegree;
  // A scale near nought makes any number of turns of it.
  if (angle_rad < 0.0f) return fmaxf(-kPi, fminf(angle_rad, -least_rad));
  return fminf(kPi, fmaxf(angle_rad, least_rad));
}

float within_reach(float angle_rad, uint16_t reach_deg) {
  return fminf(angle_rad, reach_deg * kRadiansPerDegree);
}

}  // namespace

Aim scan_point(const Parameters& parameters, uint8_t index) {
  const Cell cell = from_flash(kCells[index]);
  return {parameters.whole(cell.pan), parameters.whole(cell.tilt)};
}

Aim scan_centre(const Parameters& parameters) {
  return {parameters.whole(kMiddle), parameters.whole(kLevel)};
}

uint8_t nearest_scan_point(const Parameters& parameters, Aim aim) {
  uint8_t nearest = 0;
  uint32_t least = distance_squared(scan_point(parameters, 0), aim);
  for (uint8_t index = 1; index < kScanPoints; ++index) {
    const uint32_t distance = distance_squared(scan_point(parameters, index), aim);
    if (distance >= least) continue;
    least = distance;
    nearest = index;
  }
  return nearest;
}

Direction scan_offset(const Parameters& parameters, uint8_t index, float deviation_rad) {
  const Aim point = scan_point(parameters, index);
  const Aim centre = scan_centre(parameters);
  const float pan_rad = within_reach(2 * deviation_rad, parameters.whole(Parameter::kPanReach));
  const float tilt_rad = within_reach(2 * deviation_rad, parameters.whole(Parameter::kTiltReach));
  return {
      stretched(point.pan_us, centre.pan_us, parameters.get(Parameter::kPanScale), pan_rad),
      stretched(point.tilt_us, centre.tilt_us, parameters.get(Parameter::kTiltScale), tilt_rad),
  };
}

uint8_t faded_scan_point(const Parameters& parameters, uint8_t index, Direction offset,
                         float deviation_rad) {
  const Direction point = scan_offset(parameters, index, deviation_rad);
  const Cell was = from_flash(kCells[index]);
  const bool aside = 2 * fabsf(offset.right_rad) > fabsf(point.right_rad);
  const bool off_level = 2 * fabsf(offset.up_rad) > fabsf(point.up_rad);
  const Cell now = {aside ? was.pan : kMiddle, off_level ? was.tilt : kLevel};
  for (index = 0; index < kScanPoints; ++index) {
    const Cell cell = from_flash(kCells[index]);
    if (cell.pan == now.pan && cell.tilt == now.tilt) break;
  }
  return index;
}

}  // namespace echowing
