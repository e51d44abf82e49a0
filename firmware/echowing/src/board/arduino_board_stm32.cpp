#if defined(ARDUINO_ARCH_STM32)
#include <IWatchdog.h>
#include <backup.h>

#include "arduino_board.h"

namespace echowing {
namespace {

// Erasing a 128 kB flash sector stops the processor for up to 2 s (STM32F411 data sheet, x32);
// slow specimens of the watchdog's own oscillator count twice as fast.
constexpr uint32_t kWatchdog_us = 8000000;

// Survives a reset, so that the bootloader can be entered before the watchdog runs: once started
// it cannot be stopped, and the bootloader does not feed it.
constexpr uint32_t kBootloaderMagic = 0xb007;  // 16 bits: that is what a register of the F1 holds

// Application note AN2606.
#if defined(STM32F1xx)
constexpr uint32_t kSystemMemory = 0x1ffff000;
#elif defined(STM32F4xx)
constexpr uint32_t kSystemMemory = 0x1fff0000;
#endif

[[noreturn]] void jump_to_system_memory() {
  const uint32_t stack = *reinterpret_cast<const volatile uint32_t*>(kSystemMemory);
  const uint32_t entry = *reinterpret_cast<const volatile uint32_t*>(kSystemMemory + 4);
  HAL_RCC_DeInit();
  SysTick->CTRL = 0;
#if defined(STM32F4xx)
  // Its vectors are read from address 0, where the flash is seen otherwise.
  __HAL_RCC_SYSCFG_CLK_ENABLE();
  __HAL_SYSCFG_REMAPMEMORY_SYSTEMFLASH();
#endif
  __set_MSP(stack);
  reinterpret_cast<void (*)()>(entry)();
  for (;;) {
  }
}

}  // namespace

void ArduinoBoard::start_watchdog() { IWatchdog.begin(kWatchdog_us); }

void ArduinoBoard::feed_watchdog() { IWatchdog.reload(); }

uint32_t ArduinoBoard::seed() const { return HAL_GetUIDw0() ^ HAL_GetUIDw1() ^ HAL_GetUIDw2(); }

void ArduinoBoard::enter_bootloader_if_asked() {
  enableBackupDomain();
  if (getBackupRegister(LL_RTC_BKP_DR1) != kBootloaderMagic) return;
  setBackupRegister(LL_RTC_BKP_DR1, 0);
  jump_to_system_memory();
}

// Several flags may be set: any reset pulls the reset pin low, a power-on looks like a brown-out.
ResetCause ArduinoBoard::reset_cause() const {
  ResetCause cause = ResetCause::kUnknown;
  if (__HAL_RCC_GET_FLAG(RCC_FLAG_PINRST)) cause = ResetCause::kPin;
#if defined(RCC_FLAG_BORRST)
  if (__HAL_RCC_GET_FLAG(RCC_FLAG_BORRST)) cause = ResetCause::kBrownOut;
#endif
  if (__HAL_RCC_GET_FLAG(RCC_FLAG_PORRST)) cause = ResetCause::kPowerOn;
  if (__HAL_RCC_GET_FLAG(RCC_FLAG_SFTRST)) cause = ResetCause::kOrdered;
  if (__HAL_RCC_GET_FLAG(RCC_FLAG_IWDGRST)) cause = ResetCause::kWatchdog;
  __HAL_RCC_CLEAR_RESET_FLAGS();
  return cause;
}

void ArduinoBoard::reboot(bool into_bootloader) {
  if (into_bootloader) {
    enableBackupDomain();
    setBackupRegister(LL_RTC_BKP_DR1, kBootloaderMagic);
  }
  NVIC_SystemReset();
}

}  // namespace echowing
#endif
