// The status light, whichever level lights it.
#pragma once

#include "pins.h"

namespace echowing {

inline void set_led(bool on) { digitalWrite(kPins.led, on ? kLedOn : !kLedOn); }

inline void begin_led() {
  pinMode(kPins.led, OUTPUT);
  set_led(true);
}

}  // namespace echowing
