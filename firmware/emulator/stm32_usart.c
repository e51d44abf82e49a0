/* A serial port of an emulated STM32: bytes come and go at the rate that the program has set. */
#include <string.h>

#include "stm32.h"

enum {
  PE = 1u << 0,
  ORE = 1u << 3,
  RXNE = 1u << 5,
  TC = 1u << 6,
  TXE = 1u << 7,
  RECEIVE = 1u << 2, /* CR1 */
  SEND = 1u << 3,
  ENABLE = 1u << 13,
  OVER8 = 1u << 15,
  ERROR_INTERRUPT = 1u << 0, /* CR3 */
  BITS_A_BYTE = 10,          /* 8N1 */
  FIRST_IRQ = 37,            /* of USART1, USART2 in all our chips */
  USUAL_BAUD = 115200,
};

static usart_t* usart(board_t* board, int index) { return &board->usarts[index]; }

void usart_reset(board_t* board, int index) {
  usart_t* port = usart(board, index);
  usart_t fresh = {.sr = TC | TXE, .rx_due = NEVER, .tx_due = NEVER};
  fresh.in = port->in;
  fresh.out = port->out;
  fresh.overruns = port->overruns;
  fresh.rx_due = port->rx_due;
  fresh.byte_time = port->byte_time;
  if (fresh.byte_time == 0) {
    fresh.rx_due = NEVER;
    fresh.byte_time = BITS_A_BYTE * SECOND / USUAL_BAUD;
  }
  *port = fresh;
  core_set_line(board, FIRST_IRQ + index, 0);
}

static void renew_line(board_t* board, int index) {
  const usart_t* port = usart(board, index);
  uint32_t events = port->sr & port->cr1 & (RXNE | TC | TXE); /* status and enable bits agree */
  int error = (port->sr & ORE) && ((port->cr1 & RXNE) || (port->cr3 & ERROR_INTERRUPT));
  core_set_line(board, FIRST_IRQ + index, (events || error) && (port->cr1 & ENABLE));
}

static void renew_rate(board_t* board, int index) {
  usart_t* port = usart(board, index);
  uint32_t divisor = port->cr1 & OVER8 ? (port->brr >> 4) * 8 + (port->brr & 7) : port->brr;
  uint32_t hz = rcc_apb_hz(board, index == 0 ? 2 : 1);
  if (divisor) port->byte_time = (uint64_t)BITS_A_BYTE * divisor * SECOND / hz;
}

uint64_t usart_due(const board_t* board, int index) {
  const usart_t* port = &board->usarts[index];
  return port->rx_due < port->tx_due ? port->rx_due : port->tx_due;
}

static void begin_byte(board_t* board, usart_t* port, uint64_t start) {
  port->shift = port->tdr;
  port->sending = 1;
  port->tx_due = start + port->byte_time;
  port->sr |= TXE;
  port->sr &= ~(uint32_t)TC;
  core_schedule(board, port->tx_due);
}

static void end_byte(board_t* board, usart_t* port) {
  uint64_t ended = port->tx_due;
  outbox_add(&port->out, (uint8_t)port->shift, ended >> 10);
  port->sending = 0;
  port->tx_due = NEVER;
  if (port->waiting) {
    port->waiting = 0;
    begin_byte(board, port, ended);
  } else {
    port->sr |= TC;
  }
}

static void receive_byte(usart_t* port) {
  uint8_t byte = inbox_next(&port->in);
  port->rx_due = port->in.count ? port->rx_due + port->byte_time : NEVER;
  if ((port->cr1 & (ENABLE | RECEIVE)) != (ENABLE | RECEIVE)) return;
  if (port->sr & RXNE) {
    port->sr |= ORE;
    port->overruns++;
  } else {
    port->rdr = byte;
    port->sr |= RXNE;
  }
}

void usart_step(board_t* board, int index) {
  usart_t* port = usart(board, index);
  while (port->tx_due <= board->now) end_byte(board, port);
  while (port->rx_due <= board->now) receive_byte(port);
  renew_line(board, index);
}

uint32_t usart_read(board_t* board, int index, uint32_t offset) {
  usart_t* port = usart(board, index);
  switch (offset) {
    case 0x00: return port->sr;
    case 0x04:
      port->sr &= ~(uint32_t)(RXNE | ORE);
      renew_line(board, index);
      return port->rdr;
    case 0x08: return port->brr;
    case 0x0c: return port->cr1;
    case 0x10: return port->cr2;
    case 0x14: return port->cr3;
    case 0x18: return port->gtpr;
  }
  return 0;
}

static void send(board_t* board, usart_t* port, uint32_t value) {
  port->tdr = value & 0xff;
  if ((port->cr1 & (ENABLE | SEND)) != (ENABLE | SEND)) return;
  if (port->sending) {
    port->waiting = 1;
    port->sr &= ~(uint32_t)(TXE | TC);
  } else {
    begin_byte(board, port, board->now);
  }
}

void usart_write(board_t* board, int index, uint32_t offset, uint32_t value) {
  usart_t* port = usart(board, index);
  switch (offset) {
    case 0x00:
      port->sr &= value | ~(uint32_t)(RXNE | TC); /* the rest is read-only */
      break;
    case 0x04: send(board, port, value); break;
    case 0x08: port->brr = value & 0xffff; break;
    case 0x0c: port->cr1 = value; break;
    case 0x10: port->cr2 = value; break;
    case 0x14: port->cr3 = value; break;
    case 0x18: port->gtpr = value; break;
  }
  if (offset == 0x08 || offset == 0x0c) renew_rate(board, index);
  renew_line(board, index);
}

static usart_t* find(const board_t* board, char name) {
  int index = name - '1';
  return index < 0 || index >= UARTS ? NULL : (usart_t*)&board->usarts[index];
}

int board_feed(board_t* board, char name, const uint8_t* data, size_t count) {
  usart_t* port = find(board, name);
  if (!port) return -1;
  if (port->in.count == 0 && count) port->rx_due = board->now + port->byte_time;
  inbox_add(&port->in, data, count);
  return 0;
}

size_t board_take(board_t* board, char name, uint8_t* data, uint64_t* ticks, size_t size) {
  usart_t* port = find(board, name);
  return port ? outbox_take(&port->out, board->now >> 10, data, ticks, size) : 0;
}

uint64_t board_uart_overruns(const board_t* board, char name) {
  const usart_t* port = find(board, name);
  return port ? port->overruns : 0;
}

uint32_t board_uart_byte_ticks(const board_t* board, char name) {
  const usart_t* port = find(board, name);
  return port && port->brr ? (uint32_t)(port->byte_time >> 10) : 0;
}
