// The pins of the board being compiled for.
#pragma once

#include <Arduino.h>

namespace echowing {

struct Pins {
  uint8_t pan;
  uint8_t tilt;
  uint8_t i2c_data;
  uint8_t i2c_clock;
  uint8_t link_rx;
  uint8_t link_tx;
  uint8_t led;
  uint8_t led_on_level;
};

#define ECHOWING_PINS_HERE(...) constexpr Pins kPins = {__VA_ARGS__};
#define ECHOWING_PINS_ELSEWHERE(...)

#if defined(ARDUINO_AVR_MEGA2560)
#define ECHOWING_PINS_mega ECHOWING_PINS_HERE
#else
#define ECHOWING_PINS_mega ECHOWING_PINS_ELSEWHERE
#endif
#if defined(ARDUINO_BLACKPILL_F411CE)
#define ECHOWING_PINS_blackpill_f411 ECHOWING_PINS_HERE
#else
#define ECHOWING_PINS_blackpill_f411 ECHOWING_PINS_ELSEWHERE
#endif
#if defined(ARDUINO_BLUEPILL_F103C8)
#define ECHOWING_PINS_bluepill_f103 ECHOWING_PINS_HERE
#else
#define ECHOWING_PINS_bluepill_f103 ECHOWING_PINS_ELSEWHERE
#endif
#if defined(ARDUINO_NUCLEO_F446RE)
#define ECHOWING_PINS_nucleo_f446 ECHOWING_PINS_HERE
#else
#define ECHOWING_PINS_nucleo_f446 ECHOWING_PINS_ELSEWHERE
#endif

#include "pin_table.h"

// "kPins was not declared" below means: this board has no row in pin_table.h.
constexpr bool all_different(const Pins& pins) {
  const uint8_t all[] = {pins.pan,     pins.tilt,    pins.i2c_data, pins.i2c_clock,
                         pins.link_rx, pins.link_tx, pins.led};
  for (uint8_t i = 0; i < sizeof(all); ++i) {
    for (uint8_t j = 0; j < i; ++j) {
      if (all[i] == all[j]) return false;
    }
  }
  return true;
}
static_assert(all_different(kPins), "pin_table.h uses a pin of this board twice");

}  // namespace echowing
