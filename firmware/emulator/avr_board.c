#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avr_adc.h"
#include "avr_eeprom.h"
#include "avr_ioport.h"
#include "avr_timer.h"
#include "avr_twi.h"
#include "avr_uart.h"
#include "avr_watchdog.h"
#include "board.h"
#include "recorders.h"
#include "sim_avr.h"
#include "sim_elf.h"

enum {
  UARTS = 4,
  PINS = 8,
  OUTPUTS = 2,         /* PB7 of the ATmega2560 is on two timers */
  BUS_BUFFER = 32,     /* Wire's own buffer size */
  READ_AHEAD = 2,      /* the sonar's answer: two bytes (PD11848) */
  UART_DEPTH = 3,      /* ATmega2560 22.7.1: two buffered bytes and one in the shift register */
  BITS_A_BYTE = 10,    /* 8N1 */
  BITS_A_TWI_BYTE = 9, /* eight and the acknowledgement */
  BATCH_CYCLES = 1000, /* between looks at timers; simavr stops earlier at the next event */
  SUPPLY_MV = 5000,
  ADC_STEPS = 1024,
  STARTING_RESETS = 3, /* watchdog off, watchdog on, and the one that begins the first turn */
  PAINT = 0xa5,        /* fresh stack memory */
  EEPROM_ERASED = 0xff,
  EEPROM_WRITE_US = 3300, /* ATmega2560 table 8-1: erase and write in one operation */
};

/* TWI states of the data sheet that simavr 1.6 mixes up in its address phase. */
enum { MT_SLA_ACK = 0x18, MT_SLA_NACK = 0x20, MT_DATA_ACK = 0x28, MT_DATA_NACK = 0x30 };

typedef struct {
  avr_io_write_t call;
  void* param;
} hook_t;

typedef struct {
  board_t* board;
  avr_uart_t* io;
  hook_t baud_hook;
  inbox_t in;
  int receiving;
  uint64_t overruns;
  outbox_t out;
} uart_t;

typedef struct {
  board_t* board;
  avr_timer_comp_t* outputs[OUTPUTS]; /* timer outputs that can drive this pin */
  pin_record_t record;
} pin_t;

typedef struct {
  avr_twi_t* io;
  hook_t control_hook;
  board_write_fn write;
  board_read_fn read;
  void* context;
  uint8_t address, data[BUS_BUFFER];
  int writing, count, next;
  int bits; /* length of what the last control write began */
  avr_irq_t *data_irq, *clock_irq;
  int held_clocks, data_level, clock_level, pulling;
  char port;
  int data_pin, clock_pin;
} bus_t;

struct board {
  avr_t* avr;
  avr_io_t probe; /* must be the first ioctl listener: sees watchdog resets and chip resets */
  uart_t uarts[UARTS];
  pin_t pins[PINS];
  int pin_count;
  bus_t bus;
  hook_t eeprom_hook;
  avr_eeprom_t* eeprom;
  int eeprom_writing; /* address + 1 of the byte being written, 0 for none */
  uint64_t turn_cycle;
  uint64_t watchdog_resets; /* since the program started */
  board_meters_t meters;
  uint32_t stack_floor;
  char fault[160];
};

static board_t* board_of(avr_t* avr) { return avr->custom.data; }

/* ---- simavr's messages
 * ------------------------------------------------------------------------------------- */

static void keep_first_error(struct avr_t* avr, const int level, const char* format,
                             va_list arguments) {
  board_t* board = avr ? board_of(avr) : NULL;
  if (!board || level != LOG_ERROR || board->fault[0]) return;
  vsnprintf(board->fault, sizeof board->fault, format, arguments);
  board->fault[strcspn(board->fault, "\n")] = 0;
}

static void do_not_sleep(avr_t* avr, avr_cycle_count_t cycles) {
  (void)avr;
  (void)cycles; /* time is simulated: the caller paces */
}

/* Put `mine` in front of the handler of a register, remembering the old one. */
static void hook_register(avr_t* avr, avr_io_addr_t address, avr_io_write_t mine, void* param,
                          hook_t* old) {
  avr_io_addr_t io = AVR_DATA_TO_IO(address);
  old->call = avr->io[io].w.c;
  old->param = avr->io[io].w.param;
  avr->io[io].w.c = mine;
  avr->io[io].w.param = param;
}

