/*
 * The processor of an emulated STM32: unicorn runs the instructions; exceptions, their controller,
 * the tick timer and the passing of time are here.
 *
 * Time advances with each block of code that begins, by its length. The processor is stopped at the
 * beginning of the first block at or after board->limit, never inside one, so how a run is cut into
 * steps changes nothing.
 */
#include <string.h>

#include "stm32.h"

enum {
  /* A Thumb-2 instruction of compiled code has 2.5 bytes on average, and with flash wait states
   * and branches takes about two cycles. */
  CODE_BYTES_TIMES_10 = 25,
  CYCLES_A_INSTRUCTION = 2,
  ENTRY_CYCLES = 12, /* ARM DDI 0337, 5.6 */
  LOWEST_PRIORITY = 256,
  THUMB_BIT = 1u << 24,
  ALIGNED_BIT = 1u << 9, /* of a stacked xPSR: one word was skipped */
  PLAIN_FRAME = 32,
  FLOAT_FRAME = 104,
  FLOAT_REGISTERS = 16,
};

/* unicorn's numbers of what its interrupt hook reports (QEMU's EXCP_ numbers). */
enum { EXIT_EXCEPTION = 8, EXIT_HALT = 0x10001 };

static const int kStacked[] = {UC_ARM_REG_R0,  UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3,
                               UC_ARM_REG_R12, UC_ARM_REG_LR, UC_ARM_REG_PC};

uint32_t core_register(const board_t* board, int reg) {
  uint32_t value = 0;
  uc_reg_read(board->uc, reg, &value);
  return value;
}

static void set_register(board_t* board, int reg, uint32_t value) {
  uc_reg_write(board->uc, reg, &value);
}

static uint32_t load_word(board_t* board, uint32_t address) {
  uint32_t value = 0;
  uc_mem_read(board->uc, address, &value, sizeof value);
  return value;
}

void core_attend(board_t* board) { board->limit = board->now; }

void core_schedule(board_t* board, uint64_t due) {
  if (due < board->limit) board->limit = due;
}

static void core_advance(board_t* board, uint32_t cycles) {
  board->now += (uint64_t)cycles * SECOND / rcc_core_hz(board) * board->slowness;
}

/* ---- priorities */

static int base_priority(const board_t* board) {
  const nvic_t* nvic = &board->nvic;
  int lowest = LOWEST_PRIORITY;
  for (int i = 0; i < nvic->depth; i++) {
    int exception = nvic->active[i];
    int priority = exception == HARD_FAULT ? -1 : nvic->priority[exception];
    if (priority < lowest) lowest = priority;
  }
  return lowest;
}

static int masked_priority(const board_t* board) {
  int priority = base_priority(board);
  if (core_register(board, UC_ARM_REG_FAULTMASK) & 1) return -1;
  if ((core_register(board, UC_ARM_REG_PRIMASK) & 1) && priority > 0) return 0;
  int base = (int)core_register(board, UC_ARM_REG_BASEPRI);
  return base && base < priority ? base : priority;
}

/* The pending exception that goes first, or 0; `priority` gets its own. */
static int most_urgent(const board_t* board, int* priority) {
  const nvic_t* nvic = &board->nvic;
  int best = 0;
  *priority = LOWEST_PRIORITY;
  if (nvic->pendsv_pending && nvic->priority[PENDSV] < *priority)
    best = PENDSV, *priority = nvic->priority[PENDSV];
  if (nvic->tick_pending && nvic->priority[SYSTICK] < *priority)
    best = SYSTICK, *priority = nvic->priority[SYSTICK];
  for (int word = 0; word < IRQS / 32; word++) {
    uint32_t ready = (nvic->pended[word] | nvic->lines[word]) & nvic->enabled[word];
    for (; ready; ready &= ready - 1) {
      int exception = 16 + 32 * word + __builtin_ctz(ready);
      if (nvic->priority[exception] < *priority)
        best = exception, *priority = nvic->priority[exception];
    }
  }
  return best;
}

void core_set_line(board_t* board, int irq, int level) {
  uint32_t bit = 1u << irq % 32, *lines = &board->nvic.lines[irq / 32];
  if (level && !(*lines & bit) && (board->nvic.enabled[irq / 32] & bit)) core_attend(board);
  *lines = level ? *lines | bit : *lines & ~bit;
}

/* ---- entry and return */

static int has_float(const board_t* board) { return !board->chip->is_f1; }

