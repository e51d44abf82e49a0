#if defined(ARDUINO_ARCH_STM32)
#include <Arduino.h>

#include "board_here.h"
#include "lasting_memory.h"
#include "watchdog_stm32.h"

// From the linker script: where the initial values of variables lie in flash, which is the end of
// the program, and their place in RAM.
extern "C" const uint8_t _sidata[], _sdata[], _edata[];

namespace echowing {
namespace {

// Each slot has the smallest block of its own that can be erased, at the end of the flash: losing
// power while one is rewritten cannot hurt the other.
constexpr uint32_t kProgramEnd = FLASH_BASE + ECHOWING_PROGRAM_BYTES;
constexpr uint32_t kBlockSize = ECHOWING_SLOT_BYTES;
static_assert(ParameterStore::kSlotSize <= kBlockSize, "a slot is larger than its block");

constexpr uint32_t slot_address(uint8_t slot) { return kProgramEnd + slot * kBlockSize; }

#if defined(STM32F1xx)
static_assert(kBlockSize == 1024 && kProgramEnd % kBlockSize == 0, "the F103xB has pages of 1 kB");

bool erase(uint8_t slot) {
  FLASH_EraseInitTypeDef order = {};
  order.TypeErase = FLASH_TYPEERASE_PAGES;
  order.PageAddress = slot_address(slot);
  order.NbPages = 1;
  uint32_t failed;
  return HAL_FLASHEx_Erase(&order, &failed) == HAL_OK;
}
#elif defined(STM32F4xx)
// Sectors 0 to 4 make up the first 128 kB, of which each further sector has as many.
constexpr uint32_t kFirstSector = 4 + ECHOWING_PROGRAM_BYTES / kBlockSize;
static_assert(kBlockSize == 0x20000 && ECHOWING_PROGRAM_BYTES % kBlockSize == 0,
              "sectors from 5 on have 128 kB");

bool erase(uint8_t slot) {
  FLASH_EraseInitTypeDef order = {};
  order.TypeErase = FLASH_TYPEERASE_SECTORS;
  order.Sector = kFirstSector + slot;
  order.NbSectors = 1;
  order.VoltageRange = FLASH_VOLTAGE_RANGE_3;  // 2.7 to 3.6 V
  uint32_t failed;
  return HAL_FLASHEx_Erase(&order, &failed) == HAL_OK;
}
#endif

// Our build keeps the program out of the slots; another, as the Arduino IDE's, may not.
bool program_ends_before_slots() {
  const uint32_t end = reinterpret_cast<uintptr_t>(_sidata) + (_edata - _sdata);
  return end <= kProgramEnd;
}

}  // namespace

uint8_t LastingMemory::read(uint8_t slot, uint16_t offset) {
  return *reinterpret_cast<const volatile uint8_t*>(slot_address(slot) + offset);
}

bool LastingMemory::busy() { return false; }

void LastingMemory::write(uint8_t, uint16_t offset, uint8_t value) { bytes_[offset] = value; }

// The processor stands still while the flash erases: up to 2 s for a sector of an F4.
void LastingMemory::flush(uint8_t slot) {
  if (!program_ends_before_slots()) return;
  const WatchdogDuringErase longer;
  HAL_FLASH_Unlock();
  bool good = erase(slot);
  for (uint32_t word = 0; good && word < sizeof(words_) / sizeof(words_[0]); ++word) {
    const uint32_t address = slot_address(slot) + 4 * word;
    good = HAL_FLASH_Program(FLASH_TYPEPROGRAM_WORD, address, words_[word]) == HAL_OK;
  }
  HAL_FLASH_Lock();
}

}  // namespace echowing
#endif
