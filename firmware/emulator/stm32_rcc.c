/* The clocks of an emulated STM32: what the program has chosen, and which devices have one. */
#include <string.h>

#include "stm32.h"

enum {
  CR = 0x00,
  F4_PLLCFGR = 0x04,
  F4_CFGR = 0x08,
  F4_BDCR = 0x70,
  F4_CSR = 0x74,
  F1_CFGR = 0x04,
  F1_BDCR = 0x20,
  F1_CSR = 0x24,
  HSION = 1u << 0,
  HSEON = 1u << 16,
  PLLON = 1u << 24,
  RMVF = 1u << 24, /* in CSR: forget the causes of resets */
};

static uint32_t reg(const board_t* board, uint32_t offset) { return board->rcc[offset / 4]; }

static uint32_t configuration(const board_t* board) {
  return reg(board, board->chip->is_f1 ? F1_CFGR : F4_CFGR);
}

void rcc_reset(board_t* board) {
  const chip_t* chip = board->chip;
  uint32_t backup_domain = board->rcc[(chip->is_f1 ? F1_BDCR : F4_BDCR) / 4];
  memset(board->rcc, 0, sizeof board->rcc);
  board->rcc[CR] = HSION | 0x80;
  if (chip->is_f1) {
    board->rcc[0x14 / 4] = 0x14; /* flash and RAM are clocked */
    board->rcc[F1_BDCR / 4] = backup_domain;
  } else {
    board->rcc[F4_PLLCFGR / 4] = 0x24003010;
    board->rcc[0x30 / 4] = 0x100000;
    board->rcc[F4_BDCR / 4] = backup_domain;
  }
}

/* ---- rates */

static uint32_t f1_pll_hz(const board_t* board) {
  uint32_t set = configuration(board), factor = (set >> 18 & 15) + 2;
  uint32_t source = board->chip->hsi_hz / 2;
  if (set & 1u << 16) source = board->crystal_hz / (set & 1u << 17 ? 2 : 1);
  return source * (factor > 16 ? 16 : factor);
}

static uint32_t f4_pll_hz(const board_t* board) {
  uint32_t set = reg(board, F4_PLLCFGR), divider = set & 63;
  uint64_t source = set & 1u << 22 ? board->crystal_hz : board->chip->hsi_hz;
  if (divider == 0) return 0;
  return (uint32_t)(source * (set >> 6 & 511) / divider / (2 * (set >> 16 & 3) + 2));
}

static uint32_t system_hz(const board_t* board) {
  uint32_t hz = board->chip->hsi_hz;
  int source = configuration(board) & 3;
  if (source == 1) hz = board->crystal_hz;
  if (source == 2) hz = board->chip->is_f1 ? f1_pll_hz(board) : f4_pll_hz(board);
  return hz ? hz : board->chip->hsi_hz;
}

uint32_t rcc_core_hz(const board_t* board) {
  static const uint8_t shift[] = {1, 2, 3, 4, 6, 7, 8, 9};
  uint32_t set = configuration(board) >> 4 & 15;
  return set & 8 ? system_hz(board) >> shift[set & 7] : system_hz(board);
}

static int bus_shift(const board_t* board, int bus) {
  int place = board->chip->is_f1 ? (bus == 1 ? 8 : 11) : (bus == 1 ? 10 : 13);
  uint32_t set = configuration(board) >> place & 7;
  return set & 4 ? (int)(set & 3) + 1 : 0;
}

uint32_t rcc_apb_hz(const board_t* board, int bus) {
  return rcc_core_hz(board) >> bus_shift(board, bus);
}

uint32_t rcc_timer_hz(const board_t* board, int bus) {
  int shift = bus_shift(board, bus);
  return rcc_core_hz(board) >> (shift ? shift - 1 : 0);
}

/* ---- registers */

/* Oscillators and PLLs are ready as soon as they are on: each has its ready bit next to it. */
static uint32_t ready_bits(const board_t* board, uint32_t on) {
  uint32_t ready = 0;
  if (on & HSION) ready |= HSION << 1;
  if ((on & HSEON) && !board->crystal_broken) ready |= HSEON << 1;
  for (int pll = 0; pll < 3; pll++) {
    uint32_t bit = PLLON << 2 * pll;
    if (on & bit) ready |= bit << 1;
  }
  return ready;
}

uint32_t rcc_read(board_t* board, uint32_t offset) {
  int is_f1 = board->chip->is_f1;
  uint32_t value = reg(board, offset);
  if (offset == CR) return (value & 0x550100fd) | ready_bits(board, value);
  if (offset == (is_f1 ? F1_CFGR : F4_CFGR)) return (value & ~12u) | (value & 3) << 2;
  if (offset == (is_f1 ? F1_BDCR : F4_BDCR)) return value; /* no 32 kHz crystal: never ready */
  if (offset == (is_f1 ? F1_CSR : F4_CSR))
    return (value & 1) | (value & 1) << 1 | board->reset_flags;
  return value;
}

void rcc_write(board_t* board, uint32_t offset, uint32_t value) {
  int is_f1 = board->chip->is_f1;
  board->rcc[offset / 4] = value;
  if (offset == (is_f1 ? F1_CSR : F4_CSR) && (value & RMVF)) {
    board->reset_flags = 0;
    board->rcc[offset / 4] &= ~(uint32_t)RMVF;
  }
  core_attend(board); /* the pace of everything may have changed */
}

/* ---- clock gates */

typedef struct {
  uint32_t first, end;
  uint32_t enable; /* the register, and the bit in it */
  int bit;
} gate_t;

static const gate_t kF1Gates[] = {
    {0x40000400, 0x40000800, 0x1c, 1},
    {0x40004400, 0x40004800, 0x1c, 17},
    {0x40005400, 0x40005800, 0x1c, 21},
    {0x40006c00, 0x40007000, 0x1c, 27},
    {0x40007000, 0x40007400, 0x1c, 28},
    {0x40010000, 0x40010400, 0x18, 0},
    {0x40010800, 0x40010c00, 0x18, 2},
    {0x40010c00, 0x40011000, 0x18, 3},
    {0x40011000, 0x40011400, 0x18, 4},
    {0x40013800, 0x40013c00, 0x18, 14},
    {0},
};
static const gate_t kF4Gates[] = {
    {0x40000400, 0x40000800, 0x40, 1},  {0x40004400, 0x40004800, 0x40, 17},
    {0x40005400, 0x40005800, 0x40, 21}, {0x40007000, 0x40007400, 0x40, 28},
    {0x40011000, 0x40011400, 0x44, 4},  {0x40013800, 0x40013c00, 0x44, 14},
    {0x40020000, 0x40020400, 0x30, 0},  {0x40020400, 0x40020800, 0x30, 1},
    {0x40020800, 0x40020c00, 0x30, 2},  {0},
};

int rcc_is_clocked(const board_t* board, uint32_t address) {
  for (const gate_t* gate = board->chip->is_f1 ? kF1Gates : kF4Gates; gate->end; gate++) {
    if (address >= gate->first && address < gate->end)
      return reg(board, gate->enable) >> gate->bit & 1;
  }
  return 1;
}