static void enter(board_t* board, int exception) {
  nvic_t* nvic = &board->nvic;
  if (nvic->depth == NESTING) {
    board_complain(board, "exceptions are nested %d deep", NESTING);
    return;
  }
  uint32_t status = core_register(board, UC_ARM_REG_XPSR);
  uint32_t stack = core_register(board, UC_ARM_REG_SP), skipped = stack & 4;
  int size = has_float(board) ? FLOAT_FRAME : PLAIN_FRAME;
  uint32_t frame[FLOAT_FRAME / 4] = {0};
  for (int i = 0; i < 7; i++) frame[i] = core_register(board, kStacked[i]);
  frame[6] &= ~1u;
  frame[7] = (status & ~(uint32_t)ALIGNED_BIT) | (skipped ? ALIGNED_BIT : 0) | THUMB_BIT;
  if (has_float(board)) {
    for (int i = 0; i < FLOAT_REGISTERS; i++)
      uc_reg_read(board->uc, UC_ARM_REG_S0 + i, &frame[8 + i]);
    uc_reg_read(board->uc, UC_ARM_REG_FPSCR, &frame[8 + FLOAT_REGISTERS]);
  }
  stack -= skipped + size;
  if (uc_mem_write(board->uc, stack, frame, size) != UC_ERR_OK) {
    board_complain(board, "the stack pointer is at 0x%08x, where there is no memory", stack);
    return;
  }
  set_register(board, UC_ARM_REG_SP, stack);
  set_register(board, UC_ARM_REG_LR, nvic->depth ? 0xfffffff1 : 0xfffffff9);
  set_register(board, UC_ARM_REG_XPSR, THUMB_BIT | exception);
  set_register(board, UC_ARM_REG_PC, load_word(board, nvic->vtor + 4 * exception));
  nvic->active[nvic->depth] = exception;
  nvic->frame_size[nvic->depth++] = size;
  core_advance(board, ENTRY_CYCLES);
}

static void leave(board_t* board) {
  nvic_t* nvic = &board->nvic;
  if (nvic->depth == 0) {
    board_complain(board, "return from an exception that was not entered, PC 0x%08x",
                   core_register(board, UC_ARM_REG_PC));
    return;
  }
  uint32_t stack = core_register(board, UC_ARM_REG_SP);
  int size = nvic->frame_size[--nvic->depth];
  uint32_t frame[FLOAT_FRAME / 4] = {0};
  uc_mem_read(board->uc, stack, frame, size);
  if (size == FLOAT_FRAME) {
    for (int i = 0; i < FLOAT_REGISTERS; i++)
      uc_reg_write(board->uc, UC_ARM_REG_S0 + i, &frame[8 + i]);
    uc_reg_write(board->uc, UC_ARM_REG_FPSCR, &frame[8 + FLOAT_REGISTERS]);
  }
  set_register(board, UC_ARM_REG_XPSR, frame[7] & ~(uint32_t)ALIGNED_BIT);
  set_register(board, UC_ARM_REG_SP, stack + size + (frame[7] & ALIGNED_BIT ? 4 : 0));
  for (int i = 0; i < 6; i++) set_register(board, kStacked[i], frame[i]);
  set_register(board, UC_ARM_REG_PC, frame[6] | 1);
  core_advance(board, ENTRY_CYCLES);
}

static void take_fault(board_t* board) {
  for (int i = 0; i < board->nvic.depth; i++) {
    if (board->nvic.active[i] == HARD_FAULT) {
      board->locked_up = 1; /* a fault of the fault's own handler: only a reset helps */
      return;
    }
  }
  enter(board, HARD_FAULT);
}

int core_take_exception(board_t* board) {
  int priority, exception = most_urgent(board, &priority);
  board->interrupt_may_wait = 0;
  if (!exception) return 0;
  if (priority >= masked_priority(board)) {
    board->interrupt_may_wait = priority < base_priority(board);
    return 0;
  }
  if (exception == SYSTICK)
    board->nvic.tick_pending = 0;
  else if (exception == PENDSV)
    board->nvic.pendsv_pending = 0;
  else
    board->nvic.pended[(exception - 16) / 32] &= ~(1u << (exception - 16) % 32);
  enter(board, exception);
  return 1;
}

/* ---- running */

static int can_go_now(board_t* board) {
  int priority, exception = most_urgent(board, &priority);
  return exception && priority < masked_priority(board);
}

static void block_begins(uc_engine* uc, uint64_t address, uint32_t size, void* user) {
  board_t* board = user;
  const chip_t* chip = board->chip;
  if (address - chip->rom_base < chip->rom_size) {
    board_enter_rom(board);
    uc_emu_stop(uc);
    return;
  }
  if (board->now >= board->limit || (board->interrupt_may_wait && can_go_now(board))) {
    uc_emu_stop(uc);
    return;
  }
  board->now += size * board->byte_cost;
}

