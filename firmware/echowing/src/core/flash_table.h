// Constant tables: on AVR they would be copied to RAM unless declared to stay in flash.
#pragma once

#include <stdint.h>
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

// Compares up to `length` characters with a string of a table.
inline bool same_as_in_flash(const char* text, const char* in_flash, uint8_t length) {
#if defined(__AVR__)
  return strncmp_P(text, in_flash, length) == 0;
#else
  return strncmp(text, in_flash, length) == 0;
#endif
}

// As strlen, of a string of a table.
inline uint16_t length_in_flash(const char* in_flash) {
#if defined(__AVR__)
  return strlen_P(in_flash);
#else
  return static_cast<uint16_t>(strlen(in_flash));
#endif
}

}  // namespace echowing
