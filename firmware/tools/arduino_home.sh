#!/bin/sh
# Lay out an arduino-cli home over Debian's AVR core: no index, no download, nothing outside DIRECTORY.
# Needs Debian 12's gcc-avr avr-libc binutils-avr arduino-core-avr arduino-ctags.
set -eu

[ $# -eq 1 ] || { echo "usage: $0 DIRECTORY" >&2; exit 2; }
mkdir -p "$1"
home=$(cd "$1" && pwd)
core=${ECHOWING_AVR_CORE:-/usr/share/arduino/hardware/arduino/avr}
ctags=/usr/bin/arduino-ctags

need() {  # need WHAT PACKAGE
    echo "error: $1 is missing: apt install $2 (or run make setup)" >&2
    exit 1
}
[ -f "$core/platform.txt" ] || need "the Arduino AVR core in $core" arduino-core-avr
[ -x "$ctags" ] || need "$ctags" arduino-ctags
command -v avr-g++ >/dev/null || need avr-g++ "gcc-avr avr-libc binutils-avr"

platform=$home/user/hardware/arduino/avr
tools=$home/data/packages/builtin/tools
mkdir -p "$platform" "$home/user/libraries" "$home/downloads" "$tools/ctags/5.8-arduino11"
ln -sf "$ctags" "$tools/ctags/5.8-arduino11/ctags"
echo '{"packages":[]}' >"$home/data/package_index.json"
echo '{"libraries":[]}' >"$home/data/library_index.json"
for entry in "$core"/*; do
    ln -sfn "$entry" "$platform/$(basename "$entry")"
done

# Debian's avr-gcc 5.4 has no DECIMAL_DIG in C++, which its core 1.8.7 needs; the core's default is gnu++11.
# Without discoveries (they cannot be had offline) uploads need avrdude's place by name.
cat >"$platform/platform.local.txt" <<PLATFORM
compiler.cpp.extra_flags=-std=gnu++14 -DDECIMAL_DIG=__DECIMAL_DIG__
tools.avrdude.cmd.path=/usr/bin/avrdude
tools.avrdude.config.path=/etc/avrdude.conf
PLATFORM

cat >"$home/arduino-cli.yaml" <<YAML
directories:
  data: $home/data
  downloads: $home/downloads
  user: $home/user
build_cache:
  path: $home/cache
updater:
  enable_notification: false
YAML
