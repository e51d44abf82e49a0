#include "wire_bus.h"

#include <Arduino.h>
#include <Wire.h>

#include "pins.h"

namespace echowing {
namespace {

// As fast as the sonar goes without stretching the clock (its data sheet, PD11848).
constexpr uint32_t kClock_hz = 50000;

// A transfer that has failed by now was broken off: a missing acknowledgement is seen after 0.2 ms,
// and the longest transfer, four bytes, takes 0.74 ms.
constexpr uint32_t kBrokenOff_us = 1000;

#if defined(__AVR__)
// Twice the 0.6 ms that a read of three bytes takes, for a sensor that stretches the clock all the
// same; a stuck bus may not hold a loop turn for long.
// On STM32 it is two to three milliseconds, by I2C_TIMEOUT_TICK in the sketch's build_opt.h, a
// file in which that core takes compiler options and no comments.
constexpr uint32_t kTimeout_us = 1200;
#endif

// Open drain: low is driven, high is let go.
void drive(uint8_t pin, bool high) {
  if (high) {
    pinMode(pin, INPUT_PULLUP);
    return;
  }
  digitalWrite(pin, LOW);
  pinMode(pin, OUTPUT);
}

}  // namespace

void WireBus::begin() {
#if defined(ARDUINO_ARCH_STM32)
  Wire.setSDA(kPins.i2c_data);
  Wire.setSCL(kPins.i2c_clock);
#endif
  Wire.begin();
  Wire.setClock(kClock_hz);
#if defined(__AVR__)
  Wire.setWireTimeout(kTimeout_us, true);
#endif
}

bool WireBus::write(uint8_t address, const uint8_t* bytes, uint8_t count) {
  const uint32_t begun_us = micros();
  Wire.beginTransmission(address);
  Wire.write(bytes, count);
  return note(Wire.endTransmission() == 0, begun_us);
}

bool WireBus::read(uint8_t address, uint8_t* bytes, uint8_t count) {
  const uint32_t begun_us = micros();
  if (!note(Wire.requestFrom(address, count) == count, begun_us)) return false;
  for (uint8_t i = 0; i < count; ++i) bytes[i] = static_cast<uint8_t>(Wire.read());
  return true;
}

bool WireBus::note(bool good, uint32_t begun_us) {
  if (!good && micros() - begun_us >= kBrokenOff_us) timed_out_ = true;
  return good;
}

bool WireBus::take_timeout() {
  const bool timed_out = timed_out_;
  timed_out_ = false;
  return timed_out;
}

void WireBus::restart() {
  Wire.end();
  begin();
}

void WireBus::take_lines() {
  Wire.end();
  drive(kPins.i2c_data, true);
  drive(kPins.i2c_clock, true);
}

void WireBus::drive_clock(bool high) { drive(kPins.i2c_clock, high); }
void WireBus::drive_data(bool high) { drive(kPins.i2c_data, high); }

}  // namespace echowing
