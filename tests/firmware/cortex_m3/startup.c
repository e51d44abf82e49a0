/* The vector table: newlib's own start-up code does the rest, over semihosting. */
#include <stdint.h>

extern uint32_t __stack;
void _start(void);

void reset(void) { _start(); }

/* Any fault ends the emulation with a code that is no test result. */
static void fault(void) {
  static const uint32_t reason[2] = {0x20026 /* ADP_Stopped_ApplicationExit */, 99};
  __asm volatile("mov r0, #0x20\n mov r1, %0\n bkpt 0xab" ::"r"(reason) : "r0", "r1");
  for (;;) {
  }
}

/* The C++ library refers to it; there is no entropy on this machine, and nobody asks for any. */
int getentropy(void* bytes, unsigned count) {
  (void)bytes, (void)count;
  return -1;
}

typedef void (*handler)(void);

__attribute__((section(".vectors"), used)) static const struct {
  uint32_t* stack;
  handler reset, nmi, hard_fault, memory_fault, bus_fault, usage_fault;
} vectors = {&__stack, reset, fault, fault, fault, fault, fault};
