#include "parameters.h"

#include "crc.h"
#include "flash_table.h"

namespace echowing {
namespace {

constexpr ParameterInfo kTable[kParameterCount] ECHOWING_FLASH = {
#define ECHOWING_PARAMETER(identifier, name, normal, least, most, whole, in_flight, unit, text) \
  {name, normal, least, most, whole, in_flight},
#include "parameter_table.h"
#undef ECHOWING_PARAMETER
};

constexpr uint16_t layout_of(const ParameterInfo (&table)[kParameterCount], uint8_t count) {
  uint16_t crc = kCrcStart;
  for (uint8_t row = 0; row < count; ++row) {
    for (uint8_t i = 0; i < kParameterNameLength; ++i) {
      crc = crc_add(crc, static_cast<uint8_t>(table[row].name[i]));
    }
  }
  return crc;
}

constexpr uint16_t kLayout = layout_of(kTable, kParameterCount);
constexpr uint16_t kFormerLayout = layout_of(kTable, kFormerParameterCount);

bool acceptable(const ParameterInfo& info, float value) {
  // Not-a-number fails both comparisons.
  if (!(value >= info.least && value <= info.most)) return false;
  return !info.whole || static_cast<float>(static_cast<int16_t>(value)) == value;
}

}  // namespace

ParameterInfo parameter_info(uint8_t index) { return from_flash(kTable[index]); }

uint16_t parameter_layout(uint8_t count) {
  return count == kParameterCount ? kLayout : kFormerLayout;
}

bool Parameters::set(uint8_t index, float value) {
  if (index >= kParameterCount || !acceptable(parameter_info(index), value)) return false;
  values_[index] = value;
  return true;
}

int16_t Parameters::find(const char* name) {
  for (uint8_t index = 0; index < kParameterCount; ++index) {
    if (same_as_in_flash(name, kTable[index].name, kParameterNameLength)) return index;
  }
  return -1;
}

void Parameters::reset() {
  for (uint8_t index = 0; index < kParameterCount; ++index) {
    values_[index] = parameter_info(index).normal;
  }
}

}  // namespace echowing
