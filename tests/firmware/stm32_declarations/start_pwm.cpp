// Starts the servo pulses as the sketch does, or as the first argument says.
#include <string.h>

#include "Arduino.h"
#include "board/servo_pwm.h"

int main(int, char** arguments) {
  if (arguments[1] != nullptr && strcmp(arguments[1], "by-number") == 0) {
    HardwareTimer timer(TIM3);
    timer.setMode(1, TIMER_OUTPUT_COMPARE_PWM1, PA6);
    timer.setMode(2, TIMER_OUTPUT_COMPARE_PWM1, PA7);
  } else {
    echowing::ServoPwm().begin({1500, 1500});
  }
}
