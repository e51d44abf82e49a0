// The pins of the board being compiled for.
#pragma once

#include <Arduino.h>

#include "board_here.h"

namespace echowing {

struct Pins {
  uint8_t pan;
  uint8_t tilt;
  uint8_t i2c_data;
  uint8_t i2c_clock;
  uint8_t link_rx;
  uint8_t link_tx;
  uint8_t led;
};

constexpr Pins kPins = {ECHOWING_PIN_PAN, ECHOWING_PIN_TILT, ECHOWING_PIN_SDA, ECHOWING_PIN_SCL,
                        ECHOWING_PIN_RX,  ECHOWING_PIN_TX,   ECHOWING_PIN_LED};

constexpr uint8_t kLedOn = ECHOWING_LED_ON;

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
static_assert(all_different(kPins), "the board's file uses a pin twice");

}  // namespace echowing
