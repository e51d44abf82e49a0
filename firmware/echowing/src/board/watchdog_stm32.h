// The independent watchdog of the STM32. Its oscillator is slow or fast by half of the nominal
// rate.
#pragma once

#include <IWatchdog.h>

namespace echowing {

// A hundred times the longest loop turn, and more than the core needs to start.
constexpr uint32_t kWatchdog_us = 500000;

// Longer while the flash is erased, in which the processor stands still: up to 2 s for a sector of
// 128 kB (STM32F411 data sheet, programming by 32 bits).
class WatchdogDuringErase {
 public:
  WatchdogDuringErase() { IWatchdog.set(kErase_us); }
  ~WatchdogDuringErase() { IWatchdog.set(kWatchdog_us); }

 private:
  static constexpr uint32_t kErase_us = 8000000;
};

}  // namespace echowing