static avr_io_t* find_io(avr_t* avr, const char* kind, char name) {
  for (avr_io_t* io = avr->io_port; io; io = io->next) {
    if (strcmp(io->kind, kind) == 0 && (!name || ((avr_uart_t*)io)->name == name)) return io;
  }
  return NULL;
}

static avr_io_t* find_port(avr_t* avr, char name) {
  for (avr_io_t* io = avr->io_port; io; io = io->next) {
    if (strcmp(io->kind, "port") == 0 && ((avr_ioport_t*)io)->name == name) return io;
  }
  return NULL;
}

/* ---- UARTs: simavr counts a parity bit that 8N1 has not, and its receiver never overruns
 * ------------------------ */

static void baud_written(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  uart_t* uart = param;
  uart->baud_hook.call(avr, address, value, uart->baud_hook.param);
  uint32_t divisor = avr_regbit_get(avr, uart->io->ubrrl) | avr_regbit_get(avr, uart->io->ubrrh)
                                                                << 8;
  uint32_t bit_cycles = (divisor + 1) * (avr_regbit_get(avr, uart->io->u2x) ? 8 : 16);
  uart->io->cycles_per_byte = (avr_cycle_count_t)bit_cycles * BITS_A_BYTE;
}

static void byte_sent(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  uart_t* uart = param;
  outbox_add(&uart->out, (uint8_t)value, uart->board->avr->cycle + uart->io->cycles_per_byte);
}

static int unread(const avr_uart_t* io) {
  return (io->input.write - io->input.read) & (uart_fifo_fifo_size - 1);
}

/* One byte's start bit: simavr reports it received a byte time later. */
static avr_cycle_count_t byte_arrives(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)avr;
  uart_t* uart = param;
  if (uart->in.count == 0) {
    uart->receiving = 0;
    return 0;
  }
  uint8_t value = inbox_next(&uart->in);
  if (unread(uart->io) >= UART_DEPTH)
    uart->overruns++;
  else
    avr_raise_irq(uart->io->io.irq + UART_IRQ_INPUT, value);
  return when + uart->io->cycles_per_byte;
}

static void start_receiving(uart_t* uart) {
  if (uart->receiving || uart->in.count == 0) return;
  uart->receiving = 1;
  avr_cycle_timer_register(uart->board->avr, 1, byte_arrives, uart);
}

static uart_t* find_uart(const board_t* board, char name) {
  int index = name - '0';
  if (index < 0 || index >= UARTS || !board->uarts[index].io) return NULL;
  return (uart_t*)&board->uarts[index];
}

static void attach_uarts(board_t* board) {
  for (int i = 0; i < UARTS; i++) {
    uart_t* uart = &board->uarts[i];
    char name = (char)('0' + i);
    uart->board = board;
    uart->io = (avr_uart_t*)find_io(board->avr, "uart", name);
    if (!uart->io) continue;
    uint32_t quiet = 0; /* no copy on the console, no sleeping in polls */
    avr_ioctl(board->avr, AVR_IOCTL_UART_SET_FLAGS(name), &quiet);
    hook_register(board->avr, uart->io->ubrrl.reg, baud_written, uart, &uart->baud_hook);
    avr_irq_register_notify(uart->io->io.irq + UART_IRQ_OUTPUT, byte_sent, uart);
  }
}

int board_feed(board_t* board, char name, const uint8_t* data, size_t count) {
  uart_t* uart = find_uart(board, name);
  if (!uart) return -1;
  inbox_add(&uart->in, data, count);
  start_receiving(uart);
  return 0;
}

size_t board_take(board_t* board, char name, uint8_t* data, uint64_t* ticks, size_t size) {
  uart_t* uart = find_uart(board, name);
  return uart ? outbox_take(&uart->out, board->avr->cycle, data, ticks, size) : 0;
}

uint64_t board_uart_overruns(const board_t* board, char name) {
  uart_t* uart = find_uart(board, name);
  return uart ? uart->overruns : 0;
}

uint32_t board_uart_byte_ticks(const board_t* board, char name) {
  uart_t* uart = find_uart(board, name);
  return uart ? (uint32_t)uart->io->cycles_per_byte : 0;
}

/* ---- pins
 * ------------------------------------------------------------------------------------------------------
 */

static void set_level(pin_t* pin, int level) {
  record_level(&pin->record, pin->board->avr->cycle, level);
}

/* A timer whose compare output is connected to its pin drives it alone; simavr lets writes to the
 * port through as well. */
