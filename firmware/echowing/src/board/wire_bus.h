// The I2C bus through Wire, and its lines by hand.
#pragma once

#include "../core/ports.h"

namespace echowing {

class WireBus : public I2cBus {
 public:
  void begin();
  bool write(uint8_t address, const uint8_t* bytes, uint8_t count) override;
  bool read(uint8_t address, uint8_t* bytes, uint8_t count) override;
  bool take_timeout() override;
  void restart() override;
  void take_lines() override;
  void drive_clock(bool high) override;
  void drive_data(bool high) override;
  void return_lines() override { begin(); }

 private:
  // Notes how a transfer that began at `begun_us` has ended; returns `good`.
  bool note(bool good, uint32_t begun_us);

  bool timed_out_ = false;
};

}  // namespace echowing
