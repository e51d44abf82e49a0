/* Registers of the STM32F103 (reference manual RM0008) and of the F411 and F446 (RM0383, RM0390),
 * as far as the probe uses them. Where the chips agree there is one name. */
#ifndef PROBE_CHIP_H
#define PROBE_CHIP_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t*)(address))

/* The same on both. */
#define SYSTICK_CTRL REGISTER(0xe000e010)
#define SYSTICK_LOAD REGISTER(0xe000e014)
#define SYSTICK_VAL REGISTER(0xe000e018)
#define NVIC_ISER(n) REGISTER(0xe000e100 + 4 * (n))
#define NVIC_ISPR(n) REGISTER(0xe000e200 + 4 * (n))
#define NVIC_PRIORITY(irq) (*(volatile uint8_t*)(0xe000e400 + (irq)))
#define SCB_VTOR REGISTER(0xe000ed08)
#define SCB_AIRCR REGISTER(0xe000ed0c)
#define IWDG_KR REGISTER(0x40003000)
#define IWDG_PR REGISTER(0x40003004)
#define IWDG_RLR REGISTER(0x40003008)
#define PWR_CR REGISTER(0x40007000)
#define TIM3_CR1 REGISTER(0x40000400)
#define TIM3_CCMR1 REGISTER(0x40000418)
#define TIM3_CCER REGISTER(0x40000420)
#define TIM3_EGR REGISTER(0x40000414)
#define TIM3_PSC REGISTER(0x40000428)
#define TIM3_ARR REGISTER(0x4000042c)
#define TIM3_CCR1 REGISTER(0x40000434)
#define TIM3_CCR2 REGISTER(0x40000438)
#define I2C_CR1 REGISTER(0x40005400)
#define I2C_CR2 REGISTER(0x40005404)
#define I2C_DR REGISTER(0x40005410)
#define I2C_SR1 REGISTER(0x40005414)
#define I2C_SR2 REGISTER(0x40005418)
#define I2C_CCR REGISTER(0x4000541c)
#define I2C_TRISE REGISTER(0x40005420)
#define USART_SR(base) REGISTER((base) + 0x00)
#define USART_DR(base) REGISTER((base) + 0x04)
#define USART_BRR(base) REGISTER((base) + 0x08)
#define USART_CR1(base) REGISTER((base) + 0x0c)
#define USART2 0x40004400u
#define USART1_IRQ 37
#define SPARE_IRQ 40 /* EXTI15_10: nothing is connected */

#if defined(PROBE_F103)
#define HSI_HZ 8000000u
#define LSI_HZ 40000u
#define USART1 0x40013800u
#define RCC_CSR REGISTER(0x40021024)
#define FLASH_CR_START (1u << 6)
#define FLASH_CR_LOCK (1u << 7)
#define FLASH_BUSY (1u << 0)
#define FLASH_REG(offset) REGISTER(0x40022000 + (offset))
#define GPIO(port, offset) REGISTER(0x40010800 + 0x400 * ((port) - 'A') + (offset))
#define GPIO_SET(port) GPIO(port, 0x10)
#define GPIO_IN(port) GPIO(port, 0x08)
#define BACKUP_1 REGISTER(0x40006c04)
#define ROM 0x1ffff000u
#define UNIQUE_ID 0x1ffff7e8u
#define SLOT_0 0x0800f800u
#else
#define HSI_HZ 16000000u
#define LSI_HZ 32000u
#define USART1 0x40011000u
#define RCC_CSR REGISTER(0x40023874)
#define FLASH_CR_START (1u << 16)
#define FLASH_CR_LOCK (1u << 31)
#define FLASH_BUSY (1u << 16)
#define FLASH_REG(offset) REGISTER(0x40023c00 + (offset))
#define GPIO(port, offset) REGISTER(0x40020000 + 0x400 * ((port) - 'A') + (offset))
#define GPIO_SET(port) GPIO(port, 0x18)
#define GPIO_IN(port) GPIO(port, 0x10)
#define BACKUP_1 REGISTER(0x40002854)
#define ROM 0x1fff0000u
#define UNIQUE_ID 0x1fff7a10u
#define SLOT_0 0x08040000u
#endif

enum { INPUT_PIN, OUTPUT_PIN, TIMER_PIN, SERIAL_PIN, BUS_PIN };

void start_clocks(void);
void set_pin(char port, int bit, int use);
void write_pin(char port, int bit, int level);
int read_pin(char port, int bit);
void start_erase(uint32_t address);

#endif
