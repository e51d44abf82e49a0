/*
 * The two-wire bus of an emulated STM32: I2C1 as a master (reference manual RM0383, 18.3.3), and
 * the device that is asked. F1 and F4 have the same one.
 */
#include <string.h>

#include "stm32.h"

enum { /* SR1 */
       SB = 1u << 0,
       ADDR = 1u << 1,
       BTF = 1u << 2,
       RXNE = 1u << 6,
       TXE = 1u << 7,
       AF = 1u << 10,
       ERRORS = 0xdf00,
};
enum { MASTER = 1u << 0, BUSY = 1u << 1, SENDING = 1u << 2 }; /* SR2 */
enum {                                                        /* CR1, CR2 */
       ENABLE = 1u << 0,
       START = 1u << 8,
       STOP = 1u << 9,
       ACK = 1u << 10,
       POS = 1u << 11,
       SOFT_RESET = 1u << 15,
       ERROR_INTERRUPT = 1u << 8,
       EVENT_INTERRUPT = 1u << 9,
       BUFFER_INTERRUPT = 1u << 10,
};
enum {
  EVENT_IRQ = 31,
  ERROR_IRQ = 32,
  BITS_A_BYTE = 9, /* eight and the acknowledgement */
  READ_AHEAD = 2,  /* the sonar's answer: two bytes (PD11848) */
  RELEASED = 0xff, /* what is read where nobody drives the line */
};

static void renew_lines(board_t* board) {
  const i2c_t* i2c = &board->i2c;
  uint32_t events = i2c->sr1 & (SB | ADDR | BTF);
  if (i2c->cr2 & BUFFER_INTERRUPT) events |= i2c->sr1 & (RXNE | TXE);
  core_set_line(board, EVENT_IRQ, events && (i2c->cr2 & EVENT_INTERRUPT));
  core_set_line(board, ERROR_IRQ, (i2c->sr1 & ERRORS) && (i2c->cr2 & ERROR_INTERRUPT));
}

static uint64_t bit_time(const board_t* board) {
  const i2c_t* i2c = &board->i2c;
  uint32_t fast = i2c->ccr & 1u << 15, parts = fast ? (i2c->ccr & 1u << 14 ? 25 : 3) : 2;
  uint32_t clock = i2c->ccr & 0xfff;
  return (uint64_t)parts * (clock ? clock : 1) * SECOND / rcc_apb_hz(board, 1);
}

static void begin(board_t* board, i2c_step_t step, int bits) {
  board->i2c.step = step;
  board->i2c.due = board->now + bits * bit_time(board);
  core_schedule(board, board->i2c.due);
}

/* Everything but the device and what holds the line. */
static void forget(i2c_t* i2c) {
  i2c->sr1 = i2c->sr2 = 0;
  i2c->step = I2C_IDLE;
  i2c->due = NEVER;
  i2c->shift_full = i2c->stop_wanted = i2c->last_byte = i2c->dr_waiting = 0;
  i2c->out_count = i2c->in_count = i2c->in_next = i2c->written = 0;
}

void i2c_reset(board_t* board) {
  i2c_t* i2c = &board->i2c;
  i2c->cr1 = i2c->cr2 = i2c->ccr = i2c->oar1 = i2c->oar2 = 0;
  i2c->trise = 2;
  forget(i2c);
  renew_lines(board);
}

uint64_t i2c_due(const board_t* board) { return board->i2c.due; }

/* ---- the transfer */

/* A STOP or a repeated START ends what went before: now the device gets what was written. */
static void finish_write(board_t* board) {
  i2c_t* i2c = &board->i2c;
  if (i2c->written && i2c->out_count && i2c->write)
    i2c->write(i2c->context, board->now >> 10, i2c->address >> 1, i2c->out, i2c->out_count);
  i2c->written = i2c->out_count = 0;
}

static void stop(board_t* board) {
  i2c_t* i2c = &board->i2c;
  finish_write(board);
  i2c->sr2 = 0;
  i2c->sr1 &= ~(uint32_t)(SB | ADDR | TXE | (i2c->reading ? 0 : BTF));
  i2c->stop_wanted = 0;
  i2c->step = I2C_IDLE;
  i2c->due = NEVER;
}

