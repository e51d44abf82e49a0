// Echowing co-processor: a gimballed sonar that finds the leader and tells the autopilot its range.
// Wiring, flashing and parameters: firmware/README.md. This file only wires things together: the
// board is in src/board, what the device does in src/core.

#include "src/board/arduino_board.h"
#include "src/core/coprocessor.h"

static echowing::ArduinoBoard board;

// Comes to life with the first call: only then have the Arduino core's clocks been started.
static echowing::Coprocessor& device() {
  static echowing::Coprocessor device(board.ports(), board.seed(), micros());
  return device;
}

void setup() {
  board.wake();
  board.begin(device().aim());
}

void loop() {
  board.feed_watchdog();
  device().step(micros());
  board.show(device().led_on());
}
