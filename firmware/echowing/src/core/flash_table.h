// Constant tables: on AVR they would be copied to RAM unless told to stay in flash.
#pragma once

#include <string.h>

#if defined(__AVR__)
#include <avr/pgmspace.h>
#define ECHOWING_FLASH PROGMEM
#else
#define ECHOWING_FLASH
#endif

namespace echowing {

template <typename Row>
Row from_flash(const Row& row) {
#if defined(__AVR__)
  Row copy;
  memcpy_P(&copy, &row, sizeof(copy));
  return copy;
#else
  return row;
#endif
}

}  // namespace echowing
