#if defined(__AVR__)
#include <avr/wdt.h>

#include "arduino_board.h"
#include "status_led.h"

namespace echowing {

// Of 8 kB, with 0.4 kB for the Arduino core and 1 kB at least left for the stack; the limit that
// the build prints is 4 kB in all.
static_assert(sizeof(Coprocessor) + sizeof(ArduinoBoard) <= 2560, "too much static RAM");

// After a watchdog reset the watchdog runs on with its shortest time: it has to be stopped before
// anything else, or the board restarts for ever.
__attribute__((naked, used, section(".init3"))) void stop_watchdog_early() {
  MCUSR = 0;
  wdt_disable();
}

void ArduinoBoard::wake() {
  begin_led();
  wdt_enable(WDTO_250MS);  // a hundred times the longest loop turn
}

void ArduinoBoard::feed_watchdog() { wdt_reset(); }

// An open analogue input: its lowest bits are noise.
uint32_t ArduinoBoard::seed() const { return static_cast<uint32_t>(analogRead(A0)); }

// The bootloader runs first after every reset.
void ArduinoBoard::reboot(bool) {
  wdt_enable(WDTO_15MS);
  for (;;) {
  }
}

}  // namespace echowing
#endif
