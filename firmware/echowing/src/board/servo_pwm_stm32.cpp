#if defined(ARDUINO_ARCH_STM32)
#include <Arduino.h>

#include "pins.h"
#include "servo_pwm.h"

namespace echowing {
namespace {

constexpr uint32_t kFrame_us = 20000;
constexpr uint32_t kPanChannel = 1;  // TIM3 on PA6 and PA7
constexpr uint32_t kTiltChannel = 2;

HardwareTimer& timer() {
  static HardwareTimer tim3(TIM3);
  return tim3;
}

}  // namespace

void ServoPwm::begin(Aim aim) {
  timer().setMode(kPanChannel, TIMER_OUTPUT_COMPARE_PWM1, kPins.pan);
  timer().setMode(kTiltChannel, TIMER_OUTPUT_COMPARE_PWM1, kPins.tilt);
  timer().setOverflow(kFrame_us, MICROSEC_FORMAT);
  timer().setCaptureCompare(kPanChannel, aim.pan_us, MICROSEC_COMPARE_FORMAT);
  timer().setCaptureCompare(kTiltChannel, aim.tilt_us, MICROSEC_COMPARE_FORMAT);
  written_ = aim;
  timer().resume();
}

void ServoPwm::write(Aim aim) {
  if (aim.pan_us != written_.pan_us) {
    timer().setCaptureCompare(kPanChannel, aim.pan_us, MICROSEC_COMPARE_FORMAT);
  }
  if (aim.tilt_us != written_.tilt_us) {
    timer().setCaptureCompare(kTiltChannel, aim.tilt_us, MICROSEC_COMPARE_FORMAT);
  }
  written_ = aim;
}

}  // namespace echowing
#endif
