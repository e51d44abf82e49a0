/* Pins of an emulated STM32, and the timer that makes the servo pulses on four of them. */
#include <string.h>

#include "stm32.h"

enum { OUTPUT = 1, ALTERNATE = 2 }; /* modes of a pin, in the F4's numbers */
enum {
  TIMER_ENABLED = 1,
  PWM_MODE_1 = 6,
  SERVO_TIMER_FUNCTION = 2, /* TIM3 on the F4's pins */
};

/* TIM3's channels, in all our chips (on the F1 without remapping). */
static const struct {
  char port;
  int bit;
} kTimerPins[CHANNELS] = {{'A', 6}, {'A', 7}, {'B', 0}, {'B', 1}};

static gpio_t* port_of(const board_t* board, char port) {
  return (gpio_t*)&board->gpio[port - 'A'];
}

void gpio_reset(board_t* board) {
  memset(board->gpio, 0, sizeof board->gpio);
  for (int port = 0; port < 8; port++) {
    board->gpio[port].crl = board->gpio[port].crh = 0x44444444; /* F1: floating inputs */
  }
  gpio_renew(board);
}

static int mode(const board_t* board, char port, int bit, int* open_drain) {
  const gpio_t* gpio = port_of(board, port);
  if (!board->chip->is_f1) {
    *open_drain = gpio->otyper >> bit & 1;
    return gpio->moder >> 2 * bit & 3;
  }
  uint32_t set = (bit < 8 ? gpio->crl : gpio->crh) >> 4 * (bit % 8) & 15;
  *open_drain = set >> 2 & 1;
  if ((set & 3) == 0) return 0;
  return set & 8 ? ALTERNATE : OUTPUT;
}

int gpio_is_alternate(const board_t* board, char port, int bit, int function) {
  int open_drain;
  if (mode(board, port, bit, &open_drain) != ALTERNATE) return 0;
  if (board->chip->is_f1) return 1;
  return (int)(port_of(board, port)->afr[bit / 8] >> 4 * (bit % 8) & 15) == function;
}

/* What the world outside makes of a pin that is not driven: the bus is pulled up. */
static int outside(const board_t* board, char port, int bit) {
  const i2c_t* i2c = &board->i2c;
  if (port == i2c->port && bit == i2c->data_pin) return i2c->held_clocks == 0;
  return port == i2c->port && bit == i2c->clock_pin;
}

static int level(const board_t* board, char port, int bit) {
  int open_drain, now = mode(board, port, bit, &open_drain);
  if (now == OUTPUT) {
    int driven = port_of(board, port)->odr >> bit & 1;
    return driven && open_drain ? outside(board, port, bit) : driven;
  }
  for (int channel = 0; channel < CHANNELS; channel++) {
    if (kTimerPins[channel].port == port && kTimerPins[channel].bit == bit &&
        gpio_is_alternate(board, port, bit, SERVO_TIMER_FUNCTION))
      return timer_output(board, channel);
  }
  return outside(board, port, bit);
}

/* A line of the bus as the program drives it by hand; a device that has it is another matter. */
static int driven_by_hand(const board_t* board, char port, int bit) {
  int open_drain, now = mode(board, port, bit, &open_drain);
  return now != OUTPUT || (port_of(board, port)->odr >> bit & 1);
}

void gpio_renew(board_t* board) {
  for (int i = 0; i < board->watched_count; i++) {
    watched_t* pin = &board->watched[i];
    record_level(&pin->record, board->now >> 10, level(board, pin->port, pin->bit));
  }
  const i2c_t* i2c = &board->i2c;
  if (i2c->port)
    i2c_lines(board, driven_by_hand(board, i2c->port, i2c->data_pin),
              driven_by_hand(board, i2c->port, i2c->clock_pin));
}

uint32_t gpio_read(board_t* board, int port, uint32_t offset) {
  const gpio_t* gpio = &board->gpio[port];
  uint32_t inputs = 0;
  if (offset == (board->chip->is_f1 ? 0x08 : 0x10)) {
    for (int bit = 0; bit < 16; bit++)
      inputs |= (uint32_t)level(board, (char)('A' + port), bit) << bit;
    return inputs;
  }
  if (board->chip->is_f1)
    return offset == 0 ? gpio->crl : offset == 4 ? gpio->crh : offset == 12 ? gpio->odr : 0;
  const uint32_t all[] = {gpio->moder, gpio->otyper, gpio->ospeedr, gpio->pupdr, 0, gpio->odr,
                          0,           gpio->lckr,   gpio->afr[0],  gpio->afr[1]};
  return offset / 4 < sizeof all / sizeof all[0] ? all[offset / 4] : 0;
}

static void set_bits(gpio_t* gpio, uint32_t value) {
  gpio->odr = (gpio->odr & ~(value >> 16)) | (value & 0xffff);
}

void gpio_write(board_t* board, int port, uint32_t offset, uint32_t value) {
  gpio_t* gpio = &board->gpio[port];
  if (board->chip->is_f1) {
    if (offset == 0x00) gpio->crl = value;
    if (offset == 0x04) gpio->crh = value;
    if (offset == 0x0c) gpio->odr = value & 0xffff;
    if (offset == 0x10) set_bits(gpio, value);
    if (offset == 0x14) gpio->odr &= ~value;
  } else {
    uint32_t* all[] = {&gpio->moder, &gpio->otyper, &gpio->ospeedr, &gpio->pupdr,  NULL,
                       &gpio->odr,   NULL,          &gpio->lckr,    &gpio->afr[0], &gpio->afr[1]};
    if (offset == 0x18)
      set_bits(gpio, value);
    else if (offset / 4 < sizeof all / sizeof all[0] && all[offset / 4])
      *all[offset / 4] = value;
  }
  gpio_renew(board);
}

