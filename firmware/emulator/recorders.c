#include "recorders.h"

#include <stdlib.h>
#include <string.h>

void record_level(pin_record_t* record, uint64_t tick, int level) {
  board_pin_t* state = &record->state;
  if (level == state->level) return;
  state->level = level;
  if (level) {
    state->period_ticks = state->rise_tick ? tick - state->rise_tick : 0;
    state->rise_tick = tick;
  } else if (state->rise_tick) {
    state->width_ticks = tick - state->rise_tick;
    state->pulses++;
  }
  record->edges[(record->first + record->count) % EDGES_KEPT] =
      (board_edge_t){tick, (uint8_t)level};
  if (record->count < EDGES_KEPT)
    record->count++;
  else
    record->first = (record->first + 1) % EDGES_KEPT;
}

size_t take_edges(pin_record_t* record, board_edge_t* out, size_t size) {
  size_t count = 0;
  for (; count < size && record->count; count++, record->count--) {
    out[count] = record->edges[record->first];
    record->first = (record->first + 1) % EDGES_KEPT;
  }
  return count;
}

void inbox_add(inbox_t* inbox, const uint8_t* bytes, size_t count) {
  if (inbox->first + inbox->count + count > inbox->size) {
    if (inbox->count) memmove(inbox->bytes, inbox->bytes + inbox->first, inbox->count);
    inbox->first = 0;
    if (inbox->count + count > inbox->size) {
      inbox->size = 2 * (inbox->count + count);
      inbox->bytes = realloc(inbox->bytes, inbox->size);
    }
  }
  memcpy(inbox->bytes + inbox->first + inbox->count, bytes, count);
  inbox->count += count;
}

uint8_t inbox_next(inbox_t* inbox) {
  inbox->count--;
  return inbox->bytes[inbox->first++];
}

void inbox_free(inbox_t* inbox) { free(inbox->bytes); }

void outbox_add(outbox_t* outbox, uint8_t byte, uint64_t tick) {
  if (outbox->count == outbox->size) {
    outbox->size = outbox->size ? 2 * outbox->size : 4096;
    outbox->bytes = realloc(outbox->bytes, outbox->size);
    outbox->ticks = realloc(outbox->ticks, outbox->size * sizeof *outbox->ticks);
  }
  outbox->bytes[outbox->count] = byte;
  outbox->ticks[outbox->count++] = tick;
}

size_t outbox_take(outbox_t* outbox, uint64_t now, uint8_t* bytes, uint64_t* ticks, size_t size) {
  size_t count = outbox->count < size ? outbox->count : size;
  while (count && outbox->ticks[count - 1] > now) count--; /* its stop bit has not passed yet */
  if (count == 0) return 0;
  memcpy(bytes, outbox->bytes, count);
  if (ticks) memcpy(ticks, outbox->ticks, count * sizeof *ticks);
  outbox->count -= count;
  memmove(outbox->bytes, outbox->bytes + count, outbox->count);
  memmove(outbox->ticks, outbox->ticks + count, outbox->count * sizeof *outbox->ticks);
  return count;
}

void outbox_free(outbox_t* outbox) {
  free(outbox->bytes);
  free(outbox->ticks);
}
