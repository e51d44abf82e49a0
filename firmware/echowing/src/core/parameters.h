// The tunables: names, limits and values in force. One table, in parameter_table.h.
#pragma once

#include <stdint.h>

namespace echowing {

enum class Parameter : uint8_t {
#define ECHOWING_PARAMETER(identifier, name, normal, least, most, whole, in_flight, unit, text) \
  identifier,
#include "parameter_table.h"
#undef ECHOWING_PARAMETER
};

constexpr uint8_t kParameterCount = 0
#define ECHOWING_PARAMETER(identifier, name, normal, least, most, whole, in_flight, unit, text) +1
#include "parameter_table.h"
#undef ECHOWING_PARAMETER
    ;

// How many there were before PAN_REACH and TILT_REACH were added at the end: a board that is
// flashed anew finds such a set in its memory.
constexpr uint8_t kFormerParameterCount = 23;
static_assert(kFormerParameterCount < kParameterCount, "parameters are added at the end");

// PARAM_VALUE.param_id holds 16 characters, without a null when all are used.
constexpr uint8_t kParameterNameLength = 16;

struct ParameterInfo {
  char name[kParameterNameLength];
  int16_t normal;
  int16_t least;
  int16_t most;
  bool whole;
  bool in_flight;  // may be changed while armed
};

// Row of the table; `index` below kParameterCount.
ParameterInfo parameter_info(uint8_t index);

// Changes with the names and order of the first `count` parameters, which is one of the two counts:
// what another table stored is not ours.
uint16_t parameter_layout(uint8_t count);

static_assert(sizeof(float) == 4, "values travel and are stored as 32-bit floats");

class Parameters {
 public:
  Parameters() { reset(); }

  float get(Parameter parameter) const { return values_[static_cast<uint8_t>(parameter)]; }
  // For whole parameters, all of which fit 16 bits.
  uint16_t whole(Parameter parameter) const { return static_cast<uint16_t>(get(parameter)); }
  float at(uint8_t index) const { return values_[index]; }

  // False, and nothing changed, when out of range, not finite, or not whole where it has to be.
  bool set(uint8_t index, float value);
  // Index of a name (up to 16 characters, null-terminated if shorter), or -1.
  static int16_t find(const char* name);
  void reset();

 private:
  float values_[kParameterCount];
};

}  // namespace echowing
