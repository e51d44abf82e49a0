// Blue Pill F103C8. How to read and write such a file: README.md, "Another board".
#pragma once

#define ECHOWING_TITLE "Blue Pill F103C8"
#define ECHOWING_FQBN "STMicroelectronics:stm32:GenF1:pnum=BLUEPILL_F103C8,usb=CDCgen,opt=oslto"
#define ECHOWING_UPLOADS "serial stlink"

// Memory in bytes: what the program may fill, and after it two blocks for the parameters, each the
// smallest that can be erased there.
#define ECHOWING_PROGRAM_BYTES 63488
#define ECHOWING_SLOT_BYTES 1024
#define ECHOWING_RAM_BYTES 20480
#define ECHOWING_PROGRAM_LIMIT 57344

// Pins as Arduino names them. The link is USART1, the console is the USB socket.
#define ECHOWING_PIN_PAN PA6
#define ECHOWING_PIN_TILT PA7
#define ECHOWING_PIN_SDA PB7
#define ECHOWING_PIN_SCL PB6
#define ECHOWING_PIN_RX PA10
#define ECHOWING_PIN_TX PA9
#define ECHOWING_PIN_LED PC13
#define ECHOWING_LED_ON LOW

// Servo pulses: a timer, and for each servo the channel of it and the PinName with which the core
// finds that channel on the pin. PA_7 alone is channel 1N of TIM1.
#define ECHOWING_SERVO_TIMER 3
#define ECHOWING_PAN_CHANNEL 1
#define ECHOWING_PAN_OUTPUT PA_6
#define ECHOWING_TILT_CHANNEL 2
#define ECHOWING_TILT_OUTPUT PA_7_ALT1

// For the emulator: the chip, its crystal, and its serial ports.
#define ECHOWING_CHIP "stm32f103"
#define ECHOWING_CLOCK_HZ 8000000
#define ECHOWING_UARTS "autopilot=1"
