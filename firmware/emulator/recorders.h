/* What both kinds of board keep of their ports: edges of pins, bytes on their way. */
#ifndef ECHOWING_RECORDERS_H
#define ECHOWING_RECORDERS_H

#include "board.h"

enum { EDGES_KEPT = 1024 }; /* for each pin; older ones are dropped */

typedef struct {
  board_pin_t state;
  board_edge_t edges[EDGES_KEPT];
  size_t first, count;
} pin_record_t;

void record_level(pin_record_t* record, uint64_t tick, int level);
size_t take_edges(pin_record_t* record, board_edge_t* out, size_t size);

/* Bytes on their way to a receiver. */
typedef struct {
  uint8_t* bytes;
  size_t first, count, size;
} inbox_t;

void inbox_add(inbox_t* inbox, const uint8_t* bytes, size_t count);
uint8_t inbox_next(inbox_t* inbox); /* only while count is not 0 */
void inbox_free(inbox_t* inbox);

/* Bytes sent, each with the tick at which its stop bit ends. */
typedef struct {
  uint8_t* bytes;
  uint64_t* ticks;
  size_t count, size;
} outbox_t;

void outbox_add(outbox_t* outbox, uint8_t byte, uint64_t tick);
size_t outbox_take(outbox_t* outbox, uint64_t now, uint8_t* bytes, uint64_t* ticks, size_t size);
void outbox_free(outbox_t* outbox);

#endif
