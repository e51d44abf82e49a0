// stm32duino's Wire, as far as it is used.
#pragma once

#include "Arduino.h"

class TwoWire {
 public:
  void setSDA(uint32_t pin);
  void setSCL(uint32_t pin);
  void begin();
  void end();
  void setClock(uint32_t frequency_hz);
  void beginTransmission(uint8_t address);
  size_t write(const uint8_t* bytes, size_t count);
  uint8_t endTransmission();
  uint8_t requestFrom(uint8_t address, uint8_t count);
  int read();
};
extern TwoWire Wire;
