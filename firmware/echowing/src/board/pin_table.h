// clang-format off
// Where everything is connected, once: the sketch and the wiring tables in firmware/README.md come
// from here. A row is compiled only for its own board, which alone knows the names of its pins.
//
// ECHOWING_PINS_board(pan, tilt, i2c_data, i2c_clock, link_rx, link_tx, led, led_on_level)

// Servos on Timer1's OC1A and OC1B; the link is Serial1.
ECHOWING_PINS_mega(11, 12, 20, 21, 19, 18, 13, HIGH)

// Servos on TIM3 channels 1 and 2; the link is USART1; the console is the USB socket.
ECHOWING_PINS_blackpill_f411(PA6, PA7, PB7, PB6, PA10, PA9, PC13, LOW)
ECHOWING_PINS_bluepill_f103(PA6, PA7, PB7, PB6, PA10, PA9, PC13, LOW)

// D12 and D11, D14 and D15, D2 and D8 on the Arduino header; the console is the ST-LINK's.
ECHOWING_PINS_nucleo_f446(PA6, PA7, PB9, PB8, PA10, PA9, PA5, HIGH)
