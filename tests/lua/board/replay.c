#include "replay.h"

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "lauxlib.h"

#define MOST_BINDINGS 128

/* The userdata of ArduPilot's bindings and what they hold, at 32 bits: lua_generated_bindings.cpp,
   AP_Scripting_helpers.h, Location.h. An RC_Channel is a pointer. Behind those that applets use the
   others of a Copter 4.5, but for the network's, and what 4.6 has besides. */
static const struct {
  const char* name;
  unsigned size;
} classes[] = {{"uint32_t", 4},
               {"Vector3f", 12},
               {"Vector2f", 8},
               {"Location", 16},
               {"Parameter", 8},
               {"RC_Channel", 4},
               {"Quaternion", 16},
               {"stat_t", 0},
               {"EFI_State", 0},
               {"Cylinder_Status", 0},
               {"AP_Camera::camera_state_t", 0},
               {"CANFrame", 0},
               {"motor_factor_table", 0},
               {"mavlink_mission_item_int_t", 0},
               {"ESCTelemetryData", 0},
               {"AP_Scripting_SerialAccess", 0},
               {"RangeFinder_State", 24},
               {"BattMonitorScript_State", 0},
               {"AP_EFI_Backend", 0},
               {"ScriptingCANBuffer", 0},
               {"AP_HAL::PWMSource", 0},
               {"AP_HAL::AnalogSource", 0},
               {"AP_HAL::I2CDevice", 0},
               {"AP_RangeFinder_Backend", 4},
               {"AP_Proximity_Backend", 0},
               {"uint64_t", 8},
               {"mavlink_video_stream_information_t", 0},
               {"mavlink_camera_information_t", 0}};
enum { UINT32, VECTOR3F, VECTOR2F, QUATERNION = 6, UINT64 = 25 };
enum { CLASSES_4_5 = UINT64, CLASSES = sizeof classes / sizeof *classes };

/* The globals of a Copter 4.5 (bindings.desc), but for the network's; a name ends with a zero, the
   list with two. */
static const char singletons_4_5[] =
    "ahrs\0arming\0battery\0gps\0notify\0proximity\0rangefinder\0terrain\0relay\0gcs\0vehicle\0"
    "serialLED\0SRV_Channels\0rc\0serial\0baro\0optical_flow\0esc_telem\0param\0scripting\0"
    "mission\0RPM\0button\0LED\0MotorsMatrix\0frsky_sport\0attitude_control\0Motors_6DoF\0gpio\0"
    "analog\0Motors_dynamic\0ins\0CAN\0motors\0FWVersion\0follow\0AC_AttitudeControl\0mount\0"
    "camera\0winch\0iomcu\0compass\0efi\0logger\0i2c\0mavlink\0fence\0fs\0rtc\0";
static const char functions_4_5[] =
    "Location\0BattMonitorScript_State\0Vector3f\0Vector2f\0Quaternion\0RangeFinder_State\0"
    "Parameter\0ESCTelemetryData\0motor_factor_table\0mavlink_mission_item_int_t\0CANFrame\0"
    "Cylinder_Status\0EFI_State\0uint32_t\0stat_t\0PWMSource\0millis\0micros\0dirlist\0"
    "mission_receive\0remove\0print\0";

static struct {
  const char *owner, *name;
} bindings[MOST_BINDINGS];
static unsigned binding_count;
static const unsigned char *at, *end;
static char trouble[120];

static unsigned byte(void) { return at < end ? *at++ : 0; }

static uint32_t word(void) {
  uint32_t value = 0;
  for (unsigned shift = 0; shift < 32; shift += 8) value |= (uint32_t)byte() << shift;
  return value;
}

/* A text that ends with a zero. */
static const char* text(void) {
  const char* start = (const char*)at;
  while (byte() != 0) {
  }
  return start;
}

void replay_begin(const unsigned char* record, unsigned size) {
  at = record;
  end = record + size;
  trouble[0] = '\0';
  binding_count = byte();
  for (unsigned i = 0; i < binding_count; i++) {
    bindings[i].owner = text();
    bindings[i].name = text();
  }
}

const char* replay_trouble(void) { return trouble[0] != '\0' ? trouble : NULL; }

int replay_next_update(void) {
  if (at < end && *at++ != 'U' && trouble[0] == '\0') {
    strcpy(trouble, "an update ended before the recorded one");
  }
  return at < end;
}

/* --- uint32_t: the one class that calculates -----------------------------------------------------
 */

static void push_object(lua_State* L, unsigned class);

