/* Does one thing a letter, so that tests can see whether the emulated STM32 is one. No library and
 * no vendor's code: what it proves does not hang on them. */
#include "chip.h"

/* The board's pins are given to the compiler: LED_PORT, LED_BIT, and SCL and SDA on port B. */

enum {
  SONAR = 0x70,
  TXE = 1u << 7,
  RXNE = 1u << 5,
  WATCHDOG_MS = 120,
  SB = 1u << 0,
  ADDR = 1u << 1,
  BTF = 1u << 2,
  I2C_RXNE = 1u << 6,
  AF = 1u << 10,
  START = 1u << 8,
  STOP = 1u << 9,
  ACK = 1u << 10,
  PATIENCE_MS = 5,
  BOOT_MAGIC = 0xb007,
  RING = 64,
};

static volatile uint32_t milliseconds;
static volatile uint8_t ring[RING];
static volatile uint8_t ring_in, ring_out;
static volatile uint32_t ticks_in_handler;

/* ---- serial ports */

static void send(char letter) {
  while (!(USART_SR(USART1) & TXE)) {
  }
  USART_DR(USART1) = (uint8_t)letter;
}

static void say(const char* text) {
  while (*text) send(*text++);
}

static void say_number(uint32_t number) {
  if (number >= 10) say_number(number / 10);
  send((char)('0' + number % 10));
}

static void say_line(uint32_t number) {
  say_number(number);
  say("\r\n");
}

void usart1_handler(void) {
  uint8_t byte = (uint8_t)USART_DR(USART1);
  ring[ring_in] = byte;
  ring_in = (ring_in + 1) % RING;
}

static void open_port(uint32_t base, uint32_t baud, uint32_t interrupt) {
  USART_BRR(base) = (HSI_HZ + baud / 2) / baud;
  USART_CR1(base) = 1u << 13 | 1u << 3 | 1u << 2 | interrupt;
}

/* ---- time */

void systick_handler(void) { milliseconds++; }

/* Of lower priority than the tick, which goes on meanwhile. */
void spare_handler(void) {
  uint32_t begun = milliseconds;
  while (milliseconds - begun < 3) {
  }
  ticks_in_handler = milliseconds - begun;
}

static void wait_ms(uint32_t span) {
  for (uint32_t begun = milliseconds; milliseconds - begun < span;) {
  }
}

/* ---- bus */

static int wait_flag(uint32_t flag) {
  for (uint32_t begun = milliseconds; milliseconds - begun < PATIENCE_MS;) {
    uint32_t status = I2C_SR1;
    if (status & flag) return 1;
    if (status & AF) return 0;
  }
  return 0;
}

static void end_transfer(void) {
  I2C_CR1 |= STOP;
  I2C_SR1 = 0;
}

static void begin_bus(void) {
  set_pin('B', SCL, BUS_PIN);
  set_pin('B', SDA, BUS_PIN);
  I2C_CR1 = 1u << 15;
  I2C_CR1 = 0;
  I2C_CR2 = HSI_HZ / 1000000;
  I2C_CCR = HSI_HZ / 200000; /* 100 kHz */
  I2C_TRISE = HSI_HZ / 1000000 + 1;
  I2C_CR1 = 1;
}

static int address_sonar(int read) {
  I2C_CR1 |= START;
  if (!wait_flag(SB)) return 0;
  I2C_DR = SONAR << 1 | read;
  return wait_flag(ADDR);
}

/* 0 good, 1 no answer. */
static int write_sonar(uint8_t command) {
  if (!address_sonar(0)) return end_transfer(), 1;
  (void)I2C_SR2;
  I2C_DR = command;
  int sent = wait_flag(BTF);
  end_transfer();
  return !sent;
}

