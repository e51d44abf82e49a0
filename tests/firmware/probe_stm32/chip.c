/* What the two families do differently. */
#include "chip.h"

enum { PWR_BACKUP_OPEN = 1u << 8 };

#if defined(PROBE_F103)
void start_clocks(void) {
  REGISTER(0x40021018) = 0x0000401d; /* AFIO, ports A to C, USART1 */
  REGISTER(0x4002101c) = 0x18220002; /* TIM3, USART2, I2C1, backup registers, PWR */
  PWR_CR = PWR_BACKUP_OPEN;
}

void set_pin(char port, int bit, int use) {
  static const uint8_t modes[] = {[INPUT_PIN] = 0x4,
                                  [OUTPUT_PIN] = 0x2,
                                  [TIMER_PIN] = 0xa,
                                  [SERIAL_PIN] = 0xa,
                                  [BUS_PIN] = 0xe};
  volatile uint32_t* control = &GPIO(port, bit < 8 ? 0 : 4);
  int place = 4 * (bit % 8);
  *control = (*control & ~(15u << place)) | (uint32_t)modes[use] << place;
}

void start_erase(uint32_t address) {
  FLASH_REG(0x10) = 2; /* a page */
  FLASH_REG(0x14) = address;
  FLASH_REG(0x10) = 2 | FLASH_CR_START;
}
#else
void start_clocks(void) {
  REGISTER(0x40023830) = 7;          /* ports A to C */
  REGISTER(0x40023840) = 0x10220002; /* TIM3, USART2, I2C1, PWR */
  REGISTER(0x40023844) = 0x00004010; /* USART1, SYSCFG */
  PWR_CR = PWR_BACKUP_OPEN;
}

void set_pin(char port, int bit, int use) {
  static const uint8_t modes[] = {
      [INPUT_PIN] = 0, [OUTPUT_PIN] = 1, [TIMER_PIN] = 2, [SERIAL_PIN] = 2, [BUS_PIN] = 2};
  static const uint8_t functions[] = {[TIMER_PIN] = 2, [SERIAL_PIN] = 7, [BUS_PIN] = 4};
  volatile uint32_t* mode = &GPIO(port, 0x00);
  volatile uint32_t* function = &GPIO(port, bit < 8 ? 0x20 : 0x24);
  *mode = (*mode & ~(3u << 2 * bit)) | (uint32_t)modes[use] << 2 * bit;
  if (use >= TIMER_PIN) {
    int place = 4 * (bit % 8);
    *function = (*function & ~(15u << place)) | (uint32_t)functions[use] << place;
  }
}

void start_erase(uint32_t address) {
  uint32_t sector = 4 + (address - 0x08000000u) / 0x20000u;
  FLASH_REG(0x10) = 2 | sector << 3 | 2u << 8;
  FLASH_REG(0x10) = 2 | sector << 3 | 2u << 8 | FLASH_CR_START;
}
#endif

void write_pin(char port, int bit, int level) { GPIO_SET(port) = 1u << (level ? bit : bit + 16); }

int read_pin(char port, int bit) { return GPIO_IN(port) >> bit & 1; }