static int push_uint32(lua_State* L, uint32_t value) {
  push_object(L, UINT32);
  *(uint32_t*)lua_touserdata(L, -1) = value;
  return 1;
}

static uint32_t to_uint32(lua_State* L, int index) {
  const uint32_t* boxed = luaL_testudata(L, index, "uint32_t");
  if (boxed != NULL) return *boxed;
  if (lua_isinteger(L, index)) return (uint32_t)lua_tointeger(L, index);
  return (uint32_t)luaL_checknumber(L, index);
}

#define CALCULATES(name, sign) \
  static int name(lua_State* L) { return push_uint32(L, to_uint32(L, 1) sign to_uint32(L, 2)); }
#define COMPARES(name, sign)                                  \
  static int name(lua_State* L) {                             \
    lua_pushboolean(L, to_uint32(L, 1) sign to_uint32(L, 2)); \
    return 1;                                                 \
  }
CALCULATES(add, +)
CALCULATES(subtract, -)
CALCULATES(multiply, *)
CALCULATES(divide, /)
CALCULATES(modulo, %)
CALCULATES(both, &)
CALCULATES(either, |)
CALCULATES(differ, ^)
CALCULATES(left, <<)
CALCULATES(right, >>)
COMPARES(equal, ==)
COMPARES(less, <)
COMPARES(less_or_equal, <=)

static int invert(lua_State* L) { return push_uint32(L, ~to_uint32(L, 1)); }

static int write_out(lua_State* L) {
  char digits[12];
  snprintf(digits, sizeof digits, "%lu", (unsigned long)to_uint32(L, 1));
  lua_pushstring(L, digits);
  return 1;
}

static const luaL_Reg uint32_operators[] = {
    {"__add", add},     {"__sub", subtract},     {"__mul", multiply}, {"__div", divide},
    {"__mod", modulo},  {"__idiv", divide},      {"__band", both},    {"__bor", either},
    {"__bxor", differ}, {"__shl", left},         {"__shr", right},    {"__eq", equal},
    {"__lt", less},     {"__le", less_or_equal}, {"__bnot", invert},  {"__tostring", write_out},
    {NULL, NULL}};
static const luaL_Reg vector_operators[] = {{"__add", add}, {"__sub", subtract}, {NULL, NULL}};
static const luaL_Reg quaternion_operators[] = {{"__mul", multiply}, {NULL, NULL}};

static const luaL_Reg* operators_of(unsigned class) {
  switch (class) {
    case UINT32:
    case UINT64: return uint32_operators; /* all but __idiv */
    case VECTOR2F:
    case VECTOR3F: return vector_operators;
    case QUATERNION: return quaternion_operators;
    default: return NULL;
  }
}

/* --- Bindings: each answers as it did when the flight was recorded -------------------------------
 */

static void push_value(lua_State* L) {
  const unsigned kind = byte();
  switch (kind) {
    case 'n': lua_pushnil(L); return;
    case 'b': lua_pushboolean(L, (int)byte()); return;
    case 'i': lua_pushinteger(L, (lua_Integer)word()); return;
    case 'u': push_uint32(L, word()); return;
    case 'o': push_object(L, byte()); return;
    case 'f': {
      const uint32_t bits = word();
      float value;
      memcpy(&value, &bits, sizeof value);
      lua_pushnumber(L, value);
      return;
    }
    case 's': {
      const uint32_t length = word();
      lua_pushlstring(L, (const char*)at, length);
      at += length;
      return;
    }
    default: luaL_error(L, "bad record");
  }
}

static int answer(lua_State* L, unsigned number) {
  if (at < end && at[0] == 'C' && at[1] == number) {
    at += 2;
    const unsigned values = byte();
    for (unsigned i = 0; i < values; i++) push_value(L);
    return (int)values;
  }
  if (trouble[0] == '\0') {
    const unsigned wanted = at < end && at[0] == 'C' ? at[1] : number;
    snprintf(trouble, sizeof trouble, "called %s:%s, recorded is %s:%s", bindings[number].owner,
             bindings[number].name, wanted == number ? "the end of" : bindings[wanted].owner,
             wanted == number ? "the update" : bindings[wanted].name);
  }
  return luaL_error(L, "%s", trouble);
}

/* On the vehicle a binding is a C function without upvalues: one each here, too. */
#define ONE(n) \
  static int binding_##n(lua_State* L) { return answer(L, 0##n); }