/* Two bytes, the last not acknowledged. */
static void read_sonar(void) {
  uint8_t bytes[2];
  I2C_CR1 |= ACK;
  if (!address_sonar(1)) {
    end_transfer();
    say("no answer\r\n");
    return;
  }
  (void)I2C_SR2;
  wait_flag(I2C_RXNE);
  I2C_CR1 = (I2C_CR1 & ~(uint32_t)ACK) | STOP;
  bytes[0] = (uint8_t)I2C_DR;
  wait_flag(I2C_RXNE);
  bytes[1] = (uint8_t)I2C_DR;
  I2C_SR1 = 0;
  say_line((uint32_t)bytes[0] << 8 | bytes[1]);
}

/* Open drain by hand: low by driving, high by letting go. */
static void line(int bit, int high) {
  write_pin('B', bit, 0);
  set_pin('B', bit, high ? INPUT_PIN : OUTPUT_PIN);
}

static void free_bus(void) {
  I2C_CR1 = 0;
  line(SCL, 1);
  line(SDA, 1);
  for (int i = 0; i < 9; ++i) {
    line(SCL, 0);
    line(SCL, 1);
  }
  line(SDA, 0);
  line(SDA, 1);
  say_line((uint32_t)read_pin('B', SDA));
  begin_bus();
}

/* ---- servo pulses, 50 Hz on PA6 and PA7 */

static void set_pulses(uint32_t pan_us, uint32_t tilt_us) {
  TIM3_CCR1 = pan_us;
  TIM3_CCR2 = tilt_us;
}

static void start_pulses(void) {
  TIM3_PSC = HSI_HZ / 1000000 - 1;
  TIM3_ARR = 20000 - 1;
  TIM3_CCMR1 = 0x6868; /* PWM mode 1, preloaded */
  TIM3_CCER = 0x11;
  set_pulses(1380, 1400);
  TIM3_EGR = 1;
  TIM3_CR1 = 1;
  set_pin('A', 6, TIMER_PIN);
  set_pin('A', 7, TIMER_PIN);
}

/* ---- flash */

static void unlock_flash(void) {
  FLASH_REG(0x04) = 0x45670123;
  FLASH_REG(0x04) = 0xcdef89ab;
}

static void wait_flash(void) {
  while (FLASH_REG(0x0c) & FLASH_BUSY) {
  }
}

static void burn(uint32_t address, uint16_t value) {
#if defined(PROBE_F103)
  FLASH_REG(0x10) = 1;
#else
  FLASH_REG(0x10) = 1 | 1u << 8;
#endif
  *(volatile uint16_t*)address = value;
  wait_flash();
}

/* Erases the first slot and burns 0x5a into its byte 8; then other ones over it. */
static void store(void) {
  unlock_flash();
  start_erase(SLOT_0);
  wait_flash();
  burn(SLOT_0 + 8, 0xff5a);
  burn(SLOT_0 + 8, 0xfff3); /* 0x5a & 0xf3: only zeros can be added */
  FLASH_REG(0x10) = FLASH_CR_LOCK;
  say_line(*(volatile uint8_t*)(SLOT_0 + 8));
}

/* ---- going wrong */

static void use_stack(void) {
  volatile uint8_t block[1000];
  for (uint32_t i = 0; i < sizeof block; ++i) block[i] = (uint8_t)i;
  say_line(block[999]);
}

static void be_deaf(void) {
  uint32_t left = HSI_HZ / 1000 / 4; /* about a millisecond */
  __asm volatile("cpsid i");
  while (left--) __asm volatile("nop");
  __asm volatile("cpsie i");
}

static void hang(void) {
  for (;;) {
  }
}

/* After a fault it says so, and the watchdog does the rest. */
void fault_handler(void) {
  say("fault\r\n");
  hang();
}

static void jump_to_rom(void) {
  const volatile uint32_t* table = (const volatile uint32_t*)ROM;
  ((void (*)(void))table[1])();
}

static void reset(void) {
  SCB_AIRCR = 0x05fa0004;
  hang();
}

static void reset_into_rom(void) {
  BACKUP_1 = BOOT_MAGIC;
  reset();
}