static int acknowledged(board_t* board) {
  i2c_t* i2c = &board->i2c;
  uint64_t tick = board->now >> 10;
  uint8_t device = i2c->address >> 1;
  i2c->reading = i2c->address & 1;
  i2c->in_next = i2c->out_count = 0;
  if (!i2c->write || !i2c->read) return 0;
  if (i2c->reading) {
    i2c->in_count = i2c->read(i2c->context, tick, device, i2c->in, READ_AHEAD);
    return i2c->in_count >= 0;
  }
  i2c->written = i2c->write(i2c->context, tick, device, NULL, 0);
  return i2c->written;
}

static void end_address(board_t* board) {
  i2c_t* i2c = &board->i2c;
  i2c->step = I2C_IDLE;
  i2c->due = NEVER;
  if (!acknowledged(board)) {
    i2c->sr1 |= AF;
    return;
  }
  i2c->sr1 |= ADDR;
  if (!i2c->reading) i2c->sr2 |= SENDING;
}

static void end_sent_byte(board_t* board) {
  i2c_t* i2c = &board->i2c;
  if (i2c->out_count < BUS_BUFFER) i2c->out[i2c->out_count++] = i2c->shift;
  i2c->step = I2C_IDLE;
  i2c->due = NEVER;
  if (i2c->dr_waiting) {
    i2c->dr_waiting = 0;
    i2c->shift = i2c->dr;
    i2c->sr1 |= TXE;
    begin(board, I2C_SEND, BITS_A_BYTE);
  } else {
    i2c->sr1 |= TXE | BTF;
  }
}

/* With POS it is the byte after the next that is not acknowledged any more. */
static int goes_on(i2c_t* i2c) {
  if (i2c->cr1 & ACK) return 1;
  if ((i2c->cr1 & POS) && !i2c->last_byte) {
    i2c->last_byte = 1;
    return 1;
  }
  return 0;
}

static void end_received_byte(board_t* board) {
  i2c_t* i2c = &board->i2c;
  uint8_t byte = i2c->in_next < i2c->in_count ? i2c->in[i2c->in_next] : RELEASED;
  i2c->in_next++;
  int more = goes_on(i2c);
  i2c->step = I2C_IDLE;
  i2c->due = NEVER;
  if (i2c->sr1 & RXNE) { /* nobody has taken the last one: the clock is held */
    i2c->shift = byte;
    i2c->shift_full = 1;
    i2c->sr1 |= BTF;
  } else {
    i2c->dr = byte;
    i2c->sr1 |= RXNE;
  }
  if (i2c->stop_wanted)
    stop(board);
  else if (more && !i2c->shift_full)
    begin(board, I2C_RECEIVE, BITS_A_BYTE);
}

void i2c_step(board_t* board) {
  i2c_t* i2c = &board->i2c;
  if (i2c->due > board->now) return;
  switch (i2c->step) {
    case I2C_START:
      finish_write(board);
      i2c->step = I2C_IDLE;
      i2c->due = NEVER;
      i2c->sr1 |= SB;
      i2c->sr2 |= MASTER | BUSY;
      i2c->cr1 &= ~(uint32_t)START;
      break;
    case I2C_ADDRESS: end_address(board); break;
    case I2C_SEND: end_sent_byte(board); break;
    case I2C_RECEIVE: end_received_byte(board); break;
    default: i2c->due = NEVER;
  }
  renew_lines(board);
}

/* ---- registers */

static uint32_t take_data(board_t* board) {
  i2c_t* i2c = &board->i2c;
  uint8_t byte = i2c->dr;
  if (!(i2c->sr1 & RXNE)) return byte;
  i2c->sr1 &= ~(uint32_t)(RXNE | BTF);
  if (i2c->shift_full) {
    i2c->dr = i2c->shift;
    i2c->shift_full = 0;
    i2c->sr1 |= RXNE;
    if ((i2c->sr2 & MASTER) && (i2c->cr1 & ACK)) begin(board, I2C_RECEIVE, BITS_A_BYTE);
  }
  return byte;
}

