#if defined(__AVR__)
#include <avr/eeprom.h>

#include "lasting_memory.h"

namespace echowing {
namespace {

constexpr uint16_t kSlotSpacing = 512;
static_assert(ParameterStore::kSlotSize <= kSlotSpacing, "the slots overlap");
static_assert(2 * kSlotSpacing <= E2END + 1, "the EEPROM is too small");

uint8_t* place(uint8_t slot, uint16_t offset) {
  return reinterpret_cast<uint8_t*>(slot * kSlotSpacing + offset);
}

}  // namespace

uint8_t LastingMemory::read(uint8_t slot, uint16_t offset) {
  return eeprom_read_byte(place(slot, offset));
}

bool LastingMemory::busy() { return !eeprom_is_ready(); }

// Returns at once; the byte burns for 3.3 ms while the loop goes on.
void LastingMemory::write(uint8_t slot, uint16_t offset, uint8_t value) {
  eeprom_update_byte(place(slot, offset), value);
}

void LastingMemory::flush(uint8_t) {}

}  // namespace echowing
#endif
