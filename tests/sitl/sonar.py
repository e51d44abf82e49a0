"""What the emulated sonar hears: datagrams for `echowing emulator --target`, from the truth."""

import json
import socket
import threading
from collections.abc import Callable, Sequence

import numpy as np

from echowing.analysis.flight import Floats
from echowing.geo import Ned, ned_between

from .relay import LOOPBACK
from .truth import body_frame
from .vehicle import ORIGIN, State, Vehicle

# Vectors from a follower to all that its sonar may hear, NED metres.
Scene = Callable[[State], Sequence[Floats]]


class Feeder:
    """Tells an emulator at each truth of its follower what may be heard there."""

    def __init__(self, follower: Vehicle, port: int, scene: Scene) -> None:
        self.scene = scene
        self._to = (LOOPBACK, port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # The truth comes in another thread than the one that closes.
        self._in_use = threading.Lock()
        self._follower = follower
        follower.on_truth = self._tell

    def _tell(self, state: State) -> None:
        names = ("forward_m", "right_m", "down_m")
        places = [dict(zip(names, at_m, strict=True)) for at_m in bodies(state, self.scene(state))]
        told = json.dumps(places).encode()
        with self._in_use:
            if self._socket.fileno() >= 0:
                self._socket.sendto(told, self._to)

    def close(self) -> None:
        """Say no more."""
        self._follower.on_truth = None
        with self._in_use:
            self._socket.close()


def bodies(state: State, vectors_ned_m: Sequence[Floats]) -> list[Ned]:
    """Vectors from a follower in its body frame: forward, right, down."""
    angles = (state.roll_rad, state.pitch_rad, state.yaw_rad)
    turned = [body_frame(vector_ned_m, *angles) for vector_ned_m in vectors_ned_m]
    return [(float(forward), float(right), float(down)) for forward, right, down in turned]


def silence(state: State) -> Sequence[Floats]:
    """A sonar that hears nothing."""
    return ()


def vehicles(others: Sequence[Vehicle]) -> Scene:
    """The other vehicles, where they are by now."""

    def hear(state: State) -> Sequence[Floats]:
        seen = [_ahead(other.state, state.time_s) for other in others if other.heard.truth]
        return [np.array(ned_between(state.position, one.position)) + ahead for one, ahead in seen]

    return hear


def _ahead(state: State, now_s: float) -> tuple[State, Floats]:
    """A state and how far it has moved on since it was heard."""
    return state, np.array(state.velocity_ned_mps) * (now_s - state.time_s)


def wall(north_m: float) -> Scene:
    """A wall across the way north, heard where the sonar's axis meets it squarely."""

    def hear(state: State) -> Sequence[Floats]:
        follower_north_m = ned_between(ORIGIN, state.position)[0]
        return [np.array([north_m - follower_north_m, 0.0, 0.0])]

    return hear