static avr_timer_comp_t* connected_output(const pin_t* pin) {
  for (int i = 0; i < OUTPUTS; i++) {
    avr_timer_comp_t* output = pin->outputs[i];
    if (output && avr_regbit_get(pin->board->avr, output->com)) return output;
  }
  return NULL;
}

static void port_changed(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  pin_t* pin = param;
  if (!connected_output(pin)) set_level(pin, value & 1);
}

static void output_changed(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  pin_t* pin = param;
  if (connected_output(pin)) set_level(pin, value & 1);
}

static void attach_outputs(pin_t* pin, avr_io_addr_t port, int bit) {
  int count = 0;
  for (avr_io_t* io = pin->board->avr->io_port; io; io = io->next) {
    if (strcmp(io->kind, "timer") != 0) continue;
    avr_timer_t* timer = (avr_timer_t*)io;
    for (int i = 0; i < AVR_TIMER_COMP_COUNT && count < OUTPUTS; i++) {
      avr_regbit_t place = timer->comp[i].com_pin;
      if (place.reg != port || place.bit != bit) continue;
      pin->outputs[count++] = &timer->comp[i];
      avr_irq_register_notify(timer->io.irq + TIMER_IRQ_OUT_COMP + i, output_changed, pin);
    }
  }
}

int board_watch_pin(board_t* board, char port, int bit) {
  avr_ioport_t* io = (avr_ioport_t*)find_port(board->avr, port);
  if (!io || bit < 0 || bit > 7 || board->pin_count == PINS) return -1;
  pin_t* pin = &board->pins[board->pin_count];
  pin->board = board;
  attach_outputs(pin, io->r_port, bit);
  avr_irq_register_notify(io->io.irq + bit, port_changed, pin);
  return board->pin_count++;
}

void board_read_pin(const board_t* board, int pin, board_pin_t* out) {
  *out = board->pins[pin].record.state;
}

size_t board_take_edges(board_t* board, int pin, board_edge_t* out, size_t size) {
  return take_edges(&board->pins[pin].record, out, size);
}

/* The open input A0, from which the firmware takes its seed: half a step on, so that the
 * converter's rounding gives the number asked for. */
void board_set_noise(board_t* board, uint32_t noise) {
  avr_irq_t* irq = avr_io_getirq(board->avr, AVR_IOCTL_ADC_GETIRQ, 0);
  if (irq) avr_raise_irq(irq, (2 * noise + 1) * SUPPLY_MV / (2 * ADC_STEPS));
}

/* ---- the two-wire bus: simavr runs it at 1 us a bit and cannot show a stuck one
 * ------------------------------------ */

static void answer(bus_t* bus, uint8_t message, uint8_t data) {
  avr_raise_irq(bus->io->io.irq + TWI_IRQ_INPUT, avr_twi_irq_msg(message, bus->address, data));
}

static void finish_write(bus_t* bus, uint64_t cycle) {
  if (bus->writing && bus->count && bus->write)
    bus->write(bus->context, cycle, bus->address >> 1, bus->data, bus->count);
  bus->writing = bus->count = 0;
}

static int begin_transfer(bus_t* bus, uint64_t cycle, uint8_t address) {
  finish_write(bus, cycle); /* a repeated START ends what went before */
  bus->address = address;
  bus->next = 0;
  if (!bus->write || !bus->read) return 0;
  if (address & 1) {
    bus->count = bus->read(bus->context, cycle, address >> 1, bus->data, READ_AHEAD);
    return bus->count >= 0;
  }
  bus->count = 0;
  bus->writing = bus->write(bus->context, cycle, address >> 1, NULL, 0);
  return bus->writing;
}

static void bus_message(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  board_t* board = param;
  bus_t* bus = &board->bus;
  avr_twi_msg_irq_t message = {.u.v = value};
  if (message.u.twi.msg & TWI_COND_STOP) finish_write(bus, board->avr->cycle);
  if (message.u.twi.msg & TWI_COND_START) {
    bus->bits = BITS_A_TWI_BYTE;
    if (begin_transfer(bus, board->avr->cycle, message.u.twi.addr)) answer(bus, TWI_COND_ACK, 1);
  }
  if (message.u.twi.msg & TWI_COND_WRITE) {
    bus->bits = BITS_A_TWI_BYTE;
    if (bus->writing && bus->count < BUS_BUFFER) {
      bus->data[bus->count++] = message.u.twi.data;
      answer(bus, TWI_COND_ACK, 1);
    }
  }
  if (message.u.twi.msg & TWI_COND_READ) {
    bus->bits = BITS_A_TWI_BYTE;
    answer(bus, TWI_COND_READ, bus->next < bus->count ? bus->data[bus->next] : 0xff);
    bus->next++;
  }
}

