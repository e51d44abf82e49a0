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
  // Once, from setup().
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
  void start_watchdog();
  void enter_bootloader_if_asked();

  Uart link_;
  Uart usb_;
  WireBus bus_;
  ServoPwm servos_;
  LastingMemory memory_;
  bool led_on_ = false;
};

}  // namespace echowing
