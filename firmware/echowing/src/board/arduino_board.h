// Everything of a board that the core needs, in one object.
#pragma once

#include <Arduino.h>

#include "../core/coprocessor.h"
#include "lasting_memory.h"
#include "servo_pwm.h"
#include "uart.h"
#include "wire_bus.h"

namespace echowing {

class ArduinoBoard : public Board {
 public:
  ArduinoBoard();
  // First thing in setup(): LED and watchdog are on before anything that can fail. On STM32 they
  // have been on since before the Arduino core started its clocks.
  void wake();
  // Ports and servo pulses, once.
  void begin(Aim aim);
  // Every loop turn: a turn that never ends restarts the board.
  void feed_watchdog();
  void show(bool led_on);

  Ports ports() { return {link_, usb_, bus_, servos_, memory_, *this}; }
  // Differs from board to board, or from start to start.
  uint32_t seed() const;

  ResetCause reset_cause() const override;
  const char* git_hash() const override;
  void reboot(bool into_bootloader) override;

 private:
  Uart link_;
  Uart usb_;
  WireBus bus_;
  ServoPwm servos_;
  LastingMemory memory_;
  bool led_on_ = true;
};

}  // namespace echowing
