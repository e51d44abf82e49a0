// A serial port of the Arduino core as the core's SerialPort.
#pragma once

#include <Arduino.h>

#include "../core/ports.h"

namespace echowing {

class Uart : public SerialPort {
 public:
  explicit Uart(Stream& stream) : stream_(stream) {}
  uint8_t read(uint8_t* bytes, uint8_t capacity) override;
  uint8_t write(const uint8_t* bytes, uint8_t count) override;

 private:
  Stream& stream_;
};

}  // namespace echowing
