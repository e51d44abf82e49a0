/* ArduPilot's scripting engine on a Cortex-M4, for the memory of an applet: loads it into a heap of
   a given size and flies a recorded flight, as lua_scripts.cpp does.

     qemu-system-arm -M mps2-an386 -semihosting-config enable=on,target=native,arg=scripting,
       arg=APPLET,arg=RECORD,arg=RESULT,arg=HEAP,arg=FIRMWARE -kernel scripting.elf

   With a HEAP of 0 it looks for the least heap. FIRMWARE: ArduCopter, 4.5, 4.6 or 4.8, see
   heap.py. RESULT gets one line of JSON. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "first_fit.h"
#include "host.h"
#include "lauxlib.h"
#include "lualib.h"
#include "replay.h"

/* lbaselib.c with its table: a script gets some of these functions, see create_sandbox(). */
#include "lbaselib.c"
#include "lstate.h"

#define MOST_BYTES 204800u /* the largest default of SCR_HEAP_SIZE */
#define STEP_BYTES 256u    /* to which the least heap is found */
#define FILE_BYTES (4u * 1024u * 1024u)
#define INSTRUCTIONS_PER_TICK 40u
#define SEEDS 3 /* that must fly in a heap: the order of hashes changes how it is used up */
#define INSTRUCTIONS 10000 /* SCR_VM_I_COUNT: the hook that counts them */

static const char* const base_names[] = {"assert",   "error",    "ipairs", "load",
                                         "next",     "pairs",    "pcall",  "setmetatable",
                                         "tonumber", "tostring", "type"};

static int is_4_5, is_4_6; /* FIRMWARE */

struct file {
  unsigned char* bytes;
  unsigned size;
};

struct flight {
  const char* trouble; /* NULL: flown to its end */
  uint32_t words, load_peak, peak, live, told, most_garbage, updates;
  uint32_t update_ticks, collect_ticks; /* the longest */
};

/* --- The processor -------------------------------------------------------------------------------
 */

extern uint32_t stack_top;
static void reset(void);
static void fault(void) { host_exit(1); }

__attribute__((section(".vectors"), used)) static const void* const vectors[] = {
    &stack_top, (const void*)reset, (const void*)fault, (const void*)fault};

/* With -icount shift=0 an instruction takes 1 ns, and the counter of the board (25 MHz) 40 of them.
 */
static uint32_t ticks(void) { return *(volatile uint32_t*)0x40028018; }

/* --- The engine ----------------------------------------------------------------------------------
 */

static void hook(lua_State* L, lua_Debug* ar) {
  (void)ar;
  luaL_error(L, "Exceeded CPU time");
}

static int no_module(lua_State* L) { return luaL_error(L, "no modules here"); }

/* luaopen_package as ArduPilot cut it down. */
static void open_package(lua_State* L) {
  lua_newtable(L);
  lua_pushstring(L, "/APM/scripts/modules/?.lua;/APM/scripts/modules/?/init.lua");
  lua_setfield(L, -2, "path");
  lua_pushstring(L, "/\n;\n?\n!\n-\n");
  lua_setfield(L, -2, "config");
  luaL_getsubtable(L, -3, "_LOADED");
  lua_setfield(L, -2, "loaded");
  luaL_getsubtable(L, -3, "_PRELOAD");
  lua_setfield(L, -2, "preload");
  lua_pushvalue(L, -1);
  lua_pushcclosure(L, no_module, 1);
  lua_setfield(L, -4, "require");
}

/* Gives the functions of the string library on the stack to all texts. */
static void give_to_texts(lua_State* L) {
  lua_pushliteral(L, "");
  lua_createtable(L, 0, 1);
  lua_pushvalue(L, -3);
  lua_setfield(L, -2, "__index");
  lua_setmetatable(L, -2);
  lua_pop(L, 2);
}

