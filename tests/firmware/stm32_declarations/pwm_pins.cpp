// The core's timer as far as it can refuse a pin: rows of PinMap_TIM in the variants'
// PeripheralPins files (core 2.12.0), looked up as HardwareTimer::setMode() does. Where the core
// stops for ever in Error_Handler(), the program here ends.
#include <stdio.h>
#include <stdlib.h>

#include "Arduino.h"

namespace {

TIM_TypeDef timers[] = {{1}, {3}};

struct Row {
  PinName pin;
  uint8_t timer;
  uint8_t channel;
  bool inverted;
};

constexpr Row kRows[] = {
    {PA_6, 3, 1, false},       {PA_7, 1, 1, true},      {PA_7_ALT1, 3, 2, false},
#if defined(ARDUINO_NUCLEO_F446RE)
    {PA_6_ALT1, 13, 1, false}, {PA_7_ALT2, 8, 1, true}, {PA_7_ALT3, 14, 1, false},
#endif
};

const Row* first_row(PinName pin) {
  for (const Row& row : kRows) {
    if (row.pin == pin) return &row;
  }
  return nullptr;
}

}  // namespace

TIM_TypeDef* const TIM1 = &timers[0];
TIM_TypeDef* const TIM3 = &timers[1];

void HardwareTimer::setMode(uint32_t channel, TimerModes_t, PinName pin) {
  const Row* row = first_row(pin);
  if (row == nullptr || row->timer != instance_->number || row->channel != channel) {
    printf("the core stops here: pin 0x%03x is not channel %u of TIM%u\n",
           static_cast<unsigned>(pin), static_cast<unsigned>(channel),
           static_cast<unsigned>(instance_->number));
    exit(3);
  }
  printf("TIM%u channel %u%s on pin 0x%03x\n", static_cast<unsigned>(row->timer),
         static_cast<unsigned>(channel), row->inverted ? "N" : "", static_cast<unsigned>(pin));
}

// PA0 is number 0 on our boards, and port A comes first.
void HardwareTimer::setMode(uint32_t channel, TimerModes_t mode, uint32_t pin) {
  setMode(channel, mode, static_cast<PinName>(pin));
}

void HardwareTimer::setOverflow(uint32_t, TimerFormat_t) {}
void HardwareTimer::setCaptureCompare(uint32_t, uint32_t, TimerCompareFormat_t) {}
void HardwareTimer::resume() {}
