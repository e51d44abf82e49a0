/*
 * The parts of an emulated STM32, for the files stm32_*.c. The register maps are those of ST's
 * reference manuals RM0008 (F103), RM0383 (F411) and RM0390 (F446), the processor's those of ARM's
 * architecture manual DDI 0403 (ARMv7-M).
 *
 * Time is kept in 1/1024 ns, so that a clock's period is exact enough to be added up for hours; a
 * tick of board.h is a nanosecond.
 */
#ifndef ECHOWING_STM32_H
#define ECHOWING_STM32_H

#include <unicorn/unicorn.h>

#include "recorders.h"

#define NEVER UINT64_MAX
#define NS(ns) ((uint64_t)(ns) << 10)
#define US(us) NS(1000ull * (us))
#define SECOND US(1000000)

enum {
  UARTS = 2,
  CHANNELS = 4, /* of the servo timer */
  WATCHED = 8,
  IRQS = 96,
  EXCEPTIONS = 16 + IRQS,
  NESTING = 16,
  PENDING_WRITES = 8,
  BUS_BUFFER = 64,
  BACKUP_REGISTERS = 20,
};

/* Exceptions of ARMv7-M that occur here. */
enum { HARD_FAULT = 3, SVCALL = 11, PENDSV = 14, SYSTICK = 15 };

/* What differs from chip to chip. */
typedef struct {
  const char* name;
  int is_f1;
  uint32_t flash_size, ram_size;
  uint32_t slot_size;            /* the two blocks that hold parameters end the flash */
  uint32_t rom_base, rom_size;   /* the boot loader */
  uint32_t info_base, unique_id; /* where ST has written the chip's number */
  uint32_t rcc, flash, gpio, gpio_ports;
  uint32_t usart[UARTS];
  uint32_t hsi_hz, lsi_hz;
  uint32_t debug_id;             /* DBGMCU's name of the chip */
  uint32_t erase_us, program_ns; /* typical, from the data sheet */
  int program_bytes;             /* what is programmed at once */
} chip_t;

typedef struct {
  inbox_t in;
  outbox_t out;
  uint64_t byte_time; /* at the rate set */
  uint64_t rx_due, tx_due;
  uint32_t sr, rdr, tdr, shift, brr, cr1, cr2, cr3, gtpr;
  int sending, waiting; /* a byte in the shift register, one more in TDR */
  uint64_t overruns;
} usart_t;

typedef enum { I2C_IDLE, I2C_START, I2C_ADDRESS, I2C_SEND, I2C_RECEIVE } i2c_step_t;

typedef struct {
  board_write_fn write;
  board_read_fn read;
  void* context;
  uint32_t cr1, cr2, oar1, oar2, sr1, sr2, ccr, trise;
  i2c_step_t step; /* what is on the wires, until `due` */
  uint64_t due;
  uint8_t dr, shift, address;
  int shift_full, stop_wanted, last_byte, reading, written, dr_waiting;
  uint8_t out[BUS_BUFFER], in[BUS_BUFFER];
  int out_count, in_count, in_next;
  int held_clocks; /* something holds the data line until so many clocks have been made by hand */
  int hand_clock, hand_data;
  char port;
  int data_pin, clock_pin;
} i2c_t;

typedef struct {
  uint32_t cr1, ccmr[2], ccer, psc, arr, ccr[CHANNELS], sr, dier, egr, cr2, smcr;
  uint32_t psc_now, arr_now, ccr_now[CHANNELS]; /* behind the preload registers */
  uint64_t frame;                               /* when the counter was 0 */
  uint64_t due;
  uint64_t count_stopped;
} servo_timer_t;

typedef struct {
  int running;
  uint32_t pr, rlr, kr;
  uint64_t since; /* when it stood at `count` */
  uint32_t count;
} iwdg_t;

typedef struct {
  uint32_t acr, cr, sr, optcr, ar;
  int key_step;
  uint64_t busy_until;            /* the processor stands still until then */
  uint32_t erasing, erasing_size; /* offset in flash */
  uint8_t old[4];
  uint32_t burning, burning_size;
  struct {
    uint32_t offset, size, value;
  } pending[PENDING_WRITES]; /* stores to flash of the block of code that just ran */
  int pending_count;
} flash_t;

typedef struct {
  uint32_t moder, otyper, ospeedr, pupdr, odr, afr[2], crl, crh, lckr;
} gpio_t;

typedef struct {
  uint32_t enabled[IRQS / 32], pended[IRQS / 32], lines[IRQS / 32];
  uint8_t priority[EXCEPTIONS];
  uint32_t vtor, shcsr, ccr, cpacr, demcr, dwt_ctrl, aircr;
  uint64_t cycles_zero;
  uint32_t tick_ctrl, tick_load;
  uint64_t tick_start; /* when the counter was last loaded */
  int tick_pending, pendsv_pending;
  int active[NESTING], frame_size[NESTING], depth;
} nvic_t;