static uint32_t read_second_status(board_t* board) {
  i2c_t* i2c = &board->i2c;
  uint32_t status = i2c->sr2 | (i2c->held_clocks ? BUSY : 0);
  if (i2c->sr1 & ADDR) {
    i2c->sr1 &= ~(uint32_t)ADDR;
    i2c->last_byte = 0;
    if (i2c->reading)
      begin(board, I2C_RECEIVE, BITS_A_BYTE);
    else
      i2c->sr1 |= TXE;
  }
  return status;
}

uint32_t i2c_read(board_t* board, uint32_t offset) {
  i2c_t* i2c = &board->i2c;
  uint32_t value = 0;
  switch (offset) {
    case 0x00: return i2c->cr1;
    case 0x04: return i2c->cr2;
    case 0x08: return i2c->oar1;
    case 0x0c: return i2c->oar2;
    case 0x10: value = take_data(board); break;
    case 0x14: return i2c->sr1;
    case 0x18: value = read_second_status(board); break;
    case 0x1c: return i2c->ccr;
    case 0x20: return i2c->trise;
  }
  renew_lines(board);
  return value;
}

static void write_data(board_t* board, uint8_t byte) {
  i2c_t* i2c = &board->i2c;
  if (i2c->sr1 & SB) {
    i2c->sr1 &= ~(uint32_t)SB;
    i2c->address = byte;
    begin(board, I2C_ADDRESS, BITS_A_BYTE);
    return;
  }
  if (!(i2c->sr2 & SENDING)) return;
  i2c->sr1 &= ~(uint32_t)BTF;
  if (i2c->step == I2C_SEND) {
    i2c->dr = byte;
    i2c->dr_waiting = 1;
    i2c->sr1 &= ~(uint32_t)TXE;
  } else {
    i2c->shift = byte;
    begin(board, I2C_SEND, BITS_A_BYTE);
  }
}

static void write_control(board_t* board, uint32_t value) {
  i2c_t* i2c = &board->i2c;
  if (value & SOFT_RESET) {
    i2c_reset(board);
    i2c->cr1 = SOFT_RESET;
    return;
  }
  i2c->cr1 = value & ~(uint32_t)STOP;
  if (!(value & ENABLE)) {
    forget(i2c);
    i2c->cr1 &= ~(uint32_t)START;
    return;
  }
  if (value & STOP) {
    if (i2c->step == I2C_RECEIVE)
      i2c->stop_wanted = 1; /* when the byte is in */
    else
      stop(board);
  }
  if ((value & START) && !i2c->held_clocks && i2c->step != I2C_START) {
    i2c->sr1 &= ~(uint32_t)(TXE | BTF);
    begin(board, I2C_START, 1);
  }
}

void i2c_write(board_t* board, uint32_t offset, uint32_t value) {
  i2c_t* i2c = &board->i2c;
  switch (offset) {
    case 0x00: write_control(board, value); break;
    case 0x04: i2c->cr2 = value; break;
    case 0x08: i2c->oar1 = value; break;
    case 0x0c: i2c->oar2 = value; break;
    case 0x10: write_data(board, (uint8_t)value); break;
    case 0x14: i2c->sr1 &= value | ~(uint32_t)ERRORS; break;
    case 0x1c: i2c->ccr = value; break;
    case 0x20: i2c->trise = value; break;
  }
  renew_lines(board);
}

/* ---- the lines by hand */

void i2c_lines(board_t* board, int data, int clock) {
  i2c_t* i2c = &board->i2c;
  int clock_rises = clock && !i2c->hand_clock, data_rises = data && !i2c->hand_data;
  i2c->hand_clock = clock;
  i2c->hand_data = data;
  if (clock_rises) {
    board->meters.bus_clocks++;
    if (i2c->held_clocks) i2c->held_clocks--;
  } else if (data_rises && clock) {
    board->meters.bus_stops++;
  }
}

void board_set_bus(board_t* board, board_write_fn write, board_read_fn read, void* context) {
  board->i2c.write = write;
  board->i2c.read = read;
  board->i2c.context = context;
}

void board_hold_bus(board_t* board, char port, int data_pin, int clock_pin, int clocks) {
  i2c_t* i2c = &board->i2c;
  if (!i2c->port) i2c->hand_clock = i2c->hand_data = 1;
  i2c->port = port;
  i2c->data_pin = data_pin;
  i2c->clock_pin = clock_pin;
  i2c->held_clocks = clocks;
}
