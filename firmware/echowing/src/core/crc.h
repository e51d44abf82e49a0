// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xffff.
#pragma once

#include <stdint.h>

namespace echowing {

constexpr uint16_t kCrcStart = 0xffff;

constexpr uint16_t crc_add(uint16_t crc, uint8_t byte) {
  crc = static_cast<uint16_t>(crc ^ static_cast<uint16_t>(byte << 8));
  for (uint8_t bit = 0; bit < 8; ++bit) {
    const uint16_t shifted = static_cast<uint16_t>(crc << 1);
    crc = (crc & 0x8000) != 0 ? static_cast<uint16_t>(shifted ^ 0x1021) : shifted;
  }
  return crc;
}

}  // namespace echowing