static void create_sandbox(lua_State* L) {
  lua_newtable(L);
  for (unsigned i = 0; i < sizeof base_names / sizeof *base_names; i++) {
    const luaL_Reg* function = base_funcs;
    while (strcmp(function->name, base_names[i]) != 0) function++;
    lua_pushcfunction(L, function->func);
    lua_setfield(L, -2, function->name);
  }
  static const luaL_Reg libraries[] = {{"math", luaopen_math},
                                       {"table", luaopen_table},
                                       {"string", luaopen_string},
                                       {"io", luaopen_io}};
  for (unsigned i = 0; i < sizeof libraries / sizeof *libraries; i++) {
    lua_pushstring(L, libraries[i].name);
    libraries[i].func(L);
    lua_settable(L, -3);
  }
  if (is_4_5 || is_4_6) {
    lua_pushstring(L, "utf8");
    luaopen_utf8(L);
    lua_settable(L, -3);
  }
  lua_pushstring(L, "package");
  open_package(L);
  lua_settable(L, -3);
  if (is_4_5) {
    lua_getfield(L, -1, "string"); /* texts have the functions of the newest script */
    give_to_texts(L);
    replay_open_4_5(L);
  } else {
    replay_open(L);
  }
}

static void most(uint32_t* value, uint32_t candidate) {
  if (candidate > *value) *value = candidate;
}

static uint32_t entries(Table* table) {
  uint32_t count = 0;
  for (int i = 0; i < sizenode(table); i++) count += !ttisnil(&table->node[i].i_val);
  return count;
}

/* The compiler's table of the words in a script, its largest table, is still there after it. */
static uint32_t count_words(lua_State* L) {
  uint32_t most_entries = 0;
  for (GCObject* object = G(L)->allgc; object != NULL; object = object->next) {
    if (object->tt == LUA_TTABLE) most(&most_entries, entries(gco2t(object)));
  }
  return most_entries;
}

struct job {
  struct file script;
  struct flight* flight;
};

/* run_next_script: the function is kept in the registry between its runs. */
static int run_update(lua_State* L, int function) {
  const int top = lua_gettop(L);
  lua_sethook(L, hook, LUA_MASKCOUNT, INSTRUCTIONS);
  lua_rawgeti(L, LUA_REGISTRYINDEX, function);
  lua_call(L, 0, LUA_MULTRET);
  if (lua_gettop(L) - top != 2) luaL_error(L, "the script ended");
  lua_pop(L, 1);
  luaL_unref(L, LUA_REGISTRYINDEX, function);
  return luaL_ref(L, LUA_REGISTRYINDEX);
}

static int fly(lua_State* L) {
  const struct job* job = lua_touserdata(L, 1);
  struct flight* flight = job->flight;
  lua_pop(L, 1);
  if (is_4_5) replay_define_globals_4_5(L);
  if (is_4_6) replay_define_classes(L);
  if (!is_4_5) {
    luaopen_string(L);
    give_to_texts(L);
  }
  char* name = heap_change_size(NULL, NULL, 0, sizeof "/APM/scripts/echowing.lua");
  if (name == NULL) return luaL_error(L, "not enough memory");
  strcpy(name, "/APM/scripts/echowing.lua");
  heap_change_size(NULL, NULL, 0, 32); /* script_info */
  const char* source = (const char*)job->script.bytes;
  if (luaL_loadbuffer(L, source, job->script.size, "@/APM/scripts/echowing.lua")) lua_error(L);
  flight->words = count_words(L);
  create_sandbox(L);
  lua_pushvalue(L, -1);
  lua_setupvalue(L, -3, 1);
  luaL_ref(L, LUA_REGISTRYINDEX);
  int function = luaL_ref(L, LUA_REGISTRYINDEX);
  flight->load_peak = heap_figures.peak;
  do {
    const uint32_t before = heap_figures.used, start = ticks();
    function = run_update(L, function);
    const uint32_t middle = ticks();
    if (flight->updates > 0) {
      most(&flight->told, (uint32_t)lua_gc(L, LUA_GCCOUNT, 0) * 1024 + lua_gc(L, LUA_GCCOUNTB, 0));
      most(&flight->most_garbage, heap_figures.used - before);
      most(&flight->update_ticks, middle - start);
    }
    lua_gc(L, LUA_GCCOLLECT, 0);
    if (flight->updates > 0) most(&flight->collect_ticks, ticks() - middle);
    most(&flight->live, heap_figures.used);
    flight->updates++;
  } while (!heap_figures.out_of_memory && replay_next_update());
  return 0;
}

unsigned hash_seed; /* of the next state, see heap.py */

