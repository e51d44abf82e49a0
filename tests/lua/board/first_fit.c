#include "first_fit.h"

#include <stddef.h>
#include <string.h>

/* As chmemheaps.c on a 32-bit processor: a header of 8 bytes before each block, and blocks of whole
   8 bytes. Free blocks are in the order of their addresses, and neighbours are joined. */
#define UNIT 8u
#define MOST_BYTES (1024u * 1024u) /* the most that SCR_HEAP_SIZE can say */

struct block {
  struct block* next; /* of a free block */
  uint32_t units;     /* that follow this header */
};
_Static_assert(sizeof(struct block) == UNIT, "a header is one unit");

static _Alignas(UNIT) uint8_t memory[MOST_BYTES];
static struct block first; /* heads the list, has no units */
struct heap_figures heap_figures;

static struct block* end_of(struct block* block) { return block + 1 + block->units; }

void heap_create(uint32_t size) {
  struct block* all = (struct block*)memory;
  all->next = NULL;
  all->units = (size - sizeof *all) / UNIT;
  first.next = all;
  heap_figures = (struct heap_figures){0};
}

static void count(int32_t units) {
  heap_figures.used += (uint32_t)(units * (int32_t)UNIT);
  if (heap_figures.used > heap_figures.peak) heap_figures.peak = heap_figures.used;
}

/* Takes `units` from a free block, and leaves the rest of it in the list. */
static void* take(struct block* before, uint32_t units) {
  struct block* found = before->next;
  if (found->units == units) {
    before->next = found->next;
  } else {
    struct block* rest = found + 1 + units;
    rest->next = found->next;
    rest->units = found->units - units - 1;
    before->next = rest;
    found->units = units;
  }
  count((int32_t)units + 1);
  return found + 1;
}

static void* allocate(uint32_t size) {
  const uint32_t units = (size + UNIT - 1) / UNIT;
  for (struct block* before = &first; before->next != NULL; before = before->next) {
    if (before->next->units >= units) return take(before, units);
  }
  return NULL;
}

static void join(struct block* block) {
  if (block->next != end_of(block)) return;
  block->units += block->next->units + 1;
  block->next = block->next->next;
}

static void release(void* pointer) {
  struct block* block = (struct block*)pointer - 1;
  struct block* before = &first;
  while (before->next != NULL && before->next < block) before = before->next;
  count(-(int32_t)block->units - 1);
  block->next = before->next;
  before->next = block;
  join(block);
  if (before != &first) join(before);
}

void* heap_change_size(void* unused, void* block, unsigned old_size, unsigned new_size) {
  (void)unused;
  if (new_size == 0) {
    if (block != NULL) release(block);
    return NULL;
  }
  if (block == NULL) old_size = 0; /* then it is Lua's word for what the block is for */
  void* found = allocate(new_size);
  if (new_size > old_size) {
    heap_figures.out_of_memory |= heap_figures.refused && found == NULL;
    heap_figures.refused = found == NULL;
  }
  if (block == NULL) return found;
  if (found == NULL) return new_size > old_size ? NULL : block; /* shrinking never fails */
  memcpy(found, block, old_size < new_size ? old_size : new_size);
  release(block);
  return found;
}
