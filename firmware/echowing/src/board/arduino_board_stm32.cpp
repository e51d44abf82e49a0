#if defined(ARDUINO_ARCH_STM32)
#include <backup.h>

#include "arduino_board.h"
#include "status_led.h"
#include "watchdog_stm32.h"

namespace echowing {
namespace {

// The order to enter the boot loader survives the reset that carries it out. 16 bits: that is what
// a register of the F1 holds.
constexpr uint32_t kBootloaderMagic = 0xb007;
constexpr uint32_t kBootloaderRegister = LL_RTC_BKP_DR1;

// The vector table of the boot loader in ROM: application note AN2606.
#if defined(STM32F1xx)
constexpr uint32_t kSystemMemory = 0x1ffff000;
#elif defined(STM32F4xx)
constexpr uint32_t kSystemMemory = 0x1fff0000;
#endif

// Five flashes of 1/8 s and a pause, in the manner of the core's patterns (src/core/led.cpp).
constexpr uint16_t kCannotGoOn = 0x0155;
constexpr uint8_t kPatternSteps = 16;
constexpr uint32_t kStepsPerSecond = 8;

bool bootloader_asked() {
  __HAL_RCC_PWR_CLK_ENABLE();  // the backup registers are written through it
  enableBackupDomain();
  if (getBackupRegister(kBootloaderRegister) != kBootloaderMagic) return false;
  setBackupRegister(kBootloaderRegister, 0);
  return true;
}

[[noreturn]] void jump_to_bootloader() {
  const uint32_t stack = *reinterpret_cast<const volatile uint32_t*>(kSystemMemory);
  const uint32_t entry = *reinterpret_cast<const volatile uint32_t*>(kSystemMemory + 4);
#if defined(STM32F4xx)
  // It expects itself at address 0, as after a start with BOOT0 high.
  __HAL_RCC_SYSCFG_CLK_ENABLE();
  __HAL_SYSCFG_REMAPMEMORY_SYSTEMFLASH();
#endif
  SCB->VTOR = kSystemMemory;
  __set_MSP(stack);
  reinterpret_cast<void (*)()>(entry)();
  for (;;) {
  }
}

// Called before the Arduino core starts clocks, tick and USB. So the boot loader finds the chip as
// a reset leaves it, with no interrupt enabled and no watchdog, which once started cannot be
// stopped. And LED and watchdog are on when the core starts what can fail.
void wake_early() {
  if (bootloader_asked()) jump_to_bootloader();
  begin_led();
  IWatchdog.begin(kWatchdog_us);
}

__attribute__((section(".preinit_array"), used)) void (*const kWakeEarly)() = wake_early;

// Waits by the tick counter alone: interrupts may be off, and the clocks as they were at reset.
void wait_step() {
  constexpr uint32_t kParts = 8;  // the counter has 24 bits: an eighth of a step at 180 MHz fits
  SysTick->LOAD = SystemCoreClock / kStepsPerSecond / kParts - 1;
  SysTick->VAL = 0;
  SysTick->CTRL = SysTick_CTRL_CLKSOURCE_Msk | SysTick_CTRL_ENABLE_Msk;
  for (uint32_t part = 0; part < kParts; ++part) {
    while ((SysTick->CTRL & SysTick_CTRL_COUNTFLAG_Msk) == 0) {
    }
    IWatchdog.reload();
  }
}

// The core stops for ever where it cannot go on; build_opt.h makes a trap of that, which ends here
// like every fault of the program.
[[noreturn]] void show_and_restart() {
  begin_led();
  for (uint8_t step = 0; step < kPatternSteps; ++step) {
    set_led((kCannotGoOn >> step & 1) != 0);
    wait_step();
  }
  NVIC_SystemReset();
}

}  // namespace

void ArduinoBoard::wake() {}

void ArduinoBoard::feed_watchdog() { IWatchdog.reload(); }

uint32_t ArduinoBoard::seed() const { return HAL_GetUIDw0() ^ HAL_GetUIDw1() ^ HAL_GetUIDw2(); }

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
    __HAL_RCC_PWR_CLK_ENABLE();
    enableBackupDomain();
    setBackupRegister(kBootloaderRegister, kBootloaderMagic);
  }
  NVIC_SystemReset();
}

}  // namespace echowing

extern "C" __attribute__((used)) void HardFault_Handler() { echowing::show_and_restart(); }
#endif
