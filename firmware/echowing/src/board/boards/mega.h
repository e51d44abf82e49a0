// Arduino Mega 2560. How to read and write such a file: README.md, "Another board".
#pragma once

#define ECHOWING_TITLE "Arduino Mega 2560"
#define ECHOWING_FQBN "arduino:avr:mega"
#define ECHOWING_UPLOADS "avrdude"

// Memory in bytes: what the program may fill (the boot loader has the last 8 kB), and what we allow
// ourselves of it.
#define ECHOWING_PROGRAM_BYTES 253952
#define ECHOWING_RAM_BYTES 8192
#define ECHOWING_PROGRAM_LIMIT 45056
#define ECHOWING_RAM_LIMIT 4096

// Pins as Arduino numbers them. Servos on Timer1's OC1A and OC1B, the link on Serial1.
#define ECHOWING_PIN_PAN 11
#define ECHOWING_PIN_TILT 12
#define ECHOWING_PIN_SDA 20
#define ECHOWING_PIN_SCL 21
#define ECHOWING_PIN_RX 19
#define ECHOWING_PIN_TX 18
#define ECHOWING_PIN_LED 13
#define ECHOWING_LED_ON HIGH

// For the emulator: the chip, its clock, where the chip has those pins, and its serial ports.
#define ECHOWING_CHIP "atmega2560"
#define ECHOWING_CLOCK_HZ 16000000
#define ECHOWING_CHIP_PINS "PAN=B5 TILT=B6 SDA=D1 SCL=D0 LED=B7"
#define ECHOWING_UARTS "autopilot=1 usb=0"
