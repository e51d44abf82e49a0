#include "wire_bus.h"

#include <Arduino.h>
#include <Wire.h>

#include "pins.h"

namespace echowing {
namespace {

// The sonar takes 400 kHz, but a shielded lead of a metre is better off slower.
constexpr uint32_t kClock_hz = 100000;

#if defined(__AVR__)
// A read of three bytes takes 0.3 ms at 100 kHz; a stuck bus may not hold a loop turn for long.
// On STM32 the same is said in milliseconds by I2C_TIMEOUT_TICK in the sketch's build_opt.h, a
// file in which that core takes compiler options and no comments.
constexpr uint32_t kTimeout_us = 1000;
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
  Wire.beginTransmission(address);
  Wire.write(bytes, count);
  return Wire.endTransmission() == 0;
}

bool WireBus::read(uint8_t address, uint8_t* bytes, uint8_t count) {
  if (Wire.requestFrom(address, count) != count) return false;
  for (uint8_t i = 0; i < count; ++i) bytes[i] = static_cast<uint8_t>(Wire.read());
  return true;
}

void WireBus::take_lines() {
  Wire.end();
  drive(kPins.i2c_data, true);
  drive(kPins.i2c_clock, true);
}

void WireBus::drive_clock(bool high) { drive(kPins.i2c_clock, high); }
void WireBus::drive_data(bool high) { drive(kPins.i2c_data, high); }

}  // namespace echowing
