// stm32duino's independent watchdog, as far as it is used.
#pragma once

#include <stdint.h>

class IWatchdogClass {
 public:
  void begin(uint32_t timeout_us);
  void set(uint32_t timeout_us);
  void reload();
};
extern IWatchdogClass IWatchdog;
