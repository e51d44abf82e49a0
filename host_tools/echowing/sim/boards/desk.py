"""The co-processor on a desk: real time, ports wired to other programs, a leader to hear."""

import itertools
import json
import math
import random
import time
from collections.abc import Callable, Mapping, Sequence

from echowing.errors import EchowingError
from echowing.geo import Ned
from echowing.sim.boards.coprocessor import Coprocessor
from echowing.sim.boards.wires import Wire, open_udp
from echowing.sim.world.sonar import (
    ON_A_DESK,
    Ear,
    Gimbal,
    MaxSonar,
    Pose,
    Target,
    TrueSonar,
)

# Eleven bytes at 115200 baud: finer matters to nobody, coarser would be heard as jitter.
SLICE_S = 0.001
# A machine this far behind cannot keep up: the time is let go rather than caught up.
HOPELESS_S = 0.5
LONGEST_RANGE_CM = 10_000
_DATAGRAM_BYTES = 2048


class Scene:
    """What the sonar hears: a fixed range, vehicles told of, a leader watched, or nothing.

    Vehicles stay where the last datagram has put them. watched: where the leader is in the
    follower's body frame, asked for at every step. sonar: what it truly hears of a vehicle.
    """

    def __init__(
        self,
        range_cm: int | None = None,
        target: str | None = None,
        watched: Callable[[], Ned | None] | None = None,
        sonar: TrueSonar = ON_A_DESK,
    ) -> None:
        if range_cm is not None and not 0 <= range_cm <= LONGEST_RANGE_CM:
            raise EchowingError(f"a range of {range_cm} cm: give 0 to {LONGEST_RANGE_CM}")
        self.sensor = MaxSonar(self._listen)
        self._range_m = None if range_cm is None else range_cm / 100.0
        self._datagrams = open_udp(target) if target else None
        self._targets_body_m: Sequence[Ned] = ()
        self._watched = watched
        self._gimbal = Gimbal()
        self._ear = Ear(lambda name: random.Random(f"0 {name}"), sonar)

    @property
    def udp_port(self) -> int | None:
        """Where datagrams are taken."""
        return int(self._datagrams.getsockname()[1]) if self._datagrams else None

    def _listen(self, t_s: float) -> float | None:
        if self._datagrams is None and self._watched is None:
            return self._range_m
        sonar = self._ear.sonar
        pose = Pose((sonar.boom_m, 0.0, 0.0), self._gimbal.axis_body())
        targets = [Target(at_m, sonar.foil_m, sonar.legs_m) for at_m in self._targets_body_m]
        return self._ear.ping(t_s, pose, targets, surfaces=())

    def step(self, dt_s: float, pan_us: float, tilt_us: float) -> None:
        """Turn the gimbal, and take the newest datagram; a senseless one is reported and left."""
        self._gimbal.step(dt_s, pan_us, tilt_us)
        if self._watched is not None:
            leader_body_m = self._watched()
            self._targets_body_m = () if leader_body_m is None else (leader_body_m,)
        while self._datagrams is not None:
            try:
                datagram = self._datagrams.recv(_DATAGRAM_BYTES)
            except BlockingIOError:
                return
            try:
                self._targets_body_m = targets_from(datagram)
            except EchowingError as error:
                print(f"echowing emulator: {error}", flush=True)

    def close(self) -> None:
        """Stop listening."""
        if self._datagrams is not None:
            self._datagrams.close()


def targets_from(datagram: bytes) -> list[Ned]:
    """Places in the follower's body frame (forward, right, down), metres, from JSON."""
    try:
        told = json.loads(datagram)
        places = [
            (float(one["forward_m"]), float(one["right_m"]), float(one["down_m"]))
            for one in (told if isinstance(told, list) else [told])
        ]
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise EchowingError(f"{_WANTED}; this came: {datagram[:80]!r}") from error
    if not all(map(math.isfinite, itertools.chain(*places))):
        raise EchowingError(f"{_WANTED}; this came: {datagram[:80]!r}")
    return places


_WANTED = (
    'a datagram has to be {"forward_m": number, "right_m": number, "down_m": number}, '
    "or a list of these"
)


class Desk:
    """Runs a board at the pace of a clock and carries bytes between its ports and their wires."""

    def __init__(
        self,
        board: Coprocessor,
        wires: Mapping[int, Wire],
        scene: Scene,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._board, self._wires, self._scene = board, wires, scene
        self._clock, self._sleep = clock, sleep
        self._told_slow = False
        self._restarts = 0

    def run(self, duration_s: float | None = None) -> None:
        """Run for that long, or for ever."""
        started_s = self._clock()
        t_s = 0.0
        while duration_s is None or t_s < duration_s:
            behind_s = self._clock() - started_s - t_s
            if behind_s > HOPELESS_S:
                started_s += behind_s
                self._tell_slow()
            elif behind_s < SLICE_S:
                self._sleep(SLICE_S - behind_s)
            t_s += SLICE_S
            self._slice(t_s)

    def _slice(self, t_s: float) -> None:
        board = self._board
        board.run_until(round(t_s * 1e6))
        self._scene.step(SLICE_S, board.pan_us, board.tilt_us)
        for port, wire in self._wires.items():
            arrived = wire.exchange(board.take(port), t_s)
            if arrived:
                board.feed(port, arrived)
        if board.restarts != self._restarts:
            self._restarts = board.restarts
            print("the board has restarted", flush=True)

    def _tell_slow(self) -> None:
        if not self._told_slow:
            print("this machine is too slow for real time: the board's time lags", flush=True)
        self._told_slow = True
