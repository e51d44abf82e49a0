/*
 * The real AVR binary on an emulated board: libsimavr with what it lacks for our purpose.
 *
 * A board has two-wire (I2C) bus callbacks, UARTs that carry bytes at their real rate, pins whose
 * edges are recorded, an EEPROM that survives, and meters for the stack and for the turns of the
 * main loop. Time is the AVR's own cycle count; nothing here looks at a wall clock, so two runs
 * with the same input are identical.
 *
 * A test tool: simavr is GPL-3 and none of this is linked into the firmware.
 */
#ifndef ECHOWING_AVR_BOARD_H
#define ECHOWING_AVR_BOARD_H

#include <stddef.h>
#include <stdint.h>

typedef struct avr_board avr_board_t;

/* A device answers at `address` (7 bit). `write` returns 1 for acknowledged, 0 for not; count 0
 * asks whether the address would be acknowledged. `read` fills up to `count` bytes and returns how
 * many, or -1 for no acknowledgement. `cycle` is the AVR's time. */
typedef int (*board_write_fn)(void* context, uint64_t cycle, uint8_t address, const uint8_t* data,
                              int count);
typedef int (*board_read_fn)(void* context, uint64_t cycle, uint8_t address, uint8_t* data,
                             int count);

typedef struct {
  uint64_t rise_cycle;   /* newest rising edge */
  uint64_t width_cycles; /* newest complete high pulse */
  uint64_t period_cycles;
  uint64_t pulses;
  int level;
} board_pin_t;

typedef struct {
  uint64_t cycle;
  uint8_t level;
} board_edge_t;

typedef struct {
  uint64_t turns;          /* main loop turns seen (one watchdog reset each) */
  uint64_t longest_cycles; /* longest of them */
  uint64_t restarts;       /* resets after power-on, by the watchdog */
  uint32_t stack_headroom; /* bytes between static memory and the lowest stack ever */
  uint32_t static_bytes;   /* .data + .bss */
  uint32_t bus_clocks;     /* clock edges made by hand on the two-wire bus (bus recovery) */
  uint32_t bus_stops;      /* STOP conditions made by hand */
} board_meters_t;

/* Power on `elf` on a chip simavr knows by name. NULL on failure, `error` then says why. */
avr_board_t* board_power_on(const char* elf, const char* mcu, uint32_t hz, char* error,
                            size_t error_size);
void board_power_off(avr_board_t* board);

/* Run until at least `cycle`; 0 while alive, 1 when the firmware stopped or crashed (see
 * board_fault). */
int board_run_until(avr_board_t* board, uint64_t cycle);
uint64_t board_cycle(const avr_board_t* board);
const char* board_fault(const avr_board_t* board);

void board_set_bus(avr_board_t* board, board_write_fn write, board_read_fn read, void* context);
/* Something holds the data line low, as a slave reset in mid-byte does: no START succeeds until the
 * firmware has made `clocks` clock edges by hand on the two pins. 0 frees the bus. */
void board_hold_bus(avr_board_t* board, char port, int data_pin, int clock_pin, int clocks);

int board_feed(avr_board_t* board, char uart, const uint8_t* data, size_t count);
/* Take up to `size` bytes the firmware has sent; `cycles` (may be NULL) gets the end of each one's
 * stop bit. */
size_t board_take(avr_board_t* board, char uart, uint8_t* data, uint64_t* cycles, size_t size);
uint64_t board_uart_overruns(const avr_board_t* board, char uart);
uint32_t board_uart_byte_cycles(const avr_board_t* board, char uart);

/* Record edges of a pin; returns its index or -1. */
int board_watch_pin(avr_board_t* board, char port, int bit);
void board_read_pin(const avr_board_t* board, int pin, board_pin_t* out);
size_t board_take_edges(avr_board_t* board, int pin, board_edge_t* out, size_t size);

/* Voltage on an analogue input, from now on. */
void board_set_analog(avr_board_t* board, int channel, uint32_t millivolts);

/* The whole EEPROM; `get` shows what a power cut at this instant would leave: a byte being written
 * is lost. */
uint32_t board_eeprom_size(const avr_board_t* board);
int board_eeprom_set(avr_board_t* board, const uint8_t* data, size_t size);
int board_eeprom_get(const avr_board_t* board, uint8_t* data, size_t size);

void board_read_meters(const avr_board_t* board, board_meters_t* out);
void board_clear_meters(avr_board_t* board);

#endif
