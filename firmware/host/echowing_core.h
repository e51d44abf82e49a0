/* Plain C interface to the co-processor's core on a computer: the simulator drives it in lock
 * step, with the sonar on its I2C bus given as callbacks. Ports: 0 autopilot, 1 USB. */
#ifndef ECHOWING_CORE_H
#define ECHOWING_CORE_H

#include <stddef.h>
#include <stdint.h>

#if defined(__cplusplus)
extern "C" {
#endif

#define EW_API __attribute__((visibility("default")))

/* Both return non-zero for "acknowledged". `address` is the 7-bit one. */
typedef int (*ew_bus_write)(uint64_t t_us, uint8_t address, const uint8_t* bytes, uint8_t count);
typedef int (*ew_bus_read)(uint64_t t_us, uint8_t address, uint8_t* bytes, uint8_t count);

typedef struct ew_core ew_core;

/* The callbacks have to outlive the core. Free with ew_destroy. */
EW_API ew_core* ew_create(ew_bus_write write, ew_bus_read read, uint32_t seed, uint64_t start_us);
EW_API void ew_destroy(ew_core* core);

/* Loop turns up to and including t_us; a time not ahead of the last one does nothing. */
EW_API void ew_run_until(ew_core* core, uint64_t t_us);

/* Bytes into a port's receiver, and out of its transmitter (returns how many). */
EW_API void ew_feed(ew_core* core, int port, const uint8_t* bytes, size_t count);
EW_API size_t ew_take(ew_core* core, int port, uint8_t* bytes, size_t capacity);

/* Servo pulses commanded now, microseconds. */
EW_API double ew_pan_us(const ew_core* core);
EW_API double ew_tilt_us(const ew_core* core);

/* Non-zero while the status light is on. */
EW_API int ew_led(const ew_core* core);
/* How often the core has asked its board for a restart. */
EW_API unsigned ew_reboots(const ew_core* core);

/* The parameter table; strings live as long as the library. Index below ew_parameter_count. */
typedef struct {
  const char* name;
  float normal;
  float least;
  float most;
  int whole;
  const char* unit;
  const char* text;
} ew_parameter;
EW_API int ew_parameter_count(void);
EW_API ew_parameter ew_parameter_row(int index);
EW_API float ew_get_parameter(const ew_core* core, int index);
/* Non-zero when taken, zero when out of range. */
EW_API int ew_set_parameter(ew_core* core, int index, float value);

#if defined(__cplusplus)
}
#endif
#endif
