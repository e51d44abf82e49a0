// The board's lasting memory: EEPROM on AVR, two flash blocks of their own on STM32.
#pragma once

#include "../core/parameter_store.h"
#include "../core/ports.h"

namespace echowing {

class LastingMemory : public SlotMemory {
 public:
  uint8_t read(uint8_t slot, uint16_t offset) override;
  bool busy() override;
  void write(uint8_t slot, uint16_t offset, uint8_t value) override;
  void flush(uint8_t slot) override;

#if defined(ARDUINO_ARCH_STM32)
 private:
  // Flash is programmed in words once its block has been erased as a whole.
  union {
    uint8_t bytes_[(ParameterStore::kSlotSize + 3) / 4 * 4];
    uint32_t words_[(ParameterStore::kSlotSize + 3) / 4];
  };
#endif
};

}  // namespace echowing
