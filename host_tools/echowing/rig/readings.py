"""What the co-processor's messages say, and statistics of readings."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from echowing.rig.state import NOTHING_HEARD_M, STATE_NAMES

# Values of SNR_STATE.
TRACKING, FAULT = map(STATE_NAMES.index, ("tracking", "sonar fault"))


def named_value(message: Any) -> tuple[str, float] | None:
    """Name and value of a NAMED_VALUE_FLOAT; None for other messages."""
    if message.get_type() != "NAMED_VALUE_FLOAT":
        return None
    return str(message.name).rstrip("\0"), float(message.value)


def value_of(message: Any, name: str) -> float | None:
    """The value, if the message is that one."""
    named = named_value(message)
    return named[1] if named is not None and named[0] == name else None


def average_m(report: Any) -> float | None:
    """The running average in a DISTANCE_SENSOR, metres; None: no target."""
    if not report.min_distance <= report.current_distance <= report.max_distance:
        return None
    return float(report.current_distance) / 100.0


def heard_m(raw_m: float) -> float | None:
    """A single reading; None: nothing was heard."""
    return round(raw_m, 3) if raw_m < NOTHING_HEARD_M else None


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation; NaN where there are too few."""

    count: int
    mean: float
    std: float


def spread(values: Sequence[float]) -> Spread:
    """Of any number of values."""
    mean = statistics.fmean(values) if values else math.nan
    std = statistics.stdev(values) if len(values) > 1 else math.nan
    return Spread(len(values), mean, std)


def percentile(values: Sequence[float], share: float) -> float:
    """The least value that this share of them does not exceed; NaN of none."""
    if not values:
        return math.nan
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
