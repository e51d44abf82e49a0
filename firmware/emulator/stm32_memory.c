/* Flash that is programmed and erased as the chip does it, and the independent watchdog. */
#include <stdlib.h>
#include <string.h>

#include "stm32.h"

enum {
  PROGRAM = 1u << 0, /* CR */
  ERASE = 1u << 1,
  F1_START = 1u << 6,
  F4_START = 1u << 16,
  F1_LOCK = 1u << 7,
  ERASED = 0xff,
  HALF_ERASED =
      0x55, /* what an erase cut short leaves is anybody's guess; old bits with some ones */
};
#define F4_LOCK (1u << 31)
#define KEY_1 0x45670123u
#define KEY_2 0xcdef89abu
#define FLASH_BASE 0x08000000u

static uint32_t lock_bit(const board_t* board) { return board->chip->is_f1 ? F1_LOCK : F4_LOCK; }

static void put(board_t* board, uint32_t offset, const void* data, uint32_t size) {
  memcpy(board->image + offset, data, size);
  uc_mem_write(board->uc, FLASH_BASE + offset, data, size);
}

/* What is left at `offset` of a byte, if what goes on now is cut short. */
static uint8_t left_of(const board_t* board, uint32_t offset) {
  const flash_t* flash = &board->flash;
  uint8_t byte = board->image[offset];
  if (flash->busy_until <= board->now) return byte;
  if (offset - flash->erasing < flash->erasing_size) byte |= HALF_ERASED;
  if (offset - flash->burning < flash->burning_size)
    byte |= flash->old[offset - flash->burning] & HALF_ERASED;
  return byte;
}

static void spoil(board_t* board, uint32_t offset, uint32_t size) {
  uint8_t* left = malloc(size);
  for (uint32_t i = 0; i < size; i++) left[i] = left_of(board, offset + i);
  put(board, offset, left, size);
  free(left);
}

/* A reset cuts short what was begun. */
void flash_reset(board_t* board) {
  flash_t* flash = &board->flash;
  if (flash->erasing_size) spoil(board, flash->erasing, flash->erasing_size);
  if (flash->burning_size) spoil(board, flash->burning, flash->burning_size);
  memset(flash, 0, sizeof *flash);
  flash->cr = lock_bit(board);
}

/* ---- registers: the F4 has OPTKEYR where the F1 has it, then SR, CR and OPTCR; the F1 also AR */

uint32_t flash_read(board_t* board, uint32_t offset) {
  const flash_t* flash = &board->flash;
  switch (offset) {
    case 0x00: return flash->acr;
    case 0x0c: return flash->sr;
    case 0x10: return flash->cr;
    case 0x14: return board->chip->is_f1 ? flash->ar : 0x0fffaaed;
    case 0x1c: /* F1: option bytes, not protected */ return 0x03fffffc;
    case 0x20: return 0xffffffff;
  }
  return 0;
}

static void unlock(board_t* board, uint32_t key) {
  flash_t* flash = &board->flash;
  if (flash->key_step == 0 && key == KEY_1) {
    flash->key_step = 1;
    return;
  }
  if (flash->key_step == 1 && key == KEY_2) flash->cr &= ~lock_bit(board);
  flash->key_step = 0;
}

static int find_block(const board_t* board, uint32_t* offset, uint32_t* size) {
  const flash_t* flash = &board->flash;
  if (board->chip->is_f1) {
    *size = 1024;
    *offset = (flash->ar - FLASH_BASE) & ~1023u;
  } else {
    uint32_t sector = flash->cr >> 3 & 15;
    *size = sector < 4 ? 0x4000 : sector == 4 ? 0x10000 : 0x20000;
    *offset = sector < 4 ? sector * 0x4000 : sector == 4 ? 0x10000 : (sector - 4) * 0x20000;
  }
  return *offset < board->chip->flash_size;
}

static void start_erase(board_t* board) {
  flash_t* flash = &board->flash;
  uint32_t offset, size;
  if (!(flash->cr & ERASE) || !find_block(board, &offset, &size)) return;
  flash->erasing = offset;
  flash->erasing_size = size;
  flash->busy_until = board->now + US(board->erase_us);
  core_attend(board);
}

void flash_write(board_t* board, uint32_t offset, uint32_t value) {
  flash_t* flash = &board->flash;
  uint32_t start = board->chip->is_f1 ? F1_START : F4_START;
  switch (offset) {
    case 0x00: flash->acr = value; break;
    case 0x04: unlock(board, value); break;
    case 0x0c: /* flags are cleared by writing ones */ flash->sr &= ~value; break;
    case 0x10:
      if (flash->cr & lock_bit(board)) break;
      flash->cr = value & ~start;
      if (value & start) start_erase(board);
      break;
    case 0x14: flash->ar = value; break;
  }
}

