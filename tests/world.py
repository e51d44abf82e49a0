"""The world of the flights in which something else than the world is tested.

Heights are right, receivers drift by what the product takes for granted, and the sonar hears all
that is in a cone of 20 degrees: as all flights were before each had a world of its own.
"""

from typing import Any

CLEAR: dict[str, dict[str, Any]] = {
    "gps": {"spread": 0.0, "vertical_sigma_m": 0.0},
    "sonar": {
        "spread": 0.0,
        "heard_share": 1.0,
        "beam_near_deg": 20.0,
        "noise_m": 0.01,
        "wild_share": 0.01,
        "inset_m": 0.2,
    },
}
# The same for `--set`.
CLEARLY = tuple(
    f"{section}.{key}={value}" for section, keys in CLEAR.items() for key, value in keys.items()
)
