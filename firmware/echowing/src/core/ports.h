// What the core needs from the world. The board layer, the host build and the tests implement it.
#pragma once

#include <stdint.h>

namespace echowing {

// A UART that never blocks.
class SerialPort {
 public:
  // Copies up to `capacity` bytes that have arrived; returns how many.
  virtual uint8_t read(uint8_t* bytes, uint8_t capacity) = 0;
  // Takes as many of `count` bytes as fit without waiting; returns how many.
  virtual uint8_t write(const uint8_t* bytes, uint8_t count) = 0;

 protected:
  ~SerialPort() = default;
};

// An I2C master, and its two lines by hand for freeing a stuck bus.
class I2cBus {
 public:
  // `address` is the 7-bit one. False: not acknowledged, or the bus did not answer in time.
  virtual bool write(uint8_t address, const uint8_t* bytes, uint8_t count) = 0;
  virtual bool read(uint8_t address, uint8_t* bytes, uint8_t count) = 0;
  // True once after a transfer that ended by time-out: the bus is held, or the peripheral hangs.
  virtual bool take_timeout() = 0;
  // Initialises the peripheral again.
  virtual void restart() = 0;

  // Between take_lines and return_lines the peripheral is off and the lines are open drain.
  virtual void take_lines() = 0;
  virtual void drive_clock(bool high) = 0;
  virtual void drive_data(bool high) = 0;
  virtual void return_lines() = 0;

 protected:
  ~I2cBus() = default;
};

// Pulses of the two servos.
struct Aim {
  uint16_t pan_us;
  uint16_t tilt_us;
};

// What hobby servos stand.
constexpr float kShortestPulse_us = 800.0f;
constexpr float kLongestPulse_us = 2200.0f;

class ServoOutput {
 public:
  virtual void write(Aim aim) = 0;

 protected:
  ~ServoOutput() = default;
};

// Memory that survives power-off: two slots that can be rewritten one without the other.
class SlotMemory {
 public:
  virtual uint8_t read(uint8_t slot, uint16_t offset) = 0;
  // True while an earlier write is still burning; nothing else may be called meanwhile.
  virtual bool busy() = 0;
  virtual void write(uint8_t slot, uint16_t offset, uint8_t value) = 0;
  // Makes the bytes written to `slot` last. May take as long as a flash erase.
  virtual void flush(uint8_t slot) = 0;

 protected:
  ~SlotMemory() = default;
};

// Why the board started, as far as it knows.
enum class ResetCause : uint8_t { kUnknown, kPowerOn, kBrownOut, kPin, kWatchdog, kOrdered };

// What the board itself can do and say.
class Board {
 public:
  virtual ResetCause reset_cause() const = 0;
  // First eight characters of the git hash this was built from.
  virtual const char* git_hash() const = 0;
  // Does not return on hardware. Boards without a bootloader to enter restart plainly.
  virtual void reboot(bool into_bootloader) = 0;

 protected:
  ~Board() = default;
};

}  // namespace echowing