static avr_cycle_timer_slot_p find_timer(avr_t* avr, const void* param) {
  avr_cycle_timer_slot_p slot = avr->cycle_timers.timer;
  while (slot && slot->param != param) slot = slot->next;
  return slot;
}

static uint32_t bit_cycles(avr_t* avr, const avr_twi_t* io) {
  uint32_t prescaler = 1u << 2 * avr_regbit_get(avr, io->twps);
  return 16 + 2 * avr->data[io->r_twbr] * prescaler; /* ATmega2560 24.5.2 */
}

static void correct_address_state(avr_twi_t* io) {
  if (io->next_twstate == MT_DATA_ACK)
    io->next_twstate = MT_SLA_ACK;
  else if (io->next_twstate == MT_DATA_NACK)
    io->next_twstate = MT_SLA_NACK;
}

static void control_written(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  board_t* board = param;
  bus_t* bus = &board->bus;
  avr_cycle_timer_slot_p before = find_timer(avr, bus->io);
  uint64_t pending = before ? before->when : 0;
  int addressed = bus->io->state & TWI_COND_ADDR;
  bus->bits = 1; /* a START, unless a message says otherwise */
  bus->control_hook.call(avr, address, value, bus->control_hook.param);
  avr_cycle_timer_slot_p begun = find_timer(avr, bus->io);
  if (!begun || begun->when == pending) return;
  if (!addressed && (bus->io->state & TWI_COND_ADDR)) correct_address_state(bus->io);
  if (bus->held_clocks)
    avr_cycle_timer_cancel(avr, begun->timer, begun->param);
  else
    avr_cycle_timer_register(avr, (avr_cycle_count_t)bus->bits * bit_cycles(avr, bus->io),
                             begun->timer, begun->param);
}

static void attach_bus(board_t* board) {
  bus_t* bus = &board->bus;
  bus->io = (avr_twi_t*)find_io(board->avr, "twi", 0);
  if (!bus->io) return;
  hook_register(board->avr, bus->io->twen.reg, control_written, board, &bus->control_hook);
  avr_irq_register_notify(bus->io->io.irq + TWI_IRQ_OUTPUT, bus_message, board);
}

void board_set_bus(board_t* board, board_write_fn write, board_read_fn read, void* context) {
  board->bus.write = write;
  board->bus.read = read;
  board->bus.context = context;
}

/* Both lines are pulled up outside the chip; the data line reads low while something holds it. */
static void pull_lines(board_t* board) {
  bus_t* bus = &board->bus;
  unsigned data = 1u << bus->data_pin, clock = 1u << bus->clock_pin;
  avr_ioport_external_t pull = {
      .name = (unsigned long)bus->port,
      .mask = data | clock,
      .value = clock | (bus->held_clocks ? 0 : data),
  };
  bus->pulling = 1;
  avr_ioctl(board->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(bus->port), &pull);
  avr_raise_irq(bus->clock_irq, 1);
  avr_raise_irq(bus->data_irq, bus->held_clocks ? 0 : 1);
  bus->pulling = 0;
}

static void clock_changed(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  board_t* board = param;
  bus_t* bus = &board->bus;
  int level = value & 1, rising = level && !bus->clock_level;
  bus->clock_level = level;
  if (!rising || bus->pulling) return;
  board->meters.bus_clocks++;
  if (bus->held_clocks && --bus->held_clocks == 0) pull_lines(board);
}

static void data_changed(avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  board_t* board = param;
  int level = value & 1, rising = level && !board->bus.data_level;
  board->bus.data_level = level;
  if (rising && board->bus.clock_level && !board->bus.pulling) board->meters.bus_stops++;
}

void board_hold_bus(board_t* board, char port, int data_pin, int clock_pin, int clocks) {
  bus_t* bus = &board->bus;
  bus->port = port;
  bus->data_pin = data_pin;
  bus->clock_pin = clock_pin;
  bus->held_clocks = clocks;
  if (!bus->clock_irq) {
    bus->clock_irq = avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ(port), clock_pin);
    bus->data_irq = avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ(port), data_pin);
    pull_lines(board);
    bus->clock_level = 1;
    bus->data_level = !clocks;
    avr_irq_register_notify(bus->clock_irq, clock_changed, board);
    avr_irq_register_notify(bus->data_irq, data_changed, board);
  }
  pull_lines(board);
}