static struct flight try_seed(struct file script, struct file record, uint32_t heap_bytes) {
  static char text[200];
  struct flight flight = {0};
  struct job job = {script, &flight};
  heap_create(heap_bytes);
  replay_begin(record.bytes, record.size);
  lua_State* L = lua_newstate(heap_change_size, NULL);
  if (L == NULL) {
    flight.trouble = "not enough memory for Lua";
    return flight;
  }
  lua_pushcfunction(L, fly);
  lua_pushlightuserdata(L, &job);
  if (lua_pcall(L, 1, 0, 0) != LUA_OK) {
    snprintf(text, sizeof text, "%s", lua_tostring(L, -1));
    flight.trouble = text;
  } else if (heap_figures.out_of_memory) {
    flight.trouble = "not enough memory in flight";
  } else {
    flight.trouble = replay_trouble();
  }
  flight.peak = heap_figures.peak;
  return flight; /* Lua's state goes with its heap */
}

/* The flight with the first seed; or the one that fails. */
static struct flight try_heap(struct file script, struct file record, uint32_t heap_bytes) {
  struct flight first = {0};
  for (hash_seed = 0; hash_seed < SEEDS; hash_seed++) {
    const struct flight flight = try_seed(script, record, heap_bytes);
    if (flight.trouble != NULL) return flight;
    if (hash_seed == 0) first = flight;
  }
  return first;
}

/* --- From and to the host ------------------------------------------------------------------------
 */

static struct file read_file(const char* name, unsigned char* to) {
  return (struct file){to, host_read(name, to, FILE_BYTES)};
}

static int flies_in(struct file script, struct file record, uint32_t heap_bytes) {
  hash_seed = heap_bytes / STEP_BYTES % SEEDS; /* one at a time: it takes long enough */
  return try_seed(script, record, heap_bytes).trouble == NULL;
}

/* The heap from which on it flies in every larger one, up to a little more than all it ever uses.
   Step by step: what flies in one heap may find no hole in a somewhat larger one, where blocks lie
   elsewhere. */
static uint32_t least_heap(struct file script, struct file record, uint32_t peak) {
  uint32_t flies = (peak + peak / 16) / STEP_BYTES * STEP_BYTES;
  while (!flies_in(script, record, flies)) flies += STEP_BYTES;
  while (flies_in(script, record, flies - STEP_BYTES)) flies -= STEP_BYTES;
  return flies;
}

/* A text as JSON wants it. */
static const char* quoted(const char* text) {
  static char quoted_text[200];
  if (text == NULL) return "null";
  snprintf(quoted_text, sizeof quoted_text, "\"%s\"", text);
  for (char* c = quoted_text + 1; c[0] != '\0' && c[1] != '\0'; c++) {
    if (*c == '"' || *c == '\\' || *c < ' ') *c = '\'';
  }
  return quoted_text;
}

static void tell(const char* name, const struct flight* flight, uint32_t least_bytes) {
  static char line[600];
  snprintf(line, sizeof line,
           "{\"trouble\": %s, \"words\": %lu, \"least_bytes\": %lu, \"live_bytes\": %lu, "
           "\"load_peak_bytes\": %lu, \"peak_bytes\": %lu, \"told_bytes\": %lu, "
           "\"garbage_bytes\": %lu, \"updates\": %lu, \"update_instructions\": %lu, "
           "\"collect_instructions\": %lu}\n",
           quoted(flight->trouble), flight->words, least_bytes, flight->live, flight->load_peak,
           flight->peak, flight->told, flight->most_garbage, flight->updates,
           flight->update_ticks * INSTRUCTIONS_PER_TICK,
           flight->collect_ticks * INSTRUCTIONS_PER_TICK);
  host_write(name, line);
}

static void run(void) {
  static unsigned char script_bytes[FILE_BYTES], record_bytes[FILE_BYTES];
  char* words[6];
  if (host_arguments(words, 6) != 6) host_exit(1);
  const struct file script = read_file(words[1], script_bytes);
  const struct file record = read_file(words[2], record_bytes);
  const uint32_t heap_bytes = strtoul(words[4], NULL, 10);
  is_4_5 = strcmp(words[5], "4.5") == 0;
  is_4_6 = strcmp(words[5], "4.6") == 0;
  const struct flight flight = try_heap(script, record, heap_bytes > 0 ? heap_bytes : MOST_BYTES);
  const int look = heap_bytes == 0 && flight.trouble == NULL;
  tell(words[3], &flight, look ? least_heap(script, record, flight.peak) : 0);
  host_exit(0);
}

static void reset(void) {
  *(volatile uint32_t*)0xE000ED88 |= 0xFu << 20; /* CPACR: the floating point unit */
  __asm__ volatile("dsb\n isb");
  run();
}
