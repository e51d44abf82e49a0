"""How a vehicle answers a speed step, from its own log, beside what the envelope counts with.

A step is an order in Guided whose velocity differs from the one before: both are held for a while.
What follows is fitted as the envelope sees it: nothing for a reaction time, an acceleration that
rises at a jerk, and then stays. GUIP has the orders, XKF1 the velocity, PARM the parameters.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from echowing.analysis.flight import Floats
from echowing.analysis.vehicle_log import DATAFLASH_START, Reader
from echowing.errors import EchowingError
from echowing.flight.handling import Handling

# AC_PosControl flies a velocity in these sub-modes of Guided (ModeGuided::SubMode).
WITH_VELOCITY = {3, 4}
# GUIP's vX among its columns, and the multiplier of centimetres (up to 4.6; LogStructure.h).
VELOCITY_AT, CENTI = 6, "B"
# A smaller step does not show the deceleration: with ArduCopter's limits it is reached at 0.6 m/s,
# and given back from 1.3 m/s before the end on.
LEAST_STEP_MPS = 2.0
# So long one order before and the other after the step, give or take `SAME_MPS`.
HELD_S, SAME_MPS = 1.0, 0.2
# The vehicle flies the first order by then, give or take this.
FLOWN_MPS = 0.4
# Up to this part of a step Guided accelerates with all that it may.
SHARE = 0.5
LONGEST_S = 5.0
# In flight an order waits for the next point: half a period at 8 Hz.
POINT_WAIT_S = 0.06
# Samples of the velocity come every 0.1 s.
TOLERANCE_S = 0.1
# What a fit is tried with. An acceleration within a tenth is as well known as a gust allows.
_REACTIONS_S = np.arange(0.0, 2.0, 0.02)
_ACCELERATIONS_MPS2 = np.geomspace(0.3, 12.0, 60)
_JERKS_MPS3 = np.geomspace(0.5, 60.0, 60)


@dataclass(frozen=True, slots=True)
class Figures:
    """dead_s: until the acceleration counts as full; half_s: until half of the step is flown."""

    dead_s: float
    decel_mps2: float
    jerk_mps3: float
    half_s: float


@dataclass(frozen=True, slots=True)
class StepAnswer:
    """One step: since the vehicle was switched on, its size, and the answer.

    counted: what the envelope counts with; missing: parameters that the log does not hold, taken
    as the worst.
    """

    at_s: float
    size_mps: float
    measured: Figures
    counted: Figures
    missing: tuple[str, ...]

    @property
    def slower(self) -> bool:
        """Whether it answers later than the envelope counts with."""
        return self.measured.half_s > self.counted.half_s + TOLERANCE_S

    def to_json(self) -> dict[str, object]:
        """JSON-ready."""
        return {**asdict(self), "slower": self.slower}


def read_answers(path: Path) -> list[StepAnswer]:
    """The speed steps in a vehicle's .BIN. Raises EchowingError if there is none."""
    _refuse_others(path)
    log = _Recorded()
    for message in Reader(path, "BIN", ["FMT", "FMTU", "PARM", "GUIP", "XKF1"]):
        log.take(message)
    velocities = np.array(log.velocities, dtype=float).reshape(-1, 3)
    found = [
        answer
        for before, after, until_s in _steps(log.orders)
        if (answer := _answer(before, after, until_s, velocities, log)) is not None
    ]
    if not found:
        raise EchowingError(
            f"log {path}: no speed step of {LEAST_STEP_MPS:g} m/s or more in Guided, each order "
            f"held for {HELD_S:g} s and more: fly one (host_tools/SETUP.md)"
        )
    return found


_Order = tuple[float, float, float]
"""Time, and the velocity (north, east)."""


@dataclass(slots=True)
class _Recorded:
    """What a log holds of orders, velocities and parameters, times since the start."""

    orders: list[_Order] = field(default_factory=list)
    velocities: list[_Order] = field(default_factory=list)
    parameters: list[tuple[float, str, float]] = field(default_factory=list)
    _order_number: int = -1
    _per_unit: float = 1.0

    def take(self, message: Any) -> None:
        """Take one message."""
        kind = message.get_type()
        if kind == "FMT" and message.Name == "GUIP":
            self._order_number = message.Type
        elif kind == "FMTU" and message.FmtType == self._order_number:
            self._per_unit = 0.01 if message.MultIds[VELOCITY_AT] == CENTI else 1.0
        elif kind == "PARM":
            self.parameters.append((message.TimeUS / 1e6, message.Name, message.Value))
        elif kind == "GUIP":
            # Where no velocity was ordered it is not a number: no comparison with it holds.
            unit = self._per_unit if message.Type in WITH_VELOCITY else math.nan
            self.orders.append((message.TimeUS / 1e6, message.vX * unit, message.vY * unit))
        elif kind == "XKF1" and message.C == 0:
            self.velocities.append((message.TimeUS / 1e6, message.VN, message.VE))

    def handling_at(self, time_s: float) -> Handling:
        """What the vehicle would have reported then."""
        handling = Handling()
        for since_s, name, value in self.parameters:
            if since_s <= time_s:
                handling.receive(name, value)
        return handling


def _refuse_others(path: Path) -> None:
    try:
        with path.open("rb") as file:
            start = file.read(len(DATAFLASH_START))
    except OSError as error:
        raise EchowingError(f"log {path}: cannot be read: {error.strerror}") from error
    if start != DATAFLASH_START:
        raise EchowingError(f"log {path}: no .BIN, and --answer needs the vehicle's own log")