/* ---- the servo timer: up-counting, PWM mode 1, with and without preload */

static uint64_t count_time(const board_t* board) {
  return (uint64_t)(board->timer.psc_now + 1) * SECOND / rcc_timer_hz(board, 1);
}

static int counting(const board_t* board) { return board->timer.cr1 & TIMER_ENABLED; }

static uint64_t counted(const board_t* board) {
  const servo_timer_t* timer = &board->timer;
  if (!counting(board)) return timer->count_stopped;
  return (board->now - timer->frame) * rcc_timer_hz(board, 1) / SECOND / (timer->psc_now + 1);
}

int timer_output(const board_t* board, int channel) {
  const servo_timer_t* timer = &board->timer;
  uint32_t how = timer->ccmr[channel / 2] >> 8 * (channel % 2) >> 4 & 7;
  if (how != PWM_MODE_1 || !(timer->ccer >> 4 * channel & 1)) return 0;
  int active = counted(board) < timer->ccr_now[channel];
  return active ^ (timer->ccer >> (4 * channel + 1) & 1);
}

static void load_all(servo_timer_t* timer) {
  timer->psc_now = timer->psc;
  timer->arr_now = timer->arr;
  memcpy(timer->ccr_now, timer->ccr, sizeof timer->ccr);
}

void timer_reset(board_t* board) {
  memset(&board->timer, 0, sizeof board->timer);
  board->timer.arr = board->timer.arr_now = 0xffff;
  board->timer.due = NEVER;
}

uint64_t timer_due(const board_t* board) { return board->timer.due; }

/* The next edge or end of the frame. A unit late, so that a count rounded down has surely got
 * there.
 */
static void plan(board_t* board) {
  servo_timer_t* timer = &board->timer;
  timer->due = NEVER;
  if (!counting(board)) return;
  uint64_t count = counted(board), next = (uint64_t)timer->arr_now + 1;
  for (int channel = 0; channel < CHANNELS; channel++) {
    uint64_t edge = timer->ccr_now[channel];
    if (edge > count && edge < next) next = edge;
  }
  timer->due = timer->frame + next * (timer->psc_now + 1) * SECOND / rcc_timer_hz(board, 1) + 1;
}

static uint64_t frame_time(const board_t* board) {
  return (board->timer.arr_now + 1) * count_time(board);
}

/* An edge is dated to when it was due, not to the block of code at which it is noticed. */
void timer_step(board_t* board) {
  uint64_t noticed = board->now;
  while (board->timer.due <= noticed) {
    board->now = board->timer.due;
    if (counted(board) > board->timer.arr_now) {
      board->timer.frame += frame_time(board);
      board->timer.sr |= 1;
      load_all(&board->timer);
    }
    gpio_renew(board);
    plan(board);
  }
  board->now = noticed;
}

static uint32_t* timer_register(servo_timer_t* timer, uint32_t offset) {
  switch (offset) {
    case 0x00: return &timer->cr1;
    case 0x04: return &timer->cr2;
    case 0x08: return &timer->smcr;
    case 0x0c: return &timer->dier;
    case 0x10: return &timer->sr;
    case 0x18:
    case 0x1c: return &timer->ccmr[(offset - 0x18) / 4];
    case 0x20: return &timer->ccer;
    case 0x28: return &timer->psc;
    case 0x2c: return &timer->arr;
    case 0x34:
    case 0x38:
    case 0x3c:
    case 0x40: return &timer->ccr[(offset - 0x34) / 4];
  }
  return NULL;
}

uint32_t timer_read(board_t* board, uint32_t offset) {
  if (offset == 0x24) return (uint32_t)counted(board);
  const uint32_t* found = timer_register(&board->timer, offset);
  return found ? *found : 0;
}

static int is_preloaded(const servo_timer_t* timer, int channel) {
  return timer->ccmr[channel / 2] >> 8 * (channel % 2) >> 3 & 1;
}

void timer_write(board_t* board, uint32_t offset, uint32_t value) {
  servo_timer_t* timer = &board->timer;
  int ran = counting(board);
  uint64_t count = counted(board);
  uint32_t* found = timer_register(timer, offset);
  if (offset == 0x10)
    timer->sr &= value;
  else if (found)
    *found = value;
  if (offset == 0x24)
    timer->frame = board->now - (timer->count_stopped = value) * count_time(board);
  if (offset == 0x14 && (value & 1)) { /* an update by hand */
    load_all(timer);
    timer->frame = board->now;
    timer->count_stopped = 0;
    timer->sr |= 1;
  }
  if (!ran && counting(board)) timer->frame = board->now - timer->count_stopped * count_time(board);
  if (ran && !counting(board)) timer->count_stopped = count;
  if (offset == 0x2c && !(timer->cr1 & 0x80)) timer->arr_now = value;
  for (int channel = 0; channel < CHANNELS; channel++) {
    if (!is_preloaded(timer, channel)) timer->ccr_now[channel] = timer->ccr[channel];
  }
  gpio_renew(board);
  plan(board);
  core_schedule(board, board->timer.due);
}