/* ---- EEPROM: simavr writes in no time; the chip is busy for 3.3 ms and loses the byte if power
 * goes -------------- */

static avr_cycle_count_t eeprom_written(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)when;
  board_t* board = param;
  board->eeprom_writing = 0;
  avr_regbit_clear(avr, board->eeprom->eepe);
  return 0;
}

static void eeprom_control_written(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  board_t* board = param;
  avr_eeprom_t* io = board->eeprom;
  int begins = avr_regbit_get(avr, io->eempe) && avr_regbit_from_value(avr, io->eepe, value) &&
               !board->eeprom_writing;
  if (board->eeprom_writing) /* the running write keeps its bit, and another cannot begin */
    value &= (uint8_t)~(io->eepe.mask << io->eepe.bit);
  board->eeprom_hook.call(avr, address, value, board->eeprom_hook.param);
  if (begins) {
    board->eeprom_writing = 1 + (avr->data[io->r_eearl] | avr->data[io->r_eearh] << 8);
    avr_cycle_timer_register_usec(avr, EEPROM_WRITE_US, eeprom_written, board);
  }
  if (board->eeprom_writing) avr_regbit_set(avr, io->eepe);
}

static void attach_eeprom(board_t* board) {
  board->eeprom = (avr_eeprom_t*)find_io(board->avr, "eeprom", 0);
  if (board->eeprom)
    hook_register(board->avr, board->eeprom->r_eecr, eeprom_control_written, board,
                  &board->eeprom_hook);
}

uint32_t board_memory_size(const board_t* board) { return board->avr->e2end + 1; }

int board_memory_set(board_t* board, const uint8_t* data, size_t size) {
  if (size > board_memory_size(board)) return -1;
  memcpy(board->eeprom->eeprom, data, size);
  return 0;
}

int board_memory_get(const board_t* board, uint8_t* data, size_t size) {
  if (size > board_memory_size(board)) return -1;
  memcpy(data, board->eeprom->eeprom, size);
  if (board->eeprom_writing && (size_t)board->eeprom_writing <= size)
    data[board->eeprom_writing - 1] = EEPROM_ERASED;
  return 0;
}

/* ---- meters
 * ------------------------------------------------------------------------------------------------------
 */

static int watchdog_reset_seen(avr_io_t* io, uint32_t control, void* param) {
  (void)param;
  if (control != AVR_IOCTL_WATCHDOG_RESET) return -1;
  board_t* board = board_of(io->avr);
  uint64_t now = io->avr->cycle;
  if (++board->watchdog_resets > STARTING_RESETS) {
    uint64_t cycles = now - board->turn_cycle;
    board->meters.turns++;
    if (cycles > board->meters.longest_ticks) board->meters.longest_ticks = cycles;
  }
  board->turn_cycle = now;
  return -1; /* the watchdog itself wants it too */
}

static void chip_restarted(avr_io_t* io) {
  board_t* board = board_of(io->avr);
  io->avr->run_cycle_limit = BATCH_CYCLES;
  board->meters.restarts++;
  board->watchdog_resets = 0;
  board->eeprom_writing = 0;
  for (int i = 0; i < UARTS; i++) { /* simavr has dropped all timers */
    board->uarts[i].receiving = 0;
    if (board->uarts[i].io) start_receiving(&board->uarts[i]);
  }
}

void board_read_meters(const board_t* board, board_meters_t* out) {
  uint32_t lowest = board->stack_floor;
  while (lowest <= board->avr->ramend && board->avr->data[lowest] == PAINT) lowest++;
  *out = board->meters;
  out->stack_headroom = lowest - board->stack_floor;
}

void board_clear_meters(board_t* board) {
  board->meters.turns = board->meters.longest_ticks = 0;
  board->meters.bus_clocks = board->meters.bus_stops = 0;
}

/* ---- power
 * -------------------------------------------------------------------------------------------------------
 */

/* simavr 1.6 takes mode 14 (fast PWM, TOP = ICR) of some chips' Timer1 for phase-correct PWM, and
 * lacks the phase-correct modes 1 to 3 of the ATmega2560: the timers Arduino's start-up leaves in
 * mode 1 would then overflow at every tick, and take half of the run's time. */
