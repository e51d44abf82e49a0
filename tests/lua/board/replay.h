/* What the vehicle answered in a flight that was recorded: see tests/lua/heap.py for the format. */
#pragma once

#include "lua.h"

/* Begins the flight anew. */
void replay_begin(const unsigned char* record, unsigned size);

/* Whether another update follows. */
int replay_next_update(void);

/* What the script did that the record has not; NULL: nothing. */
const char* replay_trouble(void);

/* load_generated_bindings() of 4.6: all classes from the start, used or not. */
void replay_define_classes(lua_State* L);

/* The same of 4.5: all singletons too, and an object of each. */
void replay_define_globals_4_5(lua_State* L);

/* Where the bindings' globals come from: the sandbox, on the stack, gets its metatable. */
void replay_open(lua_State* L);

/* The same of 4.5: the sandbox gets all of them. */
void replay_open_4_5(lua_State* L);
