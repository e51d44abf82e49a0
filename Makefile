# Echowing. `make demo` flies the simulated formation, `make test` proves everything;
# both install what they need first.

.DEFAULT_GOAL := help
BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)
# Else each worker of the tests, and each of the hundreds of processes that they start, compiles the
# package anew.
unexport PYTHONDONTWRITEBYTECODE
# A file is one worker's, in the order of tests/conftest.py. Two cores carry five workers: the tests
# of processes in real time mostly wait.
WORKERS := -n 5 --dist loadfile --no-loadscope-reorder

.PHONY: help demo campaign test test-long test-sitl bench release monitor fuzz lint format pages setup setup-test core clean

help: ## list the targets
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):.*## /\1\t/' | expand -t 16

demo: setup core emulated ## fly the scenarios, print the table, write out/demo/report.html
	@$(BIN)/echowing demo --out out/demo

campaign: setup core ## fly 10,000 drawn flights with faults: FLIGHTS=10000 SEED=1, continues an interrupted one
	@$(BIN)/echowing campaign --flights $(or $(FLIGHTS),10000) --seed $(or $(SEED),1) --resume \
		--out out/campaign-$(or $(SEED),1)

test: setup-test core emulated lint ## every check, and every test that is not long
	$(BIN)/pytest $(WORKERS)

test-long: setup-test core emulated ## the tests that take minutes: many seeds, a campaign of forty, fifty followers
	$(BIN)/pytest $(WORKERS) -m long

test-sitl: setup-test core emulated ## fly it on ArduCopter SITL: ARDUCOPTER="PATH …" [CASES="NAME or NAME"]
	$(BIN)/python -m tests.sitl $(ARDUCOPTER) -- $(if $(CASES),-k "$(CASES)")

bench: setup-test core emulated ## measure speeds and sizes
	@$(BIN)/echowing bench

release: setup ## write wheel, firmware of all boards, applets, notes and checksums: dist/VERSION
	@$(BIN)/python host_tools/make_release.py dist

monitor: setup ## watch the co-processor live: PORT=/dev/ttyACM0
	@$(BIN)/echowing rig $(if $(PORT),--port $(PORT)) watch

fuzz: setup-test ## fuzz the firmware's byte entry and memory, the applets, then follow's session: SECONDS=600 for each, SEED=1
	$(BIN)/python tests/firmware/fuzz/run.py $(or $(SECONDS),600) $(or $(SEED),1)
	$(BIN)/python -m tests.lua.fuzz --seconds $(or $(SECONDS),600) --seed $(or $(SEED),1)
	$(BIN)/python -m tests.flight.session_fuzz --seconds $(or $(SECONDS),600) --seed $(or $(SEED),1)

lint: setup-test ## run formatters and linters; changes nothing
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	luacheck -q --config lua/.luacheckrc lua host_tools/echowing/sim/vehicle/lua_prelude.lua
	$(BIN)/clang-format --dry-run --Werror $$(git ls-files 'firmware/*.cpp' 'firmware/*.hpp' 'firmware/*.h' 'firmware/*.c' 'firmware/*.ino')

pages: setup ## write the pages that are made from the code
	$(BIN)/python -m echowing.docs.keys host_tools
	$(BIN)/python -m echowing.docs.constants host_tools
	$(BIN)/python -m echowing.docs.shapes host_tools/pictures/shapes.svg

format: setup-test ## apply the formatters
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $$(git ls-files 'firmware/*.cpp' 'firmware/*.hpp' 'firmware/*.h' 'firmware/*.c' 'firmware/*.ino')

setup: ## install the requirements of the simulator
	@host_tools/setup.sh run

setup-test: ## install the requirements of the tests
	@host_tools/setup.sh test

core: setup ## the co-processor's core for this machine
	@test -f build/host/build.ninja || echo "building the co-processor's core for this machine"
	@test -f build/host/build.ninja || $(BIN)/cmake -S firmware/host -B build/host -G Ninja \
		-DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja >/dev/null
	@$(BIN)/ninja -C build/host --quiet

clean: ## remove build products (keeps .venv and downloaded tools and cores)
	rm -rf out build/arduino-home*/cache
	@[ ! -d build ] || find build -mindepth 1 -maxdepth 1 ! -name tools ! -name 'arduino-home*' -exec rm -rf {} +

-include firmware/firmware.mk
-include hw/hw.mk