static void interrupted(uc_engine* uc, uint32_t number, void* user) {
  board_t* board = user;
  if (number == EXIT_EXCEPTION)
    board->exception_return = 1;
  else if (number == EXIT_HALT)
    board->halted = 1;
  else
    board->fault_taken = 1;
  uc_emu_stop(uc);
}

static bool stored_to_flash(uc_engine* uc, uc_mem_type type, uint64_t address, int size,
                            int64_t value, void* user) {
  (void)uc, (void)type;
  board_t* board = user;
  flash_store(board, (uint32_t)address - 0x08000000, size, (uint32_t)value);
  core_attend(board);
  return true;
}

void core_run(board_t* board) {
  board->exception_return = board->halted = board->fault_taken = 0;
  board->byte_cost = (uint64_t)CYCLES_A_INSTRUCTION * SECOND * 10 / CODE_BYTES_TIMES_10 *
                     board->slowness / rcc_core_hz(board);
  uc_err error = uc_emu_start(board->uc, core_register(board, UC_ARM_REG_PC) | 1, 0xfffffffe, 0, 0);
  uint32_t pc = core_register(board, UC_ARM_REG_PC);
  flash_apply(board);
  if (board->in_rom) return;
  if (board->exception_return || (error && pc >= 0xffffffe0))
    leave(board);
  else if (board->fault_taken || error)
    take_fault(board);
}

/* ---- tick timer */

static uint64_t tick_period(const board_t* board) {
  uint64_t divider = board->nvic.tick_ctrl & 4 ? 1 : 8;
  return (board->nvic.tick_load + 1) * divider * SECOND / rcc_core_hz(board);
}

uint64_t core_due(const board_t* board) {
  const nvic_t* nvic = &board->nvic;
  if (!(nvic->tick_ctrl & 1) || nvic->tick_load == 0) return NEVER;
  return nvic->tick_start + tick_period(board);
}

void core_step_tick(board_t* board) {
  nvic_t* nvic = &board->nvic;
  while (core_due(board) <= board->now) {
    nvic->tick_start = core_due(board);
    nvic->tick_ctrl |= 1u << 16;
    if (nvic->tick_ctrl & 2) nvic->tick_pending = 1;
  }
}

/* On the chip the interrupt comes with the counter's return to its start, here at the next block of
 * code: until then the counter stands at 0, or time would seem to jump back by a tick. */
static uint32_t tick_value(board_t* board) {
  const nvic_t* nvic = &board->nvic;
  if (!(nvic->tick_ctrl & 1) || nvic->tick_load == 0) return 0;
  if (board->now >= core_due(board)) return 0;
  uint64_t counted = (board->now - nvic->tick_start) * (nvic->tick_load + 1) / tick_period(board);
  return nvic->tick_load - (uint32_t)counted;
}

/* ---- registers */

static uint32_t* word_of(uint32_t* words, uint32_t offset) { return &words[offset % 0x80 / 4]; }

uint32_t core_read(board_t* board, uint32_t offset) {
  nvic_t* nvic = &board->nvic;
  uint32_t value = 0;
  if (offset >= 0xe100 && offset < 0xe10c) return *word_of(nvic->enabled, offset);
  if (offset >= 0xe180 && offset < 0xe18c) return *word_of(nvic->enabled, offset);
  if (offset >= 0xe200 && offset < 0xe20c) return *word_of(nvic->pended, offset);
  if (offset >= 0xe400 && offset < 0xe400 + IRQS) {
    memcpy(&value, &nvic->priority[16 + offset - 0xe400], 4);
    return value;
  }
  if (offset >= 0xed18 && offset < 0xed24) {
    memcpy(&value, &nvic->priority[4 + offset - 0xed18], 4);
    return value;
  }
  switch (offset) {
    case 0x1000: return nvic->dwt_ctrl;
    case 0x1004:
      if (!(nvic->dwt_ctrl & 1)) return 0;
      return (uint32_t)((double)(board->now - nvic->cycles_zero) * rcc_core_hz(board) / SECOND);
    case 0xe010:
      value = nvic->tick_ctrl;
      nvic->tick_ctrl &= ~(1u << 16);
      return value;
    case 0xe014: return nvic->tick_load;
    case 0xe018: return tick_value(board);
    case 0xed00: /* Cortex-M3 r1p1, Cortex-M4 r0p1 */
      return has_float(board) ? 0x410fc241 : 0x411fc231;
    case 0xed04: return core_register(board, UC_ARM_REG_XPSR) & 0x1ff;
    case 0xed08: return nvic->vtor;
    case 0xed0c: return 0xfa050000 | nvic->aircr;
    case 0xed14: return nvic->ccr;
    case 0xed24: return nvic->shcsr;
    case 0xed88: return nvic->cpacr;
    case 0xedfc: return nvic->demcr;
    case 0x42000: return board->chip->debug_id;
  }
  return 0;
}

