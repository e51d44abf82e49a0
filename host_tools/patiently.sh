#!/usr/bin/env bash
# Says what is done, runs the command that does it, and says every so often that it goes on. What the
# command itself says is thrown away, except errors:
#   host_tools/patiently.sh SECONDS "WHAT" COMMAND…
set -euo pipefail
period=$1 what=$2
shift 2

printf '%s\n' "$what"
tick() {
  while sleep "$period" >/dev/null 2>&1 && kill -0 $$ 2>/dev/null; do
    printf '  … %d s\n' "$((SECONDS))"
  done
}
tick &
code=0
"$@" >/dev/null || code=$?
kill $! 2>/dev/null || true
exit "$code"
