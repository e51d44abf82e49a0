"""What late echoes do to the co-processor's readings: `echowing bench --only echoes`.

An echo that comes back after the next ping reads as a near one. The firmware's own core listens to
the acoustic model: to a leader, to a leader with a reflector behind it (a wall, a building), and to
the reflector alone.
"""

import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, NativeCoprocessor
from echowing.sim.world.sonar import (
    ON_A_DESK,
    Ear,
    MaxSonar,
    Pose,
    Target,
)

# SONAR_PERIOD and SONAR_JITTER, ms. A jitter of 20 pings at clearly different intervals.
SETTINGS = ((50, 5), (50, 20), (60, 20), (70, 5), (80, 5), (100, 0), (100, 5))
REFLECTORS_M = (6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0)
LEADER_M = 3.0
# Nearer to the leader's distance than this a range is the leader's.
RIGHT_M = 0.5
# The leader is in the beam, and then is not.
PRESENT_S, ABSENT_S, ROUNDS = 5.0, 2.0, 8
STEP_US = 5_000
HEADER = ("period", "jitter", "scene", "false", "missed", "false readings", "found", "lost")
_POSE = Pose((0.0, 0.0, -10.0), (1.0, 0.0, 0.0))
_LOUD_M = 100.0  # a wall is heard from anywhere


@dataclass(frozen=True, slots=True)
class EchoRow:
    """What came of one setting in one scene. Shares are 0 to 1.

    false: reports with a range that is not the leader's. missed: reports without one while the
    leader is there and has been found. false_readings: single ones under 4.5 m that are not the
    leader's. found_s, lost_s: from the leader's coming to the first report of it, from its going
    to the first without it; NaN where there is no leader.
    """

    period_ms: int
    jitter_ms: int
    scene: str
    false: float
    missed: float
    false_readings: float
    found_s: float
    lost_s: float

    def cells(self) -> tuple[str, ...]:
        """As text, under HEADER."""
        shares = (f"{share:.0%}" for share in (self.false, self.missed, self.false_readings))
        times = (
            f"{t_s:.2f} s" if math.isfinite(t_s) else "" for t_s in (self.found_s, self.lost_s)
        )
        return (f"{self.period_ms} ms", f"{self.jitter_ms} ms", self.scene, *shares, *times)


@dataclass
class _Tally:
    reports: int = 0
    false: int = 0
    expected: int = 0
    missed: int = 0
    readings: int = 0
    false_readings: int = 0
    found_s: list[float] = field(default_factory=list)
    lost_s: list[float] = field(default_factory=list)


class _Listener:
    """The co-processor under the model, with an armed autopilot beside it, so that it searches."""

    def __init__(
        self, period_ms: int, jitter_ms: int, reflector_m: float | None, seed: int
    ) -> None:
        self.tally = _Tally()
        self.present = False
        self._ear = Ear(lambda name: random.Random(f"{seed} {name}"))
        self._beyond = [] if reflector_m is None else [_target(reflector_m, _LOUD_M)]
        self._core = NativeCoprocessor(
            MaxSonar(self._listen),
            seed=seed,
            parameters={"SYS_ID": 1, "SONAR_PERIOD": period_ms, "SONAR_JITTER": jitter_ms},
        )
        self._parser = mavlink.MAVLink(None)
        self._autopilot = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._t_us = self._beat_at_us = 0
        self._since_us = 0  # the leader came, or went
        self._waiting = False  # for a report that says so
        self._found = False

    def change(self, *, present: bool) -> None:
        """The leader comes into the beam, or leaves it."""
        self._waiting = present != self.present
        self.present, self._since_us, self._found = present, self._t_us, False

    def run(self, seconds: float) -> None:
        """Let time pass, and count."""
        end_us = self._t_us + round(seconds * 1e6)
        while self._t_us < end_us:
            self._beat()
            self._t_us += STEP_US
            self._core.run_until(self._t_us)
            for message in self._parser.parse_buffer(self._core.take(AUTOPILOT_PORT)) or []:
                if message.get_type() == "DISTANCE_SENSOR":
                    self._on_report(message)
                elif message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "SNR_RAW":
                    self.tally.readings += 1
                    self.tally.false_readings += _is_false(message.value, limit_m=4.5)

    def _listen(self, t_s: float) -> float | None:
        leader = [_target(LEADER_M, ON_A_DESK.foil_m)] if self.present else []
        return self._ear.ping(t_s, _POSE, leader + self._beyond, ())

    def _beat(self) -> None:
        if self._t_us < self._beat_at_us:
            return
        self._beat_at_us += 1_000_000
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        beat = mavlink.MAVLink_heartbeat_message(2, 3, armed, 4, 4, 3)
        self._core.feed(AUTOPILOT_PORT, bytes(beat.pack(self._autopilot)))

    def _on_report(self, message: Any) -> None:
        range_m = message.current_distance / 100.0
        right = abs(range_m - LEADER_M) <= RIGHT_M
        if self._waiting and right == self.present:
            self._waiting = False
            delays_s = self.tally.found_s if self.present else self.tally.lost_s
            delays_s.append((self._t_us - self._since_us) / 1e6)
        self._found = self._found or (right and self.present)
        self.tally.reports += 1
        self.tally.false += _is_false(range_m, limit_m=message.max_distance / 100.0)
        self.tally.expected += self._found
        self.tally.missed += self._found and message.current_distance > message.max_distance


