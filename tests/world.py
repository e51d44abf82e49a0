"""The world of the flights in which something else than the world is tested: as it is believed."""

import tomllib
from typing import Any

from echowing.bench.accuracy import AS_BELIEVED

# For `--set`, and as sections of a scenario.
CLEARLY = AS_BELIEVED
CLEAR: dict[str, dict[str, Any]] = tomllib.loads("\n".join(AS_BELIEVED))
