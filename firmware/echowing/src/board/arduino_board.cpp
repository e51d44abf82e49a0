#include "arduino_board.h"

#include "pins.h"
#include "status_led.h"

// The build gives the commit; the Arduino IDE does not.
#if !defined(ECHOWING_GIT_HASH)
#define ECHOWING_GIT_HASH "unknown"
#endif

namespace echowing {
namespace {

// SERIALn_BAUD of the autopilot has to be 115.
constexpr uint32_t kBaud = 115200;

#if defined(ARDUINO_ARCH_STM32)
HardwareSerial& link_serial() {
  static HardwareSerial usart1(kPins.link_rx, kPins.link_tx);
  return usart1;
}
#else
HardwareSerial& link_serial() { return Serial1; }
#endif

}  // namespace

ArduinoBoard::ArduinoBoard() : link_(link_serial()), usb_(Serial) {}

void ArduinoBoard::begin(Aim aim) {
  link_serial().begin(kBaud);
  Serial.begin(kBaud);
  bus_.begin();
  servos_.begin(aim);
}

void ArduinoBoard::show(bool led_on) {
  if (led_on == led_on_) return;
  led_on_ = led_on;
  set_led(led_on);
}

const char* ArduinoBoard::git_hash() const { return ECHOWING_GIT_HASH; }

}  // namespace echowing
