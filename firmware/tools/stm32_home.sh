#!/bin/sh
# Lay out an arduino-cli home over an installed official STM32 core (stm32duino): no index, no
# download, nothing outside DIRECTORY.
#   ECHOWING_STM32_CORE   the core's folder, with boards.txt and platform.txt in it
#   ECHOWING_STM32_CMSIS  the folder with CMSIS/Core/Include in it
# Without them both are looked for where arduino-cli and the Arduino IDE install them. The compiler
# is Debian's gcc-arm-none-eabi with libnewlib-arm-none-eabi and libstdc++-arm-none-eabi-newlib.
set -eu

[ $# -eq 1 ] || { echo "usage: $0 DIRECTORY" >&2; exit 2; }
version=2.12.0
packages=$HOME/.arduino15/packages/STMicroelectronics
core=${ECHOWING_STM32_CORE:-$packages/hardware/stm32/$version}
ctags=/usr/bin/arduino-ctags

fail() { printf 'error: %s\n' "$@" >&2; exit 1; }

[ -f "$core/platform.txt" ] && [ -f "$core/boards.txt" ] || fail \
    "no official STM32 core in $core. Install core $version:" \
    "  arduino-cli core install STMicroelectronics:stm32@$version --additional-urls" \
    "  https://github.com/stm32duino/BoardManagerFiles/raw/main/package_stmicroelectronics_index.json" \
    "or name a folder that has it, and CMSIS 6.2.0:" \
    "  make test-stm32 ECHOWING_STM32_CORE=/path/to/core ECHOWING_STM32_CMSIS=/path/to/CMSIS_6"
found=$(sed -n 's/^version=//p' "$core/platform.txt" | tr -d '\r')
[ "$found" = "$version" ] || fail "the STM32 core in $core is $found; sketch.yaml pins $version"

# The tools that the core asks for, with their versions, stand in its platform.txt.
wanted_cmsis=$(sed -n 's/.*runtime\.tools\.CMSIS-\([0-9.]*\)\.path.*/\1/p' "$core/platform.txt" | head -1)
cmsis=${ECHOWING_STM32_CMSIS:-$(dirname "$core")/../../tools/CMSIS/$wanted_cmsis}
[ -f "$cmsis/CMSIS/Core/Include/core_cm4.h" ] || fail \
    "no CMSIS $wanted_cmsis in $cmsis (CMSIS/Core/Include/core_cm4.h is missing)" \
    "name its folder: ECHOWING_STM32_CMSIS=/path/to/CMSIS_6"
compiler=$(command -v arm-none-eabi-g++) || fail \
    "arm-none-eabi-g++ is missing: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi" \
    "libstdc++-arm-none-eabi-newlib (or run make setup-test)"
[ -x "$ctags" ] || fail "$ctags is missing: apt install arduino-ctags (or run make setup)"

mkdir -p "$1"
home=$(cd "$1" && pwd)
platform=$home/user/hardware/STMicroelectronics/stm32
tools=$home/data/packages/builtin/tools
rm -rf "$platform"
mkdir -p "$platform" "$home/user/libraries" "$home/downloads" "$tools/ctags/5.8-arduino11"
ln -sf "$ctags" "$tools/ctags/5.8-arduino11/ctags"
echo '{"packages":[]}' >"$home/data/package_index.json"
echo '{"libraries":[]}' >"$home/data/library_index.json"
core=$(cd "$core" && pwd)
for entry in "$core"/*; do
    ln -sfn "$entry" "$platform/$(basename "$entry")"
done

cat >"$platform/platform.local.txt" <<PLATFORM
toolchain_dir=$(dirname "$(dirname "$compiler")")
cmsis_dir=$(cd "$cmsis" && pwd)/CMSIS
cmsis_dsp=$home
cmsis_nn=$home
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

echo "STM32 core $found in $core"
echo "CMSIS $wanted_cmsis in $cmsis, $("$compiler" --version | head -1)"
