// The calls of stm32duino (core 2.12.0) that the board layer makes, declared: enough to see that it
// compiles where the core itself cannot be had. Only the timer does something (pwm_pins.h).
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define HIGH 0x1
#define LOW 0x0
#define INPUT_PULLUP 0x2
#define OUTPUT 0x1

// Digital pin numbers, all different, as the variants have them.
enum : uint8_t {
  PA2 = 2,
  PA3,
  PA5 = 5,
  PA6,
  PA7,
  PA9 = 9,
  PA10,
  PB6 = 22,
  PB7,
  PB8,
  PB9,
  PC13 = 45
};

uint32_t micros();
void pinMode(uint32_t pin, uint32_t mode);
void digitalWrite(uint32_t pin, uint32_t level);

class Stream {
 public:
  virtual ~Stream() = default;
  virtual int available() = 0;
  virtual int read() = 0;
  virtual int availableForWrite();
  virtual size_t write(uint8_t byte) = 0;
  virtual size_t write(const uint8_t* bytes, size_t count);
};

class HardwareSerial : public Stream {
 public:
  HardwareSerial(uint32_t rx, uint32_t tx);
  void begin(unsigned long baud);
  int available() override;
  int read() override;
  int availableForWrite() override;
  size_t write(uint8_t byte) override;
  size_t write(const uint8_t* bytes, size_t count) override;
};

class USBSerial : public Stream {
 public:
  void begin(uint32_t baud);
  int available() override;
  int read() override;
  int availableForWrite() override;
  size_t write(uint8_t byte) override;
  size_t write(const uint8_t* bytes, size_t count) override;
};

#if defined(USBD_USE_CDC)
extern USBSerial Serial;
#else
extern HardwareSerial Serial;
#endif

// Names of a pin's functions: a port in the high digit, a pin in the low one, and which of several.
#define ALT1 0x100
#define ALT2 0x200
#define ALT3 0x300
enum PinName : uint32_t {
  PA_6 = 0x06,
  PA_6_ALT1 = PA_6 | ALT1,
  PA_7 = 0x07,
  PA_7_ALT1 = PA_7 | ALT1,
  PA_7_ALT2 = PA_7 | ALT2,
  PA_7_ALT3 = PA_7 | ALT3,
};

// Timers.
struct TIM_TypeDef {
  uint8_t number;
};
extern TIM_TypeDef* const TIM1;
extern TIM_TypeDef* const TIM3;
enum TimerModes_t { TIMER_OUTPUT_COMPARE_PWM1 };
enum TimerFormat_t { MICROSEC_FORMAT };
enum TimerCompareFormat_t { MICROSEC_COMPARE_FORMAT };
class HardwareTimer {
 public:
  explicit HardwareTimer(TIM_TypeDef* instance) : instance_(instance) {}
  // With a pin by its Arduino number it is the pin's first function that counts.
  void setMode(uint32_t channel, TimerModes_t mode, uint32_t pin);
  void setMode(uint32_t channel, TimerModes_t mode, PinName pin);
  void setOverflow(uint32_t value, TimerFormat_t format);
  void setCaptureCompare(uint32_t channel, uint32_t compare, TimerCompareFormat_t format);
  void resume();

 private:
  TIM_TypeDef* instance_;
};

// What stm32duino includes of ST's HAL and of CMSIS.
enum HAL_StatusTypeDef { HAL_OK, HAL_ERROR };
#define FLASH_TYPEPROGRAM_WORD 0x2u
#if defined(STM32F1xx)
#define FLASH_TYPEERASE_PAGES 0x0u
struct FLASH_EraseInitTypeDef {
  uint32_t TypeErase, Banks, PageAddress, NbPages;
};
HAL_StatusTypeDef HAL_FLASH_Program(uint32_t type, uint32_t address, uint64_t data);
#else
#define FLASH_TYPEERASE_SECTORS 0x0u
#define FLASH_SECTOR_6 6u
#define FLASH_SECTOR_7 7u
#define FLASH_VOLTAGE_RANGE_3 0x2u
struct FLASH_EraseInitTypeDef {
  uint32_t TypeErase, Banks, Sector, NbSectors, VoltageRange;
};
HAL_StatusTypeDef HAL_FLASH_Program(uint32_t type, uint32_t address, uint64_t data);
#endif
void __HAL_RCC_SYSCFG_CLK_ENABLE();
void __HAL_SYSCFG_REMAPMEMORY_SYSTEMFLASH();
HAL_StatusTypeDef HAL_FLASH_Unlock();
HAL_StatusTypeDef HAL_FLASH_Lock();
HAL_StatusTypeDef HAL_FLASHEx_Erase(FLASH_EraseInitTypeDef* order, uint32_t* failed);
#define RCC_FLAG_PINRST 0x7au
#define RCC_FLAG_PORRST 0x7bu
#define RCC_FLAG_SFTRST 0x7cu
#define RCC_FLAG_IWDGRST 0x7du
#if defined(STM32F4xx)
#define RCC_FLAG_BORRST 0x79u
#endif
bool __HAL_RCC_GET_FLAG(uint32_t flag);
void __HAL_RCC_CLEAR_RESET_FLAGS();
uint32_t HAL_GetUIDw0();
uint32_t HAL_GetUIDw1();
uint32_t HAL_GetUIDw2();
void __HAL_RCC_PWR_CLK_ENABLE();
#define FLASH_BASE 0x08000000u
#define SysTick_CTRL_ENABLE_Msk 0x1u
#define SysTick_CTRL_CLKSOURCE_Msk 0x4u
#define SysTick_CTRL_COUNTFLAG_Msk 0x10000u
struct SysTick_Type {
  volatile uint32_t CTRL, LOAD, VAL;
};
extern SysTick_Type* const SysTick;
struct SCB_Type {
  volatile uint32_t VTOR;
};
extern SCB_Type* const SCB;
extern uint32_t SystemCoreClock;
void __set_MSP(uint32_t stack);
[[noreturn]] void NVIC_SystemReset();