#define EIGHT(n) ONE(n##0) ONE(n##1) ONE(n##2) ONE(n##3) ONE(n##4) ONE(n##5) ONE(n##6) ONE(n##7)
EIGHT(0)
EIGHT(1) EIGHT(2) EIGHT(3) EIGHT(4) EIGHT(5) EIGHT(6) EIGHT(7) EIGHT(10) EIGHT(11) EIGHT(12)
    EIGHT(13) EIGHT(14) EIGHT(15) EIGHT(16) EIGHT(17)
#undef ONE
#define ONE(n) binding_##n,
        static const lua_CFunction functions[MOST_BINDINGS] = {
            EIGHT(0) EIGHT(1) EIGHT(2) EIGHT(3) EIGHT(4) EIGHT(5) EIGHT(6) EIGHT(7) EIGHT(10)
                EIGHT(11) EIGHT(12) EIGHT(13) EIGHT(14) EIGHT(15) EIGHT(16) EIGHT(17)};

static int push_function(lua_State* L, const char* owner, const char* name) {
  for (unsigned i = 0; i < binding_count; i++) {
    if (strcmp(bindings[i].owner, owner) == 0 && strcmp(bindings[i].name, name) == 0) {
      lua_pushcfunction(L, functions[i]);
      return 1;
    }
  }
  return 0;
}

static int is_owner(const char* name) {
  for (unsigned i = 0; i < binding_count; i++) {
    if (strcmp(bindings[i].owner, name) == 0) return 1;
  }
  return 0;
}

/* __index of singletons and userdata. */
static int method_index(lua_State* L) {
  luaL_getmetafield(L, 1, "__name");
  return push_function(L, lua_tostring(L, -1), luaL_checkstring(L, 2));
}

static void define(lua_State* L, const char* name, const luaL_Reg* operators) {
  if (luaL_newmetatable(L, name)) {
    lua_pushcfunction(L, method_index);
    lua_setfield(L, -2, "__index");
    if (operators != NULL) luaL_setfuncs(L, operators, 0);
  }
}

static void push_object(lua_State* L, unsigned class) {
  if (class >= CLASSES) luaL_error(L, "bad record");
  memset(lua_newuserdata(L, classes[class].size), 0, classes[class].size);
  define(L, classes[class].name, operators_of(class));
  lua_setmetatable(L, -2);
}

void replay_define_classes(lua_State* L) {
  for (unsigned class = 0; class < CLASSES; class++) {
    define(L, classes[class].name, operators_of(class));
    lua_pop(L, 1);
  }
}

static const char* next(const char* name) { return name + strlen(name) + 1; }

/* A class that can be called, and an object of it among the engine's globals. */
static void define_global(lua_State* L, const char* name, const luaL_Reg* operators) {
  define(L, name, operators);
  lua_pushvalue(L, -1);
  lua_setfield(L, -2, "__call");
  lua_newuserdata(L, 0);
  lua_pushvalue(L, -2);
  lua_setmetatable(L, -2);
  lua_setglobal(L, name);
  lua_pop(L, 1);
}

void replay_define_globals_4_5(lua_State* L) {
  for (unsigned class = 0; class < CLASSES_4_5; class++) {
    define_global(L, classes[class].name, operators_of(class));
  }
  for (const char* name = singletons_4_5; *name; name = next(name)) define_global(L, name, NULL);
}

static int not_recorded(lua_State* L) { return luaL_error(L, "not recorded"); }

void replay_open_4_5(lua_State* L) {
  for (const char* name = singletons_4_5; *name; name = next(name)) {
    lua_getglobal(L, name);
    lua_setfield(L, -2, name);
  }
  for (const char* name = functions_4_5; *name; name = next(name)) {
    if (!push_function(L, "", name)) lua_pushcfunction(L, not_recorded);
    lua_setfield(L, -2, name);
  }
}

/* generated_cpp_loader.h: what a script names first is made then, and kept among its globals. */
static int global_index(lua_State* L) {
  const char* name = luaL_checkstring(L, 2);
  if (!push_function(L, "", name)) {
    if (!is_owner(name)) return 0;
    lua_newuserdata(L, 0);
    define(L, name, NULL);
    lua_setmetatable(L, -2);
  }
  lua_pushvalue(L, -2);
  lua_pushvalue(L, -2);
  lua_settable(L, -5);
  return 1;
}

void replay_open(lua_State* L) {
  lua_createtable(L, 0, 1);
  lua_pushcfunction(L, global_index);
  lua_setfield(L, -2, "__index");
  lua_setmetatable(L, -2);
}
