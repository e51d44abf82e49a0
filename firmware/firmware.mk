# The co-processor: building, flashing, emulating. Included by the root Makefile.

BOARD ?= mega
ARDUINO_CLI := build/tools/arduino-cli
ARDUINO_HOME := build/arduino-home/arduino-cli.yaml
EMULATORS := build/emulator/libechowing_avr.so build/emulator/libechowing_stm32.so
MAVLINK_HEADERS := firmware/echowing/src/mavlink/echowing/mavlink.h
STM32_BOARDS := blackpill_f411 bluepill_f103 nucleo_f446
FIRMWARE_SOURCES := $(shell find firmware/echowing -type f -not -path '*/src/mavlink/*')
BUILD_TOOLS := firmware/tools/build.py host_tools/echowing/sim/boards/firmware.py

# The official STM32 core and its CMSIS, where they are installed somewhere else than arduino-cli and
# the Arduino IDE install them (firmware/tools/stm32_home.sh).
export ECHOWING_STM32_CORE ECHOWING_STM32_CMSIS
# What the Mega's binary is run through in `make test`, and what only the STM32 boards do.
STM32_TESTS := $(addprefix tests/firmware/,on_stm32.py test_emulator_faults.py test_emulator_scan.py \
	test_emulator_link.py test_emulator_figures.py) tests/system/test_look.py

.PHONY: arduino-cli firmware firmware-stm32 flash emulator emulated git-hash stm32-core test-stm32

firmware: build/firmware/$(BOARD)/echowing.elf ## compile the sketch: BOARD=mega, blackpill_f411, bluepill_f103, nucleo_f446
	@$(BIN)/python -m echowing.sim.boards.firmware $(BOARD)

firmware-stm32: $(STM32_BOARDS:%=build/firmware/%/echowing.elf) ## compile it for all STM32 boards (fetches their core)
	@for board in $(STM32_BOARDS); do $(BIN)/python -m echowing.sim.boards.firmware $$board || exit 1; done

flash: $(if $(RELEASE),setup,build/firmware/$(BOARD)/echowing.elf) ## flash a board: BOARD=mega PORT=/dev/ttyACM0, METHOD=dfu, serial, stlink, RELEASE=DIR
	@$(BIN)/python firmware/tools/flash.py $(BOARD) $(if $(PORT),--port $(PORT)) \
		$(if $(METHOD),--method $(METHOD)) $(if $(RELEASE),--release "$(RELEASE)")

test-stm32: setup-test emulator stm32-core ## build for the STM32 boards with an installed core, and test these binaries
	@for board in $(STM32_BOARDS); do \
		$(MAKE) -s firmware BOARD=$$board && \
		ECHOWING_BOARD=$$board $(BIN)/pytest -q -n 2 --dist loadfile $(STM32_TESTS) \
			-m "not mega$$([ $$board = nucleo_f446 ] || echo ' and not usb')" || exit 1; done

emulator: $(EMULATORS) ## the emulators that run the binaries

emulated: build/firmware/mega/echowing.elf $(EMULATORS)

arduino-cli: $(ARDUINO_CLI) ## arduino-cli from its Go sources (once)

build/firmware/%/echowing.elf: $(FIRMWARE_SOURCES) $(MAVLINK_HEADERS) $(BUILD_TOOLS) build/firmware/git-hash \
		| setup $(ARDUINO_CLI) $(ARDUINO_HOME) $(if $(ECHOWING_STM32_CORE),stm32-core)
	@host_tools/patiently.sh 10 "compiling the firmware for $*" $(BIN)/python firmware/tools/build.py $*

stm32-core: | setup
	@firmware/tools/stm32_home.sh build/arduino-home-stm32

# Touched only when the commit changes, so that the binary can tell which it was made from.
build/firmware/git-hash: git-hash
	@mkdir -p $(@D)
	@hash=$$(git rev-parse --short=8 HEAD 2>/dev/null || echo 00000000); \
		[ "$$(cat $@ 2>/dev/null)" = "$$hash" ] || echo $$hash >$@

# Made here only, before anything is compiled: tests build the core in several processes.
core fuzz: $(MAVLINK_HEADERS)

$(MAVLINK_HEADERS): firmware/dialect/echowing.xml | setup
	@rm -rf firmware/echowing/src/mavlink
	@$(BIN)/python -m pymavlink.tools.mavgen --lang C --wire-protocol 2.0 \
		--output firmware/echowing/src/mavlink $< >/dev/null
	@touch $@

$(ARDUINO_CLI): firmware/tools/arduino_cli.sh firmware/tools/arduino-cli/go.mod firmware/tools/arduino-cli/go.sum | setup
	@host_tools/patiently.sh 10 "building arduino-cli (about a minute, once)" firmware/tools/arduino_cli.sh $@

$(ARDUINO_HOME): firmware/tools/arduino_home.sh | setup
	@firmware/tools/arduino_home.sh $(@D)
	@touch $@

EMULATOR_HEADERS := $(wildcard firmware/emulator/*.h)
build/emulator/libechowing_avr.so: $(addprefix firmware/emulator/,avr_board.c recorders.c)
build/emulator/libechowing_avr.so: LIBRARIES = $$(pkg-config --cflags simavr) -lsimavr -lelf
build/emulator/libechowing_stm32.so: $(wildcard firmware/emulator/stm32_*.c) firmware/emulator/recorders.c
build/emulator/libechowing_stm32.so: LIBRARIES = -lunicorn

$(EMULATORS): $(EMULATOR_HEADERS) | setup
	@mkdir -p $(@D)
	@echo "building $(@F), which runs the firmware's binary"
	@$(CC) -std=c11 -O2 -g -Wall -Wextra -Werror -fPIC -shared -fvisibility=hidden $(filter %.c,$^) -o $@ $(LIBRARIES)
