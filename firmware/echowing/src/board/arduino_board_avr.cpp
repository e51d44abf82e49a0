#if defined(__AVR__)
#include <avr/wdt.h>

#include "arduino_board.h"
#include "status_led.h"

namespace echowing {

// Of 8 kB, with 0.4 kB for the Arduino core and 1 kB at least left for the stack; the limit that
// the build prints is 4 kB in all.
static_assert(sizeof(Coprocessor) + sizeof(ArduinoBoard) <= 2560, "too much static RAM");

namespace {

constexpr uint16_t kOrderedMark = 0xb007;
volatile uint16_t restart_mark;  // cleared only after .init3, which so sees what reboot() has left

}  // namespace

// After a watchdog reset the watchdog runs on with its shortest time: it has to be stopped before
// anything else, or the board restarts for ever. The cause is kept in registers of no other use.
__attribute__((naked, used, section(".init3"))) void stop_watchdog_early() {
  GPIOR0 = MCUSR;
  GPIOR1 = restart_mark == kOrderedMark;
  MCUSR = 0;
  wdt_disable();
}

// A bootloader has mostly cleared the flags: the cause is then unknown.
ResetCause ArduinoBoard::reset_cause() const {
  if (GPIOR0 & _BV(PORF)) return ResetCause::kPowerOn;
  if (GPIOR0 & _BV(BORF)) return ResetCause::kBrownOut;
  if (GPIOR0 & _BV(EXTRF)) return ResetCause::kPin;
  if (GPIOR1 != 0) return ResetCause::kOrdered;
  return GPIOR0 & _BV(WDRF) ? ResetCause::kWatchdog : ResetCause::kUnknown;
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
  restart_mark = kOrderedMark;
  wdt_enable(WDTO_15MS);
  for (;;) {
  }
}

}  // namespace echowing
#endif