/* ---- */

static void obey(char letter) {
  switch (letter) {
    case 'p': set_pulses(1330, 1500); return;
    case 'r': read_sonar(); return;
    case 't': say_line((uint32_t)write_sonar(81)); return;
    case 'f': free_bus(); return;
    case 's': use_stack(); return;
    case 'e': store(); return;
    case 'l': write_pin(LED_PORT, LED_BIT, !read_pin(LED_PORT, LED_BIT)); return;
    case 'd': wait_ms(5); return;
    case 'w': hang(); return;
    case 'o': be_deaf(); return;
    case 'z': __asm volatile("udf #1"); return;
    case 'X': *(volatile uint16_t*)(SLOT_0 + 8) = 0; return;
    case 'b': jump_to_rom(); return;
    case 'B': reset_into_rom(); return;
    case 'R': reset(); return;
    case 'm': say_line(milliseconds); return;
    case 'n': say_line(REGISTER(UNIQUE_ID)); return;
    case 'q':
      say_line(RCC_CSR >> 26 & 63);
      RCC_CSR |= 1u << 24;
      return;
    case 'i':
      NVIC_ISPR(1) = 1u << (SPARE_IRQ - 32);
      while (!ticks_in_handler) {
      }
      say_line(ticks_in_handler);
      return;
    case 'g': /* a device without a clock neither takes nor gives anything */
#if defined(PROBE_F103)
      REGISTER(0x4002101c) &= ~2u;
#else
      REGISTER(0x40023840) &= ~2u;
#endif
      TIM3_ARR = 7;
      say_line(TIM3_ARR);
      return;
  }
  send(letter);
}

static void run(void) {
  start_clocks();
  if (BACKUP_1 == BOOT_MAGIC) {
    BACKUP_1 = 0;
    SCB_VTOR = ROM;
    jump_to_rom();
  }
  set_pin(LED_PORT, LED_BIT, OUTPUT_PIN);
  set_pin('A', 9, SERIAL_PIN);
  open_port(USART1, 115200, RXNE);
  open_port(USART2, 57600, 0);
  SYSTICK_LOAD = HSI_HZ / 1000 - 1;
  SYSTICK_VAL = 0;
  SYSTICK_CTRL = 7;
  NVIC_PRIORITY(USART1_IRQ) = 0x40;
  NVIC_PRIORITY(SPARE_IRQ) = 0xc0;
  NVIC_ISER(1) = 1u << (USART1_IRQ - 32) | 1u << (SPARE_IRQ - 32);
  begin_bus();
  start_pulses();
  IWDG_KR = 0x5555;
  IWDG_RLR = LSI_HZ / 4 * WATCHDOG_MS / 1000 - 1;
  IWDG_KR = 0xaaaa;
  IWDG_KR = 0xcccc;
  say("boot\r\n");
  for (;;) {
    IWDG_KR = 0xaaaa;
    if (ring_out != ring_in) {
      char letter = (char)ring[ring_out];
      ring_out = (ring_out + 1) % RING;
      obey(letter);
    }
    if (USART_SR(USART2) & RXNE) USART_DR(USART2) = USART_DR(USART2);
  }
}

/* ---- start */

extern uint32_t data_image[], data_start[], data_end[], bss_end[], stack_top[];

__attribute__((noreturn)) void start(void) {
  for (uint32_t *from = data_image, *to = data_start; to < data_end;) *to++ = *from++;
  for (uint32_t* to = data_end; to < bss_end;) *to++ = 0;
  run();
  for (;;) {
  }
}

__attribute__((section(".vectors"), used)) void* const vectors[16 + SPARE_IRQ + 1] = {
    [0] = stack_top,
    [1] = start,
    [3] = fault_handler,
    [15] = systick_handler,
    [16 + USART1_IRQ] = usart1_handler,
    [16 + SPARE_IRQ] = spare_handler,
};