void core_write(board_t* board, uint32_t offset, uint32_t value, uint32_t mask) {
  nvic_t* nvic = &board->nvic;
  value &= mask;
  if (offset >= 0xe100 && offset < 0xe10c) {
    *word_of(nvic->enabled, offset) |= value;
    core_attend(board);
  } else if (offset >= 0xe180 && offset < 0xe18c) {
    *word_of(nvic->enabled, offset) &= ~value;
  } else if (offset >= 0xe200 && offset < 0xe20c) {
    *word_of(nvic->pended, offset) |= value;
    core_attend(board);
  } else if (offset >= 0xe280 && offset < 0xe28c) {
    *word_of(nvic->pended, offset) &= ~value;
  } else if ((offset >= 0xe400 && offset < 0xe400 + IRQS) ||
             (offset >= 0xed18 && offset < 0xed24)) {
    uint32_t first = offset >= 0xed18 ? 4 + offset - 0xed18 : 16 + offset - 0xe400;
    for (int i = 0; i < 4; i++) { /* four bits of priority are built in */
      if (mask >> 8 * i & 0xff) nvic->priority[first + i] = value >> 8 * i & 0xf0;
    }
  }
  switch (offset) {
    case 0x1000: nvic->dwt_ctrl = value; break;
    case 0x1004: nvic->cycles_zero = board->now; break;
    case 0xe010:
      if ((value & 1) && !(nvic->tick_ctrl & 1)) nvic->tick_start = board->now;
      nvic->tick_ctrl = (nvic->tick_ctrl & 1u << 16) | (value & 7);
      core_schedule(board, core_due(board));
      break;
    case 0xe014: nvic->tick_load = value & 0xffffff; break;
    case 0xe018:
      nvic->tick_start = board->now;
      nvic->tick_ctrl &= ~(1u << 16);
      break;
    case 0xed04:
      if (value & 1u << 28) nvic->pendsv_pending = 1;
      if (value & 1u << 27) nvic->pendsv_pending = 0;
      if (value & 1u << 26) nvic->tick_pending = 1;
      if (value & 1u << 25) nvic->tick_pending = 0;
      core_attend(board);
      break;
    case 0xed08: nvic->vtor = value; break;
    case 0xed0c:
      if (value >> 16 != 0x05fa) break;
      nvic->aircr = value & 0x700;
      if (value & 4) {
        board->reset_wanted = 1;
        core_attend(board);
      }
      break;
    case 0xed14: nvic->ccr = value; break;
    case 0xed24: nvic->shcsr = value; break;
    case 0xed88: nvic->cpacr = value; break;
    case 0xedfc: nvic->demcr = value; break;
  }
}

/* ---- power */

void core_reset(board_t* board) {
  memset(&board->nvic, 0, sizeof board->nvic);
  board->nvic.vtor = 0x08000000;
  board->nvic.cycles_zero = board->now;
  board->interrupt_may_wait = board->locked_up = 0;
  for (int reg = UC_ARM_REG_R0; reg <= UC_ARM_REG_R12; reg++) set_register(board, reg, 0);
  set_register(board, UC_ARM_REG_XPSR, THUMB_BIT);
  set_register(board, UC_ARM_REG_PRIMASK, 0);
  set_register(board, UC_ARM_REG_BASEPRI, 0);
  set_register(board, UC_ARM_REG_FAULTMASK, 0);
  if (has_float(board)) set_register(board, UC_ARM_REG_FPEXC, 1u << 30);
  set_register(board, UC_ARM_REG_LR, 0xffffffff);
  set_register(board, UC_ARM_REG_SP, load_word(board, 0x08000000));
  set_register(board, UC_ARM_REG_PC, load_word(board, 0x08000004));
}

int core_create(board_t* board, char* error, size_t error_size) {
  uc_err failed = uc_open(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS, &board->uc);
  if (failed) {
    snprintf(error, error_size, "unicorn: %s", uc_strerror(failed));
    return 0;
  }
  uc_ctl_set_cpu_model(board->uc, board->chip->is_f1 ? UC_CPU_ARM_CORTEX_M3 : UC_CPU_ARM_CORTEX_M4);
  uc_hook_add(board->uc, &board->hooks[0], UC_HOOK_BLOCK, (void*)block_begins, board, 1, 0);
  uc_hook_add(board->uc, &board->hooks[1], UC_HOOK_INTR, (void*)interrupted, board, 1, 0);
  uc_hook_add(board->uc, &board->hooks[2], UC_HOOK_MEM_WRITE_PROT, (void*)stored_to_flash, board, 1,
              0);
  return 1;
}