def _target(range_m: float, heard_to_m: float) -> Target:
    """Something whose face is `range_m` from the sonar's, straight ahead."""
    north_m = range_m + ON_A_DESK.inset_m
    return Target((north_m, 0.0, _POSE.position_ned_m[2]), heard_to_m)


def _is_false(range_m: float, *, limit_m: float) -> bool:
    return range_m < limit_m and abs(range_m - LEADER_M) > RIGHT_M


def listen_to(
    period_ms: int, jitter_ms: int, *, leader: bool, reflector_m: float | None, seed: int = 1
) -> EchoRow:
    """One setting in one scene; the same seed gives the same row."""
    listener = _Listener(period_ms, jitter_ms, reflector_m, seed)
    for _ in range(ROUNDS):
        listener.change(present=leader)
        listener.run(PRESENT_S)
        listener.change(present=False)
        listener.run(ABSENT_S)
    tally = listener.tally
    scene = "leader" if leader else ""
    if reflector_m is not None:
        scene += f"{' and ' if scene else ''}reflector at {reflector_m:g} m"
    return EchoRow(
        period_ms,
        jitter_ms,
        scene,
        tally.false / tally.reports,
        tally.missed / max(1, tally.expected),
        tally.false_readings / tally.readings,
        _mean(tally.found_s),
        _mean(tally.lost_s),
    )


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def late_echoes(
    settings: Sequence[tuple[int, int]] = SETTINGS,
    reflectors_m: Sequence[float] = REFLECTORS_M,
    on_row: Callable[[], None] = lambda: None,
) -> Iterator[EchoRow]:
    """A row for each setting and scene; with a reflector, of each figure its worst distance."""
    for period_ms, jitter_ms in settings:
        yield replace(
            listen_to(period_ms, jitter_ms, leader=True, reflector_m=None), scene="leader alone"
        )
        for leader, scene in ((True, "leader and reflector"), (False, "reflector alone")):
            rows = [
                listen_to(period_ms, jitter_ms, leader=leader, reflector_m=one)
                for one in reflectors_m
            ]
            yield _worst(rows, scene)
            on_row()


def _worst(rows: Sequence[EchoRow], scene: str) -> EchoRow:
    return replace(
        rows[0],
        scene=scene,
        false=max(row.false for row in rows),
        missed=max(row.missed for row in rows),
        false_readings=max(row.false_readings for row in rows),
        found_s=max(row.found_s for row in rows),
        lost_s=max(row.lost_s for row in rows),
    )


def markdown(rows: Sequence[EchoRow]) -> str:
    """The table as firmware/README.md has it."""
    lines = [HEADER, ("---",) * len(HEADER), *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
