#include "uart.h"

namespace echowing {

uint8_t Uart::read(uint8_t* bytes, uint8_t capacity) {
  uint8_t count = 0;
  while (count < capacity && stream_.available() > 0) {
    bytes[count++] = static_cast<uint8_t>(stream_.read());
  }
  return count;
}

// More than fits would make write() wait for the wire.
uint8_t Uart::write(const uint8_t* bytes, uint8_t count) {
  const int space = stream_.availableForWrite();
  if (space <= 0) return 0;
  const uint8_t taken = count < space ? count : static_cast<uint8_t>(space);
  return static_cast<uint8_t>(stream_.write(bytes, taken));
}

}  // namespace echowing