def _steps(orders: list[_Order]) -> Iterator[tuple[_Order, _Order, float]]:
    """The last order before each step, the first one after, and until when that is in force."""
    since_s = math.inf
    for number, after in enumerate(orders[1:], 1):
        before = orders[number - 1]
        changed_mps = _apart_mps(before, after)
        if changed_mps <= SAME_MPS:
            since_s = min(since_s, before[0])
            continue
        held = after[0] - min(since_s, before[0]) >= HELD_S
        since_s = math.inf
        if held and changed_mps >= LEAST_STEP_MPS:
            later = (one[0] for one in orders[number:] if not _apart_mps(one, after) <= SAME_MPS)
            yield before, after, min(next(later, math.inf), after[0] + LONGEST_S)


def _apart_mps(one: _Order, other: _Order) -> float:
    return math.hypot(other[1] - one[1], other[2] - one[2])


def _answer(
    before: _Order, after: _Order, until_s: float, velocities: Floats, log: _Recorded
) -> StepAnswer | None:
    """What a step shows; None: not held, not flown before it, or not answered within it."""
    begin_s, size_mps = after[0], _apart_mps(before, after)
    towards = (np.array(after[1:]) - np.array(before[1:])) / size_mps
    times_s = velocities[:, 0]
    earlier = velocities[(times_s > begin_s - HELD_S / 2.0) & (times_s <= begin_s), 1:]
    later = velocities[(times_s > begin_s) & (times_s <= until_s)]
    if until_s - begin_s < HELD_S or len(earlier) == 0:
        return None
    flown_before = earlier.mean(axis=0)
    if math.hypot(*(flown_before - before[1:])) > FLOWN_MPS:
        return None
    since_s, gained_mps = later[:, 0] - begin_s, (later[:, 1:] - flown_before) @ towards
    over = np.flatnonzero(gained_mps >= SHARE * size_mps)
    if len(over) == 0:
        return None
    end = int(over[0]) + 1
    half_s = _when(since_s[:end], gained_mps[:end], 0.5 * size_mps)
    measured = _fitted(since_s[:end], gained_mps[:end], half_s + POINT_WAIT_S)
    handling = log.handling_at(begin_s)
    counted = _counted(handling, size_mps)
    size_mps = round(size_mps, 2)
    return StepAnswer(round(begin_s, 2), size_mps, measured, counted, tuple(handling.missing))


def _when(times_s: Floats, gained_mps: Floats, wanted_mps: float) -> float:
    """When it had gained so much, between the last two samples."""
    return float(np.interp(wanted_mps, gained_mps[-2:], times_s[-2:]))


def _counted(handling: Handling, size_mps: float) -> Figures:
    answer = handling.answer_in_calm
    half_s = answer.dead_s + 0.5 * size_mps / answer.decel_mps2
    return Figures(answer.dead_s, answer.decel_mps2, handling.closing.jerk_mps3, half_s)


def _fitted(times_s: Floats, gained_mps: Floats, half_s: float) -> Figures:
    """The reaction time, acceleration and jerk that fit best."""
    reaction_s, accel_mps2, jerk_mps3 = np.meshgrid(
        _REACTIONS_S, _ACCELERATIONS_MPS2, _JERKS_MPS3, indexing="ij", sparse=True
    )
    rises_s = accel_mps2 / jerk_mps3
    errors = np.zeros(np.broadcast_shapes(reaction_s.shape, rises_s.shape))
    for time_s, gained in zip(times_s, gained_mps, strict=True):
        since_s = np.maximum(0.0, time_s - reaction_s)
        rising_s = np.minimum(since_s, rises_s)
        fits = 0.5 * jerk_mps3 * rising_s**2 + accel_mps2 * (since_s - rising_s)
        errors += (fits - gained) ** 2
    best = np.unravel_index(int(errors.argmin()), errors.shape)
    reaction, accel = float(_REACTIONS_S[best[0]]), float(_ACCELERATIONS_MPS2[best[1]])
    jerk = float(_JERKS_MPS3[best[2]])
    # Of an acceleration that was not reached within the step only the part that was is known.
    accel = min(accel, math.sqrt(2.0 * jerk * max(0.0, float(gained_mps[-1]))))
    return Figures(POINT_WAIT_S + reaction + accel / (2.0 * jerk), accel, jerk, half_s)


def as_lines(answers: Sequence[StepAnswer]) -> Iterator[str]:
    """A table of the steps, each figure beside the one that the envelope counts with."""
    yield "  at       step     dead time      deceleration      jerk             half of it after"
    for one in answers:
        real, counted = one.measured, one.counted
        yield (
            f"  {one.at_s:5.1f} s  {one.size_mps:.1f} m/s"
            f"  {real.dead_s:.2f} ({counted.dead_s:.2f}) s"
            f"  {real.decel_mps2:.1f} ({counted.decel_mps2:.1f}) m/s2"
            f"  {real.jerk_mps3:4.1f} ({counted.jerk_mps3:.1f}) m/s3"
            f"  {real.half_s:.2f} ({counted.half_s:.2f}) s{'  SLOWER' if one.slower else ''}"
        )
    yield "  In brackets: what the envelope counts with, from the parameters in the log."
    missing = sorted({name for one in answers for name in one.missing})
    if missing:
        yield f"  Not in the log, so taken as the worst: {', '.join(missing)}."
    if any(one.slower for one in answers):
        yield (
            "  It answers later than its parameters say: tune it (AutoTune), or lower WP_ACC and\n"
            "  PSC_JERK_NE to what it flies. Until then keep its slot farther away."
        )