/* ---- programming: a store to the flash, which only turns ones into zeros */

void flash_store(board_t* board, uint32_t offset, uint32_t size, uint32_t value) {
  flash_t* flash = &board->flash;
  if (flash->cr & lock_bit(board) || !(flash->cr & PROGRAM)) {
    board_complain(board, "the program writes to flash at 0x%08x without leave",
                   FLASH_BASE + offset);
    return;
  }
  if (offset + size > board->chip->flash_size || flash->pending_count == PENDING_WRITES) return;
  flash->pending[flash->pending_count].offset = offset;
  flash->pending[flash->pending_count].size = size;
  flash->pending[flash->pending_count++].value = value;
}

void flash_apply(board_t* board) {
  flash_t* flash = &board->flash;
  for (int i = 0; i < flash->pending_count; i++) {
    uint32_t offset = flash->pending[i].offset, size = flash->pending[i].size, word = 0;
    memcpy(flash->old, board->image + offset, size);
    memcpy(&word, board->image + offset, size);
    word &= flash->pending[i].value;
    put(board, offset, &word, size);
    flash->burning = offset;
    flash->burning_size = size;
    uint64_t start = flash->busy_until > board->now ? flash->busy_until : board->now;
    flash->busy_until = start + NS(board->chip->program_ns) * size / board->chip->program_bytes;
  }
  flash->pending_count = 0;
}

void flash_step(board_t* board) {
  flash_t* flash = &board->flash;
  if (flash->busy_until > board->now) return;
  flash->burning_size = 0;
  if (!flash->erasing_size) return;
  uint8_t erased[1024];
  memset(erased, ERASED, sizeof erased);
  for (uint32_t done = 0; done < flash->erasing_size; done += sizeof erased)
    put(board, flash->erasing + done, erased, sizeof erased);
  flash->erasing_size = 0;
}

/* ---- the blocks with the parameters, as a power cut leaves them */

static uint32_t memory_start(const board_t* board) {
  return board->chip->flash_size - board_memory_size(board);
}

uint32_t board_memory_size(const board_t* board) { return 2 * board->chip->slot_size; }

int board_memory_set(board_t* board, const uint8_t* data, size_t size) {
  if (size > board_memory_size(board)) return -1;
  put(board, memory_start(board), data, size);
  return 0;
}

int board_memory_get(const board_t* board, uint8_t* data, size_t size) {
  if (size > board_memory_size(board)) return -1;
  uint32_t start = memory_start(board);
  for (uint32_t i = 0; i < size; i++) data[i] = left_of(board, start + i);
  return 0;
}

/* ---- the watchdog: counts down at a rate of its own, and restarts the program at 0 */

enum { KR = 0x00, PR = 0x04, RLR = 0x08 };

static uint64_t count_time(const board_t* board) {
  return (uint64_t)(4u << (board->iwdg.pr & 7)) * SECOND / board->chip->lsi_hz;
}

uint64_t iwdg_due(const board_t* board) {
  const iwdg_t* iwdg = &board->iwdg;
  return iwdg->running ? iwdg->since + (iwdg->count + 1) * count_time(board) : NEVER;
}

uint32_t board_watchdog_us(const board_t* board) {
  const iwdg_t* iwdg = &board->iwdg;
  return iwdg->running ? (uint32_t)((iwdg->rlr + 1) * count_time(board) / US(1)) : 0;
}

static void count_from(board_t* board, uint32_t count) {
  board->iwdg.count = count;
  board->iwdg.since = board->now;
}

uint32_t iwdg_read(board_t* board, uint32_t offset) {
  if (offset == PR) return board->iwdg.pr;
  return offset == RLR ? board->iwdg.rlr : 0;
}

void iwdg_write(board_t* board, uint32_t offset, uint32_t value) {
  iwdg_t* iwdg = &board->iwdg;
  if (offset == KR) {
    iwdg->kr = value;
    if (value == 0xcccc && !iwdg->running) {
      iwdg->running = 1;
      count_from(board, iwdg->rlr);
    }
    if (value == 0xaaaa) {
      count_from(board, iwdg->rlr);
      board_count_turn(board);
    }
  } else if (iwdg->kr == 0x5555 && offset == PR) {
    uint64_t counted = (board->now - iwdg->since) / count_time(board);
    count_from(board, counted > iwdg->count ? 0 : iwdg->count - (uint32_t)counted);
    iwdg->pr = value & 7;
  } else if (iwdg->kr == 0x5555 && offset == RLR) {
    iwdg->rlr = value & 0xfff;
  }
  core_schedule(board, iwdg_due(board));
}