static void correct_timer(avr_timer_t* timer) {
  static const avr_timer_wgm_t phase_correct[] = {AVR_TIMER_WGM_FCPWM8(), AVR_TIMER_WGM_FCPWM9(),
                                                  AVR_TIMER_WGM_FCPWM10()};
  for (int mode = 1; mode <= 3; mode++) {
    if (timer->wgm_op[mode].kind == avr_timer_wgm_none)
      timer->wgm_op[mode] = phase_correct[mode - 1];
  }
  if (timer->wgm_op[14].kind == avr_timer_wgm_pwm)
    timer->wgm_op[14] = (avr_timer_wgm_t)AVR_TIMER_WGM_ICFASTPWM();
}

static void correct_timers(avr_t* avr) {
  for (avr_io_t* io = avr->io_port; io; io = io->next) {
    if (strcmp(io->kind, "timer") == 0) correct_timer((avr_timer_t*)io);
  }
}

static void paint_stack(board_t* board, const elf_firmware_t* firmware) {
  avr_t* avr = board->avr;
  board->meters.static_bytes = firmware->datasize + firmware->bsssize;
  board->stack_floor = avr->ioend + 1u + board->meters.static_bytes;
  memset(avr->data + board->stack_floor, PAINT, avr->ramend + 1u - board->stack_floor);
}

static int load(board_t* board, elf_firmware_t* firmware, uint32_t hz) {
  avr_t* avr = board->avr;
  if (firmware->flashbase + firmware->flashsize > avr->flashend + 1) return 0;
  if (firmware->datasize + firmware->bsssize > (uint32_t)avr->ramend - avr->ioend) return 0;
  avr_load_firmware(avr, firmware);
  avr->frequency = hz;
  avr->vcc = avr->avcc = avr->aref = SUPPLY_MV;
  paint_stack(board, firmware);
  return 1;
}

static void release(elf_firmware_t* firmware) {
  for (uint32_t i = 0; i < firmware->symbolcount; i++) free(firmware->symbol[i]);
  free(firmware->symbol);
  free(firmware->flash);
  free(firmware->eeprom);
}

board_t* board_power_on(const char* elf, const char* mcu, uint32_t hz, char* error,
                        size_t error_size) {
  avr_global_logger_set(keep_first_error);
  elf_firmware_t firmware = {0};
  if (elf_read_firmware(elf, &firmware) || !firmware.flash) {
    snprintf(error, error_size, "cannot read an AVR program from %s", elf);
    return NULL;
  }
  avr_t* avr = avr_make_mcu_by_name(mcu);
  if (!avr) {
    release(&firmware);
    snprintf(error, error_size, "simavr does not know the chip %s", mcu);
    return NULL;
  }
  board_t* board = calloc(1, sizeof *board);
  board->avr = avr;
  avr->custom.data = board;
  avr_init(avr);
  avr->log = LOG_ERROR;
  avr->sleep = do_not_sleep;
  int fits = load(board, &firmware, hz);
  release(&firmware);
  if (!fits) {
    snprintf(error, error_size, "%s does not fit into an %s", elf, mcu);
    board_power_off(board);
    return NULL;
  }
  correct_timers(avr);
  attach_uarts(board);
  attach_bus(board);
  attach_eeprom(board);
  board->probe =
      (avr_io_t){.kind = "echowing", .ioctl = watchdog_reset_seen, .reset = chip_restarted};
  avr_register_io(avr, &board->probe);
  avr->run_cycle_limit = BATCH_CYCLES;
  board->fault[0] = 0;
  return board;
}

void board_power_off(board_t* board) {
  avr_terminate(board->avr);
  free(board->avr);
  for (int i = 0; i < UARTS; i++) {
    inbox_free(&board->uarts[i].in);
    outbox_free(&board->uarts[i].out);
  }
  free(board);
}

static avr_cycle_count_t end_batch(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)avr;
  (void)when;
  (void)param;
  return 0; /* being a timer is enough: no batch of instructions runs past it */
}

int board_run_until(board_t* board, uint64_t cycle) {
  avr_t* avr = board->avr;
  if (avr->cycle < cycle) avr_cycle_timer_register(avr, cycle - avr->cycle, end_batch, NULL);
  while (avr->cycle < cycle) {
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
      if (!board->fault[0])
        snprintf(board->fault, sizeof board->fault,
                 "the program went to sleep with interrupts off");
      return 1;
    }
  }
  return 0;
}

uint64_t board_tick(const board_t* board) { return board->avr->cycle; }

uint32_t board_ticks_per_us(const board_t* board) { return board->avr->frequency / 1000000; }

const char* board_fault(const board_t* board) { return board->fault; }
