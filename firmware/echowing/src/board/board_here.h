// The board that is compiled for. Another board is a file in boards/ and a row here.
#pragma once

#if defined(ARDUINO_AVR_MEGA2560)
#include "boards/mega.h"
#elif defined(ARDUINO_BLACKPILL_F411CE)
#include "boards/blackpill_f411.h"
#elif defined(ARDUINO_BLUEPILL_F103C8)
#include "boards/bluepill_f103.h"
#elif defined(ARDUINO_NUCLEO_F446RE)
#include "boards/nucleo_f446.h"
#else
#error "this board has no file in src/board/boards: see firmware/README.md, Another board"
#endif
