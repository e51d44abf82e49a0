// Parameters in memory that survives power-off: two slots in turn, each with layout, sequence
// number and CRC, so that losing power in mid-write leaves the older set whole.
#pragma once

#include <stdint.h>

#include "parameters.h"
#include "ports.h"
#include "timing.h"

namespace echowing {

enum class StoreEvent : uint8_t {
  kNone,
  kStored,  // a set has been written and read back
  kFailed,  // what was read back is not what was written
};

class ParameterStore {
 public:
  enum class Loaded : uint8_t { kStored, kBlank, kCorrupt };

  static constexpr uint8_t kHeaderSize = 4;  // layout, sequence: 16 bits each, low byte first
  static constexpr uint16_t kImageSize = kHeaderSize + kParameterCount * sizeof(float);
  static constexpr uint16_t kSlotSize = kImageSize + 2;  // CRC

  // Reads the newer good slot into `parameters`; leaves defaults when there is none.
  Loaded load(SlotMemory& memory, Parameters& parameters);
  // Whether what is stored can be read back, or nothing has been stored yet. Not while busy.
  bool sound(SlotMemory& memory) const;
  // Call it when a parameter has changed: it is stored 2 s after the last change.
  void touch(const Instant& now);
  // One loop turn: at most one byte, one flush or one reading back, and only while `allowed`.
  StoreEvent step(const Instant& now, bool allowed, SlotMemory& memory,
                  const Parameters& parameters);

 private:
  enum class Phase : uint8_t { kIdle, kWriting, kReadingBack };

  void begin();
  void write_next(SlotMemory& memory, const Parameters& parameters);
  StoreEvent read_back(SlotMemory& memory);
  uint8_t other_slot() const { return static_cast<uint8_t>(1 - slot_); }
  uint8_t image_byte(uint16_t offset, const Parameters& parameters) const;

  Timeout calm_;
  bool wanted_ = false;
  Phase phase_ = Phase::kIdle;
  uint8_t slot_ = 1;  // in force; the other one is written next
  uint16_t sequence_ = 0;
  uint16_t offset_ = 0;
  uint16_t crc_ = 0;
  uint16_t read_crc_ = 0;
};

}  // namespace echowing
