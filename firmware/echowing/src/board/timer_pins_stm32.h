// What the Arduino core makes of a pin that shall carry a timer's pulses.
#pragma once

#include <Arduino.h>

namespace echowing {

// A row of the core's PinMap_TIM (variants/*/PeripheralPins*.c of core 2.12.0).
struct TimerPin {
  PinName name;
  uint8_t timer;
  uint8_t channel;
  bool inverted;  // channel 1N and its like
};

// HardwareTimer::setMode() takes the first row with the pin's name. If that is another timer or
// another channel, the program stops: so a name stands here only if its row is known, and the same
// on all our boards.
constexpr TimerPin kTimerPins[] = {
    {PA_6, 3, 1, false},
    {PA_7, 1, 1, true},
    {PA_7_ALT1, 3, 2, false},
};

constexpr bool drives(PinName name, uint8_t timer, uint8_t channel) {
  for (const TimerPin& row : kTimerPins) {
    if (row.name == name) return row.timer == timer && row.channel == channel && !row.inverted;
  }
  return false;
}

}  // namespace echowing
