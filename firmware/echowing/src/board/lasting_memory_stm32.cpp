#if defined(ARDUINO_ARCH_STM32)
#include <Arduino.h>

#include "lasting_memory.h"

namespace echowing {
namespace {

// Each slot has the smallest block of its own that can be erased, at the end of the flash: losing
// power while one is rewritten cannot hurt the other.
#if defined(STM32F1xx)
constexpr uint32_t kSlotAddress[] = {0x0800f800, 0x0800fc00};  // last 1 kB pages of 64 kB

uint32_t erase(uint8_t slot) {
  FLASH_EraseInitTypeDef order = {};
  order.TypeErase = FLASH_TYPEERASE_PAGES;
  order.PageAddress = kSlotAddress[slot];
  order.NbPages = 1;
  uint32_t failed;
  return HAL_FLASHEx_Erase(&order, &failed);
}
#elif defined(STM32F4xx)
constexpr uint32_t kSlotAddress[] = {0x08040000, 0x08060000};  // last 128 kB sectors of 512 kB

uint32_t erase(uint8_t slot) {
  FLASH_EraseInitTypeDef order = {};
  order.TypeErase = FLASH_TYPEERASE_SECTORS;
  order.Sector = slot == 0 ? FLASH_SECTOR_6 : FLASH_SECTOR_7;
  order.NbSectors = 1;
  order.VoltageRange = FLASH_VOLTAGE_RANGE_3;  // 2.7 to 3.6 V
  uint32_t failed;
  return HAL_FLASHEx_Erase(&order, &failed);
}
#endif

}  // namespace

uint8_t LastingMemory::read(uint8_t slot, uint16_t offset) {
  return *reinterpret_cast<const volatile uint8_t*>(kSlotAddress[slot] + offset);
}

bool LastingMemory::busy() { return false; }

void LastingMemory::write(uint8_t, uint16_t offset, uint8_t value) { bytes_[offset] = value; }

// The processor stands still while the flash erases: up to 2 s for a sector of an F4.
void LastingMemory::flush(uint8_t slot) {
  HAL_FLASH_Unlock();
  bool good = erase(slot) == HAL_OK;
  for (uint32_t word = 0; good && word < sizeof(words_) / sizeof(words_[0]); ++word) {
    const uint32_t address = kSlotAddress[slot] + 4 * word;
    good = HAL_FLASH_Program(FLASH_TYPEPROGRAM_WORD, address, words_[word]) == HAL_OK;
  }
  HAL_FLASH_Lock();
}

}  // namespace echowing
#endif
