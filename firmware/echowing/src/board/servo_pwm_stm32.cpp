#if defined(ARDUINO_ARCH_STM32)
#include <Arduino.h>

#include "pins.h"
#include "servo_pwm.h"
#include "timer_pins_stm32.h"

namespace echowing {
namespace {

static_assert(drives(ECHOWING_PAN_OUTPUT, ECHOWING_SERVO_TIMER, ECHOWING_PAN_CHANNEL),
              "the core would stop at start-up: the pan output is not that channel of the timer");
static_assert(drives(ECHOWING_TILT_OUTPUT, ECHOWING_SERVO_TIMER, ECHOWING_TILT_CHANNEL),
              "the core would stop at start-up: the tilt output is not that channel of the timer");
static_assert(ECHOWING_PAN_CHANNEL != ECHOWING_TILT_CHANNEL, "both servos on one channel");

// TIM3 for a servo timer of 3.
#define ECHOWING_TIMER_NAMED(number) TIM##number
#define ECHOWING_TIMER(number) ECHOWING_TIMER_NAMED(number)

constexpr uint32_t kFrame_us = 20000;
constexpr uint32_t kPanChannel = ECHOWING_PAN_CHANNEL;
constexpr uint32_t kTiltChannel = ECHOWING_TILT_CHANNEL;

HardwareTimer& timer() {
  static HardwareTimer timer(ECHOWING_TIMER(ECHOWING_SERVO_TIMER));
  return timer;
}

}  // namespace

// The timer starts with no pulse in its first frame: the channels are connected one after the other
// while it counts already, and a pulse would be cut. Widths are taken over with the next frame.
void ServoPwm::begin(Aim aim) {
  timer().setMode(kPanChannel, TIMER_OUTPUT_COMPARE_PWM1, ECHOWING_PAN_OUTPUT);
  timer().setMode(kTiltChannel, TIMER_OUTPUT_COMPARE_PWM1, ECHOWING_TILT_OUTPUT);
  timer().setOverflow(kFrame_us, MICROSEC_FORMAT);
  timer().resume();
  written_ = {};
  write(aim);
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
