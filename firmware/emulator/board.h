/*
 * An emulated board that runs the real binary: what Python sees of it, whichever chip is on it.
 *
 * A board has two-wire (I2C) bus callbacks, serial ports that carry bytes at their real rate, pins
 * whose edges are recorded, memory that survives, and meters for the stack and for the turns of the
 * main loop. Time is the emulated one, in ticks; nothing here looks at a wall clock, so two runs
 * with the same input are identical.
 *
 * avr_board.c does it with simavr, stm32_board.c with unicorn; each makes a library of its own.
 * Test tools: nothing of this is linked into the firmware.
 */
#ifndef ECHOWING_BOARD_H
#define ECHOWING_BOARD_H

#include <stddef.h>
#include <stdint.h>

/* The library shows these functions and no others: the emulators have names of their own inside. */
#pragma GCC visibility push(default)

typedef struct board board_t;

/* A device answers at `address` (7 bit). `write` returns 1 for acknowledged, 0 for not; count 0
 * asks whether the address would be acknowledged. `read` fills up to `count` bytes and returns how
 * many, or -1 for no acknowledgement. `tick` is the board's time. */
typedef int (*board_write_fn)(void* context, uint64_t tick, uint8_t address, const uint8_t* data,
                              int count);
typedef int (*board_read_fn)(void* context, uint64_t tick, uint8_t address, uint8_t* data,
                             int count);

typedef struct {
  uint64_t rise_tick;   /* newest rising edge */
  uint64_t width_ticks; /* newest complete high pulse */
  uint64_t period_ticks;
  uint64_t pulses;
  int level;
} board_pin_t;

typedef struct {
  uint64_t tick;
  uint8_t level;
} board_edge_t;

typedef struct {
  uint64_t turns;          /* main loop turns seen (one watchdog reset each) */
  uint64_t longest_ticks;  /* longest of them */
  uint64_t restarts;       /* resets after power-on */
  uint32_t stack_headroom; /* bytes between static memory (and heap) and the lowest stack ever */
  uint32_t static_bytes;   /* .data + .bss */
  uint32_t bus_clocks;     /* clock edges made by hand on the two-wire bus (bus recovery) */
  uint32_t bus_stops;      /* STOP conditions made by hand */
} board_meters_t;

/* Power on `elf` on a chip known by name, with a clock or crystal of `hz`. NULL on failure, `error`
 * then says why. */
board_t* board_power_on(const char* elf, const char* chip, uint32_t hz, char* error,
                        size_t error_size);
void board_power_off(board_t* board);
uint32_t board_ticks_per_us(const board_t* board);

/* Run until at least `tick`; 0 while alive, 1 when the firmware stopped or crashed (see
 * board_fault). */
int board_run_until(board_t* board, uint64_t tick);
uint64_t board_tick(const board_t* board);
const char* board_fault(const board_t* board);

void board_set_bus(board_t* board, board_write_fn write, board_read_fn read, void* context);
/* Something holds the data line low, as a slave reset in mid-byte does: no START succeeds until the
 * firmware has made `clocks` clock edges by hand on the two pins. 0 frees the bus. */
void board_hold_bus(board_t* board, char port, int data_pin, int clock_pin, int clocks);

int board_feed(board_t* board, char uart, const uint8_t* data, size_t count);
/* Take up to `size` bytes the firmware has sent; `ticks` (may be NULL) gets the end of each one's
 * stop bit. */
size_t board_take(board_t* board, char uart, uint8_t* data, uint64_t* ticks, size_t size);
uint64_t board_uart_overruns(const board_t* board, char uart);
/* Ticks of a byte at the rate that the program has set, 0 before it has set one. */
uint32_t board_uart_byte_ticks(const board_t* board, char uart);

/* Record edges of a pin; returns its index or -1. */
int board_watch_pin(board_t* board, char port, int bit);
void board_read_pin(const board_t* board, int pin, board_pin_t* out);
size_t board_take_edges(board_t* board, int pin, board_edge_t* out, size_t size);

/* What random numbers begin with: 0 to 1023. */
void board_set_noise(board_t* board, uint32_t noise);

/* The whole of the memory that parameters are kept in; `get` shows what a power cut at this instant
 * would leave: what is being written is lost. */
uint32_t board_memory_size(const board_t* board);
int board_memory_set(board_t* board, const uint8_t* data, size_t size);
int board_memory_get(const board_t* board, uint8_t* data, size_t size);

/* Only of the STM32 boards: whether the program has jumped into the boot loader in ROM, and what
 * that would not have found there after a reset. Nothing runs then until the next power-on. */
int board_in_rom(const board_t* board, char* complaint, size_t size);
/* The watchdog's time-out as it is set now, us; 0: it does not run. */
uint32_t board_watchdog_us(const board_t* board);
/* Erasing a block of flash takes so long from now on. */
void board_set_erase_us(board_t* board, uint32_t us);
/* The crystal never starts again. */
void board_break_crystal(board_t* board);
/* The processor is so many times slower than the chip; everything else keeps its time. */
void board_set_slowness(board_t* board, uint32_t times);

void board_read_meters(const board_t* board, board_meters_t* out);
void board_clear_meters(board_t* board);

#pragma GCC visibility pop

#endif