typedef struct {
  pin_record_t record;
  char port;
  int bit;
} watched_t;

struct board {
  const chip_t* chip;
  uint32_t crystal_hz;
  int crystal_broken;
  uint32_t erase_us;
  uc_engine* uc;
  uc_hook hooks[4];
  uint8_t* image; /* the flash, as the processor sees it */
  uint64_t now, limit;
  uint64_t byte_cost;     /* time of a byte of code */
  uint32_t slowness;      /* so many times slower than the chip */
  int interrupt_may_wait; /* one is pending that the program has masked */
  int exception_return, halted, fault_taken, reset_wanted, locked_up;

  nvic_t nvic;
  usart_t usarts[UARTS];
  i2c_t i2c;
  servo_timer_t timer;
  iwdg_t iwdg;
  flash_t flash;
  gpio_t gpio[8];
  uint32_t rcc[0x100 / 4], pwr[2], backup[BACKUP_REGISTERS], syscfg[0x40 / 4];
  uint32_t plain[0x80000 / 4], usb[0x40000 / 4]; /* devices that keep what is written, no more */
  watched_t watched[WATCHED];
  int watched_count;

  uint32_t reset_flags; /* of RCC's CSR */
  char rom_complaint[200];
  int in_rom;
  uint64_t turn_start, reloads; /* reloads of the watchdog since the program started */
  board_meters_t meters;
  uint32_t stack_floor, stack_top;
  char fault[200];
};

/* ---- the processor: stm32_core.c */
int core_create(board_t* board, char* error, size_t error_size);
void core_reset(board_t* board);
void core_run(board_t* board); /* until board->limit, or something wants attention */
int core_take_exception(board_t* board);
void core_attend(board_t* board); /* leave the running block of code soon */
/* An event was set to `due`: make sure that the processor does not run past it. */
void core_schedule(board_t* board, uint64_t due);
uint64_t core_due(const board_t* board);
void core_step_tick(board_t* board);
void core_set_line(board_t* board, int irq, int level);
uint32_t core_read(board_t* board, uint32_t offset);
void core_write(board_t* board, uint32_t offset, uint32_t value, uint32_t mask);
uint32_t core_register(const board_t* board, int reg);

/* ---- clocks: stm32_rcc.c */
void rcc_reset(board_t* board);
uint32_t rcc_read(board_t* board, uint32_t offset);
void rcc_write(board_t* board, uint32_t offset, uint32_t value);
uint32_t rcc_core_hz(const board_t* board);
uint32_t rcc_apb_hz(const board_t* board, int bus);   /* bus 1 or 2 */
uint32_t rcc_timer_hz(const board_t* board, int bus); /* timers run faster than a divided bus */
int rcc_is_clocked(const board_t* board, uint32_t address);

/* ---- pins and the servo timer: stm32_pins.c */
uint32_t gpio_read(board_t* board, int port, uint32_t offset);
void gpio_write(board_t* board, int port, uint32_t offset, uint32_t value);
void gpio_reset(board_t* board);
void gpio_renew(board_t* board); /* levels of the pins that somebody looks at */
int gpio_is_alternate(const board_t* board, char port, int bit, int function);
void timer_reset(board_t* board);
uint32_t timer_read(board_t* board, uint32_t offset);
void timer_write(board_t* board, uint32_t offset, uint32_t value);
uint64_t timer_due(const board_t* board);
void timer_step(board_t* board);
int timer_output(const board_t* board, int channel);

/* ---- serial ports: stm32_usart.c */
void usart_reset(board_t* board, int index);
uint32_t usart_read(board_t* board, int index, uint32_t offset);
void usart_write(board_t* board, int index, uint32_t offset, uint32_t value);
uint64_t usart_due(const board_t* board, int index);
void usart_step(board_t* board, int index);

/* ---- the two-wire bus: stm32_i2c.c */
void i2c_reset(board_t* board);
uint32_t i2c_read(board_t* board, uint32_t offset);
void i2c_write(board_t* board, uint32_t offset, uint32_t value);
uint64_t i2c_due(const board_t* board);
void i2c_step(board_t* board);
void i2c_lines(board_t* board, int data, int clock); /* driven by hand */

/* ---- flash and watchdog: stm32_memory.c */
void flash_reset(board_t* board);
uint32_t flash_read(board_t* board, uint32_t offset);
void flash_write(board_t* board, uint32_t offset, uint32_t value);
void flash_store(board_t* board, uint32_t offset, uint32_t size, uint32_t value);
void flash_apply(board_t* board); /* the stores of the code that just ran */
void flash_step(board_t* board);
uint32_t iwdg_read(board_t* board, uint32_t offset);
void iwdg_write(board_t* board, uint32_t offset, uint32_t value);
uint64_t iwdg_due(const board_t* board);

/* ---- the board: stm32_board.c */
void board_complain(board_t* board, const char* format, ...);
void board_enter_rom(board_t* board);
void board_count_turn(board_t* board);

#endif
