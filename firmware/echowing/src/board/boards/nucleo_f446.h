// ST Nucleo F446RE. How to read and write such a file: README.md, "Another board".
#pragma once

#define ECHOWING_TITLE "ST Nucleo F446RE"
#define ECHOWING_FQBN "STMicroelectronics:stm32:Nucleo_64:pnum=NUCLEO_F446RE"
#define ECHOWING_UPLOADS "stlink serial"

// Memory in bytes: what the program may fill, and after it two blocks for the parameters, each the
// smallest that can be erased there.
#define ECHOWING_PROGRAM_BYTES 262144
#define ECHOWING_SLOT_BYTES 131072
#define ECHOWING_RAM_BYTES 131072

// Pins as Arduino names them. On the Arduino header: D12 and D11, D14 and D15,
// D2 and D8. The console is the ST-LINK's, on USART2.
#define ECHOWING_PIN_PAN PA6
#define ECHOWING_PIN_TILT PA7
#define ECHOWING_PIN_SDA PB9
#define ECHOWING_PIN_SCL PB8
#define ECHOWING_PIN_RX PA10
#define ECHOWING_PIN_TX PA9
#define ECHOWING_PIN_LED PA5
#define ECHOWING_LED_ON HIGH

// Servo pulses: a timer, and for each servo the channel of it and the PinName with which the core
// finds that channel on the pin. PA_7 alone is channel 1N of TIM1.
#define ECHOWING_SERVO_TIMER 3
#define ECHOWING_PAN_CHANNEL 1
#define ECHOWING_PAN_OUTPUT PA_6
#define ECHOWING_TILT_CHANNEL 2
#define ECHOWING_TILT_OUTPUT PA_7_ALT1

// For the emulator: the chip, its crystal, and its serial ports.
#define ECHOWING_CHIP "stm32f446"
#define ECHOWING_CLOCK_HZ 8000000
#define ECHOWING_UARTS "autopilot=1 usb=2"
