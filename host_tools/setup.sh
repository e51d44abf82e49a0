#!/usr/bin/env bash
# Sets up a fresh Debian 12 / Ubuntu machine:  host_tools/setup.sh run|test
#   run   what flying the simulator needs;  test  that, and what the checks and tests need.
# System packages come through apt where root or password-less sudo is there; Python packages go
# into .venv at the root of the checkout. Does nothing when everything is in place.
set -euo pipefail
cd "$(dirname "$0")/.."

group=${1:-run}
# Package names of Debian 12; each with what it is for.
run_packages=(
  g++                     # the co-processor's core for this machine
  gcc-avr avr-libc        # the co-processor's binary
  arduino-core-avr arduino-ctags
  simavr libsimavr-dev libelf-dev pkg-config  # running that binary
  libunicorn-dev          # running the STM32 boards' binaries
)
test_packages=(
  avrdude stm32flash      # flashing, tested against fake boot loaders
  clang libclang-rt-dev   # sanitizers and fuzzing of the core
  doctest-dev             # unit tests of the core
  gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib qemu-system-arm
  graphviz openscad xvfb xauth fonts-liberation  # wiring pictures and the gimbal mount
  lua-check               # the applet's style
)
# A browser for the live page's tests: Debian's package. Ubuntu's is a snap, for which see below.
id_of_system=$(. /etc/os-release 2>/dev/null && printf '%s' "$ID" || true)
[ "$id_of_system" = ubuntu ] || test_packages+=(chromium)

say() { printf 'setup: %s\n' "$*"; }
fail() { say "$*" >&2; exit 1; }
# For what says nothing itself: a line now and then, with or without a terminal.
patiently() { host_tools/patiently.sh 10 "setup: $1" "${@:2}"; }

packages=("${run_packages[@]}")
extras=all,build
if [ "$group" = test ]; then
  packages+=("${test_packages[@]}")
  extras=all,build,test,hw
fi

stamp=.venv/.setup-$group
wanted=$(cat pyproject.toml host_tools/setup.sh | sha256sum)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
  exit 0
fi

# The system's own, where it is new enough: it is built to be quick (a simulated flight takes a fifth
# less time than with one that pyenv has built), and apt's headers are its headers.
new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }
python=/usr/bin/python3
new_enough "$python" || python=$(command -v python3 || true)
[ -n "$python" ] || packages+=(python3)
if [ -z "$python" ] || ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
  packages+=(python3-venv)
fi
if [ -z "$python" ] || ! "$python" -c \
  'import os, sysconfig as s; os.stat(os.path.join(s.get_path("include"), "Python.h"))' 2>/dev/null; then
  packages+=(python3-dev)   # lupa is built here, with 32-bit Lua numbers
fi

missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  as_root=()
  if [ "$(id -u)" != 0 ]; then
    sudo -n true 2>/dev/null || fail "missing system packages; run: sudo apt-get install ${missing[*]}"
    as_root=(sudo -n)
  fi
  patiently "reading the lists of system packages" "${as_root[@]}" apt-get update -qq
  patiently "installing system packages: ${missing[*]}" \
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq \
    --no-install-recommends "${missing[@]}"
fi

python=${python:-python3}
new_enough "$python" || fail "Python 3.11 or newer is needed; python3 here is $("$python" --version)"
[ -x .venv/bin/python ] || { say "making the virtual environment .venv"; "$python" -m venv .venv; }

# Without -O2 the compiler does not optimize: an environment's CFLAGS replace Python's own.
lua_flags='-O2 -DLUA_32BITS'
lua_built=.venv/.lua-flags
lua_is_32_bit() {
  .venv/bin/python -c 'import lupa.lua53 as l, sys
sys.exit(l.LuaRuntime().eval("math.maxinteger") != 2**31 - 1)' 2>/dev/null
}
lua_is_ours() { [ "$(cat "$lua_built" 2>/dev/null)" = "$lua_flags" ] && lua_is_32_bit; }
lua_source=build/tools/lua53   # Lua's own files of lupa's source: the tests build them for the autopilot
if [ "$group" = test ] && [ ! -f "$lua_source/lua.h" ]; then lua_source_missing=1; else lua_source_missing=; fi
if [ -n "$lua_source_missing" ] || ! lua_is_ours; then
  lupa=$(mktemp -d)
  trap 'rm -rf "$lupa"' EXIT
  .venv/bin/pip download -q --disable-pip-version-check --no-cache-dir --no-deps --no-binary lupa \
    --dest "$lupa" 'lupa>=2.4'
  tar -xzf "$lupa"/lupa-*.tar.gz -C "$lupa" --strip-components=1
fi
if ! lua_is_ours; then
  for other in "$lupa"/third-party/lua*; do  # each would be built, too
    [ "$other" = "$lupa/third-party/lua53" ] || rm -rf "$other"
  done
  CFLAGS=$lua_flags patiently "building lupa (Lua 5.3 with the autopilot's 32-bit numbers)" \
    .venv/bin/pip install -q --disable-pip-version-check --force-reinstall \
    --no-cache-dir --no-deps "$lupa"
  printf '%s' "$lua_flags" >"$lua_built"
fi
if [ -n "$lua_source_missing" ]; then
  mkdir -p "$lua_source"
  cp "$lupa"/third-party/lua53/*.[ch] "$lua_source"
fi
patiently "installing Python packages into .venv ($extras)" \
  .venv/bin/pip install -q --disable-pip-version-check -e ".[$extras]"
lua_is_32_bit || fail "lupa was not built with 32-bit Lua numbers; remove .venv and run again"
if [ "$group" = test ] && [ "$id_of_system" = ubuntu ]; then
  with_deps=()
  if [ "$(id -u)" = 0 ] || sudo -n true 2>/dev/null; then with_deps=(--with-deps); fi
  patiently "installing Chromium for the live page's tests" \
    .venv/bin/playwright install "${with_deps[@]}" chromium
fi
printf '%s' "$wanted" >"$stamp"
say "done"
