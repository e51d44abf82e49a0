#include "scan.h"

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

}  // namespace echowing
