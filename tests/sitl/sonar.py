"""What the emulated sonar hears: datagrams for `echowing emulator --target`, from the truth."""

import json
import math
import socket
import threading
from collections.abc import Callable, Sequence

import numpy as np

from echowing.analysis.flight import Floats
from echowing.geo import ned_between

from .relay import LOOPBACK
from .truth import body_frame
from .vehicle import ORIGIN, State, Vehicle

# Farther than any sonar hears: the emulator takes the last datagram for true until the next.
NOTHING_BODY_M = (1_000.0, 0.0, 0.0)
# As far as the gimbal pans (the board's `PAN_REACH`), and half a beam.
PAN_REACH_RAD = math.radians(70.0)
Scene = Callable[[State], Floats | None]


class Feeder:
    """Tells an emulator at each truth of its follower what is to be heard there.

    scene: a vector to it from the follower, NED metres; None: nothing.
    """

    def __init__(self, follower: Vehicle, port: int, scene: Scene) -> None:
        self.scene = scene
        self._to = (LOOPBACK, port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # The truth comes in another thread than the one that closes.
        self._in_use = threading.Lock()
        self._follower = follower
        follower.on_truth = self._tell

    def _tell(self, state: State) -> None:
        vector_ned_m = self.scene(state)
        place = NOTHING_BODY_M
        if vector_ned_m is not None:
            angles = (state.roll_rad, state.pitch_rad, state.yaw_rad)
            forward_m, right_m, down_m = body_frame(vector_ned_m, *angles)
            place = float(forward_m), float(right_m), float(down_m)
        names = ("forward_m", "right_m", "down_m")
        told = json.dumps(dict(zip(names, place, strict=True))).encode()
        with self._in_use:
            if self._socket.fileno() >= 0:
                self._socket.sendto(told, self._to)

    def close(self) -> None:
        """Say no more."""
        self._follower.on_truth = None
        with self._in_use:
            self._socket.close()


def silence(state: State) -> Floats | None:
    """A sonar that hears nothing."""
    return None


def vehicles(others: Sequence[Vehicle]) -> Scene:
    """The nearest of the other vehicles before which the gimbal comes, where it is by now."""

    def hear(state: State) -> Floats | None:
        seen = [_ahead(other.state, state.time_s) for other in others if other.heard.truth]
        vectors = [
            np.array(ned_between(state.position, one.position)) + ahead for one, ahead in seen
        ]
        reached = [vector for vector in vectors if _off_nose_rad(vector, state) <= PAN_REACH_RAD]
        return min(reached, key=lambda vector: float(np.linalg.norm(vector)), default=None)

    return hear


def _off_nose_rad(vector_ned_m: Floats, state: State) -> float:
    """How far to the side something is, seen from above."""
    north_m, east_m, _ = vector_ned_m
    off_rad = math.atan2(east_m, north_m) - state.yaw_rad
    return abs(math.remainder(off_rad, math.tau))


def _ahead(state: State, now_s: float) -> tuple[State, Floats]:
    """A state and how far it has moved on since it was heard."""
    return state, np.array(state.velocity_ned_mps) * (now_s - state.time_s)


def wall(north_m: float) -> Scene:
    """A wall across the way north, heard where the sonar's axis meets it squarely."""

    def hear(state: State) -> Floats | None:
        follower_north_m = ned_between(ORIGIN, state.position)[0]
        return np.array([north_m - follower_north_m, 0.0, 0.0])

    return hear
