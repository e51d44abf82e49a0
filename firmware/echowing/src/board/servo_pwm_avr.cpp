#if defined(__AVR__)
#include <Arduino.h>

#include "pins.h"
#include "servo_pwm.h"

namespace echowing {
namespace {

static_assert(kPins.pan == 11 && kPins.tilt == 12, "Timer1 of the ATmega2560 drives pins 11, 12");

// Clock / 8: two ticks a microsecond.
constexpr uint16_t kTicksPerUs = F_CPU / 8 / 1000000;
constexpr uint16_t kFrameTicks = 20000 * kTicksPerUs;

// The pulses that the core gives, 0.8 to 2.2 ms, end between these.
constexpr uint16_t kFirstEnd = 700 * kTicksPerUs;
constexpr uint16_t kLastEnd = 2300 * kTicksPerUs;

// The pin is high from the start of the frame up to and including tick OCR1x.
constexpr uint16_t compare(uint16_t pulse_us) { return pulse_us * kTicksPerUs - 1; }

}  // namespace

// Mode 14: fast PWM with ICR1 as top, outputs set at the bottom and cleared on compare. The
// limits are written before the clock is turned on.
void ServoPwm::begin(Aim aim) {
  TCCR1B = 0;
  TCCR1A = _BV(COM1A1) | _BV(COM1B1) | _BV(WGM11);
  TCNT1 = 0;
  ICR1 = kFrameTicks - 1;
  OCR1A = compare(aim.pan_us);
  OCR1B = compare(aim.tilt_us);
  written_ = aim;
  pinMode(kPins.pan, OUTPUT);
  pinMode(kPins.tilt, OUTPUT);
  TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS11);
}

// Not while pulses end, so that both servos change in the same frame and no pulse misses its end:
// the chip double-buffers each compare register, an emulator may not. The next turn will do.
void ServoPwm::write(Aim aim) {
  const uint16_t ticks = TCNT1;
  if (ticks >= kFirstEnd && ticks < kLastEnd) return;
  if (aim.pan_us != written_.pan_us) OCR1A = compare(aim.pan_us);
  if (aim.tilt_us != written_.tilt_us) OCR1B = compare(aim.tilt_us);
  written_ = aim;
}

}  // namespace echowing
#endif
