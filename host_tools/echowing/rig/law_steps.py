"""Does the speed respond to the range as law 0 says (thesis Table 6)? Pure: samples to verdicts."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from echowing.analysis.thesis import Band

SAME_MPS = 0.01  # speeds nearer than this are one: 32-bit floats on the way
# A step falls anywhere in its period, and the first one waits for a whole one: later is no answer.
PATIENCE_PERIODS = 2.5
# The applet runs 20 times per second: of samples no farther apart the second shows the range of the
# step between them; farther apart it may be that of the first.
UPDATE_S = 0.05
MONITOR_PERIODS = 3.0  # this long without a step is a speed that is held


@dataclass(frozen=True)
class Law:
    """Law 0 with the applet's parameters, metres, seconds and m/s; distances as the board reads."""

    distance_m: float
    band_in_m: float
    band_out_m: float
    detect_m: float
    step_small_mps: float
    step_big_mps: float
    period_s: float
    least_mps: float
    most_mps: float
    inset_m: float = 0.0

    @classmethod
    def of(cls, parameters: Mapping[str, float]) -> "Law":
        """From the applet's parameters by name; KeyError names one that is missing.

        In terms of the board's range: ECHO_DIST is centre to centre, the range is ECHO_INSET less.
        """
        distance_m = parameters["ECHO_DIST"] - parameters["ECHO_INSET"]
        names = ("BAND_IN", "BAND_OUT", "DETECT", "STEP_SML", "STEP_BIG", "PERIOD")
        limits = ("SPD_MIN", "SPD_MAX")
        values = (parameters[f"ECHO_{name}"] for name in (*names, *limits))
        return replace(cls(distance_m, *values), inset_m=parameters["ECHO_INSET"])

    def bands(self) -> tuple[Band, ...]:
        """Table 6 for these parameters, from far to near."""
        d, inner, outer = self.distance_m, self.band_in_m, self.band_out_m
        return (
            Band("attract, big step", d + outer, self.detect_m, self.step_big_mps),
            Band("attract, small step", d + inner, d + outer, self.step_small_mps),
            Band("monitor", d - inner, d + inner, 0.0),
            Band("repel, small step", d - outer, d - inner, -self.step_small_mps),
            Band("repel, big step", 0.0, d - outer, -self.step_big_mps),
        )

    def band_at(self, range_m: float) -> Band | None:
        """The band of a range; None: beyond the detection limit."""
        # The applet's edges are 32-bit floats: a centimetre on one counts as in the farther band.
        nearly_m = range_m + 1e-4
        return next((b for b in self.bands() if b.from_m <= nearly_m < b.to_m), None)

    def refuses(self, speed_mps: float, step_mps: float) -> bool:
        """Whether a step would reach a limit; the law does not make it then."""
        after_mps = speed_mps + step_mps
        return after_mps >= self.most_mps - SAME_MPS or after_mps <= self.least_mps + SAME_MPS


@dataclass(frozen=True)
class Sample:
    """One sample. range_m: None for no target.

    guarded: the applet's too-close guard sets the speed, not the law.
    """

    t_s: float
    range_m: float | None
    speed_mps: float
    guarded: bool = False


@dataclass(frozen=True)
class Step:
    """A change of the speed; bands: where the range was; right: the law allows it there."""

    t_s: float
    range_m: float
    change_mps: float
    speed_mps: float
    bands: tuple[str, ...]
    right: bool


@dataclass
class BandRecord:
    """The observations while the range was in one band.

    still_s: the longest time without a step though one could be made; refused: at a limit there;
    held_s: the longest time without a step.
    """

    band: Band
    right: int = 0
    wrong: int = 0
    still_s: float = 0.0
    held_s: float = 0.0
    refused: bool = False

    def answers(self, period_s: float, sampled_s: float) -> bool:
        """Whether the speed did here what the law says."""
        if self.wrong:
            return False
        if self.band.step_mps == 0.0:
            return self.held_s >= MONITOR_PERIODS * period_s
        patience_s = PATIENCE_PERIODS * period_s + 2.0 * sampled_s
        return self.right > 0 and self.still_s <= patience_s


@dataclass
class StepJudge:
    """Watches range and speed, and judges every step by the band of its range."""

    law: Law
    records: dict[str, BandRecord] = field(init=False)
    steps: list[Step] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    lost_changes: int = 0  # the speed changed with nothing in range, which law 0 does not
    sampled_s: float = 0.0  # longest time between two samples
    _quiet_since_s: float | None = None
    band: str | None = None  # where the newest range is; None: in none

    def __post_init__(self) -> None:
        self.records = {band.name: BandRecord(band) for band in self.law.bands()}

    def hear(self, sample: Sample) -> None:
        """Take the next sample."""
        before = self.samples[-1] if self.samples else None
        self.samples.append(sample)
        if before is None or before.guarded or sample.guarded:
            self._quiet_since_s = None
            return
        self.sampled_s = max(self.sampled_s, sample.t_s - before.t_s)
        if abs(sample.speed_mps - before.speed_mps) > SAME_MPS:
            self._step(before, sample)
            self._quiet_since_s = sample.t_s
        self._note_stillness(sample)

    def _step(self, before: Sample, sample: Sample) -> None:
        at_once = sample.t_s - before.t_s <= UPDATE_S
        seen_m = (sample.range_m,) if at_once else (before.range_m, sample.range_m)
        ranges_m = [r for r in seen_m if r is not None]
        bands = {b.name: b for r in ranges_m if (b := self.law.band_at(r)) is not None}
        if not bands:
            self.lost_changes += 1
            return
        change_mps = sample.speed_mps - before.speed_mps
        most = math.floor((sample.t_s - before.t_s) / self.law.period_s) + 1
        right = _is_sum(change_mps, [band.step_mps for band in bands.values()], most)
        for name, band in bands.items():
            # Between two bands the step belongs to the one whose direction it has.
            if right and len(bands) > 1 and band.step_mps * change_mps <= 0.0:
                continue
            self.records[name].right += right
            self.records[name].wrong += not right
        shown = (sample.t_s, ranges_m[-1], change_mps, sample.speed_mps)
        self.steps.append(Step(*shown, tuple(bands), right))

    def _note_stillness(self, sample: Sample) -> None:
        band = None if sample.range_m is None else self.law.band_at(sample.range_m)
        name = band.name if band else None
        if band is None or name != self.band or self._quiet_since_s is None:
            self.band, self._quiet_since_s = name, sample.t_s
            return
        record, quiet_s = self.records[band.name], sample.t_s - self._quiet_since_s
        record.held_s = max(record.held_s, quiet_s)
        if band.step_mps != 0.0 and self.law.refuses(sample.speed_mps, band.step_mps):
            record.refused = record.refused or quiet_s > PATIENCE_PERIODS * self.law.period_s
        else:
            record.still_s = max(record.still_s, quiet_s)


def _is_sum(change_mps: float, steps_mps: Sequence[float], most: int) -> bool:
    """Whether a change is the sum of up to `most` of these steps."""
    sums = {0.0}
    for _ in range(most):
        sums |= {total + step for total in sums for step in steps_mps}
        if any(abs(total - change_mps) <= SAME_MPS for total in sums if total):
            return True
    return False


def judged(law: Law, samples: Iterable[Sample]) -> StepJudge:
    """All of them, judged."""
    judge = StepJudge(law)
    for sample in samples:
        judge.hear(sample)
    return judge
