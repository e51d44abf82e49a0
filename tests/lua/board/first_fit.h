/* A heap as ChibiOS keeps one for ArduPilot's scripts: the first free block that is large enough.
 */
#pragma once

#include <stdint.h>

/* What was asked of the heap; bytes count headers and alignment. */
struct heap_figures {
  uint32_t used, peak;
  int refused;       /* the newest request; Lua then collects, and asks again */
  int out_of_memory; /* and was refused again */
};

extern struct heap_figures heap_figures;

void heap_create(uint32_t size);

/* As Lua wants an allocator (lua_Alloc); MultiHeap::change_size never resizes a block in place. */
void* heap_change_size(void* unused, void* block, unsigned old_size, unsigned new_size);
